"""Configurations and velocities of a scene: by the names of joints, on the ground, without overlaps, on constraints."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from contactvi.errors import InputError, did_you_mean
from contactvi.inputs import mapping, real, vector, warn_of_degrees
from contactvi.keywords import refusing_methods
from contactvi.scene import closure
from contactvi.scene.build import Built
from contactvi.scene.joints import dofs_of, is_revolute, joint_value, joint_velocity
from contactvi.scene.parts import PartList
from contactvi.scene.placing import place_on_ground
from contactvi.scene.selection import Names, Selector
from contactvi.scene.separation import Separation, separate


@refusing_methods
class SceneStates(ABC):
    """The methods of a scene that make configurations and velocities."""

    _parts: PartList
    q0: np.ndarray | None

    @abstractmethod
    def built(self) -> Built:
        """Return the complete scene."""

    @property
    @abstractmethod
    def names(self) -> Names:
        """What names and handles mean."""

    @property
    @abstractmethod
    def model(self) -> pin.Model:
        """The assembled model."""

    def neutral(self) -> np.ndarray:
        """Return the neutral configuration, shape (nq,): joints at zero or the nearest limit, free bodies as placed."""
        return self.built().start.copy()

    def spring_rest(self) -> np.ndarray:
        """Return the configuration where every spring rests, neutral for joints without one, shape (nq,)."""
        return self.built().arrays.rest.copy()

    def q_index(self, joint: Selector) -> slice:
        """Return where a joint's numbers lie in q; the handle of a part with a free base means that base."""
        found = self._one_joint(joint)
        return slice(found.idx_q, found.idx_q + found.nq)

    def v_index(self, joint: Selector) -> slice:
        """Return where a joint's numbers lie in v; handles as in `q_index`."""
        found = self._one_joint(joint)
        return slice(found.idx_v, found.idx_v + found.nv)

    @property
    def named_configurations(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """q (nq,) and v (nv,) of the models' files by name: keyframes of an MJCF, group states of an SRDF.

        Other parts are neutral; the name has the part's prefix.
        """
        return self._parts.named_configurations(self.neutral())

    def configuration(self, values: Mapping[Any, Any], base: np.ndarray | str | None = None) -> np.ndarray:
        """Return `base` with the values of some joints, shape (nq,).

        base: (nq,), the name of one of `named_configurations`, or None, neutral.

        Keys: joint names, patterns, handles (a part with a free base: that base; else its joints). Values: rad or m;
        free body: xyz, (xyz, rpy), xyz + quaternion xyzw or pin.SE3; spherical: quaternion xyzw; planar: x, y, angle;
        translation: x, y, z.
        """
        model = self.model
        if isinstance(base, str):
            base = self._named(base)
        q = self.neutral() if base is None else vector("base", base, model.nq)
        for selector, value in mapping("values", values, "joint: value").items():
            for name in self.names.select_placed(selector):
                q[self.q_index(name)] = joint_value(model, name, value)
                if is_revolute(model, name):
                    warn_of_degrees(f"value of joint {name!r}", q[self.q_index(name)])
        return q

    def velocity(
        self, values: Mapping[Any, Any], q: np.ndarray | None = None, base: np.ndarray | None = None
    ) -> np.ndarray:
        """Return `base` (nv,) (zero when None) with the velocities of some joints, Pinocchio coordinates.

        Values: rad/s or m/s; free body: linear or (linear, angular) in world axes at configuration q; else 3 numbers.
        """
        model = self.model
        q = self.neutral() if q is None else vector("q", q, model.nq)
        v = np.zeros(model.nv) if base is None else vector("base", base, model.nv)
        for selector, value in mapping("values", values, "joint: velocity").items():
            for name in self.names.select_placed(selector):
                v[self.v_index(name)] = joint_velocity(model, name, value, q)
        return v

    def assemble(self, q: Any = None, fixed: Sequence[Selector] | Selector = (), t: float = 0.0) -> np.ndarray:
        """Return the configuration (nq,) near q (nq,) that satisfies the constraints at t [s].

        Args:
            q: where to begin, by default neutral.
            fixed: joints that keep their values. Limits of joints are kept too.

        Raises:
            ConstraintError: there is none near q; the error names the constraints that remain violated.
        """
        built, start, time = self.built(), self._state(q), real("t", t)
        dofs, rows = self._dofs_of(fixed), built.elements.constraints
        if not rows:
            return start
        return closure.assemble(built.engine, built.model, rows, start, dofs, time)

    def consistent_velocity(
        self, q: Any = None, v: Any = None, t: float = 0.0, fixed: Sequence[Selector] | Selector = ()
    ) -> np.ndarray:
        """Return the velocity (nv,) nearest to v (in the metric of the mass) that satisfies the constraints at q.

        All joints may change: to have one turn as v says, as the crank of a linkage, name it in `fixed`.

        Args:
            q: (nq,), by default neutral.
            v: (nv,), by default rest.
            t: [s].
            fixed: joints that keep their velocities, by name, pattern or handle.

        Raises:
            ConstraintError: there is none, because constraints and fixed joints need different speeds.
        """
        built, start, time = self.built(), self._state(q), real("t", t)
        velocity = np.zeros(built.model.nv) if v is None else vector("v", v, built.model.nv)
        if not built.elements.constraints:
            return velocity
        rows, dofs = built.elements.constraints, self._dofs_of(fixed)
        return closure.consistent_velocity(built.engine, rows, start, velocity, time, dofs)

    def place_on_ground(
        self, part: Selector | None = None, q: ArrayLike | None = None, ground: Selector | None = None
    ) -> np.ndarray:
        """Return a configuration (nq,) with a part on the ground: its base moved along the normal of a halfspace.

        Its lowest point then touches the halfspace to rounding; its base is not turned, and all else stays where it is.
        `scene.q0 = scene.place_on_ground(robot)` makes it the start of runs.

        Args:
            part: with a free base; of a part with several, a joint or body of what is to be moved. None: the only one
                in the scene that is free.
            q: configuration, shape (nq,); None: the scene's q0, else neutral.
            ground: the halfspace, fixed to the world, by name or handle; None: the only one that it has pairs with.

        Raises:
            InputError: the part has no free base; there is no such halfspace, or several.
        """
        at = self._state(self.q0 if q is None else q)
        return place_on_ground(self.built(), self._parts.assembly.root_of_joint, self.names, part, at, ground)

    def separate(
        self,
        q: ArrayLike | None = None,
        limit: float | None = None,
        fixed: Sequence[Selector] | Selector = (),
        t: float = 0.0,
    ) -> Separation:
        """Return the configuration nearest to q that has no overlaps, with what was moved for it.

        The change is the smallest one in the metric of the mass matrix, within the limits of joints and on the
        constraints. Free bodies and bases of robots are moved first, with all joints as they are; where that is not
        enough, or too far, joints move too, and their changes count a hundredfold. Joints beyond a limit come back to
        it. What touches in the end touches to rounding. `scene.q0 = scene.separate(q).q` makes it the start of runs;
        simulate(..., start="separate") does so for one run.

        Args:
            q: configuration, shape (nq,); None: the scene's q0, else neutral.
            limit: how far a point of a body may be moved [m]. None: 0.01, and no overlap of two bodies may be deeper
                than a quarter of the smaller one (of the longest edge of its box), because the way out is a guess then.
            fixed: joints that keep their values, by name, pattern or handle.
            t: time [s], for constraints that depend on it.

        Raises:
            SeparationError: nothing within the limit ends the overlaps.
        """
        built, time = self.built(), real("t", t)
        at = self._state(self.q0 if q is None else q)
        most = None if limit is None else real("limit", limit, 0.0)
        return separate(built, at, most, self._dofs_of(fixed), time)

    def _dofs_of(self, fixed: Sequence[Selector] | Selector) -> list[int]:
        names = [name for selector in _several(fixed) for name in self.names.select_joints(selector)]
        return sorted({dof for name in names for dof in dofs_of(self.model, name)})

    def _one_joint(self, selector: Selector) -> pin.JointModel:
        model = self._parts.assembly.model
        return model.joints[model.getJointId(self.names.select_joint(selector))]

    def _named(self, name: str) -> np.ndarray:
        known = self.named_configurations
        if name not in known:
            raise InputError(
                "Unknown configuration",
                name="base",
                expected=" | ".join(map(repr, known)) or "an array: the files name none",
                got=repr(name),
                remedy=did_you_mean(name, list(known)),
            )
        return known[name][0]

    def _state(self, q: Any) -> np.ndarray:
        built = self.built()
        return built.start.copy() if q is None else built.states.configuration(q, "q")


def _several(fixed: Sequence[Selector] | Selector) -> Sequence[Selector]:
    return (fixed,) if isinstance(fixed, str) or not isinstance(fixed, Sequence) else fixed
