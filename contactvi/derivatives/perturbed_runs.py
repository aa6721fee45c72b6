"""A run made again with changes along the columns of its derivatives, for differences."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.derivatives.constrained_starts import ConstrainedStarts, tangent
from contactvi.errors import ContactviError, NotDifferentiable
from contactvi.scene.element_rows import dof_names
from contactvi.scene.parameter_values import LIMITS
from contactvi.simulation.run import Run
from contactvi.status import StatusCode
from contactvi.trajectory.compiled import CompiledScene, compile_scene
from contactvi.trajectory.sensitivity import Sensitivity
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from contactvi.scene.scene import Scene

Array = NDArray[np.float64]

SOLVED = 1e-15  # tolerance of the steps of the perturbed runs, near rounding
LOCATED = 1e-13  # gap at which the engine takes an impact for located [m; rad]
_HIGHEST = {"restitution": 1.0, "friction": np.inf}


@dataclass(frozen=True)
class RunEnd:
    """The end of a run: (q, v) as a difference from the unperturbed run, times of its impacts, and their sequence.

    `steps` are those of the impacts: where an impact passes the end of a step, the run has a kink of the size of the
    integrator's error.
    """

    state: Array
    times: Array
    sequence: tuple[Any, ...]
    steps: tuple[int, ...]


class PerturbedRuns:
    """The run at hand, made again with a change along a column.

    Attributes:
        starts: those that satisfy the constraints of the scene, to which changes of the start are brought back; None
            without constraints.
    """

    def __init__(self, scene: Scene, traj: Trajectory, exact: Sensitivity) -> None:
        self._scene, self._exact = scene, exact
        self._compiled = compile_scene(scene).at_start(traj.q[0])
        # Runs for derivatives have steps of their own: with implicit maps contact steps of order 2 where others hold
        # constraints in smooth steps; and all trees are advanced together.
        self._settings = replace(traj.options, record="gradient", solver_tol=min(SOLVED, traj.options.stage_tol))
        self._q, self._v, self._t = np.array(traj.q[0]), np.array(traj.v[0]), float(traj.t[0])
        bound = bool(self._compiled.built.elements.constraints)
        self.starts = ConstrainedStarts(self._compiled, self._q, self._v, self._t) if bound else None
        assert traj.inputs is not None
        self._control, self._target = traj.inputs.control, traj.inputs.target
        self._dofs = dof_names(self._compiled.built.model)
        self.span, self.growth = float(traj.t[-1] - traj.t[0]), exact.report.growth
        self.steps = traj.options.steps
        self._middle_q: Array | None = None
        middle = self._run(self._compiled, self._q, self._v, self._control)
        if middle is None or len(middle.times) != len(traj.events):
            raise NotDifferentiable(
                "The run has other impacts when its steps are solved to rounding", reason="tolerance",
                expected=f"{len(traj.events)} impacts", got="no run" if middle is None else str(len(middle.times)),
                remedy=f"Make solver_tol smaller, for example {SOLVED:g}",
            )  # fmt: skip
        self.middle = middle
        times = [event.time for event in exact.report.events]  # the first one of those at one instant
        self.first = np.searchsorted(traj.events.array("time"), times) if times else np.zeros(0, dtype=np.intp)
        self.located = _located(traj)[self.first]
        self.largest = 1.0 + float(np.abs(traj.q[-1]).max(initial=0.0)) + float(np.abs(traj.v[-1]).max(initial=0.0))

    def kind(self, column: int) -> str:
        """Return what a column belongs to, one of the names that were asked for."""
        return self._asked(column)[0]

    def name(self, column: int) -> str:
        """Return the name of a column."""
        kind, at = self._place(column)
        return kind if kind.partition(":")[0] in _HIGHEST else f"{kind}[{at}] {self._dofs[at]}"

    def scale(self, column: int) -> float:
        """Return the scale of the changes along a column: 1 rad or m, the size of the velocities, ..."""
        kind, at = self._place(column)
        speed = max(1.0, float(np.abs(self._v).max(initial=0.0)))
        if kind == "v0":
            return speed
        if kind != "control":
            return 1.0
        unit = np.eye(len(self._v))[at]  # the force that makes such a velocity within the run
        return speed / (self.span * float(np.asarray(self._compiled.core.velocity(self._q[None], unit[None]))[0, at]))

    def room(self, column: int) -> tuple[float, float]:
        """Return how far a column can be changed down and up."""
        kind, _ = self._place(column)
        word = kind.partition(":")[0]
        if word not in _HIGHEST:
            return np.inf, np.inf
        values = [value for _, value in self._coefficients(kind)]
        return min(values, default=0.0), _HIGHEST[word] - max(values, default=0.0)

    def changed(self, column: int, by: float) -> RunEnd | None:
        """Return the end of the run with a change along a column; None where it has none."""
        kind, at = self._place(column)
        q, v, control, compiled = self._q, self._v, self._control, self._compiled
        unit = np.zeros(len(v))
        if kind in ("q0", "v0", "control"):
            unit[at] = by
        if kind in ("q0", "v0") and self.starts is not None:
            none = np.zeros(len(v))
            start = self.starts.near(*((unit, none) if kind == "q0" else (none, unit)))
            if start is None:
                return None
            q, v = start
        elif kind == "q0":
            q = np.asarray(pin.integrate(compiled.built.model, q, unit))
        elif kind == "v0":
            v = v + unit
        elif kind == "control":
            control = (np.zeros((self.steps, len(v))) if control is None else control) + unit
        else:
            compiled = self._with_coefficient(kind, by)
        return self._run(compiled, q, v, control)

    def _asked(self, column: int) -> tuple[str, int]:
        parts = self._exact.columns.items()
        return next((kind, column - part.start) for kind, part in parts if part.start <= column < part.stop)

    def _place(self, column: int) -> tuple[str, int]:
        """Return what is changed along a column and its number in that; "control:joint" is part of "control"."""
        kind, at = self._asked(column)
        word, _, joint = kind.partition(":")
        if word != "control" or not joint:
            return kind, at
        model = self._compiled.built.model
        return word, int(model.idx_vs[model.getJointId(joint)]) + at

    def _coefficients(self, kind: str) -> list[tuple[tuple[str, str], float]]:
        """Return (pair or joint and limit, value) of the coefficients that a column of this name changes."""
        word, _, pair = kind.partition(":")
        built = self._compiled.built
        found = built.coefficients(word)
        if not pair:
            found = [row for row in found if row[1] > 0.0]
        if word == "restitution":
            joints = [int(k) for k in np.flatnonzero(built.arrays.limits)]
            for k in joints:
                value = float(built.arrays.limit_restitution[k])
                found += [((self._compiled.joint_names[k], side), value) for side in LIMITS]
        if not pair:
            return found
        wanted = tuple(part.strip() for part in pair.split("|"))
        if len(wanted) == 1:
            return [row for row in found if row[0] in [(pair, side) for side in LIMITS]]
        return [row for row in found if wanted in (row[0], row[0][::-1])]

    def _with_coefficient(self, kind: str, by: float) -> CompiledScene:
        twin, word = self._scene.copy(), kind.partition(":")[0]
        for names, value in self._coefficients(kind):
            if names[1] in LIMITS:
                twin.set_joint(names[0], restitution=value + by)
            elif word == "restitution":
                twin.set_contact(*names, restitution=value + by)
            else:
                twin.set_contact(*names, friction=value + by)
        return compile_scene(twin).at_start(self._q)

    def _run(self, compiled: CompiledScene, q: Array, v: Array, control: Array | None) -> RunEnd | None:
        try:
            run = Run(compiled, self._settings, q, v, self._t)
            if run.refused is not None:
                return None
            status = run.advance(self.steps, control, self._target)
        except ContactviError:  # such a start is beyond a limit, or has no end
            return None
        if status.code == StatusCode.INTERRUPTED:
            raise KeyboardInterrupt
        if not status.ok:
            return None
        log = run.record.log()
        parts = [log.array(name) for name in ("kind", "index", "fallback", "points")] if len(log) else []
        sequence = (run.record.stats.halved, len(run.record.contact_log()), *(tuple(map(int, part)) for part in parts))
        if self._middle_q is None:
            self._middle_q = run.q
        moved = tangent(self._compiled.built.model, self._middle_q, run.q)
        times = np.array(log.array("time")) if len(log) else np.zeros(0)
        steps = tuple(map(int, log.array("step"))) if len(log) else ()
        return RunEnd(np.concatenate([moved, run.v]), times, sequence, steps)


def _located(traj: Trajectory) -> Array:
    """Return the error of the time of each impact [s]: that of its gap over its closing speed; 0 where none closes."""
    if not len(traj.events):
        return np.zeros(0)
    gap, speed = np.abs(traj.events.array("gap")), -traj.events.array("gamma_minus")
    errors: Array = np.zeros(len(gap))
    np.divide(np.maximum(gap, LOCATED), speed, out=errors, where=speed > 0.0)
    return errors
