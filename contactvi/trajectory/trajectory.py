"""The result of a run: arrays over time, events, status, statistics."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.aliases import alias, renamed_arguments
from contactvi.errors import ContactviError, InputError
from contactvi.keywords import Passed
from contactvi.options import Options
from contactvi.records.actuation import Actuation
from contactvi.records.codes import STEP_KINDS
from contactvi.records.compliant_contacts import CompliantContacts, compliant_contacts
from contactvi.records.contacts import ChangeLog, ContactLog, empty_changes, empty_contacts
from contactvi.records.dense_steps import DenseSteps, no_dense_steps
from contactvi.records.events import EventLog
from contactvi.records.inputs import RunInputs
from contactvi.records.work import ConstraintRows, Forces, Work
from contactvi.scene.engine import engine_compliant_contacts
from contactvi.status import Stats, Status
from contactvi.trajectory.compiled import CompiledScene, compile_scene
from contactvi.trajectory.contact_ledger import ContactLedger
from contactvi.trajectory.coupled_reactions import coupled_rows, with_coupled
from contactvi.trajectory.efforts import Efforts, computed_efforts, efforts_known, efforts_of
from contactvi.trajectory.exports import Exports
from contactvi.trajectory.gaps import Gaps, gaps_along
from contactvi.trajectory.interpolation import interpolated, times_within
from contactvi.trajectory.ledger import Ledger, LedgerInputs
from contactvi.trajectory.polynomials import Segments, SegmentsApart, State, frame_times
from contactvi.trajectory.shown import run_html
from contactvi.trajectory.stepping import stepping_of

if TYPE_CHECKING:
    from contactvi import _core
    from contactvi.playback.page import write_html
    from contactvi.playback.render import render as draw
    from contactvi.playback.visuals import Visual
    from contactvi.scene.scene import Scene
    from contactvi.scene.separation import Separation
    from contactvi.trajectory.hessian import HessianVector
    from contactvi.trajectory.sensitivity import Sensitivity

Array = NDArray[np.float64]


@renamed_arguments(arcs="adaptive_steps")
class Trajectory(Exports):
    """A run: t (N,), q (N, nq), p (N, nv) at the recorded nodes, and what follows from them.

    q is Pinocchio's configuration, p = M(q) v the momentum of Pinocchio's tangent velocity v. v, energy and
    modified_energy are computed when first asked for and kept.

    Attributes:
        options: the settings of the run.
        events: the impacts, a sequence of `Event` (an `EventLog`).
        status: how the run ended.
        stats: what it cost.
        forced: whether the run had inputs (control) other than zero, or constraints, joint
            friction, servos, wrenches, dampers or forces given in Python.
        forces: work and reactions as arrays (contactvi.records.work.Forces), see `work` and `reactions`; None without.
        segments: the polynomials of its steps (contactvi.trajectory.polynomials), None without; `at` evaluates them.
        inputs: what acted in each step (contactvi.records.inputs.RunInputs), with record="gradient"; else None.
        actuation: what its motors were asked for (contactvi.records.actuation.Actuation), for `effort`; None of runs
            that are read from files, which have the efforts.
        contacts: every persistent contact of every step, and every impact, with its forces (a `ContactLog`); empty
            without, and with record_contacts=False.
        contact_changes: when contacts began, stuck, slipped, ended (a `ChangeLog`).
        phases: of a run with persistent contacts or dense steps, {"t": (k,), "dt": (k,), "kind": (k,)}: from these
            times [s] on steps have these lengths [s] and this kind: "free", "persistent" (contacts persist) or "dense"
            (all impacts are inside of them); else None. Persistent contacts are held in smooth steps of the run's order
            or met by contact steps of order 2, which `stats` counts and `stepping` tells. "persistent" has the kinds
            as numbers 0, 1 and 2 (contactvi.records.codes.StepKind).
        dense_steps: the dense steps and how exactly their law holds (contactvi.records.dense_steps); empty without.
        adaptive_steps: with dt="auto", {"t": (m,), "dt": (m,)}: from these times [s] on the steps have these lengths
            [s]; else None.
        error_estimate: with dt="auto", the measured error of q over the run [m, rad]
            (contactvi.simulation.auto_search); NaN where nothing was asked, with a number as dt, and of a run that was
            interrupted or ended where it started.
        separation: with start="separate", what was moved of the start that was given (contactvi.Separation); else None,
            and in runs that are read from files.

    Old names, kept for this release: arcs of adaptive_steps, "held" of "persistent" in phases.
    """

    def __init__(
        self,
        scene: Scene | CompiledScene,
        options: Options,
        t: Array,
        q: Array,
        p: Array,
        events: EventLog,
        status: Status,
        stats: Stats,
        *,
        forced: bool = False,
        segments: Segments | SegmentsApart | None = None,
        adaptive_steps: Mapping[str, Array] | None = None,
        error_estimate: float = float("nan"),
        derived: Mapping[str, Array] | None = None,
        gaps: Gaps | None = None,
        frames: tuple[Array, Array] | None = None,
        contacts: ContactLog | None = None,
        changes: ChangeLog | None = None,
        phases: Mapping[str, Array] | None = None,
        visuals: list[Visual] | None = None,
        forces: Forces | None = None,
        dense_steps: DenseSteps | None = None,
        inputs: RunInputs | None = None,
        actuation: Actuation | None = None,
    ) -> None:
        self._scene = scene
        # A run keeps the engine's scene that it was made with, because the Python scene may be edited afterwards.
        self._core = scene.core if isinstance(scene, CompiledScene) else None
        self.options = options
        self.t, self.q, self.p = t, q, p
        self.events = events
        self.status = status
        self.stats = stats
        self.forced = forced
        self.segments = segments
        self.adaptive_steps = None if adaptive_steps is None else dict(adaptive_steps)
        self.phases: dict[str, NDArray[Any]] | None = None
        if phases is not None:
            kind = np.array(STEP_KINDS)[np.asarray(phases["persistent"], dtype=np.int64)]
            self.phases = {**phases, "kind": kind, "held": phases["persistent"]}
        self.dense_steps = no_dense_steps() if dense_steps is None else dense_steps
        self.contacts = empty_contacts() if contacts is None else contacts
        self.contact_changes = empty_changes() if changes is None else changes
        self.error_estimate = error_estimate
        self._derived: dict[str, Array] = dict(derived or {})
        self._gaps = gaps
        self._frames = frames
        self._visuals = visuals
        self.forces = forces
        self._all_forces: Forces | None = None
        self.inputs = inputs
        self.actuation = actuation
        self.separation: Separation | None = None
        self._ledger: Ledger | None = None

    arcs = alias("adaptive_steps")

    @property
    def scene(self) -> Scene:
        """The scene that was run, as it was."""
        if isinstance(self._scene, CompiledScene):
            self._scene = self._scene.scene()
        return self._scene

    def __len__(self) -> int:
        return int(self.t.shape[0])

    def __repr__(self) -> str:
        return (
            f"<Trajectory: {len(self)} nodes, t = {self.t[0]:.6g} .. {self.t[-1]:.6g} s, "
            f"{len(self.events)} events, {self.status.code.name}>"
        )

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        return run_html(self)

    def __getstate__(self) -> dict[str, Any]:
        """Return what pickle and deepcopy keep: all but the engine's scene, which is built again when it is needed."""
        with contextlib.suppress(ContactviError):  # inputs that are not known, or a function that fails now
            self.all_efforts()
        return {**vars(self), "_scene": self.scene, "_core": None, "_ledger": None, "actuation": None}

    @property
    def stepping(self) -> str:
        """How it was stepped, in words, for example "order 2, dt = 0.01 s"."""
        return stepping_of(self)

    @property
    def v(self) -> Array:
        """Pinocchio's tangent velocity (body twist for a free body), shape (N, nv)."""
        return self._get("v", lambda core: core.velocity(self.q, self.p))

    @property
    def kinetic_energy(self) -> Array:
        """T [J], shape (N,)."""
        self._energies()
        return self._derived["kinetic_energy"]

    @property
    def potential_energy(self) -> Array:
        """V [J], of gravity, springs and potentials, shape (N,)."""
        self._energies()
        return self._derived["potential_energy"]

    @property
    def energy(self) -> Array:
        """H = T + V [J], shape (N,)."""
        return self.kinetic_energy + self.potential_energy

    @property
    def modified_energy(self) -> Array:
        """The modified Hamiltonian [J], shape (N,).

        At order 2 what the midpoint rule with step dt conserves to O(dt^4); from order 4 on H itself, whose nodes are
        within O(dt^order) of what the integrator conserves. With "dtec" and "mhc" steps with joint friction have order
        2, and with record="gradient" those with constraints.
        """
        return self._get("modified_energy", lambda core: self.ledger.modified_energy)

    @property
    def ledger(self) -> Ledger:
        """What should be conserved, node by node and impact by impact (contactvi.trajectory.ledger)."""
        if self._ledger is None:
            lacking = bool(self.scene.missing)
            energies = np.column_stack([self.kinetic_energy, self.potential_energy]) if lacking else None
            inputs = LedgerInputs(
                self.options, float(self.t[0]), self.forced, self.t, self.q, self.p, self.events, self.contacts,
                self.phases, self.forces, energies, self.dense_steps,
            )  # fmt: skip
            self._ledger = Ledger(self._engine(), self.scene.built(), inputs)
        return self._ledger

    @property
    def discrete_energy(self) -> Array:
        """E_d [J] of the step that starts at each node, NaN where an impact cuts it (and with inputs), shape (N,)."""
        return self._get("discrete_energy", lambda core: self.ledger.discrete_energy)

    @property
    def _dt(self) -> float:
        """Length of all steps [s]; NaN where they have several."""
        return float("nan") if self.options.auto else self.options.fixed_dt

    @property
    def impact_energy(self) -> Array:
        """H(p_plus) - H(p_minus) of the impacts up to each node [J], shape (N,); minus the loss with CTEC."""
        return self.events.total(self.events.energy_change, self.t, float(self.t[0]), self._dt)

    @property
    def impact_loss(self) -> Array:
        """What the laws of impacts took up to each node, by restitution and friction (>= 0) [J], shape (N,)."""
        return self.events.total(self.events.loss, self.t, float(self.t[0]), self._dt)

    @property
    def friction_loss(self) -> Array:
        """What sliding took in persistent contacts up to each node [J], shape (N,); to the error of the steps.

        With what contacts took in dense steps, by friction and restitution (`ledger.dense_loss` alone).
        """
        if not len(self.contacts) and not len(self.dense_steps):
            return np.zeros(len(self))
        ledger = ContactLedger(self.contacts, self.t, self.q, self.p, dense_steps=self.dense_steps)
        return ledger.friction_loss  # pictures need it without an engine

    @property
    def work(self) -> Work:
        """Work since the start at each node [J]: fields input, damping, joint_friction, prescribed, see `Work`.

        Known at the ends of steps; at samples (sample_dt) within a step in proportion, the ledger's balance too.
        """
        return self._forces().work

    @property
    def constraints(self) -> list[ConstraintRows]:
        """The constraints of the run: (name, kind, rows); after those that steps solve for those that couple joints."""
        if self.forces is None:
            return []
        known = {row.name for row in self.forces.constraints}
        coupled = coupled_rows(self.scene.built()) if self.forces.on_followers is not None else []
        more = [ConstraintRows(row.name, row.kind, row.rows) for row in coupled if row.name not in known]
        return [*self.forces.constraints, *more]

    def reactions(self, name: str) -> Array:
        """Return the mean force of a constraint over the time since the node before, impacts included, (N, rows).

        [N; N m], zero at the start: the force lambda with which J^T lambda acts on the momentum. Of a point in world
        axes on body b; of a weld force, then torque, on b at its origin, in the axes that `placement` has on a; of a
        distance the push along the line, negative for a pull; of a screw the forces along x and y, the moments about y
        and -x and the force along z on b, in the axes of frame_a; of a prescribed or following joint what acts on it;
        of a body with a prescribed pose force, then torque on it at its origin, in its axes.

        Linear joint equalities are coordinates of the engine: their reactions are computed here, from the momenta.

        Raises:
            InputError: for an unknown name.
        """
        return self.all_forces().of(name)

    def all_forces(self) -> Forces:
        """Return work and reactions, those of linear joint equalities among them."""
        forces = self._forces()
        if forces.on_followers is None:
            return forces
        if self._all_forces is None:
            self._all_forces = with_coupled(forces, self.p, self.scene.built())
        return self._all_forces

    def _forces(self) -> Forces:
        if self.forces is None:
            raise InputError(
                "The work of forces was not recorded", name="work", expected="a run of the engine", got="none",
                remedy="Run the scene with simulate or a Simulator",
            )  # fmt: skip
        return self.forces

    @property
    def visuals(self) -> list[Visual]:
        """What the viewer draws: a list of `contactvi.playback.visuals.Visual`."""
        if self._visuals is None:
            from contactvi.playback.scene_visuals import from_scene

            self._visuals = from_scene(self.scene)
        return self._visuals

    @property
    def gaps(self) -> Gaps:
        """Signed distances of the pairs that touched, at not more than 2000 times; unpacks as `t, pairs, gap`.

        The times are nodes; where these are too far apart for pictures, `frames` and impacts too.
        """
        if self._gaps is None:
            self._gaps = gaps_along(self, self._engine)
        return self._gaps

    def compliant_contacts(self) -> CompliantContacts:
        """Return the forces of compliant pairs (`Scene.set_compliance`) at the nodes, a row for each overlap.

        They are no rows of `contacts`, whose forces are means over steps: these are those of the law at the nodes.
        """
        pairs = self.scene.compliant_pairs
        numbers, values = np.zeros((0, 2)), np.zeros((0, 10))
        if pairs:
            numbers, values = engine_compliant_contacts(self._engine(), self.q, self.v)
        return compliant_contacts(pairs, self.t, numbers, values)

    def at(self, t: ArrayLike) -> State:
        """Return the state at time t [s], as accurate as the nodes: by a step that ends there, for the price of one.

        Args:
            t: one time, or an array of n times; then q, v, p of the state have a first axis n. At an impact it is the
                state after it. Of a run with inputs, which are not kept, it comes from the polynomials of the steps,
                accurate to O(h^(order/2 + 2)). Raises InputError outside the run, and for a run whose polynomials were
                not kept.
        """
        times = self._within(t)
        if self.segments is None:
            if len(self) == 1:
                q, v, p = (np.repeat(x, times.size, axis=0) for x in (self.q, self.v, self.p))
                return State(t, q, v, p) if np.ndim(t) else State(t, q[0], v[0], p[0])
            raise InputError(
                "The polynomials of the steps were not kept",
                name="dense",
                expected="a run with dense=True, or of order >= 4",
                got=f"dense={self.options.dense}, order {self.options.order}",
                remedy="Run it with dense=True; resample interpolates between the nodes",
            )
        core = self._engine()
        q, v = self.segments.states(core, times, exact=not self.forced and not self.scene.missing)
        last = times >= self.t[-1]  # where a run ends with an impact, the segments end before it
        q[last], v[last] = self.q[-1], core.velocity(self.q[-1:], self.p[-1:])[0]
        p = np.asarray(core.momentum(q, v))
        return State(np.array(t, dtype=float), q, v, p) if np.ndim(t) else State(float(times[0]), q[0], v[0], p[0])

    def sensitivity(self, wrt: Sequence[str] | str = ("q0", "v0"), *, on_kink: str = "raise") -> Sensitivity:
        """Return the exact derivatives of the run with respect to its start, inputs and parameters.

        Arguments and errors as those of contactvi.trajectory.sensitivity.Sensitivity. The run has to be one with
        record="gradient".
        """
        from contactvi.trajectory.sensitivity import Sensitivity

        return Sensitivity(self, self._compiled(), wrt, on_kink=on_kink)

    def gradient(
        self, cost: Any, wrt: Sequence[str] | str = ("q0", "v0"), *, on_kink: str = "raise"
    ) -> tuple[float | None, dict[str, Array]]:
        """Return a cost of the run and its exact gradient, whatever the number of inputs at the price of a few runs.

        Arguments, result and errors as those of contactvi.gradient.
        """
        from contactvi.trajectory.gradient import gradient

        return gradient(self, self._compiled(), cost, wrt, on_kink=on_kink)

    def hessian_vector(
        self,
        cost: Any,
        w: Mapping[str, Any],
        wrt: Sequence[str] | str | None = None,
        *,
        hessp: Any,
        method: str = "exact",
        on_kink: str = "raise",
    ) -> HessianVector:
        """Return the second derivative of a cost of the run times a direction.

        Arguments, result and errors as those of contactvi.hessian_vector.
        """
        from contactvi.trajectory.hessian import hessian_vector

        return hessian_vector(self, self._compiled(), cost, w, wrt, hessp=hessp, method=method, on_kink=on_kink)

    def _compiled(self) -> CompiledScene:
        return self._scene if isinstance(self._scene, CompiledScene) else compile_scene(self._scene)

    def resample(self, times: ArrayLike) -> Array:
        """Return configurations at these times [s] for pictures, shape (len(times), nq); `at` is the exact one.

        Between two known configurations (nodes, impacts, `frames`) every joint moves with constant velocity; free and
        planar bodies as R^3 x SO(3) and R^2 x SO(2), as the engine steps them. Raises InputError outside the run.
        """
        wanted = self._within(times)
        known = np.concatenate([self.t, self.events.array("time"), self.frames[0]])
        q = np.concatenate([self.q, self.events.array("q"), self.frames[1]])
        return interpolated(self.scene.model, known, q, wanted)

    @property
    def frames(self) -> tuple[Array, Array]:
        """(times (M,) [s], configurations (M, nq)) between nodes that are too far apart for pictures, 60 a second.

        Empty for runs whose nodes are near enough or whose polynomials were not kept. They are stored with the run.
        """
        if self._frames is None:
            times = np.zeros(0) if self.segments is None else frame_times(self.t)
            q = self.at(times).q if len(times) else np.zeros((0, self.q.shape[1]))
            self._frames = times, q
        return self._frames

    def _within(self, times: ArrayLike) -> Array:
        return times_within(times, float(self.t[0]), float(self.t[-1]))

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the run as one npz file (contactvi.trajectory.storage), whole or not at all; return its path.

        Raises:
            OverwriteError: there is such a file, without `overwrite`. InputError: a path that cannot be written.
        """
        from contactvi.trajectory.storage import save

        return save(self, path, overwrite)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a run written by `save`. Raises ContactviError for anything that is not such a file."""
        from contactvi.trajectory.storage import load

        return cls(**load(path))

    if TYPE_CHECKING:
        to_html, render = write_html, draw
    else:
        to_html = Passed("contactvi.playback.page", "write_html")
        render = Passed("contactvi.playback.render", "render")

    def efforts(self) -> Efforts:
        """Return the efforts of all driven joints with one degree of freedom, see `effort`; raises InputError."""
        return efforts_of(self.scene, self.t, self.all_efforts())

    @property
    def drives(self) -> bool:
        """Whether there are joints that are driven, with known efforts."""
        return self.efforts_known and bool(self.efforts().joints)

    @property
    def efforts_known(self) -> bool:
        """Whether it is known what the motors of the run were asked for."""
        return "effort" in self._derived or efforts_known(self)

    def all_efforts(self) -> Array:
        """Return the efforts of all degrees of freedom (N, nv). Raises InputError where they are not known."""
        if "effort" not in self._derived:
            self._derived["effort"] = computed_efforts(self)
        return self._derived["effort"]

    def _engine(self) -> _core.Scene:
        if self._core is None:
            self._core = self.scene.core()
        return self._core

    def _get(self, name: str, compute: Callable[[_core.Scene], Array]) -> Array:
        if name not in self._derived:
            self._derived[name] = np.asarray(compute(self._engine()), dtype=float)
        return self._derived[name]

    def _energies(self) -> None:
        if "kinetic_energy" not in self._derived or "potential_energy" not in self._derived:
            values = np.asarray(self._engine().energy(self.q, self.p), dtype=float)
            self._derived["kinetic_energy"] = values[:, 0]
            self._derived["potential_energy"] = values[:, 1]
