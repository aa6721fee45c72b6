"""Plain shapes as triangles: what is round is a profile that turns about z, a box its eight corners."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]

_AROUND = 24  # points of a circle: neighbouring faces turn by 15 degrees, less than a crease


def outline_mesh(shape: str, sizes: Sequence[float]) -> Mesh:
    """Return vertices [m] (n, 3) and triangles (m, 3) of a shape other than a mesh; sizes as of `Visual`."""
    if shape == "box":
        return _box(np.array(sizes, float))
    if shape == "ellipsoid":
        vertices, faces = _turned(_arc(1.0, 0.0))
        return (vertices * np.array(sizes)).astype(np.float32), faces
    radius, half = float(sizes[0]), float(sizes[1]) if len(sizes) > 1 else 0.0
    flat = {"cylinder": [(0, -half), (radius, -half), (radius, half), (0, half)],
            "cone": [(0, -half), (radius, -half), (0, half)]}  # fmt: skip
    return _turned(np.array(flat[shape]) if shape in flat else _arc(radius, half))


def _arc(radius: float, half: float) -> Array:
    """Return the profile (k, 2) of a capsule, distance from the axis and height; of a sphere where half is 0."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _AROUND // 2 + 1)
    profile = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    if half == 0.0:
        return profile
    middle = _AROUND // 4
    return np.concatenate([profile[: middle + 1] - [0.0, half], profile[middle:] + [0.0, half]])


def _turned(profile: Array) -> Mesh:
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    rings = np.empty((len(profile), _AROUND, 3))
    rings[..., 0], rings[..., 1] = np.outer(profile[:, 0], np.cos(angle)), np.outer(profile[:, 0], np.sin(angle))
    rings[..., 2] = profile[:, 1:]
    ring, place = (index.ravel() for index in np.indices((len(profile) - 1, _AROUND)))
    after = (place + 1) % _AROUND
    a, b = ring * _AROUND + place, ring * _AROUND + after
    return rings.reshape(-1, 3).astype(np.float32), _faces([[a, b, b + _AROUND], [a, b + _AROUND, a + _AROUND]])


def _box(half: Array) -> Mesh:
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    quads = np.array(sides).T
    return corners.astype(np.float32), _faces([[quads[0], quads[1], quads[2]], [quads[0], quads[2], quads[3]]])


def _faces(groups: Sequence[Sequence[NDArray[np.int64]]]) -> NDArray[np.uint32]:
    return np.concatenate([np.column_stack(list(group)) for group in groups]).astype(np.uint32)
