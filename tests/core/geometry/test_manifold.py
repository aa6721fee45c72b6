"""Contact points of pairs: gaps against an oracle and coal, and which points stand for a contact."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from helpers.touching_pairs import (
    EDGE,
    GROUND,
    IDENTITY,
    RIM,
    ROUNDING,
    SLACK,
    STACKS,
    VERTEX,
    Two,
    Z,
    hull,
    pose,
    prism,
    random_hull,
    random_pose,
    stacked,
    turn,
)
from oracles import manifold as oracle

# ---- against a halfspace ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("swapped", [False, True])
def test_a_rough_sole_is_exact_over_a_halfspace(swapped):
    """A corner 30 nm above the plane of its face: between two shapes that is noise, over a halfspace it is known."""
    points = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.2, 0.2) for z in (-0.05, 0.05)])
    points[0, 2] += 3e-8
    sole = hull(points)
    pair = (sole, GROUND) if swapped else (GROUND, sole)
    assert Two(*pair).noise() == Two(GROUND, coal.Box(0.2, 0.4, 0.1)).noise()
    other = coal.Box(1.0, 1.0, 1.0)
    # A plane through the middle of the four corners has them 7.5 nm off, one that lies on the highest 15 nm.
    rough = Two(other, sole).noise() - Two(other, coal.Box(0.2, 0.4, 0.1)).noise()
    assert 7e-9 < rough <= 1.5e-8


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("kind", ["box", "hull", "capsule", "sphere", "cylinder"])
def test_halfspace_gaps_are_the_oracles_and_coals(kind, swapped):
    rng = np.random.default_rng(1)
    half = np.array([0.1, 0.2, 0.15])
    vertices = {
        "box": oracle.box_vertices(half),
        "hull": random_hull(rng, 60),
        "capsule": np.array([[0, 0, -0.2], [0, 0, 0.2]]),
        "sphere": np.zeros((1, 3)),
        "cylinder": np.zeros((0, 3)),
    }[kind]
    shape = {
        "box": lambda: coal.Box(*(2 * half)),
        "hull": lambda: hull(vertices),
        "capsule": lambda: coal.Capsule(0.05, 0.4),
        "sphere": lambda: coal.Sphere(0.05),
        "cylinder": lambda: coal.Cylinder(0.1, 0.4),
    }[kind]()
    radius = 0.05 if kind in ("capsule", "sphere") else 0.0
    normal, offset, place = np.array([1.0, 2.0, 2.0]) / 3.0, 0.3, random_pose(rng, 0.1)
    ground = coal.Halfspace(normal, offset)
    two = Two(shape, ground, place_a=place) if swapped else Two(ground, shape, place_b=place)
    for _ in range(30):
        plane, body = random_pose(rng), random_pose(rng)
        a, b = (body, plane) if swapped else (plane, body)
        n = plane.rotation @ normal
        d = offset + n @ plane.translation
        M = body * place
        if kind == "cylinder":
            gaps = [oracle.circle_gap(M.act(np.array([0, 0, z])), M.rotation[:, 2], 0.1, n, d) for z in (-0.2, 0.2)]
        else:
            gaps = oracle.vertex_gaps(vertices, M.rotation, M.translation, n, d) - radius
        found = two.points(a, b, margin=10.0, most=100)
        assert np.min(found["gap"]) == pytest.approx(np.min(gaps), abs=1e-12)
        assert np.min(found["gap"]) == pytest.approx(two.gap(a, b), abs=1e-12)
        assert two.rest(a, b, []) == pytest.approx(np.min(gaps), abs=1e-12)
        assert two.nearest(a, b) == pytest.approx(two.rest(a, b, []), abs=1e-14)
        # Each point is one of the vertices, its contact points lie on its normal.
        for gap in found["gap"]:
            assert np.min(np.abs(gap - np.asarray(gaps))) < 1e-12
        across = found["point_b"] - found["point_a"]
        np.testing.assert_allclose(across, found["gap"][:, None] * found["normal"], atol=1e-14)
        np.testing.assert_allclose(found["normal"], np.tile(-n if swapped else n, (len(found["gap"]), 1)), atol=1e-14)
        assert set(found["material"]) == {kind in ("box", "hull")}


@pytest.mark.parametrize("tilt", [0.0, 1e-12, 1e-9, 1e-6, 1e-3])
def test_box_on_the_ground_flat_and_tilted(tilt):
    two = Two(GROUND, coal.Box(0.2, 0.4, 0.6))
    body = two.touching(IDENTITY, pose(z=0.4, R=turn([1, 0, 0], tilt)))
    lifted = 0.4 * np.sin(tilt)
    found = two.points(IDENTITY, body, margin=1e-7)
    assert found["kind"] == [VERTEX] * len(found["gap"])
    assert len(found["gap"]) == (4 if lifted < 1e-7 else 2)
    np.testing.assert_allclose(found["gap"] - found["gap"].min(), np.where(found["x"][:, 1] > 0, lifted, 0), atol=3e-13)
    lower = [f for f, x in zip(found["feature"], found["x"], strict=True) if x[1] < 0]
    if lifted > 0:
        assert two.rest(IDENTITY, body, lower) == pytest.approx(lifted, abs=3e-13)


def test_box_on_an_edge_on_a_corner_and_far_away():
    two = Two(GROUND, coal.Box(0.2, 0.4, 0.6))
    edge = two.touching(IDENTITY, pose(z=1, R=turn([1, 0, 0], 0.5)))
    corner = two.touching(IDENTITY, pose(z=1, R=turn([1, 2, 3], 0.5)))
    assert len(two.points(IDENTITY, edge)["gap"]) == 2
    assert len(two.points(IDENTITY, corner)["gap"]) == 1
    assert len(two.points(IDENTITY, pose(z=2.0))["gap"]) == 0


def test_many_corners_are_thinned_out_to_the_largest_area():
    two = Two(GROUND, hull(prism(12)))
    body = pose(z=0.07)
    everything = two.points(IDENTITY, body, most=100)
    assert len(everything["gap"]) == 12
    four = two.points(IDENTITY, body)
    assert oracle.area(four["x"][:, :2]) == pytest.approx(oracle.largest_area(everything["x"][:, :2], 4), rel=1e-9)
    # Which of the equal corners is the deepest by rounding does not matter.
    for tilt in (1e-16, -1e-16, 1e-14):
        again = two.points(IDENTITY, pose(z=0.07, R=turn([1, 0.3, 0], tilt)))
        assert again["feature"] == four["feature"]
    assert two.rest(IDENTITY, body, four["feature"]) == pytest.approx(SLACK, abs=1e-14)
    # Tilted, the lowest corner is always among them.
    deep = two.points(IDENTITY, pose(z=0.07, R=turn([0.3, 1, 0], 1e-5)), margin=1e-5)
    assert deep["gap"].min() == pytest.approx(two.rest(IDENTITY, pose(z=0.07, R=turn([0.3, 1, 0], 1e-5)), []), abs=0)


def test_random_polygons_lose_little_area():
    rng = np.random.default_rng(4)
    for _ in range(20):
        angles = np.sort(rng.uniform(0, 2 * np.pi, 9))
        corners = np.array([[0.1 * np.cos(a), 0.07 * np.sin(a), z] for a in angles for z in (0.0, 0.1)])
        two = Two(GROUND, hull(corners))
        flat = corners[::2, :2]
        assert oracle.area(two.points(IDENTITY, IDENTITY)["x"][:, :2]) > 0.9 * oracle.largest_area(flat, 4)


# ---- polytopes against polytopes ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", STACKS)
@pytest.mark.parametrize("size_b", [(0.2, 0.2, 0.2), (0.1, 0.3, 0.2)])
def test_flat_boxes_touch_at_the_corners_of_the_overlap(name, size_b):
    two = Two(coal.Box(0.2, 0.2, 0.2), coal.Box(*size_b))
    b = STACKS[name]
    core_a = np.array([0.1, 0.1, 0.1]) - ROUNDING
    core_b = np.array(size_b) / 2 - ROUNDING
    top = oracle.box_vertices(core_a)[:, :2]
    bottom = (oracle.box_vertices(core_b) @ b.rotation.T + b.translation)[:, :2]
    corners = oracle.overlap(top, bottom, 1e-8)
    for world in (IDENTITY, random_pose(np.random.default_rng(3))):
        a, b_W = world, world * b
        found = two.points(a, b_W, margin=1e-10, most=16)
        x = np.array([world.actInv(p) for p in found["x"]])
        np.testing.assert_allclose(found["gap"], 0.0, atol=1e-15)
        np.testing.assert_allclose(x[:, 2], 0.1, atol=1e-14)
        np.testing.assert_allclose(found["normal"], np.tile(world.rotation @ Z, (len(x), 1)), atol=1e-14)
        assert len(x) == len(corners)
        for corner in corners:
            assert np.min(np.linalg.norm(x[:, :2] - corner, axis=1)) < 2e-8
        four = two.points(a, b_W, margin=1e-10)
        assert len(four["gap"]) == min(4, len(corners))
        assert two.points(a, b_W, margin=1e-10)["feature"] == four["feature"]
        # The other corners touch as well, but only because the persistent points do.
        assert two.rest(a, b_W, four["feature"]) > 2.9e-11
        if len(corners) > 4:
            best = oracle.largest_area(corners, 4)
            assert oracle.area(np.array([world.actInv(p)[:2] for p in four["x"]])) > 0.9 * best


def test_aligned_boxes_have_exactly_four_points_in_either_order_and_at_any_noise():
    two = Two(coal.Box(0.2, 0.2, 0.2), coal.Box(0.2, 0.2, 0.2))
    features = two.points(IDENTITY, stacked())["feature"]
    assert len(features) == len(set(features)) == 4
    rng = np.random.default_rng(0)
    for _ in range(20):
        noise = pin.exp6(1e-14 * rng.normal(size=6))
        assert two.points(IDENTITY, stacked() * noise, margin=1e-9)["feature"] == features
        assert len(two.points(stacked() * noise, IDENTITY, margin=1e-9)["gap"]) == 4


SHAPES = {
    "box": lambda rng: coal.Box(*rng.uniform(0.05, 0.3, 3)),
    "hull": lambda rng: hull(random_hull(rng, 20)),
    "prism": lambda rng: hull(prism(int(rng.integers(3, 9)))),
    "capsule": lambda rng: coal.Capsule(0.04, 0.2),
    "cylinder": lambda rng: coal.Cylinder(0.06, 0.2),
}
NOISE = {"cylinder": 2e-8}


@pytest.mark.parametrize(
    ("first", "second"),
    [
        *[("box", "box"), ("box", "prism"), ("prism", "prism"), ("hull", "box"), ("hull", "hull")],
        *[("box", "capsule"), ("capsule", "hull"), ("cylinder", "box"), ("prism", "cylinder")],
    ],
)
def test_least_gap_is_the_distance_and_nothing_else_penetrates(first, second):
    rng = np.random.default_rng(7)
    noise = max(NOISE.get(first, 2e-9), NOISE.get(second, 2e-9))
    seen = set()
    for trial in range(60):
        two = Two(SHAPES[first](rng), SHAPES[second](rng), place_a=pose(0.01, 0.02, 0.03))
        if trial % 3 == 0:
            b = random_pose(rng, 0.1)
            b.translation = 0.6 * b.translation / np.linalg.norm(b.translation)
        else:
            tilt = rng.choice([0.0, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3, 1e-2, 0.1])
            flip = [np.eye(3), turn([1, 0, 0], np.pi / 2), turn([0, 1, 0], np.pi / 2)][rng.integers(3)]
            spin = turn(Z, rng.choice([0.0, np.pi / 4, rng.uniform(0, 7)]))
            b = pose(*rng.uniform(-0.1, 0.1, 2), 0.5, turn([*rng.normal(size=2), 0], tilt) @ spin @ flip)
        b = two.touching(IDENTITY, b)
        if abs(two.gap(IDENTITY, b)) > 1e-10:
            continue  # GJK's noise with cylinders
        found = two.points(IDENTITY, b)
        seen |= set(found["kind"])
        assert len(found["gap"]) >= 1
        assert found["gap"].min() == pytest.approx(two.gap(IDENTITY, b), abs=noise)
        np.testing.assert_allclose(np.linalg.norm(found["normal"], axis=1), 1.0, atol=1e-12)
        assert np.all(np.abs(found["gap"]) < 2e-9)
        plain = [f for f in found["feature"] if f >> 40 not in (8, 9)]
        assert two.rest(IDENTITY, b, plain) > -noise
    assert {VERTEX, EDGE} & seen


@pytest.mark.parametrize("depth", [1e-7, 1e-5, 1e-3, 4e-3, 6e-3])
def test_shapes_that_overlap_have_no_points_to_the_side(depth):
    """An edge that sinks in also crosses edges of the other along a normal in which the two overlap far more."""
    rng = np.random.default_rng(3)
    for _ in range(150):
        two = Two(hull(prism(int(rng.integers(3, 9)), 0.2, 0.1)), hull(prism(int(rng.integers(3, 9)), 0.2, 0.1)))
        tilt = turn([*rng.normal(size=2), 0], rng.uniform(0.0, 0.2)) @ turn(Z, rng.uniform(0, 7))
        b = two.touching(IDENTITY, pose(*rng.uniform(-0.2, 0.2, 2), 0.5, tilt))
        b.translation = b.translation - depth * two.core.gaps(two.q(IDENTITY, b))[1][0]
        found = two.points(IDENTITY, b, 0.0)
        assert len(found["gap"]) > 0
        # Features that face each other at a tilt of up to 0.2 overlap by little more than the pair, those to the side
        # by the size of the shapes; 1e-7 m is above the noise of coal's distances.
        assert found["gap"].min() >= 2.0 * two.gap(IDENTITY, b) - 1e-7


def test_cylinder_on_a_box():
    R, half = 0.05, 0.1
    two = Two(coal.Box(0.2, 0.2, 0.2), coal.Cylinder(R, 2 * half))
    core, border = R - ROUNDING, 0.1 - ROUNDING
    upright = two.points(IDENTITY, pose(z=0.2))
    assert upright["kind"] == [VERTEX] * 4
    assert oracle.area(upright["x"][:, :2]) == pytest.approx(2 * core**2, rel=1e-9)
    # Over the border: the part of the disc that lies on the box is spanned.
    over = two.points(IDENTITY, pose(0.08, 0.0, 0.2), most=16)
    angles = np.arccos((border - 0.08) / core)
    ends = over["x"][np.abs(over["x"][:, 0] - border) < 1e-12]
    np.testing.assert_allclose(np.sort(ends[:, 1]), [-core * np.sin(angles), core * np.sin(angles)], atol=1e-12)
    assert over["x"][:, 0].max() < border + 1e-12
    # Lying across the border: its end on the box, and its side on the box's edge.
    lying = two.points(IDENTITY, pose(0.08, 0.0, 0.15, turn([0, 1, 0], np.pi / 2)))
    assert sorted(lying["kind"]) == [RIM, EDGE]
    np.testing.assert_allclose(np.sort(lying["x"][:, 0]), [0.08 - half + ROUNDING, border], atol=1e-9)
    # A disc that is wider than the box stands on the box's corners.
    wide = Two(coal.Box(0.1, 0.1, 0.2), coal.Cylinder(0.2, 0.2)).points(IDENTITY, pose(z=0.2))
    assert wide["kind"] == [VERTEX] * 4
    np.testing.assert_allclose(np.abs(wide["x"][:, :2]), 0.05 - ROUNDING, atol=1e-12)


@pytest.mark.parametrize("corners", [8, 12, 40])
def test_hulls_with_many_faces_at_a_vertex_have_flat_faces(corners):
    """Such a vertex becomes several in the rounded hull, at most 1e-6 m apart: none of them is in a wrong face."""
    box = coal.Box(0.1, 0.1, 0.1)
    two = Two(hull(random_hull(np.random.default_rng(corners), corners)), box)
    assert two.noise() == pytest.approx(Two(box, box).noise(), abs=1e-14)


def test_flat_sides_of_single_precision_hulls_are_one_side():
    R = pin.Quaternion(0.3, 0.5, -0.2, 0.7).normalized().matrix()
    points = np.array([np.float32(R @ x) for x in prism(7)], dtype=float)
    two = Two(GROUND, hull(points))
    body = two.touching(IDENTITY, pose(z=0.2, R=R.T))
    assert len(two.points(IDENTITY, body, margin=1e-7, most=16)["gap"]) == 7
    stack = Two(hull(points), hull(points), place_a=pose(R=R.T), place_b=pose(R=R.T))
    b = stack.touching(IDENTITY, pose(0.02, 0.01, 0.2))
    found = stack.points(IDENTITY, b, margin=1e-7, most=16)
    assert len(found["gap"]) >= 6
    assert oracle.area(found["x"][:, :2]) > 0.015
