"""Stepping a scene by the caller: `Simulator`, for control loops.

Every input is checked here; the engine (contactvi._core) only gets arrays of the right shape with finite numbers.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import ConstraintError, InputError, SimulationError
from contactvi.options import Options, SteppingOptions, merged
from contactvi.records import events as event_log
from contactvi.records.contacts import Contact
from contactvi.simulation import engine
from contactvi.simulation.compatibility import Stall, check_elements, check_map, check_unforced
from contactvi.simulation.recorder import Record
from contactvi.simulation.targets import Targets
from contactvi.simulation.tolerances import LedgerWatch
from contactvi.status import Status, StatusCode
from contactvi.trajectory.compiled import CompiledScene, compile_scene
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from contactvi import _core
    from contactvi.scene.scene import Scene

Array = NDArray[np.float64]
Progress = Callable[[float, int], object]

_BLOCK = 500  # steps between two looks at what was recorded, for a ledger with tolerances and for DTEC
PROGRESS_PERIOD = 0.1  # s of wall time, the engine's own


def settings_of(scene: Scene, chosen: Mapping[str, Any], forced: bool = False) -> Options:
    """Return the options of a run: those chosen (not None), else those of the scene's file, else the defaults.

    Args:
        forced: whether it has inputs. These decide about a dt that is given nowhere (options.merged), and so do some
            elements of scenes.
    """
    fixed = forced or scene.built().needs_fixed_step is not None
    return Options.from_dict(merged(scene.settings, chosen, fixed))


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The state of a `Simulator`, opaque; it belongs to one scene and its options."""

    scene: CompiledScene
    options: Options
    engine: _core.Snapshot
    record: Record
    rest: Any


_NO_WAY_ON = (StatusCode.NEWTON_FAILED, StatusCode.EVENT_UNRESOLVED, StatusCode.CONSTRAINT)


class Simulator:
    """A scene stepped by the caller, for control loops::

        sim = Simulator(scene, dt=1e-3)
        sim.reset(q0, v0)
        while sim.t < 1.0:
            status = sim.step(controller(sim.t, sim.q, sim.v))

    Parameters: the scene, dt [s] (a number), and the other options of `Options` (what is not given comes from the
    scene's file). The scene is taken as it is now; later edits do not reach a running simulator.
    """

    def __init__(self, scene: Scene, dt: float | None = None, **options: Unpack[SteppingOptions]) -> None:
        if dt is None and scene.settings.get("dt") is None:
            settings = Options.from_dict({**scene.settings, **options})  # raises: there is no time step
        else:
            settings = settings_of(scene, dict(options, dt=dt))
        settings.require_fixed()
        self._set_up(compile_scene(scene), settings)

    @classmethod
    def of_compiled(cls, compiled: CompiledScene, options: Options) -> Simulator:
        simulator = cls.__new__(cls)
        simulator._set_up(compiled, options)
        return simulator

    def _set_up(self, compiled: CompiledScene, options: Options) -> None:
        self._scene, self.options = compiled, options
        check_map(compiled, options)
        check_elements(compiled, options)
        self._engine: _core.Simulator | None = None
        self._record: Record | None = None
        self.unreachable: ConstraintError | None = None  # why a run ended where constraints could not be met

    @cached_property
    def scene(self) -> Scene:
        """The scene as it was when the simulator was made."""
        return self._scene.scene()

    def reset(self, q0: ArrayLike | None = None, v0: ArrayLike | None = None, t: float = 0.0) -> None:
        """Put the system to (q0, v0) at time t [s] and forget what was recorded; defaults as in `simulate`.

        Raises:
            InputError: for a bad state and PenetrationError (pair, depth) where shapes overlap or a joint is beyond its
                limit.
        """
        self.unreachable = None
        self._engine = engine.make(self._scene, self.options)  # a new one, because its counters start at zero
        self._watch = LedgerWatch(self.options.ledger) if self.options.ledger else None
        inelastic = self.options.impact == "dtec" and self._scene.loses_energy
        self._stall = Stall(self.options.fixed_dt) if inelastic else None
        self._seen = (0, 0, 0)  # blocks of nodes, of events and of contacts that were inspected
        self._record, refused = engine.start(self._engine, self._scene, self.options, q0, v0, t)
        self._targets = Targets(self._scene, self._record.q[0][0])
        self._before: tuple[float, Array, Array] | None = (t, self._record.q[0][0], self._record.p[0][0])
        if refused is not None:
            raise refused

    def step(self, tau: ArrayLike | None = None, target: Any = None) -> Status:
        """Make one step; return the status.

        Args:
            tau: generalized force, shape (nv,) [N, N m], on top of what servos do.
            target: where servos are to go, as in `simulate`; None: where they go by default.

        Raises:
            SimulationError: when there is nothing to step: before `reset`, and after a run has ended with a status
                other than SUCCESS.
        """
        return self._run(1, None if tau is None else self._scene.states.force(tau)[None], target)

    def run(
        self, steps: int, tau: ArrayLike | None = None, progress: Progress | None = None, target: Any = None
    ) -> Status:
        """Make `steps` steps, tau of shape (steps, nv) or None; return the status. Ends early as `simulate` does."""
        if isinstance(steps, bool) or not isinstance(steps, (int, np.integer)) or steps < 0:
            raise InputError("Number of steps", name="steps", expected="a whole number >= 0", got=repr(steps))
        forces = None if tau is None else self._scene.states.forces(tau, steps, "tau")
        return self._run(steps, forces, target, progress)

    def _run(self, steps: int, forces: Array | None, target: Any, progress: Progress | None = None) -> Status:
        self._running()
        return self._advance(steps, forces, self._goals(target, steps), progress)

    def _goals(self, target: Any, steps: int) -> Array | None:
        """Return the references of servos for the next steps, (steps, 2 nv); None without servos."""
        if target is None and not self._targets.joints:
            return None
        return self._targets.rows(
            target, np.asarray(self.t + self.options.fixed_dt * np.arange(steps), dtype=np.float64)
        )

    def _advance(
        self, steps: int, forces: Array | None, goals: Array | None, progress: Progress | None = None
    ) -> Status:
        status = self._stepped(steps, forces, goals, progress)
        if status.code in _NO_WAY_ON and self._scene.constraint_rows:
            self.unreachable = self._scene.unreachable(self.q, status.time + self.options.fixed_dt)
            if self.unreachable is not None:
                names = ", ".join(repr(name) for name in self.unreachable.constraints)
                text = f"{status.message}: there is no way on for the constraints {names}"
                status = self._started().status = Status(status.code, text, status.time)
        return status

    def _stepped(self, steps: int, forces: Array | None, goals: Array | None, progress: Progress | None) -> Status:
        record = self._running()
        self._before = self._present(record) if steps == 1 else None
        if forces is not None and np.any(forces):
            check_unforced(self.options)
            record.forced = True
        if self._watch is None and self._stall is None:
            return engine.advance(self._running_engine, record, steps, forces, progress, goals)
        last = time.perf_counter()
        for first in range(0, steps, _BLOCK):
            count = min(_BLOCK, steps - first)
            block = None if forces is None else forces[first : first + count]
            ahead = None if goals is None else goals[first : first + count]
            engine.advance(self._running_engine, record, count, block, progress, ahead)
            if not self._inspect(record).ok:
                break
            if progress is not None and time.perf_counter() - last > PROGRESS_PERIOD:
                last = time.perf_counter()
                progress(self.t, self.impacts)
        return record.status

    def _present(self, record: Record) -> tuple[float, Array, Array]:
        """Return t, q and p as they are now, from the last node where every step records one."""
        if self.options.record_every == 1:
            return float(record.t[-1][-1]), record.q[-1][-1], record.p[-1][-1]
        return self.t, self.q, self.p

    def _inspect(self, record: Record) -> Status:
        """Look for stalled bouncing and for broken tolerances in what was recorded since the last call."""
        nodes, events, contacts = self._seen
        if self._watch is None and events == len(record.events):
            return record.status
        block = record.ledger(max(0, nodes - 1), events, contacts)
        self._seen = len(record.t), len(record.events), len(record.contacts)
        stalled = None if self._stall is None else self._stall.find(block.events)
        if stalled is not None and record.status.ok:
            record.end(stalled)
        excess = None if self._watch is None else self._watch.check(block)
        if excess is not None:
            record.status = Status(StatusCode.LEDGER, str(excess), excess.time)
        if excess is not None or stalled is not None:
            record.cut(record.status.time)
        return record.status

    @property
    def t(self) -> float:
        """Time [s]."""
        return float(self._running_engine.t)

    @property
    def q(self) -> Array:
        """Configuration, shape (nq,)."""
        return np.array(self._running_engine.q)

    @property
    def v(self) -> Array:
        """Velocity, shape (nv,)."""
        return np.array(self._running_engine.v)

    @property
    def p(self) -> Array:
        """Momentum M(q) v, shape (nv,)."""
        return np.array(self._running_engine.p)

    @property
    def status(self) -> Status | None:
        """The status after the last step; None before `reset`."""
        return None if self._record is None else self._record.status

    @property
    def impacts(self) -> int:
        """Number of impacts since `reset`."""
        return 0 if self._record is None else self._record.impacts

    @property
    def events(self) -> event_log.EventLog:
        """The impacts since `reset`."""
        return self._started().log()

    @property
    def contacts(self) -> list[Contact]:
        """The persistent contacts at the end of the last step: one `Contact` per point (contactvi.records.contacts)."""
        record = self._started()
        now = self.t
        log = record.contact_log(max(0, len(record.contacts) - 1))
        slack = 1e-9 * self.options.fixed_dt
        current = np.flatnonzero((np.abs(log.end - now) <= slack) & (log.h > 0.0))
        ended = {
            (change.pair, change.point)
            for change in record.change_log(max(0, len(record.changes) - 1))
            if change.change == "release" and change.time >= now - slack
        }
        return [log[int(k)] for k in current if (log[int(k)].pair, log[int(k)].point) not in ended]

    def reaction(self, name: str) -> Array:
        """Return the force of a constraint, the mean over the last step, shape (rows,); see Trajectory.reactions."""
        return self._started().forces.joined(-1).of(name)[-1].copy()

    def save(self) -> Snapshot:
        """Return all of the present state, with what was recorded, for `load`."""
        record = self._started()
        rest = (self._watch, self._stall, self._seen, self._targets, self._before)
        engine_state = self._running_engine.save()
        return Snapshot(self._scene, self.options, engine_state, record.copy(), copy.deepcopy(rest))

    def load(self, snapshot: Snapshot) -> None:
        """Go back to a state of `save`, of this simulator or another one of the same scene and options.

        What follows is equal to the bit. Raises InputError for a snapshot of another scene or other options.
        """
        if not isinstance(snapshot, Snapshot) or snapshot.scene is not self._scene or snapshot.options != self.options:
            got = "of another scene or other options" if isinstance(snapshot, Snapshot) else repr(snapshot)
            raise InputError("Snapshot", name="snapshot", expected="one of this scene and these options", got=got)
        if self._engine is None:
            self._engine = engine.make(self._scene, self.options)
        own = self._engine
        engine.call(lambda: own.load(snapshot.engine))
        self._record = snapshot.record.copy()
        self._watch, self._stall, self._seen, self._targets, self._before = copy.deepcopy(snapshot.rest)

    def copy(self) -> Simulator:
        """Return a simulator in the same state that goes on by itself."""
        twin = Simulator.of_compiled(self._scene, self.options)
        if self._record is not None:
            twin.load(self.save())
        return twin

    def __copy__(self) -> Simulator:
        return self.copy()

    def __deepcopy__(self, memo: Any) -> Simulator:
        return self.copy()

    def last_step(self) -> tuple[float, Array, Array]:
        """Return time [s], q (nq,) and v (nv,) at the start of the last step; of several steps by `run`, of the last
        node that was recorded before now. Raises SimulationError before the first step."""
        record = self._started()
        if self._before is not None and self._before[0] < self.t:
            t, q, p = self._before
        else:
            times, states, momenta = record.nodes(max(0, len(record.t) - 2))
            earlier = np.flatnonzero(times < self.t)
            if not len(earlier):
                raise SimulationError("No step was made yet", remedy="Call step() first")
            t, q, p = float(times[earlier[-1]]), states[earlier[-1]], momenta[earlier[-1]]
        return t, q, np.asarray(self._scene.core.velocity(q[None], p[None]))[0]

    def trajectory(self) -> Trajectory:
        """Return what was recorded since `reset`, the present state included."""
        return self._started().trajectory(self._engine)

    def interrupt(self) -> Status:
        """End the run where it is with the status INTERRUPTED."""
        record = self._started()
        record.status = Status(StatusCode.INTERRUPTED, "stopped by the user", self.t)
        return record.status

    @property
    def _running_engine(self) -> _core.Simulator:
        if self._engine is None:
            self._started()  # raises
        assert self._engine is not None
        return self._engine

    def _started(self) -> Record:
        if self._record is None:
            raise SimulationError("The simulator has no state yet", remedy="Call reset(q0, v0) first")
        return self._record

    def _running(self) -> Record:
        record = self._started()
        if not record.status.ok:
            raise SimulationError(
                f"The run has ended: {record.status}",
                status=record.status,
                remedy="Call reset(q0, v0) to start again",
            )
        return record
