"""Friction against spinning and rolling in the contact problem of many bodies: the law, and what is promised."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.block_problems import BlockProblem, heap, with_turning
from oracles import block_contact
from oracles.turning_cone import TurningProblem, fixed_point, law_errors

EPS = np.finfo(float).eps
ACCEPT = 1e-6


def drawn(seed: int, radius: float, **options) -> BlockProblem:
    rng = np.random.default_rng([seed, int(1e6 * radius)])
    return with_turning(heap(rng, **options), rng, 0.8, radius)


def dense(p: BlockProblem) -> tuple[TurningProblem, np.ndarray]:
    """The same problem with one matrix, and the places of its rows in those of p."""
    assert p.turning is not None
    first, places, rows = p.first_row, [], []
    friction = {int(of): int(first[k]) for k, of in enumerate(p.turning) if of >= 0}
    points = [i for i in range(len(p.rows)) if p.turning[i] < 0]
    for i in points:
        own = list(range(first[i], first[i] + p.rows[i]))
        if i in friction:
            own += range(friction[i], friction[i] + 3)
        places += own
        rows.append(len(own))
    G, b = block_contact.delassus(p), block_contact.free_speed(p)
    rho = np.array([1.0 if i in friction else 0.0 for i in points])
    at = np.array(places)
    return TurningProblem(G[np.ix_(at, at)], b[at], rows, p.mu[points], rho, p.lower[points]), at


def solved(p: BlockProblem, **options) -> dict:
    free = (p.offset >= 0.0).all() and (p.lower == 0.0).all()
    q = p.solver().solve(p.start, p.free_energy() if free else np.inf, **options)
    lam, v = np.array(q["impulses"]), np.array(q["v"])
    np.testing.assert_allclose(v, block_contact.velocity(p, lam), rtol=0.0, atol=1e-10 * max(1.0, np.abs(v).max()))
    law, at = dense(p)
    worst = law_errors(law, lam[at])
    assert max(worst["cone"], worst["bound"]) <= 8.0 * EPS  # whatever was reached
    if free:
        assert q["energy"] <= p.free_energy() * (1.0 + 1e-11)
        assert q["violation"] <= options.get("accept", ACCEPT) * q["scale"]
    if q["residual"] <= ACCEPT:
        speed = np.abs(law.b).max() + (np.abs(law.G) @ np.abs(lam[at])).max()
        condition = speed / (np.diag(law.G)[np.diag(law.G) > 0.0].min() * max(np.abs(lam).max(), 1e-300))
        assert max(worst.values()) <= 10.0 * (q["residual"] + 1e-12) * max(1.0, condition), worst
    return q


@pytest.mark.parametrize("radius", [0.3, 0.01])
def test_one_contact(radius):
    """The speeds are those of the slow fixed point."""
    for seed in range(20):
        p = drawn(seed, radius, bodies=1, contacts=1, mu=0.5)
        q = solved(p, tolerance=1e-12)
        assert q["residual"] <= 1e-11
        law, at = dense(p)
        slow = fixed_point(law)
        if max(law_errors(law, slow).values()) > 1e-9:  # its small steps would have to be too many
            continue
        np.testing.assert_allclose(law.G @ (np.array(q["impulses"])[at] - slow), 0.0, atol=1e-7)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("heap", {}),
        ("confined", {"bodies": 5, "contacts": 16}),
        ("redundant", {"redundant": 0.4}),
        ("robots", {"robots": 1, "joints": 4}),
        ("bounds", {"bounded": 0.5}),
        ("overlaps", {"overlap": 0.3}),
    ],
)
def test_law(kind, options):
    """Most of the drawn problems are solved to a ten thousandth; all impulses are in the cones."""
    reached = []
    for seed in range(30):
        for radius in (0.2, 0.01):
            p = drawn(seed, radius, mu=0.6, **options)
            if options.get("joints"):
                check_joints(p)
                continue
            reached.append(solved(p, accept=1e-4)["residual"])
    if reached:
        print(kind, np.mean(np.array(reached) <= 1e-4), np.median(reached), np.max(reached))
        assert np.mean(np.array(reached) <= 1e-4) >= 0.95


def check_joints(p: BlockProblem) -> None:
    """Beside joint friction, and reduced to what constraints leave, the answer is that of the whole problem."""
    q = p.solver().solve(p.start)
    from dataclasses import replace

    reduced = replace(p, equations=np.zeros((len(p.v_free), 0))).solver().solve(p.start)
    if max(q["residual"], reduced["residual"]) <= 1e-8:
        np.testing.assert_allclose(reduced["v"], q["v"], atol=1e-5 * max(1.0, np.abs(q["v"]).max()))
