"""Models without any shape: what is drawn of them, and that it is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.playback.animation import frames_of
from contactvi.playback.framing import fit
from contactvi.playback.lines import path_of
from contactvi.playback.open_side import trees_of
from contactvi.playback.page import page_data
from contactvi.playback.scene_visuals import from_scene
from contactvi.playback.sketch import Sketch

LINK = """<link name="{name}"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/>
  <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>{shape}</link>"""
ROBOT = """<robot name="bare"><link name="base"/>{upper}{lower}<link name="tool"/>
  <joint name="a" type="continuous"><parent link="base"/><child link="upper"/><origin xyz="0 0 1"/>
    <axis xyz="0 1 0"/></joint>
  <joint name="b" type="prismatic"><parent link="upper"/><child link="lower"/><origin xyz="0.1 0 -0.4"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
  <joint name="t" type="fixed"><parent link="lower"/><child link="tool"/><origin xyz="0 0.3 -0.4"/></joint></robot>"""
BALL = '<visual><geometry><sphere radius="0.05"/></geometry></visual>'


def scene_of(folder: Path, shape: str = "") -> cvi.Scene:
    file = folder / "bare.urdf"
    file.write_text(
        ROBOT.format(upper=LINK.format(name="upper", shape=shape), lower=LINK.format(name="lower", shape=""))
    )
    scene = cvi.Scene()
    scene.add_urdf(file)
    return scene


def run_of(folder: Path, shape: str = "") -> cvi.Trajectory:
    return cvi.simulate(scene_of(folder, shape), v0=[1.0, 0.3], duration=0.5, dt=1e-2)


def test_lines_go_from_joint_to_joint_and_to_the_tool(tmp_path):
    traj = run_of(tmp_path)
    model, frames = traj.scene.model, frames_of(traj, 50.0)
    paths = {visual.name: path_of(visual, frames.poses) for visual in traj.visuals if visual.shape == "line"}
    balls = [visual for visual in traj.visuals if visual.shape == "sphere"]
    assert [(ball.name, ball.joint) for ball in balls] == [("a", 1), ("b", 2)]
    assert set(paths) == {"to a", "to b", "of b"}
    data = model.createData()
    for row, q in enumerate(traj.resample(traj.t[0] + frames.times)):
        pin.forwardKinematics(model, data, q)
        pin.updateFramePlacements(model, data)
        a, b = (data.oMi[joint].translation for joint in (1, 2))
        tool = data.oMf[model.getFrameId("tool")].translation
        for name, ends in {"to a": (np.zeros(3), a), "to b": (a, b), "of b": (b, tool)}.items():
            found = [points[row if len(points) > 1 else 0] for points in paths[name]]
            # Frames are stored where a joint moves by a tenth of a micrometre, vertices in single precision.
            assert np.array(found) == pytest.approx(np.array(ends), abs=3e-7)


def test_the_user_is_told(tmp_path):
    traj = run_of(tmp_path)
    facts = [fact["text"] for fact in page_data(traj)["facts"]]
    assert any("grey: links of models without shapes" in fact for fact in facts)
    assert "model bare: no shapes to touch with" in str(traj.scene.report)


def test_one_shape_is_enough(tmp_path):
    traj = run_of(tmp_path, BALL)
    assert [visual.shape for visual in traj.visuals] == ["sphere"]
    assert not any("without shapes" in fact["text"] for fact in page_data(traj)["facts"])


def test_pictures_are_not_empty(tmp_path):
    traj = run_of(tmp_path)
    view = fit(traj.visuals, frames_of(traj, 50.0), trees_of(traj.scene.model))
    assert 0.5 < view.radius < 2.0  # of arms of half a metre at a height of a metre
    picture = Sketch(traj.scene, traj.q[0], size=(160, 120)).draw(traj.q[0]).astype(int)
    assert (np.abs(picture - picture[0, 0]).max(axis=2) > 30).sum() > 50


def test_a_stored_run_shows_the_same(tmp_path):
    traj = run_of(tmp_path)
    again = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    assert [(v.name, v.sizes, v.color) for v in again.visuals] == [(v.name, v.sizes, v.color) for v in traj.visuals]


def test_a_free_body_has_a_ball_at_its_centre_of_mass():
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(1, pin.Inertia(2.0, np.array([0.0, 0.1, 0.0]), np.eye(3)), pin.SE3.Identity())
    (ball,) = cvi.simulate(cvi.Scene.from_pinocchio(model), duration=0.1, dt=1e-2).visuals
    assert ball.shape == "sphere"
    assert ball.placement[:3, 3] == pytest.approx([0.0, 0.1, 0.0])


def test_lines_go_to_the_points_where_loops_are_closed(tmp_path):
    scene = scene_of(tmp_path)
    scene.add_point("world", "lower", (0.1, 0.0, 0.2), (0.0, 0.0, -0.4))
    drawn = from_scene(scene)
    to_tool, to_loop = (visual for visual in drawn if visual.name == "of b")
    assert to_tool.vertices[1] == pytest.approx([0.0, 0.3, -0.4])
    assert to_loop.vertices[1] == pytest.approx([0.0, 0.0, -0.4])
