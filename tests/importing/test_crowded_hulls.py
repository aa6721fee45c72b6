"""Hulls whose vertices have any number of neighbours: no vertex is lost, and gaps are those of an oracle."""

from __future__ import annotations

import pickle

import clarabel
import numpy as np
import pinocchio as pin
import pytest
from scipy import sparse
from scipy.spatial import ConvexHull

import contactvi as cvi
from contactvi import _core
from contactvi.importing.hulls import (
    MOST_NEIGHBOURS,
    crowded_text,
    faces_by_engine,
    faces_of,
    hull_by_engine,
    hull_of_points,
)
from helpers.thinning import every

Array = np.ndarray
ROUNDING = 1e-6  # [m] of hulls against hulls, a fifth of the least distance of a face from the middle at most
HULL_ERROR = 1e-9  # of the size, where a vertex has helpers (core/model/crowded_vertex.hpp)
# Of an interior point method on distances of 1e-4 to 1e-1 m; above the rounding of the planes of slender triangles.
ORACLE = 1e-12
# Qhull merges faces of the dual hull within its rounding, which the division by the distance of the nearest face from
# the middle, 1e-3 of the size, enlarges.
MERGED = 3e-8


def ring(count: int, radius: float, z: float = 0.0) -> Array:
    angle = 2.0 * np.pi * np.arange(count) / count
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, z)], axis=1)


def cone(count: int, height: float = 0.1, radius: float = 0.05) -> Array:
    return np.vstack([ring(count, radius), [[0.0, 0.0, height]]])


def half_cone(count: int) -> Array:
    """A cone that is cut through its axis."""
    angle = np.pi * np.arange(count) / (count - 1)
    base = np.stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), np.zeros(count)], axis=1)
    return np.vstack([base, [[0.0, 0.0, 0.1]]])


def uneven_cone(count: int) -> Array:
    """A cone whose sides are of very different widths and lengths."""
    rng = np.random.default_rng(3)
    angle, length = np.sort(rng.uniform(0.0, 2.0 * np.pi, count)), rng.uniform(0.6, 1.0, count)
    x, y = 0.05 * length * np.cos(angle), 0.05 * length * np.sin(angle)
    return np.vstack([np.stack([x, y, 0.1 - 0.1 * length], axis=1), [[0.0, 0.0, 0.1]]])


def ball(meridians: int, parallels: int) -> Array:
    angles = np.pi * np.arange(1, parallels) / parallels
    rings = [ring(meridians, 0.05 * np.sin(angle), 0.05 * np.cos(angle)) for angle in angles]
    return np.vstack([*rings, [[0.0, 0.0, 0.05], [0.0, 0.0, -0.05]]])


def turned_part(count: int = 300) -> Array:
    """A part from a lathe: rings of several radii, and a tip."""
    profile = [(0.02, -0.018), (0.045, -0.012), (0.052, 0.0), (0.03, 0.02)]
    return np.vstack([*(ring(count, radius, z) for radius, z in profile), [[0.0, 0.0, 0.027]]])


def random_hull(count: int) -> Array:
    points = np.random.default_rng(count).normal(size=(count, 3))
    return 0.05 * points / np.linalg.norm(points, axis=1)[:, None] * [1.0, 0.8, 0.6]


def noisy(points: Array) -> Array:
    return points + 1e-7 * np.random.default_rng(1).normal(size=points.shape)


# Points, and what of the error in hulls against hulls goes beyond the oracle's.
FAMILIES = {
    "cone of 100": (cone(100), 0.0),
    "cone of 300": (cone(300), 0.0),
    "cone of 1000": (cone(1000), 0.0),
    "flat cone": (cone(1000, 0.01), 0.0),
    "half a cone": (half_cone(600), 0.0),
    "uneven cone": (uneven_cone(1000), 0.0),
    "bipyramid of 300": (np.vstack([cone(300), [[0.0, 0.0, -0.06]]]), 0.0),
    "bipyramid of 600": (np.vstack([cone(600), [[0.0, 0.0, -0.06]]]), 0.0),
    "double frustum": (np.vstack([ring(1000, 0.05), ring(1000, 0.01, 0.08), ring(1000, 0.01, -0.05)]), 0.0),
    "bipyramid": (np.vstack([cone(1000), [[0.0, 0.0, -0.06]]]), 0.0),
    "disc of 1000": (np.vstack([ring(1000, 0.05, -0.03), ring(1000, 0.05, 0.03)]), 0.0),
    "disc of 2000": (np.vstack([ring(2000, 0.05, -0.03), ring(2000, 0.05, 0.03)]), 0.0),
    "turned part": (turned_part(), 0.0),
    "ball of 400 meridians": (ball(400, 10), 0.0),
    "3000 points": (random_hull(3000), 0.0),
    "cone with noise": (noisy(cone(1000)), MERGED),
    "disc with noise": (noisy(np.vstack([ring(500, 0.05, -0.03), ring(500, 0.05, 0.03)])), MERGED),
    "cone in single precision": (cone(700).astype(np.float32).astype(float), MERGED),
}


def distance(one: tuple[Array, Array], other: tuple[Array, Array]) -> float:
    """Return the distance of two polytopes N x <= d, by an interior point method on the planes of their faces."""
    scale = 20.0  # of lengths, to numbers of order one
    planes = sparse.block_diag([one[0], other[0]]).tocsc()
    offsets = scale * np.concatenate([one[1], other[1]])
    apart = np.hstack([np.eye(3), -np.eye(3)])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs, settings.tol_gap_rel, settings.tol_feas, settings.max_iter = 1e-16, 1e-14, 1e-13, 400
    problem = sparse.triu(apart.T @ apart).tocsc()
    cones = [clarabel.NonnegativeConeT(len(offsets))]
    x = np.array(clarabel.DefaultSolver(problem, np.zeros(6), planes, offsets, cones, settings).solve().x)
    return float(np.linalg.norm(apart @ x)) / scale


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", FAMILIES)
def test_all_vertices_stay_and_the_triangles_close(name: str):
    points, _ = FAMILIES[name]
    hull, wanted = hull_of_points(points, name), ConvexHull(points)
    vertices, faces = np.array(hull.points()), faces_of(hull)
    assert set(map(tuple, vertices)) == set(map(tuple, points[wanted.vertices]))
    assert len(faces) == 2 * len(vertices) - 4, "Euler"
    assert hull.computeVolume() == pytest.approx(wanted.volume, rel=1e-9)
    assert max(len(hull.neighbors(i)) for i in range(hull.num_points)) <= MOST_NEIGHBOURS


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", FAMILIES)
def test_gaps_are_right_from_all_sides(name: str):
    points, more = FAMILIES[name]
    hull = ConvexHull(points)
    normals, offsets, vertices = hull.equations[:, :3], -hull.equations[:, 3], points[hull.vertices]
    middle = vertices.mean(axis=0)
    rounding = min(ROUNDING, 0.2 * float((offsets - normals @ middle).min()))
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    scene = cvi.Scene()
    scene.add_halfspace()
    for body in ("a", "b"):
        scene.add_mesh(body, points, mass=1.0, placement=(0, 0, 0.3 if body == "a" else 0.6))
    rng = np.random.default_rng(5)

    def reach(R: Array, direction: Array) -> float:
        return float((vertices @ R.T @ direction).max())

    def planes(R: Array, place: Array) -> tuple[Array, Array]:
        turned = normals @ R.T
        return turned, offsets - rounding + turned @ place

    for k in range(12):
        turns = [pin.Quaternion(rng.normal(size=4)).normalized() for _ in range(2)]
        if k < 6:  # upright, upside down, on its sides: where directions are normal to faces and to edges
            turns[0] = pin.Quaternion(pin.rpy.rpyToMatrix(*(0.5 * np.pi * rng.integers(0, 4, 3))))
        A, B = (turn.matrix() for turn in turns)
        away = rng.normal(size=3) if k not in (2, 3) else np.array([0.0, 0.0, 1.0])
        away /= np.linalg.norm(away)
        a = np.array([0.0, 0.0, 0.5])
        b = a + away * (reach(A, away) + reach(B, -away) + (1e-6, 1e-4, 1e-2)[k % 3])
        q = scene.configuration({"a": [*a, *turns[0].coeffs()], "b": [*b, *turns[1].coeffs()]})
        gap = {frozenset(pair): value for pair, value in zip(scene.pair_names, scene.gaps(q), strict=True)}
        assert abs(gap[frozenset(("a", "ground"))] - a[2] + reach(A, np.array([0.0, 0.0, -1.0]))) <= HULL_ERROR * size
        wanted = distance(planes(A, a), planes(B, b)) - 2.0 * rounding
        assert abs(gap[frozenset(("a", "b"))] - wanted) <= HULL_ERROR * size + ORACLE + more, k


@pytest.mark.filterwarnings("ignore::contactvi.errors.DenseStepWarning")
@pytest.mark.parametrize(
    "name", every(2, ["cone of 300", "half a cone", "turned part", "ball of 400 meridians", "3000 points"])
)
def test_one_falls_on_the_ground_and_another_one_on_it(name: str):
    points, _ = FAMILIES[name]
    low, high = points[:, 2].min(), points[:, 2].max()
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_mesh("a", points, mass=1.0, placement=(0, 0, 2e-4 - low))
    scene.add_mesh("b", points, mass=1.0, placement=(0.001, 0.002, 4e-4 - 2.0 * low + high))
    scene.set_contact(restitution=0.5, friction=0.3)
    traj = cvi.simulate(scene, duration=0.05, dt=1e-3)
    pairs = {frozenset(event.pair) for event in traj.events}
    assert pairs >= {frozenset(("a", "ground")), frozenset(("a", "b"))}
    # Persistent contact of two hulls creeps by some 1e-8 m in a run like that, and the energy by its error of order 2.
    assert min(scene.gaps(q).min() for q in traj.q) > -1e-7
    assert np.diff(traj.energy).max() < 1e-6 * abs(traj.energy[0])


def test_the_report_names_hulls_with_such_a_vertex():
    scene = cvi.Scene()
    scene.add_mesh("cone", cone(1000), mass=1.0)
    assert "hull of 1001, 1 vertex of more than 254 edges, distances to 1.732e-10 m" in str(scene.report)
    for points in (cone(200), FAMILIES["disc of 1000"][0], random_hull(500)):
        assert crowded_text(hull_of_points(points, "plain")) == "", "flat faces have no edges inside"


@pytest.mark.parametrize("name", ["cone of 300", "half a cone", "uneven cone", "bipyramid", "disc of 1000"])
def test_the_way_over_neighbours_finds_the_farthest_vertex(name: str):
    """As coal goes it: to the best neighbour, while there is a better one; at first also to one that is as good."""
    hull = hull_of_points(FAMILIES[name][0], name)
    vertices = np.array(hull.points())
    points, lists = _core.neighbor_lists(vertices, faces_by_engine(hull))
    np.testing.assert_array_equal(points[: len(vertices)], vertices)
    assert max(map(len, lists)) <= MOST_NEIGHBOURS
    bound = HULL_ERROR * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    rng = np.random.default_rng(7)
    for direction in rng.normal(size=(300, 3)):
        heights = points @ (direction / np.linalg.norm(direction))
        at = int(rng.integers(len(points)))
        seen, even, onward = {at}, True, True
        while onward:
            onward, here = False, heights[at]
            for k in lists[at]:
                if k in seen:
                    continue
                seen.add(k)
                if heights[k] > here or (even and heights[k] == here):
                    even, onward = even and heights[k] == here, True
                    here, best = heights[k], k
            at = best if onward else at
        assert abs(heights[at] - heights[: len(vertices)].max()) <= bound


def test_such_a_hull_goes_through_a_description_of_the_scene():
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_mesh("cone", cone(400), mass=1.0, placement=(0, 0, 1.0))
    again = pickle.loads(pickle.dumps(scene))
    np.testing.assert_array_equal(again.gaps(again.neutral()), scene.gaps(scene.neutral()))


def test_too_many_neighbours_are_refused_by_name():
    """So many that helpers cannot share them; a fan, as finding such a hull takes long."""
    count = 40_001
    around = np.arange(1, count + 1, dtype=np.int32)
    faces = np.stack([np.zeros_like(around), around, np.roll(around, -1)], axis=1)
    shape = hull_by_engine(np.vstack([[[0.0, 0.0, 0.1]], ring(count, 0.05)]), faces)
    model, geometry = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    geometry.addGeometryObject(pin.GeometryObject("fan", joint, pin.SE3.Identity(), shape))
    scene = cvi.Scene.from_pinocchio(model, geometry)
    scene.add_halfspace(offset=-1.0)
    with pytest.raises(cvi.ContactviError, match="geometry 'fan' has a vertex with too many") as caught:
        scene.core()
    assert caught.value.remedy
