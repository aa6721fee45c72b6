"""The playback as data: frames, events, shapes, camera, and the page that holds them. See also test_browser.py."""

from __future__ import annotations

import math
import re
import urllib.error
import urllib.request
import warnings

import numpy as np
import pinocchio as pin
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

import contactvi as cvi
from contactvi.importing.kinematics import JointChains
from contactvi.playback import animation, event_list, framing, shapes, visuals
from contactvi.playback.animation import frames_of
from contactvi.playback.contact_frames import contact_frames
from contactvi.playback.event_list import KINDS, happenings
from contactvi.playback.lathe import outline_mesh
from contactvi.playback.open_side import trees_of
from contactvi.playback.page import make_html
from contactvi.playback.shapes import is_closed
from contactvi.playback.touches import Touches
from helpers.playback_data import PageEvents, run_data, unpacked
from helpers.run_scenes import RADIUS, ball_scene, hand_scene

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
    assert np.all(np.diff(times) > 0)
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


def test_poses_of_free_bodies_are_those_of_pinocchio():
    """A free body whose joint does not stand at the world's origin, beside one that does."""
    model = pin.Model()
    place = pin.SE3(pin.utils.rpyToMatrix(0.3, -0.4, 0.5), np.array([1.0, 2.0, 3.0]))
    model.addJoint(0, pin.JointModelFreeFlyer(), place, "a")
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "b")
    data = model.createData()
    model.lowerPositionLimit, model.upperPositionLimit = -np.ones(14), np.ones(14)
    configurations = np.array([pin.randomConfiguration(model) for _ in range(5)])
    found = animation.joint_poses(model, configurations, [0, 1, 2])
    for row, q in enumerate(configurations):
        pin.forwardKinematics(model, data, q)
        for joint in (1, 2):
            x, y, z, w = found[joint].quaternion[row]
            pose = pin.SE3(pin.Quaternion(w, x, y, z), found[joint].position[row])
            assert pose.isApprox(data.oMi[joint], 1e-12)
    assert found[0].quaternion.tolist() == [[0.0, 0.0, 0.0, 1.0]]


def test_impacts_are_listed_with_what_the_free_body_gets(ball):
    listed = happenings(ball)
    hits = listed.kind == KINDS.index("impact")
    assert listed.time[hits] == pytest.approx(ball.events.array("time"), abs=0.0)
    assert listed.point[hits] == pytest.approx(ball.events.array("point"), abs=0.0)
    assert listed.direction[hits] == pytest.approx(np.tile([0, 0, 1], (hits.sum(), 1)), abs=1e-12)
    assert np.all(np.diff(listed.time) >= 0.0)
    assert listed.left_out == 0


def test_the_strongest_impacts_are_listed(monkeypatch):
    traj = cvi.simulate(ball_scene(restitution=0.9), duration=3.0, dt=1e-2)
    impulses = np.sort(traj.events.array("impulse"))
    assert len(impulses) > 3
    monkeypatch.setattr(event_list, "MAX_IMPACTS", 3)
    listed = happenings(traj)
    assert np.sort(listed.impulse) == pytest.approx(impulses[-3:], abs=0.0)
    assert listed.left_out == len(impulses) - 3
    page = make_html(traj)
    assert f"{len(impulses) - 3} weaker impacts" in page


def test_pages_of_long_runs_stay_light():
    traj = cvi.simulate(ball_scene(), duration=5000.0, dt=1e-2, record_every=1000)
    assert len(traj.events) > 3000
    page = make_html(traj)
    assert len(page) < 3e6
    assert len(PageEvents.of(page).kind) == min(len(traj.events), event_list.MAX_IMPACTS)


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
    found = {shape["name"]: shape for shape in run_data(make_html(traj))["shapes"]}
    assert {name: shape["shape"] for name, shape in found.items()} == {
        "box": "box", "capsule": "capsule", "cylinder": "cylinder", "sphere": "sphere", "slope": "halfspace",
    }  # fmt: skip
    assert found["box"]["sizes"] == pytest.approx([0.05, 0.1, 0.15])
    assert found["sphere"]["opacity"] == 0.5


def test_black_and_white_are_drawn_nearer_to_grey():
    def tone(color):
        shape = visuals.Visual("a", 0, np.eye(4), "sphere", (1.0,), (*color, 1.0), np.zeros((0, 3)), np.zeros((0, 3)))
        return shapes.color_of(shape, 0)

    assert tone((0.0, 0.0, 0.0)) == "#6b6b6b"
    assert tone((1.0, 1.0, 1.0)) == "#e0e0e0"
    assert tone((0.5, 0.6, 0.7)) == "#8099b2"
    assert tone((1.0, 0.0, 0.0)) == "#ff0000"


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
    # A cell is about a twentieth of the size, and its point lies near the planes of its faces.
    assert np.abs(np.linalg.norm(thin.vertices, axis=1) - 1).max() < 0.01
    assert visuals.thin_out([heavy], len(faces)) == [heavy]


def test_flat_stays_flat_and_edges_sharp_in_thinned_meshes():
    """A cube with many triangles: the means of a cell's vertices would bevel its edges."""
    n = 60
    u, v = (part.reshape(-1) for part in np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij"))
    quads = np.arange(n * n).reshape(n, n)
    a, b, c, d = (x.reshape(-1) for x in (quads[:-1, :-1], quads[1:, :-1], quads[1:, 1:], quads[:-1, 1:]))
    side = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    points, faces = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            faces.append(side + n * n * len(points))
            points.append(np.roll(np.column_stack([np.full(n * n, sign), u, v]), axis, axis=1))
    cube = visuals.Visual(
        "a", 0, np.eye(4), "mesh", (), None,
        np.concatenate(points).astype(np.float32), np.concatenate(faces).astype(np.uint32),
    )  # fmt: skip
    (thin,) = visuals.thin_out([cube], 3000)
    assert len(thin.faces) <= 3000
    assert np.abs(np.abs(thin.vertices).max(axis=1) - 1).max() < 1e-4  # all points are on a face of the cube
    edges = np.sort(np.abs(thin.vertices), axis=1)[:, 1] > 1 - 1e-4
    assert edges.sum() >= 12 * 10


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


@pytest.mark.parametrize(("count", "links"), [(1, 0), (10, 4), (1000, 300), (1000, 800), (1000, 3000)])
def test_connected_components_are_those_of_scipy(count, links):
    pairs = np.random.default_rng(count + links).integers(0, count, (links, 2))
    graph = coo_matrix((np.ones(links), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    np.testing.assert_array_equal(shapes.components(count, pairs), connected_components(graph, directed=False)[1])


def test_poses_of_links_among_free_bodies():
    """Links beside bodies that have nothing to do with them are where Pinocchio has them, in the order asked for."""
    model, rng = pin.Model(), np.random.default_rng(3)
    for k in range(4):
        model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Random(), f"free{k}")
        arm = model.addJoint(0, pin.JointModelRY(), pin.SE3.Random(), f"arm{k}")
        ball = model.addJoint(arm, pin.JointModelSpherical(), pin.SE3.Random(), f"ball{k}")
        model.addJoint(ball, pin.JointModelRUBZ(), pin.SE3.Random(), f"wheel{k}")
    data, joints = model.createData(), [8, 16, 3, 2, 12]
    places = JointChains(model, joints)
    for _ in range(5):
        q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
        pin.forwardKinematics(model, data, q)
        expected = [pin.SE3ToXYZQUAT(data.oMi[joint]) for joint in joints]
        # Rounding of products of three placements of the size 1.
        np.testing.assert_allclose(places.poses(q), expected, rtol=0.0, atol=1e-14)


# -- camera -----------------------------------------------------------------------------------------------------------


def view_of(traj):
    return framing.fit(traj.visuals, animation.frames_of(traj, 60.0), trees_of(traj.scene.model))


def test_camera_sees_what_moves_and_not_the_ground(ball):
    view = view_of(ball)
    assert view.radius < 2.0
    assert view.center[2] == pytest.approx((1.1 + RADIUS) / 2, abs=0.02)
    assert np.linalg.norm(view.direction) == pytest.approx(1.0)


def test_camera_is_on_the_open_side_of_walls():
    for normal in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (-1, 0.5, 0.2)):
        scene = cvi.Scene()
        scene.add_sphere("ball", 0.1, placement=tuple(0.5 * np.array(normal, dtype=float)))
        scene.add_halfspace(normal, 0.0)
        traj = cvi.simulate(scene, duration=0.1, dt=1e-2)
        view = view_of(traj)
        assert np.dot(view.direction, normal) > 0


def test_what_flies_away_does_not_shrink_the_rest():
    scene = ball_scene()
    scene.add_sphere("runaway", 0.1, placement=(1.0, 0.0, 1.0))
    v0 = scene.velocity({"runaway": (100.0, 0.0, 0.0)})
    traj = cvi.simulate(scene, None, v0, duration=2.0, dt=1e-2)
    view = view_of(traj)
    assert traj.q[-1].max() > 100.0
    assert view.radius < 5.0


def test_the_picture_of_a_moment_fits_to_it(ball):
    """Of a ball that falls by a metre the picture shows the ball alone, where it is then."""
    frames, trees = animation.frames_of(ball, 60.0), trees_of(ball.scene.model)
    for moment in (0.0, 0.3):
        view = framing.fit(ball.visuals, frames, trees, moment)
        at = frames.poses[1].position[np.argmin(np.abs(frames.times - moment))]
        np.testing.assert_allclose(view.center, at, atol=1e-12)
        assert view.radius == pytest.approx(RADIUS * np.sqrt(3.0))
        assert np.ptp(view.outline, axis=0).max() <= 2.0 * RADIUS + 1e-12
    scene = ball_scene()
    scene.add_sphere("runaway", 0.1, placement=(1.0, 0.0, 1.0))
    traj = cvi.simulate(scene, None, scene.velocity({"runaway": (100.0, 0.0, 0.0)}), duration=2.0, dt=1e-2)
    view = framing.fit(traj.visuals, animation.frames_of(traj, 60.0), trees_of(scene.model), 2.0)
    assert view.radius < 5.0


def test_outline_holds_all_that_moves(hand):
    """In every direction the outline reaches as far as the shapes do, to a percent of the picture."""
    view, frames = view_of(hand), animation.frames_of(hand, 60.0)
    rng = np.random.default_rng(0)
    ball = next(visual for visual in hand.visuals if visual.name == "ball")
    for direction in rng.normal(size=(20, 3)):
        direction /= np.linalg.norm(direction)
        reach = (frames.poses[ball.joint].position @ direction).max() + ball.sizes[0]
        assert (view.outline @ direction).max() >= reach - 0.01 * view.radius


def test_the_open_side_shows_what_lies_in_a_bowl():
    """A ball behind a screen: from the usual side the screen hides it."""
    for x, y in ((1.0, -0.75), (-1.0, 0.75)):
        scene = cvi.Scene()
        scene.add_sphere("ball", 0.1, placement=(0.0, 0.0, 0.3))
        side = np.array([x, y]) / math.hypot(x, y)
        scene.add_box(
            "screen", (0.02, 1.2, 1.2), free=False,
            placement=((0.3 * side[0], 0.3 * side[1], 0.3), (0.0, 0.0, math.atan2(y, x))),
        )  # fmt: skip
        traj = cvi.simulate(scene, duration=0.2, dt=1e-2)
        toward = view_of(traj).direction
        ahead, aside = toward[:2] @ side, np.linalg.norm([toward[:2] @ [-side[1], side[0]], toward[2]])
        assert ahead <= 0.0 or 0.3 * aside / ahead > 0.6  # the way to the camera passes beside the screen


def touching_view(traj, moment=None):
    touches = Touches.of(traj.contacts, float(traj.t[0]))
    frames = animation.frames_of(traj, 60.0)
    return framing.fit(traj.visuals, frames, trees_of(traj.scene.model), moment, touches), touches


def behind_a_screen(x: float, y: float) -> cvi.Trajectory:
    """A ball that lies on a shelf, close behind an upright plate."""
    scene = cvi.Scene()
    side = np.array([x, y]) / math.hypot(x, y)
    scene.add_sphere("ball", 0.05, placement=(0.0, 0.0, 0.05))
    scene.add_box("shelf", (1.0, 1.0, 0.02), free=False, placement=(0.0, 0.0, -0.01))
    scene.add_box(
        "screen", (0.02, 1.0, 0.6), free=False,
        placement=((0.2 * side[0], 0.2 * side[1], 0.31), (0, 0, math.atan2(y, x))),
    )  # fmt: skip
    scene.set_contact(restitution=0.0, friction=0.5)
    return cvi.simulate(scene, duration=0.2, dt=1e-2)


@pytest.mark.parametrize(("x", "y"), [(1.0, -0.75), (-1.0, 0.75), (0.0, 1.0), (1.0, 0.0)])
def test_contacts_are_in_sight(x, y):
    """No plate stands between the contact and the camera."""
    view, _ = touching_view(behind_a_screen(x, y))
    side = np.array([x, y]) / math.hypot(x, y)
    ahead, aside = view.direction[:2] @ side, abs(view.direction[:2] @ [-side[1], side[0]])
    # Where the way to the camera comes to the plate, 0.2 m ahead, it is beside it or above it.
    hit = 0.2 / ahead if ahead > 0.0 else np.inf
    assert hit * aside > 0.5 or hit * view.direction[2] > 0.61


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.7, 0.4), (0.0, -1e-3, 1.0)])
def test_contacts_are_in_the_middle_half_of_the_picture(direction):
    """A box that slides far beside a tower: seen from any side, the impulse's mean is in the middle half."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.1, 0.1, 0.05), mass=1.0, placement=(0.0, 0.0, 0.025))
    scene.add_box("tower", (0.1, 0.1, 1.5), free=False, placement=(0.9, 0.4, 0.75))
    scene.disable_pair("box", "tower")
    scene.set_contact(restitution=0.0, friction=0.5)
    view, touches = touching_view(cvi.simulate(scene, duration=0.2, dt=1e-2))
    assert touches.center() == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)
    away = np.array(direction) / np.linalg.norm(direction)
    side = np.cross([0.0, 0.0, 1.0], away)
    for axis in (side / np.linalg.norm(side), np.cross(away, side / np.linalg.norm(side))):
        low, high = (view.outline @ axis).min(), (view.outline @ axis).max()
        place = (touches.center() @ axis - low) / (high - low)
        assert 0.24 <= place <= 0.76
    corners = np.array([(0.9 + a, 0.4 + b, 1.5) for a in (-0.05, 0.05) for b in (-0.05, 0.05)])
    for corner in corners:  # and nothing that was in the picture is lost
        assert (view.outline @ away).max() >= corner @ away - 0.01 * view.radius


def test_the_picture_of_a_moment_is_that_of_its_contacts():
    traj = behind_a_screen(1.0, 0.0)
    view, touches = touching_view(traj, 0.1)
    now = touches.at(0.1)
    assert 1 <= len(now) < len(touches)
    assert now.center() == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)
    assert view.direction[0] < 0.5


def test_a_run_without_contacts_has_the_view_of_its_motion(ball):
    scene = ball_scene()
    traj = cvi.simulate(scene, duration=0.1, dt=1e-2)
    view, touches = touching_view(traj)
    assert len(touches) == 0
    assert view.direction == pytest.approx(view_of(traj).direction)
    np.testing.assert_array_equal(view.outline, view_of(traj).outline)


# -- the page ---------------------------------------------------------------------------------------------------------


def test_page_holds_the_motion(ball, tmp_path):
    data = run_data(ball.to_html(tmp_path / "run.html").read_text())
    times = unpacked(data["times"])
    (moved,) = [body for body in data["bodies"] if body["moves"]]
    assert moved["name"] == "ball"
    assert set(ball.events.array("time")) <= set(times)
    q = ball.resample(times)
    assert unpacked(moved["position"]).reshape(-1, 3) == pytest.approx(q[:, :3], abs=8 * SINGLE)
    turned = np.abs(np.sum(unpacked(moved["quaternion"]).reshape(-1, 4) * q[:, 3:], axis=1))
    assert turned == pytest.approx(1.0, abs=64 * SINGLE)


def test_page_holds_the_impacts(ball):
    page = make_html(ball)
    listed = PageEvents.of(page)
    assert listed.kind == ["impact"] * len(ball.events)
    assert listed.time == pytest.approx(ball.events.array("time"), abs=0.0)
    assert set(listed.pair) == {("ball", "ground")}
    assert listed.impulse == pytest.approx(ball.events.array("impulse"), rel=4 * SINGLE)
    assert run_data(page)["duration"] == pytest.approx(2.5)


def test_page_names_kinds_of_what_happens():
    """A ball that bounces to rest, and one that hits a joint limit: the words are those of the records."""
    traj = cvi.simulate(ball_scene(restitution=0.5), duration=4.0, dt=1e-2)
    listed = PageEvents.of(make_html(traj))
    assert {"impact", "begin", "zeno"} <= set(listed.kind)
    ended = [change for change in traj.contact_changes if change.change == "bouncing ended"]
    assert [time for kind, time in zip(listed.kind, listed.time, strict=True) if kind == "zeno"] == [
        change.time for change in ended
    ]


@pytest.mark.parametrize("name", ["ball", "hand"])
def test_page_is_self_contained_and_finite(name, request):
    page = make_html(request.getfixturevalue(name), title="a </script><b> & b <!--")
    text = re.sub(r"<script[^>]*>.*?</script>", "", page, flags=re.DOTALL)
    assert "a &lt;/script&gt;&lt;b&gt; &amp; b &lt;!--" in page
    assert not re.findall(r"(?:src|href)\s*=", text)
    assert page.count("</script>") == 4  # the title did not end one
    assert len(page) < 5e6
    data = run_data(page)
    assert data["title"] == "a </script><b> & b <!--"

    def check(item):
        if isinstance(item, dict):
            if set(item) == {"type", "data"}:
                assert np.all(np.isfinite(unpacked(item)))
            for value in item.values():
                check(value)
        elif isinstance(item, list):
            for value in item:
                check(value)
        elif isinstance(item, float):
            assert math.isfinite(item)

    check(data)


def test_names_of_the_template_are_names_like_others():
    scene = cvi.Scene()
    name = "@PLAYER@ @THREE@ </script><script>alert(1)</script>"
    scene.add_sphere(name, 0.1)
    traj = cvi.simulate(scene, duration=0.1, dt=1e-2)
    page = make_html(traj, title="@RUN@ @SCRIPT@")
    assert "<title>@RUN@ @SCRIPT@</title>" in page
    assert page.count("</script>") == 4
    data = run_data(page)
    assert data["shapes"][0]["name"] == name
    assert data["bodies"][0]["name"] == name
    assert data["title"] == "@RUN@ @SCRIPT@"


@pytest.mark.parametrize(
    ("camera", "expected"),
    [
        (None, {"preset": "auto", "eye": None, "target": None}),
        ("top", {"preset": "top", "eye": None, "target": None}),
        ({"eye": (1, 2, 3), "target": np.zeros(3)}, {"preset": None, "eye": [1, 2, 3], "target": [0, 0, 0]}),
        ({"follow": "ball"}, {"follow": 1}),
    ],
)
def test_camera_of_the_page(ball, camera, expected):
    data = run_data(make_html(ball, camera=camera))
    assert data["camera"] == expected
    if expected == {"follow": 1}:
        assert data["bodies"][1]["name"] == "ball"


def test_camera_of_the_scene_goes_with_the_run(tmp_path):
    scene = ball_scene()
    scene.camera = {"follow": "ball"}
    traj = cvi.simulate(scene, duration=0.1, dt=1e-2)
    loaded = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    assert "follow" in run_data(make_html(loaded))["camera"]
    scene.camera = "top"  # after a run: the next one has it
    assert cvi.simulate(scene, duration=0.1, dt=1e-2).scene.camera == "top"
    with pytest.raises(cvi.InputError, match="unknown body"):
        scene.camera = {"follow": "bell"}
    assert scene.camera == "top"
    assert run_data(make_html(loaded, camera="side"))["camera"]["preset"] == "side"


@pytest.mark.parametrize(
    ("camera", "match"),
    [
        ("sid", "side"),
        (3, "eye"),
        ({"follow": "bal"}, "'ball'"),
        ({"follow": 3}, "name of a body"),
        ({"eye": (0, 0, 1)}, "Add target"),
        ({"eye": (0, 0, 1), "target": (0, 0, 1)}, "Move the eye"),
        ({"eye": (0, 0, math.nan), "target": (0, 0, 1)}, "finite"),
        ({"folow": "ball"}, "follow"),
        ({"eye": (0, 0, 1), "target": (0, 0, 0), "follow": "ball"}, "one of the others"),
    ],
)
def test_bad_cameras(ball, camera, match):
    with pytest.raises(cvi.InputError, match=match) as caught:
        make_html(ball, camera=camera)
    assert "camera" in str(caught.value).lower()


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


def test_closed_meshes_are_told_from_open_ones():
    """Also where files round the vertices of neighbouring faces apart; faces turned inside out are none of a solid."""
    points, faces = outline_mesh("box", (0.1, 0.2, 0.3))
    apart = points.astype(np.float32)[faces.reshape(-1)] + np.random.default_rng(0).uniform(0, 1e-8, (faces.size, 3))
    corners = np.arange(faces.size, dtype=np.uint32).reshape(-1, 3)
    assert is_closed(apart.astype(np.float32), corners)
    assert not is_closed(apart.astype(np.float32), corners[1:])
    assert not is_closed(apart.astype(np.float32), corners[:, ::-1])


def test_contact_points_stay_on_bodies_within_long_steps():
    """The corners of a box that slides in steps of an eighth of a second: where they are at each frame, but for the
    chord of the path, of which the sagitta is a h^2 / 8."""
    mu, h, half = 0.1, 0.125, 0.1
    scene = cvi.Scene()
    scene.add_halfspace()
    box = scene.add_box("box", size=(2 * half,) * 3, placement=(0, 0, half))
    scene.set_contact(friction=mu, restitution=0.0)
    traj = cvi.simulate(scene, v0=scene.velocity({box: (2.0, 0.0, 0.0)}), duration=1.0, dt=h)
    frames = frames_of(traj, 60.0)
    found = contact_frames(traj, frames.times, 0.3)
    assert np.diff(found.first).tolist() == [4] * len(frames.times)
    place = traj.resample(found.times)[:, 0]
    for k, x in enumerate(place):
        corners = np.sort(found.point[found.first[k] : found.first[k + 1], 0])
        # In the first step the point goes on as in the second: the speed differs by a h there.
        slack = mu * 9.81 * h**2 * (1.0 if found.times[k] < h else 0.125)
        assert corners == pytest.approx(x + half * np.array([-1, -1, 1, 1]), abs=slack + 1e-6)
