"""Contact along lines: the two ends of the segment in common, their gaps against an oracle, and what closes next."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from helpers.touching_pairs import END, IDENTITY, RIM_LINE, WITNESS, Two, Z, hull, pose, random_pose, turn
from oracles import lines

LYING = turn([1, 0, 0], np.pi / 2)  # the axis along -y
R, LENGTH = 0.05, 0.4
SHAPES = {"capsule": coal.Capsule(R, LENGTH), "cylinder": coal.Cylinder(R, LENGTH)}
KINDS = {"capsule": END, "cylinder": RIM_LINE}
PAIRS = [("capsule", "capsule"), ("capsule", "cylinder"), ("cylinder", "capsule"), ("cylinder", "cylinder")]


def axis(M: pin.SE3, half: float = LENGTH / 2) -> tuple[np.ndarray, np.ndarray]:
    return M.act(-half * Z), M.act(half * Z)


def crossed(yaw: float, tilt: float = 0.0, shift: float = 0.1, height: float = 2 * R) -> pin.SE3:
    return pose(0.0, shift, height, turn(Z, yaw) @ turn([1, 0, 0], tilt) @ LYING)


def lowered(two: Two, below: pin.SE3, body: pin.SE3) -> pin.SE3:
    """The body moved along z until the two touch."""
    for _ in range(60):
        gap = two.gap(below, body)
        if abs(gap) < 1e-15:
            break
        body = pin.SE3(body.rotation, body.translation - gap * Z)
    return body


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
@pytest.mark.parametrize("yaw", [0.0, 1e-12, 1e-6])
def test_parallel_lines_touch_at_both_ends_of_the_segment_in_common(pair, yaw):
    two = Two(SHAPES[pair[0]], SHAPES[pair[1]])
    below = pose(R=LYING)
    above = lowered(two, below, crossed(yaw))
    found = two.points(below, above, margin=1e-11)
    assert set(found["kind"]) <= {KINDS[pair[0]], KINDS[pair[1]]}
    # Shifted by .1 m the ends are one of each body.
    np.testing.assert_allclose(np.sort(found["x"][:, 1]), [-0.1, 0.2], atol=2e-3)  # cylinders have rounded edges
    # The distance by which they touch is exact for capsules; with a cylinder it has a noise of 6e-11 m.
    assert np.abs(found["gap"]).max() <= (2e-11 if pair == ("capsule", "capsule") else 6e-11)
    assert two.rest(below, above, found["feature"]) > 1e-3


@pytest.mark.parametrize("yaw", [1e-10, 1e-8, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0])
def test_gaps_of_capsules_are_exact_at_every_angle(yaw):
    """Coal's is up to 4e-7 m too large below 1e-4 rad."""
    two = Two(SHAPES["capsule"], SHAPES["capsule"])
    rng = np.random.default_rng(int(-10 * np.log10(yaw)))
    for _ in range(20):
        a = random_pose(rng, 0.3)
        b = a * crossed(yaw, yaw * rng.uniform(-1, 1), rng.uniform(-0.6, 0.6), 2 * R + rng.uniform(-0.01, 0.1))
        b = b * pin.SE3(LYING.T @ turn(rng.normal(size=3), 1e-3 * yaw) @ LYING, np.zeros(3))
        exact = lines.segments(axis(a), axis(b)) - 2 * R
        assert two.gap(a, b) == pytest.approx(exact, abs=2e-15)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_lines_that_cross_touch_in_one_point(pair):
    two = Two(SHAPES[pair[0]], SHAPES[pair[1]])
    below = pose(R=LYING)
    for yaw in (1e-3, 1e-2, 0.1, 1.0):
        found = two.points(below, lowered(two, below, crossed(yaw)), margin=1e-11)
        assert len(found["kind"]) == 1
        np.testing.assert_allclose(found["x"][0, :2], [0.0, 0.1], atol=1e-9)
        assert found["kind"][0] not in (END, RIM_LINE)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_an_end_keeps_its_name_and_its_gap_as_bodies_tip(pair):
    """One end stays where it is, and the gap of the other is the distance of the end from the line."""
    two = Two(SHAPES[pair[0]], SHAPES[pair[1]])
    below = pose(R=LYING)
    flat = two.points(below, lowered(two, below, crossed(0.0)), margin=1e-11)
    for tilt in (1e-9, 1e-6, 1e-3, 3e-2):
        for side in (1.0, -1.0):
            above = lowered(two, below, crossed(0.0, side * tilt))
            found = two.points(below, above, margin=1e-12)
            assert len(found["kind"]) == 1
            assert found["feature"][0] in flat["feature"]
            other = [f for f in flat["feature"] if f != found["feature"][0]]
            gap = two.of(below, above, other)["gap"][0]
            assert gap == pytest.approx(0.3 * np.sin(tilt), rel=0.05)
            assert two.rest(below, above, found["feature"]) == pytest.approx(gap, abs=1e-15)


@pytest.mark.parametrize("kind", ["capsule", "cylinder", "box"])
@pytest.mark.parametrize("swapped", [False, True])
def test_a_line_on_the_end_of_a_cylinder_touches_along_a_chord(kind, swapped):
    top = coal.Cylinder(0.08, 0.1)
    bar = {**SHAPES, "box": coal.Box(0.07, 0.07, LENGTH)}[kind]
    two = Two(bar, top) if swapped else Two(top, bar)
    on_edge = turn(Z, np.pi / 4) if kind == "box" else np.eye(3)
    height = 0.05 + (0.07 / np.sqrt(2) if kind == "box" else R)
    body = pose(0.03, 0.0, height, LYING @ on_edge)

    def both(M):
        return (M, IDENTITY) if swapped else (IDENTITY, M)

    for _ in range(40):
        body = pin.SE3(body.rotation, body.translation - two.gap(*both(body)) * Z)
    found = two.points(*both(body), margin=1e-11)
    assert found["kind"] == [RIM_LINE, RIM_LINE]
    chord = np.sqrt((0.08 - 1e-3) ** 2 - 0.03**2)
    np.testing.assert_allclose(np.sort(found["x"][:, 1]), [-chord, chord], atol=2e-3)
    assert np.abs(found["gap"]).max() <= 2e-11
    for tilt in (1e-8, 1e-4, 1e-2):
        tipped = pin.SE3(turn([1, 0, 0], tilt) @ body.rotation, body.translation + 0.01 * Z)
        for _ in range(60):
            tipped = pin.SE3(tipped.rotation, tipped.translation - two.gap(*both(tipped)) * Z)
        one = two.points(*both(tipped), margin=1e-12)
        assert one["kind"] == [RIM_LINE]
        assert one["feature"][0] in found["feature"]
        assert two.rest(*both(tipped), one["feature"]) == pytest.approx(2 * chord * tilt, rel=0.05)


def test_gaps_of_rims_against_lines_are_the_oracles():
    """The least gap of a rim is that of its circle, which has no rounding against a capsule, to rounding."""
    rng = np.random.default_rng(3)
    two = Two(coal.Cylinder(0.08, 0.1), coal.Capsule(R, LENGTH))
    checked = 0
    for _ in range(60):
        a = random_pose(rng, 0.2)
        tilt = turn(rng.normal(size=3), rng.uniform(0.0, 0.05))
        b = a * pose(rng.uniform(-0.05, 0.05), rng.uniform(-0.1, 0.1), 0.05 + R + 0.01, tilt @ LYING)
        found = two.points(a, b, margin=0.05, most=16)
        gaps = [gap for gap, kind in zip(found["gap"], found["kind"], strict=True) if kind == RIM_LINE]
        if not gaps:
            continue
        exact = lines.circle_and_line(a.act(0.05 * Z), a.rotation @ Z, 0.08, *axis(b)) - R
        assert min(gaps) == pytest.approx(exact, abs=1e-14)
        checked += 1
    assert checked > 20


@pytest.mark.parametrize(
    ("a", "b", "at"),
    [
        (SHAPES["capsule"], SHAPES["capsule"], crossed(0.02, 0.01, height=2 * R + 1e-3)),
        (SHAPES["capsule"], SHAPES["cylinder"], crossed(0.02, 0.01, height=2 * R + 1e-3)),
        (SHAPES["cylinder"], SHAPES["cylinder"], crossed(0.02, 0.01, height=2 * R + 1e-3)),
        (coal.Cylinder(0.08, 0.1), SHAPES["capsule"], pose(0.03, 0.0, 0.05 + R, turn([1, 0.3, 0], 0.03) @ LYING)),
        (coal.Cylinder(0.08, 0.1), SHAPES["cylinder"], pose(0.03, 0.0, 0.05 + R, turn([1, 0.3, 0], 0.03) @ LYING)),
    ],
)
def test_gaps_change_with_the_velocity_of_the_points_along_the_normal(a, b, at):
    two = Two(a, b)
    rng = np.random.default_rng(2)
    world = random_pose(rng, 0.3)
    pose_a, pose_b = world * (IDENTITY if a.radius > R else pose(R=LYING)), world * at
    found = two.points(pose_a, pose_b, margin=1.0, most=16)
    ends = [k for k, kind in enumerate(found["kind"]) if kind in (END, RIM_LINE)]
    assert ends
    features = [found["feature"][k] for k in ends]
    eps = 1e-6
    for _ in range(5):
        v, w = rng.normal(size=6), rng.normal(size=6)
        forth = two.of(pose_a * pin.exp6(eps * v), pose_b * pin.exp6(eps * w), features)["gap"]
        back = two.of(pose_a * pin.exp6(-eps * v), pose_b * pin.exp6(-eps * w), features)["gap"]
        for i, k in enumerate(ends):
            speed = []
            for M, twist, x in ((pose_a, v, found["point_a"][k]), (pose_b, w, found["point_b"][k])):
                speed.append(M.rotation @ (twist[:3] + np.cross(twist[3:], M.actInv(x))))
            expected = found["normal"][k] @ (speed[1] - speed[0])
            assert (forth[i] - back[i]) / (2 * eps) == pytest.approx(expected, abs=2e-8)


def test_edges_of_hulls_along_each_other():
    """Two wedges edge on edge: the ends of the edge in common, rounded by up to 1 mm."""
    wedge = np.array([[x, y, z] for y in (-0.2, 0.2) for x, z in ((-0.1, -0.1), (0.1, -0.1), (0.0, 0.0))])
    two = Two(hull(wedge), hull(wedge @ np.diag([1.0, 1.0, -1.0])))
    above = lowered(two, IDENTITY, pose(0.0, 0.1, 0.01))
    found = two.points(IDENTITY, above, margin=1e-11)
    assert found["kind"] == [END, END]
    np.testing.assert_allclose(np.sort(found["x"][:, 1]), [-0.1, 0.2], atol=3e-3)
    assert WITNESS not in found["kind"]
