"""Several simulators stepped side by side by threads of the engine."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import InputError
from contactvi.inputs import array, count
from contactvi.simulation.engine import step_together as step_engines
from contactvi.simulation.run import Run
from contactvi.simulation.simulator import Simulator
from contactvi.status import Status
from contactvi.threads import Workers

Array = NDArray[np.float64]


def step_together(
    simulators: Sequence[Simulator],
    steps: int,
    forces: ArrayLike | None = None,
    targets: ArrayLike | None = None,
    workers: int | None = None,
) -> list[Status]:
    """Make steps of several simulators in threads of the engine; return their statuses.

    Each has the bits of its own `run` with inputs that stay the same, whatever the number of threads.

    Args:
        simulators: different ones, of models with equally many joints. steps: how many each makes.
        forces: a generalized force for each, (n, nv) [N, N m]; None: none.
        targets: references of the servos for each, (n, servo joints); None: where they go by default.
        workers: number of threads; None for one per core.

    Raises:
        InputError: for inputs of the wrong shape. SimulationError: a simulator is in use, or its run has ended.
    """
    steps, threads = count("steps", steps), Workers(workers).number
    with ExitStack() as held:
        runs = [simulator.lend(held) for simulator in simulators]
        if not runs:
            return []
        sizes = {run.compiled.states.nv for run in runs}
        if len(sizes) > 1:
            raise InputError(
                "Simulators of unlike scenes", name="simulators", expected="as many degrees of freedom in each",
                got=" and ".join(map(str, sorted(sizes))), remedy="Step those of one kind together",
            )  # fmt: skip
        tau = None if forces is None else runs[0].compiled.states.forces(forces, len(runs), "forces")
        wanted = _references(runs, targets)
        engines = {}
        for k, run in enumerate(runs):
            engine = None if run.compiled.core.calls_functions else run.begin_steps()
            if engine is not None:
                engines[k] = engine
        quick = list(engines)
        made = step_engines(list(engines.values()), steps, _of(tau, quick), _of(wanted, quick), threads)
        ordinary = dict(zip(quick, made, strict=True))
        found = []
        for k, run in enumerate(runs):
            status, left = run.status, steps
            if k in ordinary:
                left = max(0, steps - ordinary[k] - 1)
                status = run.end_steps(ordinary[k] == steps)
            if left and status.ok:
                status = run.advance(left, _of(tau, [k] * left), _of(wanted, [k] * left))
            found.append(status)
        return found


def _of(rows: Array | None, chosen: list[int]) -> Array | None:
    return None if rows is None else np.ascontiguousarray(rows[chosen])


def _references(runs: list[Run], targets: ArrayLike | None) -> Array | None:
    """Return the references of all servos, (n, 2 nv); those of runs of one scene are made together."""
    if targets is None:
        rows = [run.targets(None, 1) for run in runs]
        if all(row is None for row in rows):
            return None
        none = np.zeros((1, 2 * runs[0].compiled.states.nv))  # of a scene without servos: nothing follows it
        return np.concatenate([none if row is None else row for row in rows])
    width = np.shape(targets)[-1] if np.ndim(targets) == 2 else 0
    given = array("targets", targets, (len(runs), width), "references of the servos for each simulator")
    members: dict[int, list[int]] = {}
    for k, run in enumerate(runs):
        members.setdefault(id(run.compiled), []).append(k)
    found = np.zeros((len(runs), 2 * runs[0].compiled.states.nv))
    for group in members.values():
        found[group] = runs[group[0]].targets(given[group], len(group))
    return found
