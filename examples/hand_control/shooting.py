"""Shooting: a cost of a run as a function of the targets of its servos, with its gradient, for optimizers of scipy."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.interpolate import BSpline
from scipy.optimize import minimize

import contactvi as cvi

DT, KNOTS = 1e-3, 10  # [s]; numbers per joint
UNIT = np.array([0.02] + [0.05] * 18)  # what a variable of 1 adds to a target: lift [m], others [rad]; 5 at most


class Shooting:
    """A cost of the run and its gradient, as functions of the variables (19 KNOTS,)."""

    def __init__(self, scene: cvi.Scene, q: np.ndarray, targets: np.ndarray, cost: Callable[..., Any]) -> None:
        self.scene, self.q, self.targets, self.cost, self.evaluations = scene, q, targets, cost, 0
        times, knots = (np.arange(len(targets)) + 0.5) / len(targets), np.arange(-3, KNOTS + 7) / (KNOTS + 3)
        self.basis = BSpline.design_matrix(times, knots, 3).toarray()[:, 3:-3]  # zero with two rates at both ends

    def run(self, x: np.ndarray, hold: int = 0) -> cvi.Trajectory:
        """Run, and go on with the last targets for so many steps."""
        targets = self.targets + self.basis @ (x.reshape(KNOTS, 19) * UNIT)
        targets = np.vstack([targets, np.repeat(self.targets[-1:], hold, axis=0)])
        return cvi.simulate(self.scene, self.q, target=targets, duration=DT * len(targets), dt=DT, record="gradient")

    def __call__(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        self.evaluations += 1
        J, slope = cvi.gradient(self.run(x), self.cost, "target")
        assert J is not None
        return J + 5e-4 * float(x @ x), (self.basis.T @ slope["target"] * UNIT).ravel() + 1e-3 * x


def at_rest(q: np.ndarray, v: np.ndarray, wanted: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return a cost of the last node and its slopes: wrist and ball in their wanted places, nothing moves."""
    off = np.where(np.arange(22) % 19 < 3, q[-1, :22] - wanted[:22], 0.0)
    heavy = np.r_[np.full(19, 0.02), np.full(3, 5.0), np.full(3, 5e-3)]
    slope = 100.0 * np.r_[off[:19], turn(q[-1]).T @ off[19:], np.zeros(3)]
    return float(50.0 * off @ off + 0.5 * v[-1] @ (heavy * v[-1])), slope, heavy * v[-1]


def turn(q: np.ndarray) -> np.ndarray:
    """Return the axes of the ball, in which its velocity and the slopes in its place are given."""
    return np.asarray(pin.Quaternion(q[-4:]).toRotationMatrix())


def solve(problem: Shooting, most: int = 60) -> np.ndarray:
    """Minimize from zero; print the way, and the gradient at its end beside fourth-order differences."""
    began, costs = time.perf_counter(), []

    def show(intermediate_result: Any) -> None:
        costs.append(float(intermediate_result.fun))

    found = minimize(problem, np.zeros(19 * KNOTS), jac=True, method="L-BFGS-B", bounds=[(-5, 5)] * 19 * KNOTS,
                     callback=show, options={"maxcor": 20, "maxiter": most, "ftol": 1e-7})  # fmt: skip
    seconds = time.perf_counter() - began
    print("cost:", *(f"{J:.4g}" for J in costs[::5]), f"... {found.fun:.6g}; {found.message}")
    print(f"{found.nit} iterations, {problem.evaluations} runs with gradients, {seconds:.1f} s")
    assert np.all(np.diff(costs) <= 0.0)
    along = np.random.default_rng(0).standard_normal(found.x.size)
    exact = float(found.jac @ along)
    # Where the contact force just touches zero the cost jumps, and searches like to end beside such a place. So
    # differences are taken on both sides; those of a side with a jump are far off.
    sides = []
    for step in (1e-4, -1e-4):
        near = [problem(found.x + step * k * along)[0] for k in range(5)]
        sides.append(float(np.dot([-25.0, 48.0, -36.0, 16.0, -3.0], near)) / (12.0 * step))
    numbers = min(sides, key=lambda slope: abs(slope - exact))
    print(f"slope along a random direction: {exact:.10g}, by differences {numbers:.10g}")
    assert abs(exact - numbers) <= 1e-6 * abs(exact)
    return found.x
