"""Distances of cylinders and boxes: equal to bounds from both sides, with supports and signed distances in closed form.

Whatever pair of features the engine took, two convex bodies are at least as far apart as along the normal it gives, and
at most as far as the two points, if these lie on the bodies.
"""

from __future__ import annotations

from collections.abc import Callable

import coal
import numpy as np
import pinocchio as pin
import pytest

from helpers.touching_pairs import Two, hull, random_pose, turn

RADIUS, HALF = 0.06, 0.1  # of the cylinders [m]
BOX = np.array([0.05, 0.07, 0.04])  # half sides
CAPSULE, LINE = 0.03, 0.05  # radius, half length
ROUNDED = 1e-6  # [m] of cylinders and boxes against each other
EXACT = 1e-13  # [m] rounding of positions of some metres
Shape = tuple[Callable[[np.ndarray], float], Callable[[np.ndarray], float]]  # support along m, signed distance of x


def cylinder(r: float) -> Shape:
    def support(m: np.ndarray) -> float:
        return (RADIUS - r) * np.hypot(m[0], m[1]) + (HALF - r) * abs(m[2]) + r

    def distance(x: np.ndarray) -> float:
        d = np.array([np.hypot(x[0], x[1]) - RADIUS + r, abs(x[2]) - HALF + r])
        return min(d.max(), 0.0) + float(np.linalg.norm(np.maximum(d, 0.0))) - r

    return support, distance


def box(r: float) -> Shape:
    def support(m: np.ndarray) -> float:
        return float((BOX - r) @ np.abs(m)) + r

    def distance(x: np.ndarray) -> float:
        d = np.abs(x) - BOX + r
        return min(d.max(), 0.0) + float(np.linalg.norm(np.maximum(d, 0.0))) - r

    return support, distance


def capsule(_: float) -> Shape:
    def support(m: np.ndarray) -> float:
        return LINE * abs(m[2]) + CAPSULE

    def distance(x: np.ndarray) -> float:
        return float(np.linalg.norm(x - np.array([0.0, 0.0, np.clip(x[2], -LINE, LINE)]))) - CAPSULE

    return support, distance


CORNERS = BOX * np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
# name -> coal's shape, radius by which both bodies of the pair are rounded, support and signed distance
OTHERS = {
    "cylinder": (lambda: coal.Cylinder(RADIUS, 2 * HALF), ROUNDED, cylinder),
    "box": (lambda: coal.Box(*(2 * BOX)), ROUNDED, box),
    "hull": (lambda: hull(CORNERS), ROUNDED, box),
    "capsule": (lambda: coal.Capsule(CAPSULE, 2 * LINE), 0.0, capsule),
}
# How b is turned against a: any way, or nearly parallel or orthogonal to it, where several features are near.
TURNS: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "any": lambda rng: random_pose(rng).rotation,
    "aligned": lambda rng: turn([0, 0, 1], rng.uniform(0.0, 6.0)),
    "nearly aligned": lambda rng: turn(rng.normal(size=3), 10.0 ** rng.uniform(-9.0, -2.0)),
    "across": lambda rng: turn([1, 0, 0], np.pi / 2) @ turn([0, 1, 0], rng.uniform(0.0, 6.0)),
    "nearly across": lambda rng: turn([1, 0, 0], np.pi / 2) @ turn(rng.normal(size=3), 10.0 ** rng.uniform(-9.0, -2.0)),
}


def at_a_gap(two: Two, a: pin.SE3, R: np.ndarray, direction: np.ndarray, gap: float) -> pin.SE3:
    """Return the pose of b, moved along a direction until its gap to a is near `gap` [m]."""
    near, far = 0.0, 0.6
    for _ in range(50):
        middle = 0.5 * (near + far)
        b = pin.SE3(R, a.translation + middle * direction)
        near, far = (near, middle) if two.gap(a, b) > gap else (middle, far)
    return pin.SE3(R, a.translation + far * direction)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("angle", TURNS)
@pytest.mark.parametrize("other", OTHERS)
@pytest.mark.parametrize("one", ["cylinder", "box"])
def test_distances_are_exact(one, other, angle):
    make, r, shape = OTHERS[other]
    two = Two(OTHERS[one][0](), make())
    (support_a, distance_a), (support_b, distance_b) = OTHERS[one][2](r), shape(r)
    rng = np.random.default_rng(1)
    errors = []
    for gap in [0.0, 1e-9, 1e-5, -1e-6] * 25:
        a = random_pose(rng)
        direction = rng.normal(size=3)
        b = at_a_gap(two, a, a.rotation @ TURNS[angle](rng), direction / np.linalg.norm(direction), gap)
        found, n, x_a, x_b = (np.asarray(x)[0] for x in two.core.gaps(two.q(a, b)))
        least = n @ (b.translation - a.translation) - support_a(a.rotation.T @ n) - support_b(-(b.rotation.T @ n))
        assert abs(np.linalg.norm(n) - 1.0) <= EXACT
        assert np.linalg.norm(x_b - x_a - found * n) <= EXACT
        errors.append(max(abs(found - least), abs(distance_a(a.actInv(x_a))), abs(distance_b(b.actInv(x_b)))))
    assert max(errors) <= EXACT
