"""A run with steps of one length: the engine's simulator, the record of what it did, and the checks of the record.

Its inputs are checked already, by `simulate` and by `Simulator`.
"""

from __future__ import annotations

import copy
import time
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import ConstraintError, SimulationError
from contactvi.options import Options
from contactvi.records.contacts import Contact, ContactLog
from contactvi.records.events import EventLog
from contactvi.records.recent import Recent
from contactvi.simulation import engine
from contactvi.simulation.compatibility import Stall, check_unforced
from contactvi.simulation.engine import Progress
from contactvi.simulation.messages import REACHED
from contactvi.simulation.recorder import ROUNDING, Record
from contactvi.simulation.snapshot import Snapshot
from contactvi.simulation.targets import Targets
from contactvi.simulation.tolerances import LedgerWatch
from contactvi.status import Status, StatusCode
from contactvi.trajectory.compiled import CompiledScene
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]

PROGRESS_PERIOD = 0.1  # s of wall time between two calls of a progress callback, as in the engine
_BLOCK = 500  # steps between two checks of what was recorded, for a ledger with tolerances and for DTEC
_SUCCESS = StatusCode.SUCCESS
_NO_WAY_ON = (StatusCode.NEWTON_FAILED, StatusCode.EVENT_UNRESOLVED, StatusCode.CONSTRAINT)


class Run:
    """A run that has started.

    Attributes:
        refused: the error of a start that the engine refuses, else None; such a run makes no steps.
        unreachable: why the run ended where constraints could not be met, else None.
    """

    def __init__(
        self,
        compiled: CompiledScene,
        options: Options,
        q0: ArrayLike | None = None,
        v0: ArrayLike | None = None,
        t: float = 0.0,
    ) -> None:
        """Start at (q0, v0), by default that of the scene, at t [s].

        Raises:
            InputError: for a bad state. DerivativeError, NotDifferentiable: with record="gradient", for a scene without
                derivatives.
        """
        self._compiled, self.options = compiled, options
        if options.record == "gradient":
            compiled.check_differentiable()
        self._engine = engine.reuse(compiled, options)
        self._quick, self._stepped = self._steps_quickly(), False
        self.start(q0, v0, t)

    def start(self, q0: ArrayLike | None = None, v0: ArrayLike | None = None, t: float = 0.0) -> None:
        """Start again with the same engine, whose steps have the digits of those of a new one; as at first."""
        compiled, options = self._compiled, self.options
        self._record, self.refused = engine.start(self._engine, compiled, options, q0, v0, t)
        self.unreachable: ConstraintError | None = None
        self._watch = LedgerWatch(options.ledger) if options.ledger else None
        inelastic = options.impact == "dtec" and compiled.loses_energy
        self._stall = Stall(options.fixed_dt) if inelastic else None
        self._seen = (0, 0, 0, 0)  # blocks of nodes, events, contacts and dense steps that were inspected
        q, p = self._record.q[0][0], self._record.p[0][0]
        self._targets = Targets(compiled, q)
        self._before: tuple[float, Array, Array] | None = (self._record.start, q, p)

    def _steps_quickly(self) -> bool:
        """Return whether the engine may record single steps until they are asked for.

        Not where each step is looked at: with tolerances of a ledger, "dtec", inputs that are kept for derivatives or
        that the map refuses, and mean reactions over several steps.
        """
        options = self.options
        looked_at = bool(options.ledger) or options.impact == "dtec" or options.record == "gradient"
        refuses = options.impact == "mhc" and options.mhc_reference == "global"
        compiled = self._compiled
        means = options.record_every > 1 and bool(compiled.constraint_rows or compiled.followers)
        return not (looked_at or refuses or means)

    @property
    def compiled(self) -> CompiledScene:
        """The scene."""
        return self._compiled

    @property
    def record(self) -> Record:
        """What the engine has done so far."""
        self._collect()
        return self._record

    @property
    def status(self) -> Status:
        """The status after the last step."""
        return self._record.status

    def _collect(self) -> Status | None:
        """Record the single steps that the engine has kept; return the status, None where there are none."""
        if not self._stepped or (status := engine.take(self._engine, self._record)) is None:
            return None
        self._stepped = False
        return status

    @classmethod
    def of(cls, snapshot: Snapshot) -> Run:
        """Return a run that goes on from a snapshot."""
        run = cls.__new__(cls)
        run._compiled, run.options = snapshot.scene, snapshot.options
        run._engine = engine.reuse(snapshot.scene, snapshot.options)
        run._quick, run._stepped = run._steps_quickly(), False
        run.refused = None
        run.load(snapshot)
        return run

    @property
    def t(self) -> float:
        """Time [s]."""
        return self._engine.t

    @property
    def q(self) -> Array:
        """Configuration, shape (nq,)."""
        return np.array(self._engine.q)

    @property
    def v(self) -> Array:
        """Velocity, shape (nv,)."""
        return np.array(self._engine.v)

    @property
    def p(self) -> Array:
        """Momentum M(q) v, shape (nv,)."""
        return np.array(self._engine.p)

    def targets(self, target: Any, steps: int) -> Array | None:
        """Return the references of servos for the next steps, (steps, 2 nv); None without servos."""
        if target is None and not self._targets.joints:
            return None
        self._targets.check_count(steps)
        times: Array = self.t + self.options.fixed_dt * np.arange(steps, dtype=np.float64)
        return self._targets.rows(target, times)

    def advance(
        self, steps: int, forces: Array | None, targets: Array | None, progress: Progress | None = None
    ) -> Status:
        """Make steps with forces (steps, nv) and targets of servos (steps, 2 nv), or None; return the status."""
        return self._explained(self._make_steps(steps, forces, targets, progress))

    def quick_step(self, tau: Any, targets: Array | None) -> Status | None:
        """Make one step with the force tau, which is not checked yet; None: nothing was done, `step` has to do it."""
        if not self._quick or self._record.status.code is not _SUCCESS:
            return None
        self._stepped = True
        self._record.actuation.add_unseen(tau is not None)
        reached = self._engine.step(tau, targets)
        if isinstance(reached, float):
            status = self._record.status = Status(_SUCCESS, REACHED, reached)
            return status
        status_then = None if reached is None else self._collect()
        return None if status_then is None else self._explained(status_then)

    def begin_steps(self) -> _core.Simulator | None:
        """Return the engine, which may make steps that it records until they are asked for; None where it may not."""
        if not self._quick or self._record.status.code is not _SUCCESS:
            return None
        self._stepped = True
        self._record.actuation.add_unseen(True)
        return self._engine

    def end_steps(self, ordinary: bool) -> Status:
        """Return the status after such steps; ordinary: the engine says that there is nothing to look at."""
        if ordinary:
            status = self._record.status = Status(_SUCCESS, REACHED, self._engine.t)
            return status
        found = self._collect()
        return self._record.status if found is None else self._explained(found)

    def _explained(self, status: Status) -> Status:
        """Return the status of the last steps, with the constraints that were in the way where the run ended."""
        if status.code is not _SUCCESS and status.code in _NO_WAY_ON:
            self.unreachable = name_unreachable(self._record, self.q)
        return self._record.status

    def step(self, forces: Array | None, targets: Array | None, progress: Progress | None = None) -> Status:
        """Make one step; as `advance`. To hold Ctrl-C back would take longer than the step.

        A Ctrl-C that comes between a step and its record ends the run with the state after the step.
        """
        try:
            return self.advance(1, forces, targets, progress)
        except KeyboardInterrupt:
            if self.record.reached != self.t:
                self.interrupt()
            raise

    def _make_steps(self, steps: int, forces: Array | None, targets: Array | None, progress: Progress | None) -> Status:
        record = self.record
        self._before = self._present() if steps == 1 else None
        if forces is not None and np.any(forces):
            check_unforced(self.options)
            record.forced = True
        record.actuation.add(self._engine.t, forces, targets)
        if record.inputs is not None:
            record.inputs.add(steps, forces, targets)
        if self._watch is None and self._stall is None:
            return engine.advance(self._engine, record, steps, forces, progress, targets)
        last = time.perf_counter()
        for first in range(0, steps, _BLOCK):
            count = min(_BLOCK, steps - first)
            block = None if forces is None else forces[first : first + count]
            ahead = None if targets is None else targets[first : first + count]
            engine.advance(self._engine, record, count, block, progress, ahead)
            if not self._inspect().ok:
                break
            if progress is not None and time.perf_counter() - last > PROGRESS_PERIOD:
                last = time.perf_counter()
                progress(self.t, record.impacts)
        return record.status

    def _present(self) -> tuple[float, Array, Array]:
        """Return t, q and p as they are now, from the last node where every step records one."""
        record = self.record
        if self.options.record_every == 1:
            return float(record.t[-1][-1]), record.q[-1][-1], record.p[-1][-1]
        return self.t, self.q, self.p

    def _inspect(self) -> Status:
        """Look for stalled bouncing and for broken tolerances in what was recorded since the last call."""
        record = self.record
        nodes, events, contacts, dense_steps = self._seen
        if self._watch is None and events == len(record.events):
            return record.status
        block = record.ledger(max(0, nodes - 1), events, contacts, dense_steps)
        self._seen = len(record.t), len(record.events), len(record.contacts), len(record.dense_steps)
        stalled = None if self._stall is None else self._stall.find(block.events)
        if stalled is not None and record.status.ok:
            record.end(stalled)
        excess = None if self._watch is None else self._watch.check(block)
        if excess is not None:
            record.status = Status(StatusCode.LEDGER, str(excess), excess.time)
        if excess is not None or stalled is not None:
            record.cut(record.status.time)
        return record.status

    def last_step(self) -> tuple[float, Array, Array]:
        """Return time [s], q (nq,) and v (nv,) at the start of the last step.

        Of several steps that were made by one call it is the last node that was recorded before now.

        Raises:
            SimulationError: before the first step.
        """
        record = self.record
        before = self._start_of_step()
        if before is not None and before[0] < self.t:
            t, q, p = before
        else:
            times, states, momenta = record.nodes(max(0, len(record.t) - 2))
            earlier = np.flatnonzero(times < self.t)
            if not len(earlier):
                raise SimulationError(
                    "No step was made yet",
                    remedy="Call step() first",
                    expected="a state before the present one",
                    got="none",
                )
            t, q, p = float(times[earlier[-1]]), states[earlier[-1]], momenta[earlier[-1]]
        return t, q, np.asarray(self._compiled.core.velocity(q[None], p[None]))[0]

    def _start_of_step(self) -> tuple[float, Array, Array] | None:
        """Return t, q and p before the last call; None where it made several steps."""
        return cast("tuple[float, Array, Array] | None", self._engine.before) or self._before

    def contacts_since(self, start: float) -> ContactLog:
        """Return the contacts from `start` [s] until now: steps by their middle, impacts in (start, now]."""
        record = self.record
        first = len(record.contacts)
        while first > 0:
            first -= 1
            t = np.asarray(record.contacts[first]["t"])
            if len(t) and t[0] < start:
                break
        log = record.contact_log(first)
        middle, slack = log.t + 0.5 * log.h, ROUNDING * (self.t - start)
        return log.rows((middle > start + slack) & (middle <= self.t + slack))

    def contacts_now(self) -> list[Contact]:
        """Return the persistent contacts at the end of the last step, one `Contact` per point."""
        return list(self.record.contacts_at(self.t))

    def recent(self, since: float) -> Recent:
        """Return the present contacts, and what has happened after `since` [s]; earlier records are not looked at."""
        return self.record.recent(since, self.t)

    def release(self) -> None:
        """Give the engine to later runs of the scene; this run makes no more steps."""
        engine.release(self._engine, self._compiled, self.options)

    def save(self) -> Snapshot:
        """Return all of the present state, with what was recorded."""
        rest = (self._watch, self._stall, self._seen, self._targets, self._start_of_step())
        return Snapshot(self._compiled, self.options, self._engine.save(), self.record.copy(), copy.deepcopy(rest))

    def load(self, snapshot: Snapshot) -> None:
        """Go back to the state of a snapshot of this scene and these options; what follows is equal to the bit."""
        self._engine.load(snapshot.engine)
        self._record, self.unreachable = snapshot.record.copy(), None
        self._watch, self._stall, self._seen, self._targets, self._before = copy.deepcopy(snapshot.rest)

    def events(self) -> EventLog:
        """Return the impacts that were recorded."""
        self._shorten()
        return self.record.log()

    def _shorten(self) -> None:
        if self.options.last_steps:
            self.record.keep_last(self.options.last_steps)

    def trajectory(self) -> Trajectory:
        """Return what was recorded, the present state included."""
        self._shorten()
        return self.record.trajectory(self._engine)

    def interrupt(self) -> Status:
        """End the run where it is with the status INTERRUPTED."""
        self.record.status = Status.interrupted(self.t)
        return self.record.status


def name_unreachable(record: Record, q: Array) -> ConstraintError | None:
    """Return the error of constraints that cannot be met where a run ended, at q (nq,). Its status becomes CONSTRAINT.

    None where they can be met, where there are none, and where the run ended for another reason.
    """
    status, compiled = record.status, record.compiled
    if status.code not in _NO_WAY_ON or not compiled.constraint_rows:
        return None
    found = compiled.unreachable(q, status.time + record.options.fixed_dt)
    if found is not None:
        names = ", ".join(repr(name) for name in found.constraints)
        text = f"{status.message}: there is no way on for the constraints {names}"
        record.status = Status(StatusCode.CONSTRAINT, text, status.time)
    return found
