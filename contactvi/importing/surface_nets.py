"""Triangles of the surface on which a function is zero, from its values at the corners of a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactvi.importing.pictures import Surface

Array = NDArray[np.float64]


def surface_net(axes: list[Array], d: Array) -> Surface:
    """Return the surface d = 0 of values d (nx, ny, nz) at the corners of a grid: a vertex in each cell it crosses.

    The vertex is the mean of the crossings of the cell's edges; the four cells around an edge that is crossed have a
    quadrilateral, seen anticlockwise from where d is positive. Surface nets (Gibson, 1998).
    """
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = d < 0.0
    shape = tuple(n - 1 for n in d.shape)
    total, count = np.zeros((*shape, 3)), np.zeros(shape)
    quads = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        low, high = (
            tuple(part if k == axis else slice(None) for k in range(3)) for part in (slice(-1), slice(1, None))
        )
        crossed = np.argwhere(inside[low] != inside[high])
        start = tuple(crossed.T)
        weight = d[low][start] / (d[low][start] - d[high][start])
        at = grid[low][start] + weight[:, None] * (grid[high][start] - grid[low][start])
        around = []
        for du, dv in ((0, 0), (-1, 0), (-1, -1), (0, -1)):
            cell = crossed.copy()
            cell[:, u] += du
            cell[:, v] += dv
            around.append(cell)
            some = ((cell >= 0) & (cell < shape)).all(axis=1)
            np.add.at(total, tuple(cell[some].T), at[some])
            np.add.at(count, tuple(cell[some].T), 1.0)
        whole = np.all([((cell >= 0) & (cell < shape)).all(axis=1) for cell in around], axis=0)
        numbers = np.stack([np.ravel_multi_index(tuple(cell[whole].T), shape) for cell in around], axis=1)
        leaves = inside[low][start][whole]  # the edge leads out of the solid
        quads.append(np.where(leaves[:, None], numbers, numbers[:, ::-1]))
    quad = np.concatenate(quads)
    used = np.flatnonzero(count.ravel())
    number = np.zeros(int(np.prod(shape)), dtype=np.int64)
    number[used] = np.arange(len(used))
    corners = number[quad]
    vertices = total.reshape(-1, 3)[used] / count.ravel()[used][:, None]
    faces = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    return Surface(vertices.astype(np.float32), faces.astype(np.uint32))
