"""Simultaneous impacts: what can come out of them, and when the answer does not depend on the order.

Several contacts that close at one instant are resolved as sequences of single impacts (contactvi.impact_sequences).
In general the order matters, and rigid bodies alone do not say it: `simultaneous_outcomes` lists what the orders lead
to, which of it a run takes, and a certificate where there is but one answer.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import InputError, PenetrationError, did_you_mean
from contactvi.events import label
from contactvi.impact_sequences import End, Impacts
from contactvi.inputs import real
from contactvi.prepared import Prepared, prepare

if TYPE_CHECKING:
    from contactvi.scene import Scene

Array = NDArray[np.float64]
Pair = tuple[str, str]

_ANGLE = 1e-9  # [rad] to which an angle has to be pi / n; normals of round shapes are good to rounding
_RANK = 1e-10  # relative: normals that depend on each other


@dataclass(frozen=True, eq=False)
class ClosedContact:
    """A contact that takes part.

    pair : names of the two shapes, or (joint, "lower limit"), (joint, "upper limit"). restitution : e in [0, 1].
    gap : [m; rad]. gamma_minus : normal speed before, negative where it closes [m/s; rad/s].
    G_c : inverse inertia W M^-1 W^T [1/kg]. W : d(gap)/dq, shape (nv,).
    """

    pair: Pair
    restitution: float
    gap: float
    gamma_minus: float
    G_c: float
    W: Array

    def __str__(self) -> str:
        return f"{self.pair[0]} | {self.pair[1]}"


@dataclass(frozen=True, eq=False)
class Outcome:
    """Where one sequence of impacts ends.

    v_plus, p_plus : velocity and momentum after, shapes (nv,), Pinocchio's coordinates.
    impulses : total normal impulse of each contact [N s; N m s], shape (ncontacts,).
    sequence : the pairs in the order in which they were struck; each entry is a tuple of the pairs struck as one
        (one pair; several where plastic contacts end together).
    energy : kinetic energy after [J].
    cut : whether the sequence is endless; it was then cut where its closing speeds were below 1e-9 of the first ones,
        and ended plastically.
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

    angles : beta_ij between the walls of contacts i and j [rad], shape (n, n), NaN on the diagonal:
        cos beta = -W_i M^-1 W_j^T / sqrt(G_ii G_jj).
    orders : n_ij where beta_ij = pi/n_ij with a whole n_ij >= 2, else 0, shape (n, n).
    certified : whether that proves the outcome unique. reason : why, or why not.
    bound : for two elastic contacts the largest number of impacts, ceil(pi/beta); None otherwise.
    """

    angles: Array
    orders: NDArray[np.int64]
    certified: bool
    reason: str
    bound: int | None


@dataclass(frozen=True, eq=False)
class SimultaneousOutcomes:
    """What the sequences of single impacts at one state lead to; a sequence of `Outcome`, printable.

    contacts : those that take part. outcomes : all different ends; the first is `chosen`.
    chosen : what a run takes: the elastic contact (e > 0) that closes fastest first, the lowest guard number on ties;
        where none closes, all plastic contacts as one problem; again until none closes.
    complete : whether all sequences were followed. unique : whether they were, and there is one outcome.
    certificate : whether that follows from the angles alone. energy : kinetic energy before [J].
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
            lines.append(f"  [{k}] {contact}  e = {contact.restitution:g}, gamma {contact.gamma_minus:.6g}")
        for i, j in zip(*np.triu_indices(len(self.contacts), 1), strict=True):
            beta = self.certificate.angles[i, j]
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
    """Return all outcomes of the impacts at (q, v), frictionless, one point per pair (contactvi.impact_sequences).

    Parameters
    ----------
    scene : the scene. q : configuration, shape (nq,); v : velocity, shape (nv,), Pinocchio's coordinates; by default
        the start of the scene's file, else neutral and rest.
    pairs : names of the pairs that take part, ("shape", "shape") or ("joint", "upper limit"), whatever their gaps are;
        by default all contacts and limits with a gap within `tolerance` [m; rad].
    e : restitution in [0, 1] of all contacts, or one value for each; by default the scene's.
    max_states : velocities that are followed before `complete` becomes False.

    Raises
    ------
    InputError : for a bad argument, and where no contact is closed.
    PenetrationError : where a contact that takes part by itself is deeper than `tolerance`.
    """
    prepared = prepare(scene)
    states = prepared.states
    q0 = states.configuration(prepared.q0 if q is None else q, "q")
    v0 = states.velocity(prepared.v0 if v is None else v, "v")
    margin = real("tolerance", tolerance, 0.0)
    limit = int(real("max_states", max_states, 1.0))
    mass = np.asarray(prepared.core.momentum(np.tile(q0, (states.nv, 1)), np.eye(states.nv)))
    lower = np.linalg.cholesky(0.5 * (mass + mass.T))
    contacts = _contacts(prepared, q0, v0, lower, pairs, e, margin)
    a = np.linalg.solve(lower, np.array([contact.W for contact in contacts]).T).T
    x = lower.T @ v0
    impacts = Impacts([row[None] for row in a], [contact.restitution for contact in contacts], x)
    ends, complete = impacts.every_order(limit)
    chosen = impacts.chosen(limit)
    others = [end for end in ends if np.linalg.norm(end.x - chosen.x) > 1e-8 * np.linalg.norm(x)]
    outcomes = tuple(_outcome(end, lower, contacts) for end in (chosen, *others))
    return SimultaneousOutcomes(contacts, outcomes, complete, _certificate(contacts, a), 0.5 * float(x @ x))


def _contacts(
    prepared: Prepared,
    q: Array,
    v: Array,
    lower: Array,
    pairs: Sequence[Sequence[str]] | None,
    e: float | Sequence[float] | None,
    margin: float,
) -> tuple[ClosedContact, ...]:
    gaps, names, restitution = _guards(prepared, q)
    if pairs is None:
        deep = np.flatnonzero(gaps < -margin)
        if len(deep):
            worst = int(gaps.argmin())
            raise PenetrationError(
                f"{' and '.join(names[worst])} overlap",
                pair=names[worst],
                depth=float(-gaps[worst]),
                expected=f"gaps >= {-margin:g}",
                got=f"{gaps[worst]:.6g}",
                remedy="Move the bodies apart, or raise tolerance=...",
            )
        chosen = [int(k) for k in np.flatnonzero(gaps <= margin)]
    else:
        chosen = _chosen(pairs, names)
    if not chosen:
        least = int(gaps.argmin()) if len(gaps) else -1
        raise InputError(
            "No contact is closed here",
            name="q",
            expected=f"a gap <= {margin:g}",
            got=f"{gaps[least]:.6g} between {' and '.join(names[least])}" if least >= 0 else "a scene without contacts",
            remedy="Name the contacts with pairs=[...]",
        )
    values = _restitution(e, restitution[chosen])
    rows = np.asarray(prepared.core.gap_gradients(q))[chosen]
    gamma = rows @ v
    inverse = np.sum(np.linalg.solve(lower, rows.T) ** 2, axis=0)
    for k, number in enumerate(chosen):
        if not inverse[k] > 0.0:
            raise InputError(
                f"{' and '.join(names[number])} cannot move against each other",
                name="pairs",
                expected="a gap that some joint changes",
                got="none",
            )
    return tuple(
        ClosedContact(names[n], float(values[k]), float(gaps[n]), float(gamma[k]), float(inverse[k]), rows[k])
        for k, n in enumerate(chosen)
    )


def _guards(prepared: Prepared, q: Array) -> tuple[Array, list[Pair], Array]:
    """Return gaps, names and restitution of all guards in the engine's order: pairs, then joint limits."""
    built = prepared.built
    gaps = [np.asarray(prepared.core.gaps(q)[0])]
    names, restitution = list(prepared.pair_names), list(built.restitution)
    for index in np.flatnonzero(built.arrays.limits):
        value = q[built.model.joints[int(index)].idx_q]
        at = built.model.joints[int(index)].idx_q
        for side, bound in enumerate((built.model.lowerPositionLimit[at], built.model.upperPositionLimit[at])):
            if np.isfinite(bound):
                gaps.append(np.array([bound - value if side else value - bound]))
                names.append(label(1, 2 * int(index) + side, prepared.pair_names, prepared.joint_names))
                restitution.append(built.arrays.limit_restitution[int(index)])
    return np.concatenate(gaps), names, np.array(restitution, dtype=float)


def _chosen(pairs: Any, names: Sequence[Pair]) -> list[int]:
    """Return the numbers of the named guards, in the engine's order."""
    known = {key: k for k, (a, b) in enumerate(names) for key in ((a, b), (b, a))}
    found = []
    for pair in pairs:
        key = tuple(pair) if not isinstance(pair, str) else (pair,)
        if key not in known:
            raise InputError(
                f"There is no contact {key!r}",
                name="pairs",
                expected="two names of one tested pair or limit",
                got=repr(pair),
                remedy=did_you_mean(" | ".join(map(str, key)), [f"{a} | {b}" for a, b in names]),
            )
        found.append(known[key])
    return sorted(set(found))


def _restitution(e: Any, own: Array) -> Array:
    if e is None:
        return own
    if np.ndim(e) == 0:
        return np.full(len(own), real("e", e, 0.0, 1.0))
    values = [real("e", value, 0.0, 1.0) for value in e]
    if len(values) != len(own):
        raise InputError("e", name="e", expected=f"one number, or one for each of {len(own)} contacts", got=len(values))
    return np.array(values)


def _certificate(contacts: Sequence[ClosedContact], a: Array) -> Certificate:
    n = len(a)
    angles, orders = np.full((n, n), np.nan), np.zeros((n, n), dtype=np.int64)
    unit = a / np.linalg.norm(a, axis=1)[:, None]
    for i, j in zip(*np.triu_indices(n, 1), strict=True):
        # twice the angle of the half sum and half difference: no digits lost where arccos is flat
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
    elif not elastic:
        certified, reason = False, "the reflections need e = 1"
    elif not np.all(orders[others] > 0):
        certified, reason = False, "not every angle is pi/n"
    elif not independent:
        certified, reason = False, "the normals depend on each other"
    else:
        certified, reason = True, "elastic, every angle is pi/n: the order does not matter"
    bound = None
    if n == 2 and elastic and angles[0, 1] > _ANGLE:
        bound = int(orders[0, 1]) or math.ceil(math.pi / angles[0, 1] - _ANGLE)
    return Certificate(angles, orders, certified, reason, bound)


def _outcome(end: End, lower: Array, contacts: Sequence[ClosedContact]) -> Outcome:
    return Outcome(
        v_plus=np.asarray(np.linalg.solve(lower.T, end.x), dtype=float),
        p_plus=lower @ end.x,
        impulses=np.array([float(impulse.sum()) for impulse in end.impulse]),
        sequence=tuple(tuple(contacts[i].pair for i in struck) for struck in end.steps),
        energy=0.5 * float(end.x @ end.x),
        cut=end.cut,
    )


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
