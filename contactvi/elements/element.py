"""What all elements of a scene are: constants with a name, checked when they are made, which files can store."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from contactvi.elements.pose_signals import PoseSignal
from contactvi.elements.signals import Signal
from contactvi.errors import InputError
from contactvi.inputs import vector

WORLD = "world"


@dataclass(frozen=True, eq=False)
class Element:
    """Base of all elements. `kind` is the name of its section in a scene file."""

    name: str
    kind: ClassVar[str] = ""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InputError(
                "Name of an element",
                name="name",
                expected="a non-empty str",
                got=repr(self.name),
                remedy="Give name='...', or leave it out: it is then made from the kind and a number",
            )
        self._check()

    def _check(self) -> None:
        """Check the fields and replace them by their clean values."""

    def _put(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __deepcopy__(self, memo: Any) -> Element:
        return self  # An element is constant, and functions of the user are not to be copied.

    @property
    def storable(self) -> bool:
        """Whether a file can store it: it is data and no function."""
        return all(_storable(getattr(self, entry.name)) for entry in fields(self))

    def to_data(self) -> dict[str, Any]:
        """Return it as plain data with its kind, if it is storable; `element_from_data` reads it back."""
        return {"kind": self.kind} | {entry.name: _data(getattr(self, entry.name)) for entry in fields(self)}

    def describe(self) -> str:
        """Return a description in a few words, for the report."""
        return self.kind


def point_of(element: Element, argument: str, value: Any) -> np.ndarray:
    """Return a point of an element [m], shape (3,)."""
    return vector(f"{argument} of {element.name!r}", value, 3)


def _storable(value: Any) -> bool:
    return value.storable if isinstance(value, (Signal, PoseSignal)) else not callable(value)


def _data(value: Any) -> Any:
    if isinstance(value, (Signal, PoseSignal)):
        return value.to_data()
    if isinstance(value, pin.SE3):
        return value.homogeneous.tolist()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, (tuple, list)):
        return [_data(item) for item in value]
    return value
