"""Local minima of the signed distance from a surface over each part of a cylinder, by looking everywhere.

The cylinder lies about the axis z of its frame. A part is a dense grid, from whose lowest nodes a general minimizer
goes down. The distance from a height field is that of the nearest of many places on it, from which Newton's method
goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.optimize import minimize
from scipy.spatial import cKDTree

Distance = Callable[[np.ndarray], np.ndarray]
LOW_RIM, HIGH_RIM, SIDE, LOW_END, HIGH_END = 1, 2, 3, 4, 5


class Minimum(NamedTuple):
    """gap [m], its part, and the place on the cylinder, in its frame; is_least: also of the cylinder as a whole."""

    gap: float
    part: int
    place: np.ndarray
    is_least: bool


class HeightDistance:
    """The signed distance (n,) of points (n, 3) from z = f(x, y), of which the foot is not on the border."""

    def __init__(self, surface: RectBivariateSpline, size: np.ndarray, samples: int = 500) -> None:
        self.surface, self.half = surface, 0.5 * np.asarray(size)
        x, y = (np.linspace(-h, h, samples) for h in self.half)
        places = np.stack([*np.meshgrid(x, y, indexing="ij"), surface(x, y)], axis=-1).reshape(-1, 3)
        self.tree, self.places = cKDTree(places), places

    def _at(self, u: np.ndarray, **order: int) -> np.ndarray:
        return np.asarray(self.surface.ev(u[:, 0], u[:, 1], **order))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        u = self.places[self.tree.query(points)[1], :2].copy()
        for _ in range(12):
            f = self._at(u)
            slope = np.stack([self._at(u, dx=1), self._at(u, dy=1)], axis=1)
            bend = np.array(
                [[self._at(u, dx=2), self._at(u, dx=1, dy=1)], [self._at(u, dx=1, dy=1), self._at(u, dy=2)]]
            )
            off = f - points[:, 2]
            gradient = u - points[:, :2] + off[:, None] * slope
            hessian = np.eye(2) + slope[:, :, None] * slope[:, None] + off[:, None, None] * bend.transpose(2, 0, 1)
            # Newton's method towards a minimum: along ways in which it would lead to a maximum downhill all the same.
            values, ways = np.linalg.eigh(hessian)
            along = np.einsum("kij,ki->kj", ways, gradient) / np.maximum(np.abs(values), 0.1)
            u = np.clip(u - np.einsum("kij,kj->ki", ways, along), -self.half, self.half)
        normal = np.column_stack([-self._at(u, dx=1), -self._at(u, dy=1), np.ones(len(u))])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        return np.asarray(((points - np.column_stack([u, self._at(u)])) * normal).sum(axis=1))


def minima(
    distance: Distance, radius: float, half: float, R: np.ndarray, t: np.ndarray, around: int = 96, along: int = 41
) -> list[Minimum]:
    """Return all of them, the nearest first; the cylinder of this radius and half length [m] is at R x + t."""

    def on(part: int, u: Any) -> np.ndarray:
        a, b = np.atleast_1d(u[0]), np.atleast_1d(u[1])
        z = half * (1.0 if part in (HIGH_RIM, HIGH_END) else -1.0)
        if part in (LOW_END, HIGH_END):
            return np.column_stack([a, b, np.full_like(a, z)])
        height = b if part == SIDE else np.full_like(a, z)
        return np.column_stack([radius * np.cos(a / radius), radius * np.sin(a / radius), height])

    def at(x: np.ndarray) -> np.ndarray:
        return distance(x @ R.T + t)

    found: list[Minimum] = []
    angles = 2.0 * np.pi * np.arange(around) / around * radius
    for part in (LOW_RIM, HIGH_RIM, SIDE, LOW_END, HIGH_END):
        if part in (LOW_RIM, HIGH_RIM):
            a, b = angles[:, None], np.zeros((around, 1))
        elif part == SIDE:
            a, b = np.meshgrid(angles, np.linspace(-half, half, along), indexing="ij")
        else:
            a, b = np.meshgrid(*[np.linspace(-radius, radius, along)] * 2, indexing="ij")
        table = at(on(part, (a.ravel(), b.ravel()))).reshape(a.shape)
        if part in (LOW_END, HIGH_END):
            table[a**2 + b**2 > radius**2] = np.inf
        for i, j in np.ndindex(table.shape):
            around_i = [(i + k) % around if part < LOW_END else min(max(i + k, 0), along - 1) for k in (-1, 0, 1)]
            around_j = range(max(j - 1, 0), min(j + 2, b.shape[1]))
            if not np.isfinite(table[i, j]) or table[i, j] > table[np.ix_(around_i, around_j)].min():
                continue
            start = np.array([a[i, j], b[i, j]])
            end = minimize(
                lambda u, part=part: float(at(on(part, u))[0]), start, method="Nelder-Mead",
                options={"xatol": 1e-10, "fatol": 1e-16, "initial_simplex": start + 1e-3 * np.eye(3, 2, -1)},
            )  # fmt: skip
            x = on(part, end.x)[0]
            if (part == SIDE and abs(x[2]) > half) or (part >= LOW_END and np.hypot(*x[:2]) > radius):
                continue
            if all(np.linalg.norm(x - other.place) > 1e-5 or other.part != part for other in found):
                found.append(Minimum(float(end.fun), part, x, _is_least(at, x, float(end.fun), radius, half)))
    return sorted(found, key=lambda m: m.gap)


def _is_least(at: Distance, x: np.ndarray, gap: float, radius: float, half: float) -> bool:
    """Return whether no place of the cylinder around x is nearer."""
    rng = np.random.default_rng(0)
    for step in (1e-4, 1e-3):
        near = x + step * rng.normal(size=(400, 3))
        out = np.hypot(near[:, 0], near[:, 1])
        near[:, :2] *= np.minimum(1.0, radius / out)[:, None]
        near[:, 2] = np.clip(near[:, 2], -half, half)
        if at(near).min() < gap - 1e-9:
            return False
    return True
