"""The elements of a scene for the oracle of constrained motion: oracles.forced, oracles.constraints."""

from __future__ import annotations

import pinocchio as pin

import contactvi as cvi
from contactvi.elements.constraints import (
    DistanceConstraint,
    EqualityConstraint,
    PointConstraint,
    PrescribedJoint,
    ScrewConstraint,
    WeldConstraint,
)
from contactvi.elements.forces import PathSpring, Wrench
from oracles import constraints as exact
from oracles import forced


class Translator:
    """Turns elements into oracle constraints and forces, on scene.model. Open rest lengths are those of `neutral`."""

    def __init__(self, scene: cvi.Scene) -> None:
        self.model = scene.model
        self.neutral = exact.Motion(self.model, scene.neutral())
        self.constraints: list[exact.Constraint] = []
        self.forces: list[forced.Force] = []
        for element in scene.elements:
            getattr(self, f"_{element.kind}")(element)

    def _frame(self, body: str) -> tuple[int, pin.SE3]:
        if body == "world":
            return 0, pin.SE3.Identity()
        frame = self.model.frames[self.model.getFrameId(body, pin.FrameType.BODY)]
        return int(frame.parentJoint), frame.placement

    def place(self, body: str, point) -> exact.Place:
        joint, frame = self._frame(body)
        return joint, frame.act(point)

    def _point(self, e: PointConstraint) -> None:
        self.constraints.append(exact.Point(self.place(e.a, e.point_a), self.place(e.b, e.point_b)))

    def _distance(self, e: DistanceConstraint) -> None:
        ends = self.place(e.a, e.point_a), self.place(e.b, e.point_b)
        self.constraints.append(exact.distance(*ends, e.length))

    def _weld(self, e: WeldConstraint) -> None:
        (a, in_a), (b, in_b) = self._frame(e.a), self._frame(e.b)
        self.constraints.append(exact.Weld(a, in_a * e.placement, b, in_b))

    def _screw(self, e: ScrewConstraint) -> None:
        (a, in_a), (b, in_b) = self._frame(e.a), self._frame(e.b)
        self.constraints.append(exact.Screw(a, in_a * e.frame_a, b, in_b * e.frame_b, e.pitch))

    def _equality(self, e: EqualityConstraint) -> None:
        joint, other = self.model.getJointId(e.joint), self.model.getJointId(e.other)
        self.constraints.append(exact.JointPolynomial(joint, other, list(e.coefficients)))

    def _prescribe(self, e: PrescribedJoint) -> None:
        self.constraints.append(exact.Prescribed(self.model.getJointId(e.joint), e.motion))

    def _spring(self, e: PathSpring) -> None:
        places = [self.place(body, point) for body, point in e.points]
        rest = float(self.neutral.length(places).value[0]) if e.rest_length is None else e.rest_length
        self.forces.append(forced.PathSpring(places, e.stiffness, rest, e.tension_only))
        self.forces.append(forced.PathDamper(places, e.damping))

    def _wrench(self, e: Wrench) -> None:
        def in_time(value):
            return value if callable(value) else lambda _t: (0.0, 0.0, 0.0) if value is None else value

        at = self.place(e.body, e.point)
        self.forces.append(forced.Wrench(at, in_time(e.force), in_time(e.torque), e.axes == "body"))
