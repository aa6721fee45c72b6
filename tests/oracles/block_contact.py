"""The contact problem of many bodies, slow and obvious: dense matrices, one clause of the law after the other.

w = W (v_free + M^-1 W^T lambda) + offset. Nothing here shares a formula with the engine's solver: the law is checked by
clauses, solved by projected gradient steps per contact, the convex problems by another package or by enumeration.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy import sparse

from helpers.block_problems import BlockProblem


def delassus(p: BlockProblem) -> np.ndarray:
    W = p.dense_rows()
    return W @ np.linalg.solve(p.dense_mass(), W.T)


def free_speed(p: BlockProblem) -> np.ndarray:
    return p.dense_rows() @ p.v_free + p.offset


def velocity(p: BlockProblem, lam: np.ndarray) -> np.ndarray:
    """v (nv,) of the impulses."""
    return p.v_free + np.linalg.solve(p.dense_mass(), p.dense_rows().T @ lam)


def energy(p: BlockProblem, v: np.ndarray) -> float:
    return 0.5 * float(v @ p.dense_mass() @ v)


def cone_error(p: BlockProblem, lam: np.ndarray) -> float:
    """How far impulses are outside of what the law allows [N s], over the largest: friction, bounds, boxes."""
    worst = 0.0
    for i, row in enumerate(p.first_row):
        if p.box[i] > 0.0:
            worst = max(worst, abs(lam[row]) - p.box[i])
            continue
        worst = max(worst, p.lower[i] - lam[row])
        if p.rows[i] == 3:
            worst = max(worst, np.linalg.norm(lam[row + 1 : row + 3]) - p.mu[i] * lam[row])
    return float(worst) / max(np.abs(lam).max(initial=0.0), 1e-300)


def worst_gap(p: BlockProblem, v: np.ndarray) -> float:
    """Least normal velocity [m/s], at most 0."""
    w = p.dense_rows() @ v + p.offset
    normals = p.first_row[p.box == 0.0]
    return float(min(0.0, w[normals].min(initial=0.0)))


def law_errors(p: BlockProblem, lam: np.ndarray) -> dict[str, float]:
    """Each clause of the law by itself, as a velocity [m/s]: an impulse counts times the contact's own mobility."""
    G, w = delassus(p), free_speed(p) + delassus(p) @ lam
    worst = dict.fromkeys(("bound", "separation", "complementarity", "cone", "dissipation", "joint"), 0.0)

    def note(clause: str, error: float) -> None:
        worst[clause] = max(worst[clause], float(error))

    for i, n in enumerate(p.first_row):
        g = np.diag(G)[n : n + p.rows[i]].max()
        if p.box[i] > 0.0:
            note("bound", g * (abs(lam[n]) - p.box[i]))
            # Either the velocity is against the impulse at its limit, or it is zero.
            note("joint", min(abs(w[n]), g * (p.box[i] + lam[n] * np.sign(w[n]))))
            continue
        note("bound", g * (p.lower[i] - lam[n]))
        note("separation", -w[n])
        note("complementarity", min(abs(w[n]), g * (lam[n] - p.lower[i])))
        if p.rows[i] == 1:
            continue
        l_t, w_t, limit = lam[n + 1 : n + 3], w[n + 1 : n + 3], p.mu[i] * lam[n]
        note("cone", g * (np.linalg.norm(l_t) - limit))
        # Friction is opposite to slip, and at its limit: the error of the direction, as slip or as what friction moves.
        slip = np.linalg.norm(w_t)
        if slip > 0.0 and limit > 0.0:
            note("dissipation", min(slip, g * limit) * np.linalg.norm(w_t / slip + l_t / limit))
    return worst


def _one_contact(p: BlockProblem, i: int, G: np.ndarray, b: np.ndarray, lam: np.ndarray, steps: int) -> np.ndarray:
    """Projected steps along the velocity with De Saxce's correction; the set is projected on clause by clause."""
    r = 0.9 / max(np.linalg.eigvalsh(G).max() * (1.0 + p.mu[i]), 1e-300)
    for _ in range(steps):
        w = b + G @ lam
        if p.box[i] > 0.0:
            lam = np.clip(lam - r * w, -p.box[i], p.box[i])
            continue
        if p.rows[i] == 1:
            lam = np.maximum(lam - r * w, p.lower[i])
            continue
        x = lam - r * (w + np.array([p.mu[i] * np.linalg.norm(w[1:]), 0.0, 0.0]))
        lam = _nearest_in_cone(x, p.mu[i], p.lower[i])
    return lam


def _nearest_in_cone(x: np.ndarray, mu: float, lower: float) -> np.ndarray:
    """Nearest point with normal >= lower and friction <= mu normal: the nearest of the candidates of each face."""
    friction = np.linalg.norm(x[1:])
    unit = x[1:] / friction if friction > 0.0 else np.zeros(2)
    edge = max((x[0] + mu * friction) / (1.0 + mu * mu), lower)
    candidates = [x, np.r_[edge, mu * edge * unit], np.r_[lower, min(friction, mu * lower) * unit]]
    allowed = [c for c in candidates if c[0] >= lower and np.linalg.norm(c[1:]) <= mu * c[0] + 1e-15 * friction]
    return min(allowed, key=lambda c: float(np.linalg.norm(c - x)))


def gauss_seidel(p: BlockProblem, lam: np.ndarray, tolerance: float = 1e-13, sweeps: int = 20000) -> np.ndarray | None:
    """Projected Gauss-Seidel until the impulses stay, None if they do not."""
    G, b, lam = delassus(p), free_speed(p), lam.copy()
    for _ in range(sweeps):
        before = lam.copy()
        for i, row in enumerate(p.first_row):
            own = slice(row, row + p.rows[i])
            others = b[own] + G[own] @ lam - G[own, own] @ lam[own]
            lam[own] = _one_contact(p, i, G[own, own], others, lam[own], 10)
        if np.abs(G @ (lam - before)).max() <= tolerance * np.abs(b).max():
            return lam
    return None


def low_normals(p: BlockProblem, lam: np.ndarray) -> np.ndarray:
    """Least normal impulses (m,) with which the tangential impulses of lam are allowed."""
    low = p.lower.copy()
    for i, row in enumerate(p.first_row):
        if p.rows[i] == 3 and p.mu[i] > 0.0:
            low[i] = max(low[i], np.linalg.norm(lam[row + 1 : row + 3]) / p.mu[i])
    return low


def normals_by_enumeration(p: BlockProblem, lam: np.ndarray) -> np.ndarray:
    """Velocity v of stage D for a few contacts: all sets of closed contacts, the first that fulfils the law."""
    normals = np.flatnonzero(p.box == 0.0)
    rows, low = p.first_row[normals], low_normals(p, lam)[normals]
    G, fixed = delassus(p), lam.copy()
    for i, row in enumerate(p.first_row):
        if p.rows[i] == 3 and p.mu[i] == 0.0:
            fixed[row + 1 : row + 3] = 0.0
    fixed[rows] = low
    b, own = (free_speed(p) + G @ fixed)[rows], G[np.ix_(rows, rows)]
    best, answer = np.inf, np.zeros(len(rows))
    for size in range(len(rows) + 1):
        for closed in itertools.combinations(range(len(rows)), size):
            n = np.zeros(len(rows))
            if closed:
                n[list(closed)] = np.linalg.lstsq(own[np.ix_(closed, closed)], -b[list(closed)], rcond=1e-12)[0]
            w = b + own @ n
            error = max(-n.min(initial=0.0), -w.min(initial=0.0), np.abs(n * w).max(initial=0.0))
            if error < best:
                best, answer = error, n
    total = fixed.copy()
    total[rows] += answer
    return velocity(p, total)


def convex_velocity(p: BlockProblem, slip: np.ndarray, clarabel) -> np.ndarray | None:
    """v of min |v - v_free|_M^2 / 2 with (w_n + mu s, w_t) in the dual of the friction cone; None where it fails."""
    M, W = p.dense_mass(), p.dense_rows()
    A, b, cones = [], [], []
    for i, row in enumerate(p.first_row):
        if p.rows[i] == 3 and p.mu[i] > 0.0:  # |w_t| <= w_n / mu + s
            scale = np.array([1.0 / p.mu[i], 1.0, 1.0])[:, None]
            A.append(-scale * W[row : row + 3])
            b.append(scale[:, 0] * p.offset[row : row + 3] + [slip[i], 0.0, 0.0])
            cones.append(clarabel.SecondOrderConeT(3))
        else:
            A.append(-W[row : row + 1])
            b.append(p.offset[row : row + 1])
            cones.append(clarabel.NonnegativeConeT(1))
    return _clarabel(M, -M @ p.v_free, np.vstack(A), np.concatenate(b), cones, clarabel)


def normal_velocity(p: BlockProblem, lam: np.ndarray, clarabel) -> np.ndarray | None:
    """v of stage D: w_n >= 0, the tangential impulses of lam and what normals they need being there already."""
    normals = np.flatnonzero(p.box == 0.0)
    rows, fixed = p.first_row[normals], lam.copy()
    for i, row in enumerate(p.first_row):
        if p.rows[i] == 3 and p.mu[i] == 0.0:
            fixed[row + 1 : row + 3] = 0.0
    fixed[rows] = low_normals(p, lam)[normals]
    M, W, base = p.dense_mass(), p.dense_rows(), velocity(p, fixed)
    return _clarabel(M, -M @ base, -W[rows], p.offset[rows], [clarabel.NonnegativeConeT(len(rows))], clarabel)


def _clarabel(P, q, A, b, cones, clarabel) -> np.ndarray | None:
    """In units in which the largest mass and the largest velocity are 1: its tolerances are absolute."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    mass = np.diag(P).max()
    speed = max(np.abs(np.linalg.solve(P, q)).max(), np.abs(b).max(), 1e-300)
    problem = sparse.csc_matrix(np.triu(P / mass)), q / (mass * speed), sparse.csc_matrix(A), b / speed
    solution = clarabel.DefaultSolver(*problem, cones, settings).solve()
    return speed * np.array(solution.x) if "Solved" in str(solution.status) else None
