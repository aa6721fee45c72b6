"""URDF models of example-robot-data that need help, and what their import says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi

ROBOTS = "example-robot-data://robots/"


def robot(file: str, **options) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_urdf(ROBOTS + file, **options)
    return scene


def test_a_joint_that_moves_no_mass_gets_an_armature():
    file = "romeo_description/urdf/romeo_laas_small.urdf"
    with pytest.raises(cvi.SceneError, match="l_gripper_joint.*armature="):
        robot(file)
    scene = robot(file, armature={"*_gripper_joint": 1e-3})
    dofs = [scene.v_index(name).start for name in ("l_gripper_joint", "r_gripper_joint")]
    assert list(scene.model.armature[dofs]) == [1e-3, 1e-3]
    assert np.count_nonzero(scene.model.armature) == 2
    assert len([n for n in scene.report.all_notes("changed", "joint") if n.text.startswith("armature 0.001")]) == 2
    with pytest.raises(cvi.InputError, match="nothing_like_it"):
        robot(file, armature={"nothing_like_it": 1e-3})
    with pytest.raises(cvi.InputError, match="armature"):
        robot(file, armature=-1.0)


def test_mimic_tags_of_unknown_joints_can_be_left_out():
    file = "alex_description/urdf/alex_psyonic_hands.urdf"
    with pytest.raises(cvi.SceneError, match="mimic=False"):
        robot(file)
    scene = robot(file, mimic=False)
    assert any("which the file does not have" in note.text for note in scene.report.suspicious)


def test_a_torso_that_slides_out_of_its_column_does_not_touch_it():
    """It is joined to the base; the start does not place it there."""
    scene = robot("tiago_description/robots/tiago.urdf")
    assert cvi.simulate(scene, duration=0.01, dt=1e-3).status.ok
    assert not [pair for pair in scene.pair_names if set(pair) == {"torso_fixed_column_link_0", "torso_lift_link_0"}]


def test_group_states_are_configurations(tmp_path: Path):
    scene = robot("talos_data/robots/talos_reduced.urdf", base="free", srdf=ROBOTS + "talos_data/srdf/talos.srdf")
    q, v = scene.named_configurations["half_sitting"]
    assert q[scene.q_index("root_joint")][2] == pytest.approx(1.01927)
    assert q[scene.q_index("leg_left_4_joint")] == pytest.approx([0.859395])
    assert not v.any()
    assert scene.configuration({"leg_left_4_joint": 0.5}, "half_sitting")[scene.q_index("leg_left_4_joint")] == 0.5


def test_a_mass_matrix_that_is_singular_in_the_neutral_pose_is_noted():
    """Two of iCub's neck joints turn about one axis there, without inertia between them."""
    notes = [
        n for n in robot("icub_description/robots/icub.urdf", base="free").report.suspicious if "inertia" in n.text
    ]
    assert any("nearly no inertia" in note.text and note.name.startswith("neck") for note in notes)
    scene = robot("icub_description/robots/icub.urdf", base="free", armature=1e-3)
    assert not any("nearly no inertia" in note.text for note in scene.report.suspicious)


def test_links_that_overlap_in_a_reference_pose_are_taken_out():
    """iCub's chest reaches 14 mm into a leg in the pose of its SRDF."""
    srdf = ROBOTS + "icub_description/srdf/icub.srdf"
    scene = robot("icub_description/robots/icub.urdf", base="free", srdf=srdf, armature=1e-3)
    scene.add_halfspace(offset=-2.0)
    q = scene.named_configurations["half_sitting"][0]
    with pytest.raises(cvi.PenetrationError, match=r"scene.disable_overlapping\(q0\)"):
        cvi.Simulator(scene, dt=1e-3).reset(q)
    assert scene.disable_overlapping(q) == [("root_link_0", "chest_0"), ("l_upper_leg_0", "chest_0")]
    assert cvi.simulate(scene, q, duration=0.01, dt=1e-3).status.ok
    q[2] -= 3.0
    assert scene.disable_overlapping(q) == []  # a robot in the ground is no property of the robot
