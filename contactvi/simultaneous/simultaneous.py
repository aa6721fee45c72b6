"""Simultaneous impacts: their possible outcomes, and when the outcome does not depend on the order.

Several contacts that close at one instant are resolved as sequences of single impacts
(contactvi.simultaneous.impact_sequences). In general the order matters, and rigid bodies alone do not decide it:
`simultaneous_outcomes` lists the outcomes of all orders, which of them a run takes, and a certificate where the outcome
is unique.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.importing.couplings import coupled_basis
from contactvi.inputs import real
from contactvi.simultaneous.closed_contacts import ClosedContact, closed_contacts
from contactvi.simultaneous.impact_sequences import End, Impacts
from contactvi.trajectory.compiled import compile_scene

if TYPE_CHECKING:
    from contactvi.scene.engine import EngineScene
    from contactvi.scene.scene import Scene

Array = NDArray[np.float64]
Pair = tuple[str, str]

_ANGLE = 1e-9  # [rad] to which an angle has to be pi / n; normals of round shapes are good to rounding
_RANK = 1e-10  # relative: normals that depend on each other


@dataclass(frozen=True, eq=False)
class Outcome:
    """Where one sequence of impacts ends.

    Attributes:
        v_plus, p_plus: velocity and momentum after, shapes (nv,), Pinocchio's coordinates.
        impulses: total normal impulse of each contact [N s; N m s], shape (ncontacts,).
        sequence: the pairs in the order in which they were struck; each entry is a tuple of the pairs struck as one
            (one pair; several where plastic contacts end together).
        energy: kinetic energy after [J].
        cut: whether the sequence is endless; it was then cut where its closing speeds were below 1e-9 of the first
            ones, and ended plastically.
    """

    v_plus: Array
    p_plus: Array
    impulses: Array
    sequence: tuple[tuple[Pair, ...], ...]
    energy: float
    cut: bool


@dataclass(frozen=True, eq=False)
class Certificate:
    """Whether the order matters, from the geometry of the contacts alone.

    In the kinetic metric M the admissible velocities {W_i v >= 0} are a cone, and an elastic frictionless impact is the
    reflection in one of its walls. Where all walls meet at angles pi/n, n = 2, 3, ..., the reflections generate a
    finite group with the cone as its fundamental domain, so every sequence ends at the same velocity.

    Attributes:
        angles: beta_ij between the walls of contacts i and j [rad], shape (n, n), NaN on the diagonal and for contacts
            of several points (faces, edges): cos beta = -W_i M^-1 W_j^T / sqrt(G_ii G_jj).
        orders: n_ij where beta_ij = pi/n_ij with a whole n_ij >= 2, else 0, shape (n, n).
        certified: whether that proves the outcome unique.
        reason: why, or why not.
        bound: for two elastic contacts the largest number of impacts, ceil(pi/beta); None otherwise.
    """

    angles: Array
    orders: NDArray[np.int64]
    certified: bool
    reason: str
    bound: int | None


@dataclass(frozen=True, eq=False)
class SimultaneousOutcomes:
    """The outcomes of the sequences of single impacts at one state; a sequence of `Outcome`, printable.

    Attributes:
        contacts: those that take part.
        outcomes: all different ends; the first is `chosen`.
        chosen: what a run takes: the elastic contact (e > 0) that closes fastest first, the lowest guard number on
            ties; where none closes, all plastic contacts as one problem; again until none closes.
        complete: whether all sequences were followed.
        unique: whether they were, and there is one outcome.
        certificate: whether that follows from the angles alone.
        energy: kinetic energy before [J].
    """

    contacts: tuple[ClosedContact, ...]
    outcomes: tuple[Outcome, ...]
    complete: bool
    certificate: Certificate
    energy: float

    @property
    def chosen(self) -> Outcome:
        """The outcome of a run."""
        return self.outcomes[0]

    @property
    def unique(self) -> bool:
        """Whether every sequence ends at the same velocity."""
        return self.complete and len(self.outcomes) == 1

    def __len__(self) -> int:
        return len(self.outcomes)

    def __iter__(self) -> Iterator[Outcome]:
        return iter(self.outcomes)

    def __str__(self) -> str:
        lines = [f"{len(self.contacts)} closed contact{'s' if len(self.contacts) > 1 else ''}, T = {self.energy:.9g} J"]
        for k, contact in enumerate(self.contacts):
            lines.append(
                f"  [{k}] {contact}{_points(contact)}  e = {contact.restitution:g}, gamma {contact.gamma_minus:.6g}"
            )
        for i, j in combinations(range(len(self.contacts)), 2):
            beta = self.certificate.angles[i, j]
            if not np.isfinite(beta):
                continue
            share = f" = pi/{self.certificate.orders[i, j]}" if self.certificate.orders[i, j] else ""
            lines.append(f"  angle [{i}] to [{j}]: {math.degrees(beta):.6g} deg{share}")
        lines.append(f"{'certified unique' if self.certificate.certified else 'no certificate'}: {self._reason()}")
        ends = f"{len(self)} outcome{'s' if len(self) > 1 else ''} of all orders"
        lines.append(ends if self.complete else ends + " that were followed; there are more orders")
        numbers = {contact.pair: k for k, contact in enumerate(self.contacts)}
        for outcome in self.outcomes:
            mark = "chosen" if outcome is self.chosen else "other"
            order = _order(outcome, numbers)
            lines.append(f"  {mark:<7}v+ = {_numbers(outcome.v_plus)}  T = {outcome.energy:.9g} J  {order}")
        return "\n".join(lines)

    def _reason(self) -> str:
        bound = self.certificate.bound
        return self.certificate.reason + (f"; at most {bound} impacts" if bound is not None else "")


def simultaneous_outcomes(
    scene: Scene,
    q: ArrayLike | None = None,
    v: ArrayLike | None = None,
    *,
    pairs: Sequence[Sequence[str]] | None = None,
    e: float | Sequence[float] | None = None,
    tolerance: float = 1e-8,
    max_states: int = 20_000,
) -> SimultaneousOutcomes:
    """Return all outcomes of the impacts at (q, v), frictionless; a pair with all its points is one impact.

    Args:
        scene: the scene.
        q: configuration, shape (nq,);
        v: velocity, shape (nv,), Pinocchio's coordinates; by default the start of the scene's file, else neutral and
            rest.
        pairs: names of the pairs that take part, ("shape", "shape") or ("joint", "upper limit"), whatever their gaps
            are; by default all contacts and limits with a gap within `tolerance` [m; rad].
        e: restitution in [0, 1] of all contacts, or one value for each; by default the scene's.
        max_states: velocities that are followed before `complete` becomes False.

    Raises:
        InputError: for a bad argument, where no contact is closed, and for one that cannot open or close, because the
            joints or the constraints do not let it.
        PenetrationError: where a contact that takes part by itself is deeper than `tolerance`.
    """
    compiled = compile_scene(scene).at_start(q)
    states = compiled.states
    q0 = states.configuration(compiled.q0 if q is None else q, "q")
    v0 = states.velocity(compiled.v0 if v is None else v, "v")
    margin = real("tolerance", tolerance, 0.0)
    limit = int(real("max_states", max_states, 1.0))
    contacts, engine = closed_contacts(compiled, q0, v0, pairs, e, margin, limit)
    # The search runs in the engine's coordinates, whose velocity of a free-flyer is that of its origin in the world.
    core = compiled.core
    mass = np.column_stack([core.dynamics(q0, unit)[0] for unit in np.eye(states.nv)])
    followers = compiled.built.elements.couplings.followers
    basis = coupled_basis(compiled.built.model, followers) if followers else None
    p = core.momentum_to_engine(q0, np.asarray(core.momentum(q0[None], v0[None]))[0])
    impacts = Impacts(engine, [contact.mobile for contact in contacts], mass, basis, p)
    ends, complete = impacts.every_order(limit)
    chosen = impacts.chosen()
    found = (chosen, *(end for end in ends if impacts.apart(end, chosen)))
    outcomes = tuple(_outcome(end, core, q0, contacts) for end in found)
    energy = 0.5 * float(np.sum(impacts.metric(p) ** 2))
    return SimultaneousOutcomes(contacts, outcomes, complete, _certificate(contacts, impacts.rows), energy)


def _certificate(contacts: Sequence[ClosedContact], rows: Sequence[Array]) -> Certificate:
    n = len(rows)
    angles, orders = np.full((n, n), np.nan), np.zeros((n, n), dtype=np.int64)
    points = all(len(a) == 1 for a in rows)
    unit = np.array([a[0] / np.linalg.norm(a[0]) for a in rows])
    for i, j in combinations(range(n), 2):
        if len(rows[i]) > 1 or len(rows[j]) > 1:
            continue
        # Twice the angle of half sum and half difference: arccos loses digits near 0 and pi.
        between = 2.0 * math.atan2(np.linalg.norm(unit[i] - unit[j]), np.linalg.norm(unit[i] + unit[j]))
        angles[i, j] = angles[j, i] = beta = math.pi - between
        whole = round(math.pi / beta) if beta > _ANGLE else 0
        if whole >= 2 and abs(beta - math.pi / whole) <= _ANGLE:
            orders[i, j] = orders[j, i] = whole
    elastic = all(contact.restitution == 1.0 for contact in contacts)
    independent = np.linalg.matrix_rank(unit, tol=_RANK * math.sqrt(n)) == n
    others = ~np.eye(n, dtype=bool)
    if n == 1:
        certified, reason = True, "one contact"
    elif not points:
        certified, reason = False, "a contact of several points is no single reflection"
    elif not elastic:
        certified, reason = False, "the reflections need e = 1"
    elif not np.all(orders[others] > 0):
        certified, reason = False, "not every angle is pi/n"
    elif not independent:
        certified, reason = False, "the normals depend on each other"
    else:
        certified, reason = True, "elastic, every angle is pi/n: the order does not matter"
    bound = None
    if n == 2 and points and elastic and angles[0, 1] > _ANGLE:
        bound = int(orders[0, 1]) or math.ceil(math.pi / angles[0, 1] - _ANGLE)
    return Certificate(angles, orders, certified, reason, bound)


def _outcome(end: End, core: EngineScene, q: Array, contacts: Sequence[ClosedContact]) -> Outcome:
    p = core.momentum_to_public(q, end.p)
    v = np.asarray(core.velocity(q[None], p[None]), dtype=float)[0]
    if core.followers:  # of coupled joints p = M v, with what the coupling adds to the impulses
        p = np.asarray(core.momentum(q[None], v[None]), dtype=float)[0]
    return Outcome(
        v_plus=v,
        p_plus=p,
        impulses=end.impulse,
        sequence=tuple(tuple(contacts[i].pair for i in struck) for struck in end.steps),
        energy=0.5 * float(p @ v),
        cut=end.cut,
    )


def _points(contact: ClosedContact) -> str:
    return f" ({len(contact.W)} points)" if len(contact.W) > 1 else ""


def _order(outcome: Outcome, numbers: dict[Pair, int]) -> str:
    """Return "[0] [1] [0 1 together]", shortened in the middle."""
    steps = [[numbers[pair] for pair in struck] for struck in outcome.sequence]
    shown = [f"[{' '.join(map(str, step))}{' together' if len(step) > 1 else ''}]" for step in steps]
    if len(shown) > 12:
        shown = [*shown[:8], f"... {len(shown) - 10} more ...", *shown[-2:]]
    return f"{len(steps)} impact{'s' if len(steps) != 1 else ''} " + " ".join(shown) + (" (endless, cut)" * outcome.cut)


def _numbers(values: Array) -> str:
    rounding = 1e-12 * float(np.abs(values).max(initial=0.0))
    return "(" + ", ".join(f"{value:.6g}" for value in np.where(np.abs(values) > rounding, values, 0.0)) + ")"
