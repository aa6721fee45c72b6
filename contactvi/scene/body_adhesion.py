"""Adhesion of bodies to whatever they touch: a pull that all their contacts share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactvi.errors import InputError
from contactvi.inputs import real
from contactvi.scene.number_functions import NumberFunction, NumberTable, number_function


@dataclass(frozen=True)
class BodyAdhesion:
    """The pull of a body on what it touches.

    Attributes:
        body: its name.
        pull: by the time [N].
    """

    body: str
    pull: NumberFunction

    @classmethod
    def checked(cls, body: str, pull: Any) -> BodyAdhesion | None:
        """Return that of a number, a table or a function of the time; None: it never pulls."""
        if callable(pull) or np.ndim(pull) > 0:
            return cls(body, number_function("pull", pull, 0.0, np.inf, "s"))
        number = real("pull", pull, 0.0)
        return cls(body, NumberTable((0.0,), (number,))) if number > 0.0 else None

    @property
    def name(self) -> str:
        """What messages call its function."""
        return f"the adhesion of {self.body!r}"

    @property
    def storable(self) -> bool:
        """Whether it holds no function."""
        return self.pull.storable

    def to_data(self) -> Any:
        """Return it as plain data."""
        return [self.body, self.pull.to_data()] if isinstance(self.pull, NumberTable) else None

    @classmethod
    def from_data(cls, row: Any) -> BodyAdhesion:
        """Return what `to_data` described."""
        places, values = row[1]
        return cls(str(row[0]), NumberTable(tuple(map(float, places)), tuple(map(float, values))))


def adhesive_bodies(given: Sequence[tuple[frozenset[str], BodyAdhesion]], a: str, b: str) -> tuple[BodyAdhesion, ...]:
    """Return what pulls in the contact of the geometries a and b; `given` names the geometries of the bodies."""
    return tuple(adhesion for names, adhesion in given if (a in names) != (b in names))


def check_body(name: str, bodies: Sequence[str], moving: bool) -> None:
    """Raise InputError unless the geometries of one body that moves are meant."""
    if len(bodies) == 1 and moving:
        return
    raise InputError(
        "Adhesion of a body needs one body that moves", name="body", expected="a body with shapes, on a joint",
        got=f"{name!r}: {', '.join(map(repr, bodies)) or 'no shapes'}" + ("" if moving else ", which is fixed"),
        remedy="Name one body; scene.set_contact(a, b, adhesion=) is that of a pair",
    )  # fmt: skip
