"""The ledger of persistent contact: how exactly the law of contact holds, and where its impulses and its work go.

Per row of the run's contacts (contactvi.records.contacts), shapes (m,): gap, impulse, complementarity, friction_work.
Per node, shapes (N,): friction_loss, impulse_balance.

A row that carries no impulse may be open: its gap counts only as far as it is negative. Impacts count as rows of their
own; their losses are those of their events and no friction work.

Friction work is the work of a step's two impulses on the slip between its ends. They count as forces at a third and at
two thirds of the step, where the contact step has them: that is exact where the slip changes evenly, else to O(h^2).

Rows of dense steps do no friction work: impacts lie inside of these steps, so slips at the ends do not give the work.
What a dense step took, by friction and restitution together, is its energy_loss (contactvi.records.dense_steps), which
counts in friction_loss. It is a difference of energies: the balance of energy closes over dense steps whatever they
did, and how well they kept the energy is in their margin.

The balance is that of the trees of bodies that hang on a free joint without damping: what the contacts gave each one in
a step, against the change of its momentum less its weight. It needs runs without inputs and whole steps between nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.importing.joint_kinds import joint_kind
from contactvi.records.codes import GuardKind
from contactvi.records.contacts import ContactLog
from contactvi.records.dense_steps import DenseSteps, no_dense_steps
from contactvi.scene.body_adhesion import BodyAdhesion
from contactvi.scene.contact_laws import PairLaw

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FreeTree:
    """The bodies that hang on one free joint.

    Attributes:
        idx_q, idx_v: place of the joint in q and v.
        mass: of all its bodies [kg].
        signs: +1 for pairs whose impulses act on it, -1 where their reactions do, else 0, shape (npairs,).
    """

    idx_q: int
    idx_v: int
    mass: float
    signs: Array


def free_trees(model: pin.Model, collision: pin.GeometryModel) -> list[FreeTree]:
    """Return the trees of a complete scene whose free joints have no damping."""
    root = list(range(model.njoints))
    for i in range(1, model.njoints):
        root[i] = root[model.parents[i]] if model.parents[i] else i
    roots = np.array([root[geometry.parentJoint] for geometry in collision.geometryObjects] or [0])
    pairs = np.array([(pair.first, pair.second) for pair in collision.collisionPairs], dtype=int).reshape(-1, 2)
    found = []
    for i in range(1, model.njoints):
        joint = model.joints[i]
        if root[i] != i or joint_kind(joint) != "free" or np.any(model.damping[joint.idx_v : joint.idx_v + 6]):
            continue
        mass = sum(float(model.inertias[k].mass) for k in range(model.njoints) if root[k] == i)
        second, first = roots[pairs[:, 1]] == i, roots[pairs[:, 0]] == i
        found.append(FreeTree(int(joint.idx_q), int(joint.idx_v), mass, 1.0 * second - 1.0 * first))
    return found


def adhesion_of(laws: Sequence[tuple[PairLaw, Sequence[int]]], contacts: ContactLog) -> Array | None:
    """Return the impulses of adhesion of every row [N s], shape (m,); None: no pair adheres.

    That of a pair or a body is shared by its rows of one step; a point that has let go has left its part to nobody, so
    that this is a bound.
    """
    sticky = [(law, places) for law, places in laws if law.adheres]
    if not sticky:
        return None
    start, h, index = (contacts.array(name) for name in ("t", "h", "index"))
    of_pair = contacts.array("kind") == GuardKind.CONTACT
    found = np.zeros(len(index))

    def share(pull: Callable[[float], float], places: Sequence[int]) -> None:
        rows = np.flatnonzero(of_pair & (h > 0.0) & np.isin(index, places))
        _, step, count = np.unique(start[rows], return_inverse=True, return_counts=True)
        for row, points in zip(rows, count[step], strict=True):
            found[row] += pull(start[row] + 0.5 * h[row]) * h[row] / points

    bodies: dict[BodyAdhesion, list[int]] = {}
    for law, places in sticky:
        for place in places:
            share(law.pull, [place])
            for adhesion in law.adhesive:
                bodies.setdefault(adhesion, []).append(place)
    for adhesion, places in bodies.items():
        share(partial(_pull_of, adhesion), places)
    return found


def _pull_of(adhesion: BodyAdhesion, t: float) -> float:
    return adhesion.pull.at(t, adhesion.name)


class ContactLedger:
    """See the module. Every array is computed when first asked for and kept."""

    def __init__(
        self,
        contacts: ContactLog,
        t: Array,
        q: Array,
        p: Array,
        trees: Sequence[FreeTree] = (),
        gravity: Array | None = None,
        pushed: bool = False,
        dense_steps: DenseSteps | None = None,
        pulls: Array | None = None,
    ) -> None:
        """Take the contacts and the nodes t (N,) [s], q (N, nq), p (N, nv) of a run.

        Only the balance needs trees from `free_trees`, gravity [m/s^2], shape (3,), and whether anything besides
        gravity and contacts acts on the trees. dense_steps are those of these nodes. pulls: from `adhesion_of`.
        """
        self._contacts, self._t, self._q, self._p = contacts, t, q, p
        self._trees, self._pushed, self._pulls = trees, pushed, pulls
        self._dense = no_dense_steps() if dense_steps is None else dense_steps
        self._gravity = np.zeros(3) if gravity is None else gravity

    @property
    def time(self) -> Array:
        """Ends of the steps of the rows [s], shape (m,)."""
        return self._contacts.end

    @property
    def impulse(self) -> Array:
        """Normal impulses [N s; N m s], shape (m,), with the adhesion that they bear; none may be below zero."""
        found = self._contacts.normal_impulse
        return found if self._pulls is None else found + self._pulls

    @cached_property
    def gap(self) -> Array:
        """Distance from contact at the end [m; rad], shape (m,): of what carries an impulse, and of what overlaps."""
        gap = self._contacts.array("gap")
        return np.where(self.impulse > 0.0, gap, np.minimum(gap, 0.0))

    @property
    def complementarity(self) -> Array:
        """gap * impulse [N m s], shape (m,)."""
        return np.asarray(self._contacts.array("gap") * self.impulse)

    @cached_property
    def friction_work(self) -> Array:
        """What friction did over the step [J], <= 0 where it slows the slip, shape (m,); 0 in impacts, dense steps."""
        return self._contacts.array("work")

    @cached_property
    def friction_loss(self) -> Array:
        """What friction in persistent contacts, and dense steps, took until each node [J], shape (N,)."""
        return self._until_nodes(self._contacts.t, self.time, -self.friction_work) + self.dense_loss

    @cached_property
    def dense_loss(self) -> Array:
        """What contacts took in dense steps until each node, by friction and restitution [J], shape (N,)."""
        return self._until_nodes(self._dense["t"], self._dense.end, self._dense["energy_loss"])

    def _until_nodes(self, start: Array, end: Array, values: Array) -> Array:
        """Return the sums of values (k,) until each node, of steps from start to end (k,) [s], shape (N,).

        A step that starts at a node comes after it, also where it is as short as rounding.
        """
        node = np.searchsorted(self._t, end - self._slack)
        node += start >= self._t[np.clip(node, 0, len(self._t) - 1)]
        sums = np.zeros(len(self._t) + 2)
        np.add.at(sums, node, values)
        return np.cumsum(sums)[: len(self._t)]

    @cached_property
    def impulse_balance(self) -> Array:
        """Impulse that is not accounted for since the node before [N s], largest of all free trees, shape (N,).

        It is NaN in runs with inputs, and where a contact step crosses a node.
        """
        result = np.zeros(len(self._t))
        if self._pushed:
            return np.full(len(self._t), np.nan)
        log, slack = self._contacts, self._slack
        node = np.searchsorted(self._t, self.time - slack)  # the node at the end of the step
        inside = (node < len(self._t)) & (node > 0) & (log.array("kind") == GuardKind.CONTACT)
        weight = np.diff(self._t, prepend=self._t[:1])[:, None] * self._gravity
        for tree in self._trees:
            q, v = tree.idx_q, tree.idx_v
            momentum = _rotated(self._q[:, q + 3 : q + 7], self._p[:, v : v + 3])
            pushed = np.zeros((len(self._t), 3))
            sign = tree.signs[log.array("index")[inside]]
            np.add.at(pushed, node[inside], sign[:, None] * log.impulse[inside])
            rest = np.diff(momentum, axis=0, prepend=momentum[:1]) - tree.mass * weight - pushed
            with np.errstate(over="ignore"):  # of huge numbers it may be infinite
                result = np.maximum(result, np.linalg.norm(rest, axis=1))
        across = inside & (log.t < self._t[np.clip(node - 1, 0, None)] - slack)
        result[node[across]] = np.nan
        return result

    @cached_property
    def _slack(self) -> float:
        """By how much a step that ends at a node may miss it [s], by rounding."""
        return 1e-6 * float(np.diff(self._t).min(initial=np.inf)) if len(self._t) > 1 else 0.0


def _rotated(quaternion: Array, vector: Any) -> Array:
    """Return vectors (N, 3) turned by quaternions x y z w (N, 4)."""
    axis, w = quaternion[:, :3], quaternion[:, 3:]
    twice = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + w * twice + np.cross(axis, twice))
