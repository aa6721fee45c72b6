"""Motions with an event that are known in closed form, with their derivatives written out by hand.

Each function returns `Known`: values by name in the order of `of`, and their derivatives (len(of), len(wrt)) with
respect to the arguments named in `wrt`, in that order. An event's time moves with the start; the formulas hold
between the events only, and each function refuses times outside of that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ellipe, ellipk


@dataclass(frozen=True)
class Known:
    """values (m,), derivative (m, n), and the names of both."""

    of: tuple[str, ...]
    wrt: tuple[str, ...]
    values: np.ndarray
    derivative: np.ndarray

    def at(self, of: str, wrt: str) -> float:
        """d(of)/d(wrt)."""
        return float(self.derivative[self.of.index(of), self.wrt.index(wrt)])


def bouncing_ball(z0: float, v0: float, e: float, g: float, t: float) -> Known:
    """Height [m], velocity [m/s, up] at time t, after one bounce, and the bounce's time t1, of a ball thrown from z0.

    With u = sqrt(v0^2 + 2 g z0) its speed at the ground, s = t - t1:
      t1 = (v0 + u)/g,   x = e u s - g s^2/2,   v = e u - g s
    """
    u = math.sqrt(v0 * v0 + 2.0 * g * z0)
    t1 = (v0 + u) / g
    s = t - t1
    if not 0.0 <= s < 2.0 * e * u / g:
        raise ValueError("not between the first and the second bounce")
    du = np.array([g / u, v0 / u, 0.0, z0 / u])
    dt1 = np.array([1.0 / u, (1.0 + v0 / u) / g, 0.0, z0 / (u * g) - t1 / g])
    dx = e * s * du - (e * u - g * s) * dt1 + [0.0, 0.0, u * s, -0.5 * s * s]
    dv = e * du + g * dt1 + [0.0, 0.0, u, -s]
    values = np.array([e * u * s - 0.5 * g * s * s, e * u - g * s, t1])
    return Known(("x", "v", "t1"), ("z0", "v0", "e", "g"), values, np.array([dx, dv, dt1]))


def two_balls(x1, x2, v1, v2, distance, t, e: float = 1.0, m1: float = 1.0, m2: float = 1.0) -> Known:
    """Two balls on a line, centres x1 < x2, that meet head on where x2 - x1 = distance (the sum of their radii).

    Equal and elastic they exchange their motions: x2(t) = x1 + v1 t + distance. So the gradient of the final position
    of ball 2 by (x1, x2, v1, v2) is (1, 0, t, 0): (1, 0, 1, 0) at t = 1 s, where Nimble gives (.75, .25, .91, .08)
    (github.com/keenon/nimblephysics, issue 97: distance .2, x1 = 0, x2 = .52, v1 = 1, v2 = 0).
    """
    closing = v1 - v2
    t1 = (x2 - x1 - distance) / closing
    if not 0.0 <= t1 <= t:
        raise ValueError("the balls do not meet before t")
    share = np.array([[m2, -m2], [-m1, m1]]) / (m1 + m2)
    impact = np.eye(2) - (1.0 + e) * share
    x, v = np.array([x1, x2]), np.array([v1, v2])
    after = impact @ v
    dt1 = np.array([-1.0, 1.0, -t1, t1, 0.0]) / closing
    dv = np.hstack([np.zeros((2, 2)), impact, -(share @ v)[:, None]])
    dx = np.hstack([np.eye(2), t1 * np.eye(2), np.zeros((2, 1))]) + (t - t1) * dv + np.outer(v - after, dt1)
    values = np.array([*(x + t1 * v + (t - t1) * after), *after, t1])
    return Known(("x1", "x2", "v1", "v2", "t1"), ("x1", "x2", "v1", "v2", "e"), values, np.array([*dx, *dv, dt1]))


def pendulum_at_stop(theta0: float, length: float, g: float, e: float) -> Known:
    """First and second impact time of a pendulum (point mass) released at rest at theta0 > 0, stop at theta = 0.

    With k = sin(theta0/2), K the complete elliptic integral: t1 = sqrt(l/g) K(k), t2 = t1 + 2 sqrt(l/g) K(e k),
    rate at the stop w1 = -2 sqrt(g/l) k; dK/dk = E/(k (1 - k^2)) - K/k.
    """

    def k_and_slope(k: float) -> tuple[float, float]:
        whole = float(ellipk(k * k))
        return whole, float(ellipe(k * k)) / (k * (1.0 - k * k)) - whole / k

    k, unit = math.sin(0.5 * theta0), math.sqrt(length / g)
    dk = 0.5 * math.cos(0.5 * theta0)
    (one, d_one), (two, d_two) = k_and_slope(k), k_and_slope(e * k)
    t1, flight, w1 = unit * one, 2.0 * unit * two, -2.0 * k / unit
    dt1 = np.array([unit * d_one * dk, 0.5 * t1 / length, -0.5 * t1 / g, 0.0])
    d_flight = np.array([2.0 * unit * d_two * e * dk, 0.5 * flight / length, -0.5 * flight / g, 2.0 * unit * d_two * k])
    dw1 = np.array([-2.0 * dk / unit, -0.5 * w1 / length, 0.5 * w1 / g, 0.0])
    values = np.array([t1, t1 + flight, w1])
    return Known(("t1", "t2", "w1"), ("theta0", "length", "g", "e"), values, np.array([dt1, dt1 + d_flight, dw1]))


def oscillator_at_wall(x0: float, v0: float, omega: float, wall: float, e: float, t: float) -> Known:
    """x, v at time t of x'' = -omega^2 x after one hit on a wall at x = wall, hit from above, and the hit's time t1.

    Also a pendulum in small motion before a stop, with omega^2 = g/l. R(t) = [[cos, sin/omega], [-omega sin, cos]];
    z(t) = R(t - t1) S R(t1) z0, S = diag(1, -e), and t1 = (phase + acos(wall/amplitude))/omega.
    """

    def turn(s):
        c, d = math.cos(omega * s), math.sin(omega * s)
        return np.array([[c, d / omega], [-omega * d, c]])

    def turn_by_omega(s):
        c, d = math.cos(omega * s), math.sin(omega * s)
        return np.array([[-s * d, s * c / omega - d / omega**2], [-d - omega * s * c, -s * d]])

    def rate(z):
        return np.array([z[1], -(omega**2) * z[0]])

    start = np.array([x0, v0])
    amplitude, phase = math.hypot(x0, v0 / omega), math.atan2(v0 / omega, x0)
    t1 = (phase + math.acos(wall / amplitude)) / omega
    before = turn(t1) @ start
    after = before * [1.0, -e]
    end = turn(t - t1) @ after
    back = 2.0 * math.acos(wall / math.hypot(wall, after[1] / omega)) / omega
    if not (0.0 < t1 <= t < t1 + back and before[1] < 0.0):
        raise ValueError("not between the first and the second hit")
    fixed = np.column_stack([turn(t1), turn_by_omega(t1) @ start, np.zeros((2, 2))])  # d(before) at fixed t1
    dt1 = (np.array([0.0, 0.0, 0.0, 1.0, 0.0]) - fixed[0]) / before[1]
    d_before = fixed + np.outer(rate(before), dt1)
    d_after = d_before * np.array([[1.0], [-e]])
    d_after[1, 4] -= before[1]
    d_end = turn(t - t1) @ d_after - np.outer(rate(end), dt1)
    d_end[:, 2] += turn_by_omega(t - t1) @ after
    values = np.array([*end, t1])
    return Known(("x", "v", "t1"), ("x0", "v0", "omega", "wall", "e"), values, np.array([*d_end, dt1]))


def sliding_block(v0: float, mu: float, g: float, slope: float = 0.0) -> Known:
    """Time and place [m, along the plane] where a block that slides up an incline (slope [rad]) comes to rest.

    It loses speed at a = g (mu cos + sin): t = v0/a, x = v0^2/(2 a). slope < 0: it slides down, mu > tan |slope|.
    Where mu > tan(slope) it stays there, and the state at any later time has the derivative of x, and zero for v.
    """
    c, s = math.cos(slope), math.sin(slope)
    a = g * (mu * c + s)
    if a <= 0.0 or v0 <= 0.0:
        raise ValueError("the block does not stop")
    da = np.array([0.0, g * c, a / g, g * (c - mu * s)])
    dv = np.array([1.0, 0.0, 0.0, 0.0])
    dt = dv / a - v0 / a**2 * da
    dx = v0 / a * dv - v0**2 / (2.0 * a**2) * da
    return Known(("t", "x"), ("v0", "mu", "g", "slope"), np.array([v0 / a, v0**2 / (2.0 * a)]), np.array([dt, dx]))
