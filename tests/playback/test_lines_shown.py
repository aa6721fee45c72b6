"""Springs and strings in the playback: their lines as data, in the page, in files. See also test_browser_views.py."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi
from contactvi.errors import SceneError
from contactvi.playback import animation, framing, lines, scene_visuals, visuals
from contactvi.playback.open_side import trees_of
from contactvi.playback.page import make_html
from helpers.line_scenes import hung_ball
from helpers.loop_scenes import BAR, arm_scene
from helpers.playback_data import run_data

SINGLE = float(np.finfo(np.float32).eps)


@pytest.fixture(scope="module")
def ball() -> cvi.Trajectory:
    return hung_ball()


def lines_of(traj: cvi.Trajectory) -> dict[str, visuals.Visual]:
    return {visual.name: visual for visual in traj.visuals if is_line(visual)}


def is_line(visual: visuals.Visual) -> bool:
    """Whether it is a spring or a distance, and not a link of a model without shapes."""
    return visual.shape == "line" and visual.color != visuals.NO_SHAPE_COLOR


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
    assert not [visual for visual in scene_visuals.from_scene(scene) if is_line(visual)]


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


def test_the_page_draws_lines(ball):
    data = run_data(make_html(ball))
    found = {shape["name"]: shape for shape in data["shapes"] if shape["shape"] == "line"}
    assert set(found) == {"tape", "string"}
    assert found["tape"]["points"] == [[-1, 0, 0], [-0.5, 0, 0.5], [0, 0, 0]]
    names = [data["bodies"][k]["name"] for k in found["tape"]["bodies"]]
    assert names == ["world", "world", "ball"]
    assert any("green: springs, dark: strings and rods" in fact["text"] for fact in data["facts"])


def test_no_lines_no_words():
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    page = make_html(cvi.simulate(scene, duration=0.1, dt=0.01))
    assert not any("lines" in fact["text"] for fact in run_data(page)["facts"])


def test_lines_are_in_the_picture_but_do_not_count_for_the_size_of_bodies(ball):
    frames = animation.frames_of(ball, 60.0)
    view = framing.fit(ball.visuals, frames, trees_of(ball.scene.model))
    corners = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.all(np.linalg.norm(corners - view.center, axis=1) <= view.radius * (1 + 1e-6))
    assert view.size == pytest.approx(6.0 * 0.05)


def test_a_stored_run_keeps_lines_that_functions_drive(ball, tmp_path):
    loaded = cvi.Trajectory.load(ball.save(tmp_path / "run.npz"))
    assert [element.name for element in loaded.scene.elements] == ["tape"]
    before, after = lines_of(ball), lines_of(loaded)
    assert set(before) == set(after)
    for name, visual in before.items():
        assert after[name].joints == visual.joints
        np.testing.assert_array_equal(after[name].vertices, visual.vertices)
    assert make_html(loaded).count('"shape": "line"') == make_html(ball).count('"shape": "line"') == 2


@pytest.mark.parametrize("sizes", [[0.0], [0.0, 1.0, 1.0], []])
def test_a_damaged_line_is_refused(ball, sizes):
    data = lines_of(ball)["string"].to_dict() | {"sizes": sizes}
    with pytest.raises(SceneError, match="line"):
        visuals.Visual.from_dict(data)
