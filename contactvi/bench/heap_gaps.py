"""The gaps of a heap (contactvi.bench.heaps) by coal alone: an independent look at what a run leaves behind."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any

import coal
import numpy as np
from numpy.typing import NDArray

from contactvi.bench.heaps import Body, Heap, rotation_of

Array = NDArray[np.float64]


class GapCheck:
    """The gaps of a heap by coal alone, without the engine's guards, contact points or placements.

    The shapes are those that contactvi simulates: where GJK is used for a pair, box and cylinder have edges of radius
    ROUNDING inside the sharp shape. Gaps to halfspaces are the exact closed forms. A pair is looked at only if its
    bounding spheres come nearer than the least gap found.
    """

    ROUNDING = 1e-6  # [m] of the edges, at most SHARE of the least half size of the shape
    SHARE = 0.2

    def __init__(self, heap: Heap) -> None:
        self._heap = heap
        self._sharp = [_coal_shape(body) for body in heap.bodies]
        self._round = [_coal_shape(body, self.ROUNDING, self.SHARE) for body in heap.bodies]
        self._radii = np.array([body.radius for body in heap.bodies])
        self._smooth = [body.kind in ("sphere", "capsule") for body in heap.bodies]
        self._request = coal.DistanceRequest()
        self._request.enable_signed_distance = True
        self._request.gjk_tolerance = 1e-10  # The default of 1e-6 is the error of the gap.

    def worst(self, q: Array, within: float = math.inf) -> tuple[float, tuple[str, str]]:
        """Return the least gap [m] at a configuration (nq,), below 0 where shapes overlap, and its two shapes.

        Gaps above `within` [m] are not looked for; where all are, it is returned, without names.
        """
        guess = within, ("", "")
        for names, gap in self._planes(q, math.inf):
            guess = min(guess, (gap, names))
        first, second, bounds = self._bounds(_places(q)[1])
        if len(bounds):
            k = int(np.argmin(bounds))
            guess = min(guess, self._named(q, int(first[k]), int(second[k])))
        return min(self.below(q, guess[0]), default=guess)

    def below(self, q: Array, bound: float) -> list[tuple[float, tuple[str, str]]]:
        """Return all gaps less than a bound [m] at a configuration (nq,), with their two shapes."""
        first, second, bounds = self._bounds(_places(q)[1])
        near = np.flatnonzero(bounds < bound)
        found = [(gap, names) for names, gap in self._planes(q, bound)]
        found += [self._named(q, int(first[k]), int(second[k])) for k in near]
        return [item for item in found if item[0] < bound]

    def kind(self, name: str) -> str:
        """Return the kind of a shape, "plane" for a halfspace."""
        return "plane" if name.startswith("plane") else self._heap.bodies[int(name.removeprefix("body"))].kind

    def _bounds(self, centers: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """Return all pairs of bodies, and the gaps of their bounding spheres [m]."""
        first, second = np.triu_indices(len(centers), 1)
        apart = np.linalg.norm(centers[first] - centers[second], axis=1)
        return first, second, apart - self._radii[first] - self._radii[second]

    def _named(self, q: Array, i: int, j: int) -> tuple[float, tuple[str, str]]:
        rotations, centers = _places(np.asarray(q).reshape(-1, 7)[[i, j]])
        gap = self.pair(i, (rotations[0], centers[0]), j, (rotations[1], centers[1]))
        return gap, (f"body{i}", f"body{j}")

    def _planes(self, q: Array, bound: float) -> Iterator[tuple[tuple[str, str], float]]:
        """Yield the gaps to halfspaces of bodies whose bounding spheres are nearer than the bound."""
        rotations, centers = _places(q)
        for number, (normal, offset) in enumerate(self._heap.planes):
            heights = centers @ np.array(normal) - offset
            for k in np.flatnonzero(heights - self._radii < bound):
                reach = _support(self._heap.bodies[k], rotations[k].T @ np.array(normal))
                yield (f"plane{number}", f"body{k}"), float(heights[k]) - reach

    def pair(self, i: int, place_i: tuple[Array, Array], j: int, place_j: tuple[Array, Array]) -> float:
        """Return the gap of two bodies [m], each at (rotation, centre)."""
        shapes = self._sharp if self._smooth[i] or self._smooth[j] else self._round
        a, b = coal.Transform3s(*place_i), coal.Transform3s(*place_j)
        return float(coal.distance(shapes[i], a, shapes[j], b, self._request, coal.DistanceResult()))


def _places(q: Array) -> tuple[Array, Array]:
    """Return rotations (n, 3, 3) and centres (n, 3) of the bodies at a configuration (7 n,)."""
    places = np.asarray(q, dtype=float).reshape(-1, 7)
    return rotation_of(places[:, 3:]), places[:, :3]


def worst_gap(heap: Heap, q: Array) -> float:
    """Return the least gap of a heap [m] at a configuration (nq,), by `GapCheck`; below 0 where shapes overlap."""
    return GapCheck(heap).worst(q)[0]


def _support(body: Body, direction: Array) -> float:
    """Return how far a body reaches from its centre along a unit vector in its own axes [m]; all are symmetric."""
    along = abs(float(direction[2]))
    if body.kind == "box":
        return 0.5 * float(np.abs(direction) @ body.size)
    if body.kind == "sphere":
        return body.size[0]
    radius, half = body.size[0], 0.5 * body.size[1]
    if body.kind == "capsule":
        return radius + half * along
    return radius * math.hypot(direction[0], direction[1]) + half * along


def _box(half: list[float]) -> Any:
    """Return the hull of eight corners: coal's box grows by 1e-10 of its size along directions with a zero in them."""
    corners = coal.StdVec_Vec3s()
    corners.extend([np.array(signs) * half for signs in itertools.product((-1.0, 1.0), repeat=3)])
    return coal.Convex.convexHull(corners, True, "Qt")


def _coal_shape(body: Body, rounding: float = 0.0, share: float = 0.0) -> Any:
    """Return the body's shape of coal, box and cylinder shrunk and swept by a sphere."""
    if body.kind == "sphere":
        return coal.Sphere(body.size[0])
    if body.kind == "capsule":
        return coal.Capsule(*body.size)
    half = [0.5 * x for x in body.size] if body.kind == "box" else [body.size[0], 0.5 * body.size[1]]
    r = min(rounding, share * min(half))
    inner = [x - r for x in half]
    shape = _box(inner) if body.kind == "box" else coal.Cylinder(inner[0], 2.0 * inner[1])
    shape.setSweptSphereRadius(r)
    return shape
