"""Where the surfaces of two solids are nearest to each other or overlap most, by dense samples and a general solver.

A place p on the first surface F = 0 and a place x on the second one G = 0 with opposite normals along x - p. Samples of
both surfaces say where; scipy's solver of nonlinear equations, with differences in the place of derivatives, says it to
rounding. Slow and obvious: nothing of it is as the engine does it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Function = Callable[[Array], Any]  # of points (n, 3), returns (n,), negative inside
_STEP = 1e-5


def gradient(function: Function, points: Array) -> Array:
    """Return the gradient of a function at points (n, 3) by differences of fourth order."""
    found = np.empty(points.shape)
    for axis, e in enumerate(np.eye(3)):
        a, b, c, d = (np.asarray(function(points + k * _STEP * e)) for k in (-2.0, -1.0, 1.0, 2.0))
        found[:, axis] = (a - 8.0 * b + 8.0 * c - d) / (12.0 * _STEP)
    return found


def normals(function: Function, points: Array) -> Array:
    """Return the outward unit normals at points (n, 3) of the surface."""
    found = gradient(function, points)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def surface_points(function: Function, extent: Array, spacing: float) -> Array:
    """Return points of the surface, about `spacing` apart: those of a grid that are near it, moved onto it."""
    axes = [np.arange(low, high + spacing, spacing) for low, high in extent]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    for _ in range(30):
        slope = gradient(function, grid)
        step = np.asarray(function(grid))[:, None] * slope / (slope**2).sum(axis=1, keepdims=True)
        if _ == 0:
            near = np.isfinite(step).all(axis=1) & (np.linalg.norm(step, axis=1) < spacing)
            grid, step = grid[near], step[near]
        grid = grid - step
    return np.asarray(grid[np.abs(function(grid)) < 1e-12])


def common_normals(first: Function, second: Function, extents: tuple[Array, Array], spacing: float) -> Array:
    """Return rows gap, n (3), p (3), x (3) of all local minima of the distance that are no deeper than `spacing`.

    Both functions are of points in one frame; n is the outward normal of the first surface at p, gap = n . (x - p).
    """
    one, other = (surface_points(f, extent, spacing) for f, extent in zip((first, second), extents, strict=True))
    tree = cKDTree(one)
    distance, nearest = tree.query(other)
    # Signed by the side of the first surface; a sample is a seed where none around it is lower.
    signed = distance * np.sign(np.einsum("ij,ij->i", normals(first, one[nearest]), other - one[nearest]))
    around = cKDTree(other).query_ball_point(other, 2.5 * spacing)
    seeds = [k for k, near in enumerate(around) if signed[k] <= signed[near].min() + 0.02 * spacing]
    rows: list[Array] = []
    for k in seeds:
        start = np.concatenate([one[nearest[k]], other[k], [signed[k]]])
        found = root(lambda u: _equations(first, second, u), start, method="hybr", tol=1e-13)
        p, x, gap = found.x[:3], found.x[3:6], float(found.x[6])
        n, m = normals(first, p[None])[0], normals(second, x[None])[0]
        if np.abs(found.fun).max() > 1e-9 or n @ m > -1.0 + 1e-9 or gap < -spacing:
            continue
        if np.linalg.norm(x - other[k]) > 4.0 * spacing or not _is_least(first, second, p, x, gap, spacing):
            continue
        if all(np.linalg.norm(x - row[7:]) > 1e-6 for row in rows):
            rows.append(np.concatenate([[gap], n, p, x]))
    return np.array(sorted(rows, key=lambda row: row[0])).reshape(-1, 10)


def _equations(first: Function, second: Function, u: Array) -> Array:
    p, x, gap = u[:3], u[3:6], u[6]
    n, m = normals(first, p[None])[0], normals(second, x[None])[0]
    across = _across(n)
    apart = x - p - gap * n
    return np.array([first(p[None])[0], second(x[None])[0], *apart, *(across @ m)])


def _across(n: Array) -> Array:
    t = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    t /= np.linalg.norm(t)
    return np.array([t, np.cross(n, t)])


def _is_least(first: Function, second: Function, p: Array, x: Array, gap: float, spacing: float) -> bool:
    """Whether the distance from the first surface grows on the second one in all directions from x."""
    h = 1e-3 * spacing
    t = _across(normals(first, p[None])[0])
    for angle in np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False):
        y = x + h * (np.cos(angle) * t[0] + np.sin(angle) * t[1])
        for _ in range(6):
            slope = gradient(second, y[None])[0]
            y = y - second(y[None])[0] * slope / (slope @ slope)
        foot = root(lambda u, y=y: _foot(first, y, u), np.concatenate([p, [gap]]), tol=1e-13)
        if foot.x[3] < gap - 1e-13:
            return False
    return True


def _foot(first: Function, y: Array, u: Array) -> Array:
    n = normals(first, u[None, :3])[0]
    return np.array([first(u[None, :3])[0], *(y - u[:3] - u[3] * n)])
