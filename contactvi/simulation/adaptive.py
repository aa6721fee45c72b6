"""dt = "auto": runs a scene with steps that make q as accurate as asked, and measures how accurate it is.

A first run, the companion, chooses its steps, so that what the stage polynomials leave out of the motion stays below a
level [m, rad]; between two impacts they only become shorter. With s stages that goes with h^s, and the error of the run
with h^2s, so with the square of the level. The factor in front depends on the motion and is measured: the steps of the
next run, at a finer level, are those of the companion times one factor, so that its error is the same part of the
companion's everywhere, and the distance of the two tells how large both are. Where the error is above tol the level is
lowered by this law and the run is made again; the run before is then the companion.

Steps with persistent contacts are midpoint steps of one length, whatever the order, so their error goes with the square
of that length; each finer run has them shorter by the factor of its level, and the same comparison measures both errors.
What the accuracy asked for would cost is known by the law before it is spent: contact steps are not refined beyond a
budget, nor where the distances of successive runs do not fall as the law says they do, at any of the times compared.

The estimate is for the largest error of q over the nodes, norm of the tangent difference [m, rad]. It is no bound: it
takes the law for granted while successive distances follow it, and the whole distance where they do not. Rounding and
the tolerance of the stage equations are counted as a floor that no level can undercut. Two motions that separate
(chaos, another sequence of impacts) show as a large distance; a run that cannot meet tol ends with an AccuracyWarning
that says why. Dense steps, with impacts inside of them, follow no law, and the whole distance counts.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import AccuracyWarning, PenetrationError
from contactvi.interrupts import CtrlC
from contactvi.options import STAGE_TOLS, Options
from contactvi.run_settings import CONTACT_DT
from contactvi.simulation import auto_runs, engine
from contactvi.simulation.auto_runs import AutoRun, largest
from contactvi.simulation.compatibility import check_elements, check_map
from contactvi.simulation.recorder import Record
from contactvi.simulation.tolerances import LedgerWatch
from contactvi.status import Status, StatusCode
from contactvi.trajectory.compiled import CompiledScene
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]

_SAME = 2  # runs of each call with equal options that have the same settings
_RUNS = 6  # at most, besides the first companion
_START = 0.3  # level = _START sqrt(tol) to begin with
_SEEN = 0.1  # errors / level^2 of many motions lie about this
_COMPANION = 30.0  # times the error of the run, by the law
_AIM = 0.1  # of tol: where the level is set to, so low that one run more seldom follows
_LEAST = 10.0  # ratio of the errors of two runs: more is not taken for granted, though the law says so
_CONFIRMED = 100.0  # as _LEAST, where the pair of runs before and this one follow the law
_FINER, _MOST = 0.6, 8.0  # length of finer steps / the shortest step; number of them / that of the steps
_FOLLOWS = 5.0  # times what the law expects: a larger distance does not follow it
_LOST = 0.1  # of the size of the motion: two runs this far apart no longer follow the same motion
_LEVELS = (1e-8, 3e-3)  # [m, rad]; below the first errors drown in rounding, and low orders need too many steps
_EPS = float(np.finfo(float).eps)
# With persistent contacts:
_CONTACT = 3.0  # [s/m] step in contact / level to begin with: about 1e-3 s for tol = 1e-6, and no shorter
_CONTACT_DT = (1e-6, 2e-2)  # [s] shortest and longest one
_CONTACT_AIM = 0.3  # as _AIM, where a finer run costs in proportion
_UNSURE = 3.0  # as _LEAST, where no third run has confirmed the law
_STRAYS = 2  # pairs of runs on the same motion that do not follow the law: then it is given up
_HALF = 0.5  # part of the steps of a run with which it is looked whether the law holds
# Contact iterations of all runs together over those of one run with steps of 1e-3 s (of dt_contact, if that is shorter):
# with the events and the smooth steps a call then takes up to ten times as long as that run, which is what asking for a
# result instead of a step may cost. Each further digit would cost a factor of three.
_BUDGET = 6.0
_PER_STEP = 2.0  # contact iterations of a short step in contact


@dataclass(frozen=True)
class _Judged:
    """What the comparison of a run with its companion has shown.

    Attributes:
        estimate: of the error of the run.
        by_law: what it is if the law holds.
        apart: distances at the times compared.
        ratio: error / (companion's error - error), by the law.
        lawful: whether the distance follows the law; confirmed: so did that of the pair before.
        follows: with contacts, whether the two runs follow the same motion at all.
        strays: how many pairs, up to this one, follow the same motion and not the law.
    """

    estimate: float
    by_law: float
    apart: Array
    ratio: float
    follows: bool = False
    lawful: bool = False
    confirmed: bool = False
    strays: int = 0


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
    if record.status.ok:
        search.release()
    if record.status.ok and not estimate <= options.tol:
        warnings.warn(
            f"The accuracy asked of q was not reached: tol = {options.tol:.3g}, estimated error {estimate:.3g}."
            f" {search.reason}",
            AccuracyWarning,
            stacklevel=4,
        )
    return traj


class _Search:
    """Looks for the level, and the length of contact steps, at which a run is as accurate as asked."""

    def __init__(
        self,
        compiled: CompiledScene,
        options: Options,
        q0: ArrayLike | None,
        v0: ArrayLike | None,
        progress: Callable[[float, int], object] | None,
    ) -> None:
        self._compiled, self._options, self._progress = compiled, options, progress
        self._start = engine.checked_start(compiled, q0, v0)
        self._stages = options.order // 2
        self._level = _clip(_START * math.sqrt(options.tol))  # of the first run after the companion
        self.seconds = 0.0
        self.reason = "Chaotic motion limits it: ask for a shorter duration or a larger tol"
        self.last: Record
        self._engine: _core.Simulator | None = None
        self._engines: list[tuple[_core.Simulator, float, float]] = []  # of the first runs, with their settings
        self._iterations = 0  # in contact, of all runs
        self._allowed = 0.0  # of these

    def search(self) -> tuple[AutoRun, float]:
        """Return the run and its estimated error; an interrupted run as it is, with NaN."""
        step = self._first_contact_step()
        companion = self._run(self._level * math.sqrt(_COMPANION), step * math.sqrt(_COMPANION))
        part, judged = 1.0 / math.sqrt(_COMPANION), None
        for _ in range(_RUNS):
            if companion.final:  # or it ended where it started
                return companion, math.nan
            level = self._level if judged is None else _clip(companion.level * part)
            found = self._run(level, max(companion.dt_contact * part, _CONTACT_DT[0]), companion)
            if found.final:
                return found, math.nan
            if judged is not None and companion.record.status.ok and not found.record.status.ok:
                self.reason = f"A run with shorter steps ended early: {found.record.status}"
                return companion, judged.estimate
            judged = self._judge(companion, found, judged)
            if judged.estimate <= self._options.tol:
                break
            part = self._contact_part(found, judged) if found.in_contact else self._smooth_part(found, judged)
            if part >= 1.0:
                break
            companion = found
        assert judged is not None
        return found, judged.estimate

    def release(self) -> None:
        """Give the engines of the first runs, whose settings depend on the options alone, to later calls."""
        for simulator, slack, dt_contact in self._engines:
            engine.release(simulator, self._compiled, self._options, slack, dt_contact)

    def stopped(self) -> AutoRun:
        """Return the last run as it is, with the status INTERRUPTED; raise KeyboardInterrupt before there is one."""
        if self._engine is None:
            raise KeyboardInterrupt
        self.last.status = Status.interrupted(float(self.last.t[-1][-1]))
        return AutoRun(math.nan, math.nan, self.last, self._engine)

    def _run(self, level: float, dt_contact: float, coarser: AutoRun | None = None) -> AutoRun:
        """Run at a level, with contact steps of at most `dt_contact` [s].

        The tolerance of the stage equations goes with the square of the level, as the error of the steps does, so that
        both show in the distance of two runs.

        Args:
            coarser: a run with longer steps. The steps are parts of its own, all the same part by the law.
        """
        plan, bound = None, level
        if coarser is not None and coarser.record.adaptive_steps is not None:
            steps, bound = coarser.record.adaptive_steps, coarser.level
            plan = (steps["t"], steps["dt"], (level / bound) ** (1.0 / self._stages))
        slack = max((level / self._level) ** 2, STAGE_TOLS[0] / self._options.stage_tol)
        simulator = engine.reuse(self._compiled, self._options, slack, dt_contact)
        self.last, refused = engine.start_checked(simulator, self._compiled, self._options, *self._start)
        if refused is not None:
            raise refused
        self._engine = simulator
        engine.advance_auto(simulator, self.last, self._options.span, bound, plan, self._progress)
        self.seconds += self.last.stats.seconds
        self._iterations += self.last.stats.contact_iterations
        if len(self._engines) < _SAME and self.last.status.ok:
            self._engines.append((simulator, slack, dt_contact))
        return AutoRun(level, dt_contact, self.last, simulator)

    def _first_contact_step(self) -> float:
        """Return the contact step of the first run after the companion [s]; a given number is that of the companion."""
        given = self._options.dt_contact
        longest = min(given if isinstance(given, float) else math.inf, _CONTACT_DT[1]) / math.sqrt(_COMPANION)
        return min(_CONTACT * max(self._level, _START * 1e-3), longest)

    def _judge(self, companion: AutoRun, found: AutoRun, before: _Judged | None) -> _Judged:
        """Judge a run by its companion. before: what the companion was judged to be."""
        floor, size = self._floor(found)
        floor = max(floor, auto_runs.transient(found))
        if not found.record.status.ok:
            # Runs that end where impacts accumulate are compared up to there.
            same = companion.record.status.code == found.record.status.code
            apart = auto_runs.distances(companion, found, ended=True) if same else np.array([math.inf])
            return _whole(apart, floor)
        power = 2 * self._stages + 1
        ratio = max(auto_runs.share(companion, found, power), auto_runs.ratio(companion, found))
        if found.in_contact:
            return _judge_contact(companion, found, before, floor, size, ratio)
        if not math.isfinite(ratio):
            return _whole(self._against_finer(found), floor)
        apart = auto_runs.distances(companion, found)
        distance = largest(apart)
        lawful = distance < _LOST * size if before is None else distance < _FOLLOWS * before.estimate
        confirmed = lawful and before is not None and before.lawful
        by_law = distance * max(ratio, 1.0 / _LEAST)
        estimate = by_law if lawful else distance
        return _Judged(max(floor, estimate), by_law, apart, ratio, lawful=lawful, confirmed=confirmed)

    def _smooth_part(self, found: AutoRun, judged: _Judged) -> float:
        """Return what the level of the next run is of that of this one; 1 where it cannot be lowered."""
        share = _AIM * self._options.tol / judged.estimate
        share = min(share, 1.0 / _LEAST) if share > 0.0 else 1.0 / _COMPANION
        part = math.sqrt(share)
        return _clip(found.level * part) / found.level

    def _contact_part(self, found: AutoRun, judged: _Judged) -> float:
        """Return what the steps of the next run are of those of this one; 1 where there is to be none, with a reason."""
        if not self._allowed:
            self._allowed = _BUDGET * self._cost(found, self._budget_step() / found.dt_contact)
        wanted = math.sqrt(_CONTACT_AIM * self._options.tol / judged.by_law) if judged.by_law > 0.0 else _HALF
        parts = [min(wanted, _HALF)] if judged.lawful else []
        if not judged.confirmed and judged.strays < _STRAYS:
            parts.append(_HALF)
        for part in parts:
            if self._iterations + self._cost(found, part) <= self._allowed:
                return part
        if judged.lawful:
            self.reason = (
                f"By what was seen contact steps of {wanted * found.dt_contact:.1g} s would reach it, at"
                f" {self._cost(found, wanted) / self._allowed * _BUDGET:.0f} times the cost of steps of"
                f" {self._budget_step():.1g} s: ask for them by dt_contact, or for a larger tol or a shorter duration"
            )
        else:
            self.reason = (
                f"Contact steps shorter than {found.dt_contact:.1g} s do not bring runs together as they should: the"
                " motion multiplies errors, or is another one after a contact. Ask for a shorter duration or a larger tol"
            )
        return 1.0

    def _budget_step(self) -> float:
        """Return the contact step [s] that the budget is counted in."""
        given = self._options.dt_contact
        return min(CONTACT_DT, given) if isinstance(given, float) else CONTACT_DT

    def _cost(self, found: AutoRun, part: float) -> float:
        """Return the contact iterations of a run whose contact steps are this part of those of `found`."""
        steps = found.contact_time / found.dt_contact
        return max(found.record.stats.contact_iterations + _PER_STEP * steps * (1.0 / part - 1.0), _PER_STEP)

    def _floor(self, found: AutoRun) -> tuple[float, float]:
        """Return what the error of a run is not below, and the size of its motion."""
        t, q, _ = found.record.nodes()
        size = float(self._compiled.states.distance(q[:1], q).max())
        solved = (_EPS + self._options.stage_tol) * size * math.sqrt(len(t))
        return max(solved, _SEEN * found.level**2), size

    def _against_finer(self, found: AutoRun) -> Array:
        """Return the distances of a run from one with steps of one length, all shorter than its own.

        It serves runs that have steps in common with their companion, whose errors do not show in the distance to it.
        That happens where the stage iterations do not converge with longer steps, whatever the level.
        """
        unknown = np.array([math.inf])
        if not len(found.steps) or found.interrupted:
            return unknown
        count = math.ceil(self._options.span / (_FINER * float(found.steps.min())))
        if count > _MOST * len(found.segments["t"]):
            return unknown
        fixed = replace(
            self._options, dt=self._options.span / count, tol=self._options.stage_tol, ledger=None, sample_dt=None,
            dt_contact=None,
        )  # fmt: skip
        finer = min(_FINER * found.dt_contact, fixed.fixed_dt)
        simulator = engine.make(self._compiled, fixed, slack=1.0 / _COMPANION, dt_contact=finer)
        record, _ = engine.start_checked(simulator, self._compiled, fixed, *self._start)
        engine.advance(simulator, record, count, None, self._progress)
        self.seconds += record.stats.seconds
        if record.status.code == StatusCode.INTERRUPTED:
            raise KeyboardInterrupt
        return auto_runs.distances(AutoRun(math.nan, finer, record, simulator), found)


def _whole(apart: Array, floor: float) -> _Judged:
    """Return the judgement of a run of which the whole distance counts."""
    distance = largest(apart)
    return _Judged(max(floor, distance), distance, apart, math.inf)


def _judge_contact(
    companion: AutoRun, found: AutoRun, before: _Judged | None, floor: float, size: float, ratio: float
) -> _Judged:
    """Judge a run with persistent contacts: a pair of runs follows the law if it does so at all times compared.

    Without a law shorter steps bring runs no nearer; with it the next distance is by `fall` smaller. A distance above
    the geometric mean of the two belongs to the first. A pair that has lost each other tells nothing about the next.
    """
    apart = auto_runs.distances(companion, found)
    distance, dense = largest(apart), found.took_dense_steps or companion.took_dense_steps
    follows = distance < _LOST * size
    lawful, confirmed = follows and math.isfinite(ratio) and not dense, False
    if lawful and before is not None:
        fall = before.ratio / (1.0 + ratio)  # of e_1 - e_2 to e_0 - e_1: ratio is e_2 / (e_1 - e_2), and before e_1 / (...)
        lawful = bool((apart <= math.sqrt(min(fall, 1.0)) * _envelope(before.apart) + floor).all())
        confirmed = lawful and before.lawful
    least = _LEAST if confirmed else _UNSURE if before is None else 1.0
    estimate = distance * max(min(ratio, 1.0), 1.0 / least) if lawful else distance
    if before is not None and not lawful:  # how far two runs of such a motion are apart is a matter of chance
        estimate = max(estimate, min(largest(before.apart), _UNSURE * distance))
    strays = (before.strays if before is not None else 0) + int(follows and not lawful)
    by_law = distance * max(ratio, 1.0 / _LEAST)
    return _Judged(max(floor, estimate), by_law, apart, ratio, follows, lawful, confirmed, strays)


def _envelope(apart: Array) -> Array:
    """Return the largest of each distance and its two neighbours in time."""
    padded = np.concatenate([apart[:1], apart, apart[-1:]])
    return np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])


def _check_ledger(record: Record) -> None:
    """Check the run against the tolerances of its ledger; where one is exceeded the run ends there."""
    excess = LedgerWatch(record.options.ledger or {}).check(record.ledger())
    if excess is not None:
        record.status = Status(StatusCode.LEDGER, str(excess), excess.time)
        record.cut(excess.time)


def _clip(level: float) -> float:
    return min(max(level, _LEVELS[0]), _LEVELS[1])
