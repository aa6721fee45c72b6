"""Motions, Jacobians, mass matrix and bias forces in public coordinates, without pin.Data, against Pinocchio's own."""

import pickle

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi import _core
from contactvi.importing.engine_model import engine_model
from contactvi.importing.kinematics import JointChains, joint_placements
from helpers.chains import JOINTS, chain
from helpers.trees import bushy_model


def models() -> dict[str, pin.Model]:
    long = pin.Model()
    for k in range(60):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -3.0]))
        joint = long.addJoint(k, (pin.JointModelRX, pin.JointModelRY)[k % 2](), place, f"j{k}")
        long.appendBodyToJoint(joint, pin.Inertia.FromBox(1e-6, 1e-3, 2e-3, 3e-3), pin.SE3.Random())
    long.armature = 1e-9 * np.ones(long.nv)
    joints = pin.Model()
    kinds = (
        pin.JointModelFreeFlyer(), pin.JointModelPlanar(), pin.JointModelTranslation(), pin.JointModelSpherical(),
        pin.JointModelRUBZ(), pin.JointModelHX(0.1), pin.JointModelPY(),
        pin.JointModelRevoluteUnaligned(np.array([0.6, 0.0, 0.8])), pin.JointModelHelicalUnaligned(np.eye(3)[1], 0.2),
    )  # fmt: skip
    for k, kind in enumerate(kinds):
        joint = joints.addJoint(k // 2, kind, pin.SE3.Random(), f"j{k}")
        joints.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Random())
    return {
        "long": long, "empty": pin.Model(), "humanoid": pin.buildSampleModelHumanoidRandom(), "all": joints,
        "bush": bushy_model(), **{name: chain(kinds)[0].model for name, kinds in JOINTS.items()},
    }  # fmt: skip


@pytest.mark.parametrize("name", models())
def test_places_and_mass_matrix_are_those_of_pinocchio(name: str):
    model = models()[name]
    if name == "all":  # Pinocchio's crba wants depth-first order
        model = depth_first(model)
    data = model.createData()
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    pin.forwardKinematics(model, data, q)
    for mine, theirs in zip(joint_placements(model, q), data.oMi, strict=True):
        assert_near(mine.homogeneous, theirs.homogeneous)
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
    assert_near(np.asarray(own.bias_forces(q, v)), np.array(pin.nle(model, data, q, v)))
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    pin.computeJointJacobians(model, data, q)
    asked = np.array([0, *rng.permutation(np.arange(1, model.njoints))[:7]])
    R, p, J = own.jacobians(asked, q)
    R_moving, p_moving, twists = own.motions(asked, q, v)
    np.testing.assert_array_equal(R, R_moving)
    np.testing.assert_array_equal(p, p_moving)
    chains = JointChains(model, asked).places(q)
    for k, joint in enumerate(map(int, asked)):
        assert_near(R[k], data.oMi[joint].rotation)
        assert_near(p[k], data.oMi[joint].translation)
        assert_near(chains[k].homogeneous, data.oMi[joint].homogeneous)
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


def depth_first(model: pin.Model) -> pin.Model:
    """Return the model with each joint's whole subtree before its next sibling."""
    result, number = pin.Model(), {0: 0}

    def add(i: int) -> None:
        parent = number[model.parents[i]]
        number[i] = result.addJoint(parent, model.joints[i], model.jointPlacements[i], model.names[i])
        result.appendBodyToJoint(number[i], model.inertias[i], pin.SE3.Identity())
        for k in range(i + 1, model.njoints):
            if model.parents[k] == i:
                add(k)

    for k in range(1, model.njoints):
        if model.parents[k] == 0:
            add(k)
    return result
