"""One step with bilateral constraints phi(q, t) = 0, in numbers of any kind, for derivatives by complex steps.

The midpoint step in RATTLE form (Hairer, Lubich, Wanner, "Geometric Numerical Integration", VII.1), W = dphi/dq:
  p0 + W(q0)^T lam = P(q_m, v) - h/2 f,   q_m = q0 + h/2 v,   q1 = q0 + h v,   phi(q1, t1) = 0
  p1 = p0 + W(q0)^T lam + h f + W(q1)^T mu,   W(q1) M(q1)^-1 p1 + dphi/dt(q1, t1) = 0
with f = dL/dq + F and P = dL/dv of `derivative_step.Motion`. Starts need not satisfy the constraints.

Inputs `x` as in derivative_step, with t [s], and what the constraints look up.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from . import precise
from .derivative_step import Motion, chain, joint_forces, mass_matrix, momentum_and_force
from .precise import gradient, vector

PINNED = Motion(chain, joint_forces)


def pinned_and_driven(q, t, x) -> list:
    """The tip of a chain at x["pin"] (x, z) [m], and its first joint at a + b t + c t^2, (a, b, c) = x["motion"]."""
    angle, at = 0, [-x["pin"][0], -x["pin"][1]]
    for length, turn in zip(x["lengths"], q, strict=True):
        angle = angle + turn
        at = [at[0] + length * precise.sin(angle), at[1] - length * precise.cos(angle)]
    a, b, c = x["motion"]
    return [*at, q[0] - (a + b * t + c * t * t)]


def outcome(motion: Motion, constraint: Callable) -> Callable[[dict], list]:
    """f(x) = [q1, p1] of one step: what oracles.precise differentiates."""

    def f(x: dict) -> list:
        floats = precise.as_floats(x)
        n = len(x["q0"])
        start = np.linalg.solve(np.array(mass_matrix(motion, floats["q0"], floats), float), floats["p0"].astype(float))
        rows = len(constraint(floats["q0"], floats["t"], floats))
        rough = precise.newton(lambda z: _equations(motion, constraint, floats, z)[0], [*start, *np.zeros(2 * rows)])
        z = precise.refine(lambda z: _equations(motion, constraint, x, z)[0], *rough, type(x["q0"][0]))
        _, q1, p1 = _equations(motion, constraint, x, z)
        assert len(q1) == n
        return [*q1, *p1]

    return f


def _equations(motion: Motion, constraint: Callable, x: dict, z) -> tuple[list, np.ndarray, np.ndarray]:
    """(residuals, q1, p1) for any z = (v, lam, mu)."""
    n, q0, p0, h = len(x["q0"]), x["q0"], x["p0"], x["h"]
    rows = (len(z) - n) // 2
    v, lam, mu = z[:n], z[n : n + rows], z[n + rows :]
    w0 = gradient(lambda q: constraint(q, x["t"], x), list(q0))[1]
    p, f = momentum_and_force(motion, q0 + h * v / 2, v, x)
    start = p0 + w0.T @ lam
    q1, t1 = q0 + h * v, x["t"] + h
    phi, w1 = gradient(lambda q: constraint(q, t1, x), list(q1))
    rate = gradient(lambda t: constraint(q1, t[0], x), [t1])[1][:, 0]
    p1 = start + h * f + w1.T @ mu
    speed = precise.solve_linear(mass_matrix(motion, q1, x), p1)
    return [*(p - start - h * f / 2), *(vector(list(phi)) / h), *(w1 @ speed + rate)], q1, p1
