"""The cone problem with friction against spinning and rolling, slow and obvious: the law itself, and a fixed point.

w = b + G lambda; rows of a contact (n, t1, t2), then one of spinning, then two of rolling, each where it has them.
lambda_n >= lower, w_n >= 0, complementary. Friction of slip and spin together lies in the ball of radius mu lambda_n,
that of rolling in the disc of radius rho lambda_n; each does the least work on its speeds that its ball allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TurningProblem:
    """G (m, m), b (m,), per contact rows (1, 3, 4, 5 or 6), mu, rho (0: no rolling), lower, frozen directions or None.

    frozen (n, 5): a unit vector of slip and spin, and one of rolling; NaN where friction is free.
    """

    G: np.ndarray
    b: np.ndarray
    rows: list[int]
    mu: np.ndarray
    rho: np.ndarray
    lower: np.ndarray
    frozen: np.ndarray | None = None

    def balls(self) -> list[tuple[int, slice, float, np.ndarray | None]]:
        """(normal row, rows, coefficient, frozen direction or None) of every ball of friction."""
        found, n = [], 0
        for i, rows in enumerate(self.rows):
            slip = 3 if rows in (4, 6) else 2
            given = [None, None] if self.frozen is None else [self.frozen[i, :slip], self.frozen[i, 3:]]
            given = [None if d is None or np.isnan(d).any() else d for d in given]
            if rows > 1:
                found.append((n, slice(n + 1, n + 1 + slip), float(self.mu[i]), given[0]))
            if rows > 4:
                found.append((n, slice(n + 1 + slip, n + rows), float(self.rho[i]), given[1]))
            n += rows
        return found

    def normals(self) -> list[int]:
        return [int(n) for n in np.cumsum([0, *self.rows])[:-1]]


def law_errors(p: TurningProblem, lam: np.ndarray) -> dict[str, float]:
    """How much each clause of the law is violated, relative to the largest impulse and to the terms of the speeds."""
    w, terms = p.b + p.G @ lam, np.abs(p.b) + np.abs(p.G) @ np.abs(lam)
    largest, fastest = max(np.abs(lam).max(), 1e-150), max(terms.max(), 1e-150)
    worst = dict.fromkeys(("bound", "separation", "complementarity", "cone", "dissipation", "direction"), 0.0)

    def note(clause: str, error: float) -> None:
        worst[clause] = max(worst[clause], float(error))

    for n, lower in zip(p.normals(), p.lower, strict=True):
        note("bound", (lower - lam[n]) / largest)
        note("separation", -w[n] / fastest)
        note("complementarity", abs((lam[n] - lower) * w[n]) / (largest * fastest))
    for n, rows, mu, d in p.balls():
        limit = mu * lam[n]
        note("cone", (np.linalg.norm(lam[rows]) - limit) / largest)
        if d is not None:
            note("direction", np.abs(lam[rows] + limit * d).max() / largest)
        else:
            power = lam[rows] @ w[rows] + limit * np.linalg.norm(w[rows])
            note("dissipation", power / (largest * fastest))
    return worst


def fixed_point(p: TurningProblem, share: float = 0.5, most: int = 400000) -> np.ndarray:
    """The impulses that a small step against the speeds, cut to what the law allows, leaves as they are."""
    lam, step = np.zeros(len(p.b)), share / np.linalg.norm(p.G, 2)
    normals, balls = np.array(p.normals()), p.balls()
    for _ in range(most):
        before, z = lam, lam - step * (p.b + p.G @ lam)
        lam = z.copy()
        lam[normals] = np.maximum(p.lower, z[normals])
        for n, rows, mu, d in balls:
            limit = mu * lam[n]
            lam[rows] = (
                -limit * d if d is not None else z[rows] * min(1.0, limit / max(np.linalg.norm(z[rows]), 1e-300))
            )
        if np.abs(lam - before).max() <= 1e-15 * np.abs(lam).max():
            break
    return lam


def drawn(
    rng: np.random.Generator, contacts: int, *, dofs: int | None = None, turn: float = 1.0, bounded: bool = False,
    frozen: bool = False,
) -> TurningProblem:  # fmt: skip
    """A problem of drawn rows on one body or on more degrees of freedom; turn: size of the rows of turning."""
    rows = [int(rng.choice([1, 3, 4, 5, 6])) for _ in range(contacts)]
    rows[0] = int(rng.choice([4, 5, 6]))
    m, n = sum(rows), len(rows)
    J = rng.normal(size=(m, dofs or m + 2))
    p = TurningProblem(np.eye(m), np.zeros(m), rows, rng.uniform(0.05, 0.9, n), np.zeros(n), np.zeros(n))
    for row, size in zip(p.normals(), rows, strict=True):
        J[row + 3 : row + size] *= turn
    weights = np.exp(rng.uniform(-1.0, 1.0, J.shape[1]))
    G = (J * weights) @ J.T
    v, normal = rng.normal(size=J.shape[1]), J[p.normals()]
    # Most contacts close. The speeds are those of a motion, so that redundant rows agree.
    b = J @ (v - np.linalg.pinv(normal) @ (normal @ v + rng.uniform(-0.5, 2.0, n)))
    rho = np.where(np.array(rows) > 4, rng.uniform(0.05, 0.9, n), 0.0)
    lower = rng.uniform(0.0, 0.3, n) if bounded else np.zeros(n)
    directions = np.full((n, 5), np.nan)
    for i, size in enumerate(rows):
        slip = 3 if size in (4, 6) else 2
        if frozen and size > 1 and rng.random() < 0.5:
            d = rng.normal(size=slip)
            directions[i, :slip] = d / np.linalg.norm(d)
        if frozen and size > 4 and rng.random() < 0.5:
            d = rng.normal(size=2)
            directions[i, 3:] = d / np.linalg.norm(d)
    # With less friction against a given direction normal forces still press bodies apart.
    mu = 0.3 * p.mu if frozen else p.mu
    return TurningProblem(G, b, rows, mu, 0.3 * rho if frozen else rho, lower, directions if frozen else None)
