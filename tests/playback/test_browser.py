"""The playback in a real browser: the page loads without errors, its slider moves the ball, and there is a picture."""

from __future__ import annotations

import io
import math
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from helpers.contact_runs import CORNERS, MU, SPEED, STEP, place, sliding_box
from helpers.line_scenes import hung_ball
from helpers.run_scenes import GRAVITY, ball_scene, hand_scene

pytestmark = pytest.mark.browser

SINGLE = float(np.finfo(np.float32).eps)  # three.js keeps the tracks as float32
# Software rendering: three.js needs WebGL, a test machine has no graphics card. The rest keeps Chromium to itself.
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1280,800",
)
POSITION = """
const bodies = viewer.scene_tree.find(["contactvi"]).children;
const name = Object.keys(bodies).filter(name => name.endsWith(arguments[0]));
if (name.length !== 1) { throw new Error(name.length + " nodes " + arguments[0]); }
return bodies[name[0]].object.position.toArray();
"""
VISIBLE_MARKERS = """
return Object.values(viewer.scene_tree.find(["contactvi", "impacts"]).children)
  .filter(node => node.object.visible).map(node => node.object.position.toArray());
"""

VISIBLE_FORCES = """
return Object.values(viewer.scene_tree.find(["contactvi", "forces"]).children)
  .filter(node => node.object.visible).map(node => [...node.object.position.toArray(), node.object.scale.z]);
"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for flag in FLAGS:
        options.add_argument(flag)
    options.add_argument(f"--user-data-dir={tmp_path_factory.mktemp('chromium')}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    driver.set_script_timeout(60)
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def ball() -> cvi.Trajectory:
    scene = ball_scene(restitution=0.8)
    v0 = scene.velocity({"ball": ((0.5, -0.2, 0.0), (0.0, 3.0, 7.0))})
    return cvi.simulate(scene, None, v0, duration=2.5, dt=1e-2)


def open_page(browser, traj: cvi.Trajectory, folder: Path, **options) -> None:
    browser.get(traj.to_html(folder / "playback.html", **options).as_uri())


def errors(browser) -> list[str]:
    """Return warnings and errors of the console, without remarks about the speed of software rendering."""
    entries = browser.get_log("browser")
    return [
        entry["message"]
        for entry in entries
        if entry["level"] in {"SEVERE", "WARNING"} and "GPU stall" not in entry["message"]
    ]


def set_slider(browser, time: float) -> None:
    """Move the page's slider as a user does: its value changes, with an input event."""
    slider = browser.find_element("id", "time")
    browser.execute_script(
        "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'));", slider, time
    )


def picture(browser, path: Path) -> np.ndarray:
    """What is on the screen after the next drawn frame, shape (height, width, 3), also written to `path`."""
    from PIL import Image

    browser.execute_async_script(
        "const done = arguments[0]; viewer.set_dirty();"
        "requestAnimationFrame(() => requestAnimationFrame(() => done(true)));"
    )
    data = browser.get_screenshot_as_png()
    path.write_bytes(data)
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


def test_page_loads_without_errors(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path, title="a ball")
    assert browser.title == "a ball"
    assert browser.execute_script("return viewer.animator.duration") == pytest.approx(2.5, rel=SINGLE)
    assert errors(browser) == []
    requested = browser.execute_script("return performance.getEntriesByType('resource').map(e => e.name)")
    assert [name for name in requested if not name.startswith(("data:", "blob:"))] == []


def test_slider_moves_the_ball(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path)
    seen = []
    for time in (0.0, 0.31, float(ball.events[0].time), 1.7, 2.5):
        set_slider(browser, time)
        position = browser.execute_script(POSITION, "_ball")
        # Between two frames (1/60 s), as between two nodes (1/100 s), a chord of the parabola lies g h^2 / 8 beside it.
        chords = GRAVITY / 8 * (1 / 60**2 + 1 / 100**2)
        assert position == pytest.approx(list(ball.resample([time])[0, :3]), abs=chords + 8 * SINGLE)
        assert browser.execute_script("return viewer.animator.time") == pytest.approx(time, abs=1e-6)
        seen.append(position)
    assert np.abs(np.diff(seen, axis=0)).max() > 0.5
    assert errors(browser) == []


def test_meshcats_own_panel_moves_the_ball_and_the_slider(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path, play=False)
    browser.execute_async_script(
        "const done = arguments[1]; viewer.animator.time_scrubber.setValue(arguments[0]);"
        "requestAnimationFrame(() => requestAnimationFrame(() => done(true)));",
        1.7,
    )
    assert browser.execute_script(POSITION, "_ball") == pytest.approx(ball.resample([1.7])[0, :3], abs=1e-3)
    assert float(browser.find_element("id", "time").get_attribute("value")) == pytest.approx(1.7, abs=1e-3)


def test_impacts_are_shown_at_their_time(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path, play=False)
    assert browser.execute_script(VISIBLE_MARKERS) == []
    browser.find_element("id", "after").click()  # jump to the first impact
    event = ball.events[0]
    assert browser.execute_script("return viewer.animator.time") == pytest.approx(event.time, abs=1e-9)
    set_slider(browser, event.time + 1e-3)
    (marker,) = browser.execute_script(VISIBLE_MARKERS)
    assert marker == pytest.approx(event.point, abs=8 * SINGLE)
    text = browser.find_element("id", "impact").text
    assert "impact 1 of 4" in text
    assert "ball | ground" in text
    set_slider(browser, event.time + 0.3)
    assert browser.execute_script(VISIBLE_MARKERS) == []
    assert len(browser.find_elements("css selector", "#ticks i")) == 4


def test_forces_are_shown_where_they_act(browser, tmp_path):
    box = sliding_box()
    open_page(browser, box, tmp_path, play=False)
    set_slider(browser, 0.3)
    arrows = np.array(browser.execute_script(VISIBLE_FORCES))
    assert len(arrows) == 4
    # Between two frames an arrow moves from the contact point of one step's end to that of the next.
    center = arrows[:, :2].mean(axis=0)
    assert center == pytest.approx([place(np.array(0.3)), 0.0], abs=STEP * SPEED)
    assert np.sort(arrows[:, 0] - center[0]) == pytest.approx(np.sort(CORNERS[:, 0]), abs=1e-6)
    assert arrows[:, 3] == pytest.approx(np.full(4, 1.0), abs=1e-3)  # sliding: friction and weight
    set_slider(browser, 0.9)
    assert np.array(browser.execute_script(VISIBLE_FORCES))[:, 3] == pytest.approx(1 / math.hypot(1, MU), abs=1e-3)
    assert errors(browser) == []
    image = picture(browser, tmp_path / "forces.png")
    assert (np.abs(image - (0x1E, 0x4F, 0xBF)).max(axis=2) < 25).sum() > 200
    open_page(browser, box, tmp_path, play=False, forces=False)
    assert browser.execute_script("return viewer.scene_tree.find(['contactvi']).children.forces") is None


LINES = """
const end = (node, z) => node.object.up.clone().set(0, 0, z).applyMatrix4(node.object.matrix).toArray();
return Object.values(viewer.scene_tree.find(["contactvi", "lines"]).children).map(line =>
  Object.values(line.children).map(node => {
    node.object.updateMatrix();
    return [...end(node, 0), ...end(node, 1)];
  }));
"""


def test_springs_and_strings_follow_their_ends(browser, tmp_path):
    traj = hung_ball()
    open_page(browser, traj, tmp_path, play=False)
    for time in (0.0, 0.37, 1.0):
        set_slider(browser, time)
        (tape, string) = (np.reshape(line, (-1, 6)) for line in browser.execute_script(LINES))
        ball = traj.resample([time])[0, :3]
        chords = 1e-3  # between two frames (1/60 s) a piece goes straight: accelerations are below 20 m/s^2
        assert string == pytest.approx(np.array([[0, 0, 1, *ball]]), abs=chords)
        assert tape[:, :3] == pytest.approx(np.array([[-1, 0, 0], [-0.5, 0, 0.5]]), abs=8 * SINGLE)
        assert tape[:, 3:] == pytest.approx(np.array([[-0.5, 0, 0.5], ball]), abs=chords)
    assert errors(browser) == []
    image = picture(browser, tmp_path / "lines.png").astype(int)
    green = (image[..., 1] > image[..., 0] + 40) & (image[..., 1] > image[..., 2] + 10)
    assert green.sum() > 200
    assert (image.max(axis=2) < 110)[: int(0.8 * len(image)), : image.shape[1] // 2 + 200].sum() > 200


# Calls back with the time shown once the condition holds, at the latest after 20 s.
POLL = """
const done = arguments[arguments.length - 1], holds = new Function("return " + arguments[0]), start = performance.now();
(function poll() {
    if (holds() || performance.now() - start > 20000) done(viewer.animator.time); else setTimeout(poll, 20);
})();
"""


def test_page_plays_by_itself_and_stops_at_the_end(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path)
    assert browser.execute_script("return player.playing || viewer.animator.time > 0")
    # Polled, not timed: on a busy machine the first frame may take seconds.
    later = browser.execute_async_script("seek(0); play();" + POLL, "viewer.animator.time > 0")
    assert 0 < later <= 2.5
    browser.execute_async_script("seek(2.45);" + POLL, "!player.playing")
    end = browser.execute_script("return [viewer.animator.time, player.playing]")
    assert end == [pytest.approx(2.5), False]


def test_picture_of_the_hand(browser, tmp_path):
    """The screen shows the hand, the ball and, at an impact, an arrow in the colour of impulses."""
    scene, q0 = hand_scene()
    traj = cvi.simulate(scene, q0, duration=0.5, dt=1e-3, throw=False)
    open_page(browser, traj, tmp_path, play=False)
    start = picture(browser, tmp_path / "start.png")
    set_slider(browser, traj.events[0].time + 1e-3)
    impact = picture(browser, tmp_path / "impact.png")
    assert errors(browser) == []
    colors = len(np.unique(start[::4, ::4].reshape(-1, 3), axis=0))
    assert colors > 200  # not blank
    dark = np.all(start < 90, axis=2).mean()
    assert 0.005 < dark < 0.5  # the black hand, not lost in the distance and not all over the screen
    arrow = np.all(np.abs(impact - (0xE0, 0x43, 0x1F)) < 25, axis=2)[: int(0.8 * len(impact))]
    assert arrow.sum() > 100
    assert np.abs(impact - start).max(axis=2).mean() > 0.5
    assert not math.isnan(float(impact.mean()))
