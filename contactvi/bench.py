"""Run time against error for one scene: which impact map and which time step for which error.

The ladder is the scene's dt times 8, 4, 2, 1, 1/2, 1/4, 1/8 as far as the number of steps divides and the time
allows. The reference is a run with the finest dt / 8. All runs share the nodes of the coarsest one; an error is the
largest distance |q - q_ref| over these nodes, in the tangent space (metres and radians mixed, as they come).

An error means something only while the runs see the same motion. The horizon is the last node up to which the
reference, its twin with twice its dt and the finest run with the same map have the same impacts and stay within LOST of
each other, relative to the size of the motion (at most half a turn, joints wind up), and the reference stays closer to
its twin than to what it judges; errors and times are those up to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactvi.bench_runs import (
    LOST,
    REFERENCE,
    OutOfTime,
    Plan,
    Progress,
    Run,
    agreement,
    distance,
    same_impacts,
    still,
)
from contactvi.errors import InputError, PenetrationError
from contactvi.options import IMPACT_MAPS
from contactvi.simulation import settings_of

if TYPE_CHECKING:
    from contactvi.scene import Scene


REPEATS = 5
ORDER = 2
Array = NDArray[np.float64]
_ROUNDING = 1e-10  # of the size of the motion: 100 times the default tolerance of a step, gathered over the run


@dataclass(frozen=True)
class Row:
    """One measured setting.

    impact : map. dt : [s]. error : largest |q - q_ref| up to the horizon [m, rad]. energy_error : largest difference
    from the reference of the energy without what the impacts took [J]. seconds : fastest of the repeats, up to the
    horizon [s]. impacts : up to the horizon. order : log of the error ratio to the next coarser dt over that of the dt;
    nan for the first. note : why the row is no measurement of the map's accuracy, empty where it is.
    """

    impact: str
    dt: float
    error: float
    energy_error: float
    seconds: float
    impacts: int
    order: float = float("nan")
    note: str = ""


@dataclass
class Bench:
    """What was measured: rows, horizon [s], duration [s], reference dt [s] and its own error, warnings."""

    rows: list[Row]
    horizon: float
    duration: float
    reference_dt: float
    reference_error: float
    impacts: int
    warnings: list[str] = field(default_factory=list)

    def good(self) -> list[Row]:
        """Rows that measure what they should."""
        return [row for row in self.rows if not row.note]

    def best(self, error: float) -> Row | None:
        """The fastest row at or below an error; of those within 10 % of its time, the most accurate one."""
        rows = [row for row in self.good() if row.error <= error]
        if not rows:
            return None
        fastest = min(row.seconds for row in rows)
        return min((row for row in rows if row.seconds <= 1.1 * fastest), key=lambda row: row.error)

    def slope(self, impact: str) -> float:
        """Order seen over the whole ladder of a map: least squares in the logarithms; nan with less than 2 points."""
        rows = [row for row in self.good() if row.impact == impact and row.error > 0]
        if len(rows) < 2:
            return float("nan")
        return float(np.polyfit(np.log([r.dt for r in rows]), np.log([r.error for r in rows]), 1)[0])


def bench(
    scene: Scene,
    *,
    budget: float = 60.0,
    maps: Sequence[str] = IMPACT_MAPS,
    progress: Progress | None = None,
    **options: Any,
) -> Bench:
    """Measure run time against error of a scene over impact maps and time steps.

    Parameters
    ----------
    scene : with its start and settings (load_scene), which `options` override. budget : wall time allowed [s].
    maps : impact maps to compare. progress : called as progress(share of the budget, text).

    Raises
    ------
    InputError : for bad settings. PenetrationError : for a start in penetration.
    """
    if not budget > 0 or not np.isfinite(budget):
        raise InputError("budget is not usable", name="budget", expected="seconds, > 0", got=repr(budget))
    plan = Plan(scene, settings_of(scene, options), budget, progress)
    reference, twin = _references(plan)
    runs: dict[tuple[str, float], Run] = {}
    if not reference.counts.any() and not twin.counts.any():
        maps = maps[:1]
        plan.warnings.append(f"no impact in this run: all maps are the same, measured with {maps[0]}")
    refused = set()
    try:
        for refine in plan.ladder():
            for impact in maps:
                if impact in refused:
                    continue
                plan.text = f"{impact}, dt = {plan.options.fixed_dt / refine:.3g} s"
                try:
                    runs[impact, refine] = plan.run(impact, refine)
                except PenetrationError:
                    raise
                except InputError as error:
                    refused.add(impact)
                    plan.warnings.append(f"{impact} is left out: {error}")
    except OutOfTime:
        plan.warnings.append("the time allowed ended before the whole ladder was run")
    return _judge(plan, reference, twin, runs)


def _references(plan: Plan) -> tuple[Run, Run]:
    """The reference and its twin, within half the budget; with a shorter ladder where that is not enough."""
    plan.limit = 0.5
    while True:
        refine = float(REFERENCE * plan.finest)
        plan.text = f"reference, dt = {plan.options.fixed_dt / refine:.3g} s"
        try:
            twin = plan.run(IMPACT_MAPS[0], refine / 2)
            reference = plan.run(IMPACT_MAPS[0], refine)
        except OutOfTime:
            if plan.finest == 1:
                raise InputError(
                    "The reference takes longer than the time allowed",
                    name="budget",
                    expected="time for a run with dt / 8",
                    got=f"{plan.budget:g} s",
                    remedy="Give a larger --budget or a shorter --duration",
                ) from None
            plan.finest //= 2
            plan.limit = 0.5 * (1.0 + plan.limit)
        else:
            plan.limit = 1.0
            return reference, twin


def _judge(plan: Plan, reference: Run, twin: Run, runs: dict[tuple[str, float], Run]) -> Bench:
    model = plan.scene.model
    size = min(np.pi, float(distance(model, reference, still(reference)).max(initial=0.0))) or 1.0
    # The finest run with the reference's own map: another map that goes another way says something about itself.
    finest = [runs[key] for key in sorted(runs, key=lambda key: key[1]) if key[0] == IMPACT_MAPS[0]][-1:]
    nodes = min(agreement(model, run, reference, size) for run in (twin, *finest))
    for run in finest:
        nodes = min(nodes, _last_accurate(distance(model, twin, reference), distance(model, run, reference), size))
    horizon = nodes * plan.node_dt
    own = distance(model, twin, reference)[: nodes + 1]
    reference_error = float(own.max(initial=0.0)) / (2.0**ORDER - 1.0)
    _warn(plan, reference, nodes)
    seconds = _repeat(plan, runs, nodes)
    rows: list[Row] = []
    for impact in dict.fromkeys(impact for impact, _ in runs):
        ladder = [(r, runs[m, r]) for m, r in runs if m == impact]
        rows += _rows(plan, impact, ladder, reference, nodes, size, reference_error, seconds)
    if rows and nodes and max(row.error for row in rows) < _ROUNDING * size:
        plan.warnings.append("the errors are rounding at every dt: the maps are exact on this motion")
    impacts = int(reference.counts[nodes].sum())
    return Bench(
        rows, horizon, plan.options.steps * plan.options.fixed_dt, plan.options.fixed_dt / (REFERENCE * plan.finest),
        reference_error, impacts, plan.warnings,
    )  # fmt: skip


def _last_accurate(near: Array, far: Array, size: float) -> int:
    """The last node at which the reference is still much closer to its twin than to the finest run.

    At order 2 the ratio is 1/16 (the twin's dt is 1/4 of the finest). Chaotic motion brings it to 1: from there on the
    reference is no better than what it judges.
    """
    n = min(len(near), len(far))
    near, far = np.maximum.accumulate(near[:n]), np.maximum.accumulate(far[:n])
    bad = np.flatnonzero((near > 0.25 * far) & (far > 10.0 * _ROUNDING * size))
    return int(bad[0]) - 1 if len(bad) else n - 1


def _warn(plan: Plan, reference: Run, nodes: int) -> None:
    if reference.status:
        plan.warnings.append(f"the scene ends with {reference.status} at {reference.end:.6g} s")
    reached = len(reference.q) - 1
    if nodes == 0:
        plan.warnings.append("the runs do not agree beyond the start: no error can be given")
    elif nodes < reached - 1:
        plan.warnings.append(
            f"the finest runs agree up to {nodes * plan.node_dt:.6g} s only (chaotic motion or another sequence of "
            "impacts): errors and times are those up to there"
        )


def _repeat(plan: Plan, runs: dict[tuple[str, float], Run], nodes: int) -> dict[tuple[str, float], float]:
    """Fastest time up to the horizon; one repeat of every setting, then the next, while the budget lasts."""
    whole = nodes == plan.nodes
    best = {key: run.seconds if whole else np.inf for key, run in runs.items()}
    if nodes == 0:
        return {key: run.seconds for key, run in runs.items()}
    for number in range(REPEATS):
        for key in runs:
            plan.text = f"timing, repeat {number + 1}"
            try:
                best[key] = min(best[key], plan.run(*key, nodes=nodes).seconds)
            except OutOfTime:
                share = nodes / plan.nodes
                return {k: s if np.isfinite(s) else share * runs[k].seconds for k, s in best.items()}
    return best


def _rows(
    plan: Plan,
    impact: str,
    ladder: list[tuple[float, Run]],
    reference: Run,
    nodes: int,
    size: float,
    reference_error: float,
    seconds: dict[tuple[str, float], float],
) -> list[Row]:
    rows: list[Row] = []
    for refine, run in ladder:
        apart = distance(plan.scene.model, run, reference)[: nodes + 1]
        n = len(apart)
        error = float(apart.max(initial=0.0))
        follows = agreement(plan.scene.model, run, reference, size)
        note = ""
        if nodes == 0:
            note = "no common motion"
        elif n < nodes + 1:
            note = f"ends at {run.end:.4g} s: {run.status}"
        elif follows < nodes and error > LOST * size:
            note = f"another motion after {follows * plan.node_dt:.4g} s"
        elif not same_impacts(run, reference, n)[-1]:
            note = "another sequence of impacts"
        elif error < 3.0 * reference_error:
            note = "at the reference's own error"
        energy = float(np.abs(run.energy[:n] - reference.energy[:n]).max(initial=0.0))
        order = float("nan")
        if rows and not note and not rows[-1].note and error > 0 and rows[-1].error > 0:
            dt_ratio = rows[-1].dt * refine / plan.options.fixed_dt
            order = float(np.log(rows[-1].error / error) / np.log(dt_ratio))
        impacts = int(run.counts[n - 1].sum())
        rows.append(
            Row(impact, plan.options.fixed_dt / refine, error, energy, seconds[impact, refine], impacts, order, note)
        )
    return rows
