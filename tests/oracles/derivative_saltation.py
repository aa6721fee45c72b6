"""Derivatives of a motion in continuous time through impacts, by variational equations and saltation matrices.

y' = f(y) until guard(y) = 0 on the way down, then y+ = r(y-). With Phi = dy/dy0:
  between impacts  Phi' = f_y Phi
  at an impact     dt/dy0 = -g_y Phi / (g_y f-),   Phi+ = [r_y + (f+ - r_y f-) g_y / (g_y f-)] Phi
the saltation matrix (Aizerman, Gantmacher 1958; Kong, Payne, Zhu, Johnson, arXiv 2306.06862, equation 9). All of f_y,
g_y, r_y come by complex steps, so f, g and r must take complex arrays. A parameter is a part of y that does not move.
It is the limit of the derivatives of the discrete motion as h -> 0, and shares no code with oracles.derivative_step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from .precise import complex_jacobian

TOLERANCE = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15}


@dataclass(frozen=True)
class Hybrid:
    """Functions of y (N,): rate -> (N,), guard -> number, positive before an impact, reset -> (N,) after it."""

    rate: Callable[[np.ndarray], np.ndarray]
    guard: Callable[[np.ndarray], complex]
    reset: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Sensitivity:
    """y (N,) at the end, its derivative dy_dy0 (N, N), impact times (k,) [s] and dtimes_dy0 (k, N)."""

    y: np.ndarray
    dy_dy0: np.ndarray
    times: np.ndarray
    dtimes_dy0: np.ndarray


def _flow(system: Hybrid, z: np.ndarray, duration: float, n: int, until_impact: bool = False):
    """Solution of the variational equations from z = (y, Phi), Phi by rows."""

    def rhs(_t, z):
        y, phi = z[:n], z[n:].reshape(n, n)
        return np.concatenate([system.rate(y), (complex_jacobian(system.rate, y) @ phi).ravel()])

    def fall(_t, z):
        return system.guard(z[:n])

    fall.terminal, fall.direction = True, -1.0  # type: ignore[attr-defined]
    return solve_ivp(rhs, (0.0, duration), z, events=fall if until_impact else None, **TOLERANCE)


def _at_impact(system: Hybrid, solved, n: int) -> tuple[float, np.ndarray]:
    """(time, z) where the guard is zero: from the last node before it, without the interpolant."""
    z, start = solved.y[:, -2], solved.t[-2]
    length = solved.t_events[0][0] - start
    for _ in range(8):
        end = _flow(system, z, length, n).y[:, -1] if length > 0.0 else z
        correction = system.guard(end[:n]) / (
            complex_jacobian(lambda y: [system.guard(y)], end[:n])[0] @ system.rate(end[:n])
        )
        length -= correction
        if abs(correction) <= 1e-15:
            break
    return start + length, end


def sensitivity(system: Hybrid, y0: np.ndarray, duration: float) -> Sensitivity:
    """The motion from y0 over `duration` [s] with all its impacts."""
    n, t = len(y0), 0.0
    z = np.concatenate([np.array(y0, dtype=float), np.eye(n).ravel()])
    times, slopes = [], []
    while True:
        solved = _flow(system, z, duration - t, n, until_impact=True)
        if solved.status != 1:
            break
        length, z = _at_impact(system, solved, n)
        y, phi = z[:n], z[n:].reshape(n, n)
        after = system.reset(y)
        before, slope = system.rate(y), complex_jacobian(lambda y: [system.guard(y)], y)[0]
        jump = complex_jacobian(system.reset, y)
        dt = -(slope @ phi) / (slope @ before)
        phi = jump @ phi + np.outer(jump @ before - system.rate(after), dt)
        t += length
        times.append(t)
        slopes.append(dt)
        z = np.concatenate([after, phi.ravel()])
    z = solved.y[:, -1]
    return Sensitivity(z[:n], z[n:].reshape(n, n), np.array(times), np.array(slopes).reshape(-1, n))


# --- a chain of links whose tip hits a wall --------------------------------------------------------------------------
class ChainAtWall:
    """Planar chain of oracles.derivative_step.PENDULUM: y = (q, v, the parameters named in `wrt`, one after another).

    parameters: masses, lengths, gravity, wall, e; where given tau, damping, stiffness, rest, centres, inertias.
    Equations by hand in absolute angles a = C q, w = C v, C lower triangular of ones:
      sum_j A_ij cos(a_i - a_j) w_j' + I_i w_i' = -sum_j A_ij sin(a_i - a_j) w_j^2 - g B_i sin a_i + (C^-T F)_i
    with A_ij = sum_k m_k d_ki d_kj, B_i = sum_k m_k d_ki, d_ki the part of link i in the way to the centre of k.
    """

    def __init__(self, parameters: Mapping[str, object], wrt: Sequence[str] = ()):
        self.x = {name: np.array(value, dtype=float) for name, value in parameters.items()}
        self.wrt, self.n = tuple(wrt), len(self.x["masses"])
        self.sum = np.tril(np.ones((self.n, self.n)))
        self.system = Hybrid(self.rate, self.guard, self.reset)

    def start(self, q0, v0) -> np.ndarray:
        """y at a state."""
        return np.concatenate([q0, v0, *(np.ravel(self.x[name]) for name in self.wrt)])

    def run(self, q0, v0, duration: float) -> Sensitivity:
        """Sensitivity over `duration` [s]."""
        return sensitivity(self.system, self.start(q0, v0), duration)

    def parts(self, y):
        """(q, v, all parameters) of y."""
        x, at = dict(self.x), 2 * self.n
        for name in self.wrt:
            shape = np.shape(self.x[name])
            size = int(np.prod(shape))
            x[name], at = y[at : at + size].reshape(shape), at + size
        return y[: self.n], y[self.n : 2 * self.n], x

    def lever(self, x) -> np.ndarray:
        """d (n, n), d[k, i] [m]."""
        centres = x.get("centres", x["lengths"])
        return np.tril(np.tile(x["lengths"], (self.n, 1)), -1) + np.diag(centres)

    def mass_matrix(self, q, x) -> np.ndarray:
        """M (n, n) of relative angles."""
        a, d = self.sum @ q, self.lever(x)
        m = (d.T * x["masses"]) @ d * np.cos(a[:, None] - a) + np.diag(x.get("inertias", np.zeros(self.n)))
        return self.sum.T @ m @ self.sum

    def rate(self, y) -> np.ndarray:
        """y' (N,)."""
        q, v, x = self.parts(y)
        a, w, d = self.sum @ q, self.sum @ v, self.lever(x)
        force = -((d.T * x["masses"]) @ d * np.sin(a[:, None] - a)) @ (w * w)
        force = self.sum.T @ (force - x["gravity"] * (x["masses"] @ d) * np.sin(a))
        zero = np.zeros(self.n)
        force = force + x.get("tau", zero) - x.get("damping", zero) * v
        force = force - x.get("stiffness", zero) * (q - x.get("rest", zero))
        return np.concatenate([v, np.linalg.solve(self.mass_matrix(q, x), force), np.zeros(len(y) - 2 * self.n)])

    def guard(self, y):
        """Gap between tip and wall [m]."""
        q, _, x = self.parts(y)
        return x["lengths"] @ np.sin(self.sum @ q) - x["wall"]

    def reset(self, y) -> np.ndarray:
        """y after the impact: v+ = v - (1 + e) M^-1 W (W v) / (W M^-1 W)."""
        q, v, x = self.parts(y)
        w = self.sum.T @ (x["lengths"] * np.cos(self.sum @ q))
        response = np.linalg.solve(self.mass_matrix(q, x), w)
        return np.concatenate([q, v - (1 + x["e"]) * (w @ v) / (w @ response) * response, y[2 * self.n :]])
