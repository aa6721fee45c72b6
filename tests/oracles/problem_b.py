"""Problem B: double pendulum with absolute angles, tip against the wall x = 0.

Point masses m1 = m2 = 1 kg, l1 = l2 = 1 m, g = 9.81 m/s^2, angles from the downward vertical; mass matrix
and equations written by hand, DOP853 at rtol 1e-13, impact times by Newton on the integrated state
(not on the interpolant). Absolute angles: q = (a1, a2); a URDF has q_urdf = (a1, a2 - a1).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81
START = (0.3, 0.5)


def mass_matrix(q):
    c = np.cos(q[0] - q[1])
    return np.array([[2.0, c], [c, 1.0]])


def energy(q, w):
    return 0.5 * w @ mass_matrix(q) @ w - GRAVITY * (2.0 * np.cos(q[0]) + np.cos(q[1]))


def acceleration(q, w):
    s = np.sin(q[0] - q[1])
    force = np.array([-s * w[1] ** 2 - 2.0 * GRAVITY * np.sin(q[0]), s * w[0] ** 2 - GRAVITY * np.sin(q[1])])
    return np.linalg.solve(mass_matrix(q), force)


def tip_gap(q):
    """x coordinate of the tip [m], the gap to the wall."""
    return np.sin(q[0]) + np.sin(q[1])


def gap_gradient(q):
    return np.cos(q)


@dataclass
class Run:
    """Impacts (time, gamma_minus, impulse, q, w_minus, w_plus) and the final state."""

    q: np.ndarray
    w: np.ndarray
    impacts: list = field(default_factory=list)


def _rhs(_t, y):
    return np.concatenate([y[2:], acceleration(y[:2], y[2:])])


def _flow(y, duration):
    if duration == 0.0:
        return y
    return solve_ivp(_rhs, (0.0, duration), y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def _fall(_t, y):
    return tip_gap(y[:2])


_fall.terminal, _fall.direction = True, -1.0  # type: ignore[attr-defined]


def run(duration: float, restitution: float = 1.0, start=START, velocity=(0.0, 0.0)) -> Run:
    """Event-located motion with impulse P = -(1 + e) gamma / G_c at every hit."""
    t, y, impacts = 0.0, np.array([*start, *velocity], float), []
    while t < duration:
        s = solve_ivp(_rhs, (t, duration), y, method="DOP853", rtol=1e-13, atol=1e-14, events=_fall)
        if s.status != 1:
            y, t = s.y[:, -1], duration
            break
        k = len(s.t) - 2  # the accepted step before the event, integrated again without interpolation
        h = s.t_events[0][0] - s.t[k]
        for _ in range(8):
            yc = _flow(s.y[:, k], h)
            correction = tip_gap(yc[:2]) / (gap_gradient(yc[:2]) @ yc[2:])
            h -= correction
            if abs(correction) < 1e-15:
                break
        yc = _flow(s.y[:, k], h)
        q, w = yc[:2], yc[2:]
        jump = np.linalg.solve(mass_matrix(q), gap_gradient(q))
        gamma = gap_gradient(q) @ w
        impulse = -(1.0 + restitution) * gamma / (gap_gradient(q) @ jump)
        t = s.t[k] + h
        impacts.append((t, gamma, impulse, q, w, w + impulse * jump))
        y = np.concatenate([q, w + impulse * jump])
    return Run(y[:2], y[2:], impacts)
