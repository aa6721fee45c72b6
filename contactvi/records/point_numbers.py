"""Numbers of contact points: 0, 1, 2, ... within each pair, in the order in which they appear in a run.

The engine knows a point by the features of the two shapes that touch there, as one long number. Users get a short one
that is the same from step to step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

FEW = 256  # rows up to which a loop takes less time than sorting arrays, by a factor of two and more
_KEY = ("kind", "index", "point")  # columns that tell points apart
Columns = Mapping[str, NDArray[Any]]
Rows = Sequence[tuple[Columns, NDArray[np.float64]]]  # parts of what the engine reported, with their times [s]


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
        short = self._few(rows) if sum([len(time) for _, time in rows]) <= FEW else self._many(rows)
        of_changes = 0 if changes is None else len(changes["time"])
        if changes is not None:
            changes = {**changes, "point": short[:of_changes]}
        if contacts is not None:
            contacts = {**contacts, "point": short[of_changes:], "feature": contacts["point"]}
        return contacts, changes

    def _few(self, rows: Rows) -> NDArray[np.int64]:
        """Return the numbers of points, those of one instant in their order."""
        points: list[tuple[int, int, int]] = []
        times: list[float] = []
        for part, time in rows:
            points += zip(*[part[name].tolist() for name in _KEY], strict=True)
            times += time.tolist()
        short = [0] * len(points)
        for k in sorted(range(len(points)), key=times.__getitem__):
            short[k] = self._of(*points[k])
        return np.array(short, dtype=np.int64)

    def _many(self, rows: Rows) -> NDArray[np.int64]:
        """Return the same as `_few`, by sorting arrays."""
        keys = np.concatenate([np.column_stack([part[name] for name in _KEY]) for part, _ in rows])
        time = np.concatenate([time for _, time in rows])
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
