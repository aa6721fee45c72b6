"""Contacts, forces and events of the playback in a real browser."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi
from helpers.browser_page import (
    POLL,
    SET,
    errors,
    is_color,
    open_page,
    picture,
    press,
    set_slider,
    time_of,
    type_speed,
)
from helpers.contact_runs import CORNERS, MASS, MU, SPEED, STEP, place, sliding_box
from helpers.run_scenes import GRAVITY, ball_scene, heap_of_boxes

pytestmark = pytest.mark.browser

# Start and vector, of the length that is drawn, of the arrows that are shown.
ARROWS = """
return signs[arguments[0]].places.map(([point, direction, length]) =>
  [...point.toArray(), ...direction.clone().multiplyScalar(length).toArray()]);
"""
SINGLE = float(np.finfo(np.float32).eps)  # three.js keeps the tracks as float32


def test_impacts_are_shown_at_their_time(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path, play=False)
    assert browser.execute_script(ARROWS, "impacts") == []
    browser.find_element("id", "after").click()  # jump to the first impact
    event = ball.events[0]
    assert time_of(browser) == event.time
    set_slider(browser, event.time + 1e-3)
    (arrow,) = browser.execute_script(ARROWS, "impacts")
    assert arrow[:3] == pytest.approx(event.point, abs=8 * SINGLE)
    assert arrow[3:5] == pytest.approx([0, 0], abs=1e-6)
    assert arrow[5] > 0.0  # what the ball gets, not the ground
    line = browser.find_element("id", "now")
    assert "impact at 0.45" in line.text
    assert "ball | ground" in line.text
    set_slider(browser, event.time + 0.26)  # a quarter of a second of viewing later
    assert browser.execute_script(ARROWS, "impacts") == []
    assert not line.is_displayed()  # the line does not show the last impact for the rest of the run
    set_slider(browser, 0.0)
    assert not line.is_displayed()


def test_an_impact_is_shown_for_the_same_time_of_viewing_at_every_speed(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path, play=False)
    type_speed(browser, "0.1")
    first = ball.events[0].time
    set_slider(browser, first + 0.02)
    assert len(browser.execute_script(ARROWS, "impacts")) == 1
    set_slider(browser, first + 0.03)
    assert browser.execute_script(ARROWS, "impacts") == []


def test_forces_are_shown_where_they_act(browser, tmp_path):
    box = sliding_box()
    open_page(browser, box, tmp_path, play=False)
    set_slider(browser, 0.3)
    arrows = np.array(browser.execute_script(ARROWS, "forces"))
    assert len(arrows) == 4
    # Between two frames an arrow moves from the contact point of one step's end to that of the next.
    center = arrows[:, :2].mean(axis=0)
    assert center == pytest.approx([place(np.array(0.3)), 0.0], abs=STEP * SPEED)
    assert np.sort(arrows[:, 0] - center[0]) == pytest.approx(np.sort(CORNERS[:, 0]), abs=1e-6)
    per_newton = browser.execute_script("return signs.perNewton * signs.scale")
    weight = 0.25 * MASS * GRAVITY
    force = np.tile([-MU * weight, 0.0, weight], (4, 1))  # sliding: friction and weight
    assert arrows[:, 3:] == pytest.approx(per_newton * force, rel=1e-5, abs=1e-6)
    set_slider(browser, 0.9)
    at_rest = np.array(browser.execute_script(ARROWS, "forces"))
    assert at_rest[:, 3:] == pytest.approx(per_newton * np.tile([0.0, 0.0, weight], (4, 1)), rel=1e-5, abs=1e-6)
    # The legend says how long a newton is, and its slider changes that.
    words = browser.find_element("id", "legend").text
    newtons, centimetres = (float(part.split()[0]) for part in words.split("force ")[1].split("=")[:2])
    assert centimetres == pytest.approx(100.0 * newtons * per_newton, rel=0.06)  # two digits
    browser.execute_script(SET, browser.find_element("id", "scale"), -0.5)
    shorter = np.array(browser.execute_script(ARROWS, "forces"))
    assert shorter[:, 5] == pytest.approx(at_rest[:, 5] * 10**-0.5, rel=1e-5)
    assert browser.find_element("id", "legend").text != words
    assert errors(browser) == []
    open_page(browser, box, tmp_path, play=False, forces=False)
    set_slider(browser, 0.3)
    assert browser.execute_script(ARROWS, "forces") == []


def test_no_arrow_goes_out_while_its_contact_lasts(browser, tmp_path):
    """A real run of a box that lands, slides and stops: from when all corners are closed on, there are four arrows."""
    scene = cvi.Scene()
    scene.add_halfspace()
    box = scene.add_box("box", size=(0.2, 0.2, 0.1), mass=2.0, placement=(0, 0, 0.1))
    scene.set_contact(restitution=0.0, friction=0.4)
    traj = cvi.simulate(scene, v0=scene.velocity({box: (2, 0, 0)}), duration=1.0)
    begun = max(change.time for change in traj.contact_changes if change.change == "begin")
    assert not any(change.change == "release" for change in traj.contact_changes)
    open_page(browser, traj, tmp_path, play=False)
    counts = browser.execute_script(
        "const counts = []; for (let t = arguments[0]; t <= 1; t += 0.00137) {"
        " player.seek(t); counts.push(signs.forces.count); } return counts;",
        begun + 1e-6,
    )
    assert len(counts) > 500
    assert set(counts) == {4}


def test_what_bodies_hide_of_an_arrow_is_faint(browser, tmp_path):
    """Arrows in front of the box have their colour; behind it and in it they are mixed with its own, and never gone."""
    open_page(browser, sliding_box(), tmp_path, play=False)
    set_slider(browser, 0.9)
    browser.execute_script("signs.shown.points = false; player.show();")
    color, opacity = browser.execute_script("return [source.pairs[0].color, FAINT]")
    blue = tuple(int(color[k : k + 2], 16) for k in (1, 3, 5))
    browser.execute_script("orbit.turn = 0.3; orbit.rise = 0.15; orbit.update();")
    with_box = picture(browser, tmp_path / "box.png")
    show = "signs.forces.meshes.forEach(({mesh}) => { mesh.visible = arguments[0]; });"
    browser.execute_script(show, False)
    without = picture(browser, tmp_path / "without.png")
    browser.execute_script(show + "stage.bodies.forEach(body => { body.visible = false; });", True)
    alone = is_color(picture(browser, tmp_path / "alone.png"), blue)
    assert alone.sum() > 500
    full = alone & is_color(with_box, blue)
    hidden = alone & ~full
    assert hidden.sum() > 200
    assert full.sum() > 200
    # Two faint layers at most, the shaft's and the head's, over the seam or the box: nearer to the arrow's colour.
    change = np.abs(with_box - without)[hidden].max(axis=1)
    assert np.quantile(change, 0.05) > 10
    assert np.abs(with_box[hidden] - np.array(blue)).max(axis=1).mean() > 0.3 * (1 - opacity) * 255


def test_contact_points_say_what_they_do(browser, tmp_path):
    open_page(browser, sliding_box(), tmp_path, play=False)
    colors = """const dots = signs.dots.layers[1].geometry.getAttribute("color").array, found = [];
      for (let k = 0; k < dots.length; k += 3) {
        found.push(new THREE.Color().fromArray(dots, k).convertLinearToSRGB().getHexString()); }
      return found;"""
    set_slider(browser, 0.3)
    assert browser.execute_script(colors) == ["e69f00"] * 4  # slips
    set_slider(browser, 0.9)
    assert browser.execute_script(colors) == ["0072b2"] * 4  # sticks
    words = browser.find_element("id", "legend").text
    assert "stick" in words
    assert "slip" in words
    assert "roll" not in words  # nothing rolls in this run
    browser.find_element("id", "points").click()
    assert browser.execute_script("return signs.dots.count") == 0
    assert "stick" not in browser.find_element("id", "legend").text
    press(browser, "c")
    assert browser.execute_script("return signs.dots.count") == 4
    press(browser, "f")
    assert browser.execute_script(ARROWS, "forces") == []
    assert browser.find_element("id", "forces").get_attribute("aria-pressed") == "false"


def test_list_of_events(browser, tmp_path):
    """A ball that bounces to rest: the list is chosen by kind and by strength, a row goes to its time."""
    traj = cvi.simulate(ball_scene(restitution=0.7), duration=4.0, dt=1e-2)
    impulse = np.sort(traj.events.array("impulse"))[::-1]
    open_page(browser, traj, tmp_path, play=False)
    panel = browser.find_element("id", "events")
    assert not panel.is_displayed()
    press(browser, "e")
    assert panel.is_displayed()
    shown = (impulse >= 0.01 * impulse[0] * (1 - 1e-6)).sum()  # at first those of a hundredth of the strongest
    words = browser.find_element("id", "least").text
    assert f"{shown} of {len(impulse)}" in words
    rows = browser.find_elements("css selector", "#rows button")
    assert "impact" in rows[0].text
    assert "ball | ground" in rows[0].text
    rows[2].click()
    assert time_of(browser) == traj.events[2].time
    assert "on" in rows[2].get_attribute("class").split()
    browser.execute_script(SET, browser.find_element("id", "threshold"), 1.0)
    assert f"1 of {len(impulse)}" in browser.find_element("id", "least").text
    strong = browser.execute_script("return player.chosen.filter(k => player.source.events.isImpact(k)).length")
    assert strong == 1
    browser.execute_script(SET, browser.find_element("id", "threshold"), 0.0)
    assert f"all {len(impulse)} impacts" in browser.find_element("id", "least").text
    # Without impacts only what became of the contact is left: bouncing ended, and it began.
    kinds = {box.get_attribute("data-kind"): box for box in browser.find_elements("css selector", "#kinds input")}
    assert {"impact", "begin", "zeno"} <= set(kinds)
    kinds["impact"].click()
    texts = [row.text for row in browser.find_elements("css selector", "#rows button")]
    assert len(texts) >= 2
    assert any("bouncing ended (Zeno)" in text for text in texts)
    assert not any(text.startswith("impact") for text in texts)
    assert errors(browser) == []


def test_thousands_of_impacts_are_few_elements(browser, tmp_path):
    traj = cvi.simulate(ball_scene(), duration=5000.0, dt=1e-2, record_every=1000)
    assert len(traj.events) > 3000
    open_page(browser, traj, tmp_path, play=False)
    press(browser, "e")
    assert browser.execute_script("return player.chosen.length") > 3000
    assert browser.execute_script("return document.querySelectorAll('*').length") < 300
    assert browser.execute_script("return stage.renderer.info.render.calls") < 30
    # Its end is reached by scrolling, and the rows there are those of the last impacts. A busy machine draws it later.
    last = f"{traj.events[-1].time:.6g}"
    browser.execute_async_script(
        POLL,
        "(list => { list.scrollTop = 1e9; const row = document.querySelector('#rows button:last-child');"
        f" return row && row.innerText.includes('{last}'); }})(document.getElementById('list'))",
    )
    state = browser.execute_script(
        "const list = document.getElementById('list'), rows = [...document.querySelectorAll('#rows button')];"
        "return {top: list.scrollTop, height: list.clientHeight, hidden: document.getElementById('events').hidden,"
        " window: innerHeight, rows: rows.map(row => row.innerText)}"
    )
    assert last in "".join(state["rows"][-1:]), state
    assert errors(browser) == []


def test_words_of_events_are_wrapped(browser, tmp_path):
    """Names that are longer than a row is wide are there in full, and rows do not cover each other."""
    scene, long = cvi.Scene(), "a_ball_with_a_name_that_is_much_longer_than_names_of_balls_are"
    scene.add_halfspace(name="the_ground_on_which_everything_in_this_scene_falls_down")
    scene.add_sphere(long, 0.1, mass=1.0, placement=(0.0, 0.0, 0.5))
    scene.set_contact(restitution=0.5)
    open_page(browser, cvi.simulate(scene, duration=1.0, dt=1e-2), tmp_path, play=False)
    press(browser, "e")
    rows = browser.execute_script(
        "return [...document.querySelectorAll('#rows button')].map(row => [row.offsetTop, row.offsetHeight,"
        " row.scrollHeight, row.scrollWidth, row.clientWidth, row.innerText.replace(/\\n/g, '')]);"
    )
    assert len(rows) >= 2
    for _, height, inner, wide, width, text in rows:
        assert inner <= height
        assert wide <= width
        assert long in text
    tops = [row[0] for row in rows]
    assert np.all(np.diff(tops) >= rows[0][1])
    assert errors(browser) == []


def test_a_pair_has_one_colour_in_the_page_and_in_plots(browser, tmp_path):
    run = heap_of_boxes()
    open_page(browser, run, tmp_path, play=False)
    shown = {pair["name"]: pair["color"] for pair in browser.execute_script("return source.pairs")}
    figures = (cvi.plot_forces(run), cvi.plot(run))
    lines = [line for figure in figures for axis in figure.axes for line in axis.lines]
    drawn = [(line.get_label(), line.get_color()) for line in lines if " | " in str(line.get_label())]
    assert len(drawn) >= 12  # six pairs in each figure
    assert all(shown[name] == color for name, color in drawn)
    assert len(set(drawn)) == len({color for _, color in drawn})  # those that are drawn differ


# Of the impulses that are shown: their points, their starts and ends as they are drawn, on the screen; and lines.
STRUCK = """
stage.render();
const pixel = p => { const q = p.clone().project(stage.camera);
  return [(0.5 + 0.5 * q.x) * stage.width, (0.5 - 0.5 * q.y) * stage.height]; };
return {
  drawn: signs.impacts.places.map(([p, d, length]) => [pixel(p), pixel(p.clone().addScaledVector(d, length))]),
  points: signs.struck.map(({point}) => point.toArray()), starts: signs.starts.map(p => p.toArray()),
  apart: APART, ends: Array.from(signs.leaders.geometry.getAttribute("position").array)};
"""


def segments_apart(first: np.ndarray, second: np.ndarray) -> float:
    """The least distance of points that are scattered over two segments (2, 2)."""
    share = np.linspace(0.0, 1.0, 60)[:, None]
    a, b = ((1.0 - share) * ends[0] + share * ends[1] for ends in (first, second))
    return float(np.linalg.norm(a[:, None] - b[None], axis=2).min())


def test_impulses_at_one_place_are_drawn_beside_each_other(browser, tmp_path):
    """A ball bounces ever faster at one place: its impulses do not overlap, and lines lead to where they happened."""
    scene = ball_scene(restitution=0.6)
    traj = cvi.simulate(scene, duration=1.9, dt=1e-2)
    times = traj.events.array("time")
    open_page(browser, traj, tmp_path, play=False)
    browser.execute_script("signs.least = 0;")
    set_slider(browser, float(times[7]) + 1e-6)
    shown = browser.execute_script(STRUCK)
    assert len(shown["drawn"]) >= 3
    assert np.ptp(np.array(shown["points"])[:, :2], axis=0).max() < 1e-6  # all at one place
    drawn = np.array(shown["drawn"])
    for k, first in enumerate(drawn):
        for second in drawn[:k]:
            assert segments_apart(first, second) > shown["apart"] - 0.5
    moved = [k for k, (a, b) in enumerate(zip(shown["points"], shown["starts"], strict=True)) if a != b]
    ends = np.array(shown["ends"]).reshape(-1, 2, 3)
    assert len(moved) == len(drawn) - 1
    for k, line in zip(moved, ends, strict=True):
        assert line == pytest.approx(np.array([shown["points"][k], shown["starts"][k]]), abs=8 * SINGLE)
    again = "player.play(); player.time = arguments[0]; player.show(); "
    shown = browser.execute_script(again + STRUCK, float(times[7]) + 1e-6)
    assert shown["starts"] == shown["points"]  # while it plays arrows stay at their places
    assert shown["ends"] == []
    assert errors(browser) == []
