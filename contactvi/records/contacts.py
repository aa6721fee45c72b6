"""Contacts of a run: who pushed whom, where, how strongly and how long; and when contacts began, slipped and ended.

The engine reports one row per persistent contact point and step, and one per point of an impact of two shapes, whose
length is 0 and whose mode is "impact"; impacts at joint limits are events only. Impulses are in world axes. They act on
the second shape of a pair, and with the opposite sign on the first. A limit in persistent contact pushes its joint back
by a number >= 0 [N s; N m s for a revolute joint], the first component of its impulse.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.aliases import alias
from contactvi.errors import InputError
from contactvi.html import html_fields
from contactvi.inputs import flag, real
from contactvi.records.codes import CHANGES, KINDS, MODES, GuardKind
from contactvi.records.events import LIMITS, label
from contactvi.records.force_sums import BRIEF, mean_forces
from contactvi.records.rows import Array, Arrays, Fields, Items, Printed, Rows, StepRows, joined
from contactvi.records.shape_names import Groups, ShapeNames, matching_pairs

# The order is that of the file format.
FIELDS: Fields = {
    "t": (0, float),
    "h": (0, float),
    "step": (0, np.int64),
    "kind": (0, np.int64),
    "index": (0, np.int64),
    "point": (0, np.int64),
    "feature": (0, np.int64),
    "mode": (0, np.int64),
    "dense": (0, np.int64),
    "position": (3, float),
    "normal": (3, float),
    "start": (3, float),
    "end": (3, float),
    "gap": (0, float),
    "slip": (3, float),
    "work": (0, float),
}
CHANGE_FIELDS: Fields = {
    "time": (0, float),
    "kind": (0, np.int64),
    "index": (0, np.int64),
    "point": (0, np.int64),
    "change": (0, np.int64),
    "value": (0, float),
}


@dataclass(frozen=True, eq=False, repr=False)
class Contact:
    """One contact point over one step, or in one impact.

    Attributes:
        t, h: start and length of the step [s]; h is 0 for an impact.
        step: its index.
        kind, pair: as of an `Event`.
        point: number of the point within the pair, 0, 1, 2, ... as they appear in the run, the same from step to step;
            of a `Simulator` with record=False as they are asked for.
        mode: "stick", "slip" (it slid in a part of the step at least), "frictionless" or "impact".
        dense: whether the step is a dense one (contactvi.records.dense_steps).
        position: of the point at the end of the step [m], normal : unit, from the first shape to the second, both in
            world axes, shape (3,); zero for a limit. A smooth step that holds contacts has the mean of its normals.
        impulse: on the second shape [N s], friction included, world axes, shape (3,); of a limit its first component.
        force: impulse / h [N], shape (3,): the mean over the step; NaN for an impact.
        gap: at the end [m; rad].
        slip: tangential velocity of the second shape against the first, at the end [m/s], world axes, shape (3,).
    """

    t: float
    h: float
    step: int
    kind: str
    pair: tuple[str, str]
    point: int
    mode: str
    dense: bool
    position: Array
    normal: Array
    impulse: Array
    force: Array
    gap: float
    slip: Array

    @property
    def normal_force(self) -> float:
        """Force along the normal [N; of a limit N or N m], >= 0."""
        return float(self.force[0] if self.kind == "limit" else self.force @ self.normal)

    def __str__(self) -> str:
        size = np.linalg.norm(self.impulse)
        acts = f"impulse {size:.6g} N s" if self.h == 0.0 else f"normal force {self.normal_force:.6g} N"
        return f"t = {self.t:.9g} s  {self.pair[0]} | {self.pair[1]}  point {self.point}  {self.mode}  {acts}"

    def __repr__(self) -> str:
        return f"<Contact: {self}>"

    def _repr_html_(self) -> str:
        """Return what a notebook shows: every field by name."""
        fields = {"pair": " | ".join(self.pair), "t": f"{self.t:.9g} s", "h": f"{self.h:.6g} s"}
        fields |= {"point": str(self.point), "mode": self.mode + (", in a dense step" if self.dense else "")}
        for name, unit in (("position", "m"), ("normal", ""), ("impulse", "N s"), ("force", "N"), ("slip", "m/s")):
            fields[name] = "(" + ", ".join(f"{x:.6g}" for x in getattr(self, name)) + f") {unit}"
        return html_fields("Contact", fields | {"gap": f"{self.gap:.3g} m"})


class ContactLog(Printed, StepRows, Items[Contact]):
    """The contacts of a run, a sequence of `Contact` in the order of time, and the same data as arrays.

    `log[3]` is a Contact; `log.impulse`, `log.force`, `log.t`, ... are arrays of all rows, shape (m,) or (m, 3);
    `log.array(name)` is one of FIELDS; kind and mode are numbers there (contactvi.records.codes).
    """

    _fields = FIELDS
    _word = "contact"

    def __init__(
        self,
        arrays: Arrays | Callable[[], Arrays],
        pair_names: Sequence[tuple[str, str]],
        joint_names: Sequence[str],
        groups: Groups | None = None,
    ) -> None:
        """Take arrays as in FIELDS, or a function that makes them, the names, and the shapes of parts and bodies."""
        super().__init__(arrays)
        self._names = pair_names, joint_names
        self._groups = {} if groups is None else groups

    def label(self, kind: int, index: int) -> tuple[str, str]:
        """Return the names that belong to (kind, index) in the engine's numbering."""
        return label(kind, index, *self._names)

    @property
    def position(self) -> Array:
        """Contact points at the ends of the steps [m], world frame, shape (m, 3)."""
        return self._arrays["position"]

    @cached_property
    def impulse(self) -> Array:
        """On the second shape over the step [N s], world axes, shape (m, 3)."""
        return np.asarray(self._arrays["start"] + self._arrays["end"])

    @cached_property
    def force(self) -> Array:
        """Mean over the step, impulse / h, on the second shape [N], world axes, shape (m, 3); NaN for impacts."""
        h = self.h[:, None]
        return np.asarray(np.divide(self.impulse, h, out=np.full(self.impulse.shape, np.nan), where=h > 0.0))

    @cached_property
    def has_force(self) -> NDArray[np.bool_]:
        """Whether a row is long enough for its force to mean something, shape (m,): for pictures and largest values.

        Impacts are not, nor are parts of steps between two changes that are shorter than a thousandth of the longest
        step: an impulse of the size of rounding, divided by almost no time, is no force.
        """
        return np.asarray(self.h > BRIEF * self.h.max(initial=0.0))

    lasting = alias("has_force")

    @cached_property
    def normal_impulse(self) -> Array:
        """Along the normal [N s; N m s at the limit of a revolute joint], shape (m,)."""
        along = np.sum(self.impulse * self._arrays["normal"], axis=1)
        return np.where(self._arrays["kind"] == GuardKind.LIMIT, self.impulse[:, 0], along)

    @cached_property
    def friction_impulse(self) -> Array:
        """Size of the impulse across the normal [N s], shape (m,); 0 of a limit."""
        across = self.impulse - self.normal_impulse[:, None] * self._arrays["normal"]
        return np.where(self._arrays["kind"] == GuardKind.LIMIT, 0.0, np.linalg.norm(across, axis=1))

    @property
    def total_impulse(self) -> Array:
        """Of all rows on their second shapes [N s], world axes, shape (3,); of one pair: `log.of(a, b).total_impulse`.

        Limits are left out.
        """
        return np.asarray(self.impulse[self._arrays["kind"] == GuardKind.CONTACT].sum(axis=0))

    @cached_property
    def pairs(self) -> list[tuple[str, str]]:
        """The pairs that touched (for a limit the joint and which one), in the engine's order."""
        return list(self._guards[0])

    @cached_property
    def _guards(self) -> tuple[list[tuple[str, str]], NDArray[np.int64]]:
        """The names of the guards that touched, in the engine's order, and the place of each row's among them (m,)."""
        kind, index = self._arrays["kind"], self._arrays["index"]
        size = 1 + int(index.max(initial=0))
        keys, places = np.unique(kind * size + index, return_inverse=True)
        return [self.label(int(key) // size, int(key) % size) for key in keys], places.reshape(-1)

    def at(self, t: float) -> list[Contact]:
        """Return the contacts that act at time t [s]: those of the step around it (the later of two), and impacts."""
        t = real("t", t)
        end = self._ends()
        now = (self.t <= t) & ((t < end) | (self.t == t))
        if not np.any(now & (self.h > 0.0)) and len(self) and t == end.max():
            now |= end == t  # at its end a run has the contacts of its last step
        return [self[int(k)] for k in np.flatnonzero(now)]

    def _ends(self) -> Array:
        """Return the ends of the steps [s], shape (n,): the starts of the next ones, from which t + h differs by
        rounding."""
        if not len(self):
            return self.end
        starts = np.unique(self.t)
        slack = 4.0 * np.spacing(np.abs(self.end))
        near = starts[np.minimum(np.searchsorted(starts, self.end - slack), len(starts) - 1)]
        return np.asarray(np.where(np.abs(near - self.end) <= slack, near, self.end))

    def of(self, a: Any, b: Any) -> ContactLog:
        """Return the contacts between two bodies, in whichever order (of a limit: joint, "lower limit").

        Args:
            a, b: each a shape, body, part, pattern, several names or a handle, as in `on`; or the two names of one of
                `pairs`. The impulses stay those on the second shapes of the pairs as `pairs` names them.

        Raises:
            InputError: a name that is unknown, or two that never touched.
        """
        return self.rows(self._between(a, b)[self._guards[1]])

    def force_of(self, a: Any, b: Any, zeros: bool = False) -> tuple[Array, Array]:
        """Return (t (k,) [s], force (k, 3) [N]) between two bodies while they are in persistent contact.

        Names, times and forces are as in `of` and `on`. The force acts on the second shape of the pair as `pairs` names
        it; of several pairs on the side of the first one's second shape. For a limit it is the first component.
        `zeros` as in `on`.
        """
        chosen = self._between(a, b)
        rows = chosen[self._guards[1]] & (self.h > 0.0)
        pairs = [pair for pair, its in zip(self.pairs, chosen, strict=True) if its]
        if len(pairs) == 1:
            return self._mean(rows, np.ones(int(rows.sum())), zeros)
        sides = [self._shapes.of(name) for name in (a, b)]
        return self._mean(rows, self._signs(sides[pairs[0][1] in sides[1]])[rows], zeros)

    def on(self, body: Any, zeros: bool = False) -> tuple[Array, Array]:
        """Return (t (k,) [s], force (k, 3) [N]): the sum of all contact forces on a body, step by step.

        Args:
            body: name of a part, body or shape, a pattern over these, several of them, or a handle of the scene; its
                shapes count as one body.
            zeros: add rows of force 0 where contact ended and where it began again, so that a line through the rows
                is zero in a flight. There are no rows in it otherwise, and a line would join those before and after.

        Times are the middles of the steps in which it had persistent contact; forces are means over the time of contact
        in them. Parts of a step that end at changes of contacts are taken together, and steps whose contact is shorter
        than a thousandth of the longest are left out (as by `has_force`).

        Raises:
            InputError: a name that no tested pair has.
        """
        signs = self._signs(self._shapes.of(body))
        chosen = (signs != 0.0) & (self.h > 0.0)
        return self._mean(chosen, signs[chosen], zeros)

    def impulse_on(self, body: Any) -> Array:
        """Return the sum of all contact impulses on a body, impacts included [N s], world axes, shape (3,).

        `body` and errors are as in `on`.
        """
        signs = self._signs(self._shapes.of(body))[:, None]
        return np.asarray(np.where(signs != 0.0, signs * self.impulse, 0.0).sum(axis=0))

    @property
    def _shapes(self) -> ShapeNames:
        return ShapeNames(self._names[0], self._groups)

    def _between(self, a: Any, b: Any) -> NDArray[np.bool_]:
        """Return which of `pairs` are meant, shape (len(pairs),)."""
        words = isinstance(a, str) and isinstance(b, str)
        found = np.array([words and (a, b) in (pair, pair[::-1]) for pair in self.pairs], dtype=bool)
        if not found.any() and not (words and {a, b} & set(LIMITS)):
            shapes = self._shapes
            found = np.array(matching_pairs(self.pairs, shapes.of(a, "pair"), shapes.of(b, "pair")), dtype=bool)
        if found.any():
            return found
        touched = ", ".join(f"({first!r}, {second!r})" for first, second in self.pairs[:6])
        raise InputError(
            f"{a!s} and {b!s} have no contact in this run", name="pair", expected="two bodies that touched",
            got=f"({a!s}, {b!s})",
            remedy=f"Look at contacts.pairs: {touched}" + (", ..." if len(self.pairs) > 6 else "")
            if self.pairs else "Nothing touched in this run",
        )  # fmt: skip

    def _mean(self, chosen: NDArray[np.bool_], signs: Array, zeros: bool) -> tuple[Array, Array]:
        step, impulse = self._arrays["step"][chosen], signs[:, None] * self.impulse[chosen]
        return mean_forces(self.t[chosen], self.h[chosen], step, impulse, flag("zeros", zeros))

    def _signs(self, shapes: set[str]) -> Array:
        """+1 where the second shape is one of these, -1 where the first is, 0 where both or none are, shape (m,)."""
        of_pair = np.array([(b in shapes) * 1.0 - (a in shapes) * 1.0 for a, b in self._names[0]] or [0.0])
        index = np.where(self._arrays["kind"] == GuardKind.CONTACT, self._arrays["index"], 0)
        return np.where(self._arrays["kind"] == GuardKind.CONTACT, of_pair[index], 0.0)

    def rows(self, chosen: NDArray[Any]) -> ContactLog:
        """Return the contacts of these rows, given by their numbers or by a mask (m,)."""
        arrays = {name: values[chosen] for name, values in self._arrays.items()}
        return ContactLog(arrays, *self._names, self._groups)

    def __repr__(self) -> str:
        return f"<ContactLog: {len(self)} rows of {len(self.pairs)} pairs>"

    def _brief(self) -> tuple[str, Sequence[str], list[Sequence[str] | None]]:
        rows: list[Sequence[str] | None] = [
            None if c is None else (
                f"{c.t:.6g}", f"{c.h:.3g}", " | ".join(c.pair), str(c.point), c.mode,
                f"{c.normal_force:.6g}" if c.h > 0.0 else "",
                f"{np.linalg.norm(c.impulse):.6g}",
            ) for c in self._shown()
        ]  # fmt: skip
        heads = ("t [s]", "h [s]", "pair", "point", "mode", "normal force [N]", "impulse, friction included [N s]")
        return f"Contacts: {len(self)} rows of {len(self.pairs)} pairs", heads, rows

    def _item(self, i: int) -> Contact:
        row = {name: values[i] for name, values in self._arrays.items()}
        kind = int(row["kind"])
        return Contact(
            t=float(row["t"]), h=float(row["h"]), step=int(row["step"]), kind=KINDS[kind],
            pair=self.label(kind, int(row["index"])), point=int(row["point"]), mode=MODES[int(row["mode"])],
            dense=bool(row["dense"]), position=row["position"], normal=row["normal"], impulse=self.impulse[i],
            force=self.force[i], gap=float(row["gap"]), slip=row["slip"],
        )  # fmt: skip


@dataclass(frozen=True)
class ContactChange:
    """One change of a contact.

    Attributes:
        time: [s].
        kind, pair: as of an `Event`.
        point: number of the point within the pair.
        change: "begin", "release", "stick", "slip", "bouncing ended", "inconsistent" or "overlap".
        value: of "bouncing ended" the time when impacts would have accumulated [s], of "inconsistent" (Painleve) A
            [1/kg], of "overlap" the gap of the pair [m]; 0 of the others, which have no value.
    """

    time: float
    kind: str
    pair: tuple[str, str]
    point: int
    change: str
    value: float

    def __str__(self) -> str:
        return f"t = {self.time:.9g} s  {self.pair[0]} | {self.pair[1]}  {self.change}"


class ChangeLog(Printed, Rows, Items[ContactChange]):
    """The changes of contacts in a run, in the order of time; `log.array("time")` is one of CHANGE_FIELDS as array."""

    _fields = CHANGE_FIELDS
    _word = "change"

    def __init__(
        self,
        arrays: Arrays | Callable[[], Arrays],
        pair_names: Sequence[tuple[str, str]],
        joint_names: Sequence[str],
    ) -> None:
        super().__init__(arrays)
        self._names = pair_names, joint_names

    def label(self, kind: int, index: int) -> tuple[str, str]:
        """Return the names that belong to (kind, index) in the engine's numbering."""
        return label(kind, index, *self._names)

    def __repr__(self) -> str:
        return f"<ChangeLog: {len(self)} changes>"

    def _brief(self) -> tuple[str, Sequence[str], list[Sequence[str] | None]]:
        rows: list[Sequence[str] | None] = [
            None if c is None else (f"{c.time:.6g}", " | ".join(c.pair), str(c.point), c.change)
            for c in self._shown()
        ]  # fmt: skip
        return f"Contact changes: {len(self)}", ("t [s]", "pair", "point", "change"), rows

    def _item(self, i: int) -> ContactChange:
        row = {name: values[i] for name, values in self._arrays.items()}
        kind = int(row["kind"])
        pair = self.label(kind, int(row["index"]))
        change = CHANGES[int(row["change"])]
        return ContactChange(float(row["time"]), KINDS[kind], pair, int(row["point"]), change, float(row["value"]))


def points_of(log: ContactLog | ChangeLog, rows: NDArray[np.int64]) -> list[tuple[int, int, int]]:
    """Return the contact points of these rows: kind, pair or limit, number of the point."""
    return list(zip(*(log.array(name)[rows].tolist() for name in ("kind", "index", "point")), strict=True))


def empty_contacts() -> ContactLog:
    """Return a log without contacts."""
    return ContactLog(joined((), FIELDS), (), ())


def empty_changes() -> ChangeLog:
    """Return a log without changes."""
    return ChangeLog(joined((), CHANGE_FIELDS), (), ())
