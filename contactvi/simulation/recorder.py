"""The record of a run: the nodes, impacts, contacts, segments and counts that the engine has reported so far."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from contactvi.options import Options
from contactvi.records import contacts, dense_steps
from contactvi.records import events as event_log
from contactvi.records.actuation import Actuation
from contactvi.records.codes import Change
from contactvi.records.inputs import GrowingInputs
from contactvi.records.point_numbers import PointNumbers
from contactvi.records.recent import Recent
from contactvi.records.rows import joined
from contactvi.records.still import Span, WithStill
from contactvi.records.work import GrowingForces
from contactvi.scene.separation import Separation
from contactvi.simulation.messages import describe
from contactvi.simulation.results import Columns, EngineResult, EngineStatus
from contactvi.status import Stats, Status, StatusCode
from contactvi.trajectory import polynomials as dense
from contactvi.trajectory.compiled import CompiledScene
from contactvi.trajectory.ledger import Ledger, LedgerInputs
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]
Log = TypeVar("Log")

ROUNDING = 1e-9  # of a step: an impact at its end may be a digit later than the step
BLOCK = 1000  # single steps that are recorded at once, where not all of them stay in the record
_BLOCKS = ("events", "segments", "contacts", "changes", "phases", "dense_steps")
_NOTHING_DONE = Stats()
_CODES = tuple(StatusCode)  # by number


class Record:
    """Grows by what each call of the engine returns. t, q, p and events are lists of blocks, one per call."""

    def __init__(self, compiled: CompiledScene, options: Options, t: float, q: Array, p: Array) -> None:
        """Start with the state at t [s]: q (nq,), p (nv,)."""
        self.compiled, self.options, self.start = compiled, options, t
        self.t: list[Array] = [np.array([t])]
        self.q: list[Array] = [q[None]]
        self.p: list[Array] = [p[None]]
        self.events: list[Columns] = []
        self.segments: list[Columns] = []
        self.apart: dense.SegmentsApart | None = None  # instead of them, of a run in which islands were advanced apart
        self.contacts: list[Columns] = []
        self.changes: list[Columns] = []
        self.points = PointNumbers()
        self._still: tuple[_core.StillRows, Columns] | None = None  # the last ones, and their columns
        self.phases: list[Columns] = []
        self.dense_steps: list[Columns] = []
        self.adaptive_steps: Columns | None = None
        self.reached = t
        self.stats = _NOTHING_DONE
        self.forced = compiled.forced
        self.forces = GrowingForces(t, compiled.constraint_rows, compiled.followers)
        self.actuation = Actuation(float("nan") if options.auto else options.fixed_dt, options.last_steps is None)
        self.inputs = GrowingInputs() if options.record == "gradient" else None
        self.status = Status(StatusCode.SUCCESS, "the run has started", t)
        self.separation: Separation | None = None  # what was moved for the start

    def collect(self, result: EngineResult) -> Status:
        """Take over what the engine did: nodes that `record_every` wants, events, segments, counts, status."""
        t, options = result["t"], self.options
        last_steps = options.last_steps
        if last_steps == 0:
            self._forget(result)
        keep = self._kept(t)
        self.forced |= result["forced"]
        times = t[keep]
        if len(times) == len(t) - 1 and len(self.t) == 1 and len(self.t[0]) == 1:
            self.t, self.q, self.p = [t], [result["q"]], [result["p"]]  # the first node is the start
        elif len(times):
            self.t.append(times)
            self.q.append(result["q"][keep])
            self.p.append(result["p"][keep])
        self.forces.add(result, t, keep)
        contacts, changes = result["contacts"], result["changes"]
        if contacts is not None or changes is not None:
            contacts, changes = self.points.number(contacts, changes)
        if (still := result["still"]) is not None:
            spans = [Span(self._still_columns(rows), n, count, t0, dt, h) for rows, n, count, t0, dt, h in still]
            contacts = WithStill(contacts, spans)
        if contacts is not None:
            self.contacts.append(contacts)
        if changes is not None:
            self.changes.append(changes)
        if (events := result["events"]) is not None:
            self.events.append(events)
        if (segments := result["segments"]) is not None:
            self.segments.append(segments)
        if (dense_rows := result["dense"]) is not None:
            self.dense_steps.append(dense_rows)
        if self.inputs is not None:
            self.inputs.saturated = result["stats"]["saturated"]
            if result["kept_steps"] is not None:
                self.inputs.add_contact_steps(result["kept_steps"])
        self._collect_phases(result["phases"])
        if options.auto:
            self.adaptive_steps = result["adaptive_steps"]
        # The engine counts from its reset, except for the seconds, which are those of this call.
        self.stats = Stats.of(result["stats"], self.stats.seconds)
        status = self.end(result)
        self.reached = result["time"]
        if last_steps and sum(map(len, self.t)) > 2 * (last_steps + BLOCK):
            self.keep_last(last_steps)
        return status

    def _still_columns(self, rows: _core.StillRows) -> Columns:
        """Return the columns of contacts of what lies still, with numbers of the points."""
        if self._still is None or self._still[0] is not rows:
            numbered, _ = self.points.number(rows.columns(self.compiled.core), None)
            self._still = rows, cast("Columns", numbered)
        return self._still[1]

    def _kept(self, t: Array) -> slice | NDArray[np.bool_]:
        """Return which of the nodes t (n,) [s] of a result are new and wanted: those from some place on, or a mask."""
        last = self.t[-1][-1]
        if self.options.record_every == 1:
            if len(t) > 1 and t[0] == last < t[1]:  # as nearly always
                return slice(1, None)
            return slice(int(t.searchsorted(last, "right")), None)
        step = np.rint((t - self.start) / self.options.fixed_dt)
        return np.asarray((t > last) & (step % self.options.record_every == 0))

    def _forget(self, result: EngineResult) -> None:
        """Forget all that was recorded; a result of the engine starts the record again with its first node."""
        self.t, self.q, self.p = [result["t"][:1]], [result["q"][:1]], [result["p"][:1]]
        for name in _BLOCKS:
            setattr(self, name, [])
        self.forces = GrowingForces(float(self.t[0][0]), self.compiled.constraint_rows, self.compiled.followers)

    def keep_last(self, steps: int) -> None:
        """Forget what was recorded before the last steps."""
        t, q, p = self.nodes()
        first = int(np.searchsorted(t, self.reached - (steps + 0.5) * self.options.fixed_dt))
        if first == 0:
            return
        self.t, self.q, self.p = [t[first:]], [q[first:]], [p[first:]]
        self.forces.forget(first)
        begin = float(t[first])
        phases = self.phases_joined()
        if phases is not None:
            here = int(np.searchsorted(phases["t"], begin, side="right")) - 1
            kept = {name: values[max(here, 0) :].copy() for name, values in phases.items()}
            kept["t"][0] = max(kept["t"][0], begin)
            self.phases = [kept]
        for name in ("events", "changes"):
            setattr(self, name, [_rows(part, part["time"] > begin) for part in getattr(self, name)])
        for name in ("segments", "contacts", "dense_steps"):
            parts = [_rows(part, part["t"] + 0.5 * part["h"] > begin) for part in getattr(self, name)]
            setattr(self, name, parts)
        for name in ("events", "changes", "segments", "contacts", "dense_steps"):
            setattr(self, name, [part for part in getattr(self, name) if len(next(iter(part.values())))])

    def _collect_phases(self, phases: Columns | None) -> None:
        """Take over of which kind steps are: a call without any phase is free, and ends that of the call before."""
        if phases is not None:
            if not self.phases and phases["t"][0] > self.start:  # the calls before it were free
                self._add_free_phase(self.start)
            self.phases.append(phases)
        elif self.phases and self.phases[-1]["persistent"][-1]:
            self._add_free_phase(self.reached)

    def _add_free_phase(self, t: float) -> None:
        free = {"t": t, "dt": self.options.fixed_dt, "persistent": 0.0}
        self.phases.append({name: np.array([value]) for name, value in free.items()})

    def end(self, result: EngineStatus, time: float | None = None) -> Status:
        """Take over the engine's status; `time` [s] replaces the time that it gives."""
        code = _CODES[int(result["code"])]
        text = describe(code, result, self.names(result), self.options.impact)
        self.status = Status(code, text, result["time"] if time is None else time)
        return self.status

    def names(self, result: EngineStatus) -> tuple[str, str] | None:
        """Return the names of the pair or limit that the engine's status is about."""
        index = result["guard_index"]
        if index < 0:
            return None
        return event_log.label(int(result["guard_kind"]), index, self.compiled.pair_names, self.compiled.joint_names)

    def nodes(self, first: int = 0) -> tuple[Array, Array, Array]:
        """Return t (N,), q (N, nq), p (N, nv) of the blocks from `first` on."""
        t, q, p = self.t[first:], self.q[first:], self.p[first:]
        return (t[0], q[0], p[0]) if len(t) == 1 else (np.concatenate(t), np.concatenate(q), np.concatenate(p))

    def log(self, first: int = 0) -> event_log.EventLog:
        """Return the events of the blocks from `first` on."""
        return self._log(self.events[first:])

    def _shared(self, kind: str, make: Callable[[list[Columns]], Log]) -> Log:
        """Return the log without rows of a kind, which the runs of a scene share."""
        found = self.compiled.empty_logs.get(kind)
        if found is None:
            found = self.compiled.empty_logs[kind] = make([])
        return found

    def _log(self, parts: list[Columns]) -> event_log.EventLog:
        return self._event_log(parts) if parts else self._shared(self.options.impact, self._event_log)

    def _event_log(self, parts: list[Columns]) -> event_log.EventLog:
        states = self.compiled.states
        return event_log.EventLog(
            partial(_events, self.compiled.core, parts, states.nq, states.nv),
            self.compiled.pair_names,
            self.compiled.joint_names,
            self.options.impact,
        )

    def segments_joined(self) -> dense.Segments | dense.SegmentsApart | None:
        """Return the segments of all blocks; None where none were kept."""
        if self.apart is not None:
            return self.apart
        return dense.joined(self.segments, self.options.order, self.options.stage_tol) if self.segments else None

    def contact_log(self, first: int = 0) -> contacts.ContactLog:
        """Return the contacts of the blocks from `first` on."""
        return self._contact_log(self.contacts[first:])

    def contacts_at(self, now: float) -> contacts.ContactLog:
        """Return the persistent contacts at the end of the last step, which is now [s]; one row per point."""
        slack = ROUNDING * self.options.fixed_dt
        last = [part.last_steps() if isinstance(part, WithStill) else part for part in self.contacts[-1:]]
        log = self._contact_log([
            _rows(part, (np.abs(part["t"] + part["h"] - now) <= slack) & (part["h"] > 0.0)) for part in last
        ])  # fmt: skip
        changes = self.change_log(max(0, len(self.changes) - 1))
        released = (changes.array("change") == Change.RELEASE) & (changes.array("time") >= now - slack)
        if not released.any():
            return log
        ended = set(contacts.points_of(changes, np.flatnonzero(released)))
        points = contacts.points_of(log, np.arange(len(log)))
        return log.rows(np.array([point not in ended for point in points], dtype=bool))

    def _contact_log(self, parts: list[Columns]) -> contacts.ContactLog:
        return self._contacts_of(parts) if parts else self._shared("contacts", self._contacts_of)

    def _contacts_of(self, parts: list[Columns]) -> contacts.ContactLog:
        rows = partial(joined, parts, contacts.FIELDS)
        compiled = self.compiled
        return contacts.ContactLog(rows, compiled.pair_names, compiled.joint_names, compiled.shape_groups)

    def change_log(self, first: int = 0) -> contacts.ChangeLog:
        """Return the changes of contacts of the blocks from `first` on."""
        return self._change_log(self.changes[first:])

    def recent(self, since: float, now: float) -> Recent:
        """Return the contacts now [s], and what was recorded after `since` [s]; the rest is not looked at."""
        events, changes = _after(self.events, since), _after(self.changes, since)
        happened = bool(events or changes)
        present = self.contacts_at(now)
        return Recent(present, self._log(events), self._change_log(changes), happened, self.stats.impacts)

    def _change_log(self, parts: list[Columns]) -> contacts.ChangeLog:
        return self._changes_of(parts) if parts else self._shared("changes", self._changes_of)

    def _changes_of(self, parts: list[Columns]) -> contacts.ChangeLog:
        rows = partial(joined, parts, contacts.CHANGE_FIELDS)
        return contacts.ChangeLog(rows, self.compiled.pair_names, self.compiled.joint_names)

    def phases_joined(self) -> dict[str, Array] | None:
        """Return {"t", "dt", "persistent"} as `Trajectory.phases`; None for a run of free steps alone."""
        if not self.phases:
            return None
        whole = {name: np.concatenate([np.asarray(part[name], dtype=float) for part in self.phases])
                 for name in ("t", "dt", "persistent")}  # fmt: skip
        new = np.ones(len(whole["t"]), dtype=bool)
        new[1:] = (np.diff(whole["dt"]) != 0.0) | (np.diff(whole["persistent"]) != 0.0)
        return {name: values[new] for name, values in whole.items()}

    def dense_log(self, first: int = 0) -> dense_steps.DenseSteps:
        """Return the dense steps of the blocks from `first` on."""
        parts = self.dense_steps[first:]
        return dense_steps.of_parts(parts) if parts else self._shared("dense steps", dense_steps.of_parts)

    @property
    def impacts(self) -> int:
        """Number of impacts so far."""
        return sum(len(part["time"]) for part in self.events)

    def impact_times(self) -> Array:
        """Return the times of the impacts so far [s]."""
        times = [part["time"] for part in self.events]
        return np.concatenate(times) if times else np.zeros(0)

    def copy(self) -> Record:
        """Return a copy that grows on its own. It shares what was recorded, which does not change."""
        twin = copy.copy(self)
        for name, value in vars(self).items():
            if isinstance(value, list):
                setattr(twin, name, list(value))
        twin.forces, twin.points = self.forces.copy(), self.points.copy()
        twin.inputs = None if self.inputs is None else self.inputs.copy()
        twin.actuation = self.actuation.copy()
        return twin

    def __getstate__(self) -> dict[str, Any]:
        """Return what pickle keeps: not the rows that are known by what they are in the engine."""
        return {**vars(self), "_still": None}

    def cut(self, time: float) -> None:
        """Forget what was recorded after the first node at or after `time` [s]."""
        t, q, p = self.nodes()
        count = int(np.searchsorted(t, time)) + 1
        self.t, self.q, self.p = [t[:count]], [q[:count]], [p[:count]]
        self.forces.cut(count)
        last = max(time, float(self.t[0][-1]))
        self.events = [_rows(part, part["time"] <= last) for part in self.events]
        for name in ("segments", "contacts", "phases", "dense_steps"):
            setattr(self, name, [_rows(part, part["t"] < last) for part in getattr(self, name)])
        self.changes = [_rows(part, part["time"] <= last) for part in self.changes]

    def ledger(self, nodes: int = 0, events: int = 0, contacts: int = 0, dense_steps: int = 0) -> Ledger:
        """Return the ledger of the blocks from these on; of the first of several blocks of nodes only the last node."""
        skipped = len(self.t[nodes]) - 1 if nodes or events or contacts or dense_steps else 0
        t, q, p = self.nodes(nodes)
        inputs = LedgerInputs(
            self.options, self.start, self.forced, t[skipped:], q[skipped:], p[skipped:], self.log(events),
            self.contact_log(contacts), self.phases_joined(), self.forces.joined(nodes).since(float(t[skipped])),
            dense_steps=self.dense_log(dense_steps),
        )  # fmt: skip
        return Ledger(self.compiled.core, self.compiled.built, inputs)

    def trajectory(self, engine: _core.Simulator | None, error_estimate: float = float("nan")) -> Trajectory:
        """Return what was recorded, with the present state of the engine where the run ended inside a step."""
        t, q, p = self.nodes()
        forces = self.forces.joined()
        if engine is not None and self.status.time > t[-1]:
            t, q, p = np.append(t, self.status.time), np.vstack([q, engine.q]), np.vstack([p, engine.p])
        segments = self.segments_joined()
        if self.options.sample_dt is not None and segments is not None:
            times = dense.sample_times(float(t[0]), float(t[-1]), self.options.sample_dt)
            times = times if len(times) > 1 else t[[0, -1]]
            q, p = self._sampled(t, q, p, segments, times)
            t = times
        if forces.t is not t and not np.array_equal(forces.t, t):
            forces = forces.sampled(t)
        found = Trajectory(
            self.compiled, self.options, t, q, p, self.log(), self.status, self.stats,
            forced=self.forced, segments=segments, adaptive_steps=self.adaptive_steps, error_estimate=error_estimate,
            contacts=self.contact_log(), changes=self.change_log(), phases=self.phases_joined(), forces=forces,
            dense_steps=self.dense_log(), inputs=None if self.inputs is None else self.inputs.joined(),
            actuation=self.actuation.copy(),
        )  # fmt: skip
        found.separation = self.separation
        return found

    def _sampled(
        self, t: Array, q: Array, p: Array, segments: dense.Segments | dense.SegmentsApart, times: Array
    ) -> tuple[Array, Array]:
        """Return q (N, nq) and p (N, nv) at times (N,), the first and the last of which are nodes."""
        slack = ROUNDING * (times[1] - times[0])
        node = t.searchsorted(times - slack)
        node[-1] = len(t) - 1
        q, p = q[node], p[node]
        inner = (t[node] - times > slack).nonzero()[0]
        if len(inner):
            core = self.compiled.core
            if self.forced:
                q[inner], v = segments.states(core, times[inner])
                p[inner] = core.momentum(q[inner], v)
            else:
                q[inner], p[inner] = segments.exact_momenta(core, times[inner])
        return q, p


def _events(core: _core.Scene, parts: list[Columns], nq: int, nv: int) -> dict[str, NDArray[Any]]:
    arrays = event_log.joined(parts, nq, nv)
    return event_log.with_energy_change(arrays, lambda q, p: np.asarray(core.energy(q, p))[:, 0])


def _rows(part: Columns, chosen: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    return {name: np.asarray(values)[chosen] for name, values in part.items()}


def _after(parts: list[Columns], time: float) -> list[Columns]:
    """Return the rows after a time [s]; parts are in the order of time."""
    found: list[Columns] = []
    for part in reversed(parts):
        late = np.asarray(part["time"]) > time
        if not late.any():
            break
        found.append(_rows(part, late))
    return found[::-1]
