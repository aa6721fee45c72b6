"""Reference for problem B that shares nothing with the engine: closed-form equations in absolute angles, DOP853.

Mass matrix [[2, c], [c, 1]] with c = cos(a1 - a2); between the impacts an order-8 Runge-Kutta method at the tolerance
asked for, each impact located by Newton on the integrated (not the interpolated) state, then the exact elastic jump.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
_G = 9.81
_NEWTON_STEPS = 8
_NEWTON_STOP = 1e-15  # [s]: no smaller correction of a time of order 1 can be represented much finer


@dataclass
class Impact:
    """time [s], normal speed before gamma_minus [m/s], impulse [N s]."""

    time: float
    gamma_minus: float
    impulse: float


@dataclass
class Reference:
    """Absolute angles q (N, 2) [rad] and rates w (N, 2) [rad/s] at times t (N,) [s], and the impacts up to then."""

    t: Array
    q: Array
    w: Array
    impacts: list[Impact] = field(default_factory=list)


def energy(q: Array, w: Array) -> float:
    """Return T + V [J]."""
    kinetic = w[0] ** 2 + 0.5 * w[1] ** 2 + math.cos(q[0] - q[1]) * w[0] * w[1]
    return float(kinetic - _G * (2.0 * math.cos(q[0]) + math.cos(q[1])))


def reference(start: Array, times: ArrayLike, rtol: float = 1e-13) -> Reference:
    """Return the motion from rest at the absolute angles `start`, shape (2,) [rad], at increasing times [s] from 0."""
    times = np.asarray(times, dtype=np.float64)
    y, t, end = np.array([*start, 0.0, 0.0]), 0.0, float(times[-1])
    states = np.empty((len(times), 4))
    impacts: list[Impact] = []
    while True:
        wanted = times[times >= t] if not impacts else times[times > t]
        settings = {"method": "DOP853", "rtol": rtol, "atol": 0.1 * rtol}
        part = solve_ivp(_rate, (t, end), y, events=_tip_event, dense_output=True, **settings)
        hit = part.status == 1
        time = t
        if hit:
            k = len(part.t) - 2  # the last accepted step before the event
            time, before = _locate(part.y[:, k], float(part.t[k]), float(part.t_events[0][0]), settings)
        wanted = wanted[wanted <= time] if hit else wanted
        if len(wanted):
            states[np.searchsorted(times, wanted)] = part.sol(wanted).T
        if not hit:
            states[-1] = part.y[:, -1]
            return Reference(times, states[:, :2], states[:, 2:], impacts)
        y, impact = _bounce(before, time)
        impacts.append(impact)
        t = time


def _rate(_t: float, y: Array) -> list[float]:
    """Return d(a1, a2, w1, w2)/dt: M(a) w' = f solved by hand."""
    c, s = math.cos(y[0] - y[1]), math.sin(y[0] - y[1])
    f1 = -s * y[3] ** 2 - 2.0 * _G * math.sin(y[0])
    f2 = s * y[2] ** 2 - _G * math.sin(y[1])
    det = 2.0 - c * c
    return [y[2], y[3], (f1 - c * f2) / det, (2.0 * f2 - c * f1) / det]


def _tip(y: Array) -> float:
    """Return the gap: x of the tip [m]."""
    return math.sin(y[0]) + math.sin(y[1])


def _tip_speed(y: Array) -> float:
    return float(math.cos(y[0]) * y[2] + math.cos(y[1]) * y[3])


def _tip_event(_t: float, y: Array) -> float:
    return _tip(y)


_tip_event.terminal, _tip_event.direction = True, -1.0  # type: ignore[attr-defined]


def _locate(y: Array, t: float, guess: float, settings: dict[str, Any]) -> tuple[float, Array]:
    """Return the time of the impact and the state there, from the state y at t < guess."""
    time = guess
    for _ in range(_NEWTON_STEPS):
        state = solve_ivp(_rate, (t, time), y, **settings).y[:, -1]
        correction = _tip(state) / _tip_speed(state)
        if abs(correction) <= _NEWTON_STOP:
            break
        time -= correction
    return time, state


def _bounce(y: Array, time: float) -> tuple[Array, Impact]:
    """Return the state after the elastic impact: w+ = w- + P M^-1 W, P = -2 gamma / (W M^-1 W^T)."""
    w1, w2 = math.cos(y[0]), math.cos(y[1])
    c = math.cos(y[0] - y[1])
    det = 2.0 - c * c
    response = np.array([(w1 - c * w2) / det, (2.0 * w2 - c * w1) / det])
    gamma = _tip_speed(y)
    impulse = -2.0 * gamma / (w1 * response[0] + w2 * response[1])
    return np.array([y[0], y[1], *(y[2:] + impulse * response)]), Impact(time, gamma, impulse)
