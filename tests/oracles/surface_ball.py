"""A ball on a surface z = f(x, y): sliding without friction, rolling, and bouncing.

Of mass 1, radius r and inertia k r^2. The place u = (x, y) is that of the touching point; the centre is
c(u) = (u, f(u)) + r n(u) with the unit normal n. Along a motion with the velocity v of the centre u' solves
(dc/du) u' = v and n' = (dn/du) u', and the centre stays on the offset surface where n . v' = -n' . v.

Sliding: v' = -g e_z + N n. Rolling, v = r omega x n, with the friction F in the tangent plane:

  omega' = -n x F / (k r),   v' = r omega' x n + r omega x n' = -F / k + r omega x n',   P v' = F - g P e_z

so that (1 + k) P v' = -g P e_z + k r P (omega x n'). Integrated by DOP853.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

GRAVITY = 9.81
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class BallOnSurface:
    """height, gradient and hessian are of one point (2,)."""

    height: Callable[[np.ndarray], float]
    gradient: Callable[[np.ndarray], np.ndarray]
    hessian: Callable[[np.ndarray], np.ndarray]
    radius: float
    k: float = 0.4

    def normal(self, u: np.ndarray) -> np.ndarray:
        slope = self.gradient(u)
        return np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1.0 + slope @ slope)

    def center(self, u: np.ndarray) -> np.ndarray:
        return np.array([*u, self.height(u)]) + self.radius * self.normal(u)

    def normal_change(self, u: np.ndarray) -> np.ndarray:
        """dn/du, (3, 2)."""
        hessian, n = self.hessian(u), self.normal(u)
        length = np.sqrt(1.0 + self.gradient(u) @ self.gradient(u))
        raw = np.vstack([-hessian, np.zeros(2)]) / length
        return raw - np.outer(n, n @ raw)

    def center_change(self, u: np.ndarray) -> np.ndarray:
        """dc/du, (3, 2)."""
        return np.vstack([np.eye(2), self.gradient(u)]) + self.radius * self.normal_change(u)

    def slide(self, u: np.ndarray, v: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centres and velocities at the times, (n, 3) each, without friction."""

        def rate(_: float, state: np.ndarray) -> np.ndarray:
            at, speed = state[:2], state[2:]
            moved = np.linalg.lstsq(self.center_change(at), speed, rcond=None)[0]
            n = self.normal(at)
            force = GRAVITY * n[2] - (self.normal_change(at) @ moved) @ speed
            return np.concatenate([moved, force * n - GRAVITY * UP])

        found = _solved(rate, np.concatenate([u, v]), times)
        return np.array([self.center(state[:2]) for state in found]), found[:, 2:]

    def roll(self, u: np.ndarray, omega: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Centres, velocities and angular velocities in the world at the times, (n, 3) each."""

        def rate(_: float, state: np.ndarray) -> np.ndarray:
            at, turn = state[:2], state[2:]
            n = self.normal(at)
            speed = self.radius * np.cross(turn, n)
            moved = np.linalg.lstsq(self.center_change(at), speed, rcond=None)[0]
            along = np.eye(3) - np.outer(n, n)
            rolls = self.radius * np.cross(turn, self.normal_change(at) @ moved)
            change = along @ (-GRAVITY * UP + self.k * rolls) / (1.0 + self.k)
            friction = change + GRAVITY * (along @ UP)
            return np.concatenate([moved, -np.cross(n, friction) / (self.k * self.radius)])

        found = _solved(rate, np.concatenate([u, omega]), times)
        speeds = [self.radius * np.cross(state[2:], self.normal(state[:2])) for state in found]
        return np.array([self.center(state[:2]) for state in found]), np.array(speeds), found[:, 2:]

    def bounce(
        self, c: np.ndarray, v: np.ndarray, restitution: float, count: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times (count,), places and velocities after the first impacts without friction."""
        times, places, speeds = [], [], []
        t = 0.0
        for _ in range(count):
            flight, u = self._next_impact(c, v)
            n = self.normal(u)
            c = c + v * flight - 0.5 * GRAVITY * flight**2 * UP
            v = v - GRAVITY * flight * UP
            v = v - (1.0 + restitution) * (v @ n) * n
            t += flight
            times.append(t)
            places.append(c)
            speeds.append(v)
        return np.array(times), np.array(places), np.array(speeds)

    def _next_impact(self, c: np.ndarray, v: np.ndarray) -> tuple[float, np.ndarray]:
        """The flight's end: a scan finds it roughly by the least distance to a dense grid, then all equations do."""

        def at(t: float) -> np.ndarray:
            return c + v * t - 0.5 * GRAVITY * t**2 * UP

        def gap(t: float) -> float:
            x = at(t)
            side = np.linspace(-1.5 * self.radius, 1.5 * self.radius, 61)
            grid = np.array([[x[0] + a, x[1] + b] for a in side for b in side])
            heights = np.array([self.height(u) for u in grid])
            away = np.linalg.norm(np.column_stack([grid, heights]) - x, axis=1)
            best = int(np.argmin(away))
            nearest[:] = grid[best]
            return float(away[best]) - self.radius

        nearest = np.zeros(2)
        t = 2e-2
        while gap(t) > 5e-3:
            t += 2e-3
        start = np.array([t, *nearest])
        root, _, ok, message = fsolve(lambda z: self.center(z[1:]) - at(z[0]), start, xtol=1e-14, full_output=True)
        assert ok == 1, message
        return float(root[0]), root[1:]


def _solved(rate: Callable[[float, np.ndarray], np.ndarray], start: np.ndarray, times: np.ndarray) -> np.ndarray:
    found = solve_ivp(rate, (0.0, float(times[-1])), start, "DOP853", times, rtol=1e-13, atol=1e-13)
    assert found.success
    return np.asarray(found.y.T)
