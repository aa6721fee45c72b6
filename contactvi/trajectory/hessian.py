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

from contactvi.errors import ContactviError, DerivativeError, InputError, NotDifferentiable
from contactvi.inputs import array, check_choice, check_signature, short
from contactvi.text import fields_shown
from contactvi.trajectory.compiled import CompiledScene
from contactvi.trajectory.direction import EXACT, Direction, change_along
from contactvi.trajectory.gradient import Cost, cost_gradients, gradient
from contactvi.trajectory.sensitivity import (
    Recorded,
    check_on_kink,
    not_differentiable,
    recorded_run,
    wanted,
)

Array = NDArray[np.float64]
CostHessian = Callable[[Array, Array, Array, Array, Array], tuple[Any, Any]] | str

METHODS = ("exact", "gauss-newton", "auto")


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

    __repr__ = fields_shown


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
    check_on_kink(on_kink)
    direction = Direction(traj, compiled, w)
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
    traj: Recorded, compiled: CompiledScene, cost: Cost, direction: Direction, names: Sequence[str],
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
    traj: Recorded, compiled: CompiledScene, cost: Cost, direction: Direction, names: Sequence[str],
    second: _CostHessian, on_kink: str, why: ContactviError | str,
) -> HessianVector:  # fmt: skip
    value, slope = gradient(traj, compiled, cost, names, on_kink=on_kink)
    moved = change_along(traj, compiled, direction, on_kink == "taken")
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
