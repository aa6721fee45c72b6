"""Gradients of costs of runs: the adjoint against the tangent, and parameters against differences of changed scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from contactvi import _core
from derivatives.differences import transpose_error
from derivatives.test_adjoint import JOINTS, chain, state_of
from derivatives.test_sensitivity import SHAPES, at_wall, falling
from helpers.sprung_arm import COLUMNS, NAMES, SPRUNG_ARM, sprung_arm

MODELS = Path(__file__).resolve().parents[2] / "models"


@pytest.mark.parametrize("mu", [0.0, 0.1, 0.8])
@pytest.mark.parametrize("shape", SHAPES)
def test_adjoint_and_tangent_of_falling_bodies(shape, mu):
    scene, q, v = falling(shape, mu=mu)
    traj = cvi.simulate(scene, q, v, record="gradient", duration=0.4, dt=0.01, order=4)
    assert len(traj.events) > 0
    assert transpose_error(traj, ["q0", "v0", "control", "restitution", *(["friction"] if mu else [])]) <= 2e-12


@pytest.mark.parametrize("order", [2, 4, 16])
@pytest.mark.parametrize("reference", ["local", "global"])
@pytest.mark.parametrize("impact", ["ctec", "dtec", "mhc"])
def test_adjoint_and_tangent_of_impact_maps(impact, reference, order):
    if (impact == "mhc" and order == 2) or (impact != "mhc" and reference == "global"):
        pytest.skip("there is none")
    scene, q, v = at_wall(0.7)
    traj = cvi.simulate(
        scene, q, v, record="gradient", duration=3.0, dt=0.01, order=order, impact=impact, mhc_reference=reference
    )
    assert len(traj.events) > 1
    assert transpose_error(traj, ["q0", "v0", "restitution"]) <= 2e-12


@pytest.mark.parametrize(
    ("joints", "order", "dt"), [("spherical", 4, 2e-3), ("spherical", 8, 2e-3), ("revolute", 8, 0.01)]
)
def test_steps_in_which_the_iterations_diverge(joints, order, dt):
    """So stiff that the transposed equations have to be solved by their matrix."""
    scene, rng = chain(JOINTS[joints], 5)
    for k in range(len(JOINTS[joints])):
        scene.set_joint(f"j{k}", stiffness=1e5, damping=1e2)
    scene.add_spring("b1", "world", 1e5, point_a=(0.1, 0.2, 0.0), point_b=(1.0, 0.0, 0.5), damping=10.0)
    q, v, _ = state_of(scene, rng)
    assert _core.derivative_costs(scene.core(), q, 0.01 * v, dt, order=order)["adjoint_iterations"] == 0
    traj = cvi.simulate(scene, q, 0.01 * v, record="gradient", duration=6 * dt, dt=dt, order=order, solver_tol=1e-14)
    assert traj.stats.halved == 0
    assert transpose_error(traj, ["q0", "v0"]) <= 2e-12


def test_long_steps_with_impacts():
    scene, _, _ = at_wall(0.7)
    q, v = np.array([0.3, 0.2]), np.array([-12.0, 8.4])
    traj = cvi.simulate(scene, q, v, record="gradient", duration=1.5, dt=0.15, order=8, solver_tol=1e-14)
    assert traj.stats.halved == 0
    assert len(traj.events) > 1
    assert transpose_error(traj, ["q0", "v0"]) <= 2e-12


def test_a_cost_is_a_function_of_the_nodes():
    scene, q, v = at_wall(0.7)
    traj = cvi.simulate(scene, q, v, record="gradient", duration=0.9, dt=0.01, order=4)

    def cost(t, q, v):
        return float((q**2).sum() + v[-1] @ v[-1]), 2.0 * q, np.vstack([np.zeros((len(t) - 1, 2)), 2.0 * v[-1]])

    value, found = cvi.gradient(traj, cost)
    assert value == cost(traj.t, traj.q, traj.v)[0]

    def run(d: np.ndarray) -> float:
        traj = cvi.simulate(scene, q + d[:2], v + d[2:], dense=True, duration=0.9, dt=0.01, order=4)
        return cost(traj.t, traj.q, traj.v)[0]

    step = 1e-4
    for k, exact in enumerate(np.concatenate([found["q0"], found["v0"]])):
        d = step * np.eye(4)[k]
        numbers = (8.0 * (run(d) - run(-d)) - run(2.0 * d) + run(-2.0 * d)) / (12.0 * step)
        assert abs(exact - numbers) <= 1e-8 * abs(numbers)


def test_parameters_through_impacts():
    """A turning arm on a slide with a spring, damping and a servo hits the ground with friction."""
    scene_of = sprung_arm(restitution=0.6)
    x = np.array(SPRUNG_ARM)
    q, v = np.array([0.4, -0.2]), np.array([0.0, 1.0])
    options = {"duration": 0.5, "dt": 0.005, "order": 4, "target": [0.3]}
    traj = cvi.simulate(scene_of(x), q, v, record="gradient", **options)
    assert len(traj.events) > 0
    names = list(NAMES)
    weights = np.array([0.7, -1.3, 0.4, 0.9])
    _, found = cvi.gradient(traj, (weights[:2], weights[2:]), [*names, "rest:turn", "target"])
    S = traj.sensitivity([*names, "rest:turn"])
    for name in S.names:
        assert np.allclose(weights @ S.of(name)[-1], found[name], rtol=1e-11, atol=1e-11), name
    exact = [found[name][column] for name, column in zip(NAMES, COLUMNS, strict=True)]

    def end(x: np.ndarray, target: float = 0.3) -> float:
        traj = cvi.simulate(scene_of(x), q, v, **{**options, "target": [target]})
        return float(weights @ np.concatenate([traj.q[-1], traj.v[-1]]))

    for k in range(len(x)):
        step = 1e-4 * max(abs(x[k]), 0.1)
        d = step * np.eye(len(x))[k]
        numbers = (8.0 * (end(x + d) - end(x - d)) - end(x + 2 * d) + end(x - 2 * d)) / (12.0 * step)
        assert abs(exact[k] - numbers) <= 1e-7 * max(abs(numbers), 1e-2), names[k]
    step = 1e-4
    numbers = (8.0 * (end(x, 0.3 + step) - end(x, 0.3 - step)) - end(x, 0.3 + 2 * step) + end(x, 0.3 - 2 * step)) / (
        12 * step
    )
    assert abs(found["target"].sum() - numbers) <= 1e-7 * abs(numbers)


def test_names_and_costs_that_do_not_fit_are_told():
    scene, q, v = at_wall(0.7)
    traj = cvi.simulate(scene, q, v, record="gradient", duration=0.9, dt=0.01)
    flat = np.ones(2), np.ones(2)
    for wrt, word in (("mas:joint_1", "mass"), ("mass:joint", "joint_1"), ("q0:joint_1", "q0")):
        with pytest.raises(cvi.InputError, match=word):
            cvi.gradient(traj, flat, wrt)
    for cost in (3.0, (np.ones(3), np.ones(2)), lambda t, q, v: 1.0):
        with pytest.raises(cvi.InputError):
            cvi.gradient(traj, cost)
    other = cvi.simulate(scene, q, v, record="gradient", duration=0.9, dt=0.01, order=4, impact="mhc")
    with pytest.raises(cvi.NotDifferentiable):
        cvi.gradient(other, flat, "mass:joint_1")
