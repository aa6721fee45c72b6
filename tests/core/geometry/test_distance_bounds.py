"""Bounds on the distance of a pair, from an earlier evaluation of it, against the distance itself."""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi import _core

KINDS = ("box", "sphere", "capsule", "cylinder", "ellipsoid", "hull", "many corners")
NOISE = 1e-7  # [m] of coal's distances, core/geometry/guard.cpp (kMeeting)

NOISE_OF_LINES = 1e-4  # [m] of an extent, since coal's directions between curved shapes are good to three digits


def points(rng: np.random.Generator, count: int) -> np.ndarray:
    """On an ellipsoid, so that all are corners of their hull, (count, 3) [m]."""
    x = rng.normal(size=(count, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True) * rng.uniform(0.05, 0.2, 3)


def shape(rng: np.random.Generator, kind: str) -> object:
    import coal

    size = rng.uniform(0.05, 0.2, 3)
    match kind:
        case "box":
            return coal.Box(*size)
        case "sphere":
            return coal.Sphere(size[0])
        case "capsule":
            return coal.Capsule(size[0], size[1])
        case "cylinder":
            return coal.Cylinder(size[0], size[1])
        case "ellipsoid":
            return coal.Ellipsoid(*size)
    vertices = coal.StdVec_Vec3s()
    vertices.extend(list(points(rng, 12 if kind == "hull" else 80)))
    return coal.Convex.convexHull(vertices, True, "")


def bodies(rng: np.random.Generator, first: str, second: str) -> cvi.Scene:
    """Two free bodies with shapes of these kinds, anywhere on them."""
    model, geometry = pin.Model(), pin.GeometryModel()
    for k, kind in enumerate((first, second)):
        parent = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"free{k}")
        model.appendBodyToJoint(parent, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        place = pin.SE3(pin.Quaternion(rng.normal(size=4)).normalized(), rng.uniform(-0.1, 0.1, 3))
        geometry.addGeometryObject(pin.GeometryObject(f"shape{k}", parent, place, shape(rng, kind)))
    geometry.addCollisionPair(pin.CollisionPair(0, 1))
    return cvi.Scene.from_pinocchio(model, geometry)


def place(rng: np.random.Generator, distance: float) -> np.ndarray:
    """Of both bodies, their origins about so far apart, (14,)."""
    turns = rng.normal(size=(2, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    direction = rng.normal(size=3)
    return np.concatenate([rng.normal(size=3), turns[0], direction / np.linalg.norm(direction) * distance, turns[1]])


def apart(rng: np.random.Generator) -> np.ndarray:
    q = place(rng, 0.7)
    q[7:10] += q[:3]
    return q


@pytest.mark.parametrize(("first", "second"), list(itertools.combinations_with_replacement(KINDS, 2)))
def test_the_distance_lies_between_its_bounds(first: str, second: str):
    """Wherever the bodies have moved and turned, and where they overlap; the bounds meet where the distance was found.

    Where a body has turned by x and shifted by d, the direction of the shortest line, which is L long, is off by
    x + d / L at most, and an extent along it by that times the size of the shape.
    """
    rng = np.random.default_rng([KINDS.index(first), KINDS.index(second)])
    scene = bodies(rng, first, second)
    core, size = scene.core(), 1.0  # [m] a bound
    for _ in range(5):
        known = apart(rng)
        moves = [rng.normal(size=12) * angle for angle in (0.0, 1e-3, 1e-2, 0.1, 1.0)]
        places = [pin.integrate(scene.model, known, move) for move in moves] + [apart(rng) for _ in range(5)]
        found = _core.distance_bounds(core, known, np.array(places), 0, 1)
        lower, distance, upper = found.T
        assert distance[0] > 0.0
        clear = distance > 0.0
        assert np.all(lower[clear] <= distance[clear] + NOISE)
        assert np.all(lower[~clear] <= NOISE)
        assert np.all(distance <= upper + NOISE)
        for k, move in enumerate(moves):
            turn, shift = np.abs(move.reshape(4, 3)[1::2]).sum(), np.abs(move.reshape(4, 3)[::2]).sum()
            off = turn + shift / distance[0]
            assert upper[k] - lower[k] <= 4.0 * size * off + NOISE_OF_LINES


def test_nothing_is_known_without_an_evaluation_that_found_a_gap():
    """Where the shapes overlap no direction separates them."""
    scene = cvi.Scene()
    for k in range(2):
        scene.add_box(f"box{k}", (0.1, 0.2, 0.3), placement=(0.05 * k, 0.0, 0.0))
    overlapping = np.asarray(scene.neutral())
    lower, distance, upper = _core.distance_bounds(scene.core(), overlapping, overlapping[None, :], 0, 1)[0]
    assert distance < 0.0
    assert (lower, upper) == (-np.inf, np.inf)
