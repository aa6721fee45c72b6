"""The gradient of a cost of a run with respect to its start, all its inputs and its parameters.

It goes backward through the run once (core/sensitivity/run_adjoint.hpp), so that its price does not depend on how many
numbers the gradient has.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import ApproximateDerivativeWarning, InputError
from contactvi.inputs import array, check_signature, real, real_numbers
from contactvi.keywords import meant
from contactvi.trajectory import parameters
from contactvi.trajectory.compiled import CompiledScene
from contactvi.trajectory.polynomials import Segments
from contactvi.trajectory.sensitivity import (
    DenseStepSensitivity,
    Laws,
    Recorded,
    check_on_kink,
    check_parameter,
    dense_report,
    not_differentiable,
    recorded_run,
    wanted,
)

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]
Cost = Callable[[Array, Array, Array], tuple[float, Array, Array]] | tuple[Any, Any]

OF_THE_RUN = ("q0", "v0", "control", "target", "target_velocity")
OF_PAIRS = ("restitution", "friction")


def gradient(
    traj: Recorded, compiled: CompiledScene, cost: Cost, wrt: Sequence[str] | str, *, on_kink: str = "raise"
) -> tuple[float | None, dict[str, Array]]:
    """Return (J, gradients by name); arguments as those of contactvi.gradient, and the scene of the run."""
    gradients = RunGradients(traj, compiled, wrt, on_kink)
    value, lq, lv = cost_gradients(traj, compiled, cost)
    gradients.warn(stacklevel=4)
    return value, gradients.of(lq, lv)


class RunGradients:
    """The gradients of costs of one run with respect to some names, one pass backward for each cost.

    Args as those of contactvi.gradient, and the scene of the run.
    """

    def __init__(self, traj: Recorded, compiled: CompiledScene, wrt: Sequence[str] | str, on_kink: str) -> None:
        check_on_kink(on_kink)
        self._traj, self._taken, names = traj, on_kink == "taken", wanted(wrt)
        self._run = recorded_run(traj, compiled)
        laws = Laws(traj, self._run, compiled)
        self._picks = [_Pick(traj, compiled, laws, name) for name in names]
        self._approximate = _check_direction(traj, self._run, compiled, names, self._taken)

    def of(self, lq: Array, lv: Array) -> dict[str, Array]:
        """Return the gradient by name of a cost with gradients (N, nv) in q and v at the nodes."""
        traj = self._traj
        found = self._run.adjoint(list(map(float, traj.t)), lq, lv, np.zeros(0), number_of_steps(traj), self._taken)
        if "fact" in found:
            raise not_differentiable(traj, found)
        return {pick.name: pick.of(found) for pick in self._picks}

    def warn(self, stacklevel: int) -> None:
        """Warn where the run has dense steps whose derivative is approximate."""
        steps = self._approximate
        if steps:
            warnings.warn(
                f"The gradient is approximate: {len(steps)} dense steps, the first at t = {steps[0].time:.9g} s"
                f" ({steps[0].reason}). Trajectory.sensitivity(...).report has them all",
                ApproximateDerivativeWarning,
                stacklevel=stacklevel + 1,
            )


def number_of_steps(traj: Recorded) -> int:
    """Return the number of control steps, the last one perhaps cut."""
    return max(1, round((float(traj.t[-1]) - float(traj.t[0])) / traj.options.fixed_dt + 0.499))


def _check_direction(
    traj: Recorded, run: _core.RecordedRun, compiled: CompiledScene, names: Sequence[str], taken: bool
) -> list[DenseStepSensitivity]:
    """Raise NotDifferentiable for a run that has a derivative along some directions and not along others.

    Where points are hit together or share a load, that is so along directions that keep them together. What holds along
    a random one of those asked for holds along all, with probability one. Returns the dense steps whose derivative is
    approximate.
    """
    assert isinstance(traj.segments, Segments)
    several = len(traj.events) and int(traj.events.array("points").max()) > 1
    if not several and not np.any(traj.segments.arrays["persistent"]):
        return []
    rng = np.random.default_rng(0)
    entries = {"q0": "q", "v0": "v", "control": "tau", "target": "tau", "target_velocity": "tau"}
    asked = {entries[name] for name in names if name in entries} or {"tau"}
    direction: dict[str, Any] = {entry: rng.standard_normal((compiled.states.nv, 1)) for entry in sorted(asked)}
    mixed: parameters.Direction = {}
    for name in filter(parameters.is_parameter, names):
        for part in parameters.directions_of(compiled.built.model, name):
            for entry, values in part.items():
                mixed[entry] = mixed.get(entry, np.zeros_like(values)) + rng.standard_normal() * values
    if mixed:
        direction["parameters"] = [mixed]
    found = run.tangent({"count": 1, **direction}, [float(traj.t[-1])], taken)
    if "fact" in found:
        raise not_differentiable(traj, found)
    return [step for step in dense_report(found) if step.reason]


def cost_gradients(traj: Recorded, compiled: CompiledScene, cost: Cost) -> tuple[float | None, Array, Array]:
    """Return the cost and its gradients in q (tangent) and v at the nodes, shapes (N, nv)."""
    nodes, nv = len(traj.t), compiled.states.nv
    value: float | None = None
    if callable(cost):
        check_signature("cost", cost, ("t", "q", "v"))
        v = np.asarray(compiled.core.velocity(traj.q, traj.p))
        given = cost(traj.t, traj.q, v)
        if not isinstance(given, tuple) or len(given) != 3:
            raise _bad_cost("(J, dJ/dq, dJ/dv) from the function", given)
        value, rest = real("J", given[0]), given[1:]
    else:
        if not isinstance(cost, tuple) or len(cost) != 2:
            raise _bad_cost("a function of (t, q, v), or the pair (dJ/dq, dJ/dv)", cost)
        rest = cost
    return value, _at_nodes("dJ/dq", rest[0], nodes, nv), _at_nodes("dJ/dv", rest[1], nodes, nv)


def _bad_cost(expected: str, got: object) -> InputError:
    return InputError(
        "This is no cost of a run", name="cost", expected=expected, got=type(got).__name__,
        remedy="Gradients are arrays of shape (nodes, nv), or (nv,) for the last node",
    )  # fmt: skip


def _at_nodes(name: str, part: Any, nodes: int, nv: int) -> Array:
    numbers = real_numbers(part)
    if numbers is not None and numbers.ndim == 1:
        rows = np.zeros((nodes, nv))
        rows[-1] = array(name, part, (nv,), "the gradient at the last node")
        return rows
    return array(name, part, (nodes, nv), "gradients at the nodes, tangent vectors of Pinocchio")


class _Pick:
    """One name of what a gradient is with respect to."""

    def __init__(self, traj: Recorded, compiled: CompiledScene, laws: Laws, name: str) -> None:
        self.name = str(name)
        model = compiled.built.model
        kind, _, pair = self.name.partition(":")
        check_parameter(traj, self.name)
        self._entry = {"q0": "q", "v0": "v", "control": "tau", "target": "q_ref", "target_velocity": "v_ref"}.get(
            self.name
        )
        self._rows: Array | None = None
        self._directions: list[parameters.Direction] = []
        self._servos = [model.idx_vs[model.getJointId(joint)] for joint in compiled.built.servo_joints]
        if kind in OF_PAIRS:
            self._entry = "e" if kind == "restitution" else "mu"
            self._rows = laws.column(self._entry, pair)
        elif parameters.is_parameter(self.name):
            self._directions = parameters.directions_of(model, self.name)
        elif self._entry is None:
            known = (*OF_THE_RUN, *parameters.CONTACT_NAMES, *parameters.NAMES)
            raise InputError(
                "Nothing of the run has this name", name="wrt", expected=f"one of {', '.join(known)}", got=name,
                remedy=meant(kind, known),
            )  # fmt: skip

    def of(self, found: dict[str, Any]) -> Array:
        """Return its part of what the engine found."""
        if self._entry is None:
            return np.array([parameters.along(found["parameters"], direction) for direction in self._directions])
        values = np.asarray(found[self._entry])
        if self._rows is not None:
            return np.asarray(self._rows.T @ values)
        return values[:, self._servos] if self._entry in ("q_ref", "v_ref") else values
