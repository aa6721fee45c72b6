"""dt = "auto" island by island: static trees that never meet in the run are searched for by themselves.

Which ones meet shows in the runs: at first every tree is run alone, with the long steps of a companion. Trees whose
paths come near each other in these are run together from the start, and looked at again, until no two groups meet. Then
each group is searched for, to its share of the accuracy asked for. What the final runs do decides: groups that come
near each other in them are searched for together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from contactvi.options import Options
from contactvi.scene.engine import static_trees
from contactvi.simulation.auto_motion import NotApart, PartMotion, WholeMotion
from contactvi.simulation.auto_runs import AutoRun
from contactvi.simulation.auto_search import Search
from contactvi.trajectory.polynomials import Segments, SegmentsApart

if TYPE_CHECKING:
    from contactvi import _core

_ROUNDS = 8  # after as many joins of groups that meet, all bodies are run together
_NEAR = 10.0  # times tol: bodies that come this near may meet; the two runs are accurate to less than tol each

Group = tuple[int, ...]


@dataclass
class Parts:
    """The runs of groups that do not meet as one, its estimated error, and why that is no smaller."""

    run: _core.KeptRun
    segments: SegmentsApart
    estimate: float
    reason: str
    interrupted: bool


class Apart:
    """Searches for groups of static trees that do not meet.

    Attributes:
        seconds: wall time of all runs.
    """

    def __init__(self, motion: WholeMotion, options: Options, progress: Callable[[float, int], object]) -> None:
        self._motion, self._options, self._progress = motion, options, progress
        self._trees = static_trees(motion.compiled.core)
        self._searches: dict[Group, tuple[PartMotion, Search]] = {}
        self._groups: list[Group] = []
        self.seconds = 0.0

    def search(self) -> Parts | None:
        """Return the runs of the groups; None where all bodies are to be run together."""
        options = self._options
        undivided = options.impact != "ctec" or options.ledger or self._trees.guards == 0
        if self._trees.count < 2 or undivided:
            return None
        # The start is looked at as a whole: it may be refused.
        self._motion.release(self._motion.started(options, 1.0, options.contact_dt), options, 1.0, options.contact_dt)
        self._groups = [(tree,) for tree in range(self._trees.count)]
        try:
            return self._searched()
        except NotApart:
            return None
        except KeyboardInterrupt:
            runs = [search.last for _, search in self._all()]
            if not all(runs):
                raise
            known = [run for run in runs if run is not None]
            return self._joined(known, [math.nan], _leader(known), interrupted=True)
        finally:
            self.seconds = sum(search.seconds for _, search in self._searches.values())

    def _searched(self) -> Parts | None:
        for _ in range(_ROUNDS):
            companions = [self._good(search.companion()) for _, search in self._all()]
            if not self._join(companions):
                runs, estimates = self._found(companions)
                if not self._join(runs):
                    return self._with_nodes(runs, estimates)
            if len(self._groups) == 1:
                break
        return None

    def _found(self, companions: list[AutoRun]) -> tuple[list[AutoRun], list[float]]:
        """Return the runs of the groups and their estimated errors, whose squares together are to be those of tol.

        The cheapest is searched for first: most need less than an equal share, and what they leave is for the others.
        One that cannot have its share takes none of theirs.
        """
        found: dict[int, tuple[AutoRun, float]] = {}
        left = whole = self._options.tol**2
        searches = self._all()
        for k in sorted(range(len(companions)), key=lambda k: companions[k].run.sweeps):
            share = max(left / (len(companions) - len(found)), whole / len(companions))
            run, estimate = searches[k][1].search(math.sqrt(share))
            found[k] = self._good(run), estimate
            left -= estimate**2
        return [found[k][0] for k in range(len(found))], [found[k][1] for k in range(len(found))]

    def _all(self) -> list[tuple[PartMotion, Search]]:
        """Return the searches of the groups, which are begun where there are none yet."""
        for trees in self._groups:
            if trees not in self._searches:
                part = PartMotion(self._motion, self._options, trees, self._trees.part(list(trees)))
                share = replace(self._options, tol=self._options.tol / math.sqrt(len(self._groups)))
                self._searches[trees] = part, Search(part, share, self._progress)
        return [self._searches[trees] for trees in self._groups]

    @staticmethod
    def _good(run: AutoRun) -> AutoRun:
        if run.interrupted:
            raise KeyboardInterrupt
        if not run.ok:
            raise NotApart("The run of a part ended early")
        return run

    def _join(self, runs: list[AutoRun]) -> bool:
        """Join the groups whose bodies may have met in these runs; return whether there are any."""
        near = _NEAR * self._options.tol
        pairs = self._trees.meetings([motion.part for motion, _ in self._all()], [run.run for run in runs], near)
        sets = [{k} for k in range(len(self._groups))]
        for a, b in pairs:
            one, other = (next(found for found in sets if k in found) for k in (a, b))
            if one is not other:
                one |= other
                sets.remove(other)
        self._groups = sorted(tuple(sorted(tree for k in found for tree in self._groups[k])) for found in sets)
        return bool(pairs)

    def _with_nodes(self, runs: list[AutoRun], estimates: list[float]) -> Parts:
        """Return the runs as one, with the nodes of the group that has most of them.

        Steps of the others end there, too, where friction, dampers or inputs do work, and where constraints have
        reactions: in between their states are known, but neither of these.
        """
        leader = _leader(runs)
        times = runs[leader].run.t
        for k, (_, search) in enumerate(self._all()):
            if k != leader and runs[k].run.counts_work:
                run, apart = search.ended_at(runs[k], times)
                runs[k], estimates[k] = self._good(run), max(estimates[k], apart)
        return self._joined(runs, estimates, leader)

    def _joined(self, runs: list[AutoRun], estimates: list[float], leader: int, interrupted: bool = False) -> Parts:
        searches = self._all()
        run = self._trees.joined([motion.part for motion, _ in searches], [found.run for found in runs], leader)
        options = self._options
        segments = [
            (motion.trees, Segments(found.run.take_segments(), options.order, options.stage_tol))
            for (motion, _), found in zip(searches, runs, strict=True)
        ]
        worst = max(range(len(estimates)), key=lambda k: estimates[k])
        estimate = math.sqrt(sum(one**2 for one in estimates))
        return Parts(run, SegmentsApart(segments), estimate, searches[worst][1].reason, interrupted)


def _leader(runs: list[AutoRun]) -> int:
    """Return the place of the run with most nodes."""
    return max(range(len(runs)), key=lambda k: runs[k].run.nodes)
