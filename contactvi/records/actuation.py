"""What the motors of a run were asked for: generalized forces, and references of servos, in the course of time."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SLACK = 1e-6  # of a step: a node at its end may be some digits early, and belongs to the step after it


class Actuation:
    """Grows by each call of the engine; rows of steps of one length, or references as a function of time.

    Attributes:
        known: whether it holds all that was asked for; not of runs that keep no record, or only that of their last
            steps, and of single steps that the engine recorded by itself.
        references: of a run that chooses its steps, (1, 2 nv) or a function t -> (2 nv,).
    """

    def __init__(self, dt: float, known: bool = True) -> None:
        """dt: length of a step [s]; NaN where they have several."""
        self.known, self._dt = known, dt
        self.references: Array | Callable[[float], Array] | None = None
        self._blocks: list[tuple[float, Array | None, Array | None]] = []  # with the time at which each begins

    def add(self, t: float, control: Array | None, target: Array | None) -> None:
        """Take over what is asked from t [s] on: forces (steps, nv), references of servos (steps, 2 nv), or None."""
        if not self.known or (control is None and target is None and not self._blocks):
            return
        self._blocks.append((t, _shortened(control), _shortened(target)))

    def add_unseen(self, asked: bool) -> None:
        """Take over steps of which nothing is told here; asked: whether they had inputs."""
        self.known = self.known and not asked and not self._blocks

    @property
    def empty(self) -> bool:
        """Whether nothing was asked for, not even that servos hold."""
        return self.references is None and not self._blocks

    def rows(self, t: Array) -> tuple[Array | None, Array | None]:
        """Return forces (N, nv) and references (N, 2 nv) at times t (N,) [s], those of the step that begins there.

        After the last step they are those of the last one. None: none were given.
        """
        if self.references is not None:
            given = self.references
            if callable(given):
                return None, np.array([given(float(time)) for time in t])
            return None, np.repeat(given, len(t), axis=0)
        if not self._blocks:
            return None, None
        starts = np.array([block[0] for block in self._blocks])
        block = np.maximum(np.searchsorted(starts, t + _SLACK * self._dt, side="right") - 1, 0)
        step = np.floor((t - starts[block]) / self._dt + _SLACK).astype(np.int64)
        return _chosen(self._blocks, 1, block, step), _chosen(self._blocks, 2, block, step)

    def copy(self) -> Actuation:
        """Return a copy that grows on its own."""
        twin = copy.copy(self)
        twin._blocks = list(self._blocks)
        return twin


def _shortened(rows: Array | None) -> Array | None:
    """Return rows that are all the same as one: it counts for all later steps."""
    if rows is None or len(rows) < 2 or not np.array_equal(rows[0], rows[-1]) or np.any(rows != rows[0]):
        return rows
    return rows[:1].copy()


def _chosen(blocks: list[tuple[Any, ...]], part: int, block: NDArray[np.int64], step: NDArray[np.int64]) -> Any:
    width = next((rows[part].shape[1] for rows in blocks if rows[part] is not None), None)
    if width is None:
        return None
    found = np.zeros((len(block), width))
    for k in np.unique(block):
        rows = blocks[k][part]
        if rows is not None:
            here = block == k
            found[here] = rows[np.clip(step[here], 0, len(rows) - 1)]
    return found
