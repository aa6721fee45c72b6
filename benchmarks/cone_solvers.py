"""contactvi's cone solver beside Pinocchio's ADMM on the same Coulomb problems: reached, iterations, microseconds.

    python benchmarks/cone_solvers.py [--count 200]

A problem is solved to 1e-12 if the natural map, evaluated here in NumPy and relative to the terms of each contact's
velocity, is below that, whatever the solver reports. Cold: started from nothing. Warm: from the solution of the same
problem with impulses of 1 % of the largest added at random, as from one step to the next. Times are of the C++ call
(Pinocchio's own timer, ours in a loop in C++), the fastest of a few; medians over the problems.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from contactvi import _core

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.cone_problems import PLAIN, Problem

SOLVED = 1e-12
REPEATS = 3


class Solved(NamedTuple):
    residual: float
    iterations: int
    microseconds: float


def natural_residual(p: Problem, lam: np.ndarray) -> float:
    """Largest error of the natural map [m/s] of a contact over the terms of its velocity; (n, t1, t2) only."""
    w = p.b + p.G @ lam
    terms = (np.abs(p.b) + np.abs(p.G) @ np.abs(lam)).reshape(-1, 3).max(axis=1)
    scale = np.diag(p.G).reshape(-1, 3).max(axis=1)
    z = (lam - w / np.repeat(scale, 3)).reshape(-1, 3)
    nearest = z.copy()
    nearest[:, 0] = np.maximum(z[:, 0], 0.0)
    length = np.linalg.norm(z[:, 1:], axis=1)
    radius = p.mu * nearest[:, 0]
    nearest[:, 1:] *= np.where(length > radius, radius / np.maximum(length, 1e-300), 1.0)[:, None]
    error = np.abs(lam.reshape(-1, 3) - nearest).max(axis=1) * scale
    return float((error / np.maximum(terms, 1e-300)).max())


class Admm:
    """Pinocchio's ADMM on a dense G, in units in which the largest diagonal of G and the largest b are 1.

    Its rows are (t1, t2, n). Without acceleration the settings are Pinocchio's defaults.
    """

    def __init__(self, tolerance: float, accelerated: bool = False, max_iterations: int = 5000):
        self.settings = pin.ADMMSolverSettings()
        for kind in ("absolute", "relative"):
            setattr(self.settings, f"{kind}_feasibility_tol", tolerance)
            setattr(self.settings, f"{kind}_complementarity_tol", tolerance)
        self.settings.max_iterations = max_iterations
        self.settings.measure_timings = True
        if accelerated:
            self.settings.admm_update_rule = pin.ADMMUpdateRule.SPECTRAL
            self.settings.anderson_capacity = 5
        self.model = pin.Model()
        self.model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")

    def constraints(self, mu: np.ndarray) -> tuple[pin.StdVec_ConstraintModel, pin.StdVec_ConstraintData]:
        models, datas = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
        for friction in mu:
            point = pin.PointContactConstraintModel(self.model, 0, pin.SE3.Identity(), 1, pin.SE3.Identity())
            point.setFriction(friction)
            models.append(pin.ConstraintModel(point))
            datas.append(models[-1].createData())
        return models, datas

    def solve(self, p: Problem, start: np.ndarray | None) -> Solved:
        order = np.arange(len(p.b)).reshape(-1, 3)[:, [1, 2, 0]].ravel()
        models, datas = self.constraints(p.mu)
        mobility, speed = np.diag(p.G).max(), np.abs(p.b).max()
        unit = speed / mobility
        matrix, g, best = p.G[np.ix_(order, order)] / mobility, p.b[order] / speed, np.inf
        for _ in range(REPEATS):
            solver, result = pin.ADMMConstraintSolver(len(g)), pin.ADMMSolverResult()
            if start is not None:
                result.setConstraintImpulseGuess(start[order] / unit)
            solver.solve(pin.DelassusOperatorDense(matrix), g, models, datas, self.settings, result)
            best = min(best, solver.getElapsedTime())
        lam = np.empty(len(g))
        lam[order] = np.asarray(result.retrieveConstraintImpulses()).ravel() * unit
        return Solved(natural_residual(p, lam), int(result.iterations), best)


def ours(p: Problem, start: np.ndarray | None, regularize: bool) -> Solved:
    args = (p.G, p.b, p.rows, p.mu, p.lower, None, start, regularize)
    lam, _, _, iterations, _ = _core.solve_cone(*args)
    seconds = _core.cone_seconds(*args, calls=20, repeats=REPEATS)
    return Solved(natural_residual(p, lam), iterations, 1e6 * seconds)


Solver = Callable[[Problem, np.ndarray | None], Solved]


def solvers() -> dict[str, Solver]:
    return {
        "contactvi": lambda p, start: ours(p, start, regularize=True),
        "contactvi, later iteration": lambda p, start: ours(p, start, regularize=False),
        "ADMM 1e-9": Admm(1e-9).solve,
        "ADMM 1e-13": Admm(1e-13).solve,
        "ADMM 1e-13, accelerated": Admm(1e-13, accelerated=True).solve,
    }


def problems(kind: str, count: int, seed: int) -> tuple[list[Problem], list[Problem], list[np.ndarray]]:
    """Problems, their neighbours and the solutions of the first, from which the neighbours are started."""
    rng = np.random.default_rng(seed)
    first = [PLAIN[kind](rng) for _ in range(count)]
    solutions = [_core.solve_cone(p.G, p.b, p.rows, p.mu, p.lower)[0] for p in first]
    near = [replace(p, b=p.b + p.G @ (0.01 * np.abs(x).max() * rng.normal(size=len(x))))
            for p, x in zip(first, solutions, strict=True)]  # fmt: skip
    return first, near, solutions


def digits(x: float) -> str:
    """Two significant digits, without an exponent."""
    return f"{float(f'{x:.2g}'):g}"


def cell(results: list[Solved]) -> str:
    residual, iterations, times = (np.array(x) for x in zip(*results, strict=True))
    return (
        f"{100 * np.mean(residual <= SOLVED):.4g} %, {100 * np.mean(residual <= 1e-8):.4g} %; "
        f"{np.median(iterations):.0f}, {iterations.max():.0f}; {digits(np.median(times))}, {digits(times.max())}"
    )


def depends_on_start(first: list[Problem], solutions: list[np.ndarray], seed: int) -> str:
    """Solved again from 0 to 2 times their impulses: how many have other impulses, other velocities."""
    rng = np.random.default_rng(seed)
    impulses, velocities = [], []
    for p, x in zip(first, solutions, strict=True):
        again = _core.solve_cone(p.G, p.b, p.rows, p.mu, p.lower, None, x * rng.uniform(0.0, 2.0, len(x)))[0]
        impulses.append(np.abs(again - x).max() / max(np.abs(x).max(), 1e-300))
        velocities.append(np.abs(p.G @ (again - x)).max() / np.abs(p.b).max())
    shares = [100 * np.mean(np.array(impulses) > limit) for limit in (1e-9, 1e-7, 1e-5)]
    return " | ".join(f"{share:.3g} %" for share in [*shares, 100 * np.mean(np.array(velocities) > 1e-5)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=200, help="problems of each kind")
    parser.add_argument("--kinds", default=",".join(PLAIN))
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    table = solvers()
    print("Each cell: solved to 1e-12, to 1e-8; iterations median, largest; microseconds median, largest.\n")
    print("| problem | start | " + " | ".join(table) + " |\n" + "|---" * (2 + len(table)) + "|")
    for kind in args.kinds.split(","):
        first, near, solutions = problems(kind, args.count, args.seed)
        cold, warm = [(p, None) for p in first], list(zip(near, solutions, strict=True))
        for start, cases in (("cold", cold), ("warm", warm)):
            cells = [cell([solve(p, guess) for p, guess in cases]) for solve in table.values()]
            print(f"| {kind} | {start} | " + " | ".join(cells) + " |", flush=True)
    print("\nSolved again by contactvi from another start: problems whose impulses differ by more, relative.\n")
    print("| problem | 1e-9 | 1e-7 | 1e-5 | velocities by 1e-5 |\n|---|---|---|---|---|")
    for kind in args.kinds.split(","):
        first, _, solutions = problems(kind, 5 * args.count, args.seed)
        print(f"| {kind} | {depends_on_start(first, solutions, args.seed)} |", flush=True)


if __name__ == "__main__":
    main()
