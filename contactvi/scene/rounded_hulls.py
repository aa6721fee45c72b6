"""Rounded hulls of the engine in the cache on disk; making them takes as long as making the hulls of meshes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactvi import cache
from contactvi.importing.kept_hulls import KeptHull, find_hull, keep_hull

Array = NDArray[np.float64]
Faces = NDArray[np.int32]


class RoundedHulls:
    """What the engine's scene asks for rounded hulls. vertices: (n, 3) [m], faces: (m, 3), radius [m]."""

    @staticmethod
    def find(vertices: Array, faces: Faces, radius: float) -> tuple[Array, Faces, float] | None:
        """Return the hull shrunk by at most radius, and by how much; None where it is not known."""
        kept = find_hull(_key(vertices, faces, radius))
        if kept is None or kept.numbers.shape != (1,) or not 0.0 <= kept.numbers[0] <= radius:
            return None
        return kept.vertices, kept.faces, float(kept.numbers[0])

    @staticmethod
    def keep(vertices: Array, faces: Faces, radius: float, shrunk: Array, shrunk_faces: Faces, by: float) -> None:
        """Keep the hull shrunk `by` [m]."""
        keep_hull(_key(vertices, faces, radius), KeptHull(shrunk, shrunk_faces, np.array([by])))


def _key(vertices: Array, faces: Faces, radius: float) -> str:
    return cache.key("rounded hull", vertices.tobytes(), faces.tobytes(), float(radius))
