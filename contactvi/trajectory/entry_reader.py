"""Reads the entries of the file of a run (contactvi.trajectory.storage) and checks their shapes, types and values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import SceneError
from contactvi.records import codes, contacts, dense_steps
from contactvi.records import events as event_log
from contactvi.records.contacts import ChangeLog, ContactLog
from contactvi.records.dense_steps import DenseSteps
from contactvi.records.inputs import STORED, RunInputs
from contactvi.records.rows import Fields, joined
from contactvi.records.work import WORKS, ConstraintRows, Forces
from contactvi.trajectory import polynomials as dense
from contactvi.trajectory.gaps import Gaps

Entries = dict[str, NDArray[Any]]
Names = tuple[list[tuple[str, str]], list[str]]

_RENAMED = {"persistent": "held"}  # names in the file, where they are not those in memory
PHASES = ("t", "dt", "persistent")

# Columns of events and contacts that are finite; energies and losses of huge numbers may be infinite.
_FINITE = (
    *("time", "t", "h", "before", "after", "q", "p_minus", "p_plus", "point", "position", "normal", "impulse", "gap"),
    *("impulse_vector", "start", "end", "slip", "gamma_minus", "gamma_plus", "restitution", "friction", "residual"),
)


# Of a state: the engine ends runs above 1e100 in its coordinates, which of a turned body are others by up to sqrt(3).
_LARGEST = 2e100
# [N] of a contact, the impulse over a step by its length. Impulses end with the states, and the shortest steps of a run
# are of the size of rounding, far above 1e-50 s; sums of the squares of such forces are finite.
_LARGEST_FORCE = 1e150


def of_a_run(values: NDArray[Any]) -> bool:
    """Return whether numbers are finite and not larger than those of any run, so that products of them are finite."""
    return bool(np.all(np.abs(values) <= _LARGEST))


class EntryReader:
    """Reads the entries of a file and checks their shapes, types and values.

    Attributes:
        sizes: of the configuration "q" and the velocity "v".
    """

    def __init__(self, path: Path, entries: Entries, sizes: Mapping[str, int]) -> None:
        self._path, self._entries, self._sizes = path, entries, sizes

    def entry(self, name: str, shape: tuple[int | None, ...], kind: type = float) -> NDArray[Any]:
        """Return an entry of this shape (None: any) and type."""
        values = self._entries.get(name)
        if values is None:
            self._refuse(f"a file without the entry {name!r}")
        fits = values.ndim == len(shape) and all(
            want is None or have == want for have, want in zip(values.shape, shape, strict=True)
        )
        if not fits or values.dtype != np.dtype(kind):
            self._refuse(f"{name!r} of shape {values.shape} and type {values.dtype}, not {shape} {np.dtype(kind)}")
        return values

    def nodes(self, names: Mapping[str, str | None]) -> Entries:
        """Return the entries per node: t, and `names` with "q", "v" or None as width."""
        t = self.entry("t", (None,))
        if len(t) == 0 or not np.all(np.isfinite(t)) or np.any(np.diff(t) <= 0):
            self._refuse("times that do not increase")
        nodes = {"t": t}
        for name, width in names.items():
            nodes[name] = self.entry(name, (len(t),) if width is None else (len(t), self._sizes[width]))
        if not of_a_run(nodes["q"]):
            self._refuse("configurations that are not finite")
        return nodes

    def segments(self, order: int, tol: float) -> dense.Segments | dense.SegmentsApart | None:
        """Return the polynomials of the steps, solved to tol, None where they were not kept."""
        if "segment/t" in self._entries:
            return self._segments_of("segment", order, tol, self._sizes)
        parts: list[tuple[tuple[int, ...], dense.Segments]] = []
        while f"segment{len(parts)}/trees" in self._entries:
            group = f"segment{len(parts)}"
            trees = self.entry(f"{group}/trees", (None,), int)
            count = len(self.entry(f"{group}/t", (None,)))
            sizes = {}
            for name, axis in (("q", "q"), ("p", "v")):
                width = self._entries.get(f"{group}/{name}", np.zeros(0))
                sizes[axis] = width.shape[1] if width.ndim == 2 and len(width) == count else -1
            parts.append((tuple(trees.tolist()), self._segments_of(group, order, tol, sizes)))
        if not parts:
            return None
        whole = {axis: sum(part.arrays[name].shape[1] for _, part in parts) for name, axis in (("q", "q"), ("p", "v"))}
        chosen = sorted(tree for trees, _ in parts for tree in trees)
        if chosen != list(range(len(chosen))) or any(whole[axis] != self._sizes[axis] for axis in whole):
            self._refuse("segments of groups of bodies that are not those of the scene")
        return dense.SegmentsApart(parts)

    def _segments_of(self, group: str, order: int, tol: float, sizes: Mapping[str, int]) -> dense.Segments:
        count = len(self.entry(f"{group}/t", (None,)))
        widths = {**sizes, "sv": order // 2 * sizes["v"]}
        arrays = {}
        for name, axes in dense.FIELDS.items():
            arrays[name] = self.entry(stored_name(group, name), (count, *(widths[axis] for axis in axes)))
            if not (np.all(np.isfinite(arrays[name])) if name == "rates" else of_a_run(arrays[name])):
                self._refuse("segments that are not finite")
        rounding = 8.0 * np.finfo(float).eps * np.abs(arrays["t"][1:])
        if count == 0 or np.any(np.diff(arrays["t"]) < -rounding) or np.any(arrays["h"] <= 0):
            self._refuse("segments that do not follow each other")
        return dense.Segments(arrays, order, tol)

    def group(self, group: str, names: tuple[str, ...]) -> Entries | None:
        """Return the entries group/name, arrays of one length, None where the first of them is missing."""
        if f"{group}/{names[0]}" not in self._entries:
            return None
        count = len(self.entry(f"{group}/{names[0]}", (None,)))
        return {name: self.entry(stored_name(group, name), (count,)) for name in names}

    def forces(self, t: NDArray[np.float64], constraints: list[Any]) -> Forces | None:
        """Return work and reactions at nodes t (N,) [s]; constraints: (name, kind, rows) of the columns."""
        if "force/work" not in self._entries:
            return None
        rows = [ConstraintRows(str(name), str(kind), int(count)) for name, kind, count in constraints]
        work = self.entry("force/work", (len(t), len(WORKS)))
        reactions = self.entry("force/reactions", (len(t), sum(row.rows for row in rows)))
        if np.any(np.isnan(work)) or np.any(np.isnan(reactions)):
            self._refuse("work or reactions that are no numbers")
        return Forces(t, work, reactions, rows)

    def inputs(self) -> RunInputs | None:
        """Return the inputs of a run with record="gradient", None of other runs."""
        if "input/saturated" not in self._entries:
            return None
        nv = self._sizes["v"]
        control, target = self._per_step("input/control", nv), self._per_step("input/target", 2 * nv)
        always = ("contact_steps", "impact_blocks")  # files of versions without derivatives of the others lack those
        earlier = tuple(
            self.entry(f"input/{name}", (None,)) if name in always or f"input/{name}" in self._entries else np.zeros(0)
            for name in STORED
        )
        if not all(np.all(np.isfinite(numbers)) for numbers in earlier):
            self._refuse("contact steps or impacts of several points that are not finite")
        return RunInputs(control, target, int(self.entry("input/saturated", (), int)), (), earlier)

    def _per_step(self, name: str, width: int) -> NDArray[np.float64] | None:
        if name not in self._entries:
            return None
        values = self.entry(name, (None, width))
        if not of_a_run(values):
            self._refuse(f"numbers in {name!r} that are not finite")
        return values

    def frames(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (times (f,) [s], configurations (f, nq)) of the frames for pictures."""
        times = self.entry("frame/time", (None,))
        values = self.entry("frame/q", (len(times), self._sizes["q"]))
        if not np.all(np.isfinite(times)) or not of_a_run(values):
            self._refuse("frames that are not finite")
        return times, values

    def gaps(self, pairs: list[tuple[str, str]]) -> Gaps:
        """Return the gaps of these pairs over time."""
        times = self.entry("gap/time", (None,))
        values = self.entry("gap/value", (len(times), len(pairs)))
        if not np.all(np.isfinite(times)) or np.any(np.isnan(values)):
            self._refuse("gaps that are no numbers")
        return Gaps(times, pairs, values)

    def events(self, names: Names, method: str) -> event_log.EventLog:
        """Return the events of a run with this impact map."""
        count = len(self.entry("event/time", (None,)))
        arrays = {}
        for name, (width, kind) in event_log.FIELDS.items():
            size = self._sizes[width] if isinstance(width, str) else width
            arrays[name] = self.entry(f"event/{name}", (count, size) if width else (count,), kind)
        self._check_finite(arrays, "events")
        self._check_codes(arrays, {"method": len(codes.METHODS), "fallback": len(codes.FALLBACKS)}, "events")
        self._check_guards(arrays, names, "events")
        return event_log.EventLog(arrays, *names, method)

    def contacts(self, names: Names, groups: Mapping[str, tuple[str, ...]]) -> ContactLog:
        """Return the contacts of a run."""
        rows = self._rows("contact", "t", contacts.FIELDS)
        h, largest = rows["h"], np.abs(rows["start"] + rows["end"]).max(axis=1, initial=0.0)
        if np.any((h > 0.0) & (largest > _LARGEST_FORCE * h)):  # of a step that is too short for its impulse
            self._refuse("contacts with forces larger than those of any run")
        self._check_codes(rows, {"mode": len(codes.MODES)}, "contacts")
        self._check_guards(rows, names, "contacts")
        return ContactLog(rows, *names, groups)

    def changes(self, names: Names) -> ChangeLog:
        """Return the changes of contacts in a run."""
        rows = self._rows("change", "time", contacts.CHANGE_FIELDS)
        self._check_codes(rows, {"change": len(codes.CHANGES)}, "contacts")
        self._check_guards(rows, names, "contacts")
        return ChangeLog(rows, *names)

    def phases(self) -> Entries | None:
        """Return where the kind and the length of the steps change, None in a run of free steps alone."""
        phases = self.group("phase", PHASES)
        if phases is not None and not np.all(np.isin(phases["persistent"], list(codes.StepKind))):
            self._refuse("steps of an unknown kind")
        return phases

    def dense_steps(self) -> DenseSteps:
        """Return the dense steps of a run."""
        rows = self._rows("dense", "t", dense_steps.FIELDS)
        same = np.argsort(rows["island"], kind="stable")  # in the order of time
        follow = np.diff(rows["t"][same]) > 0.0
        if np.any(np.diff(rows["t"]) < 0.0) or not np.all(follow[np.diff(rows["island"][same]) == 0]):
            self._refuse("dense steps that do not follow each other")
        return DenseSteps(rows)

    def _rows(self, group: str, first: str, fields: Fields) -> Entries:
        if f"{group}/{first}" not in self._entries:
            return joined((), fields)
        count = len(self.entry(f"{group}/{first}", (None,)))
        rows = {
            name: self.entry(f"{group}/{name}", (count, width) if width else (count,), kind)
            for name, (width, kind) in fields.items()
        }
        self._check_finite(rows, f"entries of {group!r}")
        return rows

    def _check_finite(self, arrays: Entries, what: str) -> None:
        for name, values in arrays.items():
            if np.any(np.isnan(values)) or (name in _FINITE and not of_a_run(values)):
                self._refuse(f"{what} with numbers in {name!r} that are not finite")

    def _check_codes(self, arrays: Entries, counts: Mapping[str, int], what: str) -> None:
        for name, count in counts.items():
            if not np.all((arrays[name] >= 0) & (arrays[name] < count)):
                self._refuse(f"{what} of an unknown {name}")

    def _check_guards(self, arrays: Entries, names: Names, what: str) -> None:
        kind, index = arrays["kind"], arrays["index"]
        bound = np.where(kind == codes.GuardKind.CONTACT, len(names[0]), 2 * len(names[1]))
        if not np.all(np.isin(kind, list(codes.GuardKind)) & (index >= 0) & (index < bound)):
            self._refuse(f"{what} that name unknown pairs")

    def _refuse(self, got: str) -> NoReturn:
        refuse(self._path, got)


def stored_name(group: str, name: str) -> str:
    return f"{group}/{_RENAMED.get(name, name)}"


def refuse(
    path: Path,
    got: str,
    cause: BaseException | None = None,
    remedy: str = "Choose a file of Trajectory.save; a damaged one has to be computed again",
) -> NoReturn:
    """Raise SceneError: the file is none that Trajectory.save has written; `got` tells why."""
    raise SceneError(
        f"Cannot read the run {path}",
        path=path,
        expected="an npz file written by Trajectory.save",
        got=got,
        remedy=remedy,
    ) from cause
