"""The playback as data: frames, markers, shapes, camera, and the page that holds them. See also test_browser.py."""

from __future__ import annotations

import math
import re
import urllib.error
import urllib.request
import warnings

import numpy as np
import pinocchio as pin
import pytest
import umsgpack

import contactvi as cvi
from contactvi.playback import animation, shapes, visuals
from contactvi.playback.page import make_html
from helpers.playback_data import FLOAT_ARRAY, commands, run_data, tracks
from helpers.run_scenes import FIRST_IMPACT, RADIUS, ball_scene, hand_scene

SINGLE = float(np.finfo(np.float32).eps)


@pytest.fixture(scope="module")
def ball() -> cvi.Trajectory:
    scene = ball_scene(restitution=0.8)
    v0 = scene.velocity({"ball": ((0.5, -0.2, 0.0), (0.0, 3.0, 7.0))})
    return cvi.simulate(scene, None, v0, duration=2.5, dt=1e-2)


@pytest.fixture(scope="module")
def hand() -> cvi.Trajectory:
    scene, q0 = hand_scene()
    return cvi.simulate(scene, q0, duration=2.0, dt=1e-3, throw=False)


# -- frames -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fps", [5.0, 60.0, 1000.0])
def test_frames_meet_start_end_and_impacts(ball, fps):
    times = animation.frame_times(ball, fps, 1)
    assert np.all(np.diff(times.astype(np.float32)) > 0)
    assert times[0] == ball.t[0]
    assert times[-1] == ball.t[-1]
    assert set(ball.events.array("time")) <= set(times)
    assert np.diff(times).max() <= 1.1 / fps
    assert len(times) <= 2.5 * fps + 2 + len(ball.events)


def test_number_of_frames_is_bounded():
    traj = cvi.simulate(ball_scene(), duration=400.0, dt=1e-2, record_every=100)
    assert len(traj.events) > 400
    assert len(animation.frame_times(traj, 60.0, 1)) <= animation.MAX_FRAMES
    assert 100 * len(animation.frame_times(traj, 60.0, 100)) <= 1.01 * animation.MAX_POSES


def test_poses_are_those_of_pinocchio(hand):
    frames = animation.frames_of(hand, 60.0)
    model, data = hand.scene.model, hand.scene.model.createData()
    for k in (0, len(frames.times) // 3, len(frames.times) - 1):
        pin.forwardKinematics(model, data, hand.resample([frames.times[k]])[0])
        for joint, poses in frames.poses.items():
            row = k if poses.moves else 0
            x, y, z, w = poses.quaternion[row]
            pose = pin.SE3(pin.Quaternion(w, x, y, z), poses.position[row])
            assert pose.isApprox(data.oMi[joint], 1e-6 if not poses.moves else 1e-12)
    assert not frames.poses[0].moves
    for poses in frames.poses.values():
        assert np.all(np.sum(poses.quaternion[1:] * poses.quaternion[:-1], axis=1) > 0)


def test_markers_show_around_their_impacts(ball):
    markers = animation.markers_of(ball)
    shown = sorted((m.start[k], m.end[k], tuple(m.point[k])) for m in markers for k in range(len(m.start)))
    assert [start for start, _, _ in shown] == list(ball.events.array("time"))
    for (start, end, point), event in zip(shown, ball.events, strict=True):
        assert start < end <= start + 0.25
        assert point == tuple(event.point)
        assert point[2] == pytest.approx(0.0, abs=1e-12)
    for marker in markers:
        assert np.all(np.array(marker.start[1:]) >= np.array(marker.end[:-1]))
        for direction in marker.direction:
            assert direction == pytest.approx([0, 0, 1], abs=1e-12)  # what the ball gets, not the ground


def test_markers_are_reused():
    traj = cvi.simulate(ball_scene(), duration=100.0, dt=1e-2)
    assert len(traj.events) > 100
    assert len(animation.markers_of(traj)) == 1


def test_number_of_shown_impacts_is_bounded():
    traj = cvi.simulate(ball_scene(), duration=5000.0, dt=1e-2, record_every=1000)
    assert len(traj.events) > animation.MAX_IMPACTS
    assert len(animation.shown_impacts(traj)) == animation.MAX_IMPACTS
    page = make_html(traj)
    assert len(page) < 3e6
    assert f"{animation.MAX_IMPACTS} of the impacts are shown" in page


# -- shapes -----------------------------------------------------------------------------------------------------------


def test_visuals_of_a_hand(hand):
    kinds = {visual.name: visual.shape for visual in hand.visuals}
    assert kinds["ball"] == "sphere"
    assert kinds["ground"] == "halfspace"
    assert sum(kind == "mesh" for kind in kinds.values()) == 21
    assert len(kinds) == 23


def test_every_primitive_is_drawn(tmp_path):
    scene = cvi.Scene()
    scene.add_box("box", (0.1, 0.2, 0.3), placement=(0, 0, 1))
    scene.add_capsule("capsule", 0.1, 0.3, placement=(1, 0, 1))
    scene.add_cylinder("cylinder", 0.1, 0.3, placement=(2, 0, 1))
    scene.add_sphere("sphere", 0.1, placement=(3, 0, 1), color=(1, 0, 0, 0.5))
    scene.add_halfspace((1, 0, 1), -1.0, name="slope")
    traj = cvi.simulate(scene, duration=0.1, dt=1e-2)
    found = [command for command in commands(make_html(traj)) if command["type"] == "set_object"]
    kinds = [command["object"]["geometries"][0]["type"] for command in found]
    assert {"BoxGeometry", "CylinderGeometry", "SphereGeometry", "BufferGeometry"} <= set(kinds)
    for name in ("box", "capsule", "cylinder", "sphere", "slope"):
        assert any(name in command["path"] for command in found)


def sphere_mesh(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a unit sphere with about 2 count^2 triangles."""
    theta, phi = np.meshgrid(np.linspace(0, math.pi, count), np.linspace(0, 2 * math.pi, count), indexing="ij")
    points = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    index = np.arange(count * count).reshape(count, count)
    a, b, c, d = (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return points.reshape(-1, 3).astype(np.float32), faces.astype(np.uint32)


def test_heavy_meshes_are_thinned_out():
    vertices, faces = sphere_mesh(120)
    heavy = visuals.Visual("a", 0, np.eye(4), "mesh", (), None, vertices, faces)
    (thin,) = visuals.thin_out([heavy], 4000)
    assert 1000 < len(thin.faces) <= 4000
    assert int(thin.faces.max()) < len(thin.vertices)
    # A cell is about a twentieth of the size: averaging its vertices moves the surface by less.
    assert np.abs(np.linalg.norm(thin.vertices, axis=1) - 1).max() < 0.05
    assert visuals.thin_out([heavy], len(faces)) == [heavy]


def test_round_parts_look_round_and_edges_sharp():
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], dtype=np.uint32)
    vertices, normals, index = shapes.creased(corners, faces)
    assert len(vertices) == 24  # three normals at each of the eight corners
    assert np.sort(np.abs(normals), axis=1) == pytest.approx(np.tile([0, 0, 1], (24, 1)), abs=SINGLE)
    np.testing.assert_array_equal(vertices[index], corners[faces])

    points, faces = sphere_mesh(40)
    vertices, normals, index = shapes.creased(points, faces)
    outside = np.linalg.norm(vertices, axis=1, keepdims=True)
    middle = np.abs(vertices[:, 2]) < 0.9  # the triangles at the poles are degenerate
    assert np.sum(normals * vertices / outside, axis=1)[middle].min() > 0.99


# -- camera -----------------------------------------------------------------------------------------------------------


def test_camera_sees_what_moves_and_not_the_ground(ball):
    view = shapes.fit(ball.visuals, animation.frames_of(ball, 60.0))
    assert view["radius"] < 2.0
    assert view["center"][2] == pytest.approx((1.1 + RADIUS) / 2, abs=0.02)
    assert np.linalg.norm(view["direction"]) == pytest.approx(1.0)


def test_camera_is_on_the_open_side_of_walls():
    for normal in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (-1, 0.5, 0.2)):
        scene = cvi.Scene()
        scene.add_sphere("ball", 0.1, placement=tuple(0.5 * np.array(normal, dtype=float)))
        scene.add_halfspace(normal, 0.0)
        traj = cvi.simulate(scene, duration=0.1, dt=1e-2)
        view = shapes.fit(traj.visuals, animation.frames_of(traj, 60.0))
        assert np.dot(view["direction"], normal) > 0


def test_what_flies_away_does_not_shrink_the_rest():
    scene = ball_scene()
    scene.add_sphere("runaway", 0.1, placement=(1.0, 0.0, 1.0))
    v0 = scene.velocity({"runaway": (100.0, 0.0, 0.0)})
    traj = cvi.simulate(scene, None, v0, duration=2.0, dt=1e-2)
    view = shapes.fit(traj.visuals, animation.frames_of(traj, 60.0))
    assert traj.q[-1].max() > 100.0
    assert view["radius"] < 5.0


# -- the page ---------------------------------------------------------------------------------------------------------


def test_page_holds_the_motion(ball, tmp_path):
    page = ball.to_html(tmp_path / "run.html").read_text()
    moved = next(found for path, found in tracks(page).items() if path.endswith("_ball"))
    position, quaternion = moved[".position"], moved[".quaternion"]
    times = position["times"]
    for event in ball.events:
        assert np.abs(times - event.time).min() <= SINGLE * event.time
    q = ball.resample(np.clip(times.astype(float), 0, 2.5))
    assert position["values"].reshape(-1, 3) == pytest.approx(q[:, :3], abs=8 * SINGLE)
    turned = np.abs(np.sum(quaternion["values"].reshape(-1, 4) * q[:, 3:], axis=1))
    assert turned == pytest.approx(1.0, abs=64 * SINGLE)


def test_page_holds_the_impacts(ball):
    page = make_html(ball)
    data = run_data(page)
    assert [hit["t"] for hit in data["impacts"]] == pytest.approx(ball.events.array("time"))
    assert data["impacts"][0]["pair"] == "ball | ground"
    assert data["duration"] == pytest.approx(2.5)
    markers = {path: found for path, found in tracks(page).items() if "/impacts/" in path}
    point = markers["/contactvi/impacts/0"]
    visible = point[".visible"]
    at_impact = np.searchsorted(visible["times"], np.float32(FIRST_IMPACT) * (1 + 2 * SINGLE)) - 1
    assert visible["values"][at_impact]
    assert not visible["values"][0]
    scale = markers["/contactvi/impacts/0/arrow"][".scale"]["values"].reshape(-1, 3)
    impulses = ball.events.array("impulse")
    assert scale[:, 2] == pytest.approx(impulses / impulses.max(), rel=4 * SINGLE)


@pytest.mark.parametrize("name", ["ball", "hand"])
def test_page_is_self_contained_and_finite(name, request):
    page = make_html(request.getfixturevalue(name), title="a </script><b> & b")
    text = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
    assert "<script" in page
    assert "a &lt;/script&gt;&lt;b&gt; &amp; b" in page
    assert not re.findall(r"(?:src|href)\s*=", text)
    assert page.count("</script>") == 3  # the title did not end one
    assert len(page) < 10e6

    def check(item):
        if isinstance(item, dict):
            for value in item.values():
                check(value)
        elif isinstance(item, (list, tuple)):
            for value in item:
                check(value)
        elif isinstance(item, umsgpack.Ext) and item.type == FLOAT_ARRAY:
            assert np.all(np.isfinite(np.frombuffer(item.data, np.float32)))
        elif isinstance(item, float):
            assert math.isfinite(item)

    check(commands(page))


def test_names_of_the_template_are_names_like_others():
    scene = cvi.Scene()
    scene.add_sphere("@COMMANDS@ @MESHCAT@", 0.1)
    traj = cvi.simulate(scene, duration=0.1, dt=1e-2)
    page = make_html(traj, title="@RUN@ @MESHCAT@")
    assert "<title>@RUN@ @MESHCAT@</title>" in page
    assert run_data(page)["duration"] == pytest.approx(0.1)
    assert any("__COMMANDS___MESHCAT_" in str(command.get("path")) for command in commands(page))


def test_run_that_never_started_has_a_page():
    scene = ball_scene()
    q0 = scene.configuration({"ball": (0.0, 0.0, 0.05)})
    traj = cvi.simulate(scene, q0, duration=1.0, dt=1e-2, throw=False)
    data = run_data(make_html(traj))
    assert data["duration"] == 0.0
    assert any(fact["bad"] and "PENETRATION" in fact["text"] for fact in data["facts"])


@pytest.mark.parametrize("fps", [0, -1.0, math.nan, "fast"])
def test_bad_frame_rate(ball, fps):
    with pytest.raises(cvi.InputError, match="fps"):
        make_html(ball, fps=fps)


def test_view_serves_the_page(ball, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda url, new=0: opened.append(url))
    shown = cvi.view(ball)
    try:
        assert opened == [shown.url]
        assert shown.url in capsys.readouterr().out
        page = urllib.request.urlopen(shown.url).read().decode()
        assert run_data(page)["duration"] == 2.5
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(shown.url + "other")
        assert "<iframe srcdoc=" in shown._repr_html_()
    finally:
        shown.close()


# -- the figure -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ball", "hand"])
def test_figure(name, request, tmp_path):
    figure = cvi.plot(request.getfixturevalue(name))
    assert len(figure.axes) == 3
    figure.savefig(tmp_path / "energy.png")
    assert (tmp_path / "energy.png").stat().st_size > 10_000


def test_figure_draws_losses_as_steps(ball):
    line = next(line for line in cvi.plot(ball).axes[0].lines if line.get_label() == "H - H(0)")
    t, change = line.get_data()
    assert np.all(np.diff(t) >= 0)
    for event in ball.events:
        at = change[t == event.time]
        assert at[1] - at[0] == pytest.approx(event.energy_change, rel=1e-9)
    # Between the impacts nothing is lost: only as many different heights as there are impacts, and the start.
    assert len(np.unique(np.round(change, 9))) == 1 + len(ball.events)


def test_figure_of_a_run_without_impacts():
    traj = cvi.simulate(ball_scene(), duration=0.2, dt=1e-2)
    assert len(cvi.plot(traj).axes) == 2


@pytest.mark.parametrize("place", [1e20, 1e50])
def test_bodies_that_are_very_far_have_a_page_without_a_warning(tmp_path, place):
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, free=False, placement=(place, 0, 0))
    scene.add_sphere("free", 0.1, placement=(0, 0, 1))
    traj = cvi.simulate(scene, duration=0.01, dt=1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert traj.to_html(tmp_path / "far.html").stat().st_size > 0
