"""Placements, motions, Jacobians, mass matrix and bias forces without pin.Data, against Pinocchio's own."""

import numpy as np
import pinocchio as pin
import pytest

from contactvi.importing.dynamics import bias_forces, mass_matrix
from contactvi.importing.kinematics import JointChains, joint_placements


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
    return {"long": long, "empty": pin.Model(), "humanoid": pin.buildSampleModelHumanoidRandom(), "all": joints}


@pytest.mark.parametrize("name", models())
def test_as_pinocchio_finds_them(name: str):
    model = models()[name]
    if name == "all":  # depth-first, as check_joints wants it
        model = depth_first(model)
    data = model.createData()
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    pin.forwardKinematics(model, data, q)
    for mine, theirs in zip(joint_placements(model, q), data.oMi, strict=True):
        np.testing.assert_allclose(mine.homogeneous, theirs.homogeneous, rtol=0.0, atol=1e-12)
    upper = np.triu(pin.crba(model, data, q))
    wanted = upper + np.triu(upper, 1).T
    size = np.sqrt(np.diag(wanted))
    np.testing.assert_allclose(mass_matrix(model, q) / size / size[:, None], wanted / size / size[:, None], atol=1e-12)


@pytest.mark.parametrize("name", models())
def test_motions_jacobians_and_bias_forces_are_those_of_pinocchio(name: str):
    model, rng = models()[name], np.random.default_rng(2)
    model.gravity = pin.Motion(np.array([1.0, -2.0, -9.0]), np.zeros(3))
    data = model.createData()
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    v = rng.normal(size=model.nv)
    b = np.array(pin.nle(model, data, q, v))
    np.testing.assert_allclose(bias_forces(model, q, v), b, rtol=0.0, atol=1e-12 * np.abs(b).max(initial=0.0))
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    pin.computeJointJacobians(model, data, q)
    asked = [0, *rng.permutation(np.arange(1, model.njoints))[:7]]
    chains = JointChains(model, asked)
    places, J = chains.jacobians(q)
    for k, motion in enumerate(chains.motions(q, v)):
        joint = int(asked[k])
        assert_near(motion.place.homogeneous, data.oMi[joint].homogeneous)
        assert_near(places[k].homogeneous, data.oMi[joint].homogeneous)
        assert_near(motion.twist.vector, data.v[joint].vector)
        assert_near(motion.acceleration.vector, data.a[joint].vector if joint else np.zeros(6))
        assert_near(J[k], pin.getJointJacobian(model, data, joint, pin.LOCAL) if joint else np.zeros((6, model.nv)))


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
