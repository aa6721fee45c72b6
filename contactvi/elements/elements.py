"""What acts on a scene besides contacts and joint settings: constraints, springs, wrenches, functions of the user.

Each is a constant, checked when it is made (InputError), and refers to bodies and joints by name; contactvi.scene
resolves the names in a model. A body is named by its frame, "world" is the ground. Points [m] and placements are in the
frames of their bodies. What is None is taken as it is in the neutral configuration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from contactvi.elements.pose_signals import PoseSignal
from contactvi.elements.signals import Signal
from contactvi.errors import InputError
from contactvi.inputs import flag, pose, real, short, vector

WORLD = "world"
AXES = ("world", "body")


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


@dataclass(frozen=True, eq=False)
class Constraint(Element):
    """Base of the constraints phi(q, t) = 0. `engine_kind`: the engine's name, `rows`: number of equations."""

    engine_kind: ClassVar[str] = ""
    rows: ClassVar[int] = 1


@dataclass(frozen=True, eq=False)
class PointConstraint(Constraint):
    """A point of body b coincides with a point of body a: a ball joint, 3 rows."""

    a: str
    b: str
    point_a: Any = (0.0, 0.0, 0.0)
    point_b: Any = None
    kind: ClassVar[str] = "point"
    engine_kind: ClassVar[str] = "point"
    rows: ClassVar[int] = 3

    def _check(self) -> None:
        _check_ends(self, self.a, self.b)
        self._put(point_a=_point(self, "point_a", self.point_a))
        self._put(point_b=None if self.point_b is None else _point(self, "point_b", self.point_b))

    def describe(self) -> str:
        return f"constraint: a point of {self.b!r} at one of {self.a!r}"


@dataclass(frozen=True, eq=False)
class DistanceConstraint(Constraint):
    """Two points have the distance `length` [m] > 0, a Signal or None; 1 row."""

    a: str
    b: str
    point_a: Any = (0.0, 0.0, 0.0)
    point_b: Any = (0.0, 0.0, 0.0)
    length: Any = None
    kind: ClassVar[str] = "distance"
    engine_kind: ClassVar[str] = "distance"

    def _check(self) -> None:
        _check_ends(self, self.a, self.b)
        self._put(point_a=_point(self, "point_a", self.point_a), point_b=_point(self, "point_b", self.point_b))
        if self.length is None:
            return
        length = Signal(self.length, f"length of {self.name!r}")
        if length.constant is not None:
            real(f"length of {self.name!r}", length.constant, 0.0, open_low=True)
        self._put(length=length)

    def describe(self) -> str:
        driven = self.length is not None and self.length.constant is None
        return f"constraint: {'driven' if driven else 'constant'} distance of points of {self.a!r} and {self.b!r}"


@dataclass(frozen=True, eq=False)
class WeldConstraint(Constraint):
    """Body b has a fixed `placement` (pin.SE3) in body a; 6 rows."""

    a: str
    b: str
    placement: Any = None
    kind: ClassVar[str] = "weld"
    engine_kind: ClassVar[str] = "weld"
    rows: ClassVar[int] = 6

    def _check(self) -> None:
        _check_ends(self, self.a, self.b)
        if self.placement is not None:
            self._put(placement=pose(f"placement of {self.name!r}", self.placement))

    def describe(self) -> str:
        return f"constraint: {self.b!r} fixed to {self.a!r}"


@dataclass(frozen=True, eq=False)
class ScrewConstraint(Constraint):
    """The z axes of two frames coincide, and body b is displaced along z by `pitch` [m/rad] times its angle; 5 rows."""

    a: str
    b: str
    pitch: float = 0.0
    frame_a: Any = None
    frame_b: Any = None
    kind: ClassVar[str] = "screw"
    engine_kind: ClassVar[str] = "screw"
    rows: ClassVar[int] = 5

    def _check(self) -> None:
        _check_ends(self, self.a, self.b)
        self._put(pitch=real(f"pitch of {self.name!r}", self.pitch))
        self._put(frame_a=pose(f"frame_a of {self.name!r}", self.frame_a))
        if self.frame_b is not None:
            self._put(frame_b=pose(f"frame_b of {self.name!r}", self.frame_b))

    def describe(self) -> str:
        what = f"screw of {self.pitch:.4g} m/rad" if self.pitch else "hinge"
        return f"constraint: {what} between {self.a!r} and {self.b!r}"


@dataclass(frozen=True, eq=False)
class EqualityConstraint(Constraint):
    """q_joint = c0 + c1 q_other + c2 q_other^2 + ... of 1-dof joints [rad or m]; 1 row. other None: q_joint = c0."""

    joint: str
    other: str | None
    coefficients: Any = (0.0, 1.0)
    kind: ClassVar[str] = "equality"
    engine_kind: ClassVar[str] = "equality"

    def _check(self) -> None:
        if self.joint == self.other:
            raise InputError(
                f"Constraint {self.name!r}",
                name="other",
                expected="two different joints",
                got=f"{self.joint!r} twice",
                remedy="Name another joint, or leave other out: the joint then keeps a constant value",
            )
        self._put(coefficients=coefficients_of(f"coefficients of {self.name!r}", self.coefficients))

    def value(self, other: float) -> float:
        """Return the value of q_joint that belongs to a value of q_other [rad or m]."""
        return float(np.polynomial.polynomial.polyval(other, self.coefficients))

    def describe(self) -> str:
        terms = [_term(float(c), k, str(self.other)) for k, c in enumerate(self.coefficients) if c]
        return f"constraint: {self.joint} = {' + '.join(terms) or '0'}"


@dataclass(frozen=True, eq=False)
class PrescribedJoint(Constraint):
    """A 1-dof joint follows `motion`, a Signal [rad or m]; 1 row."""

    joint: str
    motion: Any
    kind: ClassVar[str] = "prescribe"
    engine_kind: ClassVar[str] = "prescribed"

    def _check(self) -> None:
        self._put(motion=Signal(self.motion, f"motion of joint {self.joint!r}"))

    def describe(self) -> str:
        return f"constraint: joint {self.joint!r} follows a prescribed motion"


@dataclass(frozen=True, eq=False)
class PrescribedPose(Constraint):
    """A body follows `motion`, a PoseSignal, in the world; 6 rows."""

    body: str
    motion: Any
    kind: ClassVar[str] = "prescribe_pose"
    engine_kind: ClassVar[str] = "pose"
    rows: ClassVar[int] = 6

    def _check(self) -> None:
        self._put(motion=PoseSignal(self.motion, f"motion of {self.body!r}"))

    def describe(self) -> str:
        return f"constraint: {self.body!r} follows a prescribed motion in the world"


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
        self._put(point=_point(self, "point", self.point))
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
        _functions(self, {"value": self.value, "gradient": self.gradient}, {"hessian": self.hessian})

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
        _functions(self, {"function": self.function}, {"derivatives": self.derivatives})

    def describe(self) -> str:
        return "force given in Python" + ("" if self.derivatives is not None else ", without its derivatives")


KINDS: dict[str, type[Element]] = {
    cls.kind: cls
    for cls in (
        *(PointConstraint, DistanceConstraint, WeldConstraint, ScrewConstraint, EqualityConstraint),
        *(PrescribedJoint, PrescribedPose),
        *(PathSpring, Wrench),
    )
}


def element_from_data(data: Mapping[str, Any]) -> Element:
    """Return the element of `Element.to_data`."""
    values = dict(data)
    cls = KINDS[values.pop("kind")]
    for name in ("placement", "frame_a", "frame_b"):
        if values.get(name) is not None:
            values[name] = np.array(values[name], dtype=float).reshape(4, 4)
    return cls(**values)


def coefficients_of(name: str, value: Any) -> np.ndarray:
    """Return polynomial coefficients, lowest power first, shape (n,), n >= 1."""
    listed = isinstance(value, Sequence) or (isinstance(value, np.ndarray) and value.ndim == 1)
    count = len(value) if listed and not isinstance(value, str) else 0
    if count == 0:
        raise InputError(
            f"Value of {name}",
            name=name,
            expected="a list of numbers",
            got=short(value),
            remedy="Write the coefficients in a list, lowest power first: [0.0, 1.0]",
        )
    return vector(name, value, count)


def _check_ends(element: Element, a: str, b: str) -> None:
    if a == b:
        raise InputError(
            f"Constraint {element.name!r}",
            name="b",
            expected="two different bodies",
            got=f"{a!r} twice",
            remedy="Name another body as b, or 'world'",
        )


def _point(element: Element, argument: str, value: Any) -> np.ndarray:
    return vector(f"{argument} of {element.name!r}", value, 3)


def _functions(element: Element, needed: Mapping[str, Any], optional: Mapping[str, Any]) -> None:
    for argument, value in (*needed.items(), *((k, v) for k, v in optional.items() if v is not None)):
        if not callable(value):
            raise InputError(
                f"Argument {argument} of {element.name!r}",
                name=argument,
                expected="a function",
                got=short(value),
                remedy="Give the function itself, without calling it",
            )


def _term(factor: float, power: int, name: str) -> str:
    return f"{factor:.4g}" + ("" if power == 0 else f" {name}" if power == 1 else f" {name}^{power}")


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
