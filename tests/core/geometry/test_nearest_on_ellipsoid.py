"""Distances to ellipsoids: equal to bounds from both sides, with the engine's rows as their gradient.

Whatever way the engine went, two convex bodies are at least as far apart as along the normal it gives, and at most as
far as the two points, if these lie on the bodies. Both bounds follow from supports and surfaces in closed form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq
from scipy.spatial import ConvexHull, HalfspaceIntersection

from helpers.touching_pairs import ROUNDING, Two, hull, random_hull, random_pose

EXACT = 1e-13  # [m] rounding of positions of some metres
HALVES = {
    "any": (0.05, 0.08, 0.06),
    "ball": (0.06, 0.06, 0.06),
    "needle": (0.2, 0.01, 0.015),
    "disc": (0.1, 0.12, 0.01),
}
BOX = np.array([0.05, 0.07, 0.04])  # half sides
CAPSULE, LINE = 0.03, 0.05  # radius, half length
CYLINDER = (0.06, 0.1)  # radius, half length
SPHERE = 0.04
POINTS = random_hull(np.random.default_rng(3), 40)


@dataclass
class Core:
    """A convex core and the radius by which it is swept.

    Attributes:
        support: m -> m.x at the farthest point along m. outside: how far a point is outside [m], <= 0 inside.
    """

    radius: float
    support: Callable[[np.ndarray], float]
    outside: Callable[[np.ndarray], float]


def ellipsoid(D: np.ndarray) -> Core:
    def outside(x: np.ndarray) -> float:
        size = float(np.linalg.norm(x / D))
        return (size - 1.0) * size / float(np.linalg.norm(x / D**2))  # to first order

    return Core(0.0, lambda m: float(np.linalg.norm(D * m)), outside)


def polytope(faces: np.ndarray, r: float) -> Core:
    """Of the faces n.x + d <= 0 as rows (n, d), moved inwards by r."""
    inner = faces + np.r_[0.0, 0.0, 0.0, r]
    corners = HalfspaceIntersection(inner, np.zeros(3)).intersections
    return Core(r, lambda m: float((corners @ m).max()), lambda x: float((inner[:, :3] @ x + inner[:, 3]).max()))


def cylinder(r: float) -> Core:
    R, half = np.array(CYLINDER) - r
    return Core(
        r,
        lambda m: R * np.hypot(m[0], m[1]) + half * abs(m[2]),
        lambda x: max(np.hypot(x[0], x[1]) - R, abs(x[2]) - half),
    )


def box_faces() -> np.ndarray:
    return np.array([np.r_[s * np.eye(3)[i], -BOX[i]] for i in range(3) for s in (-1.0, 1.0)])


# name -> coal's shape, its core
OTHERS: dict[str, tuple[Callable[[], coal.CollisionGeometry], Core]] = {
    "sphere": (lambda: coal.Sphere(SPHERE), Core(SPHERE, lambda m: 0.0, lambda x: float(np.linalg.norm(x)))),
    "capsule": (
        lambda: coal.Capsule(CAPSULE, 2 * LINE),
        Core(
            CAPSULE,
            lambda m: LINE * abs(m[2]),
            lambda x: float(np.linalg.norm(x - np.array([0.0, 0.0, np.clip(x[2], -LINE, LINE)]))),
        ),
    ),
    "box": (lambda: coal.Box(*(2 * BOX)), polytope(box_faces(), ROUNDING)),
    "cylinder": (lambda: coal.Cylinder(CYLINDER[0], 2 * CYLINDER[1]), cylinder(ROUNDING)),
    "hull": (lambda: hull(POINTS), polytope(ConvexHull(POINTS).equations, ROUNDING)),
    "ellipsoid": (lambda: coal.Ellipsoid(0.07, 0.03, 0.1), ellipsoid(np.array([0.07, 0.03, 0.1]))),
}


def error(two: Two, cores: list[Core], a: pin.SE3, b: pin.SE3) -> float:
    """Largest disagreement of the engine's gap, normal and points with the bounds [m]."""
    found, n, x_a, x_b = (np.asarray(x)[0] for x in two.core.gaps(two.q(a, b)))
    supports = [core.support(s * (at.rotation.T @ n)) for core, at, s in zip(cores, (a, b), (1, -1), strict=True)]
    sweep = sum(core.radius for core in cores)
    least = n @ (b.translation - a.translation) - sum(supports) - sweep
    sides = zip(cores, (a, b), (x_a, x_b), (1, -1), strict=True)
    outside = [core.outside(at.actInv(x - s * core.radius * n)) for core, at, x, s in sides]
    return max(abs(found - least), *outside, abs(np.linalg.norm(n) - 1.0), float(np.linalg.norm(x_b - x_a - found * n)))


def at_a_gap(two: Two, a: pin.SE3, R: np.ndarray, direction: np.ndarray, gap: float) -> pin.SE3:
    """The pose of b, moved along a direction until its gap to a is `gap` [m]."""

    def off(x: float) -> float:
        return two.gap(a, pin.SE3(R, a.translation + x * direction)) - gap

    far = 0.6
    while off(far) < 0.0:
        far *= 2.0
    near = far  # overlapping cores have other gaps: the last place before is looked for from outside
    while off(near) > 0.0:
        near -= 0.005
    return pin.SE3(R, a.translation + brentq(off, near, near + 0.005, xtol=1e-16) * direction)


@pytest.mark.parametrize("halves", HALVES)
@pytest.mark.parametrize("other", OTHERS)
@pytest.mark.slow
def test_gaps_and_normals_are_exact(other, halves):
    half = np.array(HALVES[halves])
    make, core = OTHERS[other]
    cores = [ellipsoid(half), core]
    rng = np.random.default_rng(1)
    errors = []
    for swapped in (False, True):
        shapes = [coal.Ellipsoid(*half), make()]
        two = Two(*(shapes[::-1] if swapped else shapes))
        for gap in [0.0, 1e-9, 1e-5, -1e-6, 0.05] * 20:
            a, direction = random_pose(rng), rng.normal(size=3)
            b = at_a_gap(two, a, random_pose(rng).rotation, direction / np.linalg.norm(direction), gap)
            errors.append(error(two, cores[::-1] if swapped else cores, a, b))
    assert max(errors) <= EXACT


@pytest.mark.parametrize("other", OTHERS)
def test_the_gap_has_the_rows_as_gradient(other):
    """Differences of the gap along the bodies' motion, central and of fourth order."""
    two = Two(coal.Ellipsoid(*HALVES["any"]), OTHERS[other][0]())
    rng = np.random.default_rng(2)
    for gap in (0.0, 1e-3):
        a, direction = random_pose(rng), rng.normal(size=3)
        b = at_a_gap(two, a, random_pose(rng).rotation, direction / np.linalg.norm(direction), gap)
        q = two.q(a, b)
        W = np.asarray(two.core.gap_gradients(q))[0]
        for k, unit in enumerate(np.eye(12)):

            def at(h: float, unit: np.ndarray = unit, q: np.ndarray = q) -> float:
                return float(two.core.gaps(pin.integrate(two.model, q, h * unit))[0][0])

            h = 1e-4
            central = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h)
            assert abs(central - W[k]) <= 1e-9


def test_an_ellipsoid_rolls_over_the_borders_of_a_hull():
    """The vertices of rounded hulls miss the planes of their faces by some rounding; the hull counts as it is."""
    half = np.array(HALVES["any"])
    two, cores = Two(coal.Ellipsoid(*half), OTHERS["hull"][0]()), [ellipsoid(half), OTHERS["hull"][1]]
    rng = np.random.default_rng(1)
    a, R = random_pose(rng), random_pose(rng).rotation
    b = at_a_gap(two, a, R, np.array([0.0, 0.6, 0.8]), 0.02)
    axis = np.array([0.3, 1.0, -0.2])
    turns = [pin.SE3(pin.exp3(axis * angle) @ b.rotation, b.translation) for angle in np.linspace(0.0, 6.0, 400)]
    assert max(error(two, cores, a, turned) for turned in turns) <= EXACT


def test_overlapping_cores_keep_the_distance_of_the_library():
    """A ball whose centre lies in the ellipsoid: no nearest points outside, the gap stays finite."""
    two, rng = Two(coal.Ellipsoid(0.1, 0.2, 0.15), coal.Sphere(0.05)), np.random.default_rng(3)
    for _ in range(20):
        a = random_pose(rng)
        gap = two.gap(a, pin.SE3(np.eye(3), a.act(0.05 * rng.uniform(-1.0, 1.0, 3))))
        assert -0.2 <= gap < -0.05
