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
from contactvi.status import Status

Array = NDArray[np.float64]


class Run(Protocol):
    """What the words are about; contactvi.Trajectory has it."""

    options: Options
    t: Array
    status: Status
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
    ends = np.append(phases["t"][1:], traj.status.time)
    span = float((ends - phases["t"])[persistent].sum())
    built = traj.scene.built()
    coupled = built.elements.couplings.names
    constrained = built.constrained or any(row.name not in coupled for row in traj.constraints)
    what = "constraints met" if constrained else f"persistent contact for {span:.4g} s"
    lengths, same = _lengths(phases["dt"][persistent]), traj.options.order == 2 and not traj.options.auto
    if same and np.all(phases["dt"][persistent] == traj.options.fixed_dt):
        return "" if constrained else f", {what}"
    return f", {what} with order 2, dt{lengths}"


def _lengths(steps: Array) -> str:
    """Return " = 0.01 s" or " = 0.01 to 0.02 s", nothing for none."""
    low, high = (f"{x:.3g}" for x in (steps.min(initial=np.inf), steps.max(initial=0.0)))
    return f" = {low} s" if low == high else f" = {low} to {high} s" if len(steps) else ""
