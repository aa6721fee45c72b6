"""Contact points that move: rates of their gaps, names of features, what touches next, what has ended; cylinders."""

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
    WITNESS,
    Two,
    Z,
    hull,
    pose,
    prism,
    random_pose,
    stacked,
    turn,
)
from oracles import manifold as oracle


def test_cylinder_lying_upright_and_tilted():
    R, half = 0.1, 0.25
    two = Two(GROUND, coal.Cylinder(R, 2 * half))
    lying = two.points(IDENTITY, pose(z=R, R=turn([1, 0, 0], np.pi / 2)))
    assert lying["kind"] == [RIM, RIM]
    assert not any(lying["material"])
    assert two.rest(IDENTITY, pose(z=R, R=turn([1, 0, 0], np.pi / 2)), lying["feature"]) == np.inf
    np.testing.assert_allclose(np.sort(lying["x"][:, 1]), [-half, half], atol=1e-15)
    assert two.nearest(IDENTITY, pose(z=half)) == 0.0  # coal: -2.5e-11
    for tilt in (0.0, 1e-15, 1e-10):
        body = pose(z=half, R=turn([1, 0.2, 0], tilt))
        upright = two.points(IDENTITY, body)
        assert upright["kind"] == [VERTEX] * 4
        assert all(upright["material"])
        assert oracle.area(upright["x"][:, :2]) == pytest.approx(2 * R**2, rel=1e-9)
        assert 0 < two.rest(IDENTITY, body, upright["feature"]) <= SLACK
    persistent = two.points(IDENTITY, pose(z=half))["feature"]
    for tilt in (1e-9, 1e-6, 1e-2, 1.0):
        body = two.touching(IDENTITY, pose(z=1.0, R=turn([1, 0.2, 0], tilt)))
        tilted = two.points(IDENTITY, body, margin=1e-11)
        assert tilted["kind"] == [RIM]
        assert not any(two.of(IDENTITY, body, persistent)["valid"])
        # The far side of the rim closes as the cylinder falls back; the rim gives its gap if flat points persist.
        if tilt < 0.1:
            assert two.rest(IDENTITY, body, tilted["feature"]) == pytest.approx(
                2 * R * np.sin(tilt), rel=1e-9, abs=4e-11
            )
        lower = two.rest(IDENTITY, pin.SE3(body.rotation, body.translation - 1e-8 * Z), persistent)
        assert lower == pytest.approx(SLACK - 1e-8, abs=1e-12)


@pytest.mark.parametrize(
    ("a", "b", "at"),
    [
        (GROUND, coal.Box(0.2, 0.4, 0.6), pose(z=0.3, R=turn([1, 2, 3], 0.2))),
        (GROUND, coal.Cylinder(0.1, 0.4), pose(z=0.3, R=turn([1, 2, 0], 0.4))),
        (GROUND, coal.Capsule(0.1, 0.4), pose(z=0.3, R=turn([1, 2, 0], 0.4))),
        (coal.Box(0.2, 0.2, 0.2), coal.Box(0.2, 0.2, 0.2), stacked(0.7, 0.05, 0.02, 0.2)),
        (coal.Box(0.2, 0.2, 0.2), coal.Capsule(0.05, 0.4), pose(0.1, 0.01, 0.15, turn([0.02, 1, 0], np.pi / 2 + 1e-5))),
        (coal.Box(0.2, 0.2, 0.2), coal.Cylinder(0.05, 0.4), pose(0.1, 0.01, 0.15, turn([0.0, 1, 0.02], np.pi / 2))),
    ],
)
def test_gaps_change_with_the_velocity_of_the_points_along_the_normal(a, b, at):
    """d(gap)/dt = n.(velocity of b's point - velocity of a's), each moving with its body."""
    two = Two(a, b)
    rng = np.random.default_rng(2)
    world = random_pose(rng, 0.3)
    pose_a, pose_b = world, world * at
    found = two.points(pose_a, pose_b, margin=1.0, most=16)
    eps = 1e-6
    for _ in range(5):
        v, w = rng.normal(size=6), rng.normal(size=6)
        forth = two.of(pose_a * pin.exp6(eps * v), pose_b * pin.exp6(eps * w), found["feature"])["gap"]
        back = two.of(pose_a * pin.exp6(-eps * v), pose_b * pin.exp6(-eps * w), found["feature"])["gap"]
        for i in range(len(found["gap"])):
            speed = []
            for M, twist, x in ((pose_a, v, found["point_a"][i]), (pose_b, w, found["point_b"][i])):
                arm = M.actInv(x)
                speed.append(M.rotation @ (twist[:3] + np.cross(twist[3:], arm)))
            expected = found["normal"][i] @ (speed[1] - speed[0])
            assert (forth[i] - back[i]) / (2 * eps) == pytest.approx(expected, abs=2e-8)


def test_features_keep_their_names_under_small_motions():
    rng = np.random.default_rng(5)
    for name, b in STACKS.items():
        two = Two(coal.Box(0.2, 0.2, 0.2), coal.Box(0.11, 0.3, 0.2))
        features = two.points(IDENTITY, b, margin=1e-9)["feature"]
        for _ in range(5):
            world = random_pose(rng)
            assert two.points(world, world * b, margin=1e-9)["feature"] == features, name
            slide = pose(*(1e-5 * rng.normal(size=2)))
            assert two.points(IDENTITY, slide * b, margin=1e-9)["feature"] == features, name


# ---- what touches next, what has ended ----------------------------------------------------------------------------


def tipped(two: Two, angle: float, place: pin.SE3) -> pin.SE3:
    """b turned about the world's y axis by angle, then lowered until it touches a."""
    return two.touching(IDENTITY, pin.SE3(turn([0, 1, 0], angle) @ place.rotation, place.translation + 0.05 * Z))


@pytest.mark.parametrize("name", ["offset", "turned by 45 degrees", "turned a little", "overhanging corner"])
@pytest.mark.parametrize("second", ["box", "prism"])
def test_rest_comes_down_to_zero_as_a_tipped_body_falls_flat(name, second):
    two = Two(coal.Box(0.2, 0.2, 0.2), coal.Box(0.2, 0.2, 0.2) if second == "box" else hull(prism(6, half=0.1)))
    slopes = []
    for angle in (3e-1, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8):
        b = tipped(two, angle, STACKS[name])
        persistent = two.points(IDENTITY, b, margin=1e-12)
        rest = two.rest(IDENTITY, b, persistent["feature"])
        assert 0.0 < rest < 0.5 * angle
        slopes.append(rest / angle)
    # From 1e-6 rad on corners move by less than edges are rounded by.
    np.testing.assert_allclose(slopes[6:], slopes[-1], rtol=5e-3)
    assert two.rest(IDENTITY, tipped(two, 1e-7, STACKS[name]), persistent["feature"]) > 0.0


def test_rest_turns_negative_where_another_corner_goes_through():
    two = Two(coal.Box(0.4, 0.4, 0.2), coal.Box(0.2, 0.2, 0.2))
    place = stacked(0.2, 0.03, 0.05)
    persistent = two.points(IDENTITY, tipped(two, 1e-3, place), margin=1e-12)
    assert len(persistent["gap"]) == 1
    x = persistent["x"][0]
    values = []
    for angle in np.linspace(1e-3, -1e-3, 9):
        # Turned about the persistent corner.
        start = tipped(two, 1e-3, place)
        R = turn([0, 1, 0], angle - 1e-3)
        corner = x + ROUNDING * Z
        values.append(
            two.rest(
                IDENTITY, pin.SE3(R @ start.rotation, corner + R @ (start.translation - corner)), persistent["feature"]
            )
        )
    assert np.all(np.diff(values) < 0)
    assert values[0] > 1e-5
    assert values[-1] < -1e-5


def test_rest_is_infinite_where_nothing_else_can_touch():
    for shape in (coal.Sphere(0.1), coal.Ellipsoid(0.1, 0.2, 0.3)):
        two = Two(coal.Box(0.2, 0.2, 0.2), shape)
        b = two.touching(IDENTITY, pose(z=0.6))
        found = two.points(IDENTITY, b)
        assert found["kind"] == [WITNESS]
        assert found["feature"] == [0]
        assert two.rest(IDENTITY, b, found["feature"]) == np.inf
    two = Two(GROUND, coal.Sphere(0.1))
    found = two.points(IDENTITY, pose(z=0.1))
    assert found["kind"] == [VERTEX]
    assert two.rest(IDENTITY, pose(z=0.1), found["feature"]) == np.inf


def test_points_that_slid_off_are_not_valid():
    two = Two(coal.Box(0.2, 0.2, 0.2), coal.Box(0.1, 0.1, 0.2))
    persistent = two.points(IDENTITY, stacked())["feature"]
    assert all(two.of(IDENTITY, stacked(x=0.04), persistent)["valid"])
    assert sum(two.of(IDENTITY, stacked(x=0.06), persistent)["valid"]) == 2
    over = two.points(IDENTITY, stacked(x=0.06))
    assert sorted(over["kind"]) == [VERTEX, VERTEX, EDGE, EDGE]
    assert sum(two.of(IDENTITY, stacked(x=0.16), over["feature"])["valid"]) == 0
