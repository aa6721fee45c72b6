"""The motion of trees and its derivatives against Pinocchio's, which has them in its pin.Data."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from contactvi import _core
from contactvi.derivatives.constrained_dynamics import PointMotion
from contactvi.importing.engine_model import engine_model
from helpers.chains import JOINTS, chain
from helpers.trees import bushy_model


def models() -> dict[str, pin.Model]:
    return {name: chain(kinds)[0].model for name, kinds in JOINTS.items()} | {
        "humanoid": pin.buildSampleModelHumanoidRandom(), "bush": bushy_model(),
    }  # fmt: skip


def state(model: pin.Model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1, 1, model.nv))
    return q, rng.uniform(-2, 2, model.nv), rng.uniform(-3, 3, model.nv)


def assert_near(mine: np.ndarray, theirs: np.ndarray) -> None:
    """Rounding of sums of some hundred products of the size of the largest number."""
    np.testing.assert_allclose(mine, theirs, rtol=0.0, atol=1e-12 * max(1.0, np.abs(theirs).max(initial=0.0)))


@pytest.mark.parametrize("name", models())
def test_derivatives_of_forces(name: str):
    model = models()[name]
    q, v, a = state(model)
    data = model.createData()
    pin.computeRNEADerivatives(model, data, q, v, a)
    by_q, by_v = engine_model(model).motion(q, v, a).force_derivatives()
    assert_near(by_q, data.dtau_dq)
    assert_near(by_v, data.dtau_dv)


@pytest.mark.parametrize("name", models())
def test_motion_of_a_point(name: str):
    model = models()[name]
    q, v, a = state(model)
    data, x = model.createData(), np.array([0.3, -0.2, 0.5])
    pin.computeForwardKinematicsDerivatives(model, data, q, v, a)
    tree = engine_model(model).motion(q, v, a)
    for joint in range(1, model.njoints):
        found = PointMotion(*tree.point(joint, x))
        assert_near(tree.rotation(joint), data.oMi[joint].rotation)
        velocity_q, acceleration_q, acceleration_v, J = pin.getPointClassicAccelerationDerivatives(
            model, data, joint, pin.SE3(np.eye(3), x), pin.LOCAL_WORLD_ALIGNED
        )
        for mine, theirs in (
            (found.place, data.oMi[joint].act(x)), (found.J, J), (found.velocity, J @ v),
            (found.velocity_q, velocity_q), (found.acceleration_q, acceleration_q),
            (found.acceleration_v, acceleration_v),
        ):  # fmt: skip
            assert_near(mine, theirs)


@pytest.mark.parametrize("name", models())
def test_acceleration_and_turned_force_of_a_point(name: str):
    """By central differences along the motion, and of J^T f in q: errors of O(h^2), 1e-10, and of rounding, 1e-11."""
    model, h = models()[name], 1e-5
    q, v, a = state(model)
    joint, x, force = model.njoints - 1, np.array([0.3, -0.2, 0.5]), np.array([1.0, -2.0, 0.5])
    tree = engine_model(model).motion(q, v, a)

    def at(step: np.ndarray, speed: np.ndarray) -> _core.TreeMotion:
        return engine_model(model).motion(pin.integrate(model, q, step), speed, a)

    ahead, behind = at(h * v, v + h * a), at(-h * v, v - h * a)
    rate = (velocity(ahead, joint, x) - velocity(behind, joint, x)) / (2.0 * h)
    np.testing.assert_allclose(tree.point(joint, x)[2], rate, atol=1e-6 * np.abs(rate).max())
    T = tree.turned_force(joint, x, force)
    for i, d in enumerate(h * np.eye(model.nv)):
        change = (jacobian(at(d, v), joint, x) - jacobian(at(-d, v), joint, x)).T @ force / (2.0 * h)
        np.testing.assert_allclose(T[:, i], change, atol=1e-7)


def velocity(tree: _core.TreeMotion, joint: int, x: np.ndarray) -> np.ndarray:
    return PointMotion(*tree.point(joint, x)).velocity


def jacobian(tree: _core.TreeMotion, joint: int, x: np.ndarray) -> np.ndarray:
    return PointMotion(*tree.point(joint, x)).J
