"""How a run was stepped, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from contactvi.options import Options
from contactvi.records.codes import StepKind
from contactvi.records.dense_steps import DenseSteps
from contactvi.records.work import ConstraintRows
from contactvi.scene.scene import Scene
from contactvi.status import Stats, Status
from contactvi.trajectory.polynomials import CONTACT_STEP, Segments, SegmentsApart

Array = NDArray[np.float64]

_ALL = 1e-9  # of the time with contacts: what is shorter does not count


class Run(Protocol):
    """What the words are about; contactvi.Trajectory has it."""

    options: Options
    t: Array
    status: Status
    stats: Stats
    segments: Segments | SegmentsApart | None
    adaptive_steps: dict[str, Array] | None
    phases: dict[str, NDArray[Any]] | None
    dense_steps: DenseSteps
    error_estimate: float

    @property
    def scene(self) -> Scene: ...
    @property
    def constraints(self) -> list[ConstraintRows]: ...


def stepping_of(traj: Run) -> str:
    """Return how a run was stepped, for example "order 2, dt = 0.01 s"; with how long there were contacts."""
    order = f"order {traj.options.order}"
    in_contact = _persistent_stepping(traj, traj.phases) + _dense_stepping(traj)
    if not traj.options.auto:
        return f"{order}, dt = {traj.options.fixed_dt:.6g} s{in_contact}"
    lengths = _lengths(np.zeros(0) if traj.adaptive_steps is None else traj.adaptive_steps["dt"])
    return f"{order}, dt{lengths} (auto){in_contact}, error of q about {traj.error_estimate:.1g}"


def _dense_stepping(traj: Run) -> str:
    if not len(traj.dense_steps):
        return ""
    return f", dense steps for {traj.dense_steps.span:.4g} s of {float(traj.status.time - traj.t[0]):.4g} s"


def _persistent_stepping(traj: Run, phases: Mapping[str, NDArray[Any]] | None) -> str:
    if phases is None or not np.any(phases["persistent"] == StepKind.PERSISTENT):
        return ""
    persistent = phases["persistent"] == StepKind.PERSISTENT
    spans = np.where(persistent, np.append(phases["t"][1:], traj.status.time) - phases["t"], 0.0)
    built = traj.scene.built()
    coupled = built.elements.couplings.names
    constrained = built.constrained or any(row.name not in coupled for row in traj.constraints)
    what = f"persistent contact for {spans.sum():.4g} s"
    same = traj.options.order == 2 and not traj.options.auto
    if same and np.all(phases["dt"][persistent] == traj.options.fixed_dt):
        return "" if constrained else f", {what}"
    if traj.options.order > 2 and not traj.stats.contact_steps:
        return f", {what}"
    taken, stepped = _contact_steps(traj, phases, persistent, spans)
    if not np.any(stepped):
        return f", {what}, part of it with order 2"
    lengths = _lengths(phases["dt"][stepped])
    if taken < (1.0 - _ALL) * spans.sum():
        return f", {what}, {taken:.4g} s of it with order 2, dt{lengths}"
    everywhere = constrained and spans.sum() >= (1.0 - _ALL) * float(traj.status.time - traj.t[0])
    return f", {'constraints met' if everywhere else what} with order 2, dt{lengths}"


def _contact_steps(
    traj: Run, phases: Mapping[str, NDArray[Any]], persistent: NDArray[np.bool_], spans: Array
) -> tuple[float, NDArray[np.bool_]]:
    """Return for how long contact steps were taken [s], and the phases in which they were.

    Polynomials tell them from smooth steps in which contacts are held; without them the length of a phase's steps does,
    where it is not that of the run.
    """
    if traj.options.order == 2:
        return float(spans.sum()), persistent
    if traj.segments is None:
        fixed = np.nan if traj.options.auto else traj.options.fixed_dt
        stepped = persistent & (phases["dt"] < fixed)
        return float(spans[stepped].sum()), stepped
    each = traj.segments.steps
    steps = {name: np.concatenate([part[name] for part in each]) for name in ("t", "h", "persistent")}
    phase = np.searchsorted(phases["t"], steps["t"] + 0.5 * steps["h"]) - 1
    of_order_2 = (steps["persistent"] == CONTACT_STEP) & (phase >= 0) & persistent[np.maximum(phase, 0)]
    stepped = np.zeros(len(persistent), dtype=bool)
    stepped[phase[of_order_2 & (steps["h"] > _ALL * spans.sum())]] = True
    return float(steps["h"][of_order_2].sum()), stepped


def _lengths(steps: Array) -> str:
    """Return " = 0.01 s" or " = 0.01 to 0.02 s", nothing for none."""
    low, high = (f"{x:.3g}" for x in (steps.min(initial=np.inf), steps.max(initial=0.0)))
    return f" = {low} s" if low == high else f" = {low} to {high} s" if len(steps) else ""
