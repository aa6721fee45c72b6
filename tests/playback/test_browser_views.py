"""What the playback draws in a real browser: cameras, walls, lines, a picture."""

from __future__ import annotations

import math

import numpy as np
import pytest

import contactvi as cvi
from helpers.browser_page import (
    camera_of,
    errors,
    is_color,
    open_page,
    picture,
    press,
    set_slider,
)
from helpers.line_scenes import hung_ball
from helpers.run_scenes import hand_scene

pytestmark = pytest.mark.browser

SINGLE = float(np.finfo(np.float32).eps)  # three.js keeps the tracks as float32
POSITION = """
const found = stage.bodies.filter(body => body.name === arguments[0]);
if (found.length !== 1) { throw new Error(found.length + " bodies " + arguments[0]); }
return found[0].position.toArray();
"""


def outline_in_picture(browser) -> float:
    """How far the outline reaches towards the border of the picture, or the panels above and below: 1 at it."""
    return browser.execute_script("""
      stage.camera.updateMatrixWorld();
      const [above, below] = orbit.margins(), h = stage.height, point = new THREE.Vector3();
      return Math.max(...stage.view.outline.map(place => {
        const p = point.set(...place).project(stage.camera);
        const up = p.y / (1 - 2 * above / h - 0.05) * 0.95, down = -p.y / (1 - 2 * below / h - 0.05) * 0.95;
        return Math.max(Math.abs(p.x), up, down);
      }));""")


def test_cameras(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path, play=False, camera={"eye": (3.0, 1.0, 2.0), "target": (0.0, 0.0, 0.5)})
    eye, target = camera_of(browser)
    assert eye == pytest.approx([3.0, 1.0, 2.0], abs=1e-9)
    assert target == pytest.approx([0.0, 0.0, 0.5], abs=1e-9)
    for key, direction in (("2", (1, 0, 0)), ("3", (0, -1, 0)), ("4", (0, 0, 1))):
        press(browser, key)
        eye, target = camera_of(browser)
        away = (eye - target) / np.linalg.norm(eye - target)
        assert away == pytest.approx(direction, abs=2e-3)
        assert outline_in_picture(browser) == pytest.approx(0.95, abs=0.03)  # all of it, and as large as it can be
    assert browser.find_element("id", "camera").get_attribute("value") == "3"
    press(browser, "5")  # the camera that the run came with
    assert camera_of(browser)[0] == pytest.approx([3.0, 1.0, 2.0], abs=1e-9)


def test_followed_body_stays_in_the_middle(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path, play=False, camera={"follow": "ball"})
    for time in (0.0, 1.0, 2.5):
        set_slider(browser, time)
        at = ball.resample([time])[0, :3]
        assert camera_of(browser)[1] == pytest.approx(at, abs=2e-3)  # a chord between two frames
    options = [option.text for option in browser.find_elements("css selector", "#camera option")]
    assert options == ["auto", "front", "side", "top", "scene's", "follow ball"]


@pytest.mark.parametrize("camera", ["auto", "front", "side", "top"])
def test_preset_shows_all_of_the_run(browser, ball, tmp_path, camera):
    open_page(browser, ball, tmp_path, play=False, camera=camera)
    assert 0.9 < outline_in_picture(browser) <= 1.0
    set_slider(browser, 2.5)
    x, y = browser.execute_script(
        "const p = stage.center(stage.bodies.findIndex(b => b.name === 'ball'), new THREE.Vector3());"
        "p.project(stage.camera); return [p.x, p.y];"
    )
    assert max(abs(x), abs(y)) < 1.0


def test_mouse_turns_moves_and_zooms(browser, ball, tmp_path):
    from selenium.webdriver.common.action_chains import ActionChains

    open_page(browser, ball, tmp_path, play=False)
    canvas = browser.find_element("css selector", "#view canvas")
    eye, target = camera_of(browser)
    ActionChains(browser).drag_and_drop_by_offset(canvas, 100, 0).perform()
    turned, same = camera_of(browser)
    assert same == pytest.approx(target)
    assert np.linalg.norm(turned - target) == pytest.approx(np.linalg.norm(eye - target))
    assert np.linalg.norm(turned - eye) > 0.3 * np.linalg.norm(eye - target)
    browser.execute_script(
        "arguments[0].dispatchEvent(new WheelEvent('wheel', {deltaY: -200, cancelable: true}));", canvas
    )
    near, _ = camera_of(browser)
    assert np.linalg.norm(near - target) == pytest.approx(math.exp(-0.3) * np.linalg.norm(eye - target))


def test_a_wall_tints_what_is_behind_it_and_nothing_else(browser, tmp_path):
    """A ball in front of a wall has its colours, seen from the front; from behind the wall is not there."""
    scene = cvi.Scene()
    scene.add_halfspace((1.0, 0.0, 0.0), -0.2, name="wall")
    scene.add_sphere("ball", 0.1, color=(0.1, 0.6, 0.2, 1.0))
    traj = cvi.simulate(scene, duration=0.1, dt=1e-2)
    for camera in ({"eye": (2.0, 0.3, 0.2), "target": (0, 0, 0)}, {"eye": (-2.0, 0.3, 0.2), "target": (0, 0, 0)}):
        open_page(browser, traj, tmp_path, play=False, camera=camera)
        hide = "stage.scene.traverse(o => { if (%s) { o.visible = false; } });"
        browser.execute_script(hide % "o.isLineSegments")  # the outline of the wall is seen from both sides
        with_wall = picture(browser, tmp_path / "wall.png")
        browser.execute_script(hide % "o.userData.endless")
        without = picture(browser, tmp_path / "none.png")
        green = is_ball(without)
        ball = green.copy()  # without its border, which shows what is behind it
        for axis in (0, 1):
            for side in (-2, 2):
                ball &= np.roll(green, side, axis)
        assert ball.sum() > 2000
        assert np.abs(with_wall - without)[ball].max() <= 2
        changed = np.abs(with_wall - without).max(axis=2) > 2
        if camera["eye"][0] > 0.0:
            assert changed.sum() > 0.3 * green.sum()
        else:
            assert not changed.any()


def is_ball(image: np.ndarray) -> np.ndarray:
    """Where a picture is green."""
    return (image[..., 1] > image[..., 0] + 40) & (image[..., 1] > image[..., 2] + 20)


LINES = """
const end = (piece, z) => new THREE.Vector3(0, 0, z).applyMatrix4(piece.matrix).toArray();
return Object.fromEntries(stage.lines.map(line => [line.name, line.pieces.map(piece => {
  piece.updateMatrix();
  return [...end(piece, 0), ...end(piece, 1)];
})]));
"""


def test_springs_and_strings_follow_their_ends(browser, tmp_path):
    traj = hung_ball()
    open_page(browser, traj, tmp_path, play=False)
    for time in (0.0, 0.37, 1.0):
        set_slider(browser, time)
        found = {name: np.reshape(line, (-1, 6)) for name, line in browser.execute_script(LINES).items()}
        tape, string = found["tape"], found["string"]
        ball = traj.resample([time])[0, :3]
        chords = 1e-3  # between two frames (1/60 s) a piece goes straight: accelerations are below 20 m/s^2
        assert string == pytest.approx(np.array([[0, 0, 1, *ball]]), abs=chords)
        assert tape[:, :3] == pytest.approx(np.array([[-1, 0, 0], [-0.5, 0, 0.5]]), abs=8 * SINGLE)
        assert tape[:, 3:] == pytest.approx(np.array([[-0.5, 0, 0.5], ball]), abs=chords)
    assert errors(browser) == []
    image = picture(browser, tmp_path / "lines.png").astype(int)
    green = (image[..., 1] > image[..., 0] + 40) & (image[..., 1] > image[..., 2] + 10)
    assert green.sum() > 200
    assert (image.max(axis=2) < 130)[: int(0.8 * len(image)), : image.shape[1] // 2 + 200].sum() > 200


def test_picture_of_the_hand(browser, tmp_path):
    """The screen shows the hand, the ball and, at an impact, an arrow in the colour of impulses."""
    scene, q0 = hand_scene()
    traj = cvi.simulate(scene, q0, duration=0.5, dt=1e-3, throw=False)
    open_page(browser, traj, tmp_path, play=False)
    start = picture(browser, tmp_path / "start.png")
    set_slider(browser, traj.events[0].time + 1e-3)
    impact = picture(browser, tmp_path / "impact.png")
    # Without what the hand and the ball hide of it, which is fainter.
    browser.execute_script("stage.bodies.forEach(body => { body.visible = false; });")
    bare = picture(browser, tmp_path / "bare.png")
    assert errors(browser) == []
    colors = len(np.unique(start[::4, ::4].reshape(-1, 3), axis=0))
    assert colors > 200  # not blank
    dark = np.all(start < 140, axis=2).mean()
    assert 0.03 < dark < 0.5  # the hand, not lost in the distance and not all over the screen
    arrow, drawn = (is_color(image, (0xE0, 0x43, 0x1F))[: int(0.8 * len(image))] for image in (bare, impact))
    assert arrow.sum() > 100
    assert drawn.any()
    assert np.abs(impact - start).max(axis=2).mean() > 0.5
    assert not math.isnan(float(impact.mean()))
