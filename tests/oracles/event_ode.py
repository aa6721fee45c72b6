"""Smooth motion up to an event, with the event's time and state as accurate as the integration itself.

DOP853 (Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", 1993) finds the step in which an event's
function changes its sign; its interpolation is of lower order than its steps, so the event is then polished: the last
step is integrated again up to the event, followed by Newton's iterations on the time, each with a short integration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

Rhs = Callable[[float, np.ndarray], np.ndarray]
Event = Callable[[float, np.ndarray], float]

RTOL = 1e-13


@dataclass(frozen=True)
class Leg:
    """End (t, y) of a smooth piece, the index of the event that ended it (None: the final time), and its dense form."""

    t: float
    y: np.ndarray
    event: int | None
    dense: Callable[[float], np.ndarray]


def flow(rhs: Rhs, t0: float, y0: np.ndarray, t1: float, rtol: float = RTOL, atol: float = 1e-16) -> np.ndarray:
    """y(t1), where y(t0) = y0 and y' = rhs(t, y)."""
    if t1 == t0:
        return np.array(y0, dtype=float)
    return solve_ivp(rhs, (t0, t1), y0, method="DOP853", rtol=rtol, atol=atol).y[:, -1]


def leg(
    rhs: Rhs,
    t0: float,
    y0: Sequence[float] | np.ndarray,
    t1: float,
    events: Sequence[tuple[Event, int]] = (),
    rtol: float = RTOL,
    atol: float = 1e-16,
    max_step: float = np.inf,
) -> Leg:
    """From (t0, y0) to t1, or to the first of the events (function, direction of its crossing), whichever is first."""
    watched = []
    for function, direction in events:

        def watch(t: float, y: np.ndarray, function: Event = function) -> float:
            return function(t, y)

        watch.terminal, watch.direction = True, direction
        watched.append(watch)
    found = solve_ivp(
        rhs,
        (t0, t1),
        np.asarray(y0, dtype=float),
        method="DOP853",
        events=watched or None,
        rtol=rtol,
        atol=atol,
        max_step=max_step,
        dense_output=True,
    )
    if found.status < 0:
        raise ArithmeticError(found.message)
    if found.status == 0:
        return Leg(t1, found.y[:, -1], None, found.sol)
    index = next(i for i, times in enumerate(found.t_events) if len(times))
    function = events[index][0]
    t = float(found.t[-1])
    y = flow(rhs, float(found.t[-2]), found.y[:, -2], t, rtol, atol)
    for _ in range(4):
        rate, value, step = rhs(t, y), function(t, y), 1e-7 * max(t - float(found.t[-2]), 1e-12)
        slope = (function(t + step, y + step * rate) - function(t - step, y - step * rate)) / (2.0 * step)
        if slope == 0.0 or value == 0.0:
            break
        new = t - value / slope
        if not abs(new - t) <= 1e-3 * abs(t - float(found.t[-2])) + 1e-12:
            break  # a tangential crossing: the interpolated time is as good
        t, y = new, flow(rhs, t, y, new, rtol, atol)
    return Leg(float(t), y, index, found.sol)
