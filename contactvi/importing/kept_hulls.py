"""Convex hulls in the cache on disk: vertices, triangles and some numbers that go with them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactvi import cache


class KeptHull(NamedTuple):
    """A hull as arrays.

    Attributes:
        vertices: (n, 3) [m]. faces: its triangles, indices of vertices, (m, 3). numbers: what its maker keeps with it.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    numbers: NDArray[np.float64]


def find_hull(name: str) -> KeptHull | None:
    """Return the hull of an entry; None where there is none, or one that is not a hull."""
    arrays = cache.find(name)
    if arrays is None or len(arrays) != 3:
        return None
    vertices, faces, numbers = arrays
    if [array.dtype.name for array in arrays] != ["float64", "int32", "float64"]:
        return None
    if any(array.ndim != 2 or array.shape[1] != 3 or len(array) < 4 for array in (vertices, faces)):
        return None
    hull = KeptHull(vertices.astype(float, copy=False), faces.astype(np.int32, copy=False), numbers.astype(float))
    usable = np.all(np.isfinite(hull.vertices)) and hull.faces.min() >= 0 and hull.faces.max() < len(hull.vertices)
    return hull if usable else None


def keep_hull(name: str, hull: KeptHull) -> None:
    """Write an entry."""
    cache.keep(name, hull)
