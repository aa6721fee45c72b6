"""Constraints, springs, forces and motions, which are added to a scene by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from contactvi.elements.constraints import (
    DistanceConstraint,
    EqualityConstraint,
    PointConstraint,
    PrescribedJoint,
    PrescribedPose,
    ScrewConstraint,
    WeldConstraint,
)
from contactvi.elements.element import Element
from contactvi.elements.forces import PathSpring, UserForce, UserPotential, Wrench
from contactvi.errors import InputError
from contactvi.inputs import flag, short
from contactvi.keywords import refusing_methods
from contactvi.scene.build import Built
from contactvi.scene.driven import driven_by
from contactvi.scene.element_list import ElementList
from contactvi.scene.joints import one_number
from contactvi.scene.notes import noted
from contactvi.scene.parts import PartList
from contactvi.scene.selection import Selector


@refusing_methods
@noted
class SceneElements:
    """The methods of a scene that add and remove elements (contactvi.elements).

    Each returns the name of what it adds, given or its kind with a number.
    """

    _parts: PartList
    _elements: ElementList
    _built: Built | None

    def add_point(
        self,
        a: Selector,
        b: Selector,
        point_a: ArrayLike = (0.0, 0.0, 0.0),
        point_b: ArrayLike | None = (0.0, 0.0, 0.0),
        name: str | None = None,
    ) -> str:
        """Join a point of body a and one of body b (a ball joint, 3 constraints); return its name.

        point_b None: the point of b that lies at point_a in the neutral configuration.
        """
        ends = self._body(a, "a"), self._body(b, "b")
        return self._add_element(PointConstraint(self._name("point", name), *ends, point_a, point_b))

    def add_distance(
        self,
        a: Selector,
        b: Selector,
        point_a: ArrayLike = (0.0, 0.0, 0.0),
        point_b: ArrayLike = (0.0, 0.0, 0.0),
        length: Any = None,
        name: str | None = None,
    ) -> str:
        """Keep the distance of two points (a rod without mass, 1 constraint); return its name.

        Args:
            length: [m] > 0, or a motion as in `prescribe` (a winch); None: as in the neutral configuration.
        """
        ends = self._body(a, "a"), self._body(b, "b")
        return self._add_element(DistanceConstraint(self._name("distance", name), *ends, point_a, point_b, length))

    def add_weld(self, a: Selector, b: Selector, placement: Any = None, name: str | None = None) -> str:
        """Fix body b to body a (6 constraints); return its name. placement: of b in a, as in add_urdf."""
        ends = self._body(a, "a"), self._body(b, "b")
        return self._add_element(WeldConstraint(self._name("weld", name), *ends, placement))

    def add_screw(
        self,
        a: Selector,
        b: Selector,
        pitch: float,
        frame_a: Any = None,
        frame_b: Any = None,
        name: str | None = None,
    ) -> str:
        """Make b a nut on a screw of a (5 constraints; pitch 0: a hinge); return its name.

        The z axes of the two frames coincide, and b is displaced along z by pitch [m/rad] times its turn about z.

        Args:
            frame_a, frame_b: placements in the bodies, as in add_urdf; None: the frame of body a, and where that is in
                b in the neutral configuration.
        """
        ends = self._body(a, "a"), self._body(b, "b")
        return self._add_element(ScrewConstraint(self._name("screw", name), *ends, pitch, frame_a, frame_b))

    def add_joint_equality(
        self,
        joint: Selector,
        other: Selector | None,
        coefficients: ArrayLike = (0.0, 1.0),
        name: str | None = None,
    ) -> str:
        """Make a joint follow another one: q_joint = c0 + c1 q_other + c2 q_other^2 + ...; return the name.

        Of revolute, prismatic or helical joints [rad or m]; other None: q_joint = c0. `neutral()` puts the joint where
        it has to be. Of degree one the two joints are one coordinate of the engine, and no step solves for their
        reaction.
        """
        first = self._joint_with_one_number(joint, "equality")
        second = None if other is None else self._joint_with_one_number(other, "equality")
        return self._add_element(EqualityConstraint(self._name("equality", name), first, second, coefficients))

    def prescribe(self, joint: Selector, motion: Any, name: str | None = None) -> str:
        """Let a joint, or a body, follow a motion exactly, whatever force it takes; return the name.

        Args:
            joint: with one degree of freedom; or a body, a free joint or a part with a free base, whose body
                then follows a pose (6 constraints). Its joint stays, and q, v and contacts are as without the motion.
            motion: of a joint [rad or m], one of: a number; (times, values), through which a spline with continuous
                acceleration goes (the run must lie within its times); a function t -> value, (value, rate) or (value,
                rate, acceleration), of which the missing ones are found by differences; a spline of scipy.interpolate.
                Of a body, its frame in the world: a placement (as in add_urdf, or (xyz, quaternion xyzw)); (times,
                poses), through which smooth curves of positions and rotations go; a function t -> pose, or (pose,
                velocity) with velocity (linear, angular) in world axes (contactvi.elements.pose_signals).

        `Trajectory.reactions(name)` is the force or torque of the motion; of a body the wrench on it (6,): force [N],
        then torque about its origin [N m], in the axes that it has.
        """
        driven = driven_by(self._parts.assembly.model, self._parts.names, joint)
        if driven.body is not None:
            return self._add_element(PrescribedPose(self._name("prescribe", name), driven.body, motion))
        assert driven.joint is not None
        return self._add_element(PrescribedJoint(self._name("prescribe", name), driven.joint, motion))

    def add_spring(
        self,
        a: Selector,
        b: Selector,
        stiffness: float,
        *,
        rest_length: float | None = None,
        damping: float = 0.0,
        point_a: ArrayLike = (0.0, 0.0, 0.0),
        point_b: ArrayLike = (0.0, 0.0, 0.0),
        tension_only: bool = False,
        name: str | None = None,
    ) -> str:
        """Put a spring and damper between two points; return its name.

        stiffness [N/m], rest_length [m] (None: as in the neutral configuration), damping [N s/m]; tension_only: a rope,
        which does nothing while it is shorter than its rest length.
        """
        points = [(self._body(a, "a"), point_a), (self._body(b, "b"), point_b)]
        return self._add_element(
            PathSpring(self._name("spring", name), points, stiffness, rest_length, damping, tension_only)
        )

    def add_tape_spring(
        self,
        points: Sequence[tuple[Selector, ArrayLike]],
        stiffness: float,
        *,
        rest_length: float | None = None,
        damping: float = 0.0,
        tension_only: bool = False,
        name: str | None = None,
    ) -> str:
        """Put a spring along a line through points ((body, xyz), ...), such as a tendon; the rest as in add_spring."""
        try:
            along = [(self._body(body, "points"), xyz) for body, xyz in points]
        except (TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                "Argument points",
                name="points",
                expected='[("body", (x, y, z)), ...]',
                got=short(points),
                remedy="Write each point as (name of the body, (x, y, z)), in the axes of the body",
            ) from None
        return self._add_element(
            PathSpring(self._name("tape_spring", name), along, stiffness, rest_length, damping, tension_only)
        )

    def add_wrench(
        self,
        body: Selector,
        force: Any = None,
        torque: Any = None,
        point: ArrayLike = (0.0, 0.0, 0.0),
        axes: str = "world",
        name: str | None = None,
    ) -> str:
        """Let a force [N] and a torque [N m] act on a body at a point of it; return the name.

        Args:
            force, torque: (3,), or functions t -> (3,).
            axes: of force and torque, "world" or "body".
        """
        return self._add_element(
            Wrench(self._name("wrench", name), self._body(body, "body"), force, torque, point, axes)
        )

    def add_potential(
        self, value: Any, gradient: Any = None, hessian: Any = None, *, check: bool = True, name: str | None = None
    ) -> str:
        """Add a potential energy given by Python functions; return its name.

        Args:
            value: function q (nq,) -> energy [J]; or an object with methods value, gradient and perhaps hessian.
            gradient: function q -> (nv,), its derivative in the tangent space at q (Pinocchio's v).
            hessian: function q -> (nv, nv), the derivative of the gradient; makes stiff potentials solvable.
            check: compare the derivatives with differences at the start of the first run (DerivativeError).
        """
        if not callable(value) and gradient is None and hasattr(value, "value"):
            value, gradient, hessian = value.value, getattr(value, "gradient", None), getattr(value, "hessian", None)
        return self._add_element(
            UserPotential(self._name("potential", name), value, gradient, hessian, flag("check", check))
        )

    def add_force(self, function: Any, derivatives: Any = None, *, check: bool = True, name: str | None = None) -> str:
        """Add generalized forces given by a Python function; return the name.

        Args:
            function: (t, q (nq,), v (nv,)) -> (nv,) [N; N m], Pinocchio's coordinates.
            derivatives: (t, q, v) -> (df_dq, df_dv), (nv, nv) each, in the tangent space; for stiff forces.
            check: as in add_potential.
        """
        return self._add_element(UserForce(self._name("force", name), function, derivatives, flag("check", check)))

    def remove(self, name: str) -> None:
        """Remove an element."""
        self._elements.remove(name)
        self._built = None

    @property
    def elements(self) -> list[Element]:
        """Constraints, springs and forces, those of models' files included, in the order they were added."""
        return list(self._elements.elements)

    def _name(self, kind: str, name: str | None) -> str:
        return self._elements.new_name(kind, name)

    def _add_element(self, element: Element) -> str:
        self._elements.add(element)
        self._built = None
        return element.name

    def _body(self, selector: Selector, argument: str) -> str:
        return self._parts.names.select_body(selector, argument)

    def _joint_with_one_number(self, selector: Selector, what: str) -> str:
        name = self._parts.names.select_joint(selector)
        one_number(self._parts.assembly.model, name, what)
        return name
