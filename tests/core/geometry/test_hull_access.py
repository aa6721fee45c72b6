"""Hulls that are read and made at once, against coal's own: coal's == compares vertices, neighbours and all else."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi import _core
from contactvi.importing.engine_model import engine_model
from contactvi.importing.hulls import faces_by_engine, faces_of, hull_by_engine, hull_from_faces
from helpers.engine import scene_of_shapes
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


def test_of_more_neighbours_than_coal_counts_some_are_kept():
    """A fan around the first vertex; coal's own constructor refuses it."""
    around = np.arange(1, 301, dtype=np.int32)
    faces = np.stack([np.zeros_like(around), around, np.roll(around, -1)], axis=1)
    for made in (hull_by_engine(np.zeros((301, 3)), faces), hull_from_faces(np.zeros((301, 3)), faces)):
        assert len(made.neighbors(0)) == 254
        assert set(made.neighbors(0)) < set(range(1, 301))
        np.testing.assert_array_equal(faces_by_engine(made), faces)


def scene_of(shapes: list[coal.CollisionGeometry]) -> _core.Scene:
    model, geometry = pin.Model(), pin.GeometryModel()
    for k, shape in enumerate(shapes):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"body {k}")
        geometry.addGeometryObject(pin.GeometryObject(f"shape {k}", joint, pin.SE3.Identity(), shape))
    geometry.addAllCollisionPairs()
    return scene_of_shapes(model, geometry)


def test_the_engine_has_its_own_copies_of_shapes():
    """A hull of two geometries, one that is swept by a sphere, and the primitives.

    They are gone when the gaps are asked for. Where no shape of a pair is rounded, because one is a ball or a capsule,
    the gap is coal's to its tolerance, 1e-6 by default.
    """
    twelve, swept = hull(SOLIDS["12 points"]), hull(SOLIDS["31 points"])
    swept.setSweptSphereRadius(0.01)
    shapes = [
        twelve, swept, coal.Sphere(0.05), coal.Box(0.1, 0.2, 0.3), coal.Capsule(0.05, 0.2), coal.Cylinder(0.05, 0.2),
        coal.Ellipsoid(0.1, 0.2, 0.3), twelve,
    ]  # fmt: skip
    kept = [shape.clone() for shape in shapes]
    scene, same = scene_of(shapes), scene_of(kept)
    shapes[2].radius = 3.0
    del shapes, twelve, swept
    rng, identity = np.random.default_rng(5), pin.Quaternion.Identity().coeffs()
    q = np.concatenate([[k, *rng.uniform(-0.1, 0.1, 2), *identity] for k in range(len(kept))])
    gaps = np.asarray(scene.gaps(q)[0])
    np.testing.assert_array_equal(gaps, same.gaps(q)[0])
    pairs = [(a, b) for a in range(len(kept)) for b in range(a + 1, len(kept))]
    for (a, b), gap in zip(pairs, gaps, strict=True):
        if {a, b} & {2, 4}:
            places = [coal.Transform3s(np.eye(3), q[7 * k : 7 * k + 3]) for k in (a, b)]
            wanted = coal.distance(
                kept[a], places[0], kept[b], places[1], coal.DistanceRequest(), coal.DistanceResult()
            )
            assert abs(gap - wanted) <= 1e-6, (a, b)


def test_shapes_and_pairs_that_do_not_exist_are_refused():
    own = engine_model(pin.Model())
    ball = coal.Sphere(0.1)

    def made(joint: int, pairs: list[list[int]]) -> _core.Scene:
        shape = (joint, np.eye(3), np.zeros(3), "ball", ball.id())
        of_pairs, of_joints = np.ones(len(pairs)), np.zeros(1)
        numbers = np.array(pairs, dtype=np.int32).reshape(-1, 2)
        none = np.zeros(0)
        return _core.Scene(own, [shape], numbers, of_pairs, of_pairs, of_joints, none, none, of_joints, of_joints)

    with pytest.raises(cvi.ContactviError, match="on no joint"):
        made(1, [])
    with pytest.raises(cvi.ContactviError, match="no geometries"):
        made(0, [[0, 1]])


@pytest.mark.parametrize("name", SOLIDS)
def test_the_hull_of_points_is_that_of_coal(name: str):
    by_coal = hull(SOLIDS[name])
    by_engine = hull_by_engine(*_core.hull_of_points(SOLIDS[name]))
    np.testing.assert_array_equal(by_engine.points(), by_coal.points())
    np.testing.assert_array_equal(faces_of(by_engine), faces_of(by_coal))
    assert [by_engine.neighbors(i) for i in range(by_engine.num_points)] == [
        by_coal.neighbors(i) for i in range(by_coal.num_points)
    ]


def test_hulls_that_are_made_side_by_side_are_those_made_one_after_the_other():
    """Qhull keeps what it knows in a state of its own for each of them."""
    solids = [random_hull(np.random.default_rng(seed), 300) for seed in range(24)]

    def made(points: np.ndarray) -> list[np.ndarray]:
        return [_core.hull_vertices(points), *_core.hull_of_points(points)]

    alone = [made(points) for points in solids]
    with ThreadPoolExecutor(4) as pool:
        for one, other in zip(alone, pool.map(made, solids), strict=True):
            for array, same in zip(one, other, strict=True):
                np.testing.assert_array_equal(array, same)
