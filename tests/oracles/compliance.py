"""A ball that drops on a compliant plane, from one change of its law to the next by SciPy's DOP853, and closed forms.

Nothing of the engine is used. With the height z of the ball's lowest point the depth is d = -z, and the force
k d^n (1 + c d') where the ball is below the plane and this does not pull.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import beta

TOLERANCE = 1e-13


@dataclass
class Drop:
    """mass [kg], k [N/m^n], n, c [s/m], gravity [m/s^2]; touches: when the ball comes to the plane or leaves it [s]."""

    mass: float
    k: float
    n: float = 1.0
    c: float = 0.0
    gravity: float = 9.81
    touches: list[float] = field(default_factory=list)
    deepest: float = 0.0

    def at(self, z: float, v: float, duration: float) -> tuple[float, float]:
        """Return height and speed after a time, from z > 0."""
        self.touches.clear()
        t, pressed = 0.0, False
        while t < duration:
            if not pressed:
                rest = duration - t
                fall = (v + math.sqrt(v * v + 2.0 * self.gravity * z)) / self.gravity
                if fall >= rest:
                    return z + v * rest - 0.5 * self.gravity * rest**2, v - self.gravity * rest
                t, z, v = t + fall, 0.0, v - self.gravity * fall
            else:
                t, z, v = self._press(t, v, duration)
                if t >= duration:
                    return z, v
            self.touches.append(t)
            pressed = not pressed
        return z, v

    def _press(self, t: float, v: float, duration: float) -> tuple[float, float, float]:
        def rate(_: float, x: np.ndarray) -> list[float]:
            d = max(0.0, -x[0])
            return [x[1], self.k * d**self.n * (1.0 - self.c * x[1]) / self.mass - self.gravity]

        def opens(s: float, x: np.ndarray) -> float:
            return x[0] if x[1] > 0.0 else -1.0

        def turns(_: float, x: np.ndarray) -> float:
            return x[1]

        opens.terminal = True  # type: ignore[attr-defined]
        found = solve_ivp(
            rate, (t, duration), [0.0, v], "DOP853", events=[opens, turns], rtol=TOLERANCE, atol=1e-18,
            max_step=0.004 * self.time(abs(v)),
        )  # fmt: skip
        self.deepest = max(self.deepest, *(-x[0] for x in found.y_events[1]), 0.0)
        return float(found.t[-1]), 0.0 if found.status == 1 else float(found.y[0, -1]), float(found.y[1, -1])

    def time(self, v: float) -> float:
        """Return the duration of a contact at this speed without gravity and damping."""
        deepest = ((self.n + 1.0) * self.mass * v * v / (2.0 * self.k)) ** (1.0 / (self.n + 1.0))
        return 2.0 * deepest / v * beta(1.0 / (self.n + 1.0), 0.5) / (self.n + 1.0)


def restitution(c: float, v: float) -> float:
    """Return that of Hunt and Crossley's law without gravity, at the speed v: it depends on c v alone.

    From m v dv = -k d^n (1 + c v) dd: v - ln(1 + c v) / c is the same before and after, where v has the other sign.
    """

    def invariant(x: float) -> float:
        return x - math.log1p(x)

    start = invariant(c * v)
    return float(brentq(lambda e: invariant(-e * c * v) - start, 1e-12, 1.0 - 1e-12, xtol=1e-15)) if c > 0.0 else 1.0
