"""Running a scene: `simulate` for a whole run, `Simulator` step by step for control loops.

Every input is checked here; the engine (contactvi._core) only sees arrays of the right shape with finite numbers.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi import auto_step, engine
from contactvi import events as event_log
from contactvi.endings import REMEDY
from contactvi.errors import InputError, PenetrationError, SimulationError
from contactvi.ledger import Ledger
from contactvi.ledger_watch import Watch
from contactvi.map_checks import Stall, check_map, check_unforced
from contactvi.options import Options, merged
from contactvi.prepared import Prepared, prepare
from contactvi.record import Record
from contactvi.status import Status, StatusCode
from contactvi.trajectory import Trajectory

if TYPE_CHECKING:
    from contactvi.scene import Scene

Array = NDArray[np.float64]
Progress = Callable[[float, int], object]
Control = Callable[[float, Array, Array], ArrayLike]

_BLOCK = 500  # steps between two looks at what was recorded, for a ledger with tolerances and for DTEC
_PROGRESS_PERIOD = 0.1  # s of wall time, the engine's own


def simulate(
    scene: Scene,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    duration: float | None = None,
    dt: float | Literal["auto"] | None = None,
    *,
    impact: str | None = None,
    order: int | None = None,
    tol: float | None = None,
    sample_dt: float | None = None,
    control: ArrayLike | Control | None = None,
    throw: bool = True,
    progress: Progress | bool | None = None,
    ledger: Mapping[str, float] | None = None,
    **options: Any,
) -> Trajectory:
    """Run a scene from (q0, v0) and return its trajectory.

    Parameters
    ----------
    scene : the scene. What is not given below is taken from its file (scene.q0, scene.v0, scene.settings), then from
        the defaults: the neutral configuration, rest, and those of `Options`.
    q0 : initial configuration, Pinocchio's numbers, shape (nq,). v0 : initial velocity, shape (nv,).
    duration : simulated time [s]; a whole number of steps where dt is a number.
    dt : time step [s]; or "auto": the run finds the steps with which q is accurate to `tol`, and measures it
        (traj.error_estimate). By default "auto", and 1e-3 where a run cannot choose: with control, "dtec", order 2,
        record_every, or tolerances on the discrete energy or on jumps of the modified one.
    order : 2, 4, ... 16; by default 2 for a number as dt, 16 for "auto".
    tol : for a number as dt what the equations of a step are solved to (1e-12); for "auto" the accuracy of q (1e-6).
    sample_dt : keep the states at every sample_dt [s] instead of those at the ends of the steps.
    impact, **options (mhc_reference, record_every, dense, ...) : see `Options`.
    control : generalized forces in Pinocchio's coordinates, constant over a step [N, N m]: an array of shape
        (steps, nv), or a function (t, q, v) -> (nv,) called at the start of each step.
    throw : raise SimulationError (with .status and .trajectory) when the run ends before its time, and
        PenetrationError when it starts in penetration; False returns what was computed, with its status.
    ledger : tolerances on what should be conserved, name -> bound, for example {"own_jump": 1e-10}; where one is
        exceeded the run ends with the status LEDGER. The names: contactvi.ledger.
    progress : called as progress(t, impacts) about ten times a second; True shows a progress bar.

    Raises
    ------
    InputError : for arguments of the wrong shape or range. PenetrationError, SimulationError : see `throw`.

    Warns
    -----
    AccuracyWarning : where "auto" did not reach tol; traj.error_estimate says what it reached.
    """
    chosen = dict(
        options, duration=duration, dt=dt, impact=impact, order=order, tol=tol, sample_dt=sample_dt, ledger=ledger
    )
    settings = settings_of(scene, chosen, forced=control is not None)
    span = settings.span
    prepared = prepare(scene)
    if settings.auto and control is not None:
        raise InputError(
            "Inputs are constant over a step, so the run cannot choose it",
            name="dt",
            expected="a time in seconds with control",
            got="'auto'",
            remedy="Give dt=..., for example dt=1e-3",
        )
    steps = 0 if settings.auto else settings.steps
    inputs = control if control is None or callable(control) else prepared.states.forces(control, steps)
    if progress is True:
        from contactvi.progress import RunProgress

        with RunProgress(span) as bar:
            traj = _run(prepared, settings, q0, v0, inputs, bar, throw)
    else:
        traj = _run(prepared, settings, q0, v0, inputs, progress or None, throw)
    if throw and not traj.status.ok:
        broken = traj.status.code == StatusCode.LEDGER
        fact = "exceeds a tolerance of its ledger" if broken else "ended before its time"
        raise SimulationError(
            f"The run {fact} with the status {traj.status.code.name}: {traj.status.message}",
            expected=f"t = {span if settings.auto else steps * settings.fixed_dt:.9g} s",
            got=f"t = {traj.status.time:.9g} s",
            remedy=REMEDY.get(traj.status.code),
            status=traj.status,
            trajectory=traj,
        )
    return traj


def settings_of(scene: Scene, chosen: Mapping[str, Any], forced: bool = False) -> Options:
    """Return the options of a run: those chosen (not None), else those of the scene's file, else the defaults.

    forced : whether it has inputs, which count where neither says a dt (options.merged).
    """
    return Options.from_dict(merged(scene.settings, chosen, forced))


def _run(
    prepared: Prepared,
    options: Options,
    q0: ArrayLike | None,
    v0: ArrayLike | None,
    control: Array | Control | None,
    progress: Progress | None,
    throw: bool,
) -> Trajectory:
    if options.auto:
        return auto_step.run(prepared, options, q0, v0, progress, throw)
    simulator = Simulator._prepared(prepared, options)
    try:
        simulator.reset(q0, v0)
    except PenetrationError:
        if throw:
            raise
        return simulator.trajectory()
    try:
        if callable(control):
            _follow(simulator, options.steps, control, progress)
        else:
            simulator._run(options.steps, control, progress)
    except KeyboardInterrupt:
        simulator.interrupt()
    return simulator.trajectory()


def _follow(simulator: Simulator, steps: int, control: Control, progress: Progress | None) -> None:
    last = time.perf_counter()
    for _ in range(steps):
        tau = control(simulator.t, simulator.q, simulator.v)
        if not simulator.step(tau).ok:
            return
        if progress is not None and time.perf_counter() - last > _PROGRESS_PERIOD:
            last = time.perf_counter()
            progress(simulator.t, simulator.impacts)


class Simulator:
    """A scene stepped by the caller, for control loops::

        sim = Simulator(scene, dt=1e-3)
        sim.reset(q0, v0)
        while sim.t < 1.0:
            status = sim.step(controller(sim.t, sim.q, sim.v))

    Parameters: the scene, dt [s] (a number), and the other options of `Options` (what is not given comes from the
    scene's file). The scene is taken as it is now; later edits do not reach a running simulator.
    """

    def __init__(self, scene: Scene, dt: float | None = None, **options: Any) -> None:
        if dt is None and scene.settings.get("dt") is None:
            settings = Options.from_dict({**scene.settings, **options})  # raises: there is no time step
        else:
            settings = settings_of(scene, dict(options, dt=dt))
        settings.require_fixed()
        self._set_up(prepare(scene), settings)

    @classmethod
    def _prepared(cls, prepared: Prepared, options: Options) -> Simulator:
        simulator = cls.__new__(cls)
        simulator._set_up(prepared, options)
        return simulator

    def _set_up(self, prepared: Prepared, options: Options) -> None:
        self._scene, self.options = prepared, options
        check_map(prepared, options)
        self._engine: Any = None
        self._record: Record | None = None

    @cached_property
    def scene(self) -> Scene:
        """The scene as it was when the simulator was made."""
        return self._scene.scene()

    def reset(self, q0: ArrayLike | None = None, v0: ArrayLike | None = None, t: float = 0.0) -> None:
        """Put the system to (q0, v0) at time t [s] and forget what was recorded; defaults as in `simulate`.

        Raises InputError for a bad state and PenetrationError (pair, depth) where shapes overlap or a joint is beyond
        its limit.
        """
        self._engine = engine.make(self._scene, self.options)  # a new one: its counters start at zero
        self._watch = Watch(self.options.ledger) if self.options.ledger else None
        inelastic = self.options.impact == "dtec" and self._scene.loses_energy
        self._stall = Stall(self.options.fixed_dt) if inelastic else None
        self._seen = (0, 0, 0)  # blocks of nodes, of events and of contacts that the watch has seen
        self._record, refused = engine.start(self._engine, self._scene, self.options, q0, v0, t)
        if refused is not None:
            raise refused

    def step(self, tau: ArrayLike | None = None) -> Status:
        """Make one step with the generalized force tau, shape (nv,) [N, N m]; return the status.

        Raises SimulationError when there is nothing to step: before `reset`, and after a run has ended with a status
        other than SUCCESS.
        """
        return self._run(1, None if tau is None else self._scene.states.force(tau)[None])

    def run(self, steps: int, tau: ArrayLike | None = None, progress: Progress | None = None) -> Status:
        """Make `steps` steps, tau of shape (steps, nv) or None; return the status. Ends early as `simulate` does."""
        return self._run(steps, None if tau is None else self._scene.states.forces(tau, steps, "tau"), progress)

    def _run(self, steps: int, forces: Array | None, progress: Progress | None = None) -> Status:
        record = self._running()
        if forces is not None and np.any(forces):
            check_unforced(self.options)
            record.forced = True
        if self._watch is None and self._stall is None:
            return engine.advance(self._engine, record, steps, forces, progress)
        last = time.perf_counter()
        for first in range(0, steps, _BLOCK):
            count = min(_BLOCK, steps - first)
            block = None if forces is None else forces[first : first + count]
            engine.advance(self._engine, record, count, block, progress)
            if not self._inspect(record).ok:
                break
            if progress is not None and time.perf_counter() - last > _PROGRESS_PERIOD:
                last = time.perf_counter()
                progress(self.t, self.impacts)
        return record.status

    def _inspect(self, record: Record) -> Status:
        """Look for stalled bouncing and for broken tolerances in what was recorded since the last call."""
        nodes, events, contacts = self._seen
        if self._watch is None and events == len(record.events):
            return record.status
        t, q, p = record.nodes(max(0, nodes - 1))
        log = record.log(events)
        self._seen = len(record.t), len(record.events), len(record.contacts)
        cut = max(0, len(record.t[max(0, nodes - 1)]) - 1)  # of the block before only the last node
        block = Ledger(
            self._scene.core, self.options, t[cut:], q[cut:], p[cut:], log,
            model=self._scene.built.model, collision=self._scene.built.collision, forced=record.forced,
            start=record.start, contacts=record.contact_log(contacts), phases=record.phases_joined(),
        )  # fmt: skip
        stalled = None if self._stall is None else self._stall.find(log)
        if stalled is not None and record.status.ok:
            code = {"code": StatusCode.ZENO, "time": stalled[0], "accumulation_time": stalled[0]}
            record.end({**code, "pair_kind": stalled[1], "pair": stalled[2]})
        excess = None if self._watch is None else self._watch.check(block)
        if excess is not None:
            record.status = Status(StatusCode.LEDGER, str(excess), excess.time)
        if excess is not None or stalled is not None:
            record.cut(record.status.time)
        return record.status

    @property
    def t(self) -> float:
        """Time [s]."""
        self._started()
        return float(self._engine.t)

    @property
    def q(self) -> Array:
        """Configuration, shape (nq,)."""
        self._started()
        return np.array(self._engine.q)

    @property
    def v(self) -> Array:
        """Velocity, shape (nv,)."""
        self._started()
        return np.array(self._engine.v)

    @property
    def p(self) -> Array:
        """Momentum M(q) v, shape (nv,)."""
        self._started()
        return np.array(self._engine.p)

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

    def trajectory(self) -> Trajectory:
        """Return what was recorded since `reset`, the present state included."""
        record = self._started()
        return record.trajectory(self._engine)

    def interrupt(self) -> Status:
        """End the run where it is with the status INTERRUPTED."""
        record = self._started()
        record.status = Status(StatusCode.INTERRUPTED, "stopped by the user", self.t)
        return record.status

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
