"""Constraints between bodies and of joints: points, distances, welds, screws, equalities, prescribed motions.

Each is a constant, checked when it is made (InputError), and refers to bodies and joints by name; contactvi.scene
resolves the names in a model. A body is named by its frame, "world" is the ground. Points [m] and placements are in the
frames of their bodies. What is None is taken as it is in the neutral configuration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from contactvi.elements.element import Element, point_of
from contactvi.elements.pose_signals import PoseSignal
from contactvi.elements.signals import Signal
from contactvi.errors import InputError
from contactvi.inputs import pose, real, short, vector


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
        self._put(point_a=point_of(self, "point_a", self.point_a))
        self._put(point_b=None if self.point_b is None else point_of(self, "point_b", self.point_b))

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
        self._put(point_a=point_of(self, "point_a", self.point_a), point_b=point_of(self, "point_b", self.point_b))
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


def _term(factor: float, power: int, name: str) -> str:
    return f"{factor:.4g}" + ("" if power == 0 else f" {name}" if power == 1 else f" {name}^{power}")
