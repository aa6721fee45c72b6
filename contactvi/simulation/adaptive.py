"""dt = "auto": runs a scene with steps that make q as accurate as asked, and measures how accurate it is.

A first run, the companion, chooses its steps, so that what the stage polynomials leave out of the motion stays below a
level [m, rad]; between two impacts they only become shorter. With s stages that goes with h^s, and the error of the run
with h^2s, so with the square of the level. The factor in front depends on the motion and is measured: the steps of the
next run, at a finer level, are those of the companion times one factor, so that its error is the same part of the
companion's everywhere, and the distance of the two tells how large both are. Where the error is above tol the level is
lowered by this law and the run is made again; the run before is then the companion.

Steps with persistent contacts are midpoint steps of one length, whatever the order. They are as long as the level times
a constant, so that their error goes with the square of the level too and the same comparison measures it.

The estimate is for the largest error of q over the nodes, norm of the tangent difference [m, rad]. It is no bound: it
takes the law for granted while successive distances follow it, and the whole distance where they do not. Rounding and
the tolerance of the stage equations are counted as a floor that no level can undercut. Two motions that separate
(chaos, another sequence of impacts) show as a large distance; a run that cannot meet tol ends with an AccuracyWarning.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import AccuracyWarning, PenetrationError
from contactvi.interrupts import CtrlC
from contactvi.options import STAGE_TOLS, Options
from contactvi.simulation import engine
from contactvi.simulation.compatibility import check_elements, check_map
from contactvi.simulation.recorder import Record
from contactvi.simulation.tolerances import LedgerWatch
from contactvi.status import Status, StatusCode
from contactvi.trajectory import polynomials as dense
from contactvi.trajectory.compiled import CompiledScene
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]

_RUNS = 6  # at most, besides the first companion
_START = 0.3  # level = _START sqrt(tol) to begin with
_SEEN = 0.1  # errors / level^2 of many motions lie about this
_COMPANION = 30.0  # times the error of the run, by the law
_AIM = 0.1  # of tol: where the level is set to, so low that one run more seldom follows
_LEAST = 10.0  # ratio of the errors of two runs: more is not taken for granted, though the law says so
_DISTINCT = 1.3  # ratio of errors, by the law, below which the steps of a flight are too much alike to compare
_MATTERS = 0.01  # share of a flight in the error, by the law, below which that does not matter
_FINER, _MOST = 0.6, 8.0  # length of finer steps / the shortest step; number of them / that of the steps
_FOLLOWS = 5.0  # times what the law expects: a larger distance does not follow it
_LOST = 0.1  # of the size of the motion: two runs this far apart no longer follow the same motion
_TIMES = 6  # at which two runs are compared
_STARTS = 3  # flights whose first step is looked at
_CONTACT = 3.0  # [s/m] step in contact / level: about 1e-3 s for tol = 1e-6
_CONTACT_DT = (1e-6, 2e-2)  # [s] shortest and longest one
_LEVELS = (1e-8, 3e-3)  # [m, rad]; below the first errors drown in rounding, and low orders need too many steps
_EPS = float(np.finfo(float).eps)


def run(
    compiled: CompiledScene,
    options: Options,
    q0: ArrayLike | None,
    v0: ArrayLike | None,
    progress: Callable[[float, int], object] | None,
    throw: bool,
    ctrl_c: CtrlC,
) -> Trajectory:
    """Run a scene with steps chosen for options.tol; the arguments as those of `simulate`.

    Raises:
        PenetrationError: where `throw`. Warns with AccuracyWarning where tol was not reached.
    """
    check_map(compiled, options)
    check_elements(compiled, options)
    kept = options if options.dense else replace(options, dense=True)
    search = _Search(compiled, kept, q0, v0, ctrl_c.watch(progress))
    try:
        found, estimate = search.search()
    except KeyboardInterrupt:
        found, estimate = search.stopped(), math.nan
    except PenetrationError:
        if throw:
            raise
        return search.last.trajectory(None)
    record = found.record
    record.stats = replace(record.stats, seconds=search.seconds)
    if not options.dense:  # the segments were needed for the comparison only
        record.options, record.segments = options, []
    if options.ledger:
        _check_ledger(record)
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

    def __init__(self, level: float, record: Record, simulator: _core.Simulator, dt_contact: float = math.nan) -> None:
        self.level, self.record, self.engine, self.dt_contact = level, record, simulator, dt_contact

    @property
    def steps(self) -> Array:
        """Lengths of its adaptive steps [s], one for every time at which the length changes."""
        return np.zeros(0) if self.record.adaptive_steps is None else self.record.adaptive_steps["dt"]

    @cached_property
    def segments(self) -> dict[str, Array]:
        """Its segments (contactvi.trajectory.polynomials)."""
        joined = self.record.segments_joined()
        return {name: np.zeros(0) for name in dense.FIELDS} if joined is None else joined.arrays

    @property
    def in_contact(self) -> bool:
        """Whether there were persistent contacts."""
        return bool(np.any(self.segments["persistent"]))


class _Search:
    """Looks for the level at which a run is as accurate as asked."""

    def __init__(
        self,
        compiled: CompiledScene,
        options: Options,
        q0: ArrayLike | None,
        v0: ArrayLike | None,
        progress: Callable[[float, int], object] | None,
    ) -> None:
        self._compiled, self._options, self._start, self._progress = compiled, options, (q0, v0), progress
        self._stages = options.order // 2
        self.seconds = 0.0
        self.last: Record
        self._engine: _core.Simulator | None = None

    def search(self) -> tuple[_Found, float]:
        """Return the run and its estimated error; an interrupted run as it is, with NaN."""
        tol = self._options.tol
        level = _clip(_START * math.sqrt(tol))
        companion, estimate = self._run(level * math.sqrt(_COMPANION)), math.nan
        for _ in range(_RUNS):
            if _final(companion) or not len(companion.segments["t"]):  # it ended where it started
                return companion, math.nan
            found = self._run(level, companion)
            if _final(found) or not len(found.segments["t"]):
                return found, math.nan
            estimate = self._estimate(companion, found, estimate)
            share = _AIM * tol / estimate if estimate > 0.0 else 0.0
            lower = _clip(level * math.sqrt(min(share, 1.0 / _LEAST) if share else 1.0 / _COMPANION))
            if estimate <= tol or lower >= level:
                break
            level, companion = lower, found
        return found, estimate

    def stopped(self) -> _Found:
        """Return the last run as it is, with the status INTERRUPTED; raise KeyboardInterrupt before there is one."""
        if self._engine is None:
            raise KeyboardInterrupt
        self.last.status = Status.interrupted(float(self.last.t[-1][-1]))
        return _Found(math.nan, self.last, self._engine)

    def _run(self, level: float, coarser: _Found | None = None) -> _Found:
        """Run at a level.

        The tolerance of the stage equations goes with the square of the level, as the error of the steps does, so that
        both show in the distance of two runs.

        Args:
            coarser: a run with longer steps. The steps are parts of its own, all the same part by the law.
        """
        plan, bound = None, level
        if coarser is not None and coarser.record.adaptive_steps is not None:
            steps, bound = coarser.record.adaptive_steps, coarser.level
            plan = (steps["t"], steps["dt"], (level / bound) ** (1.0 / self._stages))
        dt_contact = self._contact_dt(level)
        slack = (level / _clip(_START * math.sqrt(self._options.tol))) ** 2
        slack = max(slack, STAGE_TOLS[0] / self._options.stage_tol)
        simulator = engine.make(self._compiled, self._options, slack, dt_contact)
        self.last, refused = engine.start(simulator, self._compiled, self._options, *self._start)
        if refused is not None:
            raise refused
        self._engine = simulator
        engine.advance_auto(simulator, self.last, self._options.span, bound, plan, self._progress)
        self.seconds += self.last.stats.seconds
        return _Found(level, self.last, simulator, dt_contact)

    def _contact_dt(self, level: float) -> float:
        """Return the step in contact at a level [s]; a given number is the longest one of the run."""
        given, first = self._options.dt_contact, _clip(_START * math.sqrt(self._options.tol))
        longest = given if isinstance(given, float) else math.inf
        return min(max(min(longest, _CONTACT * first) * level / first, _CONTACT_DT[0]), _CONTACT_DT[1])

    def _estimate(self, companion: _Found, found: _Found, expected: float) -> float:
        """Estimate the error of a run from its distance to its companion, whose error is `expected` (NaN: unknown)."""
        floor, size = self._floor(found)
        floor = max(floor, _transient(found))
        if not found.record.status.ok:
            # Runs that end where impacts accumulate are compared up to there.
            same = companion.record.status.code == found.record.status.code
            return max(floor, _distance(companion.record, found.record, ended=True)) if same else math.inf
        share = max(_share(companion, found, 2 * self._stages + 1), _ratio(companion, found))
        if not math.isfinite(share):
            return max(floor, self._against_finer(found))
        distance = _distance(companion.record, found.record)
        lawful = distance < _LOST * size if not math.isfinite(expected) else distance < _FOLLOWS * expected
        return max(floor, distance * max(share, 1.0 / _LEAST) if lawful else distance)

    def _floor(self, found: _Found) -> tuple[float, float]:
        """Return what the error of a run is not below, and the size of its motion."""
        t, q, _ = found.record.nodes()
        size = float(self._compiled.states.distance(q[:1], q).max())
        solved = (_EPS + self._options.stage_tol) * size * math.sqrt(len(t))
        return max(solved, _SEEN * found.level**2), size

    def _against_finer(self, found: _Found) -> float:
        """Return the distance of a run to one with steps of one length, all shorter than its own.

        It serves runs that have steps in common with their companion, whose errors do not show in the distance to it.
        That happens where the stage iterations do not converge with longer steps, whatever the level.
        """
        if not len(found.steps) or _interrupted(found):
            return math.inf
        count = math.ceil(self._options.span / (_FINER * float(found.steps.min())))
        if count > _MOST * len(found.segments["t"]):
            return math.inf
        fixed = replace(
            self._options, dt=self._options.span / count, tol=self._options.stage_tol, ledger=None, sample_dt=None,
            dt_contact=None,
        )  # fmt: skip
        finer = min(_FINER * found.dt_contact, fixed.fixed_dt)
        simulator = engine.make(self._compiled, fixed, slack=1.0 / _COMPANION, dt_contact=finer)
        record, _ = engine.start(simulator, self._compiled, fixed, *self._start)
        engine.advance(simulator, record, count, None, self._progress)
        self.seconds += record.stats.seconds
        if record.status.code == StatusCode.INTERRUPTED:
            raise KeyboardInterrupt
        return _distance(record, found.record)


def _ratio(companion: _Found, found: _Found) -> float:
    """Return error / (companion's error - error) by the levels alone."""
    return 1.0 / ((companion.level / found.level) ** 2 - 1.0)


def _share(companion: _Found, found: _Found, power: int) -> float:
    """Return error / (companion's error - error) by the lengths h of the segments: an error is their sum of h^power.

    Lengths are counted in the adaptive steps that `found` has at the time of a segment, because the factor of the law
    has made these steps so long; with persistent contacts, in its contact steps. Where the two runs do not meet the
    same impacts but both have persistent contacts, the levels alone decide. The result is infinite where flights
    (between two impacts) that matter have almost the same segments in both runs.
    """
    steps = found.record.adaptive_steps
    if steps is None or not len(steps["t"]) or found.record.impacts != companion.record.impacts:
        return _ratio(companion, found) if found.in_contact and companion.in_contact else math.inf
    sums = []
    for run in (found, companion):
        t, h, persistent = (run.segments[name] for name in ("t", "h", "persistent"))
        k = np.clip(np.searchsorted(steps["t"], t + 0.5 * h, side="right") - 1, 0, len(steps["t"]) - 1)
        flight = np.searchsorted(run.record.impact_times(), t + 0.5 * h)
        weights = np.where(persistent != 0.0, (h / found.dt_contact) ** 3, (h / steps["dt"][k]) ** power)
        sums.append(np.bincount(flight, weights, minlength=found.record.impacts + 1))
    own, other = sums
    whole = float(own.sum())
    if np.any((other < _DISTINCT * own) & (own > _MATTERS * whole)):
        return math.inf
    return whole / (float(other.sum()) - whole)


def _transient(found: _Found) -> float:
    """Return the largest distance between a step and two halves of it, of the first ones of some flights.

    A stiff motion that damping ends within a step or two has an error there that later nodes do not show. Two runs are
    no comparison in their first step either: up to the end of the shorter one both have made one step.
    """
    segments, record = found.segments, found.record
    times = record.impact_times()
    chosen = times[np.linspace(0, len(times) - 1, _STARTS).astype(int)] if len(times) else times
    first = np.searchsorted(segments["t"], chosen)
    largest = 0.0
    for k in {0, *(int(k) for k in first if k < len(segments["t"]))}:
        if segments["persistent"][k]:
            continue
        q, p, h = segments["q"][k], segments["p"][k], float(segments["h"][k])
        p = record.compiled.core.momentum_to_public(q, p)
        whole, half = _step(record, q, p, h), _step(record, q, p, 0.5 * h)
        halves = _step(record, half[0], half[1], 0.5 * h)
        largest = max(largest, _largest(record.compiled.states.distance(whole[0][None], halves[0][None])))
    return largest


def _largest(distances: Array) -> float:
    """Return the largest distance; infinite where one is not known."""
    largest = float(distances.max())
    return largest if math.isfinite(largest) else math.inf


def _distance(other: Record, found: Record, ended: bool = False) -> float:
    """Return the largest |q - q'| of two runs at some nodes of the second; infinite where one ended much earlier.

    Args:
        ended: whether both ended before their time; then up to the earlier end.
    """
    t, q, _ = found.nodes()
    last = float(other.t[-1][-1])
    if len(t) < 2 or (not ended and abs(float(t[-1]) - last) > 1e-3 * (t[-1] - t[0])):
        return math.inf
    count = int(np.searchsorted(t, last, side="right"))  # nodes that both runs have reached
    nodes = np.unique(np.linspace(0, count - 1, _TIMES + 1)[1:].round().astype(int))
    segments = other.segments_joined()
    assert segments is not None
    states = np.array([_state(other, segments, float(t[node])) for node in nodes])
    return _largest(found.compiled.states.distance(states, q[nodes]))


def _state(run: Record, pieces: dense.Segments, time: float) -> Array:
    """Return q of a run at a time [s] as accurate as its nodes: by the partial step that its polynomial stands for."""
    segments = pieces.arrays
    k = max(0, int(segments["t"].searchsorted(time, side="right")) - 1)
    if segments["persistent"][k]:
        return np.asarray(pieces.states(run.compiled.core, np.array([time]))[0][0])
    q: Array = segments["q"][k]
    h = min(time - float(segments["t"][k]), float(segments["h"][k]))
    if h <= 0.0:
        return q
    return _step(run, q, run.compiled.core.momentum_to_public(q, segments["p"][k]), h)[0]


def _step(run: Record, q: Array, p: Array, h: float) -> tuple[Array, Array]:
    """Return (q, p) after a smooth step h [s] of the run's order, in parts where the whole one does not converge."""
    options = run.options
    for parts in (1, 2, 4, 8, 16):
        try:
            q1, p1 = q, p
            for _ in range(parts):
                found = run.compiled.core.step(q1, p1, h / parts, None, options.stage_tol, options.order)
                q1, p1 = found[0], found[1]
            return q1, p1
        except RuntimeError:  # EngineError is one
            continue
    return np.full_like(q, np.nan), np.full_like(p, np.nan)


def _check_ledger(record: Record) -> None:
    """Check the run against the tolerances of its ledger; where one is exceeded the run ends there."""
    excess = LedgerWatch(record.options.ledger or {}).check(record.ledger())
    if excess is not None:
        record.status = Status(StatusCode.LEDGER, str(excess), excess.time)
        record.cut(excess.time)


def _interrupted(found: _Found) -> bool:
    return found.record.status.code == StatusCode.INTERRUPTED


def _final(found: _Found) -> bool:
    """Return whether no finer run is to be made: the user has stopped this one, or finer ones would end earlier."""
    return _interrupted(found) or found.record.status.code == StatusCode.TOO_MANY_STEPS


def _clip(level: float) -> float:
    return min(max(level, _LEVELS[0]), _LEVELS[1])
