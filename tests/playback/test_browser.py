"""The playback in a real browser: no errors, every control does what it says, and there is a picture."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver.support.ui import WebDriverWait

import contactvi as cvi
from helpers.browser_page import POLL, errors, press, set_slider
from helpers.contact_runs import CORNERS, MASS, MU, SPEED, STEP, place, sliding_box
from helpers.line_scenes import hung_ball
from helpers.run_scenes import GRAVITY, ball_scene, hand_scene

pytestmark = pytest.mark.browser

SINGLE = float(np.finfo(np.float32).eps)  # three.js keeps the tracks as float32
POSITION = """
const found = stage.bodies.filter(body => body.name === arguments[0]);
if (found.length !== 1) { throw new Error(found.length + " bodies " + arguments[0]); }
return found[0].position.toArray();
"""
# Start and vector, of the length that is drawn, of the arrows that are shown.
ARROWS = """
return signs[arguments[0]].places.map(([point, direction, length]) =>
  [...point.toArray(), ...direction.clone().multiplyScalar(length).toArray()]);
"""


@pytest.fixture(scope="module")
def ball() -> cvi.Trajectory:
    scene = ball_scene(restitution=0.8)
    v0 = scene.velocity({"ball": ((0.5, -0.2, 0.0), (0.0, 3.0, 7.0))})
    return cvi.simulate(scene, None, v0, duration=2.5, dt=1e-2)


def open_page(browser, traj: cvi.Trajectory, folder: Path, **options) -> None:
    browser.get(traj.to_html(folder / "playback.html", overwrite=True, **options).as_uri())
    # A busy browser may come back before the scripts of the page have run: a key that is pressed then is lost.
    WebDriverWait(browser, 20.0).until(
        lambda _: browser.execute_script("return document.readyState === 'complete' && typeof panels === 'object'")
    )


def time_of(browser) -> float:
    return browser.execute_script("return player.time")


SET = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'));"


def type_speed(browser, text: str) -> None:
    browser.execute_script(SET, browser.find_element("id", "speed"), text)


def camera_of(browser) -> tuple[np.ndarray, np.ndarray]:
    """Eye and target of the camera [m]."""
    found = browser.execute_script("return [stage.camera.position.toArray(), orbit.target.toArray()]")
    return np.array(found[0]), np.array(found[1])


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


def is_color(image: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Where a picture (height, width, 3) has a colour."""
    return np.abs(image - color).max(axis=2) < 25


def picture(browser, path: Path) -> np.ndarray:
    """What is on the screen after the next drawn frame, shape (height, width, 3), also written to `path`."""
    from PIL import Image

    browser.execute_async_script(
        "const done = arguments[0]; stage.draw();requestAnimationFrame(() => requestAnimationFrame(() => done(true)));"
    )
    data = browser.get_screenshot_as_png()
    path.write_bytes(data)
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


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


def heap_of_boxes() -> cvi.Trajectory:
    """Thirty boxes beside and behind each other: their names would cover each other."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(30):
        x, y = 0.06 * (k % 6), 0.06 * (k // 6)
        scene.add_box(f"box_number_{k}", (0.05, 0.05, 0.05), mass=1.0, placement=(x, y, 0.025))
    scene.set_contact(restitution=0.0, friction=0.5)
    return cvi.simulate(scene, duration=0.02, dt=1e-2)


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


def test_page_plays_by_itself_and_stops_at_the_end(browser, ball, tmp_path):
    open_page(browser, ball, tmp_path)
    assert browser.execute_script("return player.playing || player.time > 0")
    # Polled, not timed: on a busy machine the first frame may take seconds.
    later = browser.execute_async_script("player.seek(0); player.play();" + POLL, "player.time > 0")
    assert 0 < later <= 2.5
    browser.execute_async_script("player.seek(2.45);" + POLL, "!player.playing")
    end = browser.execute_script("return [player.time, player.playing]")
    assert end == [pytest.approx(2.5), False]


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
