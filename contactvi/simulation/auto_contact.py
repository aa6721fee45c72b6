"""dt = "auto" with contact steps of order 2: how far they are refined, and what the comparison of two runs shows.

A run takes them where smooth steps cannot hold its persistent contacts. What the accuracy asked for would cost is known
by the law before it is spent. Contact steps are refined within a budget, and where the distances of successive runs do
not fall as the law says, at all times compared, they are not refined further: the motion multiplies errors, or goes
another way after a contact. Dense steps, with impacts inside of them, follow no law, and the whole distance counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactvi.options import Options
from contactvi.run_settings import CONTACT_DT
from contactvi.simulation.auto_runs import AutoRun, distances, largest

Array = NDArray[np.float64]

COMPANION = 30.0  # error of the companion over that of the run, by the law
LEAST = 10.0  # ratio of the errors of two runs: no more is expected, though the law says so
LOST = 0.1  # of the size of the motion: two runs this far apart no longer follow the same motion
SHORTEST = 1e-6  # [s] step in contact
_LONGEST = 2e-2  # [s]
_STEP = 0.9  # [s] step in contact / root of tol to begin with: about 1e-3 s for tol = 1e-6,
_TOLS = (1e-6, 1e-4)  # [m, rad] and as for these beyond them
_AIM = 0.3  # of tol: what the law is to give; a margin costs in proportion
FARTHER = 3.0  # times the distance of two runs that follow no law: their error may be as large
_STRAYS = 2  # pairs of runs on the same motion that do not follow the law: then it is given up
_HALF = 0.5  # part of the steps of a run with which it is looked whether the law holds
# Contact iterations of all runs together over those of one run with steps of 1e-3 s (of dt_contact, if that is
# shorter). With events and smooth steps a call then takes up to ten times as long as that run, which is what asking for
# a result instead of a step may cost. Each further digit would cost a factor of three.
BUDGET = 6.0
_PER_STEP = 2.0  # contact iterations of a short step in contact


@dataclass(frozen=True)
class Judged:
    """What the comparison of a run with its companion has shown.

    Attributes:
        estimate: of the error of the run.
        by_law: what it is if the law holds.
        apart: distances at the times compared.
        ratio: error / (companion's error - error), by the law.
        lawful: whether the distance follows the law; confirmed: so did that of the pair before.
        strays: how many pairs, up to this one, follow the same motion and not the law.
    """

    estimate: float
    by_law: float
    apart: Array
    ratio: float
    lawful: bool = False
    confirmed: bool = False
    strays: int = 0


class ContactSearch:
    """Chooses contact steps, within the budget of a call.

    Attributes:
        spent: contact iterations of the runs made so far.
    """

    def __init__(self, options: Options) -> None:
        given = options.dt_contact
        self._tol, self._longest = options.tol, given if isinstance(given, float) else math.inf
        self._counted = min(CONTACT_DT, self._longest)  # [s] step in which the budget is counted
        self._allowed = math.nan
        self.spent = 0

    def first_step(self) -> float:
        """Return the contact step of the run at the first level [s]; a given number is that of its companion."""
        root = math.sqrt(min(max(self._tol, _TOLS[0]), _TOLS[1]))
        return min(_STEP * root, min(self._longest, _LONGEST) / math.sqrt(COMPANION))

    def next_part(self, found: AutoRun, judged: Judged) -> tuple[float, str]:
        """Return what the steps of the next run are of those of this one; 1 with a reason where there is to be none."""
        if math.isnan(self._allowed):
            self._allowed = BUDGET * self._cost(found, self._counted / found.dt_contact)
        wanted = math.sqrt(_AIM * self._tol / judged.by_law) if judged.by_law > 0.0 else _HALF
        parts = [min(wanted, _HALF)] if judged.lawful else []
        if not judged.confirmed and judged.strays < _STRAYS:
            parts.append(_HALF)
        for part in parts:
            if self.spent + self._cost(found, part) <= self._allowed:
                return part, ""
        if not judged.lawful:
            return 1.0, (
                f"Contact steps shorter than {found.dt_contact:.1g} s do not bring runs together as they should: the"
                " motion multiplies errors, or is another one after a contact. Ask for a shorter duration or a larger"
                " tol"
            )
        times = BUDGET * self._cost(found, wanted) / self._allowed
        return 1.0, (
            f"By what was seen contact steps of {wanted * found.dt_contact:.1g} s would reach it, at {times:.0f} times"
            f" the cost of steps of {self._counted:.1g} s: ask for them by dt_contact, or for a larger tol or a shorter"
            " duration"
        )

    def _cost(self, found: AutoRun, part: float) -> float:
        """Return the contact iterations of a run whose contact steps are this part of those of `found`."""
        steps = found.contact_time / found.dt_contact
        return max(found.run.contact_iterations + _PER_STEP * steps * (1.0 / part - 1.0), _PER_STEP)


def judge_contact(
    companion: AutoRun, found: AutoRun, before: Judged | None, floor: float, size: float, ratio: float
) -> Judged:
    """Judge a run with contact steps: a pair of runs follows the law if it does so at all times compared.

    Without a law shorter steps bring runs no nearer; with it the next distance is by `fall` smaller. A distance above
    the geometric mean of the two belongs to the first. A pair that has lost each other tells nothing about the next.

    Args:
        before: what the companion was judged to be.
        floor: what the error is not below.
        size: of the motion [m, rad].
        ratio: as in Judged.
    """
    apart = distances(companion, found)
    distance, dense = largest(apart), found.took_dense_steps or companion.took_dense_steps
    follows = distance < LOST * size
    lawful, confirmed = follows and math.isfinite(ratio) and not dense, False
    if lawful and before is not None:
        # With errors e_0, e_1, e_2 of three runs: ratio = e_2 / (e_1 - e_2), that before e_1 / (e_0 - e_1).
        fall = before.ratio / (1.0 + ratio)  # of e_1 - e_2 to e_0 - e_1
        earlier = _envelope(before.apart) if len(before.apart) == len(apart) else largest(before.apart)
        lawful = bool((apart <= math.sqrt(min(fall, 1.0)) * earlier + floor).all())
        confirmed = lawful and before.lawful
    estimate = distance
    if before is not None and not lawful:  # how far two runs of such a motion are apart is a matter of chance
        estimate = max(estimate, min(largest(before.apart), FARTHER * distance))
    strays = (before.strays if before is not None else 0) + int(follows and not lawful)
    by_law = distance * max(ratio, 1.0 / LEAST)
    return Judged(max(floor, estimate), by_law, apart, ratio, lawful, confirmed, strays)


def _envelope(apart: Array) -> Array:
    """Return the largest of each distance and its two neighbours in time."""
    padded = np.concatenate([apart[:1], apart, apart[-1:]])
    around: Array = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
    return around
