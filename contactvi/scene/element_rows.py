"""Elements by name as the engine takes them: frames, numbers and checked functions of a complete model.

A frame is (joint, R, p): joint index in the model (0: world), R (3, 3) and p (3,) [m] in that joint's frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from contactvi.elements.constraints import (
    Constraint,
    DistanceConstraint,
    EqualityConstraint,
    PointConstraint,
    PrescribedJoint,
    PrescribedPose,
    ScrewConstraint,
    WeldConstraint,
)
from contactvi.elements.element import WORLD, Element
from contactvi.elements.forces import PathSpring, UserForce, UserPotential, Wrench
from contactvi.elements.pose_signals import PoseSignal
from contactvi.elements.signals import Signal
from contactvi.elements.user_functions import at, checked_wrench
from contactvi.errors import InputError, UserFunctionError
from contactvi.importing.couplings import Couplings, find_couplings
from contactvi.importing.kinematics import joint_placements
from contactvi.inputs import real
from contactvi.scene.compliance import ComplianceRow

Frame = tuple[int, np.ndarray, np.ndarray]
_LEAST_LENGTH = 1e-9  # [m] distance below which there is no direction


@dataclass(frozen=True)
class ConstraintRow:
    """A constraint as the engine takes it; `name`, `kind` (of the element) and `rows` are for the Python API."""

    name: str
    kind: str
    rows: int
    engine_kind: str
    a: Frame
    b: Frame
    numbers: np.ndarray
    signal: Signal | Callable[[float], Any] | None = None
    pose: PoseSignal | None = None  # of a weld to the world: the frame of the world moves
    coupled: bool = False  # a linear equality that is a coordinate of the engine (contactvi.importing.couplings)

    @property
    def driven(self) -> bool:
        """Whether it depends on time."""
        return self.signal is not None or self.pose is not None


class SpringRow(NamedTuple):
    """A spring and damper as the engine takes it: along points (n, 3) [m] in the frames of joints (n,)."""

    joints: list[int]
    points: np.ndarray
    stiffness: float  # [N/m]
    rest_length: float  # [m]
    damping: float  # [N s/m]
    tension_only: bool


class WrenchRow(NamedTuple):
    """A wrench as the engine takes it: at a point (3,) [m] in a joint's frame."""

    joint: int
    point: np.ndarray
    axes: np.ndarray | None  # rotation of the axes in the joint's frame, (3, 3); None: world axes
    wrench: np.ndarray | Callable[[float], np.ndarray]  # force, torque (6,) [N, N m], or a function of t [s]


@dataclass
class Resolved:
    """The elements of a complete scene.

    Attributes:
        dofs: Names of the degrees of freedom, (nv,).
        couplings: Joints that follow others, which some of the constraints are.
        compliances: The compliant pairs, which are no elements but act as springs do.
    """

    dofs: list[str]
    constraints: list[ConstraintRow] = field(default_factory=list)
    springs: list[SpringRow] = field(default_factory=list)
    wrenches: list[WrenchRow] = field(default_factory=list)
    potentials: list[UserPotential] = field(default_factory=list)
    forces: list[UserForce] = field(default_factory=list)
    couplings: Couplings = field(default_factory=Couplings)
    compliances: list[ComplianceRow] = field(default_factory=list)

    @property
    def equations(self) -> list[ConstraintRow]:
        """The constraints that steps solve for: those that are no couplings of joints."""
        return [row for row in self.constraints if not row.coupled]

    @property
    def any(self) -> bool:
        """Whether there is any element, or compliant pair."""
        forces = self.springs or self.wrenches or self.potentials or self.forces or self.compliances
        return bool(self.constraints or forces)


def resolve(elements: Sequence[Element], model: pin.Model, start: np.ndarray) -> Resolved:
    """Return the elements with what is None taken from the neutral configuration `start`, shape (nq,).

    Raises:
        InputError: lengths or placements that the neutral configuration does not give.
    """
    result = Resolved(dof_names(model))
    if not elements:
        return result
    placed = _Placed(model, start)
    result.couplings = find_couplings(model, start, elements)
    for element in elements:
        if isinstance(element, Constraint):
            rows = _constraint(element, placed)
            if element.name in result.couplings.names:
                rows = replace(rows, coupled=True)
            result.constraints.append(rows)
        elif isinstance(element, PathSpring):
            joints, points = zip(*(placed.point(body, xyz) for body, xyz in element.points), strict=True)
            length = placed.length(element.points) if element.rest_length is None else element.rest_length
            numbers = (element.stiffness, length, element.damping, element.tension_only)
            result.springs.append(SpringRow(list(joints), np.array(points), *numbers))
        elif isinstance(element, Wrench):
            joint, point = placed.point(element.body, element.point)
            axes = None if element.axes == "world" else placed.body(element.body)[1]
            wrench = checked_wrench(element.force, element.torque, element.name)
            result.wrenches.append(WrenchRow(joint, point, axes, wrench))
        elif isinstance(element, UserPotential):
            result.potentials.append(element)
        elif isinstance(element, UserForce):
            result.forces.append(element)
    return result


def dof_names(model: pin.Model) -> list[str]:
    """Return a name for each degree of freedom, (nv,): that of its joint, with a number where it has several."""
    names: list[str] = []
    for i in range(1, model.njoints):
        count = int(model.nvs[i])
        names += [model.names[i] if count == 1 else f"{model.names[i]}[{k}]" for k in range(count)]
    return names


class _Placed:
    """Bodies of a model at the neutral configuration."""

    def __init__(self, model: pin.Model, start: np.ndarray) -> None:
        self.model, self.start = model, start

    @cached_property
    def joints(self) -> list[pin.SE3]:
        """Where the joints are."""
        return joint_placements(self.model, self.start)

    def body(self, name: str) -> Frame:
        if name == WORLD:
            return 0, np.eye(3), np.zeros(3)
        frame = self.model.frames[self.model.getFrameId(name, pin.FrameType.BODY)]
        return int(frame.parentJoint), np.array(frame.placement.rotation), np.array(frame.placement.translation)

    def frame(self, name: str, placement: pin.SE3 | None = None) -> Frame:
        """Return a frame of a body; `placement` in the body's."""
        joint, R, p = self.body(name)
        place = pin.SE3(R, p) * (pin.SE3.Identity() if placement is None else placement)
        return joint, np.array(place.rotation), np.array(place.translation)

    def point(self, name: str, xyz: Any) -> tuple[int, np.ndarray]:
        joint, R, p = self.body(name)
        return joint, p + R @ np.asarray(xyz)

    def world(self, name: str) -> pin.SE3:
        """Return where a body is at neutral."""
        joint, R, p = self.body(name)
        return self.joints[joint] * pin.SE3(R, p)

    def length(self, points: Sequence[tuple[str, Any]]) -> float:
        places = [self.world(body).act(np.asarray(xyz)) for body, xyz in points]
        length = sum(math.dist(a, b) for a, b in zip(places[:-1], places[1:], strict=True))  # which squares nothing
        return real("the distance of points in the neutral configuration", length, 0.0)

    def joint(self, name: str | None) -> Frame:
        return 0 if name is None else int(self.model.getJointId(name)), np.eye(3), np.zeros(3)


def _constraint(element: Constraint, placed: _Placed) -> ConstraintRow:
    a, b, numbers, signal = _ends(element, placed)
    values = np.atleast_1d(np.asarray(numbers, dtype=float))
    # A joint that equals a number follows a constant motion.
    engine_kind = "prescribed" if signal is not None and element.kind == "equality" else element.engine_kind
    pose = element.motion if isinstance(element, PrescribedPose) else None
    return ConstraintRow(element.name, element.kind, element.rows, engine_kind, a, b, values, signal, pose)


def _ends(element: Constraint, placed: _Placed) -> tuple[Frame, Frame, Any, Any]:
    """Return frames, numbers and signal of a constraint."""
    if isinstance(element, EqualityConstraint):
        if element.other is None:
            return placed.joint(None), placed.joint(element.joint), [], Signal(element.value(0.0), element.name)
        return placed.joint(element.other), placed.joint(element.joint), element.coefficients, None
    if isinstance(element, PrescribedJoint):
        return placed.joint(None), placed.joint(element.joint), [], element.motion
    if isinstance(element, PrescribedPose):
        return placed.frame(WORLD), placed.frame(element.body), [], None
    if isinstance(element, PointConstraint):
        point_b = element.point_b
        if point_b is None:
            point_b = placed.world(element.b).actInv(placed.world(element.a).act(element.point_a))
        return _at(placed, element.a, element.point_a), _at(placed, element.b, point_b), [], None
    if isinstance(element, DistanceConstraint):
        ends = _at(placed, element.a, element.point_a), _at(placed, element.b, element.point_b)
        number, signal = _length(element, placed)
        return *ends, number, signal
    if isinstance(element, WeldConstraint):
        place = element.placement
        if place is None:
            place = placed.world(element.a).actInv(placed.world(element.b))
        return placed.frame(element.a, place), placed.frame(element.b), [], None
    assert isinstance(element, ScrewConstraint)
    frame_b = element.frame_b
    if frame_b is None:
        frame_b = placed.world(element.b).actInv(placed.world(element.a) * element.frame_a)
    return placed.frame(element.a, element.frame_a), placed.frame(element.b, frame_b), [element.pitch, 0.0], None


def _at(placed: _Placed, body: str, xyz: Any) -> Frame:
    joint, point = placed.point(body, xyz)
    return joint, np.eye(3), point


def _length(element: DistanceConstraint, placed: _Placed) -> tuple[list[float], Any]:
    if element.length is None:
        length = placed.length([(element.a, element.point_a), (element.b, element.point_b)])
        if length < _LEAST_LENGTH:
            raise InputError(
                f"The two points of {element.name!r} lie on each other in the neutral configuration",
                name="length",
                expected="a distance > 0",
                got=f"{length:.3g} m",
                remedy="Give length=..., or join the points by add_point",
            )
        return [length], None
    if element.length.constant is not None:
        return [element.length.constant], None
    return [], _positive_length(element.length)


def _positive_length(length: Signal) -> Callable[[float], tuple[float, float, float]]:
    def positive(t: float) -> tuple[float, float, float]:
        value = length(t)
        if value[0] <= 0.0:
            raise UserFunctionError(
                f"{length.name} is not positive{at(t)}",
                function=length.name,
                time=t,
                entry="value",
                expected="a length > 0 m",
                got=f"{value[0]:.9g} m",
                remedy=f"Let {length.name} stay above 0, or join the points by add_point",
            )
        return value

    return positive
