"""A value per pair of geometries, from what is set for all, for geometries, for pairs, and by the models' files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np


def smaller(values: list[Any], names: tuple[str, str]) -> Any:
    """Return the smaller one of the values of two sides."""
    return min(values)


@dataclass
class Rule:
    """One value per pair of geometries: a default, values of geometries, values of pairs.

    The value of a pair is, in this order: the one set for the pair; else what `combine` makes of those set for its two
    sides, the smaller one (the only one if only one side has one); else, in the same order, what the models' files say;
    else the default. Among values set for one thing the last one counts.

    Attributes:
        combine: Called with the values of one or two sides, and the names of both.
        single: Values of geometries by name.
        pair: Values of pairs of names, the smaller name first.
        file_single, file_pair: Those of the models' files.
    """

    default: Any
    combine: Callable[[list[Any], tuple[str, str]], Any] = smaller
    single: dict[str, Any] = field(default_factory=dict)
    pair: dict[tuple[str, str], Any] = field(default_factory=dict)
    file_single: dict[str, Any] = field(default_factory=dict)
    file_pair: dict[tuple[str, str], Any] = field(default_factory=dict)

    def set_single(self, names: Iterable[str], value: Any) -> None:
        """Set the value of each geometry."""
        for name in names:
            self.single[name] = value

    def set_pair(self, first: Iterable[str], second: Iterable[str], value: Any) -> None:
        """Set the value between every one of `first` and every one of `second`."""
        others = list(second)
        for a in first:
            for b in others:
                if a != b:
                    self.pair[_key(a, b)] = value

    def set_from_file(self, names: Sequence[str], value: Any) -> None:
        """Set the value that a model's file gives a geometry (one name) or a pair (two)."""
        if len(names) == 1:
            self.file_single[names[0]] = value
        else:
            self.file_pair[_key(*names)] = value

    def value(self, a: str, b: str) -> Any:
        """Return the value of a pair."""
        key = _key(a, b)
        for single, pair in ((self.single, self.pair), (self.file_single, self.file_pair)):
            if key in pair:
                return pair[key]
            sides = [single[name] for name in (a, b) if name in single]
            if sides:
                return self.combine(sides, (a, b))
        return self.default

    def overrides_default(self, names: Iterable[str]) -> bool:
        """Return whether no two of these geometries, of which files gave some a value, leave theirs to the default."""
        own = self.single.keys() | self.file_single.keys()
        return bool(self.file_single) and sum(name not in own for name in names) < 2

    def set(self, first: Sequence[str] | None, second: Sequence[str] | None, value: Any) -> None:
        """Set the default, the value of geometries (`first`), or that between `first` and `second`."""
        if first is None:
            self.default = value
        elif second is None:
            self.set_single(first, value)
        else:
            self.set_pair(first, second, value)

    def values(self, names: Sequence[str], pairs: np.ndarray) -> np.ndarray:
        """Return the numbers of pairs (npairs, 2), ascending indices of `names`, shape (npairs,), read only."""
        index, count = {name: k for k, name in enumerate(names)}, len(names)
        result = np.broadcast_to(float(self.default), len(pairs))  # one number, however many pairs there are
        if not (self.file_single or self.file_pair or self.single or self.pair):
            return result
        codes = pairs[:, 0].astype(np.int64) * count + pairs[:, 1]
        # From what counts least to what counts most.
        for single, pair in ((self.file_single, self.file_pair), (self.single, self.pair)):
            own = np.array([single.get(name, np.nan) for name in names] or [np.nan], dtype=float)
            sides = np.fmin(*own[pairs.T])  # that of one side where the other has none
            result = np.where(np.isnan(sides), result, sides)
            for (a, b), value in pair.items():
                if a in index and b in index:
                    i, j = sorted((index[a], index[b]))
                    at = np.searchsorted(codes, i * count + j)
                    if at < len(codes) and codes[at] == i * count + j:
                        result[at] = value
        return result


def _key(a: str, b: str) -> tuple[str, str]:
    return (a, b) if a < b else (b, a)
