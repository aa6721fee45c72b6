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
    usable = (
        vertices.dtype == np.float64
        and faces.dtype == np.int32
        and numbers.dtype == np.float64
        and vertices.ndim == faces.ndim == 2
        and vertices.shape[1] == faces.shape[1] == 3
        and min(len(vertices), len(faces)) >= 4
        and bool(np.all(np.isfinite(vertices.astype(float))))
        and int(faces.min()) >= 0
        and int(faces.max()) < len(vertices)
    )
    return KeptHull(vertices, faces, numbers) if usable else None


def keep_hull(name: str, hull: KeptHull) -> None:
    """Write an entry."""
    cache.keep(name, hull)
