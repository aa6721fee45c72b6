"""The cone solver with friction against spinning and rolling: the law on random problems, and the slow fixed point."""

from __future__ import annotations

import numpy as np
import pytest

from contactvi import _core
from oracles.turning_cone import TurningProblem, drawn, fixed_point, law_errors

EPS = np.finfo(float).eps
SOLVED = 1e-12  # the solver's own tolerance, relative to the terms of a velocity

KINDS = {
    "one": {"contacts": 1},
    "one, small radii": {"contacts": 1, "turn": 1e-2},
    "one body": {"contacts": 1, "dofs": 6},
    "three, small radii": {"contacts": 3, "turn": 1e-2},
    "four, bounds": {"contacts": 4, "bounded": True},
    "three, given directions": {"contacts": 3, "frozen": True},
}


def solve(p: TurningProblem, start: np.ndarray | None = None, regularize: bool = True):
    return _core.solve_turning_cone(
        p.G, p.b, np.array(p.rows, dtype=np.int32), p.mu, p.rho, p.lower, p.frozen, start, regularize
    )


@pytest.mark.parametrize("kind", KINDS)
def test_law(kind):
    """Each clause of the law to what the solver's residual makes of the impulses: it is a speed over the least G."""
    rng = np.random.default_rng([*kind.encode()])
    for _ in range(600):
        p = drawn(rng, **KINDS[kind])
        lam, ok, residual, _, _ = solve(p)
        assert ok, (p, residual)
        terms = np.abs(p.b) + np.abs(p.G) @ np.abs(lam)
        largest = np.abs(lam).max()
        condition = (terms.max() / np.diag(p.G)).max() / largest if largest > 0.0 else 1.0
        limit = 4.0 * max(residual, len(p.b) * EPS) * max(1.0, condition)
        worst = law_errors(p, lam)
        assert max(worst.values()) <= limit, (worst, limit, p)


@pytest.mark.parametrize("kind", ["one", "one body", "three, given directions"])
def test_fixed_point(kind):
    """The speeds are those of the slow fixed point, where friction is small enough for one answer."""
    rng = np.random.default_rng([*kind.encode(), 1])
    for _ in range(25):
        p = drawn(rng, **KINDS[kind])
        if np.linalg.cond(p.G) > 1e3:  # its small steps would have to be too many
            continue
        slow = fixed_point(p)
        assert max(law_errors(p, slow).values()) <= 1e-11
        lam, ok, *_ = solve(p)
        assert ok
        assert lam == pytest.approx(slow, abs=1e-9 * np.abs(slow).max())


def test_a_start_changes_no_answer():
    rng = np.random.default_rng(7)
    for _ in range(200):
        p = drawn(rng, 1)
        lam, *_ = solve(p)
        again, ok, *_ = solve(p, rng.normal(size=len(p.b)), False)
        assert ok
        assert again == pytest.approx(lam, abs=1e-8 * max(np.abs(lam).max(), 1e-3))


def test_many_contacts_of_one_body():
    """Redundant rows: of the drawn problems nearly all are solved, and what is called solved obeys the law."""
    rng, solved = np.random.default_rng(3), 0
    for _ in range(300):
        p = drawn(rng, 4, dofs=6)
        lam, ok, *_ = solve(p)
        solved += ok
        if ok:
            assert max(law_errors(p, lam).values()) <= 1e-9
    assert solved >= 297  # the rest, friction of several contacts with mu near 1, is reported as not solved


def test_spin_alone():
    """A ball that spins on a plane: G diagonal, the closed form."""
    r_s, mu = 0.002, 0.3
    G = np.diag([1.0, 3.5, 3.5, r_s**2 / 0.001])
    for spin, sticks in ((1.0, False), (0.5, True)):
        p = TurningProblem(G, np.array([-1.0, 0.0, 0.0, r_s * spin]), [4], np.array([mu]), np.zeros(1), np.zeros(1))
        lam, ok, *_ = solve(p)
        assert ok
        tau = -r_s * spin / G[3, 3]
        assert sticks == (abs(tau) <= mu)
        assert lam == pytest.approx([1.0, 0.0, 0.0, tau if sticks else -mu], abs=1e-13)
