"""Hulls that are read and made at once, against coal's own: coal's == compares vertices, neighbours and all else."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi import _core
from contactvi.importing.hulls import faces_by_engine, faces_of, hull_by_engine, hull_from_faces
from helpers.engine import buffer
from helpers.touching_pairs import hull, prism, random_hull

SOLIDS = {
    **{f"{count} points": random_hull(np.random.default_rng(count), count) for count in (4, 12, 31, 33, 400)},
    "cube": np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)]),
    "prism of 100 sides": prism(100),  # two vertices have many neighbours
}


@pytest.mark.parametrize("name", SOLIDS)
def test_a_hull_from_arrays_equals_that_of_coals_constructor(name: str):
    made = hull(SOLIDS[name])
    vertices, faces = np.array(made.points()), faces_of(made)
    np.testing.assert_array_equal(faces_by_engine(made), faces)
    by_coal, by_engine = hull_from_faces(vertices, faces), hull_by_engine(vertices, faces.astype(np.int32))
    assert by_engine == by_coal
    assert [by_engine.neighbors(i) for i in range(len(vertices))] == [made.neighbors(i) for i in range(len(vertices))]
    np.testing.assert_array_equal(by_engine.aabb_local.max_, vertices.max(axis=0))
    assert by_engine.clone() == by_coal, "it owns its arrays"


def test_corners_that_are_no_vertices_are_refused():
    vertices, faces = np.eye(4, 3), np.array([[0, 1, 2], [0, 1, 4]], dtype=np.int32)
    for wrong in (faces, -faces):
        with pytest.raises(cvi.ContactviError, match="no vertex"):
            hull_by_engine(vertices, wrong)


def test_more_neighbours_than_coal_counts_are_refused():
    """A fan around the first vertex."""
    around = np.arange(1, 301, dtype=np.int32)
    faces = np.stack([np.zeros_like(around), around, np.roll(around, -1)], axis=1)
    with pytest.raises(cvi.ContactviError, match="neighbours"):
        hull_by_engine(np.zeros((301, 3)), faces)


def scene_of(shapes: list[coal.CollisionGeometry], hulls: list[tuple]) -> _core.Scene:
    model, geometry = pin.Model(), pin.GeometryModel()
    for k, shape in enumerate(shapes):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"body {k}")
        geometry.addGeometryObject(pin.GeometryObject(f"shape {k}", joint, pin.SE3.Identity(), shape))
    geometry.addAllCollisionPairs()
    n, pairs = model.njoints, len(geometry.collisionPairs)
    return _core.Scene(
        buffer(model), buffer(geometry), np.ones(pairs), np.zeros(n), pin.neutral(model), np.zeros(model.nv),
        np.zeros(n), np.ones(n), hulls=hulls,
    )  # fmt: skip


def test_hulls_beside_the_archive_are_those_in_the_archive():
    """A hull of two geometries, one that is swept by a sphere, and a ball."""
    shared, swept, ball = hull(SOLIDS["12 points"]), hull(SOLIDS["31 points"]), coal.Sphere(0.05)
    swept.setSweptSphereRadius(0.01)
    beside = [
        (places, np.array(shape.points()), faces_by_engine(shape), shape.getSweptSphereRadius())
        for places, shape in (([0, 2], shared), ([1], swept))
    ]
    own = scene_of([shared, swept, shared, ball], [])
    given = scene_of([ball, ball, ball, ball], beside)
    rng = np.random.default_rng(5)
    for _ in range(20):
        q = np.concatenate([[*rng.normal(scale=0.2, size=3), *rng.normal(size=4)] for _ in range(4)])
        for k in range(4):
            q[7 * k + 3 : 7 * k + 7] /= np.linalg.norm(q[7 * k + 3 : 7 * k + 7])
        for found, expected in zip(given.gaps(q), own.gaps(q), strict=True):
            np.testing.assert_array_equal(found, expected)
    assert given.rounding == own.rounding


@pytest.mark.parametrize("places", [[-1], [1]])
def test_hulls_of_no_geometry_are_refused(places: list[int]):
    shape = hull(SOLIDS["cube"])
    with pytest.raises(cvi.ContactviError, match="no geometry"):
        scene_of([coal.Sphere(1.0)], [(places, np.array(shape.points()), faces_by_engine(shape), 0.0)])
