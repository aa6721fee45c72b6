"""The runs of a bench: ladders of time steps with common nodes, within a budget, and how far two runs agree."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.options import DEFAULT_DT, IMPACT_MAPS, ImpactMap, Options, merged
from contactvi.simulation.simulation import Simulator, simulate
from contactvi.states import States
from contactvi.status import StatusCode
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from contactvi.scene.scene import Scene

Array = NDArray[np.float64]
Progress = Callable[[float, str], object]

FINER = (8, 4, 2, 1)
COARSEST = 10  # times the scene's dt at order 2
LEAST_STEPS = 8  # of a run at order 4 and higher
LOST = 0.1  # of the size of the motion: two runs this far apart no longer follow the same motion
_MAX_NODES = 400


class Setting(NamedTuple):
    """What is measured: impact map, order, and the length of a step in units of the scene's dt."""

    impact: ImpactMap
    order: int
    length: float


@dataclass
class Run:
    """A run reduced to the nodes that it shares with the reference, whose numbers are `node`."""

    node: NDArray[np.int64]
    q: Array
    energy: Array
    counts: NDArray[np.int64]  # impacts so far, (nodes, guards with an impact)
    labels: list[tuple[int, int]]
    status: str
    end: float
    seconds: float

    def until(self, node: int) -> int:
        """Return the number of nodes up to and including this one."""
        return int(np.searchsorted(self.node, node, side="right"))


class OutOfTime(Exception):
    """The budget is used up."""


def base_options(scene: Scene, chosen: dict[str, Any]) -> Options:
    """Return the settings around which the ladders are built; dt is about 1e-3 s unless a number is given."""
    settings = merged(scene.settings, {"order": 2} | {k: v for k, v in chosen.items() if v is not None}, forced=True)
    if not isinstance(settings["dt"], str):
        return Options.from_dict(settings)
    settings = {name: value for name, value in settings.items() if name != "tol"} | {"dt": DEFAULT_DT}
    span = float(settings.get("duration") or DEFAULT_DT)
    return Options.from_dict(settings | {"dt": span / max(1, round(span / DEFAULT_DT))})


class Plan:
    """The ladders of a scene and the clock of its budget."""

    def __init__(
        self, scene: Scene, options: Options, budget: float, orders: Sequence[int], progress: Progress | None
    ) -> None:
        self.scene, self.options, self.budget, self.orders = scene, options, budget, tuple(orders)
        self.progress = progress or (lambda fraction, text: None)
        self.start = time.perf_counter()
        self.warnings: list[str] = []
        self.limit = 1.0  # share of the budget after which a run is abandoned
        self.dt, steps = options.fixed_dt, options.steps
        self.lengths = divisors(steps)
        least = max(1, steps // _MAX_NODES)
        self.stride = next(s for s in range(least, steps + 1) if steps % s == 0 and steps // s <= _MAX_NODES)
        self.nodes = steps // self.stride
        self.node_dt = self.dt * self.stride
        self.finest, self.text = 1, ""
        self._choose({order: self._step_cost(order) for order in self.orders})

    @property
    def used(self) -> float:
        """Share of the budget [1]."""
        return (time.perf_counter() - self.start) / self.budget

    def tick(self, *_: Any) -> None:
        """Progress callback of the engine."""
        self.progress(min(1.0, self.used), self.text)
        if self.used > self.limit:
            raise OutOfTime

    def ladder(self, order: int) -> list[float]:
        """Lengths of the steps of an order in units of the scene's dt, long to short."""
        if order == 2:
            coarse = [float(f) for f in self.lengths if 1 < f <= COARSEST]
            return coarse[::-1] + [1.0 / f for f in reversed(FINER) if f <= self.finest]
        most = self.nodes * self.stride // LEAST_STEPS
        return [float(f) for f in reversed(self.lengths) if f <= max(1, most)]

    def run(self, setting: Setting, nodes: int | None = None) -> Run:
        """Run up to a node, or as far as whole steps go, and keep the common nodes; seconds are those up to it."""
        count = self.nodes if nodes is None else nodes
        per_dt = 1 if setting.length >= 1.0 else round(1.0 / setting.length)
        length = max(1, round(setting.length))
        dt = self.dt * length / per_dt
        steps = max(1, count * self.stride // length) * per_dt
        every = math.lcm(self.stride, length) // length * per_dt
        traj = simulate(
            self.scene, duration=steps * dt, dt=dt, impact=setting.impact, order=setting.order,
            record_every=min(every, steps), throw=False, dense=False, solver_tol=self.options.solver_tol,
            max_iterations=self.options.max_iterations, max_impacts_per_step=self.options.max_impacts_per_step,
            progress=self.tick,
        )  # fmt: skip
        if traj.status.code == StatusCode.INTERRUPTED:
            raise KeyboardInterrupt
        self.tick()
        found = reduce_run(traj, self.node_dt)
        return replace(found, seconds=found.seconds * count * self.node_dt / (steps * dt))

    def _step_cost(self, order: int) -> float:
        """Seconds per step of the scene's dt, from steps for at most 2 % of the budget in all."""
        settings = replace(self.options, record_every=1_000_000, order=order, dense=False, duration=None)
        simulator = Simulator(self.scene, **settings.to_dict())
        simulator.reset()
        begin, done, block = time.perf_counter(), 0, 1
        while done < self.options.steps and time.perf_counter() - begin < 0.02 * self.budget / len(self.orders):
            block = min(2 * block, self.options.steps - done)
            done += block
            if not simulator.run(block).ok:
                break
        return (time.perf_counter() - begin) / max(1, done)

    def _choose(self, cost: dict[int, float]) -> None:
        """Take the finest ladder that fits in 70 % of the budget with one repeat; else shorten the run."""

        def need(finest: int) -> float:
            self.finest = finest
            runs = sum(cost[order] / length for order in self.orders for length in self.ladder(order))
            return self.options.steps * (2.0 * len(IMPACT_MAPS) * runs + 6.0 * max(cost.values()))

        limit = 0.7 * self.budget
        self.finest = next((f for f in FINER if need(f) <= limit), 1)
        whole = need(self.finest)
        if whole > limit:
            self.nodes = max(1, int(self.nodes * limit / whole))
            self.warnings.append(
                f"the time allowed is enough for the first {self.nodes * self.node_dt:.4g} s of the scene only "
                f"(--budget {whole / 0.7:.0f} for all of it)"
            )


def divisors(steps: int) -> list[int]:
    """Return divisors of a number of steps from 1 on, neighbours at least 1.6 and where it can be about 2 apart."""
    low = [f for f in range(1, math.isqrt(steps) + 1) if steps % f == 0]
    known = sorted({*low, *(steps // f for f in low)})
    chosen = [1]
    while True:
        above = [f for f in known if f >= 1.6 * chosen[-1]]
        if not above:
            return chosen
        chosen.append(min(above, key=lambda f: abs(math.log(f / (2.0 * chosen[-1])))))


def reduce_run(traj: Trajectory, node_dt: float) -> Run:
    """Return the states at the nodes, the energy without the impacts, and the impacts of each guard up to each node."""
    number = np.rint(traj.t / node_dt)
    at_node = np.abs(traj.t - number * node_dt) <= 1e-6 * node_dt
    kinds, index, times = (traj.events.array(name) for name in ("kind", "index", "time"))
    labels = sorted(set(zip(kinds.tolist(), index.tolist(), strict=True)))
    t = traj.t[at_node]
    counts = [
        np.searchsorted(np.sort(times[(kinds == kind) & (index == i)]), t, side="right") for kind, i in labels
    ]  # fmt: skip
    table = np.array(counts, dtype=np.int64).T if counts else np.zeros((len(t), 0), dtype=np.int64)
    name = "" if traj.status.ok else traj.status.code.name
    energy = (traj.energy - traj.impact_energy)[at_node]
    node = number[at_node].astype(np.int64)
    return Run(node, traj.q[at_node], energy, table, labels, name, float(traj.status.time), traj.stats.seconds)


def distance(model: pin.Model, run: Run, reference: Run) -> Array:
    """Return |q - q_ref| at the nodes of a run up to the end of the reference."""
    q = reference.q[run.node[: run.until(len(reference.node) - 1)]]
    return States(model).distance(q, run.q[: len(q)])


def same_impacts(run: Run, reference: Run) -> NDArray[np.bool_]:
    """Return at which nodes of the run, up to the end of the reference, each guard had equally many impacts."""
    node = run.node[: run.until(len(reference.node) - 1)]
    same = np.ones(len(node), dtype=bool)
    for label in set(run.labels) | set(reference.labels):
        own, other = (
            r.counts[:, r.labels.index(label)] if label in r.labels else np.zeros(len(r.node), dtype=np.int64)
            for r in (run, reference)
        )
        same &= own[: len(node)] == other[node]
    return same


def agreement(model: pin.Model, run: Run, reference: Run, size: float) -> int:
    """Return the last node up to which a run follows the reference.

    Impact times differ by the error of the run, so that the counts may differ at single nodes: the last node with equal
    counts is taken.
    """
    apart = distance(model, run, reference)
    lost = np.flatnonzero(apart > LOST * size)
    last = int(lost[0]) - 1 if len(lost) else len(apart) - 1
    same = np.flatnonzero(same_impacts(run, reference)[: last + 1])
    return int(run.node[same[-1]]) if len(same) else 0


def still(run: Run) -> Run:
    """Return a run that rests at the start of this one: the distance from it is the size of the motion."""
    return replace(run, q=np.repeat(run.q[:1], len(run.q), axis=0))
