"""Numbers of contact points: 0, 1, 2, ... within each pair, in the order in which they appear in a run.

The engine knows a point by the features of the two shapes that touch there, as one long number. Users get a short one
that is the same from step to step.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

FEW = 256  # rows up to which a loop takes less time than sorting arrays, by a factor of two and more
Columns = Mapping[str, NDArray[Any]]


class PointNumbers:
    """The numbers that were given so far; they depend on the run and not on the calls in which it is reported."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, int, int], int] = {}  # kind, index, feature
        self._count: dict[tuple[int, int], int] = {}  # kind, index

    def copy(self) -> PointNumbers:
        """Return a copy that grows on its own."""
        twin = PointNumbers()
        twin._known, twin._count = dict(self._known), dict(self._count)
        return twin

    def number(self, contacts: Columns | None, changes: Columns | None) -> tuple[Columns | None, Columns | None]:
        """Return what the engine reported of a time with short numbers as "point", of contacts the long as "feature".

        Args:
            contacts, changes: columns of the engine, "point" holds its long numbers; None where there are none.
        """
        # At one instant changes come first: a contact begins before the step that it takes part in.
        parts = [(changes, "time"), (contacts, "t")]
        rows = [(part, part[time]) for part, time in parts if part is not None and len(part[time])]
        short = self._short(
            np.concatenate([np.column_stack([part[name] for name in ("kind", "index", "point")]) for part, _ in rows]),
            np.concatenate([time for _, time in rows]),
        ) if rows else np.zeros(0, dtype=np.int64)  # fmt: skip
        of_changes = 0 if changes is None else len(changes["time"])
        if changes is not None:
            changes = {**changes, "point": short[:of_changes]}
        if contacts is not None:
            contacts = {**contacts, "point": short[of_changes:], "feature": contacts["point"]}
        return contacts, changes

    def _short(self, keys: NDArray[np.int64], time: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the numbers (m,) of points (m, 3), which appear at these times (m,) [s], at one instant in order."""
        if len(keys) <= FEW:
            few, points = [0] * len(keys), keys.tolist()
            for k in np.argsort(time, kind="stable").tolist():
                few[k] = self._of(*points[k])
            return np.array(few, dtype=np.int64)
        guard = keys[:, 1] * 2 + keys[:, 0]
        feature, of_feature = np.unique(keys[:, 2], return_inverse=True)
        _, of_point = np.unique(guard * len(feature) + of_feature.reshape(-1), return_inverse=True)
        rank = np.empty(len(keys), dtype=np.int64)
        rank[np.argsort(time, kind="stable")] = np.arange(len(keys))
        first = np.full(int(of_point.max()) + 1, len(keys))
        np.minimum.at(first, of_point, rank)
        row = np.empty(len(keys), dtype=np.int64)
        row[rank] = np.arange(len(keys))
        numbers = np.empty(len(first), dtype=np.int64)
        for k in np.argsort(first):
            numbers[k] = self._of(*map(int, keys[row[first[k]]]))
        return numbers[of_point]

    def _of(self, kind: int, index: int, feature: int) -> int:
        known = self._known.get((kind, index, feature))
        if known is None:
            known = self._known[kind, index, feature] = self._count.get((kind, index), 0)
            self._count[kind, index] = known + 1
        return known
