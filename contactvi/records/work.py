"""Forces of a run: work of inputs, damping, joint friction and prescribed motions, and reactions of constraints.

Nodes as in contactvi.trajectory.trajectory: N of them, the first at the start.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError, did_you_mean

Array = NDArray[np.float64]


class Work(NamedTuple):
    """Work since the start at each node [J], shapes (N,).

    Attributes:
        input: put in by control, servos, wrenches and forces given in Python.
        damping: taken by dampers, of joints and springs, >= 0.
        joint_friction: taken by the friction of joints, >= 0.
        prescribed: put in by prescribed motions and lengths.

    Old names, kept for this release: dry of joint_friction, drive of prescribed.
    """

    input: Array
    damping: Array
    joint_friction: Array
    prescribed: Array

    @property
    def dry(self) -> Array:
        """Old name of `joint_friction`, kept for this release."""
        return self.joint_friction

    @property
    def drive(self) -> Array:
        """Old name of `prescribed`, kept for this release."""
        return self.prescribed


WORKS = tuple(Work.__annotations__)  # the columns that the engine reports


class ConstraintRows(NamedTuple):
    """A constraint of a run: its name, its kind (as in Scene.add_KIND), its number of rows."""

    name: str
    kind: str
    rows: int


class Forces:
    """Work (N, 4) and mean reactions (N, m) of a run at its nodes t (N,) [s]; `constraints` name the columns.

    on_followers: the mean force of all that acts on coupled joints that follow others, without the reaction of the
    coupling, (N, followers); None without such joints (contactvi.trajectory.coupled_reactions).
    """

    def __init__(
        self,
        t: Array,
        work: Array,
        reactions: Array,
        constraints: Sequence[ConstraintRows],
        on_followers: Array | None = None,
    ) -> None:
        self.t = t
        self.on_followers = on_followers
        self.values, self.reactions = work, reactions
        self.constraints = [ConstraintRows(*row) for row in constraints]

    @property
    def work(self) -> Work:
        """The work by name."""
        return Work(*self.values.T)

    def of(self, name: str) -> Array:
        """Return the reaction of a constraint, see `Trajectory.reactions`."""
        first = 0
        for row in self.constraints:
            if row.name == name:
                return self.reactions[:, first : first + row.rows]
            first += row.rows
        raise InputError(
            "Unknown constraint",
            name="name",
            expected="one of traj.constraints; springs, wrenches and servos are none",
            got=repr(name),
            remedy=did_you_mean(str(name), [row.name for row in self.constraints]),
        )

    def since(self, t: float) -> Forces:
        """Return the nodes from t [s] on."""
        first = int(np.searchsorted(self.t, t))
        on_followers = None if self.on_followers is None else self.on_followers[first:]
        return Forces(self.t[first:], self.values[first:], self.reactions[first:], self.constraints, on_followers)

    def sampled(self, t: Array) -> Forces:
        """Return work and reactions at other nodes t (n,) [s].

        Work between two nodes is shared in proportion to time, to O(dt^2), and reactions are means.
        """
        count = self.reactions.shape[1]
        if not self.values.any() and not self.reactions.size and self.on_followers is None:
            return Forces(t, np.zeros((len(t), self.values.shape[1])), np.zeros((len(t), 0)), self.constraints)
        spans = np.diff(self.t, prepend=self.t[:1])[:, None]
        means = self.reactions if self.on_followers is None else np.hstack([self.reactions, self.on_followers])
        impulse = np.cumsum(means * spans, axis=0)
        work, impulse = (
            np.column_stack([np.interp(t, self.t, column) for column in values.T]) if values.size else
            np.zeros((len(t), values.shape[1]))
            for values in (self.values, impulse)
        )  # fmt: skip
        means = np.zeros(impulse.shape)
        np.divide(np.diff(impulse, axis=0), np.diff(t)[:, None], out=means[1:])
        on_followers = None if self.on_followers is None else means[:, count:]
        return Forces(t, work, means[:, :count], self.constraints, on_followers)


# Of the start of a run, which nothing writes to.
_NO_WORK, _NO_REACTIONS = np.zeros((1, len(WORKS))), np.zeros((1, 0))


class GrowingForces:
    """Work and reactions of a run as it grows: what the engine reports node by node, at the nodes that are kept."""

    def __init__(self, t: float, constraints: Sequence[ConstraintRows], followers: int = 0) -> None:
        """Start at t [s]; followers: how many joints follow others, whose columns come after the constraints'."""
        self.constraints, self._followers = list(constraints), followers
        self._rows = sum([row.rows for row in constraints]) + followers
        self._t: list[Array] = [np.array([t])]
        self._work: list[Array] = [_NO_WORK]
        self._reactions: list[Array] = [np.zeros((1, self._rows)) if self._rows else _NO_REACTIONS]
        self._last = t  # time of the last node that was reported [s]
        # Impulse since the last node that was kept [N s, N m s].
        self._pending = np.zeros(self._rows) if self._rows else _NO_REACTIONS[0]

    def add(self, result: Mapping[str, Any], t: Array, keep: slice | NDArray[np.bool_]) -> None:
        """Take over a result of the engine with nodes t (n,) [s]; keep: which of them are kept, a mask (n,) or a slice.

        Where all but the first are, and that one is the start, they are taken over as they are.
        """
        if self._rows == 0:
            times = t[keep]
            if len(times) == len(t) - 1 and len(self._t) == 1 and len(self._t[0]) == 1:
                self._t, self._work, self._reactions = [t], [result["work"]], [np.zeros((len(t), 0))]
            elif len(times):
                self._t.append(times)
                self._work.append(result["work"][keep])
                self._reactions.append(np.zeros((len(times), 0)))
            self._last = float(t[-1])
            return
        mask = np.arange(len(t)) >= keep.start if isinstance(keep, slice) else keep
        reactions = np.asarray(result["reactions"], dtype=float)
        new = t > self._last
        spans = np.diff(np.append(self._last, t[new]))[:, None]
        impulse = self._pending + np.cumsum(reactions[new] * spans, axis=0)
        kept = mask[new]
        if kept.any():
            times = t[new][kept]
            before = np.append(self._t[-1][-1], times[:-1])
            sums = np.diff(impulse[kept], axis=0, prepend=np.zeros((1, self._rows)))
            exact = bool(np.all(kept)) and not self._pending.any()  # each node has its own mean
            self._reactions.append(reactions[new] if exact else sums / (times - before)[:, None])
            self._work.append(np.asarray(result["work"], dtype=float)[new][kept])
            self._t.append(times)
            last = np.flatnonzero(kept)[-1]
            self._pending = impulse[-1] - impulse[last]
        elif len(impulse):
            self._pending = impulse[-1]
        if new.any():
            self._last = float(t[-1])

    def copy(self) -> GrowingForces:
        """Return a copy that grows on its own."""
        twin = copy.copy(self)
        for name in ("_t", "_work", "_reactions"):
            setattr(twin, name, list(getattr(self, name)))
        return twin

    def cut(self, count: int) -> None:
        """Forget all but the first `count` nodes."""
        for name in ("_t", "_work", "_reactions"):
            setattr(self, name, [np.concatenate(getattr(self, name))[:count]])

    def forget(self, count: int) -> None:
        """Forget the first `count` nodes."""
        for name in ("_t", "_work", "_reactions"):
            setattr(self, name, [np.concatenate(getattr(self, name))[count:]])

    def joined(self, first: int = 0) -> Forces:
        """Return work and reactions of the blocks from `first` on."""
        if len(self._t) == 1 and first == 0:
            t, work, reactions = self._t[0], self._work[0], self._reactions[0]
        else:
            t, work, reactions = (
                parts[0] if len(parts) == 1 else np.concatenate(parts)
                for parts in (self._t[first:], self._work[first:], self._reactions[first:])
            )
        if self._followers == 0:
            return Forces(t, work, reactions, self.constraints)
        own = self._rows - self._followers
        return Forces(t, work, reactions[:, :own], self.constraints, reactions[:, own:])
