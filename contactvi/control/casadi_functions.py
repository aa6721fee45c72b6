"""A problem for CasADi's solvers of nonlinear programmes, IPOPT among them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.control.evaluation import Evaluation, Failure, Solvable
from contactvi.control.variables import checked_point
from contactvi.errors import ContactviError, missing_package

try:
    import casadi
except ImportError as _error:
    raise missing_package("CasADi", "casadi") from _error

Array = NDArray[np.float64]
# Second derivatives of constraints are not known. The six steps of memory of IPOPT's default are few where inputs cost
# little beside what the run costs: the curvatures are very different.
LIMITED_MEMORY = {"ipopt.hessian_approximation": "limited-memory", "ipopt.limited_memory_max_history": 30}


class CasadiProblem:
    """A problem as CasADi takes it: `casadi.nlpsol("solver", "ipopt", p.nlp, p.options)(**p.start)`.

    Points whose run fails are evaluations that fail: IPOPT cuts its step there. They stand in `failures`. It must live
    as long as the solver that was made of it.

    Args:
        problem: the problem. z0: where to begin (n,); None: problem.z0. It is run once.

    Attributes:
        nlp: {"x", "f", "g"}, MX. start: {"x0", "lbx", "ubx", "lbg", "ubg"}, arguments of the solver.
        options: IPOPT's limited-memory Hessian, of 30 steps.
        failures: list of `Failure`. costs: of all points that were run, in order.
        interrupted: whether Ctrl-C came; the solver ends then, and `solve` raises KeyboardInterrupt.
    """

    def __init__(self, problem: Solvable, z0: Any = None) -> None:
        self.problem = problem
        start = problem.z0 if z0 is None else checked_point(problem.variables, z0)
        first = problem.evaluate(start)
        self.failures: list[Failure] = []
        self.costs: list[float] = []
        self.interrupted = False
        self._failed: Array | None = None
        self._function = _values(self, len(start), len(first.constraints))
        x = casadi.MX.sym("x", len(start))
        f, g = self._function(x)
        self.nlp: dict[str, Any] = {"x": x, "f": f, "g": g}
        bounds = {"lbx": problem.lower, "ubx": problem.upper, "lbg": first.lower, "ubg": first.upper}
        self.start: dict[str, Array] = {"x0": start} | bounds
        self.options: dict[str, Any] = dict(LIMITED_MEMORY)

    def solve(self, solver: str = "ipopt", **options: Any) -> dict[str, Any]:
        """Return the solver's result (x, f, g, lam_x, lam_g), with `stats`, `evaluation` at x and `evaluations`.

        Args:
            solver: a plugin of casadi.nlpsol. options: its options, with "_" in the place of the first ".":
                ipopt_max_iter=100, ipopt_tol=1e-6, ipopt_print_level=0, print_time=False, ...

        Raises:
            KeyboardInterrupt: Ctrl-C. SimulationError, ...: the run at the result fails.
        """
        given = {name.replace(f"{solver}_", f"{solver}.", 1): value for name, value in options.items()}
        known = self.options if solver == "ipopt" else {}
        runs = self.problem.runs
        made = casadi.nlpsol("solver", solver, self.nlp, {**known, **given})
        found = {name: np.array(value).ravel() for name, value in made(**self.start).items()}
        if self.interrupted:
            raise KeyboardInterrupt
        return found | {
            "stats": made.stats(), "evaluation": self.problem.evaluate(found["x"]),
            "evaluations": self.problem.runs - runs,
        }  # fmt: skip

    def at(self, z: Array) -> Evaluation:
        """Return the problem at a point, for the functions of the solver; keeps what fails, and Ctrl-C."""
        if self.interrupted:
            raise KeyboardInterrupt
        try:
            before = self.problem.runs
            at = self.problem.evaluate(z)
            if self.problem.runs > before:
                self.costs.append(at.cost)
            return at
        except KeyboardInterrupt:
            self.interrupted = True
            raise
        except ContactviError as error:
            self.keep(z, error)
            raise

    def keep(self, z: Array, error: ContactviError) -> None:
        """Keep a failure, once for each point."""
        if self._failed is None or not np.array_equal(self._failed, z):
            self._failed = z.copy()
            self.failures.append(Failure(self._failed, error))


class _Function(casadi.Callback):
    """A function of z that CasADi calls: `parts` of an evaluation, with the `shapes` of its inputs and outputs."""

    def __init__(
        self, owner: CasadiProblem, parts: Callable[[Evaluation], list[Any]], name: str,
        shapes: tuple[list[Any], list[Any]], options: Any,
    ) -> None:  # fmt: skip
        casadi.Callback.__init__(self)
        self.owner, self.parts, self.shapes = owner, parts, shapes
        self.construct(name, options)

    def get_n_in(self) -> int:
        return len(self.shapes[0])

    def get_n_out(self) -> int:
        return len(self.shapes[1])

    def get_sparsity_in(self, i: int) -> Any:
        return casadi.Sparsity.dense(*self.shapes[0][i])

    def get_sparsity_out(self, i: int) -> Any:
        return casadi.Sparsity.dense(*self.shapes[1][i])

    def eval(self, arguments: Any) -> list[Any]:
        """Return the outputs; not-a-number where there is no run, which CasADi takes for an evaluation that failed."""
        z = np.array(arguments[0], dtype=float).ravel()
        try:
            return [casadi.DM(part) for part in self.parts(self.owner.at(z))]
        except ContactviError as error:
            self.owner.keep(z, error)
            return [casadi.DM(np.full(shape, np.nan)) for shape in self.shapes[1]]


class _Values(_Function):
    """Cost and constraints."""

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(self, name: str, inames: Any, onames: Any, options: Any) -> Any:
        (n, _), (m, _) = self.shapes[0][0], self.shapes[1][1]
        shapes: tuple[list[Any], list[Any]] = ([(n, 1), (1, 1), (m, 1)], [(1, n), (m, n)])
        self.derivative = _Function(self.owner, lambda at: [at.gradient[None], at.jacobian], name, shapes, options)
        return self.derivative


def _values(owner: CasadiProblem, n: int, m: int) -> _Values:
    def parts(at: Evaluation) -> list[Any]:
        at.gradient, at.jacobian  # noqa: B018  (solvers step back from values that fail, and end at derivatives)
        return [at.cost, at.constraints.reshape(m, 1)]

    return _Values(owner, parts, "run", ([(n, 1)], [(1, 1), (m, 1)]), {})
