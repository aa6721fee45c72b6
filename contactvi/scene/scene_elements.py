"""What the user adds to a scene beyond models: constraints, springs, forces, servos, and what follows from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from contactvi.checks import States
from contactvi.elements import elements as kinds
from contactvi.errors import InputError, did_you_mean
from contactvi.inputs import flag, real, short, vector
from contactvi.scene import closure as loops
from contactvi.scene.build import Built, engine_scene
from contactvi.scene.data import target_name
from contactvi.scene.joints import JointSettings, joint_settings, one_number, servo_settings
from contactvi.scene.scene_parts import SceneParts
from contactvi.scene.selection import Selector


class SceneElements(SceneParts):
    """The elements of a scene. Bodies: a name, a handle, or "world"; points [m] and frames are in the bodies' frames.

    Each element has a name, given or its kind with a number, which is returned. What is None is taken as it is in the
    neutral configuration when the scene is run. All raise InputError for bad values and unknown names.
    """

    def add_point(
        self,
        a: Selector,
        b: Selector,
        point_a: Sequence[float] = (0.0, 0.0, 0.0),
        point_b: Sequence[float] | None = (0.0, 0.0, 0.0),
        name: str | None = None,
    ) -> str:
        """Join a point of body a and one of body b (a ball joint, 3 constraints); return its name.

        point_b None: the point of b that lies at point_a in the neutral configuration.
        """
        ends = self._body(a, "a"), self._body(b, "b")
        return self._put(kinds.PointConstraint(self._name("point", name), *ends, point_a, point_b))

    def add_distance(
        self,
        a: Selector,
        b: Selector,
        point_a: Sequence[float] = (0.0, 0.0, 0.0),
        point_b: Sequence[float] = (0.0, 0.0, 0.0),
        length: Any = None,
        name: str | None = None,
    ) -> str:
        """Keep the distance of two points (a rod without mass, 1 constraint); return its name.

        Args:
            length: [m] > 0, or a motion as in `prescribe` (a winch); None: as in the neutral configuration.
        """
        ends = self._body(a, "a"), self._body(b, "b")
        return self._put(kinds.DistanceConstraint(self._name("distance", name), *ends, point_a, point_b, length))

    def add_weld(self, a: Selector, b: Selector, placement: Any = None, name: str | None = None) -> str:
        """Fix body b to body a (6 constraints); return its name. placement: of b in a, as in add_urdf."""
        ends = self._body(a, "a"), self._body(b, "b")
        return self._put(kinds.WeldConstraint(self._name("weld", name), *ends, placement))

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
        return self._put(kinds.ScrewConstraint(self._name("screw", name), *ends, pitch, frame_a, frame_b))

    def add_joint_equality(
        self,
        joint: Selector,
        other: Selector | None,
        coefficients: Sequence[float] = (0.0, 1.0),
        name: str | None = None,
    ) -> str:
        """Make a joint follow another one: q_joint = c0 + c1 q_other + c2 q_other^2 + ...; return the name.

        Of revolute, prismatic or helical joints [rad or m]; other None: q_joint = c0. `neutral()` puts the joint where
        it has to be.
        """
        first = self._joint_with_one_number(joint, "equality")
        second = None if other is None else self._joint_with_one_number(other, "equality")
        return self._put(kinds.EqualityConstraint(self._name("equality", name), first, second, coefficients))

    def prescribe(self, joint: Selector, motion: Any, name: str | None = None) -> str:
        """Let a joint with one degree of freedom follow a motion exactly, whatever force it takes; return the name.

        Args:
            motion: [rad or m], one of: a number; (times, values), through which a spline with continuous acceleration
                goes (the run must lie within its times); a function t -> value, (value, rate) or (value, rate,
                acceleration), of which the missing ones are found by differences; a spline of scipy.interpolate.
        """
        (index,) = self._joints(joint, 1)
        model = self._assembled()[0].model
        if model.nvs[model.getJointId(index)] != 1:
            raise InputError(
                f"A motion of joint {index!r}",
                name="joint",
                expected="a joint with one degree of freedom",
                got=f"{model.nvs[model.getJointId(index)]} degrees of freedom",
                remedy="Use add_weld or add_distance for free bodies",
            )
        return self._put(kinds.PrescribedJoint(self._name("prescribe", name), index, motion))

    def add_spring(
        self,
        a: Selector,
        b: Selector,
        stiffness: float,
        *,
        rest_length: float | None = None,
        damping: float = 0.0,
        point_a: Sequence[float] = (0.0, 0.0, 0.0),
        point_b: Sequence[float] = (0.0, 0.0, 0.0),
        tension_only: bool = False,
        name: str | None = None,
    ) -> str:
        """Put a spring and damper between two points; return its name.

        stiffness [N/m], rest_length [m] (None: as in the neutral configuration), damping [N s/m]; tension_only: a rope,
        which does nothing while it is shorter than its rest length.
        """
        points = [(self._body(a, "a"), point_a), (self._body(b, "b"), point_b)]
        return self._put(
            kinds.PathSpring(self._name("spring", name), points, stiffness, rest_length, damping, tension_only)
        )

    def add_tape_spring(
        self,
        points: Sequence[tuple[Selector, Sequence[float]]],
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
                "Argument points", name="points", expected='[("body", (x, y, z)), ...]', got=repr(points)
            ) from None
        return self._put(
            kinds.PathSpring(self._name("tape_spring", name), along, stiffness, rest_length, damping, tension_only)
        )

    def add_wrench(
        self,
        body: Selector,
        force: Any = None,
        torque: Any = None,
        point: Sequence[float] = (0.0, 0.0, 0.0),
        axes: str = "world",
        name: str | None = None,
    ) -> str:
        """Let a force [N] and a torque [N m] act on a body at a point of it; return the name.

        Args:
            force, torque: (3,), or functions t -> (3,).
            axes: theirs, "world" or "body".
        """
        return self._put(kinds.Wrench(self._name("wrench", name), self._body(body), force, torque, point, axes))

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
        return self._put(
            kinds.UserPotential(self._name("potential", name), value, gradient, hessian, flag("check", check))
        )

    def add_force(self, function: Any, derivatives: Any = None, *, check: bool = True, name: str | None = None) -> str:
        """Add generalized forces given by a Python function; return the name.

        Args:
            function: (t, q (nq,), v (nv,)) -> (nv,) [N; N m], Pinocchio's coordinates.
            derivatives: (t, q, v) -> (df_dq, df_dv), (nv, nv) each, in the tangent space; for stiff forces.
            check: as in add_potential.
        """
        return self._put(kinds.UserForce(self._name("force", name), function, derivatives, flag("check", check)))

    def remove(self, name: str) -> None:
        """Take an element out again."""
        known = [element.name for element in self._edits.elements] + list(self._edits.missing)
        if not isinstance(name, str) or name not in known:
            raise InputError(
                "Unknown element", name="name", expected="an element of the scene", got=short(name),
                remedy=did_you_mean(str(name), known),
            )  # fmt: skip
        self._edits.elements = [element for element in self._edits.elements if element.name != name]
        self._edits.missing = [missing for missing in self._edits.missing if missing != name]
        self._built = None

    @property
    def elements(self) -> list[kinds.Element]:
        """What was added by the methods above and by models' files, in order."""
        return list(self._edits.elements)

    def set_servo(self, joint: Selector, kp: float, kd: float, effort: float | None = None, target: Any = None) -> None:
        """Drive joints by PD in the engine: torque kp (q_ref - q) + kd (v_ref - v), at most effort. kp = kd = 0: none.

        Args:
            joint: joints with one degree of freedom, by name, pattern or part; continuous ones go the shorter way.
            kp, kd: [N m/rad or N/m], [N m s/rad or N s/m], >= 0. They are implicit in the step and may be stiff.
            effort: largest torque [N m or N]; None: the file's limit, float("inf"): none.
            target: where to when the run says nothing (`simulate(target=)`): a motion as in `prescribe`; None: the
                start.
        """
        model = self._assembled()[0].model
        names = self._joints(joint)
        new = {name: servo_settings(model, name, kp, kd, effort, target) for name in names}
        given = {target_name(name) for name in names}
        self._edits.missing = [missing for missing in self._edits.missing if missing not in given]
        self._update_joints(new)

    def set_actuator(
        self, joint: Selector, effort: bool | float | None = None, velocity: bool | float | None = None
    ) -> None:
        """Limit what inputs do at joints with one degree of freedom; by default nothing is limited.

        effort [N m or N], velocity [rad/s or m/s] : a number, True for the file's limit, False for none. The torque put
        in is cut to +-effort, and may not push a joint beyond +-velocity; that is decided at the start of each step.
        """
        model = self._assembled()[0].model
        names = self._joints(joint)
        self._update_joints({name: joint_settings(model, name, effort=effort, velocity=velocity) for name in names})

    @property
    def servo_joints(self) -> list[str]:
        """The joints with a servo, in the order of v."""
        return self._complete().servo_joints

    def assemble(self, q: Any = None, fixed: Sequence[Selector] | Selector = (), t: float = 0.0) -> np.ndarray:
        """Return the configuration (nq,) near q (nq,) that satisfies the constraints at t [s].

        Args:
            q: where to begin, by default neutral.
            fixed: joints that keep their values. Limits of joints are kept too.

        Raises:
            ConstraintError: there is none near q; it names the constraints that stay open.
        """
        built, start, time = self._complete(), self._state(q), real("t", t)
        dofs = [dof for selector in _several(fixed) for dof in self._dofs(selector)]
        rows = built.elements.constraints
        if not rows:
            return start
        return loops.assemble(engine_scene(built), built.model, rows, start, sorted(set(dofs)), time)

    def consistent_velocity(self, q: Any = None, v: Any = None, t: float = 0.0) -> np.ndarray:
        """Return the velocity (nv,) nearest to v (in the metric of the mass) that goes with the constraints at q.

        Args:
            q: (nq,), by default neutral.
            v: (nv,), by default rest.
            t: [s].

        Raises:
            ConstraintError: where constraints ask for different speeds.
        """
        built, start, time = self._complete(), self._state(q), real("t", t)
        velocity = np.zeros(built.model.nv) if v is None else vector("v", v, built.model.nv)
        if not built.elements.constraints:
            return velocity
        return loops.consistent_velocity(engine_scene(built), built.elements.constraints, start, velocity, time)

    # -- helpers -------------------------------------------------------------------------------------------------------

    def _complete(self) -> Built:
        raise NotImplementedError  # contactvi.scene.scene

    def _state(self, q: Any) -> np.ndarray:
        built = self._complete()
        return built.start.copy() if q is None else States(built.model).configuration(q, "q")

    def _body(self, selector: Selector, argument: str = "body") -> str:
        return self._assembled()[1].select_body(selector, argument)

    def _joints(self, selector: Selector, count: int | None = None) -> list[str]:
        found = self._assembled()[1].select_joints(selector)
        if count is not None and len(found) != count:
            raise InputError(f"Joint {str(selector)!r}", name="joint", expected="one joint", got=f"{len(found)}")
        return found

    def _joint_with_one_number(self, selector: Selector, what: str) -> str:
        (name,) = self._joints(selector, 1)
        one_number(self._assembled()[0].model, name, what)
        return name

    def _dofs(self, selector: Selector) -> list[int]:
        model = self._assembled()[0].model
        found: list[int] = []
        for name in self._joints(selector):
            index = model.getJointId(name)
            found += range(model.idx_vs[index], model.idx_vs[index] + model.nvs[index])
        return found

    def _update_joints(self, new: dict[str, JointSettings]) -> None:
        for name, settings in new.items():
            self._edits.joints.setdefault(name, JointSettings()).update(settings)
        self._built = None

    def _name(self, kind: str, name: str | None) -> str:
        """Return the name of a new element: the one given, or kind_1, kind_2, ..."""
        taken = {element.name for element in self._edits.elements}
        if name is None:
            return next(f"{kind}_{k}" for k in range(1, len(taken) + 2) if f"{kind}_{k}" not in taken)
        if not isinstance(name, str) or not name:
            raise InputError("Name of an element", name="name", expected="a non-empty str", got=short(name))
        if name in taken:
            raise InputError(
                f"There is an element called {name!r} already", name="name", expected="a new name", got=repr(name),
                remedy="Give another name, or scene.remove(name) first",
            )  # fmt: skip
        return name

    def _put(self, element: kinds.Element) -> str:
        self._edits.elements.append(element)
        self._edits.missing = [name for name in self._edits.missing if name != element.name]
        self._built = None
        return element.name


def _several(fixed: Any) -> Sequence[Any]:
    return (fixed,) if isinstance(fixed, str) or not isinstance(fixed, Sequence) else fixed
