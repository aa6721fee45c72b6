"""The Coulomb cone problem, slow and obvious: the law itself, all solutions by modes, projected Gauss-Seidel, least
squares.

w = b + G lambda; rows of a contact (n, t1, t2), or one row. Nothing here shares a formula with the engine's solver.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from scipy import optimize

from helpers.cone_problems import Problem


def law_errors(p: Problem, lam: np.ndarray) -> dict[str, float]:
    """How much each clause of the law is violated, relative to the terms that the contact's velocity is the sum of.

    Products of impulse and velocity are divided by both sizes. Impulses are compared with the largest of the problem.
    """
    w = p.b + p.G @ lam
    terms = np.abs(p.b) + np.abs(p.G) @ np.abs(lam)
    worst = dict.fromkeys(
        ("bound", "separation", "complementarity", "cone", "dissipation", "direction"),
        0.0,
    )
    largest = max(np.abs(lam).max(initial=0.0), 1e-150)

    def note(clause: str, error: float) -> None:
        worst[clause] = max(worst[clause], float(error))

    for i, n in enumerate(p.first_rows()):
        size = max(terms[n : n + p.rows[i]].max(), 1e-150)
        note("bound", (p.lower[i] - lam[n]) / largest)
        note("separation", -w[n] / size)
        note("complementarity", abs((lam[n] - p.lower[i]) * w[n]) / (largest * size))
        if p.rows[i] == 1:
            continue
        l_t, w_t, limit = lam[n + 1 : n + 3], w[n + 1 : n + 3], p.mu[i] * lam[n]
        note("cone", (np.linalg.norm(l_t) - limit) / largest)
        if p.frozen is not None and not np.isnan(p.frozen[i]).any():
            note("direction", np.abs(l_t + limit * p.frozen[i]).max() / largest)
        else:
            # The power of friction is the least that the disc allows: -limit |w_t|.
            note(
                "dissipation",
                (l_t @ w_t + limit * np.linalg.norm(w_t)) / (largest * size),
            )
    return worst


def _solutions_of_modes(p: Problem, modes: tuple[str, ...], starts: int) -> Iterator[np.ndarray]:
    """Candidates with given modes: linear in lambda once the slip angles are known; the angles by root finding."""
    m, first = len(p.b), p.first_rows()
    slipping = [i for i, mode in enumerate(modes) if mode == "slip"]

    def impulses(angles: np.ndarray) -> np.ndarray:
        A, c = np.zeros((m, m)), np.zeros(m)
        for i, n in enumerate(first):
            for k in range(n, n + 3):
                A[k, k] = 1.0
            if modes[i] != "open":
                A[n], c[n] = p.G[n], -p.b[n]
            if modes[i] == "stick":
                A[n + 1 : n + 3], c[n + 1 : n + 3] = (
                    p.G[n + 1 : n + 3],
                    -p.b[n + 1 : n + 3],
                )
            if modes[i] == "slip":
                angle = angles[slipping.index(i)]
                A[n + 1, n], A[n + 2, n] = (
                    p.mu[i] * np.cos(angle),
                    p.mu[i] * np.sin(angle),
                )
        return np.linalg.solve(A, c)

    def turned(angles: np.ndarray) -> np.ndarray:
        w = p.b + p.G @ impulses(angles)
        return np.array([np.cos(a) * w[first[i] + 2] - np.sin(a) * w[first[i] + 1]
                         for a, i in zip(angles, slipping, strict=True)])  # fmt: skip

    if not slipping:
        yield impulses(np.zeros(0))
        return
    grid = np.arange(starts) * 2 * np.pi / starts
    for start in itertools.product(grid, repeat=len(slipping)):
        found = optimize.root(turned, start, options={"xtol": 1e-14})
        if found.success:
            yield impulses(found.x)


def all_solutions(p: Problem, starts: int = 12) -> list[np.ndarray]:
    """Every solution of a problem of few contacts with friction, without bounds and frozen directions."""
    kept: list[np.ndarray] = []
    for modes in itertools.product(("open", "stick", "slip"), repeat=len(p.rows)):
        for lam in _solutions_of_modes(p, modes, starts):
            new = all(np.abs(lam - other).max() > 1e-8 * np.abs(other).max() for other in kept)
            if new and max(law_errors(p, lam).values()) < 1e-8:
                kept.append(lam)
    return kept


def projected_gauss_seidel(p: Problem, sweeps: int = 20000) -> np.ndarray:
    """Projected gradient contact by contact, each with its own step length: slow, but each line is the law."""
    lam = np.zeros(len(p.b))
    for _ in range(sweeps):
        before = lam.copy()
        for i, n in enumerate(p.first_rows()):
            rows = slice(n, n + p.rows[i])
            step = 1.0 / np.linalg.norm(p.G[rows, rows], 2)
            lam[n] = max(p.lower[i], lam[n] - step * (p.b[n] + p.G[n] @ lam))
            if p.rows[i] == 3:
                t = slice(n + 1, n + 3)
                l_t, limit = lam[t] - step * (p.b[t] + p.G[t] @ lam), p.mu[i] * lam[n]
                lam[t] = l_t * min(1.0, limit / max(np.linalg.norm(l_t), 1e-300))
        if np.abs(lam - before).max() <= 1e-14 * np.abs(lam).max():
            break
    return lam


def frictionless_velocities(p: Problem) -> np.ndarray:
    """w of a problem of one-row contacts without bounds: least squares with lambda >= 0, G = L L^T, b = L c."""
    values, vectors = np.linalg.eigh(p.G)
    keep = values > 1e-12 * values.max()
    L = vectors[:, keep] * np.sqrt(values[keep])
    c = np.linalg.lstsq(L, p.b, rcond=None)[0]
    lam, _ = optimize.nnls(L.T, -c)
    return p.b + p.G @ lam
