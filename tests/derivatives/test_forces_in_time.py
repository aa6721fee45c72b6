"""Derivatives where forces depend on time and an event, whose time moves, lies before or at the end of a step."""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import transpose_error
from derivatives.test_constraint_sensitivity import TOUCHING
from derivatives.test_persistent_sensitivity import MOVING, RUNS, body
from helpers import constrained_scenes as scenes
from helpers.thinning import every

BAR = 1e-7

# Contacts that slide, stick, roll, bounce, break loose, come to rest and are released.
CHANGES = {
    "a ball slips and rolls": ["begin", "stick", "slip"],
    "a ball bounces to rest": ["bouncing ended", "begin", "stick"],
    "a corner slips, and comes to rest": ["begin", "slip"],
    "a box sticks on a corner and an edge": ["begin", "slip", "begin", "release"],
    "a ball slips in a trough, and leaves a wall": ["begin", "begin", "release", "release", "begin", "begin"],
    "a wall is hit": ["begin", "release", "begin"],
    "an arm comes to rest": ["begin", "stick", "slip"],  # as a whole: forces and reactions alone act until it slips
    "an arm with joint friction": ["begin", "release"],
    "a ball slips, and leaves a ball": ["begin", "release"],
    "a ball rolls, slips, leaves a ball": ["begin", "slip", "release"],
}
BESIDE_CONSTRAINTS = [
    "a linkage bounces off a stop",
    "a linkage strikes a ball, with friction",
    "a driven arm bounces",
    "a driven arm comes to rest",
    "a ball with a pendulum slips and rolls",
    "a ball with a box rolls off another",
    "a towed ball leaves another",
    "a ball leaves a moved plate",
]


def shake(scene: cvi.Scene, seed: int) -> None:
    """Let forces of a third of the weights act on all degrees of freedom, which swing with 5 to 40 rad/s."""
    rng = np.random.default_rng(seed)
    M = np.diag(pin.crba(scene.model, scene.model.createData(), pin.neutral(scene.model)))
    size = 0.3 * 9.81 * M * rng.standard_normal(scene.nv)
    rate, phase = rng.uniform(5, 40, scene.nv), rng.uniform(0, 6, scene.nv)
    none = np.zeros((scene.nv, scene.nv))
    scene.add_force(lambda t, q, v: size * np.sin(rate * t + phase), lambda t, q, v: (none, none))


def compare(scene: cvi.Scene, q: np.ndarray, v: np.ndarray, **options) -> cvi.Trajectory:
    """Compare tangents with differences of runs, and the adjoint with the tangent."""
    found = cvi.check_gradient(scene, q, v, columns=6, tolerance=BAR, **options)
    assert found.ok
    assert sum(column.believe == "both" for column in found.columns) >= 4
    traj = cvi.simulate(scene, q, v, record="gradient", **options)
    assert transpose_error(traj, ["q0", "v0", "control"]) <= 2e-12
    return traj


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    ("name", "order"),
    every(
        4, ((name, order) for name in CHANGES for order in (2, 4, 8) if (name, order) != ("a ball bounces to rest", 2))
    ),
)
def test_contacts(name, order):
    make, duration, _, _ = RUNS[name]
    scene, q, v = make()
    shake(scene, len(name))
    traj = compare(scene, q, v, duration=duration, dt=0.01, order=order)
    found = [change.change for change in traj.contact_changes]
    assert found[: len(CHANGES[name])] == CHANGES[name]
    assert (traj.stats.contact_steps > 0) == (order == 2)


@pytest.mark.parametrize(("name", "order"), every(3, itertools.product(BESIDE_CONSTRAINTS, (2, 4))))
def test_beside_constraints(name, order):
    start, duration, _, _ = TOUCHING[name]
    scene, q, v = start()
    shake(scene, len(name))
    compare(scene, *scenes.on_constraints(scene, q, v), duration=duration, dt=0.01, order=order)


@pytest.mark.filterwarnings("ignore::contactvi.DenseStepWarning")
@pytest.mark.parametrize(("e", "mu"), [(0.0, 0.0), (0.0, 0.9)])
def test_dense_steps_that_begin_at_an_event(e, mu):
    scene, q, v = scenes.balls_on_a_lift(e, mu)
    shake(scene, 3)
    options = {"contact_mode": "auto", "max_impacts_per_step": 1, "duration": 0.1, "dt": 0.02}
    assert len(compare(scene, *scenes.on_constraints(scene, q, v), **options).dense_steps) > 0


@pytest.mark.parametrize("order", [2, 4, 16])
def test_a_function_is_asked_between_the_ends_of_the_run_alone(order):
    """A table that ends with the run has no values after it."""
    scene, q, v = body("ball", 0.105, MOVING, 0.1, e=0.5)
    times: list[float] = []

    def wrench(t: float) -> np.ndarray:
        times.append(t)
        return np.array([np.sin(20 * t), np.cos(30 * t), 2.0 * np.sin(10 * t)])

    scene.add_wrench("body", force=wrench)
    traj = compare(scene, q, v, duration=0.2, dt=0.01, order=order)
    assert len(traj.events) > 0
    assert min(times) >= 0.0
    assert max(times) <= 0.2


@pytest.mark.parametrize("order", [2, 4])
def test_a_function_is_not_asked_before_a_slip_that_begins_with_the_run(order):
    scene, q, v = body("ball", 0.1 / np.cos(0.3), [0.0] * 6, 0.05, tilt=0.3)
    times: list[float] = []

    def wrench(t: float) -> np.ndarray:
        times.append(t)
        return np.array([0.1 * np.sin(20 * t), 0.1 * np.cos(30 * t), 0.0])

    scene.add_wrench("body", force=wrench)
    traj = cvi.simulate(scene, q, v, 0.1, dt=0.01, order=order, record="gradient")
    assert traj.contacts.array("mode")[0] == 1  # slips
    assert transpose_error(traj, ["control"]) <= 2e-12
    assert 0.0 <= min(times) <= max(times) <= 0.1


def test_a_force_that_jumps_where_a_stage_lies_beside_an_event_has_none():
    scene, q, v = body("ball", 0.105, MOVING, 0.0, e=0.5)
    options = {"duration": 0.2, "dt": 0.01, "order": 2}
    hit = cvi.simulate(scene, q, v, **options).events[0].time
    end = 0.01 * np.ceil(hit / 0.01)
    middle = 0.5 * (hit + end)  # of the rest of the step: its stage
    scene.add_wrench("body", force=lambda t: [0.0, 0.0, -5.0 * (t > middle - 1e-4)])
    with pytest.raises(cvi.NotDifferentiable, match="smoothly with time") as caught:
        cvi.simulate(scene, q, v, record="gradient", **options).sensitivity()
    assert caught.value.reason == "time"
