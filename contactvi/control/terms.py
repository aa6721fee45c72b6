"""The terms of a problem: costs of the run, of the inputs and of parameters, and constraints, with their gradients."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import InputError
from contactvi.inputs import array, check_signature, real, real_numbers, short
from contactvi.trajectory.compiled import CompiledScene
from contactvi.trajectory.gradient import Cost, cost_gradients
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]
InputCost = Callable[[Array], tuple[float, ArrayLike]]
ParameterCost = Callable[[dict[str, Array]], tuple[float, Mapping[str, ArrayLike]]]


@dataclass(frozen=True)
class Constraint:
    """Numbers of a run that have to lie between bounds; equal bounds make an equality.

    Args:
        function: of the nodes (t (N,), q (N, nq), v (N, nv)), returns (c (m,), dc/dq, dc/dv): gradients dual to
            tangent vectors, of shape (m, N, nv), or (m, nv) for what depends on the last node alone. One pass backward
            through the run is made for each of the m numbers.
        lower, upper: numbers or arrays (m,), infinite for none.
        name: for messages.
    """

    function: Callable[[Array, Array, Array], tuple[ArrayLike, ArrayLike, ArrayLike]]
    lower: ArrayLike = 0.0
    upper: ArrayLike = 0.0
    name: str = "constraint"

    def __post_init__(self) -> None:
        check_signature(f"the function of {self.name!r}", self.function, ("t", "q", "v"))
        low, high = real_numbers(self.lower), real_numbers(self.upper)
        if low is None or high is None or np.any(np.isnan(low)) or np.any(np.isnan(high)) or np.any(low > high):
            raise InputError(
                f"The bounds of {self.name!r} leave nothing", name="lower", expected="numbers, lower <= upper",
                got=f"{short(self.lower)}, {short(self.upper)}", remedy="Give the smaller one first",
            )  # fmt: skip

    def bounds(self, rows: int) -> tuple[Array, Array]:
        """Return the bounds of its numbers, (rows,) each."""
        ends = []
        for side, value in (("lower", self.lower), ("upper", self.upper)):
            if np.shape(value) not in ((), (rows,)):
                raise InputError(
                    f"The bounds of {self.name!r} do not fit", name=side, expected=f"a number, or shape ({rows},)",
                    got=f"shape {np.shape(value)}", remedy="Give one for each number that the function returns",
                )  # fmt: skip
            ends.append(np.broadcast_to(np.asarray(value, dtype=float), (rows,)).copy())
        return ends[0], ends[1]


class Quadratic:
    """The cost 1/2 sum w (u - r)^2 of inputs, with w and r that fit to u (rows, nu); made by `quadratic`."""

    def __init__(self, weights: Array, reference: Array) -> None:
        self.weights, self.reference = weights, reference

    def __call__(self, u: Array) -> tuple[float, Array]:
        """Return the cost and its gradient."""
        off = u - self.reference
        weighted = np.asarray(self.weights * off)
        return 0.5 * float(np.sum(weighted * off)), weighted

    def hessp(self, u: Array, du: Array) -> Array:
        """Return the change of the gradient along du."""
        return np.asarray(self.weights * du)


def quadratic(weights: ArrayLike, reference: ArrayLike = 0.0) -> Quadratic:
    """Return the cost 1/2 sum w (u - r)^2 of inputs u (intervals, nu), for `Problem(input_cost=...)`.

    Args:
        weights: w >= 0, a number, (nu,) or (intervals, nu). For 1/2 r int u^2 dt it is r times the length of an
            interval.
        reference: r, likewise.
    """
    w, r = real_numbers(weights), real_numbers(reference)
    if w is None or r is None or not np.all(np.isfinite(w)) or not np.all(np.isfinite(r)) or np.any(w < 0.0):
        raise InputError(
            "This is no quadratic cost", name="weights", expected="finite numbers, weights >= 0",
            got=f"{short(weights)}, {short(reference)}", remedy="For example quadratic(1e-3)",
        )  # fmt: skip
    return Quadratic(w, r)


@dataclass(frozen=True)
class TermValues:
    """The terms at one run.

    Attributes:
        cost: the sum. nodes: gradients of the run's own cost in q and v at the nodes, None without one.
        direct: gradients by blocks of the variables. constraints: numbers (m,). rows: their gradients at the nodes.
        lower, upper: bounds (m,).
    """

    cost: float
    nodes: tuple[Array, Array] | None
    direct: dict[str, Array]
    constraints: Array
    rows: list[tuple[Array, Array]]
    lower: Array
    upper: Array


@dataclass(frozen=True)
class Terms:
    """The cost and the constraints of a problem, as given."""

    cost: Cost | None
    input_cost: InputCost | None
    parameter_cost: ParameterCost | None
    constraints: Sequence[Constraint]

    def at(self, traj: Trajectory, compiled: CompiledScene, values: Mapping[str, Array]) -> TermValues:
        """Return the terms at a run with these values of the variables by block."""
        total, nodes, direct = 0.0, None, {}
        if self.cost is not None:
            value, lq, lv = cost_gradients(traj, compiled, self.cost)
            total, nodes = float(value or 0.0), (lq, lv)
        if self.input_cost is not None:
            own, slope = _pair("input_cost", self.input_cost(values["inputs"].copy()))
            total += real("J of input_cost", own)
            direct["inputs"] = array("dJ/du", slope, values["inputs"].shape, "the gradient of input_cost")
        if self.parameter_cost is not None:
            chosen = {name: value.copy() for name, value in values.items() if name not in ("inputs", "q0", "v0")}
            own, slopes = _pair("parameter_cost", self.parameter_cost(chosen))
            total += real("J of parameter_cost", own)
            direct |= _by_name(slopes, chosen)
        found = [_rows_of(constraint, traj, compiled) for constraint in self.constraints]
        bounds = [c.bounds(len(row[0])) for c, row in zip(self.constraints, found, strict=True)]
        none = np.zeros(0)
        return TermValues(
            total, nodes, direct, np.concatenate([none, *(row[0] for row in found)]),
            [pair for row in found for pair in zip(row[1], row[2], strict=True)],
            np.concatenate([none, *(low for low, _ in bounds)]), np.concatenate([none, *(high for _, high in bounds)]),
        )  # fmt: skip


def _pair(name: str, given: Any) -> tuple[Any, Any]:
    if not isinstance(given, tuple) or len(given) != 2:
        raise InputError(
            f"{name} returned no cost", name=name, expected="a pair (J, gradient)", got=short(given),
            remedy="Return the cost and its gradient: return J, dJ",
        )  # fmt: skip
    return given


def _by_name(slopes: Any, values: Mapping[str, Array]) -> dict[str, Array]:
    """Return gradients by parameter; those that are not given are zero."""
    if not isinstance(slopes, Mapping) or not set(slopes) <= set(values):
        raise InputError(
            "The gradient of parameter_cost is by name", name="parameter_cost",
            expected=f"a dict with some of {', '.join(values) or 'no parameters'}", got=short(slopes),
            remedy="Return J, {name: dJ/dvalue}",
        )  # fmt: skip
    return {
        name: array(f"dJ/d{name}", np.atleast_1d(slope), values[name].shape, "the gradient of parameter_cost")
        for name, slope in slopes.items()
    }


def _rows_of(constraint: Constraint, traj: Trajectory, compiled: CompiledScene) -> tuple[Array, Array, Array]:
    """Return the numbers (m,) of a constraint and their gradients at the nodes, (m, N, nv) each."""
    given = constraint.function(traj.t, traj.q, traj.v)
    if not isinstance(given, tuple) or len(given) != 3:
        raise InputError(
            f"The function of {constraint.name!r} returned no constraint", name=constraint.name,
            expected="(c, dc/dq, dc/dv)", got=short(given), remedy="Return the numbers and both gradients",
        )  # fmt: skip
    numbers = real_numbers(given[0])
    rows = len(numbers) if numbers is not None and numbers.ndim == 1 else 1
    c = array(f"c of {constraint.name!r}", np.atleast_1d(given[0]), (rows,), "numbers")
    shape = (rows, len(traj.t), compiled.states.nv)
    return c, _at_nodes(constraint, "dc/dq", given[1], shape), _at_nodes(constraint, "dc/dv", given[2], shape)


def _at_nodes(constraint: Constraint, name: str, part: Any, shape: tuple[int, int, int]) -> Array:
    numbers, what = real_numbers(part), f"{name} of {constraint.name!r}"
    if numbers is not None and numbers.ndim == 2:
        found = np.zeros(shape)
        found[:, -1] = array(what, part, (shape[0], shape[2]), "gradients at the last node")
        return found
    return array(what, part, shape, "gradients at the nodes, or of shape (m, nv) at the last one")
