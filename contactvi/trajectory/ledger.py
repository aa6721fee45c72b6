"""The ledger of a run: what should be conserved, node by node and impact by impact, and tolerances on it.

Energies [J], momenta [N s, N m s] about the world's origin, in world axes. A loss is what the law of an impact takes by
restitution and friction; a jump has it added back: what an impact changes beyond its loss. What persistent contacts do
is in `Ledger.contacts` (contactvi.trajectory.contact_ledger).

Jumps of the three scalars at an impact (q_c, p_minus -> p_plus; `before` and `after` the parts of the step):

- energy H: T(p_plus) - T(p_minus) + loss.
- discrete energy E_d, the mean of E over the Gauss stages, of the partial step that starts at the impact less that of
  the one that ended there. Of several impacts at one instant each starts from what the one before it left.
- modified Hamiltonian of the full step length (H itself from order 4 on), of the node that the step would end at
  without further impacts less that of the node it started from; of several impacts in one step each starts from what
  the one before it left.

The work of damping between the two things compared (the stages of the parts, the two nodes) is no jump and is taken
off, with the Gauss weights of the stages.

Tolerances, the keys of the option `ledger` of a run, are upper bounds of

- energy, modified_energy, discrete_energy: drift from the start at the recorded nodes, losses added back, relative to
  the largest kinetic energy so far. Damping and inputs change these energies; a tolerance is for runs without.
- energy_jump, modified_energy_jump, discrete_energy_jump, own_jump (of the map used): likewise relative.
- linear_momentum, angular_momentum: distance from the start [N s], [N m s], for free bodies without gravity;
  linear_momentum_jump, angular_momentum_jump: at an impact of free bodies.
- energy_balance: of what H changed beyond the work of inputs and prescribed motions and the losses of damping, friction
  and impacts, relative to the largest kinetic energy so far. It is O(dt^2).
- energy_rise: how far the energy at a node is above the least one before it, relative to the largest kinetic energy so
  far: more than the error of the integrator is an error of a contact. For runs without inputs.
- dense_residual: of Coulomb's law in a dense step, over the largest free speed of a contact. dense_gap: how far a gap
  is below zero at its end [m]. dense_energy_rise: how far the energy rose in it beyond the error of the step, relative
  to the largest kinetic energy so far. See contactvi.records.dense_steps.
- impulse: how far one is below zero [N s]. complementarity: abs(gap * impulse) [N m s]. gap: abs(gap) [m]. Of impacts
  and of persistent contacts. impulse_balance: between two nodes, of free bodies [N s].

Inputs are not kept in a run. What needs a step to be made again (discrete energy, jumps but that of the energy) is NaN
where a run had some (or constraints, joint friction, servos, wrenches, dampers, forces of the user), and where the run
had to cut that step in two because its stage iterations did not converge. It is NaN, too, where there are persistent
contacts, constraints or joint friction, whose steps are not made again; own_jump is known there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from contactvi.aliases import alias
from contactvi.html import html_table
from contactvi.options import Options
from contactvi.records.codes import METHODS, Fallback
from contactvi.records.contacts import ContactLog
from contactvi.records.dense_steps import DenseSteps, no_dense_steps
from contactvi.records.events import EventLog
from contactvi.records.work import Forces
from contactvi.scene.build import Built
from contactvi.trajectory.contact_ledger import ContactLedger, adhesion_of, free_trees
from contactvi.trajectory.remade_steps import RemadeSteps

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LedgerInputs:
    """A run, or some consecutive nodes of it, as its ledger looks at it.

    Attributes:
        start: time at which the run began [s].
        forced: whether there were inputs or forces that a step which is made again does not have.
        t, q, p: nodes, shapes (N,) [s], (N, nq), (N, nv).
        events, contacts, phases, dense_steps: those of these nodes.
        forces: work and reactions at these nodes, None where they are not known.
        energies: T and V at the nodes (N, 2) of a run whose scene lacks functions of the user. What would have to be
            computed with them is NaN. None for a complete scene.
    """

    options: Options
    start: float
    forced: bool
    t: Array
    q: Array
    p: Array
    events: EventLog
    contacts: ContactLog
    phases: Mapping[str, Array] | None
    forces: Forces | None
    energies: Array | None = None
    dense_steps: DenseSteps = field(default_factory=no_dense_steps)


class Ledger:
    """See the module. Every array is computed when first asked for and kept.

    Per node, shapes (N,) and (N, 3): energy, modified_energy, discrete_energy (of the step that starts there; NaN where
    an impact cuts that step, and at the last node), linear_momentum, angular_momentum, loss (so far), friction_loss,
    dense_loss, energy_balance, constraint_residual, energy_rise, impulse_balance, persistent (whether the step that
    starts there has persistent contacts or is a dense one).
    Per event, shapes (n,) and (n, 3): energy_jump, modified_energy_jump, discrete_energy_jump, own_jump, event_loss,
    impulse, gap, complementarity, linear_momentum_jump, angular_momentum_jump.
    Per dense step (contactvi.records.dense_steps), shapes (d,): dense_residual, dense_gap, dense_energy_rise,
    dense_energy_margin.
    """

    def __init__(self, core: _core.Scene, built: Built, run: LedgerInputs) -> None:
        """Take the engine's scene, the complete scene that it is made from, and a run of it."""
        self._core, self._built, self._run = core, built, run
        self._forced, self._forces, self._given = run.forced, run.forces, run.energies
        rows = [] if run.forces is None else run.forces.constraints
        self._constrained = built.constrained or any(row.name not in built.elements.couplings.names for row in rows)
        self._dt = float("nan") if run.options.auto else run.options.fixed_dt
        self._damping = np.array(built.model.damping, dtype=float)
        self._steps = RemadeSteps(
            core, self._dt, run.options.order, self._damping, self._meets_with_order_2(), complete=run.energies is None
        )
        self.t, self._q, self._p, self.events = run.t, run.q, run.p, run.events

    def _meets_with_order_2(self) -> bool:
        """Return whether constraints or joint friction are met by steps of order 2, whatever that of the run is."""
        implicit, friction = self._run.options.impact != "ctec", bool(np.any(self._built.arrays.joint_friction))
        return self._constrained and implicit and (friction or self._run.options.record == "gradient")

    def __repr__(self) -> str:
        dense = f", {len(self.dense_steps)} dense steps" if len(self.dense_steps) else ""
        return f"<Ledger: {len(self.t)} nodes, {len(self.events)} impacts{dense}>"

    def __str__(self) -> str:
        rows = [f"  {name:24} {value:10.3g} {unit}" for name, value, unit in deviations(self)]
        return "\n".join([f"Ledger of {len(self.t)} nodes and {len(self.events)} impacts, largest deviations:", *rows])

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the largest deviation of what should be conserved, by name."""
        rows = [(name, f"{value:.3g}", unit) for name, value, unit in deviations(self)]
        title = f"Ledger of {len(self.t)} nodes and {len(self.events)} impacts"
        return html_table(title, ("largest deviation of", "is", "unit"), rows)

    # -- per node ------------------------------------------------------------------------------------------------------

    @cached_property
    def kinetic_energy(self) -> Array:
        """T [J], shape (N,)."""
        return self._energies[:, 0]

    @cached_property
    def energy(self) -> Array:
        """H [J], shape (N,)."""
        return np.asarray(self._energies.sum(axis=1))

    @cached_property
    def modified_energy(self) -> Array:
        """Modified Hamiltonian of the full step [J], shape (N,); H from order 4 on without constraints."""
        return self._steps.modified_energy(self._q, self._p, self.t)

    @cached_property
    def discrete_energy(self) -> Array:
        """E_d of the step that starts at the node [J], shape (N,); NaN without such a step, with inputs or "auto"."""
        values = np.full(len(self.t), np.nan)
        if not np.isfinite(self._dt):
            return values
        step = (self.t - self._run.start) / self._dt
        index = np.rint(step).astype(np.int64)
        whole = np.abs(step - index) < 1e-6  # the last node of a run may lie inside a step
        whole[-1:] = False
        whole &= ~np.isin(index, self.events.array("step")) & ~self.persistent
        if not self._forced:
            values[whole] = self._steps.discrete_energy(
                self._q[whole], self._p[whole], np.full(int(whole.sum()), self._dt)
            )
        return values

    @cached_property
    def linear_momentum(self) -> Array:
        """Of all bodies [N s], shape (N, 3)."""
        return self._momenta[:, :3]

    @cached_property
    def angular_momentum(self) -> Array:
        """Of all bodies about the world's origin [N m s], shape (N, 3)."""
        return self._momenta[:, 3:]

    @cached_property
    def loss(self) -> Array:
        """What impacts, the friction of persistent contacts and dense steps took until each node [J], shape (N,)."""
        return self.events.total(self.event_loss, self.t, self._run.start, self._dt) + self.friction_loss

    @property
    def friction_loss(self) -> Array:
        """What sliding in persistent contacts, and dense steps, took until each node [J], shape (N,)."""
        return self.contacts.friction_loss

    @property
    def dense_loss(self) -> Array:
        """The part of `friction_loss` that dense steps took, by friction and restitution [J], shape (N,).

        It is a difference of energies, with the error of the steps in it: `energy_balance` says nothing about them, and
        dense_energy_margin does.
        """
        return self.contacts.dense_loss

    @cached_property
    def undriven_energy(self) -> Array:
        """H less what inputs and prescribed motions put in, plus what damping and joint friction took [J], shape (N,).

        NaN where that was not recorded, in runs with damping or forces.
        """
        if self._forces is not None:
            work = self._forces.work
            return np.asarray(self.energy - work.input - work.prescribed + work.damping + work.joint_friction)
        lossless = not self._forced and not np.any(self._damping)
        return self.energy if lossless else np.full(len(self.t), np.nan)

    @cached_property
    def energy_balance(self) -> Array:
        """Change of H that is not accounted for since the first node [J], shape (N,), of O(dt^2).

        It is H less the work of inputs and prescribed motions, plus what damping, joint friction, friction of
        persistent contacts, dense steps and impacts took.
        """
        known = self.undriven_energy + self.loss
        with np.errstate(invalid="ignore"):  # of a stored run with infinite energies
            return np.asarray(known - known[0])

    @cached_property
    def constraint_residual(self) -> Array:
        """Largest residual of the scene's constraints at the node [m; rad], shape (N,); 0 without constraints."""
        if not sum(self._core.constraint_rows):
            return np.zeros(len(self.t))
        pairs = zip(self._q, self.t, strict=True)
        return np.array([np.abs(self._core.constraint_residual(q, t)).max() for q, t in pairs])

    @cached_property
    def energy_rise(self) -> Array:
        """H at the node less the least H at a node before it, >= 0 [J], shape (N,)."""
        return np.asarray(self.energy - np.minimum.accumulate(self.energy))

    @property
    def impulse_balance(self) -> Array:
        """What of the impulses on free bodies is not accounted for since the node before [N s], shape (N,)."""
        return self.contacts.impulse_balance

    @cached_property
    def persistent(self) -> NDArray[np.bool_]:
        """Whether the step that starts at the node has persistent contacts or is a dense one, shape (N,)."""
        return self._in_contact(self.t)

    held = alias("persistent")

    # -- of persistent contacts ----------------------------------------------------------------------------------------

    @cached_property
    def contacts(self) -> ContactLedger:
        """How exactly the law of contact holds, row by row of the run's contacts."""
        model, run = self._built.model, self._run
        trees = free_trees(model, self._built.collision)
        pushed = self._forced or self._built.elements.any or self._given is not None
        gravity = np.array(model.gravity.linear)
        pulls = adhesion_of(self._built.laws, run.contacts)
        return ContactLedger(run.contacts, self.t, self._q, self._p, trees, gravity, pushed, run.dense_steps, pulls)

    # -- of dense steps ------------------------------------------------------------------------------------------------

    @property
    def dense_steps(self) -> DenseSteps:
        """The dense steps, all columns (contactvi.records.dense_steps)."""
        return self._run.dense_steps

    @property
    def dense_residual(self) -> Array:
        """Residual of Coulomb's law over the largest free speed of a contact, shape (d,)."""
        return self._run.dense_steps["residual"]

    @property
    def dense_gap(self) -> Array:
        """Least gap at the end of the step [m; rad], shape (d,); below zero shapes overlap."""
        return self._run.dense_steps["gap"]

    @property
    def dense_energy_rise(self) -> Array:
        """How far the energy rose beyond the error of the step [J], >= 0, shape (d,)."""
        return self._run.dense_steps["energy_rise"]

    @property
    def dense_energy_margin(self) -> Array:
        """The error of the step less the rise of the energy [J], shape (d,); below zero it rose too far."""
        return self._run.dense_steps.energy_margin

    # -- per event -----------------------------------------------------------------------------------------------------

    @property
    def event_loss(self) -> Array:
        """What the law of the impact takes by restitution and friction [J], shape (n,)."""
        return self.events.loss

    @property
    def impulse(self) -> Array:
        """lambda [N s; N m s at the limit of a revolute joint], shape (n,)."""
        return self.events.array("impulse")

    @property
    def gap(self) -> Array:
        """Signed distance at the impact [m; rad], shape (n,)."""
        return self.events.array("gap")

    @property
    def complementarity(self) -> Array:
        """gap * impulse [N m s], shape (n,): no impulse at a distance."""
        return self.gap * self.impulse

    @cached_property
    def energy_jump(self) -> Array:
        """Of H, loss added back [J], shape (n,)."""
        return self.events.energy_change + self.event_loss

    @cached_property
    def discrete_energy_jump(self) -> Array:
        """Of E_d, loss added back [J], shape (n,)."""
        if self._forced:
            return np.full(len(self.events), np.nan)
        q, before, after = map(self.events.array, ("q", "before", "after"))
        start = self._steps.discrete_energy(q, self.events.array("p_minus"), -before) + self._before[3]
        end = self._steps.discrete_energy(q, self.events.array("p_plus"), after) - self._after[3]
        chained = self._follows("step", "time", "before")
        start[chained] = end[np.flatnonzero(chained) - 1]
        return np.where(self.event_in_contact, np.nan, end - start + self.event_loss)

    @cached_property
    def modified_energy_jump(self) -> Array:
        """Of the modified Hamiltonian over the step, loss added back [J], shape (n,)."""
        if self._forced:
            return np.full(len(self.events), np.nan)
        q_end, p_end, work_after, _ = self._after
        q_start, p_start, work_before, _ = self._before
        end = self._steps.modified_energy(q_end, p_end) - work_after
        start = self._steps.modified_energy(q_start, p_start)
        chained = self._follows("step")
        start[chained] = end[np.flatnonzero(chained) - 1]
        # Damping works until the first impact of an instant; the impacts after it have no work of their own.
        start += np.where(self._follows("step", "time", "before"), 0.0, work_before)
        return end - start + self.event_loss

    @cached_property
    def own_jump(self) -> Array:
        """Of the scalar that the map of the event conserves, against the reference of that map [J], shape (n,)."""
        explicit = (self.events.array("method") == METHODS.index("ctec")) | (
            self.events.array("fallback") == int(Fallback.PERSISTENT)
        )
        return np.where(explicit, self.energy_jump, self.events.array("jump"))

    @property
    def linear_momentum_jump(self) -> Array:
        """p_plus less p_minus of all bodies [N s], shape (n, 3)."""
        return self._momentum_jumps[:, :3]

    @property
    def angular_momentum_jump(self) -> Array:
        """Of all bodies about the world's origin [N m s], shape (n, 3)."""
        return self._momentum_jumps[:, 3:]

    # -- how -----------------------------------------------------------------------------------------------------------

    @cached_property
    def _energies(self) -> Array:
        return np.asarray(self._core.energy(self._q, self._p)) if self._given is None else self._given

    @cached_property
    def _momenta(self) -> Array:
        return np.asarray(self._core.spatial_momentum(self._q, self._p))

    @cached_property
    def _momentum_jumps(self) -> Array:
        q, p_minus, p_plus = map(self.events.array, ("q", "p_minus", "p_plus"))
        return np.asarray(self._core.spatial_momentum(q, p_plus) - self._core.spatial_momentum(q, p_minus))

    @cached_property
    def event_kinetic_energy(self) -> Array:
        """T before each impact [J], shape (n,)."""
        return np.asarray(self._core.energy(self.events.array("q"), self.events.array("p_minus")))[:, 0]

    @cached_property
    def event_in_contact(self) -> NDArray[np.bool_]:
        """Whether there are persistent contacts just before or just after the impact, shape (n,)."""
        time = self.events.array("time")
        return self._in_contact(time) | self._in_contact(time, "left")

    def _in_contact(self, t: Array, side: Literal["left", "right"] = "right") -> NDArray[np.bool_]:
        """Return whether steps just after these times (or with "left" just before) have persistent contacts, (N,)."""
        phases = self._run.phases
        if self._constrained or phases is None:
            return np.full(len(t), self._constrained)
        at = np.searchsorted(phases["t"], t, side=side) - 1
        return np.asarray((at >= 0) & (phases["persistent"][np.clip(at, 0, None)] != 0.0))

    def _follows(self, *names: str) -> NDArray[np.bool_]:
        """Return which events share these fields with the event before them, shape (n,)."""
        same = np.ones(len(self.events), dtype=bool)
        same[:1] = False
        for name in names:
            same[1:] &= np.diff(self.events.array(name)) == 0
        return same

    @cached_property
    def _before(self) -> tuple[Array, Array, Array, Array]:
        """The part of the step that ends at each impact, see `RemadeSteps.after`."""
        return self._steps.after(self.events.array("q"), self.events.array("p_minus"), -self.events.array("before"))

    @cached_property
    def _after(self) -> tuple[Array, Array, Array, Array]:
        """The rest of the step after each impact, see `RemadeSteps.after`."""
        return self._steps.after(self.events.array("q"), self.events.array("p_plus"), self.events.array("after"))


def deviations(ledger: Ledger) -> list[tuple[str, float, str]]:
    """Return (name, largest deviation, unit) of what should be conserved.

    The names are those of the tolerances of a run (`simulate(ledger=)`), whose energies are relative there.
    """
    found = [("energy_balance", _most(ledger.energy_balance), "J"), ("energy_rise", _most(ledger.energy_rise), "J")]
    found.append(("constraint residual", _most(ledger.constraint_residual), "m, rad"))
    if len(ledger.events):
        found += [("own_jump", _most(ledger.own_jump), "J"), ("gap", _most(ledger.gap), "m, rad")]
        found.append(("complementarity", _most(ledger.complementarity), "N m s"))
    if len(ledger.dense_steps):
        found.append(("dense_residual", _most(ledger.dense_residual), "of the largest free speed"))
    return found


def _most(values: Array) -> float:
    """Return the largest absolute value that is known; NaN where none is."""
    known = np.abs(values[np.isfinite(values)])
    return float(known.max()) if len(known) else float("nan")
