"""Where joints are, found without pin.Data, against Pinocchio's own."""

import numpy as np
import pinocchio as pin
import pytest

from contactvi.importing.kinematics import JointChains, joint_placements
from helpers.trees import models


@pytest.mark.parametrize("name", models())
def test_places_are_those_of_pinocchio(name: str):
    """To the rounding of a sum over at most 60 joints, some 200 m long."""
    model, rng = models()[name], np.random.default_rng(2)
    data = model.createData()
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    pin.forwardKinematics(model, data, q)
    for mine, theirs in zip(joint_placements(model, q), data.oMi, strict=True):
        np.testing.assert_allclose(mine.homogeneous, theirs.homogeneous, rtol=0.0, atol=1e-12)
    asked = [0, *map(int, rng.permutation(np.arange(1, model.njoints))[:7]), 0]
    chains = JointChains(model, asked)
    for joint, place, pose in zip(asked, chains.places(q), chains.poses(q), strict=True):
        np.testing.assert_allclose(place.homogeneous, data.oMi[joint].homogeneous, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(pose, pin.SE3ToXYZQUAT(place), rtol=0.0, atol=1e-15)
