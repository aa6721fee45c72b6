"""Runs of a plan, block after block: by the engine's threads where these can make them alone, else by Python's."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from contactvi.batch import engine
from contactvi.batch.blocks import Block, KeptRun
from contactvi.batch.plan import Plan, Report
from contactvi.batch.scenes import SceneCache
from contactvi.errors import ContactviError
from contactvi.interrupts import CtrlC
from contactvi.simulation.simulation import ended_early, run_compiled
from contactvi.status import Status, StatusCode
from contactvi.threads import Workers
from contactvi.trajectory.compiled import compile_scene
from contactvi.trajectory.trajectory import Trajectory

# Runs that are prepared at once: their inputs, scenes and results lie in memory together. At the end of a block the
# threads wait for the last of its runs, with more and more lanes of the kernel empty, which takes each of them about as
# long as half of the runs in its lanes; and the results of several blocks are copied into one.
BLOCK = 1024
BLOCK_BYTES = 2**26  # of the states of a block, so that blocks of long runs have fewer of them
_FIRST = 8  # runs for each thread in a block whose runs are to take a given time: as many as the kernel has lanes


def blocks_of(
    plan: Plan,
    workers: int,
    report: Report | None = None,
    scenes: SceneCache | None = None,
    seconds: float | None = None,
) -> Iterator[Block]:
    """Yield the results of the runs of a plan in their order; report(runs made) is called now and then.

    Args:
        seconds: time that a block is to take [s], by the time that the one before it took; None: blocks as large as
            memory allows.
    """
    known = SceneCache(plan.options) if scenes is None else scenes
    most = runs_of_block(plan)
    length = most if seconds is None else min(most, _FIRST * workers)
    first = 0
    while first < plan.runs:
        part, begun = plan.part(first, min(first + length, plan.runs)), time.perf_counter()
        block = block_of(part, workers, known, None if report is None else _after(first, report))
        if seconds is not None:
            took = max(time.perf_counter() - begun, 1e-6)
            length = max(workers, min(most, int(part.runs * seconds / took)))
        first += part.runs
        yield block


def runs_of_block(plan: Plan) -> int:
    """Return how many runs are made together: all blocks have as many, but for the last one."""
    most = max(1, min(BLOCK, int(BLOCK_BYTES / plan.bytes_of_a_run)))
    blocks = max(1, -(-plan.runs // most))
    return max(1, -(-plan.runs // blocks))


def block_of(plan: Plan, workers: int, scenes: SceneCache, report: Report | None = None) -> Block:
    """Return the results of the runs of a plan, made together."""
    if engine.possible(plan, compile_scene(plan.scene)):
        return engine.run(plan, scenes, workers, report)
    return _run_in_python(plan, scenes, workers, report)


def _after(first: int, report: Report) -> Report:
    return lambda made: report(first + made)


def _run_in_python(plan: Plan, scenes: SceneCache, workers: int, report: Report | None) -> Block:
    """Make runs whose steps are chosen, or that call functions: the interpreter lock is free only inside the engine."""
    lock, made = threading.Lock(), 0

    def one(k: int, check: Callable[[], None]) -> _Made:
        nonlocal made
        found = _run(plan, k, scenes, check)
        with lock:
            made += 1
            if report is not None:
                report(made)
        return found

    runs = Workers(workers).each(plan.runs, one)
    return _block(plan, runs)


class _Made:
    """A run, and the error that it ended with."""

    def __init__(self, traj: Trajectory | None, status: Status, error: ContactviError | None, ends: bool) -> None:
        self.status, self.error = status, error
        self.trajectory = None if ends and error is None else traj
        self.counts = (0, 0, 0.0, np.nan)
        self.nodes = (np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)))
        if traj is not None:
            self.counts = (len(traj.events), traj.stats.dense_steps, traj.stats.seconds, traj.error_estimate)
            nodes = slice(-1, None) if ends else slice(None)
            self.nodes = traj.t[nodes], traj.q[nodes], traj.v[nodes]


def _run(plan: Plan, k: int, scenes: SceneCache, check: Callable[[], None]) -> _Made:
    options, ends = plan.options, plan.keep == "ends"
    try:
        compiled = scenes.of(plan, k)
        control = plan.input("control", k)
        if control is not None and not callable(control):
            control = compiled.states.forces(control, options.steps)
        traj = run_compiled(
            compiled, options, plan.input("q0", k), plan.input("v0", k), control, plan.input("target", k),
            lambda t, impacts: check(), True, CtrlC(),
        )  # fmt: skip
    except ContactviError as error:
        status = getattr(error, "status", None) or Status(StatusCode.REFUSED, error.what, 0.0)
        partial = getattr(error, "trajectory", None)
        return _Made(partial, status, _kept(error, plan), ends)
    if traj.status.code == StatusCode.INTERRUPTED:
        raise KeyboardInterrupt
    early = None if traj.status.ok else ended_early(options, traj.status, traj if plan.keep == "runs" else None)
    return _Made(traj, traj.status, early, ends)


def _kept(error: ContactviError, plan: Plan) -> ContactviError:
    """Return an error without what was computed, where runs are not kept."""
    if plan.keep != "runs" and getattr(error, "trajectory", None) is not None:
        vars(error)["trajectory"] = None
    return error


def _block(plan: Plan, runs: list[_Made]) -> Block:
    model = plan.scene.model
    width = {"t": 1, "q": int(model.nq), "v": int(model.nv)}
    nodes = np.array([len(run.nodes[0]) for run in runs])
    columns = {name: np.full((len(runs), max(1, int(nodes.max())), size), np.nan) for name, size in width.items()}
    for k, run in enumerate(runs):
        for values, rows in zip(columns.values(), run.nodes, strict=True):
            if len(rows):
                values[k, : len(rows)] = rows.reshape(len(rows), -1)
    impacts, dense_steps, seconds, estimates = zip(*(run.counts for run in runs), strict=True)
    block = Block(columns | {
        "nodes": nodes, "code": np.array([int(run.status.code) for run in runs]),
        "time": np.array([run.status.time for run in runs]), "impacts": np.array(impacts),
        "dense_steps": np.array(dense_steps), "seconds": np.array(seconds), "error_estimate": np.array(estimates),
    })  # fmt: skip
    for k, run in enumerate(runs):
        if run.error is not None:
            block.fail(k, run.error, run.status)
    if plan.keep == "runs":
        block.trajectories = [KeptRun(partial(_trajectory, run)) for run in runs]
    return block


def _trajectory(run: _Made) -> Trajectory | None:
    return run.trajectory
