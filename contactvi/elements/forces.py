"""Springs, wrenches, and potentials and forces that functions of the user give.

Each is a constant, checked when it is made (InputError), and refers to bodies by name; contactvi.scene resolves the
names in a model. A body is named by its frame, "world" is the ground. Points [m] are in the frames of their bodies.
What is None is taken as it is in the neutral configuration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from contactvi.elements.element import Element, point_of
from contactvi.errors import InputError
from contactvi.inputs import flag, real, short, vector

AXES = ("world", "body")


@dataclass(frozen=True, eq=False)
class PathSpring(Element):
    """Spring and damper along a line through points (body, xyz [m]) of at least two bodies.

    stiffness [N/m], rest_length [m] or None, damping [N s/m]; tension_only: slack below its rest length.
    """

    points: Any
    stiffness: float = 0.0
    rest_length: float | None = None
    damping: float = 0.0
    tension_only: bool = False
    kind: ClassVar[str] = "spring"

    def _check(self) -> None:
        what = f"points of {self.name!r}"
        try:
            points = [(body, vector(what, xyz, 3)) for body, xyz in self.points]
        except (TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"The {what}",
                name="points",
                expected='[("body", (x, y, z)), ...]',
                got=short(self.points),
                remedy="Write each point as (name of the body, (x, y, z)), in the axes of the body",
            ) from None
        if len(points) < 2 or len({body for body, _ in points}) < 2:
            got = f"{len(points)} points on {len({body for body, _ in points})} body"
            raise InputError(
                f"The {what}",
                name="points",
                expected="at least two, not all on one body",
                got=got,
                remedy="Add a point on another body, or on 'world'",
            )
        self._put(points=tuple(points), stiffness=real(f"stiffness of {self.name!r}", self.stiffness, 0.0))
        self._put(damping=real(f"damping of {self.name!r}", self.damping, 0.0))
        if self.rest_length is not None:
            self._put(rest_length=real(f"rest_length of {self.name!r}", self.rest_length, 0.0))
        flag("tension_only", self.tension_only)

    def describe(self) -> str:
        bodies = " - ".join(repr(body) for body, _ in self.points)
        only = ", only in tension" if self.tension_only else ""
        return f"spring of {self.stiffness:.4g} N/m, damper of {self.damping:.4g} N s/m{only} along {bodies}"


@dataclass(frozen=True, eq=False)
class Wrench(Element):
    """Force [N] and torque [N m] on a body at a point [m]: constants (3,) or functions of t, world or body axes."""

    body: str
    force: Any = None
    torque: Any = None
    point: Any = (0.0, 0.0, 0.0)
    axes: str = "world"
    kind: ClassVar[str] = "wrench"

    def _check(self) -> None:
        if self.force is None and self.torque is None:
            raise InputError(
                f"Wrench {self.name!r}",
                name="force",
                expected="a force, a torque or both",
                got="none",
                remedy="Give force=(x, y, z) or torque=(x, y, z), or a function of t that returns it",
            )
        for part in ("force", "torque"):
            value = getattr(self, part)
            if value is not None and not callable(value):
                self._put(**{part: vector(f"{part} of {self.name!r}", value, 3)})
        self._put(point=point_of(self, "point", self.point))
        if not isinstance(self.axes, str) or self.axes not in AXES:
            raise InputError(
                "Axes of a wrench",
                name="axes",
                expected="'world' or 'body'",
                got=short(self.axes),
                remedy="Use axes='world' for a fixed direction, axes='body' for one that turns with the body",
            )

    @property
    def constant(self) -> bool:
        """Whether it does not depend on time."""
        return not (callable(self.force) or callable(self.torque))

    def describe(self) -> str:
        return f"{'constant' if self.constant else 'time-varying'} wrench on {self.body!r}, {self.axes} axes"


@dataclass(frozen=True, eq=False)
class UserPotential(Element):
    """value(q) -> [J], gradient(q) -> (nv,), hessian(q) -> (nv, nv) or None; derivatives in the tangent space at q."""

    value: Any
    gradient: Any
    hessian: Any = None
    check: bool = True
    kind: ClassVar[str] = "potential"

    def _check(self) -> None:
        _check_functions(self, {"value": self.value, "gradient": self.gradient}, {"hessian": self.hessian})

    def describe(self) -> str:
        return "potential given in Python" + ("" if self.hessian is not None else ", without its Hessian")


@dataclass(frozen=True, eq=False)
class UserForce(Element):
    """function(t, q, v) -> (nv,) [N; N m]; derivatives(t, q, v) -> (df_dq, df_dv), (nv, nv) each, or None."""

    function: Any
    derivatives: Any = None
    check: bool = True
    kind: ClassVar[str] = "force"

    def _check(self) -> None:
        _check_functions(self, {"function": self.function}, {"derivatives": self.derivatives})

    def describe(self) -> str:
        return "force given in Python" + ("" if self.derivatives is not None else ", without its derivatives")


def _check_functions(element: Element, needed: Mapping[str, Any], optional: Mapping[str, Any]) -> None:
    for argument, value in (*needed.items(), *((k, v) for k, v in optional.items() if v is not None)):
        if not callable(value):
            raise InputError(
                f"Argument {argument} of {element.name!r}",
                name=argument,
                expected="a function",
                got=short(value),
                remedy="Give the function itself, without calling it",
            )
