"""The rest of two polytopes behind the features in which they touch, against all of their vertices."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from contactvi import _core
from helpers.touching_pairs import EDGE, IDENTITY, ROUNDING, VERTEX, Two, hull, pose, random_hull, random_pose, turn

SLACK = 1e-10  # [m]
ON_PLANE = 5 * ROUNDING  # [m] vertices of rounded hulls are those of the sharp ones to the rounding
CLEAR = 100 * ON_PLANE  # what is not that near is so much farther, or the sample says nothing


def touching_hulls(rng: np.random.Generator, count: int) -> list[tuple[Two, list[np.ndarray], pin.SE3, dict]]:
    """Hulls (their own points), where the second one is, and their only point there."""
    found = []
    for _ in range(120):
        shapes = [random_hull(rng, count), 0.7 * random_hull(rng, count)]
        two = Two(hull(shapes[0]), hull(shapes[1]))
        at = two.touching(IDENTITY, pin.SE3(random_pose(rng).rotation, np.array([0.3, 0.0, 0.0])))
        points = two.points(IDENTITY, at)
        if len(points["feature"]) == 1 and points["kind"][0] in (EDGE, VERTEX):
            found.append((two, shapes, at, points))
    return found


def behind(vertices: np.ndarray, outward: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, float]:
    """The vertices in the plane, and the least depth of the others over their distance from these; NaN: not clear."""
    depth = (place - vertices) @ outward
    touching = vertices[np.abs(depth) < ON_PLANE]
    rest, depth = vertices[np.abs(depth) >= ON_PLANE], depth[np.abs(depth) >= ON_PLANE]
    d = rest - touching[0]
    if len(touching) == 2:
        along = touching[1] - touching[0]
        along /= np.linalg.norm(along)
        d -= np.outer(d @ along, along)
    return touching, np.min(depth / np.linalg.norm(d, axis=1)) if depth.min() > CLEAR else np.nan


@pytest.mark.parametrize("count", [8, 200])
def test_the_rest_is_as_far_behind_as_its_vertices_are(count):
    rng = np.random.default_rng(count)
    seen, reached = {1: 0, 2: 0}, 0
    for two, (a, b), at, points in touching_hulls(rng, count):
        n, x = points["normal"][0], points["x"][0]
        on_a, of_a = behind(a, n, x)
        on_b, of_b = behind(b @ at.rotation.T + at.translation, -n, x)
        least = min(len(on_a), len(on_b))
        # A shape with a face in the plane is behind it wherever it is.
        depth = min(of_a, of_b) if least == 2 else of_a if len(on_a) == 1 else of_b
        if least not in seen or np.isnan(depth):
            continue
        seen[least] += 1
        q = two.q(IDENTITY, at)
        crossing = 1.0
        if least == 2:
            crossing = np.linalg.norm(np.cross(*[(p[1] - p[0]) / np.linalg.norm(p[1] - p[0]) for p in (on_a, on_b)]))
        # In the place of one vertex of many faces a rounded hull has several, some of them less steeply behind.
        for share in (0.0, 0.99, 1.01):
            sine, is_behind, gap = _core.rest_behind(two.core, q, 0, points["feature"], share * depth, SLACK)
            assert sine == pytest.approx(crossing, abs=1e-4)
            assert is_behind == (share < 1.0) or share == 0.99
            reached += is_behind and share == 0.99
            assert np.isnan(gap) or gap == pytest.approx(two.gap(IDENTITY, at), abs=two.noise())
    assert reached >= 5
    assert min(seen.values()) >= 3


@pytest.mark.parametrize("count", [8, 200])
def test_the_gap_of_the_points_is_that_of_the_pair_where_it_is_said_to_be(count):
    """Hulls that turn about where they touched: from some angle on other features are nearer."""
    rng = np.random.default_rng(count + 1)
    known = {True: 0, False: 0}
    for two, _, at, points in touching_hulls(rng, count):
        for angle in (1e-5, 1e-3, 0.1, 0.5):
            R, x = turn(rng.standard_normal(3), angle), points["x"][0]
            turned = pin.SE3(R @ at.rotation, x + R @ (at.translation - x) + 1e-7 * rng.standard_normal(3))
            gap = _core.rest_behind(two.core, two.q(IDENTITY, turned), 0, points["feature"], 0.0, SLACK)[2]
            known[bool(np.isfinite(gap))] += 1
            if np.isfinite(gap) and gap > 0.0:
                assert gap == pytest.approx(two.gap(IDENTITY, turned), abs=2 * two.noise())
            elif np.isfinite(gap):
                # Of shapes that overlap the depth is the least along any direction.
                assert two.gap(IDENTITY, turned) >= gap - 2 * two.noise()
    assert min(known.values()) >= 10


def test_points_that_share_a_plane_may_each_be_passed_by_the_others():
    """A box on a box: all corners of the face are in the plane, and come in front as soon as the boxes turn."""
    box = hull(0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]))
    two = Two(box, box)
    at = pose(0.03, 0.02, 0.2)
    features = two.points(IDENTITY, at)["feature"]
    assert len(features) == 4
    for feature in features:
        crossing, is_behind, gap = _core.rest_behind(two.core, two.q(IDENTITY, at), 0, [feature], 1e-6, SLACK)
        assert crossing in (0.0, 1.0) or crossing == pytest.approx(1.0)
        assert not is_behind
        assert np.isnan(gap) or gap == pytest.approx(two.gap(IDENTITY, at), abs=two.noise())


@pytest.mark.parametrize("sine", [1.0, 0.3])
def test_what_turns_dips_by_no_more_than_the_bound(sine):
    """Depths behind the common normal of two edges whose shapes turn, along joints with bent rates, below their chord.

    The bound is that of Guards::dip_of_others, for turns and bends summed over the joints.
    """
    rng = np.random.default_rng(5)
    tau = np.linspace(0.0, 1.0, 101)
    nearest = 0.0
    for _ in range(200):
        size = 10.0 ** rng.uniform(-3.0, -1.5)
        axes = rng.standard_normal((3, 3))
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        rate, curve = size * rng.standard_normal(3), size * rng.standard_normal(3) * rng.uniform(0.0, 2.0)
        turns = np.array(
            [[turn(k, r * t + 0.5 * c * t * t) for k, r, c in zip(axes, rate, curve, strict=True)] for t in tau]
        )
        R = turns[:, 0] @ turns[:, 1] @ turns[:, 2]
        a, b = np.array([1.0, 0.0, 0.0]), np.array([np.sqrt(1 - sine**2), sine, 0.0])
        n = np.cross(a, R @ b)
        crossing = np.linalg.norm(n, axis=1)
        n /= crossing[:, None]
        turned, bend = np.maximum(np.abs(rate), np.abs(rate + curve)).sum(), np.abs(curve).sum()
        least = crossing[-1] - turned
        dip = 0.125 * (bend / least + 5.0 * (turned / least) ** 2)
        x = rng.standard_normal(3)
        depth = -n @ x
        chord = depth[0] + tau * (depth[-1] - depth[0])
        worst = (chord - depth).max() / np.linalg.norm(np.cross(x, a))
        assert worst <= dip
        nearest = max(nearest, worst / dip)
    assert nearest > 0.2  # the bound is not idle
