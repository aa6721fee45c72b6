"""`contactvi reproduce`: the paper's Table I and Fig. 1, measured here, in one folder.

Murphey, Pekarek, Seghete, "Variational Methods for Contact Mechanics". Every claim of the table is measured on the
engine and gets a verdict by a rule that the report names, also where the claim does not hold.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from contactvi.reproduce import ensemble, figures, laws, runs
from contactvi.reproduce import report as reports
from contactvi.reproduce.row import Row
from contactvi.reproduce.systems import DURATION, STEPS

_T = TypeVar("_T")
Report = Callable[[float, str], object]  # called with the fraction that is done and what is being done


@dataclass(frozen=True)
class Size:
    """How much is measured.

    Attributes:
        fine: steps h in the convergence plot.
        repeats: of each timed step.
        starts: random starts of the L2 row.
        long_starts: starts of the ensemble of long runs.
    """

    fine: int
    repeats: int
    starts: int
    long_starts: int


FULL = Size(fine=250, repeats=1000, starts=1000, long_starts=96)
QUICK = Size(fine=60, repeats=100, starts=60, long_starts=4)


@dataclass(frozen=True)
class Result:
    """The rows of the table, and the files written (report.md first)."""

    rows: list[Row]
    files: list[Path]


def reproduce(folder: Path, quick: bool = False, progress: Report | None = None) -> Result:
    """Measure everything and write report.md, table.csv and the pictures with their CSVs into an existing folder.

    Args:
        quick: fewer random starts, repeats and steps, the same rows.
        progress: called as progress(fraction, text).
    """
    started = time.perf_counter()
    size = QUICK if quick else FULL
    tell = _Stages(progress, quick)
    rows = [
        tell("own scalars", laws.scalar_row),
        tell("momentum", laws.momentum_row),
        tell("symplecticity", laws.impact_symplectic_row),
        tell("symplecticity", laws.smooth_symplectic_row),
        tell("kinds of maps", laws.implementation_row),
        tell("kinds of maps", laws.kind_row),
    ]
    table = tell("orders", lambda: runs.convergence(np.array(STEPS)))
    long = tell("1000 s of problem B", runs.long_run)
    cost = tell("cost of an impact", lambda: runs.cost_row(size.repeats, tell.part))
    dense = tell("dense impacts", runs.dense_runs)
    start, errors = tell("random starts", lambda: runs.l2_errors(size.starts, tell.part))
    many = tell("long runs", lambda: ensemble.ensemble(size.long_starts, tell.part))
    fine = tell("convergence", lambda: runs.convergence(fine_steps(size.fine), tell.part))
    rows += [runs.structured_row(table, fine), runs.long_run_row(long), ensemble.flat_row(many)]
    rows += [cost, runs.dense_row(dense), runs.l2_row(errors)]
    pictures = [
        tell("Fig. 1", lambda: figures.energy_figure(folder)),
        tell("figures", lambda: figures.convergence_figure(table, fine, folder)),
        tell("figures", lambda: figures.long_run_figure(long, folder)),
        tell("figures", lambda: figures.ensemble_figure(many, folder)),
        tell("figures", lambda: figures.dense_figure(dense, folder)),
        tell("figures", lambda: figures.l2_figure(start, errors, folder)),
    ]
    written = [
        reports.save_report(rows, pictures, time.perf_counter() - started, quick, folder / "report.md"),
        reports.save_table(rows, folder / "table.csv"),
    ]
    return Result(rows, written + [folder / name for picture in pictures for name in (picture.png, picture.csv)])


def fine_steps(count: int) -> np.ndarray:
    """Return about `count` steps [s], 0.04 to 0.0025, that divide the duration, evenly on a logarithmic axis."""
    wanted = np.geomspace(DURATION / STEPS[0], DURATION / STEPS[-1], count)
    return np.asarray(DURATION / np.unique(wanted.round()))


class _Stages:
    """Turns stages of known weight into one fraction that is done."""

    # Rough wall times [s] of the longest stages (quick, full); the others count as _SMALL.
    _WEIGHT = {"cost of an impact": (1.0, 8.0), "random starts": (2.0, 30.0), "convergence": (1.0, 4.0)}
    _WEIGHT |= {"long runs": (3.0, 60.0)}
    _SMALL, _COUNT = 0.4, 15

    def __init__(self, progress: Report | None, quick: bool) -> None:
        self._progress = progress
        self._weights = {name: pair[0 if quick else 1] for name, pair in self._WEIGHT.items()}
        self._total = sum(self._weights.values()) + self._COUNT * self._SMALL
        self._done, self._current, self._text = 0.0, 0.0, ""

    def __call__(self, text: str, work: Callable[[], _T]) -> _T:
        self._text, self._current = text, self._weights.get(text, self._SMALL)
        self.part(0.0)
        result = work()
        self._done += self._current
        return result

    def part(self, fraction: float) -> None:
        """Report that this fraction of the present stage is done."""
        if self._progress is not None:
            self._progress(min(1.0, (self._done + fraction * self._current) / self._total), self._text)
