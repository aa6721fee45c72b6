"""A ball that falls on a plane and is pushed by any law f(d, d') of the depth of its overlap, by DOP853.

Nothing is assumed of the law: it is written out where the ball overlaps, cut off where it would pull, and the
integration is stopped where one of both begins or ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .event_ode import leg

Law = Callable[[float, float], float]


def dropped(law: Law, mass: float, height: float, duration: float, gravity: float = 9.81) -> tuple[float, float, int]:
    """Return gap and speed upwards at the end of a fall from rest, and how often the law began or ended to push."""

    def flight(t: float, y: np.ndarray) -> np.ndarray:
        return np.array([y[1], -gravity])

    def pushed(t: float, y: np.ndarray) -> np.ndarray:
        return np.array([y[1], law(max(-y[0], 0.0), -y[1]) / mass - gravity])

    t, y, changes = 0.0, np.array([height, 0.0]), 0
    while t < duration:
        down = leg(flight, t, y, duration, [(lambda t, y: y[0], -1)])
        t, y = down.t, down.y
        if down.event is None:
            break
        changes += 1
        # Deepest first: on the way down neither the gap nor the force comes to zero.
        deepest = leg(pushed, t, y, duration, [(lambda t, y: y[1], 1)], max_step=1e-4)
        if deepest.event is None:
            t, y = deepest.t, deepest.y
            break
        up = leg(
            pushed, deepest.t, deepest.y, duration,
            [(lambda t, y: y[0], 1), (lambda t, y: law(max(-y[0], 0.0), -y[1]), -1)], max_step=1e-4,
        )  # fmt: skip
        t, y = up.t, up.y
        if up.event is None:
            break
        changes += 1
        if up.event == 1 and y[0] < 0.0:  # the rest of the overlap is flown through
            out = leg(flight, t, y, duration, [(lambda t, y: y[0], 1)])
            t, y = out.t, out.y
    return float(y[0]), float(y[1]), changes


def lankarani_nikravesh(k: float, e: float, speed: float) -> Law:
    """Hertz's force with the damping of Lankarani and Nikravesh (J. Mech. Des. 112, 1990), at this speed."""
    return lambda d, rate: k * math.sqrt(d) * d * (1.0 + 0.75 * (1.0 - e * e) * rate / speed)
