"""Gaps of the shapes of a scene without the engine: closed forms, and coal for what has none.

Exact are all pairs with a halfspace, and those of a sphere or a capsule with spheres, capsules, boxes and cylinders,
whose distance is the least of a convex function along the capsule's axis. Of all other pairs coal's distance of the
sharp shapes is taken. The engine rounds the edges of most of these with a radius of up to 1 mm inside the shape: sharp
shapes may overlap by what that takes off their corners, which is much of an acute one (`slack`).
"""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, HalfspaceIntersection

Array = np.ndarray
EXACT, COAL = 2e-9, 1e-5  # [m] of the closed forms, with the 1e-9 that is promised, and of coal's sharp shapes
ROUNDING = 1e-6  # [m], the largest radius of rounded edges
FAILED = 1e100
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


class Gaps:
    """The gaps of all tested pairs at many configurations.

    Attributes:
        pairs: numbers of the shapes of each pair. exact: whether its gap is exact. slack: how far below zero the gap
            may be all the same [m].
    """

    def __init__(self, scene) -> None:
        built = scene.built()
        self._model, self._collision = built.model, built.collision
        self._shapes = [item.geometry for item in self._collision.geometryObjects]
        self.pairs = [(pair.first, pair.second) for pair in self._collision.collisionPairs]
        self.exact = np.array([self._is_exact(*pair) for pair in self.pairs], dtype=bool)
        lost = [rounded_off(shape) for shape in self._shapes]
        rough = np.array([COAL + lost[i] + lost[j] for i, j in self.pairs])
        self.slack = np.where(self.exact, EXACT, rough)

    def at(self, q: Array) -> Array:
        """Return the gaps (N, pairs) [m] at configurations (N, nq); below zero where shapes overlap."""
        rotations, places = self._poses(q)
        found = np.full((len(q), len(self.pairs)), np.inf)
        for k, (i, j) in enumerate(self.pairs):
            near = np.arange(len(q))
            if not any(isinstance(self._shapes[n], coal.Halfspace) for n in (i, j)):
                apart = np.linalg.norm(places[:, i] - places[:, j], axis=1)
                near = np.flatnonzero(apart < reach(self._shapes[i]) + reach(self._shapes[j]) + 1e-3)
            if len(near):
                a = self._shapes[i], rotations[near, i], places[near, i]
                b = self._shapes[j], rotations[near, j], places[near, j]
                found[near, k] = gap(a, b)
        found[found < -FAILED] = np.inf  # coal finds no distance of a few cylinders that lie exactly along each other
        return found

    def _is_exact(self, i: int, j: int) -> bool:
        kinds = self._shapes[i], self._shapes[j]
        if any(isinstance(shape, coal.Halfspace) for shape in kinds):
            return True
        smooth = [isinstance(shape, (coal.Sphere, coal.Capsule)) for shape in kinds]
        return any(smooth) and not any(isinstance(shape, coal.ConvexBase) for shape in kinds)

    def _poses(self, q: Array) -> tuple[Array, Array]:
        data, geometry = self._model.createData(), self._collision.createData()
        rotations = np.empty((len(q), len(self._shapes), 3, 3))
        places = np.empty((len(q), len(self._shapes), 3))
        for k, row in enumerate(q):
            pin.updateGeometryPlacements(self._model, data, self._collision, geometry, row)
            for i, pose in enumerate(geometry.oMg):
                rotations[k, i], places[k, i] = pose.rotation, pose.translation
        return rotations, places


def gap(a: tuple, b: tuple) -> Array:
    """Return the gaps (N,) of two shapes, each with rotations (N, 3, 3) and places (N, 3)."""
    if isinstance(b[0], coal.Halfspace):
        a, b = b, a
    if isinstance(a[0], coal.Halfspace):
        normal = np.einsum("nij,j->ni", a[1], a[0].n)
        offset = a[0].d + np.sum(normal * a[2], axis=1)
        return np.sum(normal * b[2], axis=1) - offset - support(b[0], -np.einsum("nij,ni->nj", b[1], normal))
    if isinstance(b[0], (coal.Sphere, coal.Capsule)):
        a, b = b, a
    if not isinstance(a[0], (coal.Sphere, coal.Capsule)) or isinstance(b[0], coal.ConvexBase):
        return by_coal(a, b)
    half = getattr(a[0], "halfLength", 0.0)
    axis = np.einsum("nij,ni->nj", b[1], half * a[1][:, :, 2])  # in the axes of the second shape
    middle = np.einsum("nij,ni->nj", b[1], a[2] - b[2])
    return least(lambda s: to_point(b[0], middle + s[:, None] * axis), len(middle)) - a[0].radius


def least(function, count: int) -> Array:
    """Return the least values of convex functions over -1..1, all at once, by golden sections."""
    low, high = -np.ones(count), np.ones(count)
    best = np.minimum(function(low), function(high))
    for _ in range(90):
        left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        f, g = function(left), function(right)
        best = np.minimum(best, np.minimum(f, g))
        low, high = np.where(f > g, left, low), np.where(f > g, high, right)
    return best


def to_point(shape, x: Array) -> Array:
    """Return the signed distances (N,) of a solid from points (N, 3) in its axes."""
    if isinstance(shape, coal.Sphere):
        return np.linalg.norm(x, axis=1) - shape.radius
    if isinstance(shape, coal.Capsule):
        beyond = np.maximum(np.abs(x[:, 2]) - shape.halfLength, 0.0)
        return np.sqrt(x[:, 0] ** 2 + x[:, 1] ** 2 + beyond**2) - shape.radius
    if isinstance(shape, coal.Box):
        out = np.abs(x) - np.array(shape.halfSide)
    else:
        out = np.column_stack([np.hypot(x[:, 0], x[:, 1]) - shape.radius, np.abs(x[:, 2]) - shape.halfLength])
    return np.linalg.norm(np.maximum(out, 0.0), axis=1) + np.minimum(out.max(axis=1), 0.0)


def support(shape, d: Array) -> Array:
    """Return how far a solid reaches along unit vectors (N, 3) in its axes, (N,)."""
    if isinstance(shape, coal.Sphere):
        return np.full(len(d), shape.radius)
    if isinstance(shape, coal.Capsule):
        return shape.radius + shape.halfLength * np.abs(d[:, 2])
    if isinstance(shape, coal.Box):
        return np.abs(d) @ np.array(shape.halfSide)
    if isinstance(shape, coal.Cylinder):
        return shape.radius * np.hypot(d[:, 0], d[:, 1]) + shape.halfLength * np.abs(d[:, 2])
    return (d @ vertices(shape).T).max(axis=1)


def vertices(shape) -> Array:
    return np.array([shape.point(k) for k in range(shape.num_points)])


def reach(shape) -> float:
    """Return the radius of a ball about the origin that holds the shape [m]."""
    if isinstance(shape, coal.Sphere):
        return shape.radius
    if isinstance(shape, coal.Capsule):
        return shape.radius + shape.halfLength
    if isinstance(shape, coal.Box):
        return float(np.linalg.norm(shape.halfSide))
    if isinstance(shape, coal.Cylinder):
        return float(np.hypot(shape.radius, shape.halfLength))
    return float(np.linalg.norm(vertices(shape), axis=1).max())


def rounded_off(shape) -> float:
    """Return the most that edges of radius ROUNDING take off the corners of a shape [m]."""
    if isinstance(shape, coal.Box):
        return (np.sqrt(3.0) - 1.0) * ROUNDING
    if isinstance(shape, coal.Cylinder):
        return (np.sqrt(2.0) - 1.0) * ROUNDING
    if not isinstance(shape, coal.ConvexBase):
        return 0.0
    corners = vertices(shape)
    sides = ConvexHull(corners).equations + [0.0, 0.0, 0.0, ROUNDING]
    left = HalfspaceIntersection(sides, corners.mean(axis=0)).intersections
    return float(np.linalg.norm(corners[:, None] - left[None], axis=2).min(axis=1).max()) - ROUNDING


def by_coal(a: tuple, b: tuple) -> Array:
    request = coal.DistanceRequest()
    request.enable_signed_distance = True
    request.gjk_tolerance = 1e-9
    places = [(coal.Transform3s(a[1][k], a[2][k]), coal.Transform3s(b[1][k], b[2][k])) for k in range(len(a[2]))]
    return np.array([coal.distance(a[0], x, b[0], y, request, coal.DistanceResult()) for x, y in places])
