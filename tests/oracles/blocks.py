"""Two blocks and a wall, elastic, exact in rational numbers: their collisions count the digits of pi.

Light block (mass 1) at rest between the wall x = 0 and the heavy block (mass 100^k) coming in.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction


@dataclass
class Hit:
    """time [s], kind 'wall' (light block at the wall) or 'blocks', velocities after."""

    time: Fraction
    kind: str
    light: Fraction
    heavy: Fraction


def collisions(k: int, light_gap=Fraction(1), heavy_gap=Fraction(1), speed=Fraction(-1)) -> list[Hit]:
    """All collisions in order. light_gap: wall to light block, heavy_gap: light to heavy block [m]."""
    m = Fraction(100**k)
    a, b = Fraction(light_gap), Fraction(heavy_gap)  # the two gaps
    u, w, t = Fraction(0), Fraction(speed), Fraction(0)  # velocities of the light and the heavy block
    hits: list[Hit] = []
    while True:
        wall = -a / u if u < 0 else None
        meet = b / (u - w) if u > w else None
        if wall is None and meet is None:
            return hits
        dt = min(x for x in (wall, meet) if x is not None)
        t, a, b = t + dt, a + u * dt, b + (w - u) * dt
        if dt == wall:
            u, kind = -u, "wall"
        else:
            mean = (u + m * w) / (1 + m)
            u, w, kind = 2 * mean - u, 2 * mean - w, "blocks"
        hits.append(Hit(t, kind, u, w))
