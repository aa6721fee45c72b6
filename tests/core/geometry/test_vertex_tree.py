"""The farthest vertices of large hulls, by a tree of bounds, against a look at all; and what spares a distance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from contactvi import _core
from helpers.touching_pairs import Two, hull, pose, prism, turn

RNG = np.random.default_rng(11)
ROUNDING = 2e-15  # of products of vectors of 4 m, which NumPy sums in another order


def corners_of(points: np.ndarray) -> np.ndarray:
    """Vertices (n, 3) of the hull of points."""
    return points[ConvexHull(points).vertices]


def sphere_points(n: int) -> np.ndarray:
    x = RNG.standard_normal((n, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def rounded_box(n: int) -> np.ndarray:
    x = sphere_points(n)
    return x / np.sum(x**8, axis=1, keepdims=True) ** 0.125


HULLS = {
    "a ball": lambda: corners_of(sphere_points(400)),
    "a flat disc": lambda: corners_of(sphere_points(600) * [1.0, 0.8, 1e-3]),
    "a needle": lambda: corners_of(sphere_points(300) * [1e-2, 1e-2, 1.0] + [3.0, -2.0, 1.0]),
    "a rounded box": lambda: corners_of(rounded_box(1500)),
    "a prism": lambda: prism(150),
}


def directions(vertices: np.ndarray, count: int = 600) -> np.ndarray:
    """Random ones, those of the axes, and along vertices and between them, where several are nearly as far."""
    between = vertices[RNG.integers(0, len(vertices), count)] + vertices[RNG.integers(0, len(vertices), count)]
    between = between[np.linalg.norm(between, axis=1) > 1e-6]
    found = np.concatenate([sphere_points(count), np.eye(3), -np.eye(3), between])
    return found / np.linalg.norm(found, axis=1, keepdims=True)


@pytest.mark.parametrize("name", HULLS)
@pytest.mark.parametrize("roughness", [0.0, 3e-7])
@pytest.mark.parametrize("depth", [0.0, 1e-3, 0.3])
def test_the_farthest_vertices_are_those_of_a_look_at_all(name, roughness, depth):
    vertices = HULLS[name]()
    moved = vertices + roughness * RNG.uniform(-0.5, 0.5, vertices.shape)  # no exact hull any more
    along = directions(moved)
    answers = _core.far_vertices(moved, along, depth)
    assert len(answers) == len(along)
    for m, (farthest, near) in zip(along, answers, strict=True):
        heights = moved @ m
        assert heights[farthest] >= heights.max() - ROUNDING
        assert near == sorted(set(near))
        assert set(np.flatnonzero(heights >= heights[farthest] - depth + ROUNDING)) <= set(near)
        assert (heights[near] >= heights[farthest] - depth - ROUNDING).all()


def test_of_several_that_are_equally_far_the_first_is_told():
    """Upper and lower corners of a prism, whose products with an axis are the same numbers, and those of an end."""
    vertices = prism(152)
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    for m, (farthest, _) in zip(axes, _core.far_vertices(vertices, axes, 1e-3), strict=True):
        heights = vertices @ m
        equal = np.flatnonzero(heights == heights.max())
        assert len(equal) >= 2
        assert farthest == equal[0]


def test_hulls_with_few_vertices_have_no_tree():
    assert _core.far_vertices(prism(20), np.eye(3), 1e-3) == []


def touching_hulls(count: int) -> list[tuple[Two, np.ndarray, np.ndarray, list[int]]]:
    """Pairs of random hulls, place and rotation of the second where they touch, and the features that do."""
    found = []
    for _ in range(60):
        pair = Two(hull(sphere_points(count) * [0.1, 0.12, 0.05]), hull(sphere_points(count) * [0.2, 0.1, 0.1]))
        R = turn(RNG.standard_normal(3), RNG.uniform(0.0, 3.0))
        at = np.array([0.05, 0.02, 0.4]) * RNG.uniform(-1.0, 1.0, 3) + [0.0, 0.0, 0.4]
        low, high = 0.0, 1.0  # of the line to `at`: they overlap, they are apart
        for _ in range(60):
            middle = 0.5 * (low + high)
            q = pair.q(pose(), pose(*(middle * at), R))
            apart = _core.contact_points(pair.core, q, 0, 1e9, 4)["gap"].min() > 0.0
            low, high = (low, middle) if apart else (middle, high)
        features = pair.points(pose(), pose(*(high * at), R))["feature"]
        if len(features) > 0 and 0 not in features:  # where no feature is known there is a witness
            found.append((pair, high * at, R, features))
    return found


@pytest.mark.thinned(2)
@pytest.mark.parametrize("count", [12, 300])
def test_what_is_said_to_be_no_deeper_is_not(count):
    """The distance asked of coal. The bound allows half of its noise, and coal may be off by the other half."""
    known = 0
    for pair, place, R, features in touching_hulls(count):
        for angle in (0.0, 1e-9, 1e-5, 1e-3):
            q = pair.q(pose(), pose(*place, turn(RNG.standard_normal(3), angle) @ R))
            none_deeper, deeper = _core.none_deeper(pair.core, q, 0, features)
            known += none_deeper
            assert not (none_deeper and deeper < -_core.distance_noise(pair.core, q, 0))
    assert known >= 20


@pytest.mark.thinned(2)
@pytest.mark.parametrize("count", [12, 300])
def test_features_that_are_far_are_left_out_and_no_others(count):
    """The least gap beside the points that touch, where gaps above some number do not count."""
    left_out = 0
    for pair, place, R, features in touching_hulls(count):
        q = pair.q(pose(), pose(*place, turn(RNG.standard_normal(3), 1e-3) @ R))
        least = _core.rest_gap(pair.core, q, 0, features)[0]
        for enough in (1e-5, 1e-4, 1e-3, 1e-2):
            found = _core.rest_gap(pair.core, q, 0, features, enough=enough)[0]
            assert found == (least if least < enough else np.inf)
            left_out += least >= enough
    assert left_out >= 20
