"""The one-sided derivative of a run along a direction, also at kinks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.derivatives.constrained_starts import tangent
from contactvi.errors import ContactviError, InputError, NotDifferentiable
from contactvi.inputs import short
from contactvi.simulation.run import Run
from contactvi.text import fields_shown
from contactvi.trajectory.compiled import CompiledScene, compile_scene
from contactvi.trajectory.direction import EXACT, Direction, change_along
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]

ROUNDING = 1e-10  # of the states of two runs [m, rad, m/s]
SAME = 1e-6  # of the largest change: as near is the derivative of a side to that of both
# By which the inputs or the states change most in the nearby runs [m, rad, m/s, N, N m]: far above rounding, its square
# far below 1.
STEP = 1e-4
AGREES = 1e-4  # of the largest change: from differences of the runs, whose error is that of their steps over STEP


@dataclass(frozen=True)
class DirectionalDerivative:
    """The one-sided derivative of a run along a direction.

    Attributes:
        q, v: changes of the states at the nodes, tangent vectors at q [m, rad] and velocities, shape (N, nv) each.
        one_sided: whether it is that of this side only, as at a kink; else it is the exact one, of both sides.
        kink: the first kink that the exact derivative meets along the direction; None where it meets none.
        error: what halving the distance of the nearby runs changed the derivative by, relative; 0.0 where it is exact.
    """

    q: Array
    v: Array
    one_sided: bool
    kink: NotDifferentiable | None
    error: float

    __repr__ = fields_shown


def directional_derivative(traj: Trajectory, direction: Mapping[str, Any]) -> DirectionalDerivative:
    """Return the derivative of a run along a direction, to that side only: the limit of (run(x + h d) - run(x)) / h.

    Where the run is smooth along the direction this is the exact derivative. At a kink it is that of the side that the
    direction leads to: for a motion that is smooth on each side it is the limit of the derivatives of runs from
    x + h d, h > 0, along d. These runs are made, and decide themselves which contacts open, close, stick or slip there.
    Two of them, at a distance and half of it, are extrapolated. That they are on one side, and that this is the side of
    d, is checked: the result has to be their difference from the run over that distance. So it costs some three runs.

    Args:
        traj: a run with record="gradient".
        direction: a dict of arrays by name, of the shapes of a gradient: "q0" (nv,), "v0" (nv,), "control" (steps, nv),
            "target" and "target_velocity" (steps, servos).

    Raises:
        InputError: as Sensitivity; other names in the direction.
        NotDifferentiable: at a kink whose one-sided derivative does not follow from runs on that side: they jump, end
            before their time, or have a kink of their own that depends on it; with the pair, the time and the reason of
            the kink.

    Source: Scholtes, "Introduction to piecewise differentiable equations", 2012: directional derivatives of such maps.
    """
    if not isinstance(traj, Trajectory):
        raise InputError(
            "There is no derivative of this", name="traj", expected="a Trajectory", got=short(traj),
            remedy="Give the run that contactvi.simulate(..., record='gradient') has returned",
        )  # fmt: skip
    compiled = compile_scene(traj.scene).at_start(traj.q[0])
    along = Direction(traj, compiled, direction)
    for name in along.names:
        if name not in EXACT:
            raise InputError(
                "The direction of a one-sided derivative is one in starts and inputs", name="direction",
                expected=f"some of {EXACT}", got=name, remedy="Ask for Trajectory.sensitivity by parameters",
            )  # fmt: skip
    nv = compiled.states.nv
    exact, kink = _exact(traj, compiled, along)
    rough = _taken(traj, compiled, along) if exact is None else exact
    side = _Side(traj, compiled, direction)
    step = STEP / (max(side.largest(), float(np.abs(rough).max())) or 1.0)
    (far, far_difference), (near, near_difference) = side.at(step, kink), side.at(0.5 * step, kink)
    found, differences = 2.0 * near - far, 2.0 * near_difference - far_difference
    size = max(float(np.abs(found).max()), float(np.abs(differences).max())) or 1.0
    off, error = float(np.abs(found - differences).max()) / size, float(np.abs(near - far).max()) / size
    if not off <= AGREES + ROUNDING / (step * size):
        raise _no_side(kink, f"runs on that side whose derivative is off their difference by {off:.1g} of it")
    if exact is not None and float(np.abs(found - exact).max()) <= max(SAME, error) * size + ROUNDING / step:
        return DirectionalDerivative(exact[:, :nv], exact[:, nv:], False, None, 0.0)
    return DirectionalDerivative(found[:, :nv], found[:, nv:], True, kink, error)


def _exact(
    traj: Trajectory, compiled: CompiledScene, along: Direction
) -> tuple[Array | None, NotDifferentiable | None]:
    try:
        return change_along(traj, compiled, along, False), None
    except NotDifferentiable as kink:
        return None, kink


def _taken(traj: Trajectory, compiled: CompiledScene, along: Direction) -> Array:
    try:
        return change_along(traj, compiled, along, True)
    except NotDifferentiable:
        return np.zeros(1)


def _no_side(kink: NotDifferentiable | None, got: str) -> NotDifferentiable:
    reason, pair, time = (None, None, None) if kink is None else (kink.reason, kink.pair, kink.time)
    return NotDifferentiable(
        "The run has no one-sided derivative that follows from runs on that side", reason=reason, pair=pair, time=time,
        expected="nearby runs along the direction that are smooth", got=got,
        remedy="Take another direction; on_kink='taken' of Trajectory.sensitivity gives that of what the run did",
    )  # fmt: skip


class _Side:
    """Runs on the side of a direction."""

    def __init__(self, traj: Trajectory, compiled: CompiledScene, direction: Mapping[str, Any]) -> None:
        self._traj, self._compiled, self._direction = traj, compiled, direction
        assert traj.inputs is not None
        nv, steps = compiled.states.nv, traj.options.steps
        given = {name: np.asarray(values, dtype=float) for name, values in direction.items()}
        self._dq, self._dv = given.get("q0", np.zeros(nv)), given.get("v0", np.zeros(nv))
        self._forces = given.get("control", np.zeros((steps, nv)))
        self._targets = np.zeros((steps, 2 * nv))
        model = compiled.built.model
        servos = np.array([model.idx_vs[model.getJointId(joint)] for joint in compiled.built.servo_joints], dtype=int)
        for name, first in (("target", 0), ("target_velocity", nv)):
            if name in given:
                self._targets[:, first + servos] = given[name]

    def largest(self) -> float:
        """Return the largest number of the direction."""
        parts = (self._dq, self._dv, self._forces, self._targets)
        return max(float(np.abs(part).max(initial=0.0)) for part in parts)

    def at(self, step: float, kink: NotDifferentiable | None) -> tuple[Array, Array]:
        """Return the derivative of the run at a distance, and its difference from the run over it, (N, 2 nv) each."""
        traj, inputs = self._traj, self._traj.inputs
        assert inputs is not None
        control, target = inputs.control, inputs.target
        if self._forces.any():
            control = step * self._forces if control is None else control + step * self._forces
        if target is not None:
            target = target + step * self._targets
        model = self._compiled.built.model
        try:
            q = np.asarray(pin.integrate(model, np.array(traj.q[0]), step * self._dq))
            run = Run(self._compiled, replace(traj.options), q, traj.v[0] + step * self._dv, float(traj.t[0]))
            if run.refused is not None:
                raise _no_side(kink, f"a start that is refused: {run.refused}")
            if not run.advance(traj.options.steps, control, target).ok:
                raise _no_side(kink, "a run that ends before its time")
            side = run.trajectory()
            slope = change_along(side, self._compiled, Direction(side, self._compiled, self._direction), True)
        except NotDifferentiable:
            raise
        except ContactviError as error:
            raise _no_side(kink, f"no such run: {error}") from error
        moved = np.array([tangent(model, a, b) for a, b in zip(traj.q, side.q, strict=True)])
        return slope, np.hstack([moved, side.v - traj.v]) / step
