"""The search of dt = "auto" for steps that make q as accurate as asked; it measures how accurate q is.

A first run, the companion, chooses its steps, so that what the stage polynomials leave out of the motion stays below a
level [m, rad]; between two impacts they only become shorter. With s stages that goes with h^s, and the error of the run
with h^2s, so with the square of the level. The factor in front depends on the motion and is measured: the steps of the
next run, at a finer level, are those of the companion times one factor, and of one length between two impacts, so that
its error follows the law, and the distance of the two tells how large both are. The stage iterations of the finer run
start from where the coarser one has gone. Where the error is above tol the level is lowered by this law and the run is
made again; the run before is then the companion.

Persistent contacts are held in these steps, which end where a contact, a slip or a sticking ends, and follow the same
law. Where they cannot be held the run takes contact steps, which are midpoint steps of one length whatever the order:
their error goes with the square of that length. Each finer run has them shorter by the factor of its level, and the
same comparison measures both errors. How far they are refined is in contactvi.simulation.auto_contact.

The estimate is for the largest error of q over the nodes, norm of the tangent difference [m, rad]. It is no bound: it
relies on the law as far as successive distances have followed it, and is the whole distance where they do not. What the
motion makes of rounding and of the tolerance of the stage equations is a floor that no level can undercut. Two motions
that separate (chaos, another sequence of impacts) show as a large distance; a run that cannot meet tol ends with an
AccuracyWarning that says why. Dense steps, with impacts inside of them, follow no law, and the whole distance counts.
Where a rope goes slack or taut a step ends, so that the law holds through it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from contactvi.options import STAGE_TOLS, Options
from contactvi.simulation import auto_runs, engine
from contactvi.simulation.auto_contact import (
    COMPANION,
    FARTHER,
    LEAST,
    LOST,
    SHORTEST,
    ContactSearch,
    Judged,
    judge_contact,
)
from contactvi.simulation.auto_motion import Motion
from contactvi.simulation.auto_runs import AutoRun, largest

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]

CHAOS = "Chaotic motion limits it: ask for a shorter duration or a larger tol"  # where nothing else is seen
_SAME = 2  # runs of each call with equal options that have the same settings
_RUNS = 6  # at most, besides the first companion
_START = 0.03  # level = _START sqrt(tol) to begin with
_TOLD = 0.01  # of tol: a smaller error is not told from this one
_SEEN = 0.1  # errors / level^2 of many motions lie about this
_AIM = 0.3  # of tol: where the level is set to, so low that one run more seldom follows
_FINER = 0.6  # length of steps over that of another run
_UNSURE = 2.0  # on an estimate by the law with the exponent that was seen
_FOLLOWS = 5.0  # times what the law expects: a larger distance does not follow it
_LEVELS = (1e-8, 3e-3)  # [m, rad]; below the first errors drown in rounding, and low orders need too many steps
_EPS = float(np.finfo(float).eps)


class Search:
    """Looks for the level, and the length of contact steps, at which a run is as accurate as asked.

    Attributes:
        seconds: wall time of its runs.
        reason: why no run may be as accurate, where none is.
        last: the last run.
    """

    def __init__(self, motion: Motion, options: Options, progress: Callable[[float, int], object] | None) -> None:
        self._motion, self._options, self._progress = motion, options, progress
        self._stages = options.order // 2
        self._level = _clip(_START * math.sqrt(options.tol))  # of the first run after the companion
        self._allowed = options.tol
        self.seconds = 0.0
        self._runs = 1  # the number of the next one
        self.reason = CHAOS
        self.last: AutoRun | None = None
        self._first: AutoRun | None = None
        self._engines: list[tuple[_core.Simulator, float, float]] = []  # of the first runs, with their settings
        self._contact = ContactSearch(options)
        self._growth = 0.0  # of errors over the square of the level, the most that was seen

    def companion(self) -> AutoRun:
        """Return the first run."""
        if self._first is None:
            step = self._contact.first_step()
            self._first = self._run(self._level * math.sqrt(COMPANION), step * math.sqrt(COMPANION))
        return self._first

    def search(self, allowed: float | None = None) -> tuple[AutoRun, float]:
        """Return the run and its estimated error; an interrupted run as it is, with NaN.

        Args:
            allowed: the error that is asked for [m, rad], by default tol.
        """
        self._allowed = self._options.tol if allowed is None else allowed
        companion, earlier = self.companion(), None
        part, judged = 1.0 / math.sqrt(COMPANION), None
        for _ in range(_RUNS):
            if companion.final:  # or it ended where it started
                return companion, math.nan
            level = self._level if judged is None else _clip(companion.level * part)
            found = self._run(level, max(companion.dt_contact * part, SHORTEST), companion)
            if found.final:
                return found, math.nan
            if judged is not None and companion.ok and not found.ok:
                self.reason = f"A run with shorter steps ended early: {self._motion.told(found, self._options)}"
                return companion, judged.estimate
            judged = self._judge(companion, found, judged)
            if earlier is not None and not judged.lawful:
                judged = self._unlike_its_companion(earlier, found, judged)
            if judged.estimate <= self._allowed:
                break
            if found.in_contact:
                part, reason = self._contact.next_part(found, judged)
                self.reason = reason or self.reason
            else:
                part = self._smooth_part(found, judged)
            if part >= 1.0:
                break
            companion, earlier = found, companion
        assert judged is not None
        return found, judged.estimate

    def ended_at(self, found: AutoRun, times: Sequence[float]) -> tuple[AutoRun, float]:
        """Return a run with the steps of another one, cut at these times [s], and its distance from that one."""
        simulator = self._motion.started(self._options, found.stage_tol / self._options.stage_tol, found.dt_contact)
        # The level is that of a companion, as in all runs whose steps are given, so that it shortens none of them.
        taken = engine.run_auto(
            simulator, self._options.span, math.sqrt(COMPANION) * found.level, self._progress, found.run, 1.0, 0.0,
            self._runs, self._motion.references(), times,
        )  # fmt: skip
        run = self._took(AutoRun(found.level, found.dt_contact, found.stage_tol, *taken, simulator))
        return run, largest(auto_runs.distances(found, run)) if run.ok else math.inf

    def release(self) -> None:
        """Give the engines of the first runs, whose settings depend on the options alone, to later calls."""
        for simulator, slack, dt_contact in self._engines:
            self._motion.release(simulator, self._options, slack, dt_contact)

    def _run(
        self, level: float, dt_contact: float, coarser: AutoRun | None = None, slack: float | None = None,
        sample: float | None = None,
    ) -> AutoRun:  # fmt: skip
        """Run at a level, with contact steps of at most `dt_contact` [s].

        Args:
            coarser: a run with longer steps. The steps are parts of its own, all the same part by the law, and start
                from where it has gone.
            slack: factor on the tolerance of the stage equations. By default it goes with the square of the level, as
                the error of the steps does, so that both show in the distance of two runs.
            sample: steps that are not much longer end at its multiples [s]; by default those of a run with a coarser
                one at the samples that were asked for.
        """
        slack = (level / self._level) ** 2 if slack is None else slack
        slack = max(slack, STAGE_TOLS[0] / self._options.stage_tol)
        simulator = self._motion.started(self._options, slack, dt_contact)
        if coarser is None:
            found = engine.run_auto(
                simulator, self._options.span, level, self._progress, target=self._motion.references()
            )
        else:
            part = (level / coarser.level) ** (1.0 / self._stages)
            sample = (self._options.sample_dt or 0.0) if sample is None else sample
            found = engine.run_auto(
                simulator, self._options.span, coarser.level, self._progress, coarser.run, part, sample, self._runs,
                self._motion.references(),
            )  # fmt: skip
        run = self._took(AutoRun(level, dt_contact, slack * self._options.stage_tol, *found, simulator))
        if len(self._engines) < _SAME and run.ok:
            self._engines.append((simulator, slack, dt_contact))
        return run

    def _took(self, run: AutoRun) -> AutoRun:
        """Count what a run took."""
        self.last = run
        self._runs += 1
        self.seconds += run.run.seconds
        self._contact.spent += run.run.contact_iterations
        return run

    def _judge(self, companion: AutoRun, found: AutoRun, before: Judged | None) -> Judged:
        """Judge a run by its companion. before: what the companion was judged to be."""
        floor, size = self._floor(found)
        floor = max(floor, found.run.first_step_error)
        if not found.ok:
            # Runs that end where impacts accumulate are compared up to there.
            same = companion.code == found.code
            apart = auto_runs.distances(companion, found, ended=True) if same else np.array([math.inf])
            return _whole(apart, floor)
        power = 2 * self._stages + 1
        ratio = max(auto_runs.share(companion, found, power), auto_runs.ratio(companion, found))
        if found.in_contact:
            return judge_contact(companion, found, before, floor, size, ratio)
        if not math.isfinite(ratio):
            return _whole(self._against_finer(found), floor)
        apart = auto_runs.distances(companion, found)
        self._growth = max(self._growth, min(largest(apart), size) / companion.level**2)
        # Where contacts persist two runs may have one error in common: that of a slip that turns faster than the steps
        # of either. Two runs are then no proof of a law, and their whole distance counts.
        least = 1.0 if found.touched else 1.0 / LEAST
        return _by_law(apart, before, ratio, max(floor, _left_over(self._growth, found, size)), size, least)

    def _unlike_its_companion(self, earlier: AutoRun, found: AutoRun, judged: Judged) -> Judged:
        """Judge a run anew that does not follow the law, by the run before its companion, where it is nearer to that.

        Two runs with other steps that go one way where a third goes another one are nearer to the motion than to that.
        How far two runs without a law are apart is a matter of chance, and more of their distance counts.
        """
        apart = FARTHER * largest(auto_runs.distances(earlier, found, ended=not found.ok))
        floor = max(self._floor(found)[0], found.run.first_step_error)
        return replace(judged, estimate=min(judged.estimate, max(apart, floor)))

    def _smooth_part(self, found: AutoRun, judged: Judged) -> float:
        """Return what the level of the next run is of that of this one; 1 where it cannot be lowered."""
        share = _AIM * self._allowed / judged.estimate
        share = min(share, 1.0 / LEAST) if share > 0.0 else 1.0 / COMPANION
        part = math.sqrt(share)
        return _clip(found.level * part) / found.level

    def _floor(self, found: AutoRun) -> tuple[float, float]:
        """Return what the error of a run is not below, and the size of its motion."""
        size = found.run.size
        solved = (_EPS + self._options.stage_tol) * size * math.sqrt(found.run.nodes)
        return max(solved, _SEEN * found.level**2, _TOLD * self._options.tol), size

    def _against_finer(self, found: AutoRun) -> Array:
        """Return the distances of a run from one whose steps are _FINER of its own.

        It serves runs that have steps in common with their companion, whose errors do not show in the distance to it.
        That happens where the stage iterations do not converge with longer steps, whatever the level.
        """
        if found.interrupted:
            return np.array([math.inf])
        slack = (found.level / self._level) ** 2 / COMPANION
        level = found.level * _FINER**self._stages
        run = self._run(level, max(_FINER * found.dt_contact, SHORTEST), found, slack=slack, sample=0.0)
        self.last = found
        if run.interrupted:
            raise KeyboardInterrupt
        return auto_runs.distances(run, found)


def _left_over(growth: float, found: AutoRun, size: float) -> float:
    """Return what the motion makes of what is left of the stage equations, and of rounding.

    It multiplies them as it multiplies what the steps leave out, the square of the level. The law does not see them:
    the tolerance ends at rounding, and iterations stop anywhere below it.

    Args:
        growth: the largest distance of two runs over the square of the coarser one's level.
    """
    return growth * (_EPS + found.stage_tol) * size * math.sqrt(found.run.nodes)


def _by_law(
    apart: Array, before: Judged | None, ratio: float, floor: float, size: float, least: float = 1.0 / LEAST
) -> Judged:
    """Return the judgement of a smooth run by the law of its steps, as far as that can be relied on.

    The first pair of runs has shown nothing about the law: no less than a part `least` of their distance is taken. A
    third run shows how much of the law's exponent the motion has between the first two (less where their steps are too
    long for the law), and the same part is expected of the last two, over at most the square of the fall that was seen.

    Args:
        before: what the companion was judged to be; the rest as in `judge_contact`.
    """
    distance, share = largest(apart), ratio / (1.0 + ratio)
    lawful = distance < LOST * size if before is None else distance < _FOLLOWS * before.estimate
    confirmed = before is not None and lawful and before.lawful and distance > 0.0
    if before is not None and confirmed:
        fall = 1.0 + largest(before.apart) / distance  # of the errors of the two runs before, as it was seen
        part = min(math.log(fall) / math.log1p(1.0 / before.ratio), 1.0)
        share, least = _UNSURE * share**part, min(fall**-2.0, least)
    by_law = distance * max(share, least)
    return Judged(max(floor, by_law if lawful else distance), by_law, apart, ratio, lawful, confirmed)


def _whole(apart: Array, floor: float) -> Judged:
    """Return the judgement of a run of which the whole distance counts."""
    distance = largest(apart)
    return Judged(max(floor, distance), distance, apart, math.inf)


def _clip(level: float) -> float:
    return min(max(level, _LEVELS[0]), _LEVELS[1])
