"""The player in a real browser: no errors, and every control does what it says."""

from __future__ import annotations

import numpy as np
import pytest
from selenium.webdriver.support.ui import WebDriverWait

import contactvi as cvi
from helpers.browser_page import (
    POLL,
    errors,
    open_page,
    picture,
    press,
    set_slider,
    time_of,
    type_speed,
)
from helpers.run_scenes import GRAVITY, ball_scene, heap_of_boxes

pytestmark = pytest.mark.browser

SINGLE = float(np.finfo(np.float32).eps)  # three.js keeps the tracks as float32
POSITION = """
const found = stage.bodies.filter(body => body.name === arguments[0]);
if (found.length !== 1) { throw new Error(found.length + " bodies " + arguments[0]); }
return found[0].position.toArray();
"""


def test_page_loads_without_errors(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path, title="a ball")
    assert browser.title == "a ball"
    assert browser.execute_script("return player.source.end") == 2.5
    assert errors(browser) == []
    requested = browser.execute_script("return performance.getEntriesByType('resource').map(e => e.name)")
    assert [name for name in requested if not name.startswith(("data:", "blob:"))] == []


def test_slider_moves_the_ball(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path)
    seen = []
    for time in (0.0, 0.31, float(ball.events[0].time), 1.7, 2.5):
        set_slider(browser, time)
        position = browser.execute_script(POSITION, "ball")
        # Between two frames (1/60 s), as between two nodes (1/100 s), a chord of the parabola lies g h^2 / 8 beside it.
        chords = GRAVITY / 8 * (1 / 60**2 + 1 / 100**2)
        assert position == pytest.approx(list(ball.resample([time])[0, :3]), abs=chords + 8 * SINGLE)
        assert time_of(browser) == pytest.approx(time, abs=1e-12)
        seen.append(position)
    assert np.abs(np.diff(seen, axis=0)).max() > 0.5
    assert errors(browser) == []


def test_keys(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path, play=False)
    times = browser.execute_script("return [...player.source.times]")
    press(browser, "ArrowRight")
    assert time_of(browser) == times[1]
    press(browser, "ArrowRight", shift=True)
    assert time_of(browser) == times[11]
    press(browser, "ArrowLeft")
    assert time_of(browser) == times[10]
    press(browser, "n")
    press(browser, "n")
    assert time_of(browser) == ball.events[1].time
    press(browser, "p")
    assert time_of(browser) == ball.events[0].time
    press(browser, "End")
    assert time_of(browser) == 2.5
    press(browser, "Home")
    assert time_of(browser) == 0.0
    press(browser, " ")
    assert browser.execute_script("return player.playing")
    press(browser, " ")
    assert not browser.execute_script("return player.playing")
    help_line = browser.find_element("id", "help")
    assert not help_line.is_displayed()
    press(browser, "?")
    assert "play or pause" in help_line.text
    # In the box of the speed letters are letters.
    browser.execute_script(
        "arguments[0].focus(); arguments[0].dispatchEvent(new KeyboardEvent('keydown', {key: ' ', bubbles: true}));",
        browser.find_element("id", "speed"),
    )
    assert not browser.execute_script("return player.playing")
    assert errors(browser) == []


def test_speed_box(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path, play=False)
    for text, speed in (("0.25", 0.25), ("2,5", 2.5), ("-1", 2.5), ("quick", 2.5), ("10", 10.0)):
        type_speed(browser, text)
        assert browser.execute_script("return player.speed") == speed
        wrong = "wrong" in (browser.find_element("id", "speed").get_attribute("class") or "")
        assert wrong == (float(text.replace(",", ".")) != speed if text[-1].isdigit() else True)


def test_labels(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path, play=False)
    assert browser.find_elements("class name", "label") == []
    press(browser, "l")
    picture(browser, tmp_path / "labels.png")
    (label,) = [label for label in browser.find_elements("class name", "label") if label.is_displayed()]
    assert label.text == "ball"
    x, y = browser.execute_script(
        "const p = stage.center(1, new THREE.Vector3()).project(stage.camera);"
        "return [(0.5 + 0.5 * p.x) * stage.width, (0.5 - 0.5 * p.y) * stage.height];"
    )
    box = label.rect
    assert [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2] == pytest.approx([x, y], abs=2.0)
    press(browser, "l")
    assert browser.find_elements("class name", "label") == []


def test_labels_do_not_overlap(browser, tmp_path):
    """Seen from every side their boxes are disjoint, and those beside their bodies have lines to them."""
    open_page(browser, heap_of_boxes(), tmp_path, play=False)
    press(browser, "l")
    for turn in (0.0, 0.8, 2.0):
        browser.execute_script("orbit.turn = arguments[0]; orbit.rise = 0.2; orbit.update();", turn)
        picture(browser, tmp_path / "labels.png")
        boxes = np.array(browser.execute_script(
            "return labels.elements.filter(label => label.style.visibility !== 'hidden').map(label => {"
            " const box = label.getBoundingClientRect(); return [box.left, box.top, box.right, box.bottom]; });"
        ))  # fmt: skip
        assert len(boxes) == 30
        for k, one in enumerate(boxes):
            others = boxes[k + 1 :]
            apart = (others[:, :2] >= one[2:]).any(axis=1) | (others[:, 2:] <= one[:2]).any(axis=1)
            assert apart.all()
        leaders = browser.execute_script("return labels.lines.firstChild.getAttribute('d')").count("M")
        assert 1 <= leaders <= 30
    assert errors(browser) == []


@pytest.mark.parametrize("width", [1280, 500, 360])
def test_everything_fits(browser, tmp_path, width):
    """No button overflows or lies outside, panels do not cover each other, and there is one slider of time."""
    traj = cvi.simulate(ball_scene(restitution=0.7), duration=4.0, dt=1e-2)
    device = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", device)
    try:
        open_page(browser, traj, tmp_path, play=False, title="a title that is as long as titles of runs sometimes are")
        press(browser, "e")
        set_slider(browser, traj.events[0].time)
        assert browser.execute_script("return document.documentElement.scrollWidth") <= width
        for button in browser.find_elements("css selector", "#bar button, #bar select, .box, #clock"):
            box = button.rect
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= width
            assert browser.execute_script("return arguments[0].scrollWidth <= arguments[0].clientWidth + 1", button)
        boxes = [browser.find_element("id", name).rect for name in ("head", "legend", "now")]
        for k, one in enumerate(boxes):
            assert one["x"] + one["width"] <= width
            for other in boxes[:k]:
                assert (
                    one["y"] >= other["y"] + other["height"]
                    or other["y"] >= one["y"] + one["height"]
                    or one["x"] >= other["x"] + other["width"]
                    or other["x"] >= one["x"] + one["width"]
                )

        def shown(_) -> bool:
            sliders = browser.find_elements("css selector", "input[type=range]")
            names = [slider.get_attribute("id") for slider in sliders if slider.is_displayed()]
            return names == ["scale", "threshold", "time"]

        WebDriverWait(browser, 20.0).until(shown)  # a busy machine lays the page out a little later
        assert browser.find_elements("class name", "dg") == []  # meshcat's panel
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_page_plays_by_itself_and_stops_at_the_end(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path)
    assert browser.execute_script("return player.playing || player.time > 0")
    # Polled, not timed: on a busy machine the first frame may take seconds.
    later = browser.execute_async_script("player.seek(0); player.play();" + POLL, "player.time > 0")
    assert 0 < later <= 2.5
    browser.execute_async_script("player.seek(2.45);" + POLL, "!player.playing")
    end = browser.execute_script("return [player.time, player.playing]")
    assert end == [pytest.approx(2.5), False]
