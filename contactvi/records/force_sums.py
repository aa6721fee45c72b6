"""Sums of contact forces over the steps of a run, for curves over time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactvi.records.rows import Array

# A part of a step that is shorter, as a share of the longest, has no force that means something: an impulse of the size
# of rounding, divided by almost no time.
BRIEF = 1e-3
_WHOLE = 0.5  # of the longest part of its step: from this length on parts are a step of a curve


def mean_forces(
    t: Array, h: Array, step: NDArray[np.int64], impulse: Array, zeros: bool = False
) -> tuple[Array, Array]:
    """Return the middles (k,) [s] of steps in contact and the mean force (k, 3) [N] over each.

    Changes of contacts cut a step into parts, some of them as short as rounding. The parts of a step are joined until
    they are at least half as long as its longest part, and the force is the sum of their impulses over the time of
    contact. Steps whose contact is shorter than BRIEF of the longest have no force.

    Args:
        t, h: starts and lengths > 0 of the parts [s], (m,), one for each contact point.
        step: the steps to which they belong, (m,).
        impulse: over the parts [N s], (m, 3).
        zeros: add force 0 at both ends of each time without contact between two steps.
    """
    order = np.lexsort((step, t))
    t, h, step, impulse = t[order], h[order], step[order], impulse[order]
    if not len(t):
        return np.zeros(0), np.zeros((0, 3))
    # Points of one part have one start; parts of separate islands overlap, and are not torn apart.
    reached = np.concatenate([[-np.inf], np.maximum.accumulate(t + h)[:-1]])
    later = t > np.concatenate([[-np.inf], t[:-1]])
    first = np.flatnonzero(later & (t >= reached - 4.0 * np.spacing(np.abs(t))) | _new(step))
    start, end = t[first], np.maximum.reduceat(t + h, first)
    overlap = np.maximum.reduceat(t, first) > start
    length = np.where(overlap, end - start, np.maximum.reduceat(h, first))
    total = np.add.reduceat(impulse, first, axis=0)
    joined = _joined(step[first], length)
    length, total = np.add.reduceat(length, joined), np.add.reduceat(total, joined, axis=0)
    begin, end = start[joined], np.maximum.reduceat(end, joined)
    kept = length > BRIEF * length.max()
    begin, end, force = begin[kept], end[kept], total[kept] / length[kept, None]
    middle = 0.5 * (begin + end)
    if not zeros:
        return middle, force
    apart = np.flatnonzero(begin[1:] - end[:-1] > BRIEF * length.max())
    places = np.repeat(apart + 1, 2)
    ends = np.column_stack([end[apart], begin[apart + 1]]).ravel()
    return np.insert(middle, places, ends), np.insert(force, places, 0.0, axis=0)


def _new(step: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.concatenate([[True], step[1:] != step[:-1]])


def _joined(step: NDArray[np.int64], length: Array) -> NDArray[np.int64]:
    """Return the first parts of those that are joined, (k,); parts are in the order of time."""
    of_step = np.cumsum(_new(step)) - 1
    longest = np.maximum.reduceat(length, np.flatnonzero(_new(step)))[of_step]
    whole = (length >= _WHOLE * longest).tolist()
    if all(whole):
        return np.arange(len(length))
    first: list[int] = []
    open_length, last_step = np.inf, -1
    for k, (part, its_step, most) in enumerate(zip(length.tolist(), of_step.tolist(), longest.tolist(), strict=True)):
        if its_step != last_step or open_length >= _WHOLE * most:
            first.append(k)
            open_length = 0.0
        open_length += part
        last_step = its_step
    return _without_rests(np.array(first), of_step, longest, length)


def _without_rests(
    first: NDArray[np.int64], of_step: NDArray[np.int64], longest: Array, length: Array
) -> NDArray[np.int64]:
    """Return `first` without what is left at the ends of steps, which goes to the parts before."""
    total = np.add.reduceat(length, first)
    rest = (total < _WHOLE * longest[first]) & ~_new(of_step[first])
    return first[~rest]
