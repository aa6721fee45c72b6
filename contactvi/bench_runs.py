"""The runs of a bench: a ladder of time steps with common nodes, within a budget, and how far two runs agree."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.options import IMPACT_MAPS, Options
from contactvi.simulation import Simulator, simulate
from contactvi.trajectory import Trajectory

if TYPE_CHECKING:
    from contactvi.scene import Scene

Array = NDArray[np.float64]
Progress = Callable[[float, str], object]

COARSER = ((8, 4, 2), (10, 5, 2), (6, 3, 2), (4, 2), (9, 3), (5,), (7,), (3,), (2,), ())
FINER = (8, 4, 2, 1)
REFERENCE = 8  # times finer than the finest dt: 64 times more accurate at order 2
LOST = 0.1  # of the size of the motion: two runs this far apart no longer follow the same motion
_MAX_NODES = 400


@dataclass
class Run:
    """A run reduced to the common nodes."""

    q: Array
    energy: Array
    counts: NDArray[np.int64]  # (nodes, guards that were ever hit)
    labels: list[tuple[int, int]]
    status: str
    end: float
    seconds: float


class OutOfTime(Exception):
    """The budget is used up."""


class Plan:
    """The ladder of a scene and the clock of its budget."""

    def __init__(self, scene: Scene, options: Options, budget: float, progress: Progress | None) -> None:
        self.scene, self.options, self.budget = scene, options, budget
        self.progress = progress or (lambda fraction, text: None)
        self.start = time.perf_counter()
        self.warnings: list[str] = []
        self.limit = 1.0  # share of the budget at which a run is given up
        steps = options.steps
        coarser = next(chain for chain in COARSER if all(steps % f == 0 for f in chain))
        per_node = coarser[0] if coarser else 1
        self.nodes = steps // per_node
        self.stride = next(s for s in range(1, self.nodes + 1) if self.nodes % s == 0 and self.nodes // s <= _MAX_NODES)
        self.nodes //= self.stride
        self.node_dt = options.fixed_dt * per_node * self.stride
        self.coarser, self.finest, self.text = coarser, 1, ""
        self._choose(self._step_cost())

    @property
    def used(self) -> float:
        """Share of the budget [1]."""
        return (time.perf_counter() - self.start) / self.budget

    def tick(self, *_: Any) -> None:
        """Progress callback of the engine."""
        self.progress(min(1.0, self.used), self.text)
        if self.used > self.limit:
            raise OutOfTime

    def ladder(self) -> list[float]:
        """Refinements of the scene's dt, coarse to fine: 1/8, ..., 8."""
        return [1.0 / f for f in self.coarser] + [float(f) for f in reversed(FINER) if f <= self.finest]

    def run(self, impact: str, refine: float, nodes: int | None = None) -> Run:
        """Run with dt / refine up to a node, and keep the common nodes."""
        count = self.nodes if nodes is None else nodes
        every = round(self.node_dt / self.options.fixed_dt * refine)
        dt = self.node_dt / every
        traj = simulate(
            self.scene, duration=count * every * dt, dt=dt, impact=impact, record_every=every, throw=False,
            tol=self.options.tol, max_iterations=self.options.max_iterations,
            max_impacts_per_step=self.options.max_impacts_per_step, progress=self.tick,
        )  # fmt: skip
        self.tick()
        return reduce_run(traj, self.node_dt)

    def _step_cost(self) -> float:
        """Seconds per step, from steps of the scene for at most 2 % of the budget."""
        simulator = Simulator(self.scene, **replace(self.options, record_every=1_000_000).to_dict())
        simulator.reset()
        begin, done, block = time.perf_counter(), 0, 1
        while done < self.options.steps and time.perf_counter() - begin < 0.02 * self.budget:
            block = min(2 * block, self.options.steps - done)
            done += block
            if not simulator.run(block).ok:
                break
        return (time.perf_counter() - begin) / max(1, done)

    def _choose(self, cost: float) -> None:
        """Take the finest ladder that fits in 70 % of the budget with one repeat; else shorten the run."""
        whole = cost * self.options.steps

        def need(finest: int) -> float:
            runs = sum(1.0 / f for f in self.coarser) + sum(f for f in FINER if f <= finest)
            return whole * (2.0 * len(IMPACT_MAPS) * runs + 1.5 * REFERENCE * finest)

        limit = 0.7 * self.budget
        self.finest = next((f for f in FINER if need(f) <= limit), 1)
        if need(1) > limit:
            self.nodes = max(1, int(self.nodes * limit / need(1)))
            self.warnings.append(
                f"the time allowed is enough for the first {self.nodes * self.node_dt:.4g} s of the scene only "
                f"(--budget {need(1) / 0.7:.0f} for all of it)"
            )


def reduce_run(traj: Trajectory, node_dt: float) -> Run:
    """Keep the states at the nodes, the energy without the impacts, and how often each guard was hit up to each."""
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
    return Run(traj.q[at_node], energy, table, labels, name, float(traj.status.time), traj.stats.seconds)


def distance(model: pin.Model, run: Run, reference: Run) -> Array:
    """|q - q_ref| at the nodes both have."""
    n = min(len(run.q), len(reference.q))
    if model.nq == model.nv:
        return np.asarray(np.linalg.norm(run.q[:n] - reference.q[:n], axis=1))
    return np.array([np.linalg.norm(pin.difference(model, reference.q[k], run.q[k])) for k in range(n)])


def same_impacts(run: Run, reference: Run, n: int) -> NDArray[np.bool_]:
    """At which nodes each guard was hit equally often."""
    same = np.ones(n, dtype=bool)
    for label in set(run.labels) | set(reference.labels):
        columns = [
            r.counts[:n, r.labels.index(label)] if label in r.labels else np.zeros(n, dtype=np.int64)
            for r in (run, reference)
        ]
        same &= columns[0] == columns[1]
    return same


def agreement(model: pin.Model, run: Run, reference: Run, size: float) -> int:
    """The last node up to which a run follows the reference.

    Impact times differ by O(dt^2), so that counts may differ at a node for a moment; what matters is where they stop
    being equal for good.
    """
    apart = distance(model, run, reference)
    lost = np.flatnonzero(apart > LOST * size)
    last = int(lost[0]) - 1 if len(lost) else len(apart) - 1
    same = np.flatnonzero(same_impacts(run, reference, last + 1))
    return int(same[-1]) if len(same) else 0


def still(run: Run) -> Run:
    """The run standing still where it starts: the distance from it is the size of the motion."""
    return replace(run, q=np.repeat(run.q[:1], len(run.q), axis=0))
