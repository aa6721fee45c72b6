"""The Coulomb cone solver: the law itself on random problems of the kinds that steps and impacts pose."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from contactvi import _core
from helpers.cone_problems import KINDS, Problem, body, frame, frictionless, hand, mechanism, point_velocity, stack
from helpers.malloc_shim import SHIM
from oracles import cone as oracle

EPS = np.finfo(float).eps
SOLVED = 1e-12  # the solver's own tolerance, relative to the terms of a velocity


def solve(
    p: Problem, start: np.ndarray | None = None, regularize: bool = True, noise: float = 0.0, accept: float = SOLVED
):
    return _core.solve_cone(p.G, p.b, p.rows, p.mu, p.lower, p.frozen, start, regularize, noise, accept)


def check_law(p: Problem, lam: np.ndarray, residual: float) -> None:
    """Each clause of the law to a few of the solver's residuals, or to the rounding of sums of m terms.

    The residual is a velocity. An impulse may be wrong by that over the contact's own diagonal of G: beside the largest
    impulse that is `condition` times more, a number of the problem and not of the solver (1 where contacts are alike).
    """
    terms, largest = np.abs(p.b) + np.abs(p.G) @ np.abs(lam), np.abs(lam).max()
    condition = (terms / np.diag(p.G)).max() / largest if largest > 0.0 else 1.0
    limit = 4.0 * max(residual, len(p.b) * EPS) * max(1.0, condition)
    worst = oracle.law_errors(p, lam)
    assert max(worst.values()) <= limit, (p.kind, worst, limit)


def check_kind(kind: str, count: int) -> None:
    rng = np.random.default_rng([*kind.encode()])
    for _ in range(count):
        p = KINDS[kind](rng)
        lam, ok, residual, _, _ = solve(p)
        assert ok, (p, residual)
        assert residual <= SOLVED
        check_law(p, lam, residual)


def test_the_law_is_noticed():
    """Each clause fails where it is broken: contacts that open, stick, slip, turn the friction, leave the cone."""
    p = contact(np.eye(3), [-1.0, 2.0, 0.0])
    wrong = {
        "separation": [0.5, -0.25, 0.0],
        "complementarity": [2.0, -1.0, 0.0],
        "cone": [1.0, -0.8, 0.0],
        "dissipation": [1.0, -0.3, 0.4],
        "bound": [-1.0, 0.0, 0.0],
    }
    assert max(oracle.law_errors(p, np.array([1.0, -0.5, 0.0])).values()) == 0.0
    for clause, lam in wrong.items():
        assert oracle.law_errors(p, np.array(lam))[clause] > 0.05
    turned = replace(p, frozen=np.array([[0.0, 1.0]]))
    assert oracle.law_errors(turned, np.array([1.0, -0.5, 0.0]))["direction"] > 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_law(kind):
    check_kind(kind, 15)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_law_of_many(kind):
    check_kind(kind, 250)


@pytest.mark.parametrize("make", [lambda rng: body(rng, 1), lambda rng: hand(rng, 1), lambda rng: body(rng, 2),
                                  lambda rng: hand(rng, 2)])  # fmt: skip
def test_is_one_of_all_solutions(make):
    rng = np.random.default_rng(5)
    for _ in range(6):
        p = make(rng)
        lam, ok, *_ = solve(p)
        assert ok
        known = oracle.all_solutions(p)
        assert known, "the oracle found no solution"
        distance = min(np.abs(lam - other).max() for other in known)
        # The oracle's roots are good to about 1e-8, its solutions likewise.
        assert distance <= 1e-7 * np.abs(lam).max()


def test_projected_gauss_seidel_agrees():
    """Little friction: one solution, which projected Gauss-Seidel reaches too."""
    rng = np.random.default_rng(6)
    for _ in range(5):
        p = hand(rng, 3)
        p = replace(p, mu=0.1 * p.mu)
        lam, ok, *_ = solve(p)
        slow = oracle.projected_gauss_seidel(p)
        assert ok
        assert max(oracle.law_errors(p, slow).values()) <= 1e-9, "the oracle did not converge"
        # Errors of 1e-9 in velocity, times the condition of the contacts, up to 1e2.5.
        assert np.abs(lam - slow).max() <= 1e-6 * np.abs(lam).max()


@pytest.mark.parametrize(
    "make",
    [lambda rng: hand(rng, 5), lambda rng: stack(rng, 1), lambda rng: stack(rng, 3)],
)
def test_frictionless_is_least_squares(make):
    rng = np.random.default_rng(7)
    for _ in range(10):
        p = frictionless(make(rng))
        lam, ok, *_ = solve(p)
        assert ok
        # nnls stops at about 1e-10 of its data.
        np.testing.assert_allclose(
            p.b + p.G @ lam,
            oracle.frictionless_velocities(p),
            atol=1e-9 * np.abs(p.b).max(),
        )


@pytest.mark.parametrize("boxes", [1, 2, 3])
@pytest.mark.parametrize("friction", [False, True])
def test_least_norm_where_redundant(boxes, friction):
    """At rest under gravity the loads are those of least norm: equal at the corners, whatever the start."""
    rng = np.random.default_rng(8)
    b = np.zeros((4 * boxes, 3))
    b[:4, 0] = -0.0981  # all fall alike: only the lowest box comes nearer to what is below it
    p = replace(stack(rng, boxes), b=b.ravel(), mu=np.full(4 * boxes, 0.5))
    if not friction:
        p = frictionless(p)
    expected = -np.linalg.lstsq(p.G, p.b, rcond=1e-11)[0]
    normal = p.first_rows()
    np.testing.assert_allclose(expected[normal].reshape(boxes, 4).std(axis=1), 0.0, atol=1e-12)
    for start in (None, expected, expected * rng.uniform(0.0, 2.0, len(expected))):
        lam, ok, *_ = solve(p, start)
        assert ok
        # Rounding times the condition of the stack (its nonzero singular values span less than 1e3).
        np.testing.assert_allclose(lam, expected, atol=1e4 * EPS * np.abs(expected).max())


@pytest.mark.parametrize("friction", [False, True])
@pytest.mark.parametrize("relative", [1e-13, 1e-11, 1e-9])
def test_rows_that_disagree_by_rounding(friction, relative):
    """Gaps of four corners over the step: rounding over h. With it as noise the solver shares the load evenly."""
    rng = np.random.default_rng(13)
    for _ in range(10):
        p = stack(rng, 1)
        b = np.zeros((4, 3))
        b[:, 0] = -0.0981
        b *= 1.0 + relative * rng.normal(size=b.shape)
        p = replace(p, b=b.ravel(), mu=np.full(4, 0.5))
        if not friction:
            p = frictionless(p)
        even = -np.linalg.lstsq(p.G, p.b, rcond=1e-9)[0]
        noise = 10.0 * relative * 0.0981
        first, ok, *_ = solve(p, even * rng.uniform(0.5, 1.5, len(even)), noise=noise)
        assert ok
        np.testing.assert_allclose(first, even, atol=1e4 * EPS * np.abs(even).max())
        # Later contact iterations keep the share; w is the noise at most.
        later, ok, *_ = solve(replace(p, b=1.001 * p.b), first, regularize=False, noise=noise)
        assert ok
        np.testing.assert_allclose(later, 1.001 * even, atol=10.0 * noise / np.diag(p.G).min())


def test_rows_that_disagree_are_accepted_without_other_starts():
    """Two points of an edge that stick: along it their rows are one. Where these disagree by little they share it.

    The law is met only where the two press against each other up to their cones. No start leads there: the points share
    what they disagree about, and the residual says so.
    """
    rng = np.random.default_rng(14)
    inverse_mass = np.diag([1.0, 1.0, 1.0, 40.0, 50.0, 60.0])
    plane = frame(np.array([0.0, 0.0, 1.0]))
    W = np.vstack([plane @ point_velocity(np.array([x, 0.0, -0.1])) for x in (-0.1, 0.1)])
    falls = W @ np.array([0.0, 0.0, -0.01, 0.0, 0.0, 0.0])
    p = Problem("edge", W @ inverse_mass @ W.T, falls, np.array([3, 3], dtype=np.int32), np.full(2, 0.7))
    for _ in range(20):
        b = falls.copy()
        b[:3] += 1e-11 * rng.uniform(0.5, 1.0) * (plane @ [1.0, 0.0, 0.0])
        p = replace(p, b=b)
        lam, ok, *_, fallbacks = solve(p)
        assert fallbacks > 0
        assert not ok
        np.testing.assert_allclose(lam.reshape(2, 3)[:, 0], 5e-3, rtol=1e-8)
        lam, ok, residual, _, fallbacks = solve(p, accept=1e-7)
        assert fallbacks == 0
        assert not ok
        assert residual <= 1e-9
        np.testing.assert_allclose(lam.reshape(2, 3)[:, 0], 5e-3, rtol=1e-8)
        np.testing.assert_allclose(lam.reshape(2, 3)[:, 1:], 0.0, atol=1e-11)
        check_law(p, lam, residual)


def test_speeds_below_the_noise_ask_for_no_other_start():
    """In a step of rounding length the gaps' noise over its length is larger than any speed of the corners."""
    rng = np.random.default_rng(15)
    p = stack(rng, 1)
    even = solve(replace(p, b=np.tile([-0.01, 0.0, 0.0], 4)))[0]
    for noise in (1e-7, 1e-4):
        q = replace(p, b=noise * 1e-2 * rng.normal(size=len(p.b)))
        lam, ok, residual, _, fallbacks = solve(q, even, regularize=False, noise=noise)
        assert ok
        assert residual <= 1e-12
        assert fallbacks == 0
        assert np.abs(q.b + q.G @ lam).max() <= noise


def test_three_loaded_corners_are_no_answer():
    """An exact solution as the start is not returned where another split has less norm."""
    p = frictionless(stack(np.random.default_rng(9), 1))
    p = replace(p, b=np.full(4, -1.0))
    quarter = -np.linalg.pinv(p.G) @ p.b
    two = quarter * [2.0, 0.0, 0.0, 2.0]
    np.testing.assert_allclose(p.G @ two, -p.b, atol=1e-12)
    np.testing.assert_allclose(solve(p, two)[0], quarter, rtol=1e-9)
    np.testing.assert_allclose(solve(p, two, regularize=False)[0], two, rtol=1e-12)


def test_frozen_direction_holds_whatever_the_slip():
    rng = np.random.default_rng(10)
    for _ in range(20):
        p = hand(rng, 1)
        d = rng.normal(size=2)
        d /= np.linalg.norm(d)
        p = replace(p, mu=np.array([0.1]), frozen=d[None, :])
        lam, ok, *_ = solve(p)
        w_n = (p.b + p.G @ lam)[0]
        assert ok
        np.testing.assert_allclose(lam[1:], -0.1 * lam[0] * d, atol=4 * EPS * np.abs(lam).max())
        assert min(lam[0], w_n) >= -1e-12
        assert abs(lam[0] * w_n) <= 1e-12


def test_warm_start_is_cheap():
    rng = np.random.default_rng(11)
    steps = []
    for _ in range(50):
        p = hand(rng, 4)
        lam, ok, *_ = solve(p)
        again, ok_again, _, iterations, _ = solve(p, lam, regularize=False)
        assert ok
        assert ok_again
        assert iterations <= 1
        np.testing.assert_array_less(np.abs(again - lam), 1e-9 * np.abs(lam).max() + 1e-300)
        near = replace(p, b=p.b + p.G @ (1e-3 * np.abs(lam).max() * rng.normal(size=len(lam))))
        steps.append(solve(near, lam)[3])
    assert np.median(steps) <= 3


def test_same_answer_in_other_units():
    """Impulses in other units: the residual and the path of the solver do not change but by rounding."""
    rng = np.random.default_rng(12)
    for scale in (1e-6, 1e6):
        p = hand(rng, 4)
        q = replace(p, G=p.G * scale)
        lam, ok, *_ = solve(p)
        other, ok_other, *_ = solve(q)
        assert ok
        assert ok_other
        np.testing.assert_allclose(other * scale, lam, atol=1e-9 * np.abs(lam).max())


def contact(G, b, mu=0.5, lower=0.0, rows=(3,)) -> Problem:
    n = len(rows)
    return Problem(
        "given",
        np.array(G, float),
        np.array(b, float),
        np.array(rows, int),
        np.full(n, mu),
        np.full(n, lower),
    )


ZERO = np.zeros((3, 3))
SOLVABLE = {
    "no contact": contact(np.zeros((0, 0)), [], rows=()),
    "nothing moves, opening": contact(ZERO, [1.0, 1.0, 0.0]),
    "nothing moves, at rest": contact(ZERO, [0.0, 0.0, 0.0]),
    "nothing moves, bound": contact(ZERO, [1.0, 1.0, 0.0], lower=2.0),
    "one of two moves": contact(
        np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]),
        [-1.0, 0.3, 0.0, 1.0, 0.0, 0.0],
        rows=(3, 3),
    ),
    "no friction in three rows": contact(np.eye(3), [-1.0, 0.3, 0.0], mu=0.0),
    "opposite walls at rest": contact([[1.0, -1.0], [-1.0, 1.0]], [0.0, 0.0], rows=(1, 1)),
    "rank one": contact(np.ones((4, 4)), [-1.0] * 4, rows=(1, 1, 1, 1)),
    "one freedom, three rows": mechanism(np.random.default_rng(3), 1),
}


@pytest.mark.parametrize("name", SOLVABLE)
@pytest.mark.parametrize("regularize", [True, False])
def test_degenerate(name, regularize):
    lam, ok, residual, *_ = solve(SOLVABLE[name], None, regularize)
    assert ok
    assert residual <= SOLVED
    assert max(oracle.law_errors(SOLVABLE[name], lam).values()) <= SOLVED


UNSOLVABLE = {
    "nothing moves, closing": contact(ZERO, [-1.0, 0.0, 0.0]),
    "squeezed by opposite walls": contact([[1.0, -1.0], [-1.0, 1.0]], [-1.0, -1.0], rows=(1, 1)),
    "matrix not a number": contact(np.full((3, 3), np.nan), [-1.0, 0.0, 0.0]),
    "matrix infinite": contact(np.diag([np.inf, 1.0, 1.0]), [-1.0, 0.0, 0.0]),
    "velocity not a number": contact(np.eye(3), [-1.0, np.nan, 0.0]),
    "friction not a number": contact(np.eye(3), [-1.0, 1.0, 0.0], mu=np.nan),
    "bound not a number": contact(np.eye(3), [-1.0, 1.0, 0.0], lower=np.nan),
    "two rows": contact(np.eye(2), [-1.0, 1.0], rows=(2,)),
    "too few rows": contact(np.eye(6), [-1.0] * 6),
    "pulling matrix": contact(-np.eye(3), [-1.0, 0.3, 0.0]),
}


@pytest.mark.parametrize("name", UNSOLVABLE)
@pytest.mark.parametrize("regularize", [True, False])
def test_says_so_where_there_is_no_solution(name, regularize):
    lam, ok, residual, *_ = solve(UNSOLVABLE[name], None, regularize)
    assert not ok
    assert residual > SOLVED
    assert np.isfinite(lam).all()


def test_start_that_is_not_finite_is_forgotten():
    p = contact(np.eye(6), [-1.0, 0.3, 0.0, -1.0, 2.0, 0.0], rows=(3, 3))
    lam, ok, *_ = solve(p, np.full(6, np.nan))
    assert ok
    np.testing.assert_allclose(lam, [1.0, -0.3, 0.0, 1.0, -0.5, 0.0], atol=1e-15)


PROGRAM = """
import ctypes
import numpy as np
from helpers.cone_problems import KINDS
from contactvi import _core

count = ctypes.CDLL(None).malloc_calls
count.restype = ctypes.c_long
rng = np.random.default_rng(0)
for kind in ("hand 4", "stack 12", "body 4"):
    for _ in range(10):  # some of body 4 need Gauss-Seidel sweeps
        p = KINDS[kind](rng)
        def calls(n):
            before = count()
            _core.cone_seconds(p.G, p.b, p.rows, p.mu, p.lower, p.frozen, None, True, n, 1)
            return count() - before
        calls(1)
        assert calls(20) == calls(1), (kind, calls(20), calls(1))
"""


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler for the malloc shim")
def test_allocates_nothing(tmp_path):
    source, shim = tmp_path / "shim.c", tmp_path / "shim.so"
    source.write_text(SHIM)
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-O1", "-o", str(shim), str(source), "-ldl"],
        check=True,
    )
    env = dict(
        os.environ,
        LD_PRELOAD=str(shim),
        PYTHONPATH=os.pathsep.join(p for p in sys.path if p),
    )
    # Run from elsewhere: the package's source folder has no engine where the package is installed.
    subprocess.run([sys.executable, "-c", PROGRAM], check=True, env=env, cwd=tmp_path)
