"""One-sided derivatives along a direction, at kinks whose sides have closed forms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.test_kinks import table

SPAN, DT, STEPS, G = 0.2, 0.01, 20, 9.81


def run_of(
    scene: cvi.Scene, q: np.ndarray, v: np.ndarray, force: np.ndarray, order: int, steps: int = STEPS
) -> cvi.Trajectory:
    control = np.tile(force, (steps, 1))
    return cvi.simulate(scene, q, v, control=control, duration=steps * DT, dt=DT, order=order, record="gradient")


@pytest.mark.parametrize(("order", "side"), [(2, 1.0), (2, -1.0), (4, -1.0)])
def test_a_ball_that_its_weight_just_holds_down(order: int, side: float) -> None:
    """More force lifts it, as free motion, and less leaves it where it is."""
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_sphere("ball", 0.05, mass=0.5)
    scene.set_contact(friction=0.0, restitution=0.0)
    q = pin.neutral(scene.model)
    q[2] = 0.05
    run = run_of(scene, q, np.zeros(6), 0.5 * G * np.eye(6)[2], order)
    found = cvi.directional_derivative(run, {"control": np.tile(side * np.eye(6)[2], (STEPS, 1))})
    lifted = max(side, 0.0) / 0.5
    np.testing.assert_allclose(found.v[:, 2], lifted * run.t, atol=1e-6)
    np.testing.assert_allclose(found.q[:, 2], 0.5 * lifted * run.t**2, atol=1e-6)


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_box_at_the_limit_of_its_friction(order: int, side: float) -> None:
    """More force makes it slide with it, less leaves it at rest."""
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_box("box", [0.2, 0.2, 0.1], mass=1.0)
    scene.set_contact(friction=0.3, restitution=0.0)
    q = pin.neutral(scene.model)
    q[2] = 0.05
    run = run_of(scene, q, np.zeros(6), 0.3 * G * np.eye(6)[0], order)
    found = cvi.directional_derivative(run, {"control": np.tile(side * np.eye(6)[0], (STEPS, 1))})
    np.testing.assert_allclose(found.v[:, 0], max(side, 0.0) * run.t, atol=1e-6)


def test_two_walls_that_are_hit_at_once() -> None:
    """Outcomes of a sharp corner depend on the order, so that the run jumps to one side and has a derivative to the
    other: that of the order that it took."""
    scene = cvi.Scene()
    tilt = np.array([np.sin(1.2), 0.0, np.cos(1.2)])
    scene.add_halfspace(name="left", normal=tilt)
    scene.add_halfspace(name="right", normal=tilt * [-1.0, 1.0, 1.0])
    scene.add_sphere("ball", 0.05, mass=1.0)
    scene.set_contact(friction=0.0, restitution=0.5)
    q = pin.neutral(scene.model)
    q[2] = 0.6
    steps = 33
    run = run_of(scene, q, np.zeros(6), np.zeros(6), 4, steps)
    answers = []
    for side in (1.0, -1.0):
        d = side * np.eye(6)[0]
        try:
            found = cvi.directional_derivative(run, {"q0": d})
        except cvi.NotDifferentiable as error:
            answers.append(f"refused: {error.reason}")
            continue
        ends = []
        for h in (1e-6, 5e-7):
            near = run_of(scene, pin.integrate(scene.model, q, h * d), np.zeros(6), np.zeros(6), 4, steps)
            ends.append(np.r_[near.q[-1, :3] - run.q[-1, :3], near.v[-1, :3] - run.v[-1, :3]] / h)
        got = np.r_[found.q[-1, :3], found.v[-1, :3]]
        np.testing.assert_allclose(got, 2 * ends[1] - ends[0], rtol=1e-4, atol=1e-5)
        assert found.kink is not None
        answers.append(found.kink.reason)
    assert sorted(answers) == ["refused: simultaneous", "simultaneous"]


@pytest.mark.parametrize("order", [2, 4])
def test_a_box_that_is_hit_while_it_rests(order: int) -> None:
    """Along a force on the box the impact has a kink; the derivative is that of one-sided differences."""
    scene, q, v = table()
    run = run_of(scene, q, v, np.zeros(12), order, 30)
    for side in (1.0, -1.0):
        unit = side * np.eye(12)[0]
        found = cvi.directional_derivative(run, {"control": np.tile(unit, (30, 1))})
        assert found.error < 1e-6
        ends = []
        for h in (1e-4, 5e-5):
            near = run_of(scene, q, v, h * unit, order, 30)
            ends.append(np.r_[pin.difference(scene.model, run.q[-1], near.q[-1]), near.v[-1] - run.v[-1]] / h)
        np.testing.assert_allclose(np.r_[found.q[-1], found.v[-1]], 2 * ends[1] - ends[0], atol=1e-7)


def test_without_a_kink_it_is_the_exact_one() -> None:
    scene, q, v = table()
    run = run_of(scene, q, v, np.zeros(12), 4, 10)
    found = cvi.directional_derivative(run, {"v0": np.eye(12)[6]})
    assert not found.one_sided
    assert found.kink is None
    np.testing.assert_array_equal(np.hstack([found.q, found.v]), run.sensitivity("v0").matrix[:, :, 6])
    with pytest.raises(cvi.InputError, match="direction"):
        cvi.directional_derivative(run, {"friction": [1.0]})
