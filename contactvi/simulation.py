"""Running a scene: `simulate` for a whole run, `Simulator` step by step for control loops.

Every input is checked here; the engine (contactvi._core) only sees arrays of the right shape with finite numbers.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi import checks
from contactvi import events as event_log
from contactvi.endings import REMEDY, describe
from contactvi.errors import ContactviError, PenetrationError, SimulationError
from contactvi.ledger import Ledger, Watch
from contactvi.map_checks import Stall, check_map, check_unforced, loses_energy
from contactvi.options import IMPACT_MAPS, Options, check_names
from contactvi.status import Stats, Status, StatusCode
from contactvi.trajectory import Trajectory

if TYPE_CHECKING:
    from contactvi.scene import Scene

Array = NDArray[np.float64]
Progress = Callable[[float, int], object]
Control = Callable[[float, Array, Array], ArrayLike]

_BLOCK = 500  # steps between two looks at what was recorded, for a ledger with tolerances and for DTEC
_PROGRESS_PERIOD = 0.1  # s of wall time, the engine's own
_STATS = [field.name for field in fields(Stats)]


def simulate(
    scene: Scene,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    duration: float | None = None,
    dt: float | None = None,
    *,
    impact: str | None = None,
    order: int | None = None,
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
    duration : simulated time [s], a whole number of steps. dt : time step [s].
    impact, order, **options (mhc_reference, tol, record_every, ...) : see `Options`.
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
    """
    chosen = dict(options, duration=duration, dt=dt, impact=impact, order=order, ledger=ledger)
    settings = settings_of(scene, chosen)
    steps = settings.steps
    tau = None if control is None or callable(control) else checks.forces(scene.model, control, steps)
    simulator = Simulator(scene, **settings.to_dict())
    try:
        simulator.reset(q0, v0)
    except PenetrationError:
        if throw:
            raise
        return simulator.trajectory()
    if progress is True:
        from contactvi.progress import RunProgress

        with RunProgress(steps * settings.dt) as bar:
            _run(simulator, steps, control if callable(control) else tau, bar)
    else:
        _run(simulator, steps, control if callable(control) else tau, progress or None)
    traj = simulator.trajectory()
    if throw and not traj.status.ok:
        broken = traj.status.code == StatusCode.LEDGER
        fact = "exceeds a tolerance of its ledger" if broken else "ended before its time"
        raise SimulationError(
            f"The run {fact} with the status {traj.status.code.name}: {traj.status.message}",
            expected=f"t = {steps * settings.dt:.9g} s",
            got=f"t = {traj.status.time:.9g} s",
            remedy=REMEDY.get(traj.status.code),
            status=traj.status,
            trajectory=traj,
        )
    return traj


def settings_of(scene: Scene, chosen: Mapping[str, Any]) -> Options:
    """Return the options of a run: those chosen (not None), else those of the scene's file, else the defaults."""
    check_names(chosen)
    settings = dict(getattr(scene, "settings", None) or {})
    settings.update({name: value for name, value in chosen.items() if value is not None})
    return Options.from_dict(settings)


class Simulator:
    """A scene stepped by the caller, for control loops.

        sim = Simulator(scene, dt=1e-3)
        sim.reset(q0, v0)
        while sim.t < 1.0:
            status = sim.step(controller(sim.t, sim.q, sim.v))

    Parameters: the scene, dt [s] and the other options of `Options` (what is not given comes from the scene's file).
    The scene is taken as it is now; later edits do not reach a running simulator.
    """

    def __init__(self, scene: Scene, dt: float | None = None, **options: Any) -> None:
        self._scene_core = scene.core()
        self.scene = _snapshot(scene)
        self.options = settings_of(scene, dict(options, dt=dt))
        check_map(self.scene, self.options)
        self._pair_names = [(str(a), str(b)) for a, b in scene.pair_names]
        self._engine = self._new_engine()
        self._status: Status | None = None
        self._seen: tuple[int, int]
        self._clear()

    def reset(self, q0: ArrayLike | None = None, v0: ArrayLike | None = None, t: float = 0.0) -> None:
        """Put the system to (q0, v0) at time t [s] and forget what was recorded; defaults as in `simulate`.

        Raises InputError for a bad state and PenetrationError (pair, depth) where shapes overlap or a joint is beyond
        its limit.
        """
        model = self.scene.model
        q0 = getattr(self.scene, "q0", None) if q0 is None else q0
        v0 = getattr(self.scene, "v0", None) if v0 is None else v0
        q = checks.configuration(model, self.scene.neutral() if q0 is None else q0)
        v = checks.velocity(model, v0)
        start = float(checks.array("t", t, (), "the start time in seconds"))
        self._clear()
        self._engine = self._new_engine()  # its counters start at zero with it; making one takes microseconds
        result = self._call(self._engine.reset, q, v, start)
        self._add_node(start, q, np.asarray(self._scene_core.momentum(q[None], v[None]))[0])
        code = StatusCode(result["code"])
        self._status = Status(code, describe(code, result, self._names(result), self.options.impact), start)
        if code == StatusCode.PENETRATION:
            raise PenetrationError(
                f"The start is refused: {self._status.message}",
                pair=self._names(result),
                depth=float(result["depth"]),
                expected="gaps >= 0 and joints within their limits",
                got=f"{-float(result['depth']):.6g}",
                remedy=REMEDY[code],
            )
        if code != StatusCode.SUCCESS:
            raise SimulationError(f"The start is refused: {self._status.message}", status=self._status)

    def step(self, tau: ArrayLike | None = None) -> Status:
        """Make one step with the generalized force tau, shape (nv,) [N, N m]; return the status.

        Raises SimulationError when there is nothing to step: before `reset`, and after a run has ended with a status
        other than SUCCESS.
        """
        return self.run(1, None if tau is None else checks.force(self.scene.model, tau)[None])

    def run(self, steps: int, tau: ArrayLike | None = None, progress: Progress | None = None) -> Status:
        """Make `steps` steps, tau of shape (steps, nv) or None; return the status. Ends early as `simulate` does."""
        self._check_running()
        forces = None if tau is None else checks.forces(self.scene.model, tau, steps, "tau")
        if forces is not None and np.any(forces):
            check_unforced(self.options)
            self._forced = True
        if self._watch is None and self._stall is None:
            return self._advance(steps, forces, progress)
        last = time.perf_counter()
        for first in range(0, steps, _BLOCK):
            count = min(_BLOCK, steps - first)
            self._advance(count, None if forces is None else forces[first : first + count], progress)
            if not self._inspect().ok:
                break
            if progress is not None and time.perf_counter() - last > _PROGRESS_PERIOD:
                last = time.perf_counter()
                progress(self.t, self.impacts)
        assert self._status is not None
        return self._status

    def _advance(self, steps: int, forces: Array | None, progress: Progress | None) -> Status:
        result = self._call(self._engine.advance, steps, forces, self.options.record_every, progress)
        status = self._collect(result)
        error = result["error"]  # of the progress callback; Ctrl-C ends the run, anything else is the caller's
        if error is not None and not isinstance(error, KeyboardInterrupt):
            raise error
        return status

    def _inspect(self) -> Status:
        """Look for stalled bouncing and for broken tolerances in what was recorded since the last call."""
        assert self._status is not None
        nodes, events = self._seen
        if self._watch is None and events == len(self._events):
            return self._status
        t, q, p = (np.concatenate(parts[max(0, nodes - 1) :]) for parts in (self._t, self._q, self._p))
        arrays = event_log.join(self._events[events:], self.scene.model.nq, self.scene.model.nv)
        log = event_log.EventLog(arrays, self._pair_names, list(self.scene.model.names), self.options.impact)
        self._seen = len(self._t), len(self._events)
        cut = max(0, len(self._t[max(0, nodes - 1)]) - 1)  # of the block before only the last node
        block = Ledger(
            self._scene_core, self.options.dt, t[cut:], q[cut:], p[cut:], log,
            damping=self.scene.model.damping, forced=self._forced, start=float(self._t[0][0]),
        )  # fmt: skip
        stalled = None if self._stall is None else self._stall.find(log)
        if stalled is not None and self._status.ok:
            found = {"pair_kind": stalled[1], "pair": stalled[2], "accumulation_time": stalled[0]}
            text = describe(StatusCode.ZENO, found, log.label(*stalled[1:]), self.options.impact)
            self._status = Status(StatusCode.ZENO, text, stalled[0])
        excess = None if self._watch is None else self._watch.check(block)
        if excess is not None:
            self._status = Status(StatusCode.LEDGER, str(excess), excess.time)
        if excess is not None or stalled is not None:
            self._cut(self._status.time)
        return self._status

    def _cut(self, time: float) -> None:
        """Forget what was recorded after the first node at or after `time` [s]."""
        t, q, p = (np.concatenate(parts) for parts in (self._t, self._q, self._p))
        count = int(np.searchsorted(t, time)) + 1
        self._t[:], self._q[:], self._p[:] = [t[:count]], [q[:count]], [p[:count]]
        events = event_log.join(self._events, self.scene.model.nq, self.scene.model.nv)
        early = events["time"] <= max(time, self._t[0][-1])
        self._events[:] = [{name: values[early] for name, values in events.items()}]

    @property
    def t(self) -> float:
        """Time [s]."""
        return float(self._engine.t)

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

    @property
    def status(self) -> Status | None:
        """The status after the last step; None before `reset`."""
        return self._status

    @property
    def impacts(self) -> int:
        """Number of impacts since `reset`."""
        return sum(len(part["time"]) for part in self._events)

    @property
    def events(self) -> event_log.EventLog:
        """The impacts since `reset`."""
        arrays = event_log.join(self._events, self.scene.model.nq, self.scene.model.nv)
        return event_log.EventLog(arrays, self._pair_names, list(self.scene.model.names), self.options.impact)

    def trajectory(self) -> Trajectory:
        """Return what was recorded since `reset`, the present state included."""
        if self._status is None:
            self._check_running()
        assert self._status is not None
        t, q, p = (np.concatenate(parts) for parts in (self._t, self._q, self._p))
        # A run that ended inside a step has its last state there, not at a node.
        if self._status.time > t[-1]:
            t, q, p = np.append(t, self._status.time), np.vstack([q, self.q]), np.vstack([p, self.p])
        return Trajectory(
            self.scene, self.options, t, q, p, self.events, self._status, self._stats,
            forced=self._forced, core=self._scene_core,
        )  # fmt: skip

    def interrupt(self) -> Status:
        """End the run where it is with the status INTERRUPTED."""
        self._status = Status(StatusCode.INTERRUPTED, "stopped by the user", self.t)
        return self._status

    def _new_engine(self) -> Any:
        from contactvi import _core

        return _core.Simulator(
            self._scene_core,
            self.options.dt,
            self.options.tol,
            IMPACT_MAPS.index(self.options.impact),
            self.options.max_impacts_per_step,
            self.options.max_iterations,
            self.options.mhc_reference == "global",
        )

    def _clear(self) -> None:
        self._t: list[Array] = []
        self._q: list[Array] = []
        self._p: list[Array] = []
        self._events: list[dict[str, NDArray[Any]]] = []
        self._stats = Stats()
        self._forced = False
        self._watch = Watch(self.options.ledger) if self.options.ledger else None
        inelastic = self.options.impact == "dtec" and loses_energy(self.scene)
        self._stall = Stall(self.options.dt) if inelastic else None
        self._seen = (0, 0)  # blocks of nodes and of events that the watch has seen

    def _add_node(self, t: float, q: Array, p: Array) -> None:
        self._t.append(np.array([t]))
        self._q.append(np.array(q, dtype=float)[None])
        self._p.append(np.array(p, dtype=float)[None])

    def _check_running(self) -> None:
        if self._status is None:
            raise SimulationError("The simulator has no state yet", remedy="Call reset(q0, v0) first")
        if not self._status.ok:
            raise SimulationError(
                f"The run has ended: {self._status}", status=self._status, remedy="Call reset(q0, v0) to start again"
            )

    def _call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        from contactvi import _core

        try:
            return function(*arguments)
        except _core.CoreError as error:
            raise ContactviError(
                f"The engine failed: {error}", remedy="This is a bug: please report the scene"
            ) from error

    def _collect(self, result: dict[str, Any]) -> Status:
        """Take over what the engine did: nodes that `record_every` wants, events, counts, status."""
        t = np.asarray(result["t"])
        step = np.rint((t - self._t[0][0]) / self.options.dt)
        keep = (t > self._t[-1][-1]) & (step % self.options.record_every == 0)
        if np.any(keep):
            self._t.append(t[keep])
            self._q.append(np.asarray(result["q"])[keep])
            self._p.append(np.asarray(result["p"])[keep])
        if len(result["events"]["time"]):
            self._events.append(result["events"])
        # The engine counts from its reset, except for the seconds, which are those of this call.
        counts = {name: result["stats"][name] for name in _STATS}
        counts["seconds"] += self._stats.seconds
        self._stats = Stats(**counts)
        code = StatusCode(result["code"])
        self._status = Status(
            code, describe(code, result, self._names(result), self.options.impact), float(result["time"])
        )
        return self._status

    def _names(self, result: Mapping[str, Any]) -> tuple[str, str] | None:
        """Return the names of the pair or limit that the engine's status is about."""
        if int(result["pair"]) < 0:
            return None
        kind, index = int(result["pair_kind"]), int(result["pair"])
        return event_log.label(kind, index, self._pair_names, list(self.scene.model.names))


def _snapshot(scene: Scene) -> Scene:
    """Return the scene as it is now: the caller may edit his and run it again. What is built is shared, not copied."""
    taken = copy.copy(scene)
    for name, value in vars(scene).items():
        if isinstance(value, (list, dict)):
            setattr(taken, name, copy.copy(value))
    return taken


def _run(simulator: Simulator, steps: int, control: Array | Control | None, progress: Progress | None) -> None:
    last = time.perf_counter()
    try:
        if not callable(control):
            simulator.run(steps, control, progress)
            return
        for _ in range(steps):
            tau = control(simulator.t, simulator.q, simulator.v)
            if not simulator.step(tau).ok:
                return
            if progress is not None and time.perf_counter() - last > _PROGRESS_PERIOD:
                last = time.perf_counter()
                progress(simulator.t, simulator.impacts)
    except KeyboardInterrupt:
        simulator.interrupt()
