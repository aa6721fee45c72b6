"""Runs of the battery with forces, in a process of their own as in batteries.runner, and runs made twice.

As a program: requests and answers as in runner.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

import contactvi as cvi
from batteries import force_laws, force_scenes, runner
from batteries.runner import Report
from contactvi import _core

# Evaluations and iterations of a mean step, each of a few microseconds: a hand whose fingers are thrown at each other
# takes some 250 to 600, its worst start 3400. They are counted because wall time is that of the other processes, too.
SLOW = 5000


def effort(stats: cvi.Stats) -> float:
    """Evaluations of guards and iterations of all solvers in a step, in the mean."""
    iterations = stats.stage_iterations + stats.contact_iterations + stats.cone_iterations
    dense = stats.dense_sweeps + stats.dense_gap_iterations
    return (stats.guards_evaluated + iterations + dense) / (stats.steps + 1)


def expected(drawn: force_scenes.Drawn, traj: cvi.Trajectory) -> bool:
    """Whether a run may end with its status: DTEC where impacts accumulate, a driven constraint where it jams."""
    code = traj.status.code.name
    jammed = force_laws.jams(traj, drawn.built) or (drawn.built.driven and code == "CONSTRAINT")
    return code in runner.ALLOWED_STATUSES[drawn.options["impact"]] or jammed


def examine(family: str, seed: int, **chosen: Any) -> Report:
    """Run one drawn scene and check all laws."""
    drawn = force_scenes.draw(family, seed, **chosen)
    start = time.perf_counter()
    traj = cvi.simulate(drawn.built.scene, drawn.q, drawn.v, throw=False, **drawn.options)
    found = [str(f) for f in force_laws.broken(traj, drawn.built)]
    if not expected(drawn, traj):
        found.insert(0, str(traj.status))
    seconds, stats = time.perf_counter() - start, traj.stats
    if effort(stats) > SLOW:
        found.append(f"slow: {effort(stats):.0f} evaluations and iterations a step")
    return Report(
        str(drawn), traj.status.code.name, found, traj.status.time, len(traj.events), stats.contact_steps, seconds
    )


def balance(family: str, seed: int, dt: float, **chosen: Any) -> float | None:
    """Relative error of the energy balance of a run of .2 s; None where the run ended early."""
    drawn = force_scenes.draw(family, seed, 0.2, dt=dt, impact="ctec", order=2, **chosen)
    traj = cvi.simulate(drawn.built.scene, drawn.q, drawn.v, throw=False, **drawn.options)
    if not traj.status.ok:
        return None
    return float(np.abs(traj.ledger.energy_balance).max()) / force_laws.energy_scale(traj)


def arrays(simulator: cvi.Simulator) -> list[np.ndarray]:
    """All that a run recorded."""
    traj = simulator.trajectory()
    forces = [] if traj.forces is None else [traj.forces.values, traj.forces.reactions]
    logs = [*traj.events.arrays.values(), *traj.contacts.arrays.values(), *traj.contact_changes.arrays.values()]
    return [traj.t, traj.q, traj.p, *forces, *logs]


def made_again(family: str, seed: int) -> list[str]:
    """Which of a second run, runs from a snapshot, from its bytes and of a copy, and `simulate` differ in any bit."""
    drawn = force_scenes.draw(family, seed, 0.12)
    options = dict(drawn.options)
    steps = round(options.pop("duration") / options["dt"])
    first, second = (cvi.Simulator(drawn.built.scene, **options) for _ in range(2))
    for simulator in (first, second):
        simulator.reset(drawn.q, drawn.v)
    step(first, steps // 2 + 1)
    if not first.status or not first.status.ok:
        return []
    snapshot, twin, rest = first.save(), first.copy(), steps - steps // 2 - 1
    step(first, rest)
    step(twin, rest)
    step(second, steps)
    wanted = arrays(first)
    first.load(snapshot)
    step(first, rest)
    kept = snapshot.engine.to_bytes()
    read = cvi.Simulator.of(replace(snapshot, engine=_core.Snapshot(snapshot.scene.core, kept)))
    step(read, rest)
    whole = cvi.simulate(drawn.built.scene, drawn.q, drawn.v, steps * options["dt"], throw=False, **options)
    runs = {"snapshot": arrays(first), "bytes": arrays(read), "copy": arrays(twin), "second run": arrays(second)}
    found = [name for name, got in runs.items() if not all(map(equal, got, wanted))]
    return found + ["simulate"] * (not equal(whole.q, wanted[1]))


def step(simulator: cvi.Simulator, steps: int) -> None:
    """Step until the run ends."""
    for _ in range(steps):
        if not simulator.step().ok:
            return


def equal(one: np.ndarray, two: np.ndarray) -> bool:
    """To the bit; NaN is NaN."""
    return np.array_equal(one, two, equal_nan=one.dtype.kind == "f")


if __name__ == "__main__":
    runner.main(examine)
