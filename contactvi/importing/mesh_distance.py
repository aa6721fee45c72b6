"""How far the surface of a shape is from the mesh that it was made of.

It is measured both ways: at places spread evenly over the triangles of the mesh, and at its vertices, the distance from
the surface of the shape; at such places on the shape the distance from the mesh. Mean and largest are those of all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from contactvi._core import mesh_distances
from contactvi.importing.height_fields import Deviation
from contactvi.importing.mesh_bodies import MeshSource
from contactvi.importing.mesh_solids import closed, mesh_solid
from contactvi.importing.solids import SampledSolid

Array = NDArray[np.float64]
Faces = NDArray[np.int64]
_PLACES = 4000  # on each of the two surfaces
_PLASTIC = 1.324717957244746  # of the sequence of points, which fills the unit square evenly (Roberts, 2018)
_ABOVE = 1e-3  # of the size of a mesh: a place with another hull so close above it is in a seam, and no surface
_STEPS = 8  # of Newton's method towards the surface of a field


def places(vertices: Array, faces: Faces, count: int = _PLACES) -> tuple[Array, Array]:
    """Return `count` places (n, 3) [m] on triangles (m, 3), as many on equal areas, and the normals there (n, 3)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    chosen = np.searchsorted(np.cumsum(area), (np.arange(count) + 0.5) / count * area.sum()).clip(max=len(faces) - 1)
    u, v = (np.arange(1, count + 1)[:, None] / [_PLASTIC, _PLASTIC**2] % 1.0).T
    u, v = np.where(u + v > 1.0, [1.0 - u, 1.0 - v], [u, v])
    at = a[chosen] + u[:, None] * (b - a)[chosen] + v[:, None] * (c - a)[chosen]
    return at, normals[chosen] / area[chosen, None]


def from_hulls(mesh: MeshSource, hulls: Sequence[tuple[Array, Faces]]) -> Deviation:
    """Return the distance of the surface of the union of hulls, each vertices and outward triangles, from a mesh [m].

    In the union the distance from its surface is taken as the depth in the deepest hull.
    """
    vertices, faces = _arrays(mesh)
    there = np.abs(_signed(_on_mesh(vertices, faces), hulls))
    own = [places(*hull, count=max(1, _PLACES // len(hulls))) for hull in hulls]
    at, normals = (np.concatenate(parts) for parts in zip(*own, strict=True))
    above = at + _ABOVE * float(np.ptp(vertices, axis=0).max()) * normals
    outside = at[_signed(above, hulls) > 0.0]  # what another hull covers, or lies upon, is no surface
    return _of(there, np.abs(_distance(vertices, faces, outside)))


def field(name: str, mesh: MeshSource, spacing: float | None, fine: float) -> tuple[SampledSolid, float]:
    """Return the field of a closed mesh and the distance of its samples [m], by default the longest edge / fine."""
    vertices, faces = closed(name, *_arrays(mesh))
    apart = float(np.ptp(vertices, axis=0).max()) / fine if spacing is None else spacing
    return mesh_solid(name, vertices, faces, apart)[0], apart


def from_field(mesh: MeshSource, solid: SampledSolid) -> Deviation:
    """Return the distance of the surface of a field from a mesh [m]; the way to it is Newton's, along the gradient."""
    vertices, faces = _arrays(mesh)
    on_mesh = _on_mesh(vertices, faces)
    there = np.linalg.norm(_onto(solid, on_mesh) - on_mesh, axis=1)
    return _of(there, np.abs(_distance(vertices, faces, _onto(solid, solid.middles(solid.passed())))))


def _onto(solid: SampledSolid, points: Array) -> Array:
    """Return points of the surface near points (n, 3)."""
    for _ in range(_STEPS):
        value, gradient = solid.at(points)
        square = np.maximum((gradient**2).sum(axis=1), 0.1)  # that of a distance is 1, less at its ridges
        points = points - (value / square)[:, None] * gradient
    return points


def _on_mesh(vertices: Array, faces: Faces) -> Array:
    return np.concatenate([places(vertices, faces)[0], vertices[np.unique(faces)]])


def _signed(points: Array, hulls: Sequence[tuple[Array, Faces]]) -> Array:
    least: Array = np.min([_distance(*hull, points) for hull in hulls], axis=0)
    return least


def _distance(vertices: Array, faces: Faces, points: Array) -> Array:
    corners, triangles = np.ascontiguousarray(vertices), np.ascontiguousarray(faces, dtype=np.int32)
    return np.asarray(mesh_distances(corners, triangles, np.ascontiguousarray(points)))


def _arrays(mesh: MeshSource) -> tuple[Array, Faces]:
    assert mesh.vertices is not None
    assert mesh.faces is not None
    return mesh.vertices, mesh.faces


def _of(*distances: Array) -> Deviation:
    found = np.concatenate(distances)
    return Deviation(float(found.max()), float(found.mean()))
