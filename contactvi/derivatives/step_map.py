"""One step of a scene as a map of its state and forces, with its first and second derivatives.

The state is the configuration and the velocity or the momentum. Changes of configurations are Pinocchio's tangent
vectors, and second derivatives those of d -> f(q (+) d, ...) in the same coordinates at the end, (+) being Pinocchio's
`integrate`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi import inputs
from contactvi.derivatives.inertia import MassDerivatives
from contactvi.derivatives.linear import STATES, step_derivatives
from contactvi.errors import NotDifferentiable, SimulationError
from contactvi.importing.couplings import coupled_basis
from contactvi.scene.scene import Scene
from contactvi.simulation.messages import remedy
from contactvi.simulation.simulator import Simulator
from contactvi.trajectory.compiled import compile_scene
from contactvi.trajectory.hessian import check_exact
from contactvi.trajectory.sensitivity import not_differentiable, recorded_run
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]

# What a step can have in it that only a run knows; it then gives the derivative, or the reason why there is none.
OF_RUNS = ("impact", "contact", "step", "saturation")


class StepMap:
    """The steps of one length of a scene.

    Args:
        scene: the scene. dt: step [s]. order: 2, 4, ... 16.
        state: what stands beside q, "velocity" or "momentum".
        options: further ones, as for contactvi.Simulator.
    """

    def __init__(self, scene: Scene, dt: float, order: int, state: str, options: dict[str, Any]) -> None:
        inputs.check_choice("state", state, STATES, "Unknown kind of state")
        self.scene, self.order, self.momentum = scene, order, state == "momentum"
        chosen: dict[str, Any] = {**options, "order": order, "record": "gradient", "start": "given"}
        self.simulator = Simulator(scene, dt, **chosen)
        self.dt = self.simulator.options.fixed_dt
        self.compiled = compile_scene(scene)
        self.core, self.nv = self.compiled.core, self.compiled.states.nv
        self.mass = MassDerivatives(self.compiled.built.model)

    def at(self, q: Array, x: Array, tau: Array, target: Any, t: float) -> Step:
        """Return the step from (q, x) at t [s] with the forces tau (nv,) and the targets of servos of a run."""
        return Step(self, q, x, tau, target, t)


class Step:
    """One step of a StepMap, made when its end or a derivative is asked for.

    Attributes:
        q, v: where it starts.

    Raises:
        InputError, PenetrationError, ConstraintError: for a start that no run accepts.
        SimulationError: the step could not be made.
    """

    def __init__(self, steps: StepMap, q: Array, x: Array, tau: Array, target: Any, t: float) -> None:
        self._steps, self._tau, self._target, self._t = steps, tau, target, t
        self.q = q
        self.v = np.asarray(steps.core.velocity(q[None], x[None]))[0] if steps.momentum else x

    @cached_property
    def end(self) -> tuple[Array, Array]:
        """The configuration at the end, shape (nq,), and the velocity or the momentum there, (nv,)."""
        simulator = self._run()
        return simulator.q, simulator.p if self._steps.momentum else simulator.v

    def _run(self) -> Simulator:
        simulator = self._steps.simulator
        simulator.reset(self.q, self.v, self._t)
        status = simulator.step(self._tau, self._target)
        if not status.ok:
            options = simulator.options
            raise SimulationError(
                f"The step was not made: {status.message}", expected=f"a step of {self._steps.dt:g} s",
                got=status.code.name, remedy=remedy(status.code, options.contact_mode, options.zeno, options.impact),
                status=status,
            )  # fmt: skip
        return simulator

    @cached_property
    def trajectory(self) -> Trajectory:
        """The step as a run of its own."""
        return self._run().trajectory()

    @cached_property
    def first(self) -> tuple[Array, Array]:
        """The derivatives of (q1, x1) with respect to (q, x), shape (2 nv, 2 nv), and tau, (2 nv, nv)."""
        steps = self._steps
        state = STATES[1] if steps.momentum else STATES[0]
        more: dict[str, Any] = {"order": steps.order, "target": self._target, "t": self._t, "state": state}
        try:
            found = step_derivatives(steps.scene, self.q, self.v, self._tau, steps.dt, **more)
        except NotDifferentiable as reason:
            if reason.reason not in OF_RUNS:
                raise
        else:
            return found.A, found.B
        made = self.trajectory.sensitivity(["q0", "v0", "control"])
        A, B = made.matrix[-1, :, : 2 * steps.nv], made.matrix[-1, :, 2 * steps.nv :]
        if not steps.momentum:
            return A, B
        end = self._momentum(self.end[0], self.trajectory.v[-1])
        return end @ A @ self._velocity(), end @ B

    def second(self, z: Array, acts: Array) -> Array:
        """Return the second derivative of z^T (q1, x1) in (q, x, u), tau being acts u; z (2 nv,), acts (nv, m).

        The shape is (2 nv + m, 2 nv + m).

        Raises:
            NotDifferentiable, DerivativeError: as contactvi.hessian_vector.
        """
        nv, (products, slope) = self._steps.nv, self._products(z, acts)
        if not self._steps.momentum:
            return products
        # v is a function g of (q, p), M(q) g = p: the chain rule, and the second derivatives of g along the slope in v.
        mass = self._steps.mass
        change = np.eye(len(products))
        change[: 2 * nv, : 2 * nv] = self._velocity()
        found = change.T @ products @ change
        g_q, g_p = change[nv : 2 * nv, :nv], change[nv : 2 * nv, nv : 2 * nv]
        y = g_p @ slope
        C = mass.first(self.q, y)
        mixed = g_q.T @ C
        found[:nv, :nv] -= mass.second(self.q, y, self.v) + mixed + mixed.T
        found[:nv, nv : 2 * nv] -= C.T @ g_p
        found[nv : 2 * nv, :nv] -= g_p.T @ C
        return np.asarray(found)

    def _products(self, z: Array, acts: Array) -> tuple[Array, Array]:
        """Return the second derivative in (q, v, u), and the first one in v (nv,), of z^T (q1, x1)."""
        nv, traj, compiled = self._steps.nv, self.trajectory, self._steps.compiled.at_start(self.q)
        check_exact(compiled, ("q0", "v0", "control"))
        run, times = recorded_run(traj, compiled), [float(t) for t in traj.t]
        lq, lv, hessp = self._end(z)
        count = 2 * nv + acts.shape[1]
        rows, slope = np.zeros((count, count)), np.zeros(nv)
        for k, unit in enumerate(np.eye(count)):
            w = {"q": unit[:nv], "v": unit[nv : 2 * nv], "tau": (acts @ unit[2 * nv :])[None]}
            found = run.hessian(times, lq, lv, w, hessp)
            if "fact" in found:
                raise not_differentiable(traj, found)
            product, slope = found["product"], np.asarray(found["gradient"]["v"])
            rows[k] = np.concatenate([product["q"], product["v"], acts.T @ np.asarray(product["tau"])[0]])
        return 0.5 * (rows + rows.T), slope

    def _end(self, z: Array) -> tuple[Array, Array, Callable[[Array, Array], tuple[Array, Array]]]:
        """Return the gradients of z^T (q1, x1) at the nodes, and what changes them along changes of states."""
        nv, mass = self._steps.nv, self._steps.mass
        lq, lv = np.zeros((2, len(self.trajectory.t), nv))
        lq[-1], lv[-1] = z[:nv], z[nv:]
        if not self._steps.momentum:
            return lq, lv, lambda dq, dv: (np.zeros_like(dq), np.zeros_like(dv))
        q1, v1, z_p = self.end[0], np.asarray(self.trajectory.v[-1]), z[nv:]
        M, C, K = mass.mass(q1), mass.first(q1, z_p), mass.second(q1, z_p, v1)
        lq[-1] += mass.first(q1, v1).T @ z_p
        lv[-1] = M @ z_p

        def hessp(dq: Array, dv: Array) -> tuple[Array, Array]:
            change_q, change_v = np.zeros_like(dq), np.zeros_like(dv)
            change_q[-1], change_v[-1] = K @ dq[-1] + C.T @ dv[-1], C @ dq[-1]
            return change_q, change_v

        return lq, lv, hessp

    def _momentum(self, q: Array, v: Array) -> Array:
        """Return the derivative of (q, p) by (q, v), p = M(q) v, shape (2 nv, 2 nv)."""
        nv, mass = self._steps.nv, self._steps.mass
        found = np.eye(2 * nv)
        found[nv:, :nv], found[nv:, nv:] = mass.first(q, v), mass.mass(q)
        return found

    def _velocity(self) -> Array:
        """Return the derivative of (q, v) by (q, p) at the start, shape (2 nv, 2 nv)."""
        nv = self._steps.nv
        found = np.eye(2 * nv)
        M = self._steps.mass.mass(self.q)
        changes = np.hstack([-self._steps.mass.first(self.q, self.v), np.eye(nv)])
        built = self._steps.compiled.built
        followers = built.elements.couplings.followers
        if followers:  # v = S u of coupled joints
            S = coupled_basis(built.model, followers)
            found[nv:] = S @ np.linalg.solve(S.T @ M @ S, S.T @ changes)
        else:
            found[nv:] = np.linalg.solve(M, changes)
        return found
