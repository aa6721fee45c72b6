"""A problem for scipy.optimize.minimize."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from contactvi.control.evaluation import Evaluation, Failure, Solvable
from contactvi.control.variables import checked_point
from contactvi.errors import ContactviError, InputError
from contactvi.inputs import check_choice, mapping

Array = NDArray[np.float64]

ON_FAILURE = ("raise", "infinite")
# What the methods take. All need gradients, and none makes differences of its own.
BOUNDED = ("L-BFGS-B", "TNC", "SLSQP", "trust-constr")
CONSTRAINED = ("SLSQP", "trust-constr")
BY_HESSIAN = ("trust-ncg", "trust-krylov", "Newton-CG", "trust-constr")
METHODS = ("L-BFGS-B", "BFGS", "CG", "TNC", "SLSQP", "trust-constr", "trust-ncg", "trust-krylov", "Newton-CG")
# Those that step back from an infinite cost (tests/control/test_solvers.py). L-BFGS-B says there that it has converged.
BACK_FROM_INFINITY = ("SLSQP", "trust-constr", "BFGS", "CG", "trust-ncg", "trust-krylov", "Newton-CG")


def minimize(problem: Solvable, z0: Any, method: str | None, *, on_failure: str, **options: Any) -> Any:
    """Return scipy's result for a problem.

    Args:
        problem: the problem. z0: where to begin (n,); None: problem.z0.
        method: of scipy.optimize.minimize, one that uses gradients: "trust-constr" or "SLSQP" with constraints, these,
            "L-BFGS-B" or "TNC" with bounds, or "BFGS", "CG", "trust-ncg", "trust-krylov", "Newton-CG". None:
            "trust-constr" with constraints or on_failure="infinite", else "L-BFGS-B". Second derivatives are used by
            the last three, which need them, and by "trust-constr" where the problem has them (`hessp`) and no
            constraint.
        on_failure: what a point is at which the run or its derivative fails: "raise": the error comes through;
            "infinite": its cost is infinite, from which the methods of `BACK_FROM_INFINITY` step back, and it stands in
            `failures`. At z0 it is raised in any case.
        options: `tol`, and options of the method: maxiter=..., ...; or as scipy takes them: options={"maxiter": ...}.

    Returns:
        scipy's OptimizeResult, and in it `trajectory`, the run at its x; `evaluations`, how many runs were made;
        `history`, the cost after each iteration, the one at z0 first; `failures`, a list of `Failure`.

    Raises:
        InputError: a method that does not take the bounds or the constraints, or needs what the problem has not; an
            option that the method does not have.
    """
    check_choice("on_failure", on_failure, ON_FAILURE, "Unknown answer to a failure")
    start = problem.z0 if z0 is None else checked_point(problem.variables, z0)
    first, runs = problem.evaluate(start), problem.runs
    chosen = _method(problem, first, method, on_failure)
    calls = _Calls(problem, first, on_failure == "infinite")
    tol = options.pop("tol", None)
    options = {**mapping("options", options.pop("options", {}), "option: value"), **options}
    bounded = bool(np.any(np.isfinite(problem.lower)) or np.any(np.isfinite(problem.upper)))
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "Unknown solver options", optimize.OptimizeWarning)
        try:
            result = optimize.minimize(
                calls.cost, start, method=chosen, jac=calls.gradient, tol=tol, callback=calls.iteration,
                options=options, bounds=optimize.Bounds(problem.lower, problem.upper) if bounded else None,
                constraints=_constraints(first, calls, chosen), **_second(problem, first, chosen),
            )  # fmt: skip
        except optimize.OptimizeWarning as unknown:
            raise InputError(
                f"{chosen} does not have these options", name="options", expected=f"options of scipy's {chosen}",
                got=str(unknown).rpartition(": ")[2],
                remedy=f"scipy.optimize.show_options('minimize', {chosen!r}) lists them",
            ) from None  # fmt: skip
    result.trajectory = problem.evaluate(result.x).trajectory
    result.evaluations, result.history, result.failures = problem.runs - runs + 1, calls.history, calls.failures
    return result


class _Calls:
    """What scipy calls: values and derivatives at points, of which each is run once.

    Attributes:
        history: costs after iterations. failures: points without run or derivative.
    """

    def __init__(self, problem: Solvable, first: Evaluation, infinite: bool) -> None:
        self._problem, self._infinite = problem, infinite
        self._costs = {first.z.tobytes(): first.cost}
        self._good = first
        self.history = [first.cost]
        self.failures: list[Failure] = []
        self._failed: Array | None = None

    def cost(self, z: Array) -> float:
        at = self._at(z)
        return np.inf if at is None else at.cost

    def gradient(self, z: Array) -> Array:
        at = self._at(z)
        return np.zeros(len(z)) if at is None else at.gradient

    def constraints(self, z: Array) -> Array:
        """Return the constraints; where there is no run those of the last one: the cost is what refuses the point."""
        at = self._at(z)
        return self._good.constraints if at is None else at.constraints

    def jacobian(self, z: Array) -> Array:
        at = self._at(z)
        return self._good.jacobian if at is None else at.jacobian

    def iteration(self, z: Array, *_state: Any) -> None:
        known = self._costs.get(np.asarray(z, dtype=float).tobytes())
        self.history.append(self.cost(z) if known is None else known)

    def _at(self, z: Array) -> Evaluation | None:
        if not self._infinite:
            return self._kept(self._problem.evaluate(z))
        if self._failed is not None and np.array_equal(self._failed, z):
            return None
        try:
            at = self._problem.evaluate(z)
            at.gradient, at.jacobian  # noqa: B018  (a point whose derivative fails has to have an infinite cost)
        except ContactviError as error:
            self._failed = np.array(z)
            self.failures.append(Failure(self._failed, error))
            return None
        return self._kept(at)

    def _kept(self, at: Evaluation) -> Evaluation:
        self._costs[at.z.tobytes()], self._good = at.cost, at
        return at


def _method(problem: Solvable, first: Evaluation, method: str | None, on_failure: str) -> str:
    """Return the method, after a check that it takes the problem."""
    constrained = len(first.constraints) > 0
    if method is None:
        return "trust-constr" if constrained or on_failure == "infinite" else "L-BFGS-B"
    check_choice("method", method, METHODS, "Unknown method, or one that does not use gradients")
    bounded = bool(np.any(np.isfinite(problem.lower)) or np.any(np.isfinite(problem.upper)))
    for there, able, what in ((constrained, CONSTRAINED, "constraints"), (bounded, BOUNDED, "bounds")):
        if there and method not in able:
            raise InputError(
                f"{method} takes no {what}", name="method", expected=" | ".join(able), got=repr(method),
                remedy=f"Use {able[0]}, or take the {what} out",
            )  # fmt: skip
    if on_failure == "infinite" and method not in BACK_FROM_INFINITY:
        raise InputError(
            f"{method} does not step back from an infinite cost", name="on_failure",
            expected=f"'raise', or one of {', '.join(BACK_FROM_INFINITY)}", got=f"'infinite' with {method}",
            remedy="Use 'SLSQP' or 'trust-constr', or IPOPT: problem.nlp()",
        )  # fmt: skip
    if method in BY_HESSIAN and method != "trust-constr":
        problem.check_second()
    return method


def _second(problem: Solvable, first: Evaluation, method: str) -> dict[str, Any]:
    """Return the Hessian's product for methods that use it."""
    if method not in BY_HESSIAN or len(first.constraints) or problem.second_missing() is not None:
        return {}
    return {"hessp": problem.hessian_product}


def _constraints(first: Evaluation, calls: _Calls, method: str) -> Any:
    """Return the constraints in the form that the method takes."""
    if not len(first.constraints):
        return ()
    lower, upper = first.lower, first.upper
    if method == "trust-constr":
        return optimize.NonlinearConstraint(calls.constraints, lower, upper, jac=calls.jacobian, hess=optimize.BFGS())
    equal = lower == upper
    rows: list[tuple[str, NDArray[np.bool_], Array, float]] = [
        ("eq", equal, lower, 1.0), ("ineq", ~equal & np.isfinite(lower), lower, 1.0),
        ("ineq", ~equal & np.isfinite(upper), upper, -1.0),
    ]  # fmt: skip
    return [_rows(calls, *row) for row in rows if row[1].any()]


def _rows(calls: _Calls, kind: str, chosen: NDArray[np.bool_], bound: Array, sign: float) -> dict[str, Any]:
    return {
        "type": kind,
        "fun": lambda z: sign * (calls.constraints(z) - bound)[chosen],
        "jac": lambda z: sign * calls.jacobian(z)[chosen],
    }
