"""Solids of closed meshes: the signed distance, sampled on a grid.

The distance is the engine's own: the nearest triangle by a tree of boxes, and the sign by angle-weighted normals, exact
to rounding for closed meshes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactvi import cache
from contactvi._core import mesh_distances
from contactvi.errors import InputError, SceneError
from contactvi.importing.height_fields import Deviation
from contactvi.importing.solids import SampledSolid, deviation, sampled_solid

Array = NDArray[np.float64]
_BORDER = 3.0  # samples around the mesh


def mesh_solid(name: str, vertices: Array, faces: NDArray[np.int64], spacing: float) -> tuple[SampledSolid, Deviation]:
    """Return the solid of a closed mesh, vertices (n, 3) [m] and triangles (m, 3), and how far its surface is from it.

    Samples are `spacing` [m] apart. They are kept in the cache on disk.

    Raises InputError for a spacing that the mesh is too thin or too large for.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = np.stack([low - _BORDER * spacing, high + _BORDER * spacing], axis=1)
    if spacing > 0.5 * float((high - low).max()):
        raise InputError(
            f"The spacing of {name!r}", name="spacing", expected="less than half of the mesh",
            got=f"{spacing:g} m, of {float((high - low).max()):g} m", remedy="A tenth of its thinnest part is fine",
        )  # fmt: skip
    corner_data, triangle_data = np.ascontiguousarray(vertices), np.ascontiguousarray(faces, dtype=np.int32)

    def distance(points: Array) -> Array:
        return mesh_distances(corner_data, triangle_data, np.ascontiguousarray(points))

    key = cache.key("solid of a mesh", corner_data.tobytes(), triangle_data.tobytes(), float(spacing))
    found = cache.find(key)
    if found is not None and len(found) == 2:
        samples, off = (np.array(part, dtype=float) for part in found)
        return SampledSolid(False, extent, samples), Deviation(*off.tolist())
    solid = sampled_solid(distance, extent, spacing, False)
    away = deviation(solid, distance)
    cache.keep(key, [solid.samples, np.array(away)])
    return solid, away


def closed(name: str, vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Return a mesh with equal vertices joined, triangles outward and none flat. Raises SceneError for an open one."""
    corners, number = np.unique(vertices, axis=0, return_inverse=True)
    triangles = number.reshape(-1)[faces]
    triangles = triangles[(triangles[:, [0, 1, 2]] != triangles[:, [1, 2, 0]]).all(axis=1)]
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    there, ways = np.unique(edges @ [len(corners), 1], return_counts=True)
    back = np.unique(edges[:, ::-1] @ [len(corners), 1])
    if len(there) == 0 or ways.max() > 1 or not np.array_equal(there, back):
        odd = len(np.setxor1d(there, back)) + int((ways > 1).sum())
        raise SceneError(
            f"The mesh of {name!r} is not closed", body=name, expected="each edge between two triangles, turned alike",
            got=f"{odd} edges without" if len(there) else "no triangles",
            remedy="Repair it, for example in MeshLab, or leave spacing or shape out: the hull needs no closed mesh",
        )  # fmt: skip
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    outward = np.einsum("ij,ij->", a, np.cross(b, c)) > 0.0
    return corners, triangles if outward else triangles[:, ::-1]
