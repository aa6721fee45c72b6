"""Exact derivatives of a run through its impacts: what changes at all later times where its start, inputs or
parameters change.

The derivative is that of what was computed: partial steps to the events, impact maps, and the rest of the steps
(docs/theory/run_derivatives.md). Rows are those of (q, v) in Pinocchio's coordinates: tangent vectors at q, then
velocities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import InputError, NotDifferentiable, did_you_mean
from contactvi.inputs import array, check_choice, real_numbers, short
from contactvi.keywords import meant
from contactvi.options import Options
from contactvi.records.events import EventLog
from contactvi.records.inputs import RunInputs
from contactvi.scene.parameter_values import LIMITS
from contactvi.trajectory import parameters
from contactvi.trajectory.compiled import CompiledScene
from contactvi.trajectory.polynomials import Segments, SegmentsApart
from contactvi.trajectory.poses import point_jacobians

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]

ON_KINK = ("raise", "taken")
PLAIN = ("q0", "v0", "control", "restitution", "friction")
NEAR_KINK = 1e-3  # of the impulse or the speeds: an event so near to a kink is marked in the report


def check_on_kink(value: Any) -> None:
    """Raise InputError where this is no answer to a kink."""
    check_choice("on_kink", value, ON_KINK, "Unknown answer to a kink", {
        "forward": "The one-sided derivative along a direction is cvi.directional_derivative(run, {'control': du})",
    })  # fmt: skip


class Recorded(Protocol):
    """What of a Trajectory its derivatives need."""

    t: Array
    q: Array
    p: Array
    options: Options
    events: EventLog
    segments: Segments | SegmentsApart | None
    inputs: RunInputs | None


@dataclass(frozen=True)
class EventSensitivity:
    """An event on the way, and how well its derivative is conditioned.

    Attributes:
        time: [s]. pair: names of the shapes, or of a joint and its limit.
        approach: closing speed of the gap over the sum of the sizes of its terms, from 0 (grazing) to 1: derivatives
            grow like its inverse.
        margin: distance from the nearest change between sticking and slipping, relative to the impulse or the speeds;
            1 without friction.
        simultaneous: whether other contacts were hit at the same instant: the derivative is then that of the order
            taken.
    """

    time: float
    pair: tuple[str, str]
    approach: float
    margin: float
    simultaneous: bool

    @property
    def near_kink(self) -> bool:
        """Whether the derivative is near to where it does not exist."""
        return self.simultaneous or min(self.approach, self.margin) < NEAR_KINK


@dataclass(frozen=True)
class DenseStepSensitivity:
    """A dense step on the way whose derivative is not that of the step to rounding, or is near to where it has none.

    Attributes:
        time: start of the step [s].
        error: what its impulses leave of the laws that are differentiated, relative to its impulses and speeds.
        margin: distance from the nearest change between open, sticking and slipping, relative to the same.
        reason: why the derivative is approximate; "" where it is only near a kink.
    """

    time: float
    error: float
    margin: float
    reason: str


@dataclass(frozen=True)
class Kink:
    """A place of a run where a direction leads to both sides of a kink.

    Attributes:
        time: [s]. pair: of the contact, None: of no single one. reason: as of NotDifferentiable.
    """

    time: float
    pair: tuple[str, str] | None
    reason: str


@dataclass(frozen=True)
class SensitivityReport:
    """How far derivatives of a run can be trusted.

    Attributes:
        events: those on the way, in the order of time.
        growth: largest derivative of a state on the way, relative to that of the start; 0 with respect to what does not
            change the start.
        dense_steps: the dense steps on the way that are approximate or near a kink, in the order of time.
        kinks: with on_kink="taken", where some column has a kink, and is the derivative of what the run did there: an
            element of the generalised derivative (Clarke), but for "redundant" ones, whose impulses are those of
            least norm. Combinations of the other columns are derivatives.
    """

    events: tuple[EventSensitivity, ...]
    growth: float
    dense_steps: tuple[DenseStepSensitivity, ...] = ()
    kinks: tuple[Kink, ...] = ()

    @property
    def approximate(self) -> bool:
        """Whether some dense step does not satisfy the laws that are differentiated, or has a kink."""
        return any(step.reason for step in self.dense_steps)

    def __str__(self) -> str:
        lines = [f"{len(self.events)} events, growth {self.growth:.3g}{', approximate' if self.approximate else ''}"]
        lines += [
            f"t = {e.time:.9g} s  {e.pair[0]} | {e.pair[1]}  approach {e.approach:.3g}  margin {e.margin:.3g}"
            f"{'  near a kink' if e.near_kink else ''}"
            for e in self.events
        ]
        lines += [
            f"t = {s.time:.9g} s  dense step  error {s.error:.3g}  margin {s.margin:.3g}  {s.reason or 'near a kink'}"
            for s in self.dense_steps
        ]
        lines += [f"t = {k.time:.9g} s  {' | '.join(k.pair or ())}  kink ({k.reason}), as taken" for k in self.kinks]
        return "\n".join(lines)


class Sensitivity:
    """The derivatives of (q, v) of a run at its nodes.

    In a scene with constraints the columns of the start are those of the run as it is computed, whose steps end on the
    constraints: changes of the start that satisfy them to first order are combinations of columns. One column alone
    tells what the first step makes of a start that is off.

    Args:
        traj: a run with record="gradient". compiled: its scene.
        wrt: what they are with respect to, any of

            - "q0": the start, as a tangent vector of Pinocchio (nv columns); "v0": its velocity (nv);
            - "control": generalized forces added to all steps (nv); "control:joint": of this joint or free body alone;
            - "gravity" (3), "mass:joint" (1), "inertia:joint" (10), "armature:joint", "stiffness:joint",
              "damping:joint", "rest:joint", "kp:joint", "kd:joint": as for contactvi.gradient;
            - "restitution", "friction": a number added to those of all pairs, and of all limits, that have some (1);
              "restitution:a|b", "friction:a|b": of the pair of these shapes, or of a joint and its limit (1);
              "restitution:joint": of both limits of a joint (1).
        on_kink: "raise", or "taken": at a kink the derivative of what the run did, `report.kinks` tells where. Where
            several contacts were hit at one instant it is that of their order; a contact that an impact of others
            leaves at rest takes no part in it; what stands on a face keeps standing on it; what is at the limit of its
            friction without a slip sticks. Where points share a load in a way that decides about the motion it is that
            with impulses of least norm, which is not the run's.

    Attributes:
        names: what was asked for. columns: name -> slice of columns.
        t: times of the nodes [s], shape (N,).
        matrix: the derivatives there, shape (N, 2 nv, columns).
        event_times: derivatives of the times of the events of `report`, shape (events, columns) [s].
        report: how far they can be trusted.

    Raises:
        InputError: the run was not made with record="gradient"; an unknown name.
        NotDifferentiable: for a run with something that has no derivative, or none that is known: grazing
            impacts, several nearest points, points that turn while they slip; with the pair, the time and the reason.
    """

    def __init__(
        self, traj: Recorded, compiled: CompiledScene, wrt: Sequence[str] | str, *, on_kink: str = "raise"
    ) -> None:
        check_on_kink(on_kink)
        self._traj, self._taken = traj, on_kink == "taken"
        self._run = recorded_run(traj, compiled)
        self.names = wanted(wrt)
        laws = Laws(traj, self._run, compiled)
        self._directions, self.columns = _directions(traj, laws, self.names, compiled)
        self.t = np.array(traj.t)
        found = self._solve(self.t)
        self.matrix: Array = np.array(found["nodes"])
        self._built = compiled.built
        self.event_times: Array = np.asarray(found["event_times"]).reshape(-1, self._directions["count"])
        self.report = self._report(found)

    def of(self, name: str) -> Array:
        """Return the derivatives with respect to one of `names` at the nodes, shape (N, 2 nv, width)."""
        check_choice("name", name, self.names, "The derivative was not asked for")
        return self.matrix[:, :, self.columns[name]]

    def at(self, t: ArrayLike) -> Array:
        """Return the derivatives at t [s] within the run, shape (2 nv, columns); at an impact those after it.

        For an array of n times a first axis n is added. Between nodes they belong to the state `Trajectory.at` gives.
        """
        given = real_numbers(t)
        many = given is not None and given.ndim > 0
        times = array("t", t if many else [t], (len(given) if given is not None and many else 1,), "times in the run")
        if times.size and not (self.t[0] <= times.min() and times.max() <= self.t[-1]):
            raise InputError(
                "The run has no state there", name="t", expected=f"times from {self.t[0]:g} to {self.t[-1]:g} s",
                got=f"{times.min():g} to {times.max():g} s", remedy="Ask within the run",
            )  # fmt: skip
        order = np.argsort(times, kind="stable")
        found = np.array(self._solve(times[order])["nodes"]).reshape(len(times), *self.matrix.shape[1:])
        result = np.empty_like(found)
        result[order] = found
        return result if many else result[0]

    def position(self, body: Any, point: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
        """Return the derivatives of the position of a point of a body at the nodes, world axes, (N, 3, columns).

        The rows of `matrix` are tangent vectors, those of a free body in its own axes; these are in the world's.

        Args:
            body: name of a body, or the handle of a part with one body. point: in the body's frame [m], shape (3,).

        Raises:
            InputError: unknown body.
        """
        name = self._built.names.select_body(body)
        rows = point_jacobians(self._built, self._traj.q, name, array("point", point, (3,), "a point of the body"))
        return np.asarray(rows @ self.matrix[:, : self._built.model.nv])

    def _solve(self, times: Array) -> dict[str, Any]:
        found = self._run.tangent(self._directions, list(map(float, times)), self._taken)
        if "fact" in found:
            raise not_differentiable(self._traj, found)
        return found

    def _report(self, found: dict[str, Any]) -> SensitivityReport:
        log = self._traj.events
        entries = zip(found["impact"], found["approach"], found["margin"], found["guards"], strict=True)
        events = tuple(
            EventSensitivity(log[i].time, log[i].pair, approach, margin, guards > 1)
            for i, approach, margin, guards in entries
        )
        kinks = tuple(Kink(at["time"], _pair_of(self._traj, at), at["reason"]) for at in found["kinks"])
        return SensitivityReport(events, found["growth"], dense_report(found), kinks)


def dense_report(found: dict[str, Any]) -> tuple[DenseStepSensitivity, ...]:
    """Return the dense steps of the engine's answer that are approximate or near a kink."""
    entries = zip(found["dense_time"], found["dense_error"], found["dense_margin"], found["dense_why"], strict=True)
    return tuple(DenseStepSensitivity(*entry) for entry in entries if entry[3] or entry[2] < NEAR_KINK)


def wanted(wrt: Sequence[str] | str) -> tuple[str, ...]:
    """Return the names of what derivatives are with respect to; raise InputError where there are none."""
    names = (wrt,) if isinstance(wrt, str) else tuple(wrt) if isinstance(wrt, Sequence) else ()
    if not names or not all(isinstance(name, str) for name in names):
        raise InputError(
            "wrt names nothing", name="wrt", expected="a name, or a sequence of names", got=short(wrt),
            remedy="For example wrt=['q0', 'v0']",
        )  # fmt: skip
    if len(set(names)) < len(names):
        raise InputError(
            "wrt names something twice", name="wrt", expected="names that differ", got=short(wrt),
            remedy="Leave one of them out",
        )  # fmt: skip
    return names


def recorded_run(traj: Recorded, compiled: CompiledScene) -> _core.RecordedRun:
    """Return the engine's view of a run; raise InputError where it has not kept what derivatives need."""
    from contactvi import _core

    inputs, segments = traj.inputs, traj.segments
    if inputs is not None and segments is None:
        still = compiled.states.nv == 0
        raise InputError(
            "The run has nothing to take derivatives of", name="scene" if still else "duration",
            expected="a scene in which something moves" if still else "a run that has made a step",
            got="one without joints" if still else f"{len(traj.t)} node, {traj.options.steps} steps asked for",
            remedy="Add a body that moves" if still else "Look at its status, why it has ended where it started",
        )  # fmt: skip
    if inputs is None or not isinstance(segments, Segments):
        raise InputError(
            "The run has not kept what its derivatives need", name="record", expected="a run with record='gradient'",
            got="one without", remedy="simulate(..., record='gradient')",
        )  # fmt: skip
    compiled.check_differentiable()
    if inputs.saturated:
        raise NotDifferentiable(
            "Actuators were at limits of speed or, in contact steps of order 2, of effort, a rope with a damper became "
            "taut, or the force of a compliant contact jumped where it began or ended",
            reason="saturation",
            expected="limits of effort alone, in smooth steps or beside contact above order 2; ropes without dampers",
            got=f"{inputs.saturated} steps in which a force is constant or jumps",
            remedy="Ask for less, or take the limits off: scene.set_actuator('*', effort=False, velocity=False); give "
            "ropes no damping, and compliant contacts forces that are zero at the opening",
        )  # fmt: skip
    options = traj.options
    settings = {
        "t0": float(traj.t[0]), "dt": options.fixed_dt, "order": options.order, "tol": options.stage_tol,
        "impact": _core.ImpactMap[options.impact.upper()],
        "mhc_reference": _core.MhcReference[options.mhc_reference.upper()], "contact_points": options.contact_points,
    }  # fmt: skip
    events = traj.events.arrays if len(traj.events) else None
    return _core.RecordedRun(
        compiled.core, settings, dict(segments.arrays), None if events is None else dict(events), inputs.control,
        inputs.target, np.array(traj.q[-1]), np.array(traj.p[-1]), _contact_steps(inputs, compiled),
    )  # fmt: skip


def _contact_steps(inputs: RunInputs, compiled: CompiledScene) -> list[_core.KeptContactSteps]:
    """Return the steps with contacts or constraints; ContactviError for numbers that are not those of the scene."""
    from contactvi import _core

    if not inputs.earlier:
        return list(inputs.contact_steps)
    return [_core.KeptContactSteps(compiled.core, inputs.earlier), *inputs.contact_steps]


def _pair_of(traj: Recorded, found: dict[str, Any]) -> tuple[str, str] | None:
    """Return the pair of a place that the engine names; None: it is of none."""
    return traj.events.label(found["kind"], found["index"]) if found["index"] >= 0 else None


def not_differentiable(traj: Recorded, found: dict[str, Any]) -> NotDifferentiable:
    """Return the error for the engine's reason why there is no derivative."""
    pair = _pair_of(traj, found)
    where = f", t = {found['time']:.9g} s" + ("" if pair is None else f", {pair[0]} - {pair[1]}")
    return NotDifferentiable(
        found["fact"], reason=found["reason"], pair=pair, time=found["time"], expected=found["expected"],
        got=found["got"] + where, remedy=found["remedy"],
    )  # fmt: skip


def check_parameter(traj: Recorded, name: str) -> None:
    """Raise NotDifferentiable for what changes the energy of a motion, which an implicit impact map conserves."""
    if traj.options.impact == "ctec" or not len(traj.events) or name.partition(":")[0] not in parameters.OF_ENERGY:
        return
    raise NotDifferentiable(
        "The energy that an implicit impact map conserves depends on inputs and on the scene's parameters",
        reason="map", got=f"{name!r} with {traj.options.impact!r}",
        expected="impact='ctec' for derivatives in inputs, inertias, gravity, springs and damping",
        remedy="Use impact='ctec', or leave these names out of wrt",
    )  # fmt: skip


def _directions(
    traj: Recorded, laws: Laws, names: Sequence[str], compiled: CompiledScene
) -> tuple[dict[str, Any], dict[str, slice]]:
    """Return the directions for the engine, one column each, and the columns of each name."""
    parts = [_part(traj, laws, str(name), compiled) for name in names]
    columns: dict[str, slice] = {}
    count = sum(part[1].shape[1] if isinstance(part[1], np.ndarray) else len(part[1]) for part in parts)
    directions: dict[str, Any] = {"count": count}
    at = 0
    for name, (entry, part) in zip(names, parts, strict=True):
        width = part.shape[1] if isinstance(part, np.ndarray) else len(part)
        columns[name] = slice(at, at + width)
        if isinstance(part, np.ndarray):
            matrix = directions.setdefault(entry, np.zeros((part.shape[0], count)))
            matrix[:, columns[name]] += part
        else:
            directions.setdefault(entry, [{} for _ in range(count)])[columns[name]] = part
        at += width
    return directions, columns


def _part(
    traj: Recorded, laws: Laws, name: str, compiled: CompiledScene
) -> tuple[str, Array | list[parameters.Direction]]:
    """Return the engine's entry of a name and its columns."""
    kind, _, pair = name.partition(":")
    check_parameter(traj, name)
    if parameters.is_parameter(name):
        return "parameters", parameters.directions_of(compiled.built.model, name)
    entry = {"q0": "q", "v0": "v", "control": "tau", "restitution": "e", "friction": "mu"}.get(kind)
    if entry is None or (pair and entry not in ("e", "mu", "tau")):
        known = ("q0", "v0", "control", *parameters.CONTACT_NAMES, *parameters.NAMES)
        raise InputError(
            "Nothing of the run has this name", name="wrt", expected=f"one of {', '.join(known)}", got=name,
            remedy=meant(kind, known),
        )  # fmt: skip
    if kind == "control" and pair:
        return entry, _joint_columns(compiled.built.model, pair)
    return entry, laws.column(entry, pair) if entry in ("e", "mu") else np.eye(compiled.states.nv)


def _joint_columns(model: Any, joint: str) -> Array:
    """Return the columns of the unit matrix of one joint, shape (nv, its degrees of freedom)."""
    names = tuple(model.names)[1:]
    if joint not in names:
        raise InputError(
            "Nothing of the run has this name", name="wrt", expected="'control:' and the name of a joint or free body",
            got=repr(joint), remedy=did_you_mean(joint, names),
        )  # fmt: skip
    k = model.getJointId(joint)
    return np.eye(model.nv)[:, model.idx_vs[k] : model.idx_vs[k] + model.nvs[k]]


class Laws:
    """Restitution and friction of the engine's guards: the pairs, then the limits."""

    def __init__(self, traj: Recorded, run: _core.RecordedRun, compiled: CompiledScene) -> None:
        built = compiled.built
        self._labels = [traj.events.label(int(kind), int(index)) for kind, index in run.guards]
        limits = len(self._labels) - len(built.restitution)
        e = np.concatenate([built.restitution, np.ones(limits)])
        mu = np.concatenate([built.friction, np.zeros(limits)])
        self._values = {"e": e, "mu": mu}

    def column(self, entry: str, pair: str) -> Array:
        """Return the column (guards, 1) of the change of one pair's law, or of all that have one."""
        rows = np.zeros((len(self._labels), 1))
        if not pair:
            rows[self._values[entry] > 0.0, 0] = 1.0
            return rows
        wanted = tuple(part.strip() for part in pair.split("|"))
        found = [k for k, label in enumerate(self._labels) if wanted in (label, label[::-1])]
        if len(wanted) == 1 and entry == "e":  # both limits of a joint, which have one restitution
            found = [k for k, label in enumerate(self._labels) if label in [(pair, side) for side in LIMITS]]
        if not found:
            names = ["|".join(label) for label in self._labels]
            raise InputError(
                "No pair has these names", name="wrt", expected="restitution:first|second", got=pair,
                remedy=did_you_mean(pair, names),
            )  # fmt: skip
        rows[found, 0] = 1.0
        return rows


__all__ = ["DenseStepSensitivity", "EventSensitivity", "Sensitivity", "SensitivityReport"]
