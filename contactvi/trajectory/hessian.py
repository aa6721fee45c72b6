"""Second derivatives of the cost of a run along a direction.

Exactly, by the derivative of the backward pass (core/sensitivity/run_hessian.hpp); or Gauss-Newton's part of it, the
second derivative of the cost between two first derivatives of the run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import ContactviError, DerivativeError, InputError, NotDifferentiable, did_you_mean
from contactvi.inputs import array, check_choice, check_signature, short
from contactvi.trajectory import parameters
from contactvi.trajectory.compiled import CompiledScene
from contactvi.trajectory.gradient import Cost, cost_gradients, gradient, number_of_steps
from contactvi.trajectory.sensitivity import (
    ON_KINK,
    Laws,
    Recorded,
    check_parameter,
    not_differentiable,
    recorded_run,
    wanted,
)

Array = NDArray[np.float64]
CostHessian = Callable[[Array, Array, Array, Array, Array], tuple[Any, Any]] | str

METHODS = ("exact", "gauss-newton", "auto")
EXACT = ("q0", "v0", "control", "target", "target_velocity")
GAINS = {"target": 0, "target_velocity": 1}  # rows of the servos' gains


@dataclass(frozen=True)
class HessianVector:
    """The second derivative H of the cost of a run times a direction w.

    Attributes:
        product: H w by name, of the shapes of a gradient.
        gradient: the gradient by name.
        value: the cost; None where only its gradients were given.
        approximate: why this is Gauss-Newton's approximation of H, None where it is H itself.
    """

    product: dict[str, Array]
    gradient: dict[str, Array]
    value: float | None
    approximate: ContactviError | str | None


def hessian_vector(
    traj: Recorded,
    compiled: CompiledScene,
    cost: Cost,
    w: Mapping[str, Any],
    wrt: Sequence[str] | str | None,
    *,
    hessp: CostHessian,
    method: str,
    on_kink: str,
) -> HessianVector:
    """Return H w; arguments as those of contactvi.hessian_vector, and the scene of the run."""
    check_choice("method", method, METHODS, "Unknown way to second derivatives")
    check_choice("on_kink", on_kink, ON_KINK, "Unknown answer to a kink")
    direction = _Direction(traj, compiled, w)
    names = direction.names if wrt is None else wanted(wrt)
    for name in names:
        direction.shape(name)
    second = _CostHessian(traj, compiled, hessp)
    if method == "gauss-newton":
        return _gauss_newton(traj, compiled, cost, direction, names, second, on_kink, "method='gauss-newton'")
    try:
        return _exact(traj, compiled, cost, direction, names, second)
    except NotDifferentiable as reason:
        if method == "exact" or reason.reason != "second":
            raise
        why: ContactviError = reason
    except DerivativeError as reason:
        if method == "exact":
            raise
        why = reason
    return _gauss_newton(traj, compiled, cost, direction, names, second, on_kink, why)


def _exact(
    traj: Recorded, compiled: CompiledScene, cost: Cost, direction: _Direction, names: Sequence[str],
    second: _CostHessian,
) -> HessianVector:  # fmt: skip
    check_exact(compiled, (*direction.names, *names))
    run = recorded_run(traj, compiled)
    value, lq, lv = cost_gradients(traj, compiled, cost)
    found = run.hessian(list(map(float, traj.t)), lq, lv, direction.exact(), second)
    if "fact" in found:
        raise not_differentiable(traj, found)
    product = {name: direction.rows(name, found["product"]) for name in names}
    return HessianVector(product, {name: direction.rows(name, found["gradient"]) for name in names}, value, None)


def check_exact(compiled: CompiledScene, names: Sequence[str]) -> None:
    """Raise for what has first derivatives alone."""
    for name in names:
        if name not in EXACT:
            raise NotDifferentiable(
                "Second derivatives in parameters and laws of contact are not known", reason="second",
                expected=f"directions and rows of {', '.join(EXACT)}", got=name,
                remedy="Use method='gauss-newton'",
            )  # fmt: skip
    found = compiled.built.elements
    for element in (*found.forces, *found.potentials):
        raise DerivativeError(
            "Functions of the user have no second derivatives of their forces", function=element.name,
            expected="forces of the scene's own elements", got=f"{element.name!r}, given in Python",
            remedy="Use method='gauss-newton', which needs their first derivatives alone",
        )  # fmt: skip
    for row in found.compliances:
        raise NotDifferentiable(
            "Forces of compliant pairs have no second derivatives that are known", reason="second",
            expected="rigid pairs", got=f"the compliant pair of {row.names[0]!r} and {row.names[1]!r}",
            remedy="Use method='gauss-newton', which needs their first derivatives alone",
        )  # fmt: skip


def _gauss_newton(
    traj: Recorded, compiled: CompiledScene, cost: Cost, direction: _Direction, names: Sequence[str],
    second: _CostHessian, on_kink: str, why: ContactviError | str,
) -> HessianVector:  # fmt: skip
    value, slope = gradient(traj, compiled, cost, names, on_kink=on_kink)
    run = recorded_run(traj, compiled)
    found = run.tangent(direction.engine(run), list(map(float, traj.t)), on_kink == "taken")
    if "fact" in found:
        raise not_differentiable(traj, found)
    moved = np.array(found["nodes"])[:, :, 0]
    nv = compiled.states.nv
    product = gradient(traj, compiled, second(moved[:, :nv], moved[:, nv:]), names, on_kink=on_kink)[1]
    return HessianVector(product, slope, value, why)


class _CostHessian:
    """The second derivative of the cost along changes of the states at the nodes."""

    def __init__(self, traj: Recorded, compiled: CompiledScene, hessp: CostHessian) -> None:
        self._linear = isinstance(hessp, str) and hessp == "linear"
        if not self._linear:
            if not callable(hessp):
                raise InputError(
                    "The cost has no second derivative", name="hessp", got=short(hessp),
                    expected="a function of (t, q, v, dq, dv), or 'linear'",
                    remedy="Give the derivative of (dJ/dq, dJ/dv) along (dq, dv)",
                )  # fmt: skip
            check_signature("hessp", hessp, ("t", "q", "v", "dq", "dv"))
        self._hessp: Any = hessp
        self._t, self._q = traj.t, traj.q
        self._v = np.asarray(compiled.core.velocity(traj.q, traj.p))

    def __call__(self, dq: Array, dv: Array) -> tuple[Array, Array]:
        if self._linear:
            return np.zeros_like(dq), np.zeros_like(dv)
        given = self._hessp(self._t, self._q, self._v, dq, dv)
        if not isinstance(given, tuple) or len(given) != 2:
            raise InputError(
                "This is no second derivative of a cost", name="hessp", expected="a pair of arrays (nodes, nv)",
                got=type(given).__name__, remedy="Return the changes of dJ/dq and dJ/dv along (dq, dv)",
            )  # fmt: skip
        what = "second derivatives at the nodes along (dq, dv)"
        return array("hessp[0]", given[0], dq.shape, what), array("hessp[1]", given[1], dv.shape, what)


class _Direction:
    """A direction by name, and the rows of results."""

    def __init__(self, traj: Recorded, compiled: CompiledScene, w: Mapping[str, Any]) -> None:
        if not isinstance(w, Mapping) or not w:
            raise InputError(
                "This is no direction", name="w", expected="a dict of arrays by name, as a gradient", got=short(w),
                remedy="For example w={'q0': dq, 'control': du}",
            )  # fmt: skip
        self.names = wanted(tuple(w))
        self._traj, self._compiled = traj, compiled
        model = compiled.built.model
        self._servos = [model.idx_vs[model.getJointId(joint)] for joint in compiled.built.servo_joints]
        self._gains = compiled.built.arrays.servo[:2]
        self._w = {name: array(f"w[{name!r}]", w[name], self.shape(name), "a direction") for name in self.names}

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of the part of a name; InputError where nothing has it."""
        nv, steps = self._compiled.states.nv, number_of_steps(self._traj)
        kind = name.partition(":")[0]
        if kind in ("restitution", "friction"):
            return (1,)
        if parameters.is_parameter(name):
            check_parameter(self._traj, name)
            return (len(parameters.directions_of(self._compiled.built.model, name)),)
        shapes: dict[str, tuple[int, ...]] = {"q0": (nv,), "v0": (nv,), "control": (steps, nv)}
        shapes |= dict.fromkeys(GAINS, (steps, len(self._servos)))
        if name not in shapes:
            known = (*EXACT, *parameters.CONTACT_NAMES, *parameters.NAMES)
            raise InputError(
                "Nothing of the run has this name", name="w", expected=f"some of {', '.join(known)}", got=name,
                remedy=did_you_mean(kind, known),
            )  # fmt: skip
        return shapes[name]

    def exact(self) -> dict[str, Array]:
        """Return the engine's direction in the start and the inputs: a reference of a servo acts as its torque."""
        nv = self._compiled.states.nv
        tau = np.zeros((number_of_steps(self._traj), nv))
        if "control" in self._w:
            tau += self._w["control"]
        for name, row in GAINS.items():
            if name in self._w:
                tau[:, self._servos] += self._gains[row, self._servos] * self._w[name]
        none = np.zeros(nv)
        return {"q": self._w.get("q0", none), "v": self._w.get("v0", none), "tau": tau}

    def engine(self, run: Any) -> dict[str, Any]:
        """Return the engine's direction of everything, as one column."""
        own = self.exact()
        found: dict[str, Any] = {"count": 1, "q": own["q"][:, None], "v": own["v"][:, None], "inputs": own["tau"]}
        laws = Laws(self._traj, run, self._compiled)
        sums: parameters.Direction = {}
        for name, values in self._w.items():
            kind, _, pair = name.partition(":")
            if kind in ("restitution", "friction"):
                entry = "e" if kind == "restitution" else "mu"
                found[entry] = found.get(entry, 0.0) + laws.column(entry, pair) * values[0]
            elif parameters.is_parameter(name):
                for part, number in zip(
                    parameters.directions_of(self._compiled.built.model, name), values, strict=True
                ):
                    for entry, numbers in part.items():
                        sums[entry] = sums.get(entry, np.zeros_like(numbers)) + number * numbers
        if sums:
            found["parameters"] = [sums]
        return found

    def rows(self, name: str, found: dict[str, Array]) -> Array:
        """Return the rows of a name from the engine's in the start and the inputs."""
        if name in ("q0", "v0"):
            return np.asarray(found[name[0]])
        tau = np.asarray(found["tau"])
        return tau if name == "control" else self._gains[GAINS[name], self._servos] * tau[:, self._servos]
