"""What handles and names of a scene mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from helpers.extras import needs_mujoco
from helpers.run_scenes import HAND_URDF


class TestHandlesOfRobotsWithAFreeBase:
    """What takes the value of a joint takes that of the base of a robot, by its handle or its name."""

    def robot(self, base: str = "free") -> tuple[cvi.Scene, cvi.PartHandle]:
        scene = cvi.Scene()
        scene.add_sphere("ball", 0.1)
        return scene, scene.add_urdf(HAND_URDF, base=base)

    def test_its_place_in_q_and_v(self):
        scene, hand = self.robot()
        (base,) = [name for name in hand.joints if name.endswith("root_joint")]
        for selector in (hand, hand.name):
            assert scene.q_index(selector) == scene.q_index(base) == slice(7, 14)
            assert scene.v_index(selector) == slice(6, 12)

    def test_its_start(self):
        scene, hand = self.robot()
        q = scene.configuration({hand: ((0.1, 0.2, 0.3), (0.0, 0.0, np.pi / 2)), "*joint_3.0": 0.4})
        np.testing.assert_allclose(q[7:14], [0.1, 0.2, 0.3, 0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-15)
        v = scene.velocity({hand: (1.0, 0.0, 0.0)}, q)
        np.testing.assert_allclose(v[6:12], [0.0, -1.0, 0.0, 0.0, 0.0, 0.0], atol=1e-15)
        assert np.count_nonzero(np.abs(v) > 1e-15) == 1

    def test_settings_are_those_of_all_joints(self):
        scene, hand = self.robot()
        scene.set_joint(hand, damping=0.3)
        v = np.ones(scene.nv)
        np.testing.assert_allclose(scene.passive_forces(scene.neutral(), v)[6:], -0.3, atol=1e-15)

    def test_a_robot_that_is_fixed_has_no_base_to_move(self):
        scene, hand = self.robot("fixed")
        with pytest.raises(cvi.InputError, match="expected one joint, got 16") as caught:
            scene.q_index(hand)
        assert "joint_0.0" in caught.value.remedy

    @needs_mujoco
    def test_parts_of_several_trees_have_none(self, tmp_path: Path):
        """Of two free bodies in one file neither is the base of both."""
        (tmp_path / "two.xml").write_text(
            "<mujoco><worldbody>"
            "<body name='a'><freejoint/><geom size='.1'/></body>"
            "<body name='b' pos='1 0 0'><freejoint/><geom size='.1'/></body>"
            "</worldbody></mujoco>"
        )
        scene = cvi.Scene()
        with pytest.raises(cvi.InputError, match="expected one joint, got 2"):
            scene.q_index(scene.add_mjcf(tmp_path / "two.xml"))
