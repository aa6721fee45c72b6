"""Contact forces in a playback: which arrows show when, where and how long. Knows nothing of meshcat.

An arrow belongs to one contact point as long as the point carries a force, then to another one. It starts at the point
and shows the mean force of the step, friction included, on the body that can move more freely. World frame, run time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contactvi.playback.animation import Run, drawn_side
from contactvi.records.contacts import ContactLog

Array = NDArray[np.float64]

MAX_ARROWS = 32  # at the same time: the fingers of a hand or two boxes on their faces
MAX_KEYS = 60_000  # arrows x frames, 40 bytes each: about 3 MB of the page
_WEAK = 0.01  # of the full force: weaker forces are not drawn
_CUT = 1.5  # times the full length: the longest arrow
_FULL = 0.98  # share of the forces up to the full force: peaks at touch-down do not set the scale


@dataclass
class Arrow:
    """One arrow: keys in the order of time, (k,) each; where it is not shown it keeps the last point and force.

    Attributes:
        time: [s].
        shown: from then on.
        point: [m], (3,).
        force: [N], (3,).
    """

    time: list[float] = field(default_factory=list)
    shown: list[bool] = field(default_factory=list)
    point: list[Array] = field(default_factory=list)
    force: list[Array] = field(default_factory=list)

    def add(self, time: float, shown: bool, point: Array, force: Array) -> None:
        """Add a key."""
        self.time.append(time)
        self.shown.append(shown)
        self.point.append(point)
        self.force.append(force)


@dataclass(frozen=True)
class Forces:
    """The arrows of a run.

    Attributes:
        arrows: as many as are shown at a time.
        full: force that has the full length [N].
        hidden: number of points and frames for which no arrow was free.
    """

    arrows: list[Arrow]
    full: float
    hidden: int = 0

    def length(self, arrow: Arrow) -> Array:
        """Return the lengths of an arrow at its keys, 1 for the full length, shape (k,)."""
        return np.asarray(np.minimum(np.linalg.norm(np.array(arrow.force), axis=1) / self.full, _CUT), dtype=float)

    @property
    def reference(self) -> float:
        """A round force not above the full one [N], for a legend: 1, 2 or 5 times a power of ten."""
        power = 10.0 ** np.floor(np.log10(self.full))
        return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= self.full * (1.0 + 1e-12)) * power)


def forces_of(run: Run, times: Array) -> Forces | None:
    """Return the arrows at the frames of a run, `times` (F,) [s], run time; None without persistent contact."""
    log = run.contacts
    strength = np.linalg.norm(log.force, axis=1)
    drawn = (log.array("kind") == 0) & log.has_force & (strength > 0.0) & np.isfinite(log.position).all(axis=1)
    if not drawn.any() or len(times) < 2:
        return None
    frame, row = _seen(log, np.flatnonzero(drawn), times)
    if not len(row):
        return None
    full = float(np.quantile(strength[row], _FULL))
    strong = strength[row] >= _WEAK * full
    frame, row = frame[strong], row[strong]
    every = int(np.ceil(len(row) / MAX_KEYS))
    if every > 1:
        kept = frame % every == 0
        frame, row, times = frame[kept] // every, row[kept], times[::every]
    index = np.unique(log.array("index")[row])
    side = np.zeros(int(index.max()) + 1)
    side[index] = [drawn_side(run.scene, int(k)) for k in index]
    force = side[log.array("index")[row], None] * log.force[row]
    return _assigned(times, frame, _keys(log, row), log.position[row], force, full)


def _seen(log: ContactLog, rows: NDArray[np.int64], times: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (frame, row) of every row that acts at a frame, frame by frame, the strongest row first."""
    first = np.searchsorted(times, log.t[rows])
    after = np.searchsorted(times, log.end[rows])
    slack = 1e-9 * max(1.0, abs(float(times[-1])))
    after[log.end[rows] >= times[-1] - slack] = len(times)  # the last frame is the end of the last step
    count = np.maximum(after - first, 0)
    frame = np.repeat(first, count) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    row = np.repeat(rows, count)
    order = np.lexsort((-np.linalg.norm(log.impulse[row], axis=1), frame))
    return frame[order], row[order]


def _keys(log: ContactLog, row: NDArray[np.int64]) -> list[tuple[int, int]]:
    return list(zip(log.array("index")[row].tolist(), log.array("point")[row].tolist(), strict=True))


def _assigned(
    times: Array, frame: NDArray[np.int64], keys: list[tuple[int, int]], point: Array, force: Array, full: float
) -> Forces:
    """Give every contact point of every frame an arrow; a released arrow is hidden for a frame before its next use."""
    arrows: list[Arrow] = []
    in_use: dict[tuple[int, int], int] = {}  # contact point -> arrow
    free: list[int] = []
    hidden = 0
    for now, rows in _by_frame(frame, len(times)):
        time = float(times[now])
        active = {keys[k]: k for k in rows}
        gone = [key for key in in_use if key not in active]
        for key in gone:
            arrow = arrows[in_use[key]]
            arrow.add(time, False, arrow.point[-1], arrow.force[-1])
        for key, k in active.items():
            if key not in in_use:
                if free:
                    in_use[key] = free.pop()
                elif len(arrows) < MAX_ARROWS:
                    in_use[key] = len(arrows)
                    arrows.append(Arrow())
                else:
                    hidden += 1
                    continue
            arrows[in_use[key]].add(time, True, point[k], force[k])
        free += [in_use.pop(key) for key in gone]
    return Forces(arrows, full, hidden)


def _by_frame(frame: NDArray[np.int64], count: int) -> Iterator[tuple[int, range]]:
    """Yield each frame that has rows, and the frames right after them, with the places of its rows."""
    starts = np.searchsorted(frame, np.arange(count + 1))
    filled = np.diff(starts) > 0
    filled[1:] |= filled[:-1]
    for now in np.flatnonzero(filled):
        yield int(now), range(int(starts[now]), int(starts[now + 1]))
