"""Springs and strings in the playback: their lines as data, in the page, in files. In a browser: test_browser.py."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi
from contactvi.errors import SceneError
from contactvi.playback import animation, lines, shapes, visuals
from contactvi.playback.page import make_html
from helpers.line_scenes import hung_ball
from helpers.loop_scenes import BAR, arm_scene
from helpers.playback_data import commands, run_data, tracks

SINGLE = float(np.finfo(np.float32).eps)


@pytest.fixture(scope="module")
def ball() -> cvi.Trajectory:
    return hung_ball()


def lines_of(traj: cvi.Trajectory) -> dict[str, visuals.Visual]:
    return {visual.name: visual for visual in traj.visuals if visual.shape == "line"}


def test_lines_of_a_scene(ball):
    found = lines_of(ball)
    assert set(found) == {"tape", "string"}
    assert found["string"].joints == (0, 1)
    assert found["string"].vertices == pytest.approx(np.array([[0, 0, 1], [0, 0, 0]]))
    assert found["tape"].joints == (0, 0, 1)
    assert found["tape"].vertices == pytest.approx(np.array([[-1, 0, 0], [-0.5, 0, 0.5], [0, 0, 0]]))
    assert found["tape"].color != found["string"].color


def test_other_constraints_are_no_lines():
    scene = arm_scene(3)
    scene.add_point("world", "j3", (0.5, 0.0, 0.0), (BAR, 0.0, 0.0))
    scene.prescribe("j1", 0.0)
    assert not [visual for visual in visuals.from_scene(scene) if visual.shape == "line"]


def test_ends_are_in_the_frames_of_their_bodies():
    """A spring between two links of an arm, at places that Pinocchio gives as well."""
    scene = arm_scene(3)
    scene.add_spring("j1", "j3", 10.0, point_a=(0.1, 0, 0.05), point_b=(0.3, 0, 0))
    traj = cvi.simulate(scene, [0.4, -0.3, 0.7], duration=0.2, dt=0.01)
    frames = animation.frames_of(traj, 60.0)
    (visual,) = lines_of(traj).values()
    for joint, at, path in zip((1, 3), ((0.1, 0, 0.05), (0.3, 0, 0)), lines.path_of(visual, frames.poses), strict=True):
        pose = animation.joint_poses(scene.model, traj.resample(frames.times), [joint])[joint]
        assert path == pytest.approx(pose.position + lines.rotate(pose.quaternion, np.array(at)), abs=4 * SINGLE)
    (piece,) = lines.pieces_of(visual, frames.poses)
    tip = lines.rotate(piece.quaternion[:1], np.array([0, 0, piece.length[0]]))
    assert piece.start[:1] + tip == pytest.approx(lines.path_of(visual, frames.poses)[1][:1], abs=1e-12)


def test_turns_of_the_z_axis():
    rng = np.random.default_rng(3)
    some = rng.normal(size=(200, 3))
    some[:100] = [0.0, 0.0, -1.0] + 1e-9 * some[:100]  # near the one direction that has no least turn
    some = np.concatenate([some, [[0, 0, 1], [0, 0, -1], [1, 0, 0]]])
    some /= np.linalg.norm(some, axis=1, keepdims=True)
    found = lines.turns(some)
    assert np.linalg.norm(found, axis=1) == pytest.approx(np.ones(len(some)), abs=1e-15)
    z = np.array([0.0, 0.0, 1.0])
    turned = np.array([lines.rotate(q[None], z)[0] for q in found])
    assert turned == pytest.approx(some, abs=1e-15)


def test_the_page_draws_lines(ball):
    page = make_html(ball)
    paths = [c["path"] for c in commands(page) if c["type"] == "set_object" and "/lines/" in c["path"]]
    assert [path.split("/")[3].split("_")[1] for path in paths] == ["tape", "tape", "string"]
    assert any("green: springs, dark: strings and rods" in fact["text"] for fact in run_data(page)["facts"])
    moved = {path: found for path, found in tracks(page).items() if "/lines/" in path}
    assert len(moved) == 2  # the tape's first piece stands still
    (string,) = (found for path, found in moved.items() if "string" in path)
    count = len(string[".position"]["times"])
    assert string[".position"]["values"].reshape(count, 3) == pytest.approx(np.tile([0.0, 0.0, 1.0], (count, 1)))
    chords = 20.0 * 1e-3**2 / 8.0  # between two nodes: accelerations are below 20 m/s^2
    assert string[".scale"]["values"].reshape(count, 3) == pytest.approx(np.ones((count, 3)), abs=chords)
    turns = string[".quaternion"]["values"].reshape(count, 4)
    assert np.all(np.sum(turns[1:] * turns[:-1], axis=1) > 0.9)
    fixed = [c["matrix"] for c in commands(page) if c["type"] == "set_transform" and c["path"].endswith("tape/0")]
    assert fixed[0][12:15] == pytest.approx([-1.0, 0.0, 0.0])


def test_no_lines_no_words():
    page = make_html(cvi.simulate(arm_scene(1), duration=0.1, dt=0.01))
    assert not any("lines" in fact["text"] for fact in run_data(page)["facts"])


def test_lines_are_in_the_picture_but_do_not_count_for_the_size_of_bodies(ball):
    frames = animation.frames_of(ball, 60.0)
    view = shapes.fit(ball.visuals, frames)
    corners = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.all(np.linalg.norm(corners - view["center"], axis=1) <= view["radius"] * (1 + 1e-6))
    assert view["size"] == pytest.approx(6.0 * 0.05)


def test_a_stored_run_keeps_lines_that_functions_drive(ball, tmp_path):
    loaded = cvi.Trajectory.load(ball.save(tmp_path / "run.npz"))
    assert [element.name for element in loaded.scene.elements] == ["tape"]
    before, after = lines_of(ball), lines_of(loaded)
    assert set(before) == set(after)
    for name, visual in before.items():
        assert after[name].joints == visual.joints
        np.testing.assert_array_equal(after[name].vertices, visual.vertices)
    assert make_html(loaded).count("/lines/") == make_html(ball).count("/lines/")


@pytest.mark.parametrize("sizes", [[0.0], [0.0, 1.0, 1.0], []])
def test_a_damaged_line_is_refused(ball, sizes):
    data = lines_of(ball)["string"].to_dict() | {"sizes": sizes}
    with pytest.raises(SceneError, match="line"):
        visuals.Visual.from_dict(data)
