"""dt = "auto": runs a scene with steps that make q as accurate as asked, and measures how accurate it is.

The engine keeps the step constant on each arc between impacts, so that its truncation indicator (how much of the motion
the stage polynomial leaves out, relative) stays below a level; the error of the run goes with level**(2s / (s - 1)), s
stages. The factor in front depends on the motion and is measured, by a companion: a run with a coarser level. Its
distance from the run is the companion's own error, and the run's error is that divided by the ratio of the law. Where
this is above tol the level is lowered by the law and the run made again; the one before is then the companion.

The estimate is for the largest error of q over the nodes, norm of the tangent difference [m, rad]. It is no bound: it
takes the law for granted while successive distances follow it, and the whole distance where they do not. Rounding and
the tolerance of the stage equations are counted as a floor that no level can undercut. Motions that part for good
(chaos, another sequence of impacts) show as a large distance; a run that cannot meet tol ends with an AccuracyWarning.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from contactvi import engine
from contactvi.errors import AccuracyWarning, PenetrationError
from contactvi.ledger import Ledger, Watch
from contactvi.options import Options
from contactvi.prepared import Prepared
from contactvi.record import Record
from contactvi.status import Status, StatusCode
from contactvi.trajectory import Trajectory

Array = NDArray[np.float64]

ROUNDS = 4
COMPANION = 30.0  # times the error of the run, by the law
_AIM = 0.3  # of tol: where the level is set to
_LEAST = 10.0  # ratio of two runs, so that their distance is the coarser one's error
_FOLLOWS = 5.0  # times what the law expects: more is not the law
_LOST = 0.1  # of the size of the motion: two runs this far apart no longer follow the same motion
_TIMES = 16  # at which two runs are compared
_LEVELS = (1e-12, 0.3)
_EPS = float(np.finfo(float).eps)


def run(
    prepared: Prepared,
    options: Options,
    q0: ArrayLike | None,
    v0: ArrayLike | None,
    progress: Callable[[float, int], object] | None,
    throw: bool,
) -> Trajectory:
    """Run a scene with steps chosen for options.tol; the arguments as those of `simulate`.

    Raises PenetrationError where `throw`. Warns with AccuracyWarning where tol was not reached.
    """
    search = _Search(prepared, options if options.dense else replace(options, dense=True), q0, v0, progress)
    try:
        found, estimate = search.search()
    except PenetrationError:
        if throw:
            raise
        return search.last.trajectory(None)
    record = found.record
    record.stats = replace(record.stats, seconds=search.seconds)
    if not options.dense:  # its segments were needed for the comparison only
        record.options, record.segments = options, []
    if options.ledger:
        _watch(record)
    traj = record.trajectory(found.engine, estimate)
    if record.status.ok and not estimate <= options.tol:
        warnings.warn(
            f"The accuracy asked of q was not reached: tol = {options.tol:.3g}, estimated error {estimate:.3g}. Chaotic"
            " motion limits it: ask for a shorter duration or a larger tol",
            AccuracyWarning,
            stacklevel=4,
        )
    return traj


class _Found:
    """A run at a level: its record, and the engine at its end."""

    def __init__(self, level: float, record: Record, simulator: Any) -> None:
        self.level, self.record, self.engine = level, record, simulator


class _Search:
    """Looks for the level at which a run is as accurate as asked."""

    def __init__(
        self, prepared: Prepared, options: Options, q0: Any, v0: Any, progress: Callable[[float, int], object] | None
    ) -> None:
        self._prepared, self._options, self._start, self._progress = prepared, options, (q0, v0), progress
        stages = options.order // 2
        self._power = 2.0 * stages / (stages - 1.0)
        self.seconds = 0.0
        self.last: Record

    def search(self) -> tuple[_Found, float]:
        """Return the run and its estimated error; an interrupted run as it is, with NaN."""
        tol = self._options.tol
        level = _clip(tol ** (1.0 / self._power))
        companion = self._run(_clip(level * COMPANION ** (1.0 / self._power)))
        estimate = math.nan
        for _ in range(ROUNDS):
            if _interrupted(companion):
                return companion, math.nan
            found = self._run(level, companion)
            if _interrupted(found):
                return found, math.nan
            estimate = self._estimate(companion, found, estimate)
            if estimate <= tol:
                break
            share = _AIM * tol / estimate if math.isfinite(estimate) and estimate > 0 else 0.0
            lower = _clip(level * min(share, 1.0 / _LEAST) ** (1.0 / self._power)) if share else _clip(0.1 * level)
            if lower >= level:
                break
            level, companion = lower, found
        return found, estimate

    def _run(self, level: float, before: _Found | None = None) -> _Found:
        """Run at a level; the one before says how long the first step may be."""
        guess = None
        if before is not None and before.record.arcs is not None and len(before.record.arcs["dt"]):
            stages = self._options.order // 2
            guess = float(before.record.arcs["dt"][0]) * (level / before.level) ** (1.0 / (stages - 1.0))
        simulator = engine.make(self._prepared, self._options, guess)
        self.last, refused = engine.start(simulator, self._prepared, self._options, *self._start)
        if refused is not None:
            raise refused
        engine.take(self.last, engine.call(simulator.run_auto, self._options.span, level, self._progress))
        self.seconds += self.last.stats.seconds
        return _Found(level, self.last, simulator)

    def _estimate(self, companion: _Found, found: _Found, expected: float) -> float:
        """Estimate the error of a run from its distance to its companion, whose error is expected so large (or NaN)."""
        t, q, _ = found.record.nodes()
        end, other = float(t[-1]), float(companion.record.t[-1][-1])
        if abs(end - other) > 1e-3 * (end - t[0]):
            return math.inf  # one of them ended early, so nothing is known of the rest
        distance, size = _distance(self._prepared, companion.record, found.record)
        floor = (_EPS + self._options.stage_tol) * max(size, _EPS) * math.sqrt(len(t))
        ratio = (companion.level / found.level) ** self._power
        lawful = distance < _LOST * size if math.isnan(expected) else distance < _FOLLOWS * expected
        return max(floor, distance / (ratio - 1.0) if lawful else distance)


def _distance(prepared: Prepared, companion: Record, found: Record) -> tuple[float, float]:
    """Return the largest |q - q'| of two runs at some nodes of the second, and the size of its motion."""
    t, q, _ = found.nodes()
    last = min(float(t[-1]), float(companion.t[-1][-1]))
    count = int(np.searchsorted(t, last, side="right"))  # nodes that both runs have reached
    nodes = np.unique(np.linspace(1, max(1, count - 1), _TIMES).round().astype(int))
    model = prepared.built.model
    segments = companion.segments_joined()
    largest = size = 0.0
    for node in nodes[nodes < len(t)]:
        other = _state(prepared, companion.options, segments, float(t[node]))
        largest = max(largest, _apart(model, q[node], other))
        size = max(size, _apart(model, q[0], q[node]))
    return largest, size


def _state(prepared: Prepared, options: Options, segments: Any, time: float) -> Array:
    """Return q of a run at a time [s] as accurate as its nodes: by the partial step that its polynomial stands for."""
    arrays = segments.arrays
    k = max(0, int(np.searchsorted(arrays["t"], time, side="right")) - 1)
    h = min(time - float(arrays["t"][k]), float(arrays["h"][k]))
    if h <= 0.0:
        return np.asarray(arrays["q"][k])
    found = engine.call(prepared.core.step, arrays["q"][k], arrays["p"][k], h, None, options.stage_tol, options.order)
    return np.asarray(found[0])


def _apart(model: pin.Model, a: Array, b: Array) -> float:
    if model.nq == model.nv:
        return float(np.linalg.norm(b - a))
    return float(np.linalg.norm(pin.difference(model, a, b)))


def _watch(record: Record) -> None:
    """Hold the run to the tolerances of its ledger; where one is exceeded it ends there."""
    t, q, p = record.nodes()
    prepared, options = record.prepared, record.options
    ledger = Ledger(
        prepared.core, options, t, q, p, record.log(), damping=prepared.damping, forced=False, start=record.start
    )
    excess = Watch(options.ledger or {}).check(ledger)
    if excess is not None:
        record.status = Status(StatusCode.LEDGER, str(excess), excess.time)
        record.cut(excess.time)


def _interrupted(found: _Found) -> bool:
    return found.record.status.code == StatusCode.INTERRUPTED


def _clip(level: float) -> float:
    return min(max(level, _LEVELS[0]), _LEVELS[1])
