"""Random Coulomb cone problems of the kinds that steps and impacts pose, for tests and benchmarks.

Rows of a contact: (n, t1, t2), or one row (frictionless contact, joint limit). G = W M^-1 W^T, b = W v.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from helpers.contact_rows import frame, point_velocity


@dataclass(frozen=True)
class Problem:
    """w = b + G lambda; G (m, m) [1/kg], b (m,) [m/s], per contact rows 1 or 3, mu, lower [N s], frozen (n, 2)."""

    kind: str
    G: np.ndarray
    b: np.ndarray
    rows: np.ndarray
    mu: np.ndarray
    lower: np.ndarray = field(default_factory=lambda: np.zeros(0))
    frozen: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.lower.size == 0:
            object.__setattr__(self, "lower", np.zeros(len(self.rows)))

    def first_rows(self) -> np.ndarray:
        return np.cumsum(self.rows) - self.rows


def _friction(rng: np.random.Generator, contacts: int) -> np.ndarray:
    return rng.uniform(0.1, 1.0, contacts)


def _problem(kind: str, W: np.ndarray, inverse_mass: np.ndarray, v: np.ndarray, mu: np.ndarray) -> Problem:
    return Problem(kind, W @ inverse_mass @ W.T, W @ v, np.full(len(mu), 3), mu)


def body(rng: np.random.Generator, contacts: int) -> Problem:
    """One free body with contacts on its lower half, thrown against them."""
    inverse_mass = np.diag(np.r_[np.full(3, 1.0), 10.0 ** rng.uniform(0.0, 1.5, 3)])
    rows = []
    for _ in range(contacts):
        normal = rng.normal(size=3)
        normal[2] = abs(normal[2]) + 0.3
        rows.append(frame(normal) @ point_velocity(rng.uniform(-0.5, 0.5, 3) - [0.0, 0.0, 0.5]))
    v = np.r_[rng.normal(size=2), -rng.uniform(0.0, 2.0), rng.normal(size=3)]
    return _problem(f"body {contacts}", np.vstack(rows), inverse_mass, v, _friction(rng, contacts))


def hand(rng: np.random.Generator, fingers: int) -> Problem:
    """Fingers of three joints of very different inertia on one object: anisotropic and coupled."""
    nv = 6 + 3 * fingers
    inverse_mass = np.zeros((nv, nv))
    inverse_mass[:6, :6] = np.diag(np.r_[np.full(3, 1.0 / rng.uniform(0.1, 1.0)), 10.0 ** rng.uniform(2.0, 4.0, 3)])
    rows = []
    for i in range(fingers):
        own = slice(6 + 3 * i, 9 + 3 * i)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        inverse_mass[own, own] = turn @ np.diag(10.0 ** rng.uniform(2.0, 4.5, 3)) @ turn.T
        normal = rng.normal(size=3)
        W = np.zeros((3, nv))
        W[:, :6] = frame(normal) @ point_velocity(-0.03 * normal / np.linalg.norm(normal))
        W[:, own] = -frame(normal) @ rng.normal(size=(3, 3)) * 0.05
        rows.append(W)
    v = rng.normal(size=nv) * np.r_[np.full(6, 0.3), np.full(nv - 6, 3.0)]
    return _problem(f"hand {fingers}", np.vstack(rows), inverse_mass, v, _friction(rng, fingers))


def stack(rng: np.random.Generator, boxes: int) -> Problem:
    """Boxes upon each other, four corners each: redundant. At rest, sliding or thrown down, with gravity."""
    corners = [np.array([x, y, -0.5]) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    nv = 6 * boxes
    inverse_mass = np.zeros((nv, nv))
    rows = []
    for i in range(boxes):
        mass = 10.0 ** rng.uniform(-0.5, 0.5)
        inverse_mass[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = np.diag(np.r_[np.ones(3), np.full(3, 6.0)]) / mass
        for corner in corners:
            W = np.zeros((3, nv))
            W[:, 6 * i : 6 * i + 6] = frame(np.array([0.0, 0.0, 1.0])) @ point_velocity(corner)
            if i > 0:
                W[:, 6 * i - 6 : 6 * i] = -frame(np.array([0.0, 0.0, 1.0])) @ point_velocity(corner + [0.0, 0.0, 1.0])
            rows.append(W)
    v = np.zeros((boxes, 6))
    v[:, 2] = -9.81 * 0.01
    what = rng.integers(3)
    if what == 1:
        v[:, [0, 1, 5]] += rng.normal(size=(boxes, 3)) * 0.3
    elif what == 2:
        v += rng.normal(size=(boxes, 6)) * 0.3
    W = np.vstack(rows)
    mu = np.repeat(_friction(rng, boxes), 4)
    return _problem(f"stack {4 * boxes}", W, inverse_mass, v.ravel(), mu)


def mechanism(rng: np.random.Generator, contacts: int) -> Problem:
    """Two joints that carry contacts with friction: fewer freedoms than rows."""
    turn = np.linalg.qr(rng.normal(size=(2, 2)))[0]
    inverse_mass = turn @ np.diag(10.0 ** rng.uniform(-1.0, 1.0, 2)) @ turn.T
    return _problem(
        f"mechanism {contacts}", rng.normal(size=(3 * contacts, 2)), inverse_mass, rng.normal(size=2),
        _friction(rng, contacts),
    )  # fmt: skip


def frictionless(problem: Problem) -> Problem:
    """The normal rows alone."""
    n = problem.first_rows()
    ones = np.ones(len(n), dtype=int)
    return Problem(
        problem.kind + " lcp",
        problem.G[np.ix_(n, n)],
        problem.b[n],
        ones,
        np.zeros(len(n)),
    )


def mixed(rng: np.random.Generator, problem: Problem) -> Problem:
    """Some contacts without friction (one row), some of three rows with mu = 0."""
    rows = np.where(rng.uniform(size=len(problem.rows)) < 0.4, 1, 3)
    keep = np.concatenate([np.arange(f, f + r) for f, r in zip(problem.first_rows(), rows, strict=True)])
    mu = np.where((rows == 1) | (rng.uniform(size=len(rows)) < 0.2), 0.0, problem.mu)
    return Problem(
        problem.kind + " mixed",
        problem.G[np.ix_(keep, keep)],
        problem.b[keep],
        rows,
        mu,
    )


def bounded(rng: np.random.Generator, problem: Problem) -> Problem:
    """Lower bounds of the size of the impulses, for some contacts."""
    n = problem.first_rows()
    size = np.abs(problem.b[n]).max() / np.diag(problem.G)[n].max()
    lower = rng.uniform(0.0, 1.0, len(n)) * size * (rng.uniform(size=len(n)) < 0.7)
    return replace(problem, kind=problem.kind + " bounded", lower=lower)


def frozen(rng: np.random.Generator, problem: Problem) -> Problem:
    """Given slip directions, near those of the slip, for some contacts; no friction that would jam (Painleve)."""
    directions, mu = np.full((len(problem.rows), 2), np.nan), problem.mu.copy()
    for i, row in enumerate(problem.first_rows()):
        if problem.rows[i] == 3 and rng.uniform() < 0.6:
            d = problem.b[row + 1 : row + 3] + 0.1 * rng.normal(size=2)
            directions[i] = d / np.linalg.norm(d)
            coupling = np.linalg.norm(problem.G[row, row + 1 : row + 3])
            mu[i] = min(mu[i], 0.5 * problem.G[row, row] / max(coupling, 1e-300))
    return replace(problem, kind=problem.kind + " frozen", frozen=directions, mu=mu)


def skewed(rng: np.random.Generator, problem: Problem) -> Problem:
    """G as a step poses it: not symmetric, by O(h)."""
    noise = 1.0 + 1e-3 * rng.normal(size=problem.G.shape)
    return replace(problem, kind=problem.kind + " skewed", G=problem.G * noise)


Maker = Callable[[np.random.Generator], Problem]

# The kinds in the order of the benchmark's table: what a step or an impact poses most often comes first.
PLAIN: dict[str, Maker] = {
    "body 1": lambda rng: body(rng, 1),
    "body 2": lambda rng: body(rng, 2),
    "hand 1": lambda rng: hand(rng, 1),
    "hand 3": lambda rng: hand(rng, 3),
    "hand 4": lambda rng: hand(rng, 4),
    "hand 5": lambda rng: hand(rng, 5),
    "plate 4": lambda rng: replace(stack(rng, 1), kind="plate 4"),
    "stack 8": lambda rng: stack(rng, 2),
    "stack 12": lambda rng: stack(rng, 3),
}
OTHER: dict[str, Maker] = {
    "body 4": lambda rng: body(rng, 4),
    "mechanism 1": lambda rng: mechanism(rng, 1),
    "hand 4 skewed": lambda rng: skewed(rng, hand(rng, 4)),
    "hand 1 skewed": lambda rng: skewed(rng, hand(rng, 1)),
    "hand 5 lcp": lambda rng: frictionless(hand(rng, 5)),
    "plate 4 lcp": lambda rng: frictionless(stack(rng, 1)),
    "stack 12 lcp": lambda rng: frictionless(stack(rng, 3)),
    "hand 5 mixed": lambda rng: mixed(rng, hand(rng, 5)),
    "stack 8 mixed": lambda rng: mixed(rng, stack(rng, 2)),
    "hand 1 bounded": lambda rng: bounded(rng, hand(rng, 1)),
    "hand 4 bounded": lambda rng: bounded(rng, hand(rng, 4)),
    "stack 8 bounded": lambda rng: bounded(rng, stack(rng, 2)),
    "hand 1 frozen": lambda rng: frozen(rng, hand(rng, 1)),
    "body 2 frozen": lambda rng: frozen(rng, body(rng, 2)),
    "plate 4 frozen": lambda rng: frozen(rng, stack(rng, 1)),
}
KINDS = {**PLAIN, **OTHER}
