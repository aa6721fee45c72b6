"""Run time against error for one scene: which order, which impact map and which time step for which error.

For every order a ladder of time steps: at order 2 the scene's dt times about 8, 4, 2, 1, 1/2, 1/4, 1/8, at the others
dt and coarser up to an eighth of the run, as far as the number of steps divides and the time allows. The reference is
a run of order 16 with dt / 2, its twin one of order 12. An error is the largest distance |q - q_ref| over the nodes
that a run shares with the reference, in the tangent space (metres and radians mixed, as they come).

An error is meaningful only while the runs follow one motion. The horizon is the last node up to which the
reference, its twin and the finest run of the lowest order with the same map have the same impacts and stay within LOST
of each other, relative to the size of the motion (at most half a turn, joints wind up), and the reference stays closer
to its twin than to what it judges; errors and times are those up to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactvi.bench.runs import (
    LOST,
    OutOfTime,
    Plan,
    Progress,
    Run,
    Setting,
    agreement,
    base_options,
    distance,
    same_impacts,
    still,
)
from contactvi.errors import InputError, PenetrationError
from contactvi.options import IMPACT_MAPS, ImpactMap
from contactvi.run_settings import ORDERS

if TYPE_CHECKING:
    from contactvi.scene.scene import Scene

REPEATS = 5
BENCHED = (2, 4, 8, 16)
REFERENCE, TWIN = (16, 0.5), (12, 0.5)  # order, step in units of the scene's dt
Array = NDArray[np.float64]
_ROUNDING = 1e-10  # of the size of the motion: 100 times the default tolerance of a step, gathered over the run


AT_REFERENCE = "at the reference's own error"  # the note of a row whose error is not its own


@dataclass(frozen=True)
class Row:
    """One measured setting.

    Attributes:
        impact: map.
        dt: [s].
        error: largest |q - q_ref| up to the horizon [m, rad].
        energy_error: largest difference from the reference of the energy without what the impacts took [J].
        seconds: fastest of the repeats, up to the horizon [s].
        impacts: up to the horizon.
        slope: order seen, log of the error ratio to the next coarser dt over that of the dt; nan for the first.
        note: why the row does not measure accuracy, empty where it does.
        order: of the integrator.
    """

    impact: str
    dt: float
    error: float
    energy_error: float
    seconds: float
    impacts: int
    slope: float = float("nan")
    note: str = ""
    order: int = 2


@dataclass
class Bench:
    """What was measured: rows, horizon [s], duration [s], reference dt [s] and its own error, impacts, warnings.

    Attributes:
        rounding: errors below it are not of the method.
    """

    rows: list[Row]
    horizon: float
    duration: float
    reference_dt: float
    reference_error: float
    impacts: int
    warnings: list[str] = field(default_factory=list)
    rounding: float = 0.0

    def good(self) -> list[Row]:
        """Rows whose error is that of the method."""
        return [row for row in self.rows if not row.note]

    def best(self, error: float) -> Row | None:
        """The fastest row at or below an error; of those within 10 % of its time, the most accurate one.

        A row at the reference's own error is good for every error that the reference is good for.
        """
        rows = [row for row in self.rows if not row.note and row.error <= error]
        rows += [row for row in self.rows if row.note == AT_REFERENCE and 3.0 * self.reference_error <= error]
        if not rows:
            return None
        fastest = min(row.seconds for row in rows)
        return min((row for row in rows if row.seconds <= 1.1 * fastest), key=lambda row: row.error)

    def slope(self, impact: str, order: int = 2) -> float:
        """Order seen over the whole ladder of a map: least squares in the logarithms; nan with less than 2 points."""
        rows = [row for row in self.good() if (row.impact, row.order) == (impact, order) and row.error > self.rounding]
        if len(rows) < 2:
            return float("nan")
        return float(np.polyfit(np.log([r.dt for r in rows]), np.log([r.error for r in rows]), 1)[0])


def bench(
    scene: Scene,
    *,
    budget: float = 60.0,
    maps: Sequence[ImpactMap] = IMPACT_MAPS,
    orders: Sequence[int] = BENCHED,
    progress: Progress | None = None,
    **options: Any,
) -> Bench:
    """Measure run time against error of a scene over orders, impact maps and time steps.

    Args:
        scene: with its start and settings (load_scene), which `options` override.
        budget: wall time allowed [s].
        maps, orders: what to compare.
        progress: called as progress(share of the budget, text).

    Raises:
        InputError: for bad settings.
        PenetrationError: for a start in penetration.
    """
    if not budget > 0 or not np.isfinite(budget):
        raise InputError(
            "budget is not usable",
            name="budget",
            expected="seconds, > 0",
            got=repr(budget),
            remedy="Give --budget 60, or budget=60.0: about a minute of measuring",
        )
    if not orders or any(order not in ORDERS for order in orders):
        raise InputError(
            "orders are not usable",
            name="orders",
            expected="even numbers from 2 to 16",
            got=str(orders),
            remedy="Give --orders 2,4,8, or orders=[2, 4, 8]",
        )
    plan = Plan(scene, base_options(scene, options), budget, sorted(set(orders)), progress)
    reference, twin = _references(plan)
    runs: dict[Setting, Run] = {}
    if not reference.counts.any() and not twin.counts.any():
        maps = maps[:1]
        plan.warnings.append(f"no impact in this run: all maps are the same, measured with {maps[0]}")
    refused: set[str] = set()
    exact = max(_ROUNDING * _size(plan, reference), float(distance(plan.scene.model, twin, reference).max(initial=0.0)))
    try:
        for order in plan.orders:
            for length in plan.ladder(order):
                found = [
                    _measure(plan, Setting(impact, order, length), runs, refused)
                    for impact in maps
                    if impact not in refused
                ]
                apart = [distance(plan.scene.model, run, reference) for run in found if run is not None]
                if order > 2 and apart and all(x.max(initial=0.0) < exact for x in apart):
                    break  # the errors of shorter steps would be rounding
    except OutOfTime:
        plan.warnings.append("the time allowed ended before the whole ladder was run")
    return _judge(plan, reference, twin, runs)


def _measure(plan: Plan, setting: Setting, runs: dict[Setting, Run], refused: set[str]) -> Run | None:
    plan.text = f"order {setting.order}, {setting.impact}, dt = {plan.dt * setting.length:.3g} s"
    try:
        runs[setting] = plan.run(setting)
        return runs[setting]
    except PenetrationError:
        raise
    except InputError as error:
        refused.add(setting.impact)
        plan.warnings.append(f"{setting.impact} is not measured: {error}")
    return None


def _size(plan: Plan, reference: Run) -> float:
    """Size of the motion [m, rad], at most half a turn."""
    return min(np.pi, float(distance(plan.scene.model, reference, still(reference)).max(initial=0.0))) or 1.0


def _references(plan: Plan) -> tuple[Run, Run]:
    """The reference and its twin, within half the budget."""
    plan.limit = 0.5
    try:
        plan.text = f"reference, order {REFERENCE[0]}"
        reference, twin = (plan.run(Setting(IMPACT_MAPS[0], *each)) for each in (REFERENCE, TWIN))
    except OutOfTime:
        raise InputError(
            "The reference takes longer than the time allowed",
            name="budget",
            expected=f"time for a run of order {REFERENCE[0]} with dt / 2",
            got=f"{plan.budget:g} s",
            remedy="Give a larger --budget or a shorter --duration",
        ) from None
    plan.limit = 1.0
    return reference, twin


def _judge(plan: Plan, reference: Run, twin: Run, runs: dict[Setting, Run]) -> Bench:
    model = plan.scene.model
    size = _size(plan, reference)
    # Only runs with the reference's map judge the reference: with another map they may follow another motion.
    own_map = [setting for setting in runs if setting.impact == IMPACT_MAPS[0]]
    finest = [runs[min(own_map, key=lambda setting: (setting.order, setting.length))]] if own_map else []
    nodes = min(agreement(model, run, reference, size) for run in (twin, *finest))
    near = distance(model, twin, reference)
    for run in finest:
        nodes = min(nodes, _last_accurate(near, run.node, distance(model, run, reference), size))
    reference_error = float(near[: nodes + 1].max(initial=0.0))
    _warn(plan, reference, nodes)
    seconds = _repeat(plan, runs, nodes)
    rows: list[Row] = []
    for impact, order in dict.fromkeys((setting.impact, setting.order) for setting in runs):
        ladder = {setting: run for setting, run in runs.items() if setting[:2] == (impact, order)}
        rows += _rows(plan, ladder, reference, nodes, size, reference_error, seconds)
    if rows and nodes and max(row.error for row in rows) < _ROUNDING * size:
        plan.warnings.append("the errors are rounding at every dt: the maps are exact on this motion")
    impacts = int(reference.counts[nodes].sum())
    span, rounding = plan.options.span, max(_ROUNDING * size, 10.0 * reference_error)
    return Bench(
        rows, nodes * plan.node_dt, span, REFERENCE[1] * plan.dt, reference_error, impacts, plan.warnings, rounding
    )


def _last_accurate(near: Array, node: NDArray[np.int64], far: Array, size: float) -> int:
    """The last node at which the reference is still much closer to its twin than to the finest run at its nodes.

    Chaotic motion brings the ratio to 1: from there on the reference is no better than what it judges.
    """
    count = min(int(np.searchsorted(node, len(near) - 1, side="right")), len(far))
    near = np.maximum.accumulate(near)[node[:count]]
    far = np.maximum.accumulate(far[:count])
    bad = np.flatnonzero((near > 0.25 * far) & (far > 10.0 * _ROUNDING * size))
    last = int(bad[0]) - 1 if len(bad) else count - 1
    return int(node[max(0, last)])


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


def _repeat(plan: Plan, runs: dict[Setting, Run], nodes: int) -> dict[Setting, float]:
    """Fastest time up to the horizon; one repeat of every setting, then the next, while the budget lasts."""
    whole = nodes == plan.nodes
    best = {setting: run.seconds if whole else np.inf for setting, run in runs.items()}
    if nodes == 0:
        return {setting: run.seconds for setting, run in runs.items()}
    for number in range(REPEATS):
        for setting in runs:
            plan.text = f"timing, repeat {number + 1}"
            try:
                best[setting] = min(best[setting], plan.run(setting, nodes=nodes).seconds)
            except OutOfTime:
                share = nodes / plan.nodes
                return {k: s if np.isfinite(s) else share * runs[k].seconds for k, s in best.items()}
    return best


def _rows(
    plan: Plan,
    ladder: dict[Setting, Run],
    reference: Run,
    nodes: int,
    size: float,
    reference_error: float,
    seconds: dict[Setting, float],
) -> list[Row]:
    rows: list[Row] = []
    for setting, run in ladder.items():
        count = run.until(nodes)
        apart = distance(plan.scene.model, run, reference)[:count]
        error = float(apart.max(initial=0.0))
        follows = agreement(plan.scene.model, run, reference, size)
        note = ""
        if nodes == 0:
            note = "no common motion"
        elif run.status and run.end < nodes * plan.node_dt * (1.0 - 1e-9):
            note = f"ends at {run.end:.4g} s: {run.status}"
        elif follows < run.node[count - 1] and error > LOST * size:
            note = f"another motion after {follows * plan.node_dt:.4g} s"
        elif not same_impacts(run, reference)[count - 1]:
            note = "another sequence of impacts"
        elif count < 2:
            note = "no node up to the horizon"
        elif error < 3.0 * reference_error:
            note = AT_REFERENCE
        energy = float(np.abs(run.energy[:count] - reference.energy[run.node[:count]]).max(initial=0.0))
        dt, slope = plan.dt * setting.length, float("nan")
        if rows and not note and not rows[-1].note and error > 0 and rows[-1].error > 0:
            slope = float(np.log(rows[-1].error / error) / np.log(rows[-1].dt / dt))
        impacts = int(run.counts[count - 1].sum())
        rows.append(Row(setting.impact, dt, error, energy, seconds[setting], impacts, slope, note, setting.order))
    return rows
