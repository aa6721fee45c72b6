"""Runs with steps of one length by the engine's own threads (contactvi._core.Batch)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from contactvi import _core
from contactvi.batch.blocks import Block, KeptRun
from contactvi.batch.plan import Plan, Report
from contactvi.batch.scenes import SceneCache
from contactvi.errors import ContactviError
from contactvi.inputs import usable
from contactvi.simulation import engine
from contactvi.simulation.compatibility import check_unforced
from contactvi.simulation.recorder import Record
from contactvi.simulation.results import EngineResult, EngineStatus
from contactvi.simulation.run import name_unreachable
from contactvi.simulation.simulation import ended_early, no_way_on
from contactvi.simulation.simulator import Simulator
from contactvi.simulation.targets import Targets
from contactvi.status import Status, StatusCode
from contactvi.trajectory.compiled import MOST_LOST, CompiledScene, compile_scene
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]


class Started(NamedTuple):
    """A run whose inputs can be used: what returns its scene, its start, what acts in its steps."""

    scene: Callable[[], CompiledScene]
    q: Array
    v: Array
    forces: Array | None
    targets: Array | None


class End(NamedTuple):
    """The state at the end of a run."""

    q: Array
    p: Array


def possible(plan: Plan, compiled: CompiledScene) -> bool:
    """Return whether the engine can make these runs without Python: nothing in it is called or asked in between."""
    options = plan.options
    watched = options.auto or options.ledger is not None or options.sample_dt is not None
    bounces = any(name.startswith("restitution") for name in (*plan.parameters, *plan.common))
    stalls = options.impact == "dtec" and (compiled.loses_energy or bounces)
    return not (watched or stalls or compiled.core.calls_functions or callable(plan.shared.get("control")))


def run(plan: Plan, scenes: SceneCache, workers: int, report: Report | None) -> Block:
    """Make the runs of a plan for which this is `possible`."""
    keep = _core.BatchKeep[plan.keep.upper()]
    options = plan.options
    batch = _core.Batch(engine.engine_options(options), options.steps, options.record_every, keep, MOST_LOST)
    changed = scenes.changed(plan)
    if changed is not None:
        places = [(_core.SceneNumber[kind], i, column) for kind, i, column in changed.places.places]
        batch.set_changes(changed.compiled.core, places)
    inputs = _Inputs(plan) if plan.start is None else _InputsFrom(plan, plan.start)
    if isinstance(inputs, _InputsFrom):
        batch.set_start(inputs.snapshot.engine)
    started: dict[int, tuple[int, Started]] = {}  # by run: its number in the batch
    errors: dict[int, ContactviError] = {}
    only: CompiledScene | None = None  # the scene of all runs
    for k in range(plan.runs):
        try:
            copied = changed is not None and bool(changed.usable[k])
            compiled = changed.compiled if changed is not None and copied else only or scenes.of(plan, k)
            only = None if plan.parameters else compiled
            copied = copied and inputs.with_pairs(k, compiled) is compiled  # copies are made of one scene
            compiled = inputs.with_pairs(k, compiled if copied or changed is None else scenes.of(plan, k))
            row = changed.rows[k] if changed is not None and copied else None
            found = inputs.start(k, compiled, partial(_scene_of, inputs, scenes, plan, k))
        except ContactviError as error:
            errors[k] = error
            continue
        forces = inputs.matrix("control", found.forces)
        batch.add(compiled.core, found.q, found.v, forces, inputs.last_targets, row)
        started[k] = (len(started), found)
    batch.run(workers, report)
    block = _block(plan, batch, started)
    for k, refused in errors.items():
        block.refuse(k, refused)
    _explain(plan, batch, started, block)
    if plan.keep == "runs":
        block.trajectories = [
            KeptRun(
                partial(_trajectory, plan, batch, *started[k]) if k in started and k not in block.errors else
                partial(_ended, block.errors.get(k))
            ) for k in range(plan.runs)
        ]  # fmt: skip
    return block


class _Inputs:
    """The inputs of the runs as the engine takes them; those that are the same in all runs are made once."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._shared: dict[str, _core.BatchInputs] = {}
        self._forces: Array | None = None
        self.last_targets: _core.BatchInputs | None = None
        states, rows = compile_scene(plan.scene).states, plan.rows
        self._q0s = states.configurations(rows["q0"]) if "q0" in rows else None
        self._v0s = usable(rows["v0"]) if "v0" in rows else None

    def start(self, k: int, compiled: CompiledScene, scene: Callable[[], CompiledScene]) -> Started:
        """Return the start of run k; raise ContactviError where it cannot be used.

        Args:
            compiled: the scene of the run, but for numbers that the engine changes in a copy. scene: returns that of
                the run itself.
        """
        plan, states = self._plan, compiled.states
        if self._q0s is None:
            q0 = plan.input("q0", k)
            q = states.configuration(compiled.q0 if q0 is None else q0)
        else:
            q = self._q0s[k]
        q, _ = engine.moved_apart(compiled, plan.options, q, 0.0)
        if self._v0s is None:
            v0 = plan.input("v0", k)
            given = compiled.v0 if v0 is None else v0
            v = compiled.start_velocity(q, 0.0) if given is None else states.velocity(given)
        else:
            v = self._v0s[k]
        try:
            compiled.check_on_constraints(q, v, 0.0)
        except ContactviError:
            scene().check_start(q, v, 0.0)  # a mass matrix that is singular is told first
            raise
        forces = self._control(k, compiled)
        targets = self._targets(k, Targets(compiled, q), 0.0)
        return Started(scene, q, v, forces, targets)

    def with_pairs(self, k: int, compiled: CompiledScene) -> CompiledScene:
        """Return the scene with the pairs that run k tests from its start; raise ContactviError for a bad one."""
        return compiled.at_start(self._plan.input("q0", k))

    def matrix(self, name: str, values: Array | None) -> _core.BatchInputs | None:
        """Return inputs for the engine, the same ones where all runs share them."""
        if values is None:
            return None
        if name in self._plan.rows:
            return _core.BatchInputs(values)
        if name not in self._shared:
            self._shared[name] = _core.BatchInputs(values)
        return self._shared[name]

    def _control(self, k: int, compiled: CompiledScene) -> Array | None:
        control, options = self._plan.input("control", k), self._plan.options
        if control is None:
            return None
        if self._forces is None or "control" in self._plan.rows:
            self._forces = compiled.states.forces(control, options.steps)
        if np.any(self._forces):
            check_unforced(options)
        return self._forces

    def _targets(self, k: int, of: Targets, start: float) -> Array | None:
        self.last_targets = None
        target, options = self._plan.input("target", k), self._plan.options
        if target is None and not of.joints:
            return None
        of.check_count(options.steps)
        rows = of.rows(target, start + options.fixed_dt * np.arange(options.steps, dtype=np.float64))
        assert rows is not None
        self.last_targets = _core.BatchInputs(rows)
        return rows


def _scene_of(inputs: _Inputs, scenes: SceneCache, plan: Plan, k: int) -> CompiledScene:
    """Return the scene of run k with its parameters and its pairs."""
    return inputs.with_pairs(k, scenes.of(plan, k))


class _InputsFrom(_Inputs):
    """The inputs of runs that go on from the present state of a simulator."""

    def __init__(self, plan: Plan, simulator: Simulator) -> None:
        super().__init__(plan)
        self.snapshot = simulator.save()
        self._q, self._v, self._t = simulator.q, simulator.v, simulator.t

    def with_pairs(self, k: int, compiled: CompiledScene) -> CompiledScene:
        """Return the scene as it is: the pairs are those of the simulator."""
        return compiled

    def start(self, k: int, compiled: CompiledScene, scene: Callable[[], CompiledScene]) -> Started:
        """Return the start of run k; raise ContactviError where its inputs cannot be used."""
        assert compiled.core is self.snapshot.scene.core
        targets = self._targets(k, self.snapshot.targets, self._t)
        return Started(scene, self._q, self._v, self._control(k, compiled), targets)


def _block(plan: Plan, batch: _core.Batch, started: dict[int, tuple[int, Started]]) -> Block:
    """Return the results of the runs that were started, with rows for the others."""
    model = plan.scene.model
    table: dict[str, Any] = dict(batch.table(int(model.nq), int(model.nv)))
    table["error_estimate"] = np.full(len(started), np.nan)
    if len(started) == plan.runs:
        return Block(table)
    columns = {}
    for name, values in table.items():
        empty = np.nan if values.dtype.kind == "f" else 0
        columns[name] = np.full((plan.runs, *values.shape[1:]), empty, dtype=values.dtype)
        columns[name][list(started)] = values
    return Block(columns)


def _explain(plan: Plan, batch: _core.Batch, started: dict[int, tuple[int, Started]], block: Block) -> None:
    """Enter the errors of the runs that ended before their time."""
    ended = (block.columns["code"] != StatusCode.SUCCESS) | (block.columns["nodes"] == 0)
    for k in np.flatnonzero(ended).tolist():
        if k not in started:
            continue
        row, found = started[k]
        try:
            error, status = _error(plan, batch, row, found, block.states(k)[1][-1:])
            block.fail(k, error, status)
        except ContactviError as error:  # of the engine itself
            block.refuse(k, error)


def _error(plan: Plan, batch: _core.Batch, row: int, found: Started, last: Array) -> tuple[ContactviError, Status]:
    """Return the error of a run that ended before its time, with its status; last: its last configuration (1, nq)."""
    status = batch.status(row)
    result = cast(EngineStatus, status)
    compiled = found.scene()
    if status["massless"]:
        compiled.check_start(found.q, found.v, 0.0)  # raises what the engine found
    record = Record(compiled, plan.options, 0.0, found.q, np.zeros(compiled.states.nv))
    if status["refused"]:
        ended = record.end(result, 0.0)
        return engine.refusal(ended, record.names(result), result["depth"]), ended
    record.end(result)
    unreachable = name_unreachable(record, last[0])
    traj, ended = _trajectory(plan, batch, row, found) if plan.keep == "runs" else None, record.status
    if unreachable is not None:
        return no_way_on(unreachable, ended, traj), ended
    return ended_early(plan.options, ended, traj), ended


def _trajectory(plan: Plan, batch: _core.Batch, row: int, found: Started) -> Trajectory:
    """Return a run that was kept, as `simulate` would have made it."""
    start_p, end_q, end_p, result = batch.result(row)
    record = Record(found.scene(), plan.options, 0.0, found.q, np.asarray(start_p))
    if found.forces is not None and np.any(found.forces):
        record.forced = True
    if record.inputs is not None:
        record.inputs.add(plan.options.steps, found.forces, found.targets)
    record.collect(cast(EngineResult, result))
    name_unreachable(record, np.asarray(end_q))
    return record.trajectory(cast(Any, End(np.asarray(end_q), np.asarray(end_p))))


def _ended(error: ContactviError | None) -> Trajectory | None:
    return getattr(error, "trajectory", None)
