"""Where bodies touch in a run, and how strongly: what a picture of it shows in its middle and leaves in sight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactvi.records.codes import GuardKind
from contactvi.records.contacts import ContactLog

Array = NDArray[np.float64]

MOST = 60  # points of one moment that are looked at, the strongest ones


@dataclass(frozen=True)
class Touches:
    """Contact points, each over one step or in one impact.

    Attributes:
        begin, end: of the step [s] from the start of the run, (n,); equal for an impact.
        point: [m], world frame, (n, 3).
        weight: size of the impulse [N s], > 0, (n,).
    """

    begin: Array
    end: Array
    point: Array
    weight: Array

    @classmethod
    def of(cls, log: ContactLog, start: float = 0.0) -> Touches:
        """Return those of a log of contacts; start: of the run [s]."""
        weight = np.linalg.norm(log.impulse, axis=1)
        kept = (log.array("kind") == GuardKind.CONTACT) & np.isfinite(log.position).all(axis=1) & (weight > 0.0)
        begin = log.t[kept] - start
        return cls(begin, begin + log.h[kept], log.position[kept], weight[kept])

    def __len__(self) -> int:
        return len(self.weight)

    def near(self, place: Array, far: float) -> Touches:
        """Return those that are not further than `far` [m] from a place (3,)."""
        return self._rows(np.linalg.norm(self.point - place, axis=1) <= far)

    def at(self, moment: float) -> Touches:
        """Return the strongest ones at a time [s]: of the step around it, and impacts at it."""
        slack = 1e-9 * max(1.0, abs(moment))
        rows = np.flatnonzero((self.begin <= moment + slack) & (self.end >= moment - slack))
        return self._rows(np.sort(rows[np.argsort(-self.weight[rows], kind="stable")[:MOST]]))

    def moments(self, shares: tuple[float, ...]) -> list[float]:
        """Return the middles of the steps up to which so much of the whole impulse has passed, each once [s]."""
        order = np.argsort(self.begin, kind="stable")
        passed = np.cumsum(self.weight[order])
        rows = order[np.searchsorted(passed, np.array(shares) * passed[-1])]
        return [float(t) for t in np.unique(0.5 * (self.begin[rows] + self.end[rows]))]

    def center(self) -> Array:
        """Return the mean of the points, weighted by their impulses [m], (3,)."""
        return np.asarray(self.weight @ self.point / self.weight.sum())

    def _rows(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Touches:
        return Touches(self.begin[rows], self.end[rows], self.point[rows], self.weight[rows])
