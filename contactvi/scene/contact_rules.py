"""Contact data by pair: restitution and friction, and how two sides combine.

The value of a pair is, in this order: the value set for the pair; else the smaller of the values set for its two sides
(the only one if only one side has one); else the scene's default. Among values set for the same thing the last wins.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

RESTITUTION = 0.5  # of a scene that says nothing: neither plastic nor elastic
FRICTION = 0.0


@dataclass
class Rule:
    """One number per pair: a default, values of geometries, values of pairs of geometries (i < j)."""

    default: float
    single: dict[str, float] = field(default_factory=dict)
    pair: dict[tuple[str, str], float] = field(default_factory=dict)

    def set_single(self, names: Iterable[str], value: float) -> None:
        """Set the value of each geometry."""
        for name in names:
            self.single[name] = value

    def set_pair(self, first: Iterable[str], second: Iterable[str], value: float) -> None:
        """Set the value between every one of `first` and every one of `second`."""
        others = list(second)
        for a in first:
            for b in others:
                if a != b:
                    self.pair[_key(a, b)] = value

    def value(self, a: str, b: str) -> float:
        """Return the value of a pair by the combine rule."""
        own = self.pair.get(_key(a, b))
        if own is not None:
            return own
        sides = [self.single[name] for name in (a, b) if name in self.single]
        return min(sides, default=self.default)

    def values(self, pairs: Iterable[tuple[str, str]]) -> np.ndarray:
        """Return the values of many pairs, shape (npairs,)."""
        return np.array([self.value(a, b) for a, b in pairs], dtype=float)


def _key(a: str, b: str) -> tuple[str, str]:
    return (a, b) if a < b else (b, a)
