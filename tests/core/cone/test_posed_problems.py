"""The contact problems that steps pose, as a simulator keeps them, and the solver that takes them with equations."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi
from contactvi import _core
from helpers.block_problems import BlockProblem, heap
from helpers.constrained_scenes import joined_balls
from helpers.posed_problems import record
from oracles import block_contact as oracle

H = 1e-3
G = 9.81


def box_at_rest() -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.2, 0.2, 0.1), mass=2.0)
    scene.set_contact(restitution=0.0, friction=0.5)
    q = scene.neutral()
    q[2] = 0.05
    return scene, q, np.zeros(6)


def solved(p: BlockProblem) -> tuple[np.ndarray, np.ndarray]:
    """Impulses and velocity."""
    q = p.solver().solve(p.start, tolerance=1e-12, accept=1e-12)
    assert q["residual"] <= 1e-10
    return np.array(q["impulses"]), np.array(q["v"])


def test_of_a_box_at_rest_the_impulses_bear_the_weight():
    for mode in ("steps", "events"):
        problems = record(*box_at_rest(), 5 * H, H, mode)
        assert len(problems) == 5
        for p in problems:
            assert (p.rows == 3).all()
            assert (p.mu == 0.5).all()
            lam, v = solved(p)
            assert max(oracle.law_errors(p, lam).values()) <= 1e-12
            np.testing.assert_allclose(v, oracle.velocity(p, lam), atol=1e-14)
            # The position impulse holds the mean velocity of the step, half of what gravity adds.
            assert lam[p.first_row].sum() == pytest.approx(0.5 * 2.0 * G * H, rel=1e-8)


@pytest.mark.parametrize("mode", ["steps", "events"])
def test_equations_hold_and_add_impulses_of_their_own(mode: str):
    scene, q, v = joined_balls(0.5)
    q = scene.assemble(q)
    problems = record(scene, q, scene.consistent_velocity(q, v), 0.1, H, mode, count=10)
    assert len(problems) == 10
    for p in problems:
        A = p.equations
        assert A is not None
        assert A.shape == (len(p.v_free), 3)
        lam, v = solved(p)
        scale = np.abs(p.v_free).max()
        np.testing.assert_allclose(A.T @ v, A.T @ p.v_free, atol=1e-12 * scale)
        # What the contacts leave of M (v - v_free) is an impulse of the equations.
        rest = p.dense_mass() @ (v - p.v_free) - p.dense_rows().T @ lam
        left = rest - A @ np.linalg.lstsq(A, rest, rcond=None)[0]
        assert np.abs(left).max() <= 1e-10 * max(np.abs(rest).max(), np.abs(lam).max())
        w = p.dense_rows() @ v + p.offset
        assert w[p.first_row].min() >= -1e-9 * scale
        assert np.abs(w[p.first_row] * lam[p.first_row]).max() <= 1e-9 * scale * np.abs(lam).max()


def test_no_equations_are_the_problem_itself():
    for seed in range(5):
        p = heap(np.random.default_rng(seed), robots=1)
        lam = p.solver().solve(p.start)["impulses"]
        empty = BlockProblem(**{**p.__dict__, "equations": np.zeros((len(p.v_free), 0))})
        v = empty.solver().solve(p.start)["v"]
        np.testing.assert_allclose(v, oracle.velocity(p, np.array(lam)), atol=1e-5 * np.abs(p.v_free).max())


def test_equations_need_as_many_rows_as_velocities():
    p = heap(np.random.default_rng(0))
    with pytest.raises(cvi.ContactviError, match="expected equations"):
        BlockProblem(**{**p.__dict__, "equations": np.zeros((3, 1))}).solver()


def test_joint_friction_is_a_row_of_solve_cone():
    for box, expected in ((0.5, -0.5), (2.0, -1.0)):
        args = (np.array([[2.0]]), np.array([2.0]), np.array([1], np.int32), np.zeros(1), np.zeros(1))
        assert _core.solve_cone(*args, box=np.array([box]))[0] == pytest.approx([expected])


def test_islands_keep_no_problems():
    scene, *_ = box_at_rest()
    simulator = _core.Simulator(scene.core(), _core.SimulatorOptions())
    with pytest.raises(cvi.ContactviError, match="all bodies together"):
        simulator.keep_problems()


def test_problems_are_handed_over_once():
    scene, q, v = box_at_rest()
    options = _core.SimulatorOptions()
    options.islands = False
    simulator = _core.Simulator(scene.core(), options)
    simulator.keep_problems()
    simulator.reset(q, v)
    simulator.advance(2)
    posed = simulator.take_problems()
    assert posed["contact"]
    assert not posed["dense"]
    assert simulator.take_problems() == {"dense": [], "contact": []}
