"""The live view in a real browser: the page follows the simulator, pauses, goes back, and follows again."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

import contactvi as cvi
from contactvi.playback.viewer import LiveView
from helpers.browser_page import POLL, errors, press, set_slider
from helpers.run_scenes import RADIUS, ball_scene

pytestmark = pytest.mark.browser

SINGLE = float(np.finfo(np.float32).eps)
DT = 1e-3
STATE = """
const ball = stage.bodies.find(body => body.name === "ball");
return {time: player.time, following: player.following, playing: player.playing, start: source.start, end: source.end,
  count: source.count, height: ball.position.z, events: source.events.time, kept: source.times,
  pressed: element("live").getAttribute("aria-pressed"), fact: element("fact").textContent,
  slider: [Number(element("time").min), Number(element("time").value), Number(element("time").max)]};
"""


def state(browser) -> dict:
    return browser.execute_script(STATE)


def poll(browser, condition: str) -> dict:
    """Wait until a condition holds on the page; return its state."""
    browser.execute_async_script(POLL, condition)
    assert browser.execute_script("return Boolean(" + condition + ")"), condition
    return state(browser)


@contextmanager
def running(sim: cvi.Simulator, live: LiveView) -> Iterator[None]:
    """Step a simulator in the background while a test looks at its page."""
    over = threading.Event()

    def loop() -> None:
        while not over.is_set():
            sim.step()
            live.sync()

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def flight(time: float, rise: float) -> float:
    """Height [m] of the ball that bounces without loss, of a step that is exact for parabolas."""
    fall = np.sqrt(2 * rise / 9.81)
    since = (time + fall) % (2 * fall) - fall  # from the highest point
    return RADIUS + rise - 0.5 * 9.81 * since**2


@pytest.fixture
def ball() -> cvi.Simulator:
    sim = cvi.Simulator(ball_scene(), dt=DT)
    sim.reset()
    return sim


def test_the_ball_moves_while_the_loop_runs(browser, ball):
    with cvi.view(ball, open_browser=False, realtime=True, title="a live ball") as live:
        browser.get(live.url)
        assert browser.title == "a live ball"
        with running(ball, live):
            first = poll(browser, "source.count > 20 && source.end > 0.2")
            second = poll(browser, f"source.end > {first['end'] + 0.3}")
        for found in (first, second):
            assert found["following"]
            assert found["pressed"] == "true"
            # What is drawn may be the frame before the one that came while the page was asked.
            assert found["end"] - found["time"] < 1.0
            assert found["height"] == pytest.approx(flight(found["time"], 1.0), abs=1e-6)  # of impacts that are located
            assert "live" in found["fact"]
        assert second["slider"][2] > first["slider"][2]  # the time bar grows
        assert second["slider"][0] <= second["kept"][0]
    ended = poll(browser, "element('fact').textContent.startsWith('ended') && player.time === source.end")
    assert ended["end"] == ball.t  # the last state was shown
    assert ended["events"] == ball.events.array("time").tolist() != []
    assert errors(browser) == []


@pytest.mark.slow
def test_pause_scrub_and_live(browser, ball):
    with cvi.view(ball, open_browser=False, realtime=True) as live:
        browser.get(live.url)
        with running(ball, live):
            poll(browser, "source.end > 1")
            browser.find_element("id", "play").click()
            paused = state(browser)
            assert not paused["playing"]
            assert paused["pressed"] == "false"
            later = poll(browser, f"source.end > {paused['end'] + 0.3}")  # it goes on meanwhile
            assert later["time"] == paused["time"]
            assert later["height"] == paused["height"]
            set_slider(browser, 0.3)
            past = state(browser)
            assert past["time"] == pytest.approx(0.3, abs=1e-12)
            gap = np.diff(past["kept"]).max()  # between two frames the ball goes along a chord
            assert past["height"] == pytest.approx(flight(0.3, 1.0), abs=9.81 / 8 * gap**2 + 4 * SINGLE)
            press(browser, " ")
            replayed = poll(browser, "player.time > 0.35")
            assert replayed["playing"]
            assert not replayed["following"]
            assert replayed["time"] < replayed["end"] - 0.3
            press(browser, "p")
            browser.find_element("id", "live").click()
            back = state(browser)
            assert back["following"]
            assert back["end"] - back["time"] < 1.0
            poll(browser, f"player.time > {back['end'] + 0.1}")
            browser.find_element("id", "play").click()
            press(browser, "End")
            assert state(browser)["following"]
    assert errors(browser) == []


def test_the_page_forgets_what_is_old_and_starts_anew(browser, ball):
    with cvi.view(ball, open_browser=False) as live:
        browser.get(live.url)
        live.wait_for_page()
        with running(ball, live):
            browser.execute_async_script(POLL, "source.count > 5")
        # Frames as they come, many more than are kept.
        kept = browser.execute_script("""
          const {pose} = source.frames[source.frames.length - 1], data = {data: btoa(String.fromCharCode(
            ...new Uint8Array(pose.buffer))), type: "f4"}, start = source.end;
          for (let k = 1; k <= 2 * KEPT; ++k) {
            const frame = {run: 0, t: start + k / 60, pose: data, contacts: null, impacts: k, bad: ""};
            source.push({frame, happened: []});
          }
          return [KEPT, source.times.length, source.frames.length, source.start - start];""")
        assert kept[1:3] == [kept[0], kept[0]]
        assert kept[3] == pytest.approx((kept[0] + 1) / 60)
        assert poll(browser, "source.events.length === 0")["start"] > 10
        ball.reset()
        with running(ball, live):
            anew = poll(browser, "source.start < 1 && source.count > 3")
        assert anew["following"]
        assert anew["end"] >= anew["start"] >= 0
    assert errors(browser) == []


@pytest.mark.slow
def test_contacts_forces_and_events_of_a_rolling_ball(browser):
    """What the signs, the legend and the list say of contacts that come after the page was opened."""
    scene = cvi.Scene()
    scene.add_sphere("ball", RADIUS, mass=0.5, placement=(0.0, 0.0, RADIUS + 1e-3))
    scene.add_halfspace()
    scene.set_contact(restitution=0.0, friction=0.8)
    sim = cvi.Simulator(scene, dt=DT)
    sim.reset(None, scene.velocity({"ball": ((1.0, 0.0, 0.0), (0.0, 1.0 / RADIUS, 0.0))}))
    with cvi.view(sim, open_browser=False) as live:
        browser.get(live.url)
        live.wait_for_page()
        assert "force" not in browser.find_element("id", "legend").text
        while sim.t < 0.5:  # as many frames as steps
            sim.step()
            live.sync()
            time.sleep(1 / 60)
        poll(browser, f"source.end > {sim.t - 0.1} && player.time === source.end && source.fullForce !== null")
        press(browser, "e")
        poll(browser, "document.querySelectorAll('#kinds input').length > 1")
        legend = browser.find_element("id", "legend").text
        assert "force" in legend
        assert "roll" in legend
        forces = browser.execute_script("return signs.forces.places.map(([p, d]) => [...p.toArray(), ...d.toArray()])")
        assert len(forces) == 1
        ball = browser.execute_script("return stage.bodies.find(body => body.name === 'ball').position.toArray()")
        assert forces[0] == pytest.approx([ball[0], ball[1], 0.0, 0.0, 0.0, 1.0], abs=1e-4)  # rolling takes no friction
        full = browser.execute_script("return source.fullForce")
        assert full == pytest.approx(0.5 * 9.81, rel=1e-6)
        kinds = [label.text for label in browser.find_elements("css selector", "#kinds label")]
        assert "begin (1)" in kinds
        words = [row.text for row in browser.find_elements("css selector", "#rows button")]
        assert any("begin" in row and "ball" in row for row in words)
    assert errors(browser) == []
