"""The exact derivatives of a run compared with fourth-order differences of the same run, column by column.

In a scene with constraints changes of the start are brought back to the constraints, and the exact derivatives are
those along such changes.

Differences are made with steps of many sizes. Those whose runs have other impacts than the run itself cross a kink and
are no derivatives; of the others the one is taken whose neighbours in size change it least, and that change is its own
error. A disagreement beyond both the tolerance and that error is a fault of the exact derivative.
"""

from __future__ import annotations

import numbers
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.derivatives.constrained_starts import ConstrainedStarts
from contactvi.derivatives.perturbed_runs import SOLVED, PerturbedRuns, RunEnd
from contactvi.errors import InputError, did_you_mean
from contactvi.inputs import callback, count, real, short
from contactvi.keywords import with_keywords
from contactvi.options import FurtherOptions, ImpactMap
from contactvi.simulation.simulation import Control, simulate
from contactvi.trajectory.sensitivity import PLAIN, Sensitivity, check_on_kink, wanted
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from contactvi.scene.scene import Scene

Array = NDArray[np.float64]
Progress = Callable[[float, str], object]

TOLERANCE = 1e-7  # relative: what fourth-order differences in double precision reach where nothing amplifies errors
# Of the steps of differences, down to 5e-9 of a column's scale: edges of shapes are rounded by 1e-6 m, and what touches
# them is smooth over a part of that alone.
SIZES = tuple(1e-2 * 0.5**k for k in range(22))
_PAST = 3  # sizes without improvement after which rounding has taken over
_CENTRAL = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
_ONE_SIDED = {0: -25 / 12, 1: 4.0, 2: -3.0, 3: 4 / 3, 4: -1 / 4}  # where a coefficient has no room on one side

BOTH, EXACT, NEITHER = "both", "exact", "neither"


@dataclass(frozen=True)
class Comparison:
    """One quantity of a column: the exact derivative beside the best differences.

    Attributes:
        what: "state", (q, v) at the end of the run, or "impact times".
        size: largest entry of the exact derivative. block: that of all columns of its name.
        difference: largest disagreement; of the time of an impact, beyond what it is located to.
        own: error of the differences by their own measure: the change between neighbouring sizes.
        unseen: what the tolerance of the steps may add to it in proportion, so that no change of the size shows it.
        step: with which they were made.
    """

    what: str
    size: float
    block: float
    difference: float
    own: float
    unseen: float
    step: float

    @property
    def is_zero(self) -> bool:
        """Whether the derivative is less than what differences show."""
        return self.size <= self.own + self.unseen

    @property
    def relative_difference(self) -> float:
        """The disagreement relative to the size; of what is zero, to that of its block."""
        return self.difference / self._scale

    @property
    def relative_own(self) -> float:
        """The own error of the differences, relative to the same."""
        return self.own / self._scale

    @property
    def _scale(self) -> float:
        return (self.block if self.is_zero else self.size) or 1.0

    def believe(self, tolerance: float) -> str:
        """Return which one to believe: BOTH, EXACT where differences cannot tell, NEITHER at a fault."""
        if self.relative_difference <= tolerance:
            return BOTH
        return EXACT if self.difference <= self.own + self.unseen else NEITHER


@dataclass(frozen=True)
class ColumnCheck:
    """One column of the derivative, compared.

    Attributes:
        name: "q0[2] elbow", "restitution", ...
        state, times: of (q, v) at the end and of the times of the impacts; None where no differences could be made, or
            nothing was hit.
        believe: "both"; "exact" where differences are worth less than the tolerance; "neither": a fault.
        reason: why.
    """

    name: str
    state: Comparison | None
    times: Comparison | None
    believe: str
    reason: str

    @property
    def worse(self) -> Comparison | None:
        """The one of state and times that disagrees more."""
        parts = [part for part in (self.state, self.times) if part is not None]
        return max(parts, key=lambda part: part.relative_difference, default=None)


@dataclass(frozen=True)
class GradientCheck:
    """The derivatives of a run beside its differences.

    Attributes:
        columns: those that were compared. of: how many there are.
        sensitivity: the exact derivatives.
        tolerance: relative, beyond which a disagreement counts.
    """

    columns: tuple[ColumnCheck, ...]
    of: int
    sensitivity: Sensitivity
    tolerance: float

    @property
    def ok(self) -> bool:
        """Whether no column disagrees beyond the tolerance and the own error of its differences."""
        return all(column.believe != NEITHER for column in self.columns)

    def __str__(self) -> str:
        counts = {word: sum(column.believe == word for column in self.columns) for word in (BOTH, EXACT, NEITHER)}
        text = f"{len(self.columns)} of {self.of} columns compared: {counts[BOTH]} agree to {self.tolerance:g}"
        if counts[EXACT]:
            text += f", {counts[EXACT]} have no differences as good as that"
        return text + (f", {counts[NEITHER]} disagree" if counts[NEITHER] else "")


@with_keywords(FurtherOptions)
def check_gradient(
    scene: Scene,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    duration: float | None = None,
    dt: float | None = None,
    *,
    wrt: Sequence[str] | str = PLAIN,
    columns: int | None = None,
    seed: int = 0,
    tolerance: float = TOLERANCE,
    on_kink: str = "raise",
    impact: ImpactMap | None = None,
    order: int | None = None,
    tol: float | None = None,
    solver_tol: float | None = None,
    control: ArrayLike | Control | None = None,
    target: Any = None,
    progress: Progress | None = None,
    **options: Unpack[FurtherOptions],
) -> GradientCheck:
    """Run a scene, take the derivatives of its end and of the times of its impacts, and compare them with differences.

    Inputs and references of servos are held as the run had them: what a control function or the start of a servo would
    do in perturbed runs is no part of the derivative. In a scene with constraints a column of "q0" or "v0" is that of
    the start which is changed along it and brought back to the constraints.

    Args:
        scene, q0, v0, duration, dt, impact, order, tol, solver_tol, control, target, options: as those of `simulate`.
        wrt, on_kink: as those of `Trajectory.sensitivity`, but no parameters of the scene.
        columns: compare so many, at least one of each name, chosen at random by `seed`; None: all. A column costs up to
            30 runs.
        tolerance: relative to the largest entry of a column, beyond which a disagreement counts.
        progress: called with (fraction, name of the column).

    Raises:
        InputError, SimulationError, PenetrationError: as `simulate`. NotDifferentiable: as `Trajectory.sensitivity`,
            and where the run has other impacts when its steps are solved to rounding.
    """
    tolerance, most = real("tolerance", tolerance, 0.0), None if columns is None else count("columns", columns)
    check_on_kink(on_kink)
    seed = _checked_seed(seed)
    called = callback("progress", progress)
    chosen: dict[str, Any] = {
        **options, "record": "gradient", "duration": duration, "dt": dt, "impact": impact, "order": order, "tol": tol,
        "solver_tol": solver_tol, "control": control, "target": target,
    }  # fmt: skip
    for name in wanted(wrt):
        if name.partition(":")[0] not in PLAIN:
            raise InputError(
                "Differences are not made along this", name="wrt", expected=f"one of {', '.join(PLAIN)}", got=name,
                remedy=did_you_mean(name, PLAIN),
            )  # fmt: skip
    traj = simulate(scene, q0, v0, **chosen)
    if len(traj.dense_steps) and traj.options.stage_tol > SOLVED:
        # Gaps that count as closed are errors of the speeds, over dt: differences see them.
        traj = simulate(scene, q0, v0, **{**chosen, "tol": None, "solver_tol": SOLVED})
    exact = traj.sensitivity(wrt, on_kink=on_kink)
    runs = PerturbedRuns(scene, traj, exact)
    ends = _ends(runs.starts, exact, traj, on_kink)
    sample = _sample(exact, most, seed)
    found = []
    for k, column in enumerate(sample):
        if called is not None:
            called(k / len(sample), runs.name(column))
        found.append(_check_column(runs, exact, ends, column, tolerance))
    return GradientCheck(tuple(found), exact.matrix.shape[2], exact, tolerance)


def _checked_seed(seed: int) -> int:
    if isinstance(seed, numbers.Integral) and not isinstance(seed, bool) and seed >= 0:
        return int(seed)
    raise InputError(
        "seed is not usable", name="seed", expected="a whole number >= 0", got=short(seed), remedy="For example seed=0"
    )  # fmt: skip


def _sample(exact: Sensitivity, most: int | None, seed: int) -> list[int]:
    """Return the columns to compare, ascending: at least one of each name."""
    total = exact.matrix.shape[2]
    if most is None or most >= total:
        return list(range(total))
    mixed = [int(k) for k in np.random.default_rng(seed).permutation(total)]
    first = [next(k for k in mixed if part.start <= k < part.stop) for part in exact.columns.values()]
    rest = [k for k in mixed if k not in first]
    return sorted([*first, *rest[: max(0, most - len(first))]])


def _ends(starts: ConstrainedStarts | None, exact: Sensitivity, traj: Trajectory, on_kink: str) -> tuple[Array, Array]:
    """Return the exact derivatives of the run's end (2 nv, columns) and of the impacts' times (impacts, columns).

    Those by the start are along changes that constraints allow.
    """
    end, times = np.array(exact.matrix[-1]), np.array(exact.event_times)
    if starts is None or not {"q0", "v0"} & set(exact.columns):
        return end, times
    whole, changes = traj.sensitivity(["q0", "v0"], on_kink=on_kink), starts.changes()
    nv = len(changes) // 2
    for name, rows in (("q0", slice(0, nv)), ("v0", slice(nv, 2 * nv))):
        if name in exact.columns:
            end[:, exact.columns[name]] = whole.matrix[-1] @ changes[:, rows]
            times[:, exact.columns[name]] = whole.event_times @ changes[:, rows]
    return end, times


def _check_column(
    runs: PerturbedRuns, exact: Sensitivity, ends: tuple[Array, Array], column: int, tolerance: float
) -> ColumnCheck:
    name, (end, hit) = runs.name(column), ends
    fine = tolerance * float(np.abs(end[:, column]).max(initial=0.0))
    ladder = _Ladder(runs, column, fine)
    if not ladder.usable:
        return ColumnCheck(name, None, None, EXACT, ladder.obstacle)
    block = exact.columns[runs.kind(column)]
    state = ladder.compare("state", end[:, column], end[:, block], runs.largest)
    times = ladder.compare("impact times", hit[:, column], hit[:, block], runs.span, runs.located) if len(hit) else None
    parts = [part for part in (state, times) if part is not None]
    worst = max(parts, key=lambda part: (BOTH, EXACT, NEITHER).index(part.believe(tolerance)))
    believe = worst.believe(tolerance)
    if believe == BOTH:
        return ColumnCheck(name, state, times, believe, f"{ladder.likeness}; they agree")
    if believe == NEITHER:
        return ColumnCheck(name, state, times, believe, f"{worst.what}: beyond own error, a fault")
    lost = f"{worst.what}: digits lost, growth {runs.growth:.2g}"
    return ColumnCheck(name, state, times, believe, lost)


class _Ladder:
    """Differences along a column with steps of all sizes, until they are `fine` and rounding has taken over.

    Differences that are not fine yet may become so where smaller steps reach no other feature of a shape.

    Attributes:
        usable: indices of the sizes whose runs, and those of their neighbours, have the impacts of the run itself; in
            the same steps, if there are any such.
        likeness: what they have in common, in words. obstacle: why there are no more.
    """

    def __init__(self, runs: PerturbedRuns, column: int, fine: float) -> None:
        self._runs, self._column = runs, column
        self._scale, self._room = runs.scale(column), runs.room(column)
        self._ends: dict[float, RunEnd | None] = {0.0: runs.middle}
        self._found: dict[int, tuple[Array, Array]] = {}
        self._passing: set[int] = set()
        self.obstacle = "there is no room for differences"
        best, least = 0, np.inf
        for k in range(len(SIZES)):
            values = self._differences(k)
            if values is None:
                continue
            self._found[k] = values
            own = np.inf if self._passing & {k - 2, k - 1, k} else self._change(k - 1, 0)
            if own < least:
                best, least = k - 1, own
            if least <= fine and k - 1 > best + _PAST:
                break
        whole = [k for k in self._found if k + 1 in self._found and k - 1 in self._found]
        alike = [k for k in whole if not self._passing & {k - 1, k, k + 1}]
        self.usable = alike or whole
        self.likeness = "same impacts" if alike else "same impacts, in other steps"

    def compare(self, what: str, exact: Array, block: Array, largest: float, located: Any = 0.0) -> Comparison:
        """Compare the exact column of the "state" or of the "impact times" with the best differences.

        Every step is solved to SOLVED of numbers of size `largest`; this grows on the way as changes of the start do.
        located: to what each impact is located, which differences of its time show as noise [s], shape (impacts,).
        """
        which = 0 if what == "state" else 1
        best = min(self.usable, key=lambda k: self._change(k, which))
        step = self._scale * SIZES[best]
        unseen = SOLVED * self._runs.steps * max(1.0, self._runs.growth) * largest / step
        numbers = self._found[best][which]
        apart = np.abs(exact - (numbers[self._runs.first] if which else numbers))
        off = np.maximum(apart - located / step, 0.0).max(initial=0.0)
        size, widest = (float(np.abs(part).max(initial=0.0)) for part in (exact, block))
        return Comparison(what, size, widest, float(off), self._change(best, which), unseen, step)

    def _change(self, k: int, which: int) -> float:
        """Return the larger change from the differences of size k to those of its neighbours, infinite without both.

        One neighbour alone may agree by chance.
        """
        near = [self._found[j][which] for j in (k - 1, k, k + 1) if j in self._found]
        if len(near) < 3:
            return float("inf")
        return float(max(np.abs(near[1] - other).max(initial=0.0) for other in (near[0], near[2])))

    def _differences(self, k: int) -> tuple[Array, Array] | None:
        step = self._scale * SIZES[k]
        down, up = self._room
        if min(down, up) >= 2.0 * step:
            weights = {count * step: weight / step for count, weight in _CENTRAL.items()}
        elif max(down, up) >= 4.0 * step:
            signed = step if up > down else -step
            weights = {count * signed: weight / signed for count, weight in _ONE_SIDED.items()}
        else:
            return None
        ends = [(self._end(by), weight) for by, weight in weights.items()]
        state, times = np.zeros(len(self._runs.middle.state)), np.zeros(len(self._runs.middle.times))
        for end, weight in ends:
            if end is None or end.sequence != self._runs.middle.sequence:
                self.obstacle = "other impacts in perturbed runs: a kink"
                return None
            if end.steps != self._runs.middle.steps:
                self._passing.add(k)
            state += weight * (end.state - self._runs.middle.state)
            times += weight * (end.times - self._runs.middle.times)
        return state, times

    def _end(self, by: float) -> RunEnd | None:
        if by not in self._ends:
            self._ends[by] = self._runs.changed(self._column, by)
        return self._ends[by]


__all__ = ["BOTH", "EXACT", "NEITHER", "ColumnCheck", "Comparison", "GradientCheck", "check_gradient"]
