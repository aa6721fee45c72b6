"""Solvers of contact problems of many bodies on a folder of saved problems: how far they get, how long they take.

    python benchmarks/contact_problems.py DIR [--every 1] [--dense 60] [--solvers block,dense,admm,clarabel] [--heavy 1]

DIR holds npz files (tests/helpers/block_problems.py says what is in them). Printed per file and solver: the shares of
the problems solved to 1e-4, 1e-6, 1e-8; microseconds per contact, mean and median, of the C++ call with its
preparation; the worst closing gap; the rises of the energy among problems whose offsets are not negative. Residual: the
natural map of the whole law, evaluated here in NumPy, over the largest free speed of a contact. Every solver starts
from the saved impulses but Clarabel, which knows no start and solves another law, the convex one without De Saxce's
correction (its residual: the distance from the engine's convex answer; its time has Python's share in it). For the
engine's solver also the stages in which it ended, sweeps and factorizations.

Dense solvers get problems of up to --dense contacts only (a time per problem of seconds beyond). --heavy: factor on the
mass of every third body.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from contactvi import _core

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from cone_solvers import Admm

from helpers.block_problems import BlockProblem, heavier, read
from oracles.block_contact import convex_velocity, delassus, energy, free_speed, velocity, worst_gap

REPEATS = 3
LIMITS = (1e-4, 1e-6, 1e-8)


class Answer(NamedTuple):
    v: np.ndarray
    residual: float
    seconds: float
    stage: str = ""
    sweeps: int = 0
    factors: int = 0


def residual(p: BlockProblem, lam: np.ndarray) -> float:
    """Natural map of the law of three rows per contact, over the largest free speed."""
    w, W = (free_speed(p) + delassus(p) @ lam).reshape(-1, 3), p.dense_rows()
    scale = np.abs(W @ p.v_free).max()
    w[:, 0] += p.mu * np.linalg.norm(w[:, 1:], axis=1)
    g = np.diag(delassus(p)).reshape(-1, 3).max(axis=1)
    x = lam.reshape(-1, 3) - w / g[:, None]
    friction = np.linalg.norm(x[:, 1:], axis=1)
    normal = np.where(friction <= p.mu * x[:, 0], x[:, 0], np.maximum(0.0, (x[:, 0] + p.mu * friction) / (1 + p.mu**2)))
    share = np.where(friction > p.mu * normal, p.mu * normal / np.maximum(friction, 1e-300), 1.0)
    nearest = np.c_[normal, x[:, 1:] * share[:, None]]
    return float((np.abs(lam.reshape(-1, 3) - nearest) * g[:, None]).max() / scale)


def bound_of(p: BlockProblem) -> float:
    return p.free_energy() if (p.offset >= 0.0).all() else np.inf


def block(p: BlockProblem) -> Answer:
    solver = p.solver()
    q = solver.solve(p.start, bound_of(p))
    seconds = solver.seconds(p.start, bound_of(p), repeats=REPEATS)
    return Answer(q["v"], residual(p, q["impulses"]), seconds, q["stage"], q["sweeps"], q["factors"])


def dense(p: BlockProblem) -> Answer:
    G, b = delassus(p), free_speed(p)
    begin = time.perf_counter()
    lam = _core.solve_cone(G, b, p.rows, p.mu, p.lower, None, p.start, False)[0]
    seconds = time.perf_counter() - begin
    return Answer(velocity(p, lam), residual(p, lam), seconds)


class DenseAdmm(Admm):
    def __init__(self) -> None:
        super().__init__(1e-9, accelerated=True, max_iterations=1000)

    def __call__(self, p: BlockProblem) -> Answer:
        order = np.arange(len(p.offset)).reshape(-1, 3)[:, [1, 2, 0]].ravel()
        G, b = delassus(p), free_speed(p)
        mobility, speed = np.diag(G).max(), max(np.abs(b).max(), 1e-300)
        models, datas = self.constraints(p.mu)
        solver, result = pin.ADMMConstraintSolver(len(b)), pin.ADMMSolverResult()
        result.setConstraintImpulseGuess(p.start[order] * mobility / speed)
        matrix = pin.DelassusOperatorDense(G[np.ix_(order, order)] / mobility)
        solver.solve(matrix, b[order] / speed, models, datas, self.settings, result)
        lam = np.empty(len(b))
        lam[order] = np.asarray(result.retrieveConstraintImpulses()).ravel() * speed / mobility
        return Answer(velocity(p, lam), residual(p, lam), 1e-6 * solver.getElapsedTime())


def convex(p: BlockProblem) -> Answer:
    """The dual variables are not asked for: the residual is how far the velocity is from the engine's convex answer."""
    import clarabel

    begin = time.perf_counter()
    v = convex_velocity(p, np.zeros(len(p.mu)), clarabel)
    seconds = time.perf_counter() - begin
    lam = p.solver().solve_convex(np.zeros(len(p.mu)))[0]
    W = p.dense_rows()
    scale = np.abs(W @ p.v_free).max()
    if v is None:
        return Answer(p.v_free, np.inf, seconds)
    return Answer(v, float(np.abs(W @ (v - velocity(p, lam))).max() / scale), seconds)


def line(problems: list[BlockProblem], answers: list[Answer]) -> str:
    residuals = np.array([a.residual for a in answers])
    per_contact = np.array([1e6 * a.seconds / len(p.mu) for p, a in zip(problems, answers, strict=True)])
    gaps, rises = 0.0, 0
    for p, a in zip(problems, answers, strict=True):
        scale = np.abs(p.dense_rows() @ p.v_free).max()
        gaps = max(gaps, -worst_gap(p, np.array(a.v)) / scale)
        rises += bool((p.offset >= 0.0).all() and energy(p, np.array(a.v)) > p.free_energy() * (1.0 + 1e-11))
    shares = "/".join(f"{100 * np.mean(residuals <= limit):.0f}" for limit in LIMITS)
    stages = Counter(a.stage for a in answers if a.stage)
    text = f"{shares} | {per_contact.mean():.1f}, {np.median(per_contact):.1f} | {gaps:.0e} | {rises}"
    if not stages:
        return text + " |"
    work = f"{np.mean([a.sweeps for a in answers]):.0f} sweeps, {np.mean([a.factors for a in answers]):.1f} factors"
    return text + " | " + ", ".join(f"{name} {count}" for name, count in stages.most_common()) + f"; {work}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--dense", type=int, default=60)
    parser.add_argument("--solvers", default="block,dense,admm,clarabel")
    parser.add_argument("--heavy", type=float, default=1.0)
    args = parser.parse_args()
    table: dict[str, Callable[[BlockProblem], Answer]] = {
        "block": block,
        "dense": dense,
        "admm": DenseAdmm(),
        "clarabel": convex,
    }
    print(
        "| problems | solver | number | % to 1e-4/1e-6/1e-8 | us/contact: mean, median | worst gap | rises | stages |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for path in sorted(args.folder.glob("*.npz")):
        problems = [heavier(p, 3, args.heavy) for p in read(path)[:: args.every]]
        for name in args.solvers.split(","):
            given = problems if name == "block" else [p for p in problems if len(p.mu) <= args.dense]
            if not given:
                continue
            answers = [table[name](p) for p in given]
            print(f"| {path.stem} | {name} | {len(given)} | {line(given, answers)} |", flush=True)


if __name__ == "__main__":
    main()
