"""Events: the impacts of a run, one `Event` each, kept as arrays in an `EventLog`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.records.codes import FALLBACKS, KINDS, METHODS, GuardKind
from contactvi.records.rows import Arrays, Items, Printed, Rows

_SAME_TIME = 1e-13  # relative: events so near to the start of a step happen there

LIMITS = "lower limit", "upper limit"

# name -> (width, dtype) of one event's entry; width 0 is a scalar, "q" and "v" the size of the configuration and of
# the velocity. The order is that of the file format.
FIELDS: dict[str, tuple[int | str, type]] = {
    "time": (0, float),
    "step": (0, np.int64),
    "kind": (0, np.int64),
    "index": (0, np.int64),
    "point": (3, float),
    "normal": (3, float),
    "impulse": (0, float),
    "gamma_minus": (0, float),
    "gamma_plus": (0, float),
    "G_c": (0, float),
    "gap": (0, float),
    "restitution": (0, float),
    "method": (0, np.int64),
    "iterations": (0, np.int64),
    "fallback": (0, np.int64),
    "jump": (0, float),
    "before": (0, float),
    "after": (0, float),
    "q": ("q", float),
    "p_minus": ("v", float),
    "p_plus": ("v", float),
    "impulse_vector": (3, float),
    "points": (0, np.int64),
    "friction": (0, float),
    "loss": (0, float),
    "energy_change": (0, float),
}


@dataclass(frozen=True, eq=False)
class Event:
    """One impact.

    Attributes:
        time: [s].
        step: index of the step in which it happened.
        kind: "contact" between two shapes or "limit" of a joint.
        pair: names of the two shapes; for a limit (joint, "lower limit") or (joint, "upper limit").
        point: contact point [m], world frame, shape (3,); zero for a limit.
        normal: unit normal from the first shape to the second, world frame, shape (3,); zero for a limit.
        impulse: lambda >= 0 [N s; N m s for the limit of a revolute joint], of all points along their normals; without
            friction the second shape gets +impulse * normal.
        gamma_minus, gamma_plus: normal speed W v before and after [m/s; rad/s]; of several points that which closed
            most.
        G_c: inverse inertia W M^-1 W^T seen by the contact [1/kg].
        gap: signed distance at the located configuration [m; rad].
        restitution: coefficient used.
        method: impact map, "ctec", "dtec" or "mhc".
        iterations: evaluations of the map's scalar equation; 0 for CTEC, which is explicit.
        fallback: None, or the reason why the impulse is CTEC's because the map had no answer.
        jump: what is left of the map's own scalar equation [J], losses by restitution taken off; 0 for CTEC,
            and for a fallback where the rest of the step was not solved.
        before, after: lengths [s] of the partial step that ends at the impact (since the last event or node) and of the
            rest of the step after it.
        q: configuration at the impact, shape (nq,). Bodies that are in another island at that time
            (docs/theory/accuracy.md) have no state of their own there: theirs lies between those at
            the ends of the step.
        p_minus, p_plus: momentum before and after, shape (nv,).
        impulse_vector: on the second shape, friction included [N s], world frame, shape (3,); zero for a limit.
        points: how many points of the pair took part.
        friction: Coulomb coefficient used.
        loss: what the law of the impact takes from the kinetic energy, by restitution and friction [J]; at one point
            without friction (1 - e^2) gamma_minus^2 / (2 G_c). Events of one instant share what contacts that act
            together lose, one after the other: a share may be negative, their sum is >= 0.
        energy_change: H(p_plus) - H(p_minus) [J]; -loss with CTEC, at one point without friction (gamma_plus^2 -
            gamma_minus^2) / (2 G_c).
    """

    time: float
    step: int
    kind: str
    pair: tuple[str, str]
    point: NDArray[np.float64]
    normal: NDArray[np.float64]
    impulse: float
    gamma_minus: float
    gamma_plus: float
    G_c: float
    gap: float
    restitution: float
    method: str
    iterations: int
    fallback: str | None
    jump: float
    before: float
    after: float
    q: NDArray[np.float64]
    p_minus: NDArray[np.float64]
    p_plus: NDArray[np.float64]
    impulse_vector: NDArray[np.float64]
    points: int
    friction: float
    loss: float
    energy_change: float

    def __str__(self) -> str:
        return (
            f"t = {self.time:.9g} s  {self.pair[0]} | {self.pair[1]}  impulse {self.impulse:.6g}  "
            f"gamma {self.gamma_minus:.6g} -> {self.gamma_plus:.6g}"
        )


class EventLog(Printed, Rows, Items[Event]):
    """The events of a run in the order of time: a sequence of `Event`, and the same data as arrays.

    `log[3]` is an Event, `log.array("impulse")` the array of all impulses, shape (n,); kind, method and fallback are
    numbers there (contactvi.records.codes). `method` is the impact map of the run.
    """

    _fields = FIELDS
    _word = "event"

    def __init__(
        self,
        arrays: Arrays | Callable[[], Arrays],
        pair_names: Sequence[tuple[str, str]],
        joint_names: Sequence[str],
        method: str = "ctec",
    ) -> None:
        """Take arrays as in FIELDS, or a function that makes them when they are first asked for."""
        super().__init__(arrays)
        self._pair_names = pair_names
        self._joint_names = joint_names
        self.method = method

    def label(self, kind: int, index: int) -> tuple[str, str]:
        """Return the names that belong to (kind, index) in the engine's numbering."""
        return label(kind, index, self._pair_names, self._joint_names)

    @property
    def energy_change(self) -> NDArray[np.float64]:
        """H(p_plus) - H(p_minus) of every event [J], shape (n,)."""
        return self._arrays["energy_change"]

    @property
    def loss(self) -> NDArray[np.float64]:
        """What the law takes at every event, by restitution and friction [J], shape (n,)."""
        return self._arrays["loss"]

    def first_by_pair(self) -> dict[tuple[str, str], Event]:
        """Return the first impact of every pair (of a limit: joint, which limit), in the order of time."""
        keys = 2 * self._arrays["index"] + self._arrays["kind"]
        events = (self[int(k)] for k in np.sort(np.unique(keys, return_index=True)[1]))
        return {event.pair: event for event in events}

    def total(
        self, values: NDArray[np.float64], t: NDArray[np.float64], start: float = 0.0, dt: float = math.nan
    ) -> NDArray[np.float64]:
        """Return the sum of `values` (n,) of the events until each of these times [s], those at it included.

        With steps of length dt from `start` on: events at the very start of a step belong to it, not to its node.
        """
        times = self._arrays["time"]
        if math.isfinite(dt) and len(times):
            late = np.abs(times - (start + self._arrays["step"] * dt)) <= _SAME_TIME * (1.0 + np.abs(times))
            times = np.where(late, np.maximum(times, start + self._arrays["step"] * dt) + 2.0 * _SAME_TIME, times)
        sums = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(sums[np.searchsorted(np.maximum.accumulate(times), t, side="right")])

    def __repr__(self) -> str:
        return f"<EventLog: {len(self)} events>"

    def _brief(self) -> tuple[str, Sequence[str], list[Sequence[str] | None]]:
        rows: list[Sequence[str] | None] = [
            None if e is None else (
                f"{e.time:.9g}", " | ".join(e.pair), str(e.points), f"{e.impulse:.6g}", f"{e.gamma_minus:.6g}",
                f"{e.gamma_plus:.6g}", f"{e.loss:.6g}",
            ) for e in self._shown()
        ]  # fmt: skip
        heads = ("t [s]", "pair", "points", "normal impulse [N s]", "speed before [m/s]", "after [m/s]", "loss [J]")
        return f"Impacts: {len(self)} ({self.method.upper()})", heads, rows

    def _item(self, i: int) -> Event:
        values: dict[str, Any] = {}
        for name, (width, kind) in FIELDS.items():
            entry = self._arrays[name][i]
            values[name] = entry if width else (float(entry) if kind is float else int(entry))
        index = values.pop("index")
        values["pair"] = self.label(values["kind"], index)
        values["kind"] = KINDS[values["kind"]]
        values["method"] = METHODS[values["method"]]
        values["fallback"] = FALLBACKS[values["fallback"]]
        return Event(**values)


def with_energy_change(
    arrays: Arrays, kinetic_energy: Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]
) -> dict[str, NDArray[Any]]:
    """Return all fields: those of `joined`, and the change of energy.

    One point without friction has it from its speeds and G_c. Where points act together, or with friction, it is the
    difference of two kinetic energies.

    Args:
        kinetic_energy: (q (k, nq), p (k, nv)) -> (k,) [J].
    """
    found = dict(arrays)
    before, after, twice = found["gamma_minus"], found["gamma_plus"], 2.0 * found["G_c"]
    change = (after**2 - before**2) / twice
    formula = (1.0 - found["restitution"] ** 2) * before**2 / twice
    alone = (found["points"] <= 1) & (found["friction"] == 0.0)
    rows = np.flatnonzero(~alone | (np.abs(found["loss"] - formula) > 1e-9 * formula))
    if len(rows):
        q, p_minus, p_plus = (found[name][rows] for name in ("q", "p_minus", "p_plus"))
        change[rows] = kinetic_energy(q, p_plus) - kinetic_energy(q, p_minus)
    return {name: change if name == "energy_change" else found[name] for name in FIELDS}


def empty_arrays(nq: int, nv: int) -> dict[str, NDArray[Any]]:
    """Return the arrays of a log without events."""
    widths = {"q": nq, "v": nv}
    shapes = {
        name: (0, widths[width]) if isinstance(width, str) else (0, width) if width else (0,)
        for name, (width, _) in FIELDS.items()
    }
    return {name: np.zeros(shapes[name], dtype=kind) for name, (_, kind) in FIELDS.items()}


def joined(parts: Sequence[Arrays], nq: int, nv: int) -> dict[str, NDArray[Any]]:
    """Return the events that the engine reported in several calls, all fields but energy_change."""
    empty = empty_arrays(nq, nv)
    del empty["energy_change"]
    if not parts:
        return empty
    return {
        name: np.concatenate([np.asarray(part[name]).reshape((-1, *none.shape[1:])) for part in parts]).astype(
            none.dtype, copy=False
        )
        for name, none in empty.items()
    }


def label(kind: int, index: int, pair_names: Sequence[tuple[str, str]], joint_names: Sequence[str]) -> tuple[str, str]:
    """Return the two names of a guard in the engine's numbering: pairs, or 2 * joint + {0 lower, 1 upper}."""
    if kind == GuardKind.CONTACT:
        return pair_names[index]
    return joint_names[index // 2], LIMITS[index % 2]
