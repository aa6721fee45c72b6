"""States and inputs of a scene as vectors: what they are made of, by joints, and how they change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from contactvi import inputs
from contactvi.derivatives.constrained_starts import tangent
from contactvi.errors import InputError
from contactvi.scene.scene import Scene
from contactvi.trajectory.compiled import compile_scene

Array = NDArray[np.float64]


class StateParts(NamedTuple):
    """Configuration Q, momentum p and velocity v of a state (nq,), (nv,), (nv,), or of each of a trajectory."""

    Q: Array
    p: Array
    v: Array


class InputParts(NamedTuple):
    """Forces u and targets of servos rho of an input, or of each of a trajectory."""

    u: Array
    rho: Array


class TrajectoryParts(NamedTuple):
    """The parts of states (N, ...) and of inputs (N - 1, ...)."""

    Q: Array
    p: Array
    v: Array
    u: Array
    rho: Array


class StatesAndInputs(NamedTuple):
    """States (N, nX) and the inputs (N - 1, nU) between them."""

    X: Array
    U: Array


class StateVectors:
    """How states and inputs are made of their parts, by joints."""

    def __init__(
        self, scene: Scene, time: Array, state: str, joints: Sequence[str] | None, servos: Sequence[str]
    ) -> None:
        self.scene, self.time, self.state = scene, time, state
        compiled = compile_scene(scene)
        self._model, self._core, self._states = compiled.built.model, compiled.core, compiled.states
        self.nQ, self.nV = self._states.nq, self._states.nv
        names = compiled.joint_names[1:] if joints is None else list(joints)
        self.joints = [name for chosen in names for name in scene.names.select_joints(chosen)]
        self.servos = [name for chosen in servos for name in scene.names.select_joints(chosen)]
        _check_servos(compiled.built.servo_joints, compiled.built.arrays.targets, self.servos)
        dofs = [dof for name in self.joints for dof in range(self.nV)[scene.v_index(name)]]
        driven = [scene.v_index(name).start for name in self.servos]
        self.forces, self.targets = slice(0, len(dofs)), slice(len(dofs), len(dofs) + len(driven))
        # Forces of an input: a target acts as the torque kp times it.
        self.acts = np.zeros((self.nV, len(dofs) + len(driven)))
        self.acts[dofs, range(len(dofs))] = 1.0
        for column, dof in enumerate(driven, len(dofs)):
            self.acts[dof, column] = compiled.built.arrays.servo[0, dof]
        self._all_servos = self.servos == compiled.built.servo_joints

    @property
    def nX(self) -> int:
        """Numbers of a state."""
        return self.nQ + self.nV

    @property
    def input_names(self) -> list[str]:
        """A name per number of an input: the joint, its axis where it has several, and "target" where it is one."""
        axes = [(name, self.scene.v_index(name)) for name in self.joints]
        names = [name if v.stop - v.start == 1 else f"{name}[{k}]" for name, v in axes for k in range(v.stop - v.start)]
        return names + [f"{name} target" for name in self.servos]

    @property
    def ndX(self) -> int:
        """Numbers of a change of a state: nX but for free bodies and other configurations that are no vectors."""
        return 2 * self.nV

    @property
    def nU(self) -> int:
        """Numbers of an input."""
        return int(self.acts.shape[1])

    def build_state(self, Q: Any = None, p: Any = None, v: Any = None) -> Array:
        """Return the state with the configuration Q and momentum p or velocity v; by default neutral, at rest."""
        q = self._states.configuration(pin.neutral(self._model) if Q is None else Q, "Q")
        return np.concatenate([q, self._second_part(q[None], p, v, ())[0]])

    def build_input(self, u: Any = None, rho: Any = None) -> Array:
        """Return the input with the forces u and the targets rho; zero if None."""
        return self._inputs(u, rho, ())

    def build_trajectory(
        self, Q: Any = None, p: Any = None, v: Any = None, u: Any = None, rho: Any = None
    ) -> StatesAndInputs:
        """Return states and inputs from their parts at all times; None is as in build_state and build_input."""
        count = len(self.time)
        q = np.tile(pin.neutral(self._model), (count, 1)) if Q is None else Q
        q = inputs.array("Q", q, (count, self.nQ), "one configuration per time")
        rows = [self._states.configuration(row, "Q") for row in q]
        X = np.hstack([rows, self._second_part(np.array(rows), p, v, (count,))])
        return StatesAndInputs(X, self._inputs(u, rho, (count - 1,)))

    def split_state(self, X: ArrayLike | None = None) -> StateParts:
        """Return Q, p and v of a state."""
        x = self.build_state() if X is None else self.checked_state(X)
        return StateParts(*(part[0] for part in self._split(x[None])))

    def split_input(self, U: ArrayLike | None = None) -> InputParts:
        """Return u and rho of an input."""
        value = self.build_input() if U is None else self.checked_input(U)
        return InputParts(value[self.forces], value[self.targets])

    def split_trajectory(self, X: ArrayLike | None = None, U: ArrayLike | None = None) -> TrajectoryParts:
        """Return the parts of states and inputs."""
        default = self.build_trajectory()
        x = default.X if X is None else rows_of("X", X, self.nX)
        values = default.U if U is None else rows_of("U", U, self.nU)
        return TrajectoryParts(*self._split(x), values[:, self.forces], values[:, self.targets])

    def difference(self, x0: Array, x1: Array) -> Array:
        """Return the change from a state to another one, shape (ndX,): Pinocchio's tangent vector, and numbers."""
        change = tangent(self._model, x0[: self.nQ], x1[: self.nQ])
        return np.concatenate([change, x1[self.nQ :] - x0[self.nQ :]])

    def integrate(self, x: Array, dx: Array) -> Array:
        """Return the state x changed by dx (ndX,)."""
        return np.concatenate([pin.integrate(self._model, x[: self.nQ], dx[: self.nV]), x[self.nQ :] + dx[self.nV :]])

    def d_difference(self, x0: Array, x1: Array) -> Array:
        """Return the derivative of difference(x0, x1) by changes of x1, shape (ndX, ndX)."""
        return np.asarray(np.linalg.inv(self.d_integrate(x0, self.difference(x0, x1))))

    def d_integrate(self, x: Array, dx: Array) -> Array:
        """Return the derivative of integrate(x, dx) by dx, as changes there, shape (ndX, ndX)."""
        found = np.eye(self.ndX)
        found[: self.nV, : self.nV] = pin.dIntegrate(self._model, x[: self.nQ], dx[: self.nV])[1]
        return found

    def checked_state(self, x: Any) -> Array:
        numbers = inputs.array("xk", x, (self.nX,), f"one state: a configuration, then its {self.state}")
        return np.concatenate([self._states.configuration(numbers[: self.nQ], "xk"), numbers[self.nQ :]])

    def checked_input(self, u: Any) -> Array:
        return inputs.array("uk", u, (self.nU,), "one input: forces of `inputs`, then targets of `targets`")

    def _inputs(self, u: Any, rho: Any, rows: tuple[int, ...]) -> Array:
        found = np.zeros((*rows, self.nU))
        for name, part, at in (("u", u, self.forces), ("rho", rho, self.targets)):
            if part is not None:
                found[..., at] = inputs.array(name, part, (*rows, at.stop - at.start), "one number per input")
        return found

    def _second_part(self, q: Array, p: Any, v: Any, rows: tuple[int, ...]) -> Array:
        """Return the momenta or velocities that stand in states, (N, nv), from those of one kind or the other."""
        if p is not None and v is not None:
            raise InputError(
                "A state has its momentum twice", name="v", expected="p or v, p = M(Q) v", got="both",
                remedy="Leave one of them out",
            )  # fmt: skip
        name, given = ("p", p) if p is not None else ("v", v)
        if given is None:
            return np.zeros((len(q), self.nV))
        found = inputs.array(name, given, (*rows, self.nV), "one number per axis of the joints").reshape(-1, self.nV)
        if (name == "p") == (self.state == "momentum"):
            return found
        return np.asarray((self._core.velocity if name == "p" else self._core.momentum)(q, found))

    def _split(self, X: Array) -> tuple[Array, Array, Array]:
        q, x = np.ascontiguousarray(X[:, : self.nQ]), np.ascontiguousarray(X[:, self.nQ :])
        if self.state == "momentum":
            return q, x, np.asarray(self._core.velocity(q, x))
        return q, np.asarray(self._core.momentum(q, x)), x

    def target(self, u: Array) -> dict[str, float] | Array | None:
        """Return the targets of the servos of a run under the input u (nU,)."""
        if not self.servos:
            return None
        values = u[self.targets]
        return values if self._all_servos else dict(zip(self.servos, map(float, values), strict=True))


def rows_of(name: str, values: Any, width: int) -> Array:
    """Return an array (N, width) of vectors."""
    found = inputs.real_numbers(values)
    count = len(found) if found is not None and found.ndim > 0 else 1
    return inputs.array(name, values, (count, width), "one vector per time")


def _check_servos(driven: Sequence[str], targets: Mapping[str, Any], servos: Sequence[str]) -> None:
    """Raise InputError for inputs of joints without a servo, and for servos without a target.

    A servo without one holds the place where a run starts: here that of each state.
    """
    for name in servos:
        if name not in driven:
            raise InputError(
                f"Joint {name!r} has no servo", name="targets", expected=f"some of {', '.join(driven) or 'no joint'}",
                got=repr(name), remedy="Call scene.set_servo first",
            )  # fmt: skip
    for name in driven:
        if name not in servos and name not in targets:
            raise InputError(
                f"The servo of joint {name!r} has no target", name="targets", expected="targets of all servos",
                got="a servo that holds where it starts, which is another place in each step",
                remedy=f"Give targets=[{name!r}, ...], or scene.set_servo({name!r}, ..., target=...)",
            )  # fmt: skip
