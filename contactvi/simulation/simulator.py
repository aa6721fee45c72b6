"""Stepping a scene by the caller: `Simulator`, for control loops.

Every input is checked here; the engine (contactvi._core) only gets arrays of the right shape with finite numbers.
"""

from __future__ import annotations

import threading
from contextlib import ExitStack
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import ConstraintError, InputError, SceneError, SimulationError
from contactvi.inputs import MOST_STEPS, callback, short
from contactvi.interrupts import held_back
from contactvi.keywords import with_keywords
from contactvi.options import Options, SteppingOptions
from contactvi.records.contacts import Contact, ContactLog
from contactvi.records.events import EventLog
from contactvi.records.recent import Recent
from contactvi.simulation.compatibility import check_elements, check_map
from contactvi.simulation.engine import Progress
from contactvi.simulation.present_dynamics import PresentDynamics
from contactvi.simulation.run import Run
from contactvi.simulation.settings import settings_of
from contactvi.simulation.snapshot import Snapshot
from contactvi.status import Status
from contactvi.trajectory.compiled import CompiledScene, compile_scene, filled_scene
from contactvi.trajectory.coupled_reactions import with_coupled
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from contactvi.scene.build import Built
    from contactvi.scene.scene import Scene

Array = NDArray[np.float64]


class Simulator(PresentDynamics):
    """A scene stepped by the caller, for control loops::

        sim = Simulator(scene, dt=1e-3)
        sim.reset(q0, v0)
        while sim.t < 1.0:
            status = sim.step(controller(sim.t, sim.q, sim.v))

    Parameters: the scene, dt [s] (a number), and the other options of `Options` (what is not given comes from the
    scene's file). The scene is taken as it is now; later edits do not reach a running simulator. Of the pairs that
    overlap at the neutral pose, those are tested that are apart in the start of the last `reset`.

    One call at a time: while it steps, other threads and its own callbacks get a SimulationError (callbacks may read t,
    q and v). Threads take a `copy` each.

    Everything is recorded by default. record=n keeps the last n steps, and record=False nothing but the present state
    and the last step: contacts, reaction, last_step and last_contacts have them, trajectory() and events raise a
    SimulationError. The motion has the same digits with each.
    """

    @with_keywords(SteppingOptions)
    def __init__(self, scene: Scene, dt: float | None = None, **options: Unpack[SteppingOptions]) -> None:
        if dt is None and filled_scene(scene).settings.get("dt") is None:
            settings = Options.from_dict({**scene.settings, **options})  # raises: there is no time step
        else:
            settings = settings_of(filled_scene(scene), dict(options, dt=dt))
        settings.require_fixed()
        self.options = settings
        self._scene = compile_scene(scene)
        check_map(self._scene, settings)
        check_elements(self._scene, settings)
        self._run: Run | None = None
        self._follows = bool(self._scene.built.servo_joints)
        self._lock, self._user = threading.Lock(), 0

    @cached_property
    def scene(self) -> Scene:
        """The scene as it was when the simulator was made, with the pairs that are tested since the last reset."""
        return self._scene.scene()

    def built(self) -> Built:
        """Return the complete scene. Treat it as constant."""
        return self._scene.built

    def reset(self, q0: ArrayLike | None = None, v0: ArrayLike | None = None, t: float = 0.0) -> None:
        """Put the system to (q0, v0) at time t [s] and forget what was recorded; defaults as in `simulate`.

        Raises:
            InputError: for a bad state and PenetrationError (pair, depth) where shapes overlap or a joint is beyond its
                limit.
        """
        with self._unused():
            self._user = threading.get_ident()
            run, scene = self._run, self._scene.at_start(q0)
            if run is None or scene is not self._scene:
                run = Run(scene, self.options, q0, v0, t)
                self._take(scene, run)
            else:
                self._restart(run, q0, v0, t)
            if run.refused is not None:
                raise run.refused

    def _take(self, scene: CompiledScene, run: Run) -> None:
        """Go on with a run of the scene with the pairs that its start leaves apart."""
        self._scene, self._run = scene, run
        self.__dict__.pop("scene", None)

    def _restart(self, run: Run, q0: ArrayLike | None, v0: ArrayLike | None, t: float) -> None:
        """Start a run again; where the start is refused by a check it stays what it was."""
        try:
            run.start(q0, v0, t)
        except (InputError, SceneError, ConstraintError):
            raise
        except BaseException:  # of a function of the user, or Ctrl-C: the engine may have started already
            self._run = None
            raise

    def step(self, tau: ArrayLike | None = None, target: Any = None) -> Status:
        """Make one step; return the status.

        Args:
            tau: generalized force, shape (nv,) [N, N m], on top of what servos do.
            target: where servos are to go, as in `simulate`; None: where they go by default.

        Raises:
            SimulationError: when there is nothing to step: before `reset`, and after a run has ended with a status
                other than SUCCESS.
        """
        with self._unused():
            self._user = threading.get_ident()
            run = self._run
            if run is not None and target is None and not self._follows:
                status = run.quick_step(tau, None)
                if status is not None:
                    return status
        return self._advance(1, None if tau is None else self._scene.states.force(tau)[None], target)

    def run(
        self, steps: int, tau: ArrayLike | None = None, progress: Progress | None = None, target: Any = None
    ) -> Status:
        """Make `steps` steps; return the status. Ends early as `simulate` does.

        tau: generalized forces, shape (steps, nv), or (nv,) for all steps, or None.
        """
        if isinstance(steps, bool) or not isinstance(steps, (int, np.integer)) or not 0 <= steps <= MOST_STEPS:
            raise InputError(
                "Number of steps",
                name="steps",
                expected="a whole number >= 0",
                got=short(steps),
                remedy="Give a number of steps such as 1000; round(duration / dt) where it is a time",
            )
        forces = None if tau is None else self._scene.states.forces(tau, steps, "tau")
        return self._advance(steps, forces, target, callback("progress", progress))

    def _advance(self, steps: int, forces: Array | None, target: Any, progress: Progress | None = None) -> Status:
        with self._unused():
            self._user = threading.get_ident()
            run = self._going_on()
            targets = run.targets(target, steps)
            if steps == 1:
                return run.step(forces, targets, progress)
            with held_back() as ctrl_c:
                status = run.advance(steps, forces, targets, ctrl_c.watch(progress))
                return run.interrupt() if ctrl_c.settle() else status

    @property
    def t(self) -> float:
        """Time [s]."""
        return self._started().t

    @property
    def q(self) -> Array:
        """Configuration, shape (nq,)."""
        return self._started().q

    @property
    def v(self) -> Array:
        """Velocity, shape (nv,)."""
        return self._started().v

    @property
    def p(self) -> Array:
        """Momentum M(q) v, shape (nv,)."""
        return self._started().p

    @property
    def status(self) -> Status | None:
        """The status after the last step; None before `reset`."""
        return None if self._run is None else self._run.status

    @property
    def impacts(self) -> int:
        """Number of impacts since `reset`."""
        if self._run is None:
            return 0
        record = self._run.record
        return record.impacts if self.options.last_steps is None else record.stats.impacts

    @property
    def events(self) -> EventLog:
        """The impacts since `reset`; with record=n those of the last n steps.

        Raises:
            SimulationError: with record=False.
        """
        self._require_record("events")
        return self._started().events()

    @property
    def contacts(self) -> list[Contact]:
        """The persistent contacts at the end of the last step: one `Contact` per point (contactvi.records.contacts)."""
        return self._started().contacts_now()

    @property
    def _stepped(self) -> bool:
        run = self._started()
        return run.t != run.record.start

    def recent(self, since: float) -> Recent:
        """Return the present contacts, and the impacts and changes of contacts after `since` [s], as arrays.

        It takes as long as what is new, not as the whole record; with record=False that is the last step alone.
        """
        return self._started().recent(since)

    def reaction(self, name: str) -> Array:
        """Return the force of a constraint, the mean over the last step, shape (rows,); see Trajectory.reactions."""
        record, built = self._started().record, self._scene.built
        if name not in built.elements.couplings.names:
            return np.array(record.forces.joined(-1).of(name)[-1])
        _, _, p = record.nodes()
        forces = record.forces.joined().since(float(record.forces.joined().t[-2:][0]))
        return np.array(with_coupled(forces, p[-len(forces.t) :], built).of(name)[-1])

    def save(self) -> Snapshot:
        """Return all of the present state, with what was recorded, for `load`."""
        with self._unused():
            self._user = threading.get_ident()
            return self._started().save()

    def load(self, snapshot: Snapshot) -> None:
        """Go back to a state of `save`, of this simulator or another one of the same scene and options.

        What follows is equal to the bit. Raises InputError for a snapshot of another scene or other options; the scene
        of one that was read from a pickle is a scene of its own (`of`).
        """
        own = isinstance(snapshot, Snapshot) and snapshot.scene.same_but_start(self._scene)
        if not own or snapshot.options != self.options:
            got = "of another scene or other options" if isinstance(snapshot, Snapshot) else repr(snapshot)
            raise InputError(
                "Snapshot",
                name="snapshot",
                expected="one of this scene and these options",
                got=got,
                remedy="Load it into the simulator that saved it or a copy of it, or take Simulator.of(snapshot)",
            )
        with self._unused():
            self._user = threading.get_ident()
            if self._run is None or snapshot.scene is not self._scene:
                self._take(snapshot.scene, Run.of(snapshot))
            else:
                self._run.load(snapshot)

    @classmethod
    def of(cls, snapshot: Snapshot) -> Simulator:
        """Return a simulator of the snapshot's scene and options that goes on from it, with equal bits."""
        if not isinstance(snapshot, Snapshot):
            raise InputError(
                "Argument snapshot", name="snapshot", expected="what Simulator.save() returns", got=short(snapshot),
                remedy="Make a simulator of a scene with Simulator(scene, dt)",
            )  # fmt: skip
        return cls._made(snapshot.scene, snapshot.options, snapshot)

    @classmethod
    def _made(cls, scene: CompiledScene, options: Options, snapshot: Snapshot | None) -> Simulator:
        """Return a simulator from what was checked before; snapshot: None before the first reset."""
        sim = cls.__new__(cls)
        sim.options, sim._scene = options, scene
        sim._follows = bool(scene.built.servo_joints)
        sim._lock, sim._user = threading.Lock(), 0
        sim._run = None if snapshot is None else Run.of(snapshot)
        return sim

    def copy(self) -> Simulator:
        """Return a simulator in the same state that goes on by itself."""
        return self._made(self._scene, self.options, None if self._run is None else self.save())

    def __repr__(self) -> str:
        run = self._run
        state = "no state yet" if run is None else f"t = {run.status.time:.9g} s, {run.status.code.name}"
        return f"<Simulator: nq = {self._scene.states.nq}, nv = {self._scene.states.nv}, {state}>"

    def __copy__(self) -> Simulator:
        return self.copy()

    def __deepcopy__(self, memo: Any) -> Simulator:
        return self.copy()

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle keeps: the scene, the options and the present state (`Snapshot`)."""
        return type(self)._made, (self._scene, self.options, None if self._run is None else self.save())

    def last_step(self) -> tuple[float, Array, Array]:
        """Return time [s], q (nq,) and v (nv,) at the start of the last step.

        After `run` it is the last node that was recorded before now.

        Raises:
            SimulationError: before the first step.
        """
        return self._started().last_step()

    def last_contacts(self) -> ContactLog:
        """Return the contacts of the last step (see `last_step`), its impacts included."""
        run = self._started()
        return run.contacts_since(run.last_step()[0])

    def trajectory(self) -> Trajectory:
        """Return what was recorded since `reset`, the present state included; with record=n the last n steps.

        Raises:
            SimulationError: with record=False.
        """
        self._require_record("trajectory()")
        return self._started().trajectory()

    def interrupt(self) -> Status:
        """End the run where it is with the status INTERRUPTED."""
        return self._started().interrupt()

    def _require_record(self, what: str) -> None:
        if self.options.last_steps == 0:
            raise SimulationError(
                f"{what} needs a record, and this simulator keeps none",
                expected="a simulator that records its steps",
                got="record=False",
                remedy="Use record=1000 for the last 1000 steps, or leave record out",
            )

    def _unused(self) -> threading.Lock:
        """Return the lock of the simulator, for one call; raise SimulationError while another one has it.

        Of two calls that begin in the same instant one waits. The lock is taken by the `with` of the caller, so that
        no Ctrl-C comes between.
        """
        if self._lock.locked():
            raise self._busy()
        return self._lock

    def _busy(self) -> SimulationError:
        own = self._user == threading.get_ident()
        return SimulationError(
            "The simulator is in use",
            expected="one call at a time",
            got="a call from a callback of its own" if own else "a call from another thread",
            remedy="Give each thread a copy of its own: sim.copy()",
        )

    def lend(self, held: ExitStack) -> Run:
        """Return the run, which goes on, to be advanced by the caller (`step_together`) alone until `held` ends.

        Raises:
            SimulationError: as `step`.
        """
        held.enter_context(self._unused())
        self._user = threading.get_ident()
        return self._going_on()

    def _going_on(self) -> Run:
        run = self._started()
        if not run.status.ok:
            raise SimulationError(
                f"The run has ended: {run.status}",
                status=run.status,
                remedy="Call reset(q0, v0) to start again",
                expected="a run that goes on",
                got=run.status.code.name,
            )
        return run

    def _started(self) -> Run:
        if self._lock.locked() and self._user != threading.get_ident():
            raise self._busy()
        if self._run is None:
            raise SimulationError(
                "The simulator has no state yet",
                remedy="Call reset(q0, v0) first",
                expected="a state to step from",
                got="none",
            )
        return self._run
