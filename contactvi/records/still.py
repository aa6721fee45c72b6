"""Contacts of what lies still: the engine tells them once for all steps of a span."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Span:
    """The same rows in each of several steps, one after the other.

    Attributes:
        rows: columns of one step; "t", "h" and "step" are of no account.
        first, count: number of the first step, and how many they are.
        start, dt: step k starts at start + k dt [s].
        length: of each step [s].
    """

    rows: Columns
    first: int
    count: int
    start: float
    dt: float
    length: float

    def column(self, name: str) -> NDArray[Any]:
        """Return a column of all rows, those of one step after the other."""
        column = np.asarray(self.rows[name])
        each = len(column)
        if name == "h":
            return np.full(each * self.count, self.length)
        if name in ("t", "step"):
            step = np.repeat(np.arange(self.first, self.first + self.count), each)
            return step if name == "step" else self.start + step * self.dt
        return np.tile(column, (self.count, *[1] * (column.ndim - 1)))

    def last_step(self) -> Span:
        """Return the span of the last step alone."""
        return Span(self.rows, self.first + self.count - 1, 1, self.start, self.dt, self.length)


class WithStill(Mapping[str, NDArray[Any]]):
    """Columns of contacts in the order of time; those of what lies still are added when they are asked for."""

    def __init__(self, rows: Columns | None, spans: Sequence[Span]) -> None:
        """Take the other rows, None where there are none, and at least one span."""
        self._rows, self._spans = rows, tuple(spans)
        self._columns: dict[str, NDArray[Any]] = {}

    def _joined(self, name: str) -> NDArray[Any]:
        others = [] if self._rows is None else [np.asarray(self._rows[name])]
        return np.concatenate([*others, *(span.column(name) for span in self._spans)])

    @cached_property
    def _order(self) -> NDArray[np.int64]:
        return np.argsort(self._joined("t"), kind="stable")

    def __getitem__(self, name: str) -> NDArray[Any]:
        found = self._columns.get(name)
        if found is None:
            found = self._columns[name] = self._joined(name)[self._order]
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._spans[0].rows)

    def __len__(self) -> int:
        return len(self._spans[0].rows)

    def last_steps(self) -> WithStill:
        """Return these columns with the last step of each span alone."""
        return WithStill(self._rows, [span.last_step() for span in self._spans])
