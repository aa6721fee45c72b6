"""Solvers of contact problems beside each other: how far they get, in how many iterations, how long they take.

    python benchmarks/contact_problems.py [--kinds random,recorded] [--saved DIR] [--families hand,stack] [--count 40]
                                          [--solvers block,...] [--dense 60] [--heavy 1]

Kinds of problems:

    random    those of the tests (tests/helpers/cone_problems.py), from nothing (cold), or from the solution of a
              problem whose impulses differ at random by 1 % of the largest (warm)
    recorded  as steps of runs pose them, started from the impulses of the step before, with the rows of constraints:
              of dense steps (dense) and of contact steps (contact), whose G is made symmetric
    saved     the files of DIR (tests/helpers/block_problems.py), heaps of free bodies

A problem is solved to a number if the natural map of Coulomb's law, evaluated here in NumPy, is below it times the
largest free speed of a contact, whatever the solver reports. Equations of constraints are rows without a cone; the
impulses of constraints are taken as those that belong to the contacts' impulses. Solvers:

    block     that of dense steps, with their tolerances (1e-8, good enough at 1e-4)
    block+    the same with a tolerance of 1e-12, good enough at 1e-6
    cone      that of located contact, as in the first contact iteration of a step; equations are eliminated before
    cone+     the same as in later iterations: of redundant loads not the ones of least norm
    admm      Pinocchio's ADMM with its default settings at 1e-13, 2000 iterations at most, in units in which the
              largest diagonal of G and the largest b are 1; equations are boxes without bounds
    admm+     the same accelerated: spectral rule, Anderson acceleration of depth 5
    clarabel  another law, the convex one without De Saxce's correction, at 1e-12, and its natural map
    clarabel+ Coulomb's law by Clarabel: the convex problem again for the slip speeds that it leads to, 20 times at most

Each cell: share solved to 1e-6, to 1e-12; iterations, median and largest (of the block solver sweeps / factorizations);
microseconds, median and 90 % quantile. In the end, of each solver the largest closing speed that it leaves, over the
largest free speed; rises of the energy among the problems without negative offsets; answers of the block solver that
keep cones, gaps and energy, but not the law. Times are those of the solver with its preparation from G, of the block
solver from masses and rows; the fastest of three. Clarabel's are its own.

Solvers other than block get problems of up to --dense contacts; their number is in brackets where it is less. --heavy:
factor on the mass of every third body of the saved problems. --again: how many of the random problems have several
solutions, instead of the table.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import clutter
import numpy as np
import pinocchio as pin
from scale import scale_scenes

import contactvi as cvi
from contactvi import _core

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.block_problems import BlockProblem, heavier, read
from helpers.cone_problems import PLAIN
from helpers.grasp_scene import grasp
from helpers.posed_problems import of_rows, record

REPEATS = 3
LIMITS = (1e-6, 1e-12)
SLIPS = 20  # convex problems for one of Coulomb's law
IDLE = 1e-12  # of the largest mobility: rows with less move nothing
Start = tuple[cvi.Scene, np.ndarray, np.ndarray]


class Answer(NamedTuple):
    lam: np.ndarray
    iterations: tuple[int, ...]
    seconds: float
    stage: str = ""
    convex: bool = False


class Posed:
    """A problem with its dense matrices: G, b of the contacts where the equations hold; all, b_all with those first."""

    def __init__(self, problem: BlockProblem) -> None:
        p = self.p = problem
        W, mobility = p.dense_rows(), np.linalg.inv(p.dense_mass())
        A = np.zeros((0, W.shape[1])) if p.equations is None else p.equations.T
        size = np.sqrt(np.einsum("ij,jk,ik->i", A, mobility, A))
        A = A[size > 0.0] / size[size > 0.0, None]
        rows = np.vstack([A, W])
        self.all = rows @ mobility @ rows.T
        self.b = W @ p.v_free + p.offset
        self.b_all = np.r_[np.zeros(len(A)), self.b]
        self.equations = e = len(A)
        self.G = self.all[e:, e:] - self.all[e:, :e] @ np.linalg.pinv(self.all[:e, :e], 1e-12) @ self.all[:e, e:]
        self.G = 0.5 * (self.G + self.G.T)
        self.scale = np.abs(W @ p.v_free).max()

    @cached_property
    def groups(self) -> list[tuple[int, slice]]:
        """Contacts that move anything, with their rows."""
        slices = [slice(first, first + n) for first, n in zip(self.p.first_row, self.p.rows, strict=True)]
        diagonal = np.diag(self.G)
        return [(i, s) for i, s in enumerate(slices) if diagonal[s].max() > IDLE * np.diag(self.all).max()]

    def residual(self, lam: np.ndarray, convex: bool) -> float:
        """Natural map of the law, or of the convex one, over the largest free speed."""
        p, w, worst = self.p, self.b + self.G @ lam, 0.0
        for i, s in self.groups:
            g, u, l_i = np.diag(self.G)[s].max(), w[s].copy(), lam[s]
            if p.rows[i] == 3 and not convex:
                u[0] += p.mu[i] * np.linalg.norm(u[1:])
            x = l_i - u / g
            if p.box[i] > 0.0:
                x = np.clip(x, -p.box[i], p.box[i])
            elif p.rows[i] == 1:
                x = np.maximum(x, p.lower[i])
            else:
                x = nearest(x, p.mu[i])
            worst = max(worst, g * float(np.abs(l_i - x).max()))
        return worst / self.scale

    def closing(self, lam: np.ndarray) -> float:
        """Largest closing speed, over the largest free speed."""
        w = (self.b + self.G @ lam)[self.p.first_row[self.p.box == 0.0]]
        return float(max(0.0, -w.min(initial=0.0)) / self.scale)

    def rises(self, lam: np.ndarray) -> bool:
        """Whether the energy is higher than before, though no offset is negative."""
        free = self.p.free_energy()
        w_free = self.b - self.p.offset
        return bool((self.p.offset >= 0.0).all() and lam @ (w_free + 0.5 * self.G @ lam) > 1e-11 * free)


def nearest(x: np.ndarray, mu: float) -> np.ndarray:
    """The point of the friction cone next to x."""
    t = np.linalg.norm(x[1:])
    if t <= mu * x[0]:
        return x
    normal = max(0.0, (x[0] + mu * t) / (1.0 + mu**2))
    return np.r_[normal, x[1:] * (mu * normal / t if t > 0.0 else 0.0)]


# --- the solvers ------------------------------------------------------------------------------------------------------


def block(posed: Posed, **tolerances: float) -> Answer:
    p, solver = posed.p, posed.p.solver()
    bound = p.free_energy() if (p.offset >= 0.0).all() and not p.box.any() else np.inf
    q = solver.solve(p.start, bound, factors=60, **tolerances)
    seconds = solver.seconds(p.start, bound, factors=60, repeats=REPEATS, **tolerances)
    return Answer(np.array(q["impulses"]), (q["sweeps"], q["factors"]), seconds, q["stage"])


def cone(posed: Posed, regularize: bool) -> Answer:
    p = posed.p
    args = (posed.G, posed.b, p.rows.astype(np.int32), p.mu, p.lower, None, p.start, regularize)
    lam, _, _, iterations, _ = _core.solve_cone(*args, box=p.box)
    seconds = _core.cone_seconds(*args, calls=3, repeats=REPEATS, box=p.box)
    return Answer(np.array(lam), (iterations,), seconds)


def admm(posed: Posed, accelerated: bool) -> Answer:
    settings = pin.ADMMSolverSettings()
    for kind in ("absolute", "relative"):
        setattr(settings, f"{kind}_feasibility_tol", 1e-13)
        setattr(settings, f"{kind}_complementarity_tol", 1e-13)
    settings.max_iterations, settings.measure_timings = 2000, True
    if accelerated:
        settings.admm_update_rule, settings.anderson_capacity = pin.ADMMUpdateRule.SPECTRAL, 5
    p, e, model = posed.p, posed.equations, pin.Model()
    mobility, speed = np.diag(posed.all).max(), max(np.abs(posed.b).max(), 1e-300)
    impulse = speed / mobility
    # Of one row: a box of a joint's friction, without bounds for an equation, from its lower bound on for a contact.
    bounds = [(-np.inf, np.inf)] * e
    for rows, lower, box in zip(p.rows, p.lower, p.box, strict=True):
        if rows == 1:
            bounds.append((-box / impulse, box / impulse) if box > 0.0 else (lower / impulse, np.inf))
    for k in range(max(1, len(bounds))):
        model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), f"row{k}")
    low, high = np.array([*bounds, (0.0, 0.0)][: model.nv]).T
    models, datas, order, single = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData(), list(range(e)), 0

    def add_row() -> None:
        nonlocal single
        joint = pin.StdVec_Index()
        joint.append(1 + single)
        models.append(pin.ConstraintModel(pin.JointFrictionConstraintModel(model, joint, low, high)))
        single += 1

    for _ in range(e):
        add_row()
    for rows, mu, first in zip(p.rows, p.mu, e + p.first_row, strict=True):
        if rows == 1:
            add_row()
            order.append(first)
            continue
        point = pin.PointContactConstraintModel(model, 0, pin.SE3.Identity(), 1, pin.SE3.Identity())
        point.setFriction(mu)
        models.append(pin.ConstraintModel(point))
        order += [first + 1, first + 2, first]  # its rows are (t1, t2, n)
    for constraint in models:
        datas.append(constraint.createData())
    matrix = pin.DelassusOperatorDense(posed.all[np.ix_(order, order)] / mobility)
    start, best = np.r_[np.zeros(e), p.start][order] / impulse, np.inf
    for _ in range(REPEATS):
        solver, result = pin.ADMMConstraintSolver(len(order)), pin.ADMMSolverResult()
        result.setConstraintImpulseGuess(start)
        solver.solve(matrix, posed.b_all[order] / speed, models, datas, settings, result)
        best = min(best, 1e-6 * solver.getElapsedTime())
    lam = np.empty(len(order))
    lam[order] = np.asarray(result.retrieveConstraintImpulses()).ravel() * impulse
    return Answer(lam[e:], (int(result.iterations),), best)


def clarabel(posed: Posed, slips: int) -> Answer:
    """slips: how often the convex problem is solved again for the slip speeds that its solution has; 0: never."""
    import clarabel as package
    from scipy import sparse

    p, e = posed.p, posed.equations
    mobility, speed = np.diag(posed.all).max(), max(np.abs(posed.b).max(), 1e-300)
    impulse, rows, bounds, cones = speed / mobility, [], [], []

    def need(*entries: tuple[int, float], above: float = 0.0) -> None:
        row = np.zeros(len(posed.b_all))
        for at, factor in entries:
            row[e + at] = -factor
        rows.append(row)
        bounds.append(-above / impulse)

    for i, n in enumerate(p.first_row):
        if p.box[i] > 0.0:
            need((n, 1.0), above=-p.box[i])
            need((n, -1.0), above=-p.box[i])
            cones.append(package.NonnegativeConeT(2))
        elif p.rows[i] == 1:
            need((n, 1.0), above=p.lower[i])
            cones.append(package.NonnegativeConeT(1))
        else:
            need((n, p.mu[i] or 1.0))
            need((n + 1, 1.0))
            need((n + 2, 1.0))
            cones += [package.SecondOrderConeT(3)] if p.mu[i] else [package.NonnegativeConeT(1), package.ZeroConeT(2)]
    settings = package.DefaultSettings()
    settings.verbose, settings.max_iter = False, 100
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    matrix = sparse.csc_matrix(np.triu(posed.all / mobility))
    normals = p.first_row[p.rows == 3]
    b, used, seconds, change, lam = posed.b_all.copy(), 0, 0.0, np.inf, p.start
    for _ in range(1 + slips):
        solver = package.DefaultSolver(
            matrix, b / speed, sparse.csc_matrix(np.array(rows)), np.array(bounds), cones, settings
        )
        solution = solver.solve()
        used, seconds = used + solution.iterations, seconds + solution.solve_time
        last, lam = lam, np.array(solution.x)[e:] * impulse
        change = np.abs(lam - last).max()
        if not np.isfinite(lam).all() or change <= 1e-12 * np.abs(lam).max():
            break
        w = posed.b + posed.G @ lam
        b[e + normals] = posed.b[normals] + p.mu[p.rows == 3] * np.hypot(w[normals + 1], w[normals + 2])
    return Answer(lam, (used,), seconds, convex=slips == 0)


SOLVERS: dict[str, Callable[[Posed], Answer]] = {
    "block": lambda posed: block(posed, tolerance=1e-8, accept=1e-4),
    "block+": lambda posed: block(posed, tolerance=1e-12, accept=1e-6),
    "cone": lambda posed: cone(posed, regularize=True),
    "cone+": lambda posed: cone(posed, regularize=False),
    "admm": lambda posed: admm(posed, accelerated=False),
    "admm+": lambda posed: admm(posed, accelerated=True),
    "clarabel": lambda posed: clarabel(posed, slips=0),
    "clarabel+": lambda posed: clarabel(posed, slips=SLIPS),
}

# --- the problems -----------------------------------------------------------------------------------------------------


def random_problems(kind: str, count: int, warm: bool) -> list[BlockProblem]:
    """Problems from nothing, or their neighbours, started from the solutions of the first."""
    rng, found = np.random.default_rng(0), []
    for p in [PLAIN[kind](rng) for _ in range(count)]:
        start, b = np.zeros(len(p.b)), p.b
        if warm:
            start = np.array(_core.solve_cone(p.G, p.b, p.rows, p.mu, p.lower)[0])
            b = b + p.G @ (0.01 * np.abs(start).max() * rng.normal(size=len(start)))
        found.append(of_rows(p.G, b, p.rows, p.mu, p.lower, np.zeros(len(p.rows)), start, 0))
    return found


def hand(coupled: bool) -> Start:
    """The Allegro hand closes around a ball; coupled: the last joint of each finger follows the one before."""
    scene, q, v = grasp(0.0, 0.8)
    if coupled:
        for first in (2, 6, 10):
            scene.add_joint_equality(f"joint_{first + 1}.0", f"joint_{first}.0", (0.0, 1.0))
    return scene, q, v


def humanoid(loop: bool) -> Start:
    """The G1 comes down on its feet, which servos hold; loop: its hands are fixed to each other."""
    setup = scale_scenes.robot("g1")
    setup.q0[2] -= scale_scenes.DROP - 0.01
    if loop:
        placement = hands_apart(setup.scene, setup.q0)
        setup.scene.add_weld("left_wrist_yaw_link", "right_wrist_yaw_link", placement)
    return setup.scene, setup.q0, setup.v0


def hands_apart(scene: cvi.Scene, q: np.ndarray) -> pin.SE3:
    """The placement of the right hand in the left one."""
    data = scene.model.createData()
    pin.framesForwardKinematics(scene.model, data, q)
    left, right = (data.oMf[scene.model.getFrameId(f"{side}_wrist_yaw_link")] for side in ("left", "right"))
    return left.actInv(right)


def gripper(wrist: str, objects: int) -> Start:
    """A gripper in a bin of objects, from where they rest."""
    rest, _, plan = clutter.settled(0, objects)
    places = {name: pin.SE3ToXYZQUAT(pose) for name, pose in rest.items()}
    with tempfile.TemporaryDirectory() as folder:
        scene, q = clutter.gripper_scene(0, objects, wrist, plan, places, Path(folder))
        scene.core()
    q = scene.separate(q).q
    return scene, q, scene.consistent_velocity(q, np.zeros(scene.nv))


# name -> the start of a run, its duration [s], the length of its steps [s]
RECORDED: dict[str, tuple[Callable[[], Start], float, float]] = {
    "hand and ball": (lambda: hand(False), 0.5, 1e-3),
    "hand and ball, coupled joints": (lambda: hand(True), 0.5, 1e-3),
    "g1 on its feet": (lambda: humanoid(False), 0.3, 1e-3),
    "g1, hands joined": (lambda: humanoid(True), 0.3, 1e-3),
    "gripper in a bin, driven pose": (lambda: gripper("pose", 8), 1.5, 1e-3),
    "gripper in a bin, driven joints": (lambda: gripper("joints", 8), 1.5, 1e-3),
    "gripper in a bin of 30": (lambda: gripper("servos", 30), 1.0, 1e-3),
}


def families(args: argparse.Namespace) -> Iterator[tuple[str, list[BlockProblem]]]:
    """Name and problems of each."""

    def wanted(name: str) -> bool:
        return not args.families or any(part in name for part in args.families.split(","))

    for kind in PLAIN:
        for warm in (False, True):
            name = f"{kind}, {'warm' if warm else 'cold'}"
            if "random" in args.kinds and wanted(name):
                yield name, random_problems(kind, args.count, warm)
    for kind, (make, duration, dt) in RECORDED.items():
        for mode, step in (("steps", "dense"), ("events", "contact")):
            if "recorded" in args.kinds and wanted(f"{kind}, {step}"):
                yield f"{kind}, {step}", record(*make(), duration, dt, mode, args.count)
    for path in sorted(args.saved.glob("*.npz")) if args.saved else []:
        if wanted(path.stem):
            found = [heavier(p, 3, args.heavy) for p in read(path)]
            yield path.stem, found[:: max(1, len(found) // args.count)]


# --- the tables -------------------------------------------------------------------------------------------------------


def pair(values: Any) -> str:
    """Median and largest or 90 % quantile, of two significant digits."""
    return ", ".join(f"{float(f'{x:.2g}'):g}" for x in values)


def cell(problems: list[Posed], answers: list[Answer]) -> str:
    residuals = np.array([p.residual(a.lam, a.convex) for p, a in zip(problems, answers, strict=True)])
    work = " / ".join(f"{np.median(n):.0f}, {max(n)}" for n in zip(*(a.iterations for a in answers), strict=True))
    times = 1e6 * np.array([a.seconds for a in answers])
    shares = ", ".join(f"{100 * np.mean(residuals <= limit):.0f}" for limit in LIMITS)
    return f"{shares} %; {work}; {pair((np.median(times), np.quantile(times, 0.9)))}"


def sizes(problems: list[Posed]) -> str:
    contacts = [int((p.p.box == 0.0).sum()) for p in problems]
    return f"{len(problems)} | {pair((np.median(contacts), max(contacts)))}, {max(p.equations for p in problems)}"


@dataclass
class Faults:
    """Of the answers of a solver: the largest closing speed, rises of the energy, answers that left the law."""

    closing: float = 0.0
    rises: int = 0
    stages: Counter[str] = field(default_factory=Counter)

    def add(self, posed: Posed, answer: Answer) -> None:
        self.closing = max(self.closing, posed.closing(answer.lam))
        self.rises += posed.rises(answer.lam)
        self.stages[answer.stage] += 1

    def __str__(self) -> str:
        left = [f"{self.stages[name]} {name}" for name in ("repaired", "blended", "failed") if self.stages[name]]
        return ", ".join([f"{self.closing:.0e}", f"{self.rises} rises", *left])


def several_solutions(kind: str, count: int) -> str:
    """Solved again from 0 to 2 times their impulses: how many have other impulses, other velocities."""
    rng, impulses, velocities = np.random.default_rng(0), [], []
    for p in [PLAIN[kind](rng) for _ in range(count)]:
        x = np.array(_core.solve_cone(p.G, p.b, p.rows, p.mu, p.lower)[0])
        again = _core.solve_cone(p.G, p.b, p.rows, p.mu, p.lower, None, x * rng.uniform(0.0, 2.0, len(x)))[0]
        impulses.append(np.abs(again - x).max() / max(np.abs(x).max(), 1e-300))
        velocities.append(np.abs(p.G @ (again - x)).max() / np.abs(p.b).max())
    shares = [100 * np.mean(np.array(impulses) > limit) for limit in (1e-9, 1e-7, 1e-5)]
    return " | ".join(f"{share:.3g} %" for share in [*shares, 100 * np.mean(np.array(velocities) > 1e-5)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default="random,recorded")
    parser.add_argument("--saved", type=Path, metavar="DIR")
    parser.add_argument("--families", default="", help="parts of names")
    parser.add_argument("--count", type=int, default=40, help="problems of each family")
    parser.add_argument("--solvers", default=",".join(SOLVERS))
    parser.add_argument("--dense", type=int, default=60)
    parser.add_argument("--heavy", type=float, default=1.0)
    parser.add_argument("--again", action="store_true")
    args = parser.parse_args()
    if args.again:
        print("| problem | 1e-9 | 1e-7 | 1e-5 | velocities by 1e-5 |\n|---|---|---|---|---|")
        for kind in PLAIN:
            print(f"| {kind} | {several_solutions(kind, args.count)} |", flush=True)
        return
    names = args.solvers.split(",")
    faults = {name: Faults() for name in names}
    print("| problems | number | contacts median, most, equations | " + " | ".join(names) + " |")
    print("|---" * (3 + len(names)) + "|")
    for family, found in families(args):
        problems, cells = [Posed(p) for p in found], []
        for name in names:
            given = [p for p in problems if name.startswith("block") or len(p.p.mu) <= args.dense]
            answers = [SOLVERS[name](p) for p in given]
            some = f"({len(given)}) " if len(given) < len(problems) else ""
            cells.append(some + cell(given, answers) if given else "-")
            for posed, answer in zip(given, answers, strict=True):
                faults[name].add(posed, answer)
        print(f"| {family} | {sizes(problems)} | " + " | ".join(cells) + " |", flush=True)
    print("\n" + "; ".join(f"{name}: {of}" for name, of in faults.items()))


if __name__ == "__main__":
    main()
