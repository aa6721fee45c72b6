"""Second derivatives of runs by differences of their gradients, and a cost with second derivatives of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

import contactvi as cvi
from derivatives.differences import FOURTH

Array = np.ndarray
Direction = dict[str, Array]


class CurvedCost:
    """a.d + d.Q.d/2 + b.v + v.V.v/2 + d.X.v at each node, d its tangent vector from where the first run has it."""

    def __init__(self, traj: cvi.Trajectory, rng: np.random.Generator) -> None:
        self.model, self.q = traj.scene.model, np.array(traj.q)
        nodes, nv = len(traj.t), traj.scene.nv
        self.a, self.b = rng.standard_normal((2, nodes, nv))
        Q, V, self.X = rng.standard_normal((3, nv, nv))
        self.Q, self.V = Q + Q.T, V + V.T

    def __call__(self, t: Array, q: Array, v: Array) -> tuple[float, Array, Array]:
        lq, lv = np.zeros_like(self.a), np.zeros_like(self.a)
        for k in range(len(t)):
            d = pin.difference(self.model, self.q[k], q[k])
            turn = pin.dDifference(self.model, self.q[k], q[k], pin.ARG1)
            lq[k] = turn.T @ (self.a[k] + self.Q @ d + self.X @ v[k])
            lv[k] = self.b[k] + self.V @ v[k] + self.X.T @ d
        return 0.0, lq, lv

    def hessp(self, t: Array, q: Array, v: Array, dq: Array, dv: Array) -> tuple[Array, Array]:
        """Return the second derivative along (dq, dv), at the nodes of the first run."""
        return dq @ self.Q + dv @ self.X.T, dv @ self.V + dq @ self.X


@dataclass
class Start:
    """A scene with a start and inputs, which directions move."""

    scene: cvi.Scene
    q: Array
    v: Array
    control: Array
    options: dict[str, Any]

    def run(self, w: Direction | None = None, s: float = 0.0) -> cvi.Trajectory:
        w = {} if w is None else w
        q = pin.integrate(self.scene.model, self.q, s * w["q0"]) if "q0" in w else self.q
        control = self.control + s * w.get("control", 0.0)
        return cvi.simulate(
            self.scene, q, self.v + s * w.get("v0", 0.0), control=control, record="gradient", **self.options
        )

    def direction(self, rng: np.random.Generator) -> Direction:
        nv = self.scene.nv
        return {
            "q0": rng.standard_normal(nv), "v0": rng.standard_normal(nv),
            "control": rng.standard_normal(self.control.shape),
        }  # fmt: skip

    def gradient(self, cost: Any, w: Direction, s: float) -> Array:
        """Return the gradient at s w, in exponential coordinates at the start."""
        found = cvi.gradient(self.run(w, s), cost, ["q0", "v0", "control"])[1]
        turn = pin.dIntegrate(self.scene.model, self.q, s * w["q0"], pin.ARG1)
        return flat({**found, "q0": turn.T @ found["q0"]})

    def differences(self, cost: Any, w: Direction, step: float) -> tuple[Array, float]:
        """Return fourth-order differences of the gradient along w, and their own error, relative."""
        wide, near = (
            sum(weight / size * self.gradient(cost, w, count * size) for count, weight in FOURTH)
            for size in (step, 0.5 * step)
        )
        return near, float(np.abs(wide - near).max() / np.abs(near).max())


def flat(parts: Direction) -> Array:
    return np.concatenate([np.ravel(parts[name]) for name in ("q0", "v0", "control")])


def start_of(case: Any, seed: int = 0) -> Start:
    """Return the start of a case of helpers.derivative_cases, with random inputs."""
    scene, q, v = case.make()
    steps = round(case.options["duration"] / case.options["dt"])
    control = np.random.default_rng(seed).standard_normal((steps, scene.nv))
    return Start(scene, q, v, control, case.options)


def check_second(start: Start, step: float = 1e-3, tolerance: float = 1e-7, seed: int = 1) -> cvi.HessianVector:
    """Check H w against differences of the gradient, and its symmetry; return it."""
    rng = np.random.default_rng(seed)
    traj = start.run()
    cost = CurvedCost(traj, rng)
    w, other = start.direction(rng), start.direction(rng)
    found, second = (cvi.hessian_vector(traj, cost, d, hessp=cost.hessp) for d in (w, other))
    assert found.approximate is None
    slope = flat(cvi.gradient(traj, cost, tuple(w))[1])
    # Through impacts the same numbers come by other sums.
    assert np.abs(flat(found.gradient) - slope).max() <= (1e-12 * np.abs(slope).max() if len(traj.events) else 0.0)
    expected, own = start.differences(cost, w, step)
    size = np.abs(expected).max()
    assert np.abs(flat(found.product) - expected).max() <= (tolerance + 10.0 * own) * size
    assert own <= 1e-4
    one, two = flat(other) @ flat(found.product), flat(w) @ flat(second.product)
    terms = np.abs(flat(other)) @ np.abs(flat(found.product))
    assert abs(one - two) <= 1e-10 * terms
    return found
