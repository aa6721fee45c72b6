"""Motions, Jacobians, mass matrix and bias forces in public coordinates, without pin.Data, against Pinocchio's own."""

import pickle

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi import _core
from contactvi.importing.engine_model import engine_model
from helpers.trees import bushy_model, depth_first, models


@pytest.mark.parametrize("name", models())
def test_mass_matrix_is_that_of_pinocchio(name: str):
    model = models()[name]
    if name == "all":  # Pinocchio's crba wants depth-first order
        model = depth_first(model)
    data = model.createData()
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    upper = np.triu(pin.crba(model, data, q))
    wanted = upper + np.triu(upper, 1).T
    size = np.sqrt(np.diag(wanted))
    found = np.asarray(engine_model(model).mass_matrix(q))
    np.testing.assert_allclose(found / size / size[:, None], wanted / size / size[:, None], atol=1e-12)
    np.testing.assert_array_equal(found, found.T)


@pytest.mark.parametrize("name", models())
def test_motions_jacobians_and_bias_forces_are_those_of_pinocchio(name: str):
    model, rng = models()[name], np.random.default_rng(2)
    model.gravity = pin.Motion(np.array([1.0, -2.0, -9.0]), np.zeros(3))
    data, own = model.createData(), engine_model(model)
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    v = rng.normal(size=model.nv)
    b = np.array(pin.nle(model, data, q, v))
    np.testing.assert_allclose(own.bias_forces(q, v), b, rtol=0.0, atol=1e-12 * np.abs(b).max(initial=0.0))
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    pin.computeJointJacobians(model, data, q)
    asked = np.array([0, *rng.permutation(np.arange(1, model.njoints))[:7]])
    R, p, J = own.jacobians(asked, q)
    R_moving, p_moving, twists = own.motions(asked, q, v)
    np.testing.assert_array_equal(R, R_moving)
    np.testing.assert_array_equal(p, p_moving)
    for k, joint in enumerate(map(int, asked)):
        assert_near(R[k], data.oMi[joint].rotation)
        assert_near(p[k], data.oMi[joint].translation)
        assert_near(twists[k, 0], data.v[joint].vector)
        assert_near(twists[k, 1], data.a[joint].vector if joint else np.zeros(6))
        assert_near(J[k], pin.getJointJacobian(model, data, joint, pin.LOCAL) if joint else np.zeros((6, model.nv)))


def test_a_pickled_model_gives_equal_bits():
    model = bushy_model()
    q, v = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq)), np.ones(model.nv)
    own = engine_model(model)
    twin = pickle.loads(pickle.dumps(own))
    np.testing.assert_array_equal(twin.bias_forces(q, v), own.bias_forces(q, v))
    np.testing.assert_array_equal(twin.mass_matrix(q), own.mass_matrix(q))


def test_sizes_that_do_not_fit_are_refused():
    model = bushy_model()
    own, q = engine_model(model), pin.neutral(model)
    for call in (
        lambda: own.bias_forces(np.zeros(2), np.zeros(own.nv)),
        lambda: own.mass_matrix(np.zeros(2)),
        lambda: own.motion(q, np.zeros(own.nv), np.zeros(1)),
        lambda: own.jacobians(np.array([99]), q),
        lambda: own.jacobians(np.array([-1]), q),
        lambda: own.motion(q, np.zeros(own.nv), np.zeros(own.nv)).point(99, np.zeros(3)),
    ):
        with pytest.raises(cvi.ContactviError, match="expected"):
            call()


def test_joints_that_do_not_fit_are_refused():
    empty = _core.Model(np.zeros(3), np.zeros(3), np.zeros(4), np.zeros(4))
    joint = (np.zeros(6), np.eye(3), np.zeros(3), 1.0, np.zeros(3), np.eye(3), "j")
    with pytest.raises(cvi.ContactviError, match="before its parent"):
        empty.add_joint(_core.JointType.SPHERICAL, 1, *joint)
    with pytest.raises(cvi.ContactviError, match="a joint more"):
        empty.add_joint(_core.JointType.FREE, 0, *joint)


def assert_near(mine: np.ndarray, theirs: np.ndarray) -> None:
    """Rounding of a sum over at most 60 joints; numbers are of the size of the largest one."""
    np.testing.assert_allclose(mine, theirs, rtol=0.0, atol=1e-12 * max(1.0, np.abs(theirs).max(initial=0.0)))
