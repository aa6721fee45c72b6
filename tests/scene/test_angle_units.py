"""Degrees in the place of radians: one warning, where a joint or a placement has less than a turn."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import contactvi as cvi
from helpers.loop_scenes import arm_scene


@pytest.mark.parametrize(
    "give",
    [
        lambda scene: scene.configuration({"j1": 90.0}),
        lambda scene: scene.set_joint("j1", limits=(-90.0, 90.0)),
        lambda scene: scene.set_joint("j1", stiffness=1.0, rest=45.0),
        lambda scene: scene.add_box("box", (0.1, 0.1, 0.1), placement=((0, 0, 3), (90.0, 0, 0))),
    ],
)
def test_degrees_are_told(give):
    with pytest.warns(cvi.AngleUnitWarning, match=r"Angles are in rad: np\.deg2rad\(") as told:
        give(arm_scene(2))
    assert len(told) == 1
    assert told[0].filename == __file__


def test_what_may_be_meant_is_not_told(tmp_path):
    """A joint without end, lengths, a turn of a placement, and the file of a model."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = arm_scene(2)
        scene.configuration({"j1": 2.0 * np.pi, "j2": -6.0})
        scene.set_joint("j1", limits=(-np.pi, np.pi))
        scene.add_urdf("models/damped_pendulum.urdf")
        scene.configuration({"hinge": 90.0})
        scene.add_box("box", (0.1, 0.1, 0.1), placement=(20.0, 0.0, 90.0))
        text = '<link name="a"/><link name="b"><inertial><mass value="1"/>'
        text += '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        text += '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>'
        text += '<limit lower="-90" upper="90" effort="1" velocity="1"/></joint>'
        (tmp_path / "turns.urdf").write_text(f'<robot name="r">{text}</robot>')
        scene.add_urdf(tmp_path / "turns.urdf")
        cvi.Scene.from_dict(scene.to_dict())
