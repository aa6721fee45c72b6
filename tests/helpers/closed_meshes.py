"""Closed meshes that are not convex, as triangles of level sets: a cow, a stool with three legs, a mug."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from contactvi.importing.surface_nets import surface_net

Mesh = tuple[np.ndarray, np.ndarray]
Function = Callable[[np.ndarray], np.ndarray]

# The mug stands on z = 0; its handle is a ring in the plane x = 0.
MUG_OUT, MUG_IN, MUG_HIGH, MUG_FLOOR = 0.035, 0.027, 0.12, 0.008
HANDLE, HANDLE_TUBE, HANDLE_AT = 0.026, 0.006, np.array([0.0, 0.055, 0.08])
# The stool: the middle of the ends of its legs is so far from z, at these angles and below the seat's middle.
STOOL_FOOT, STOOL_OUT, STOOL_DOWN, STOOL_SEAT = 0.02, 0.08, 0.12, np.array([0.11, 0.11, 0.025])
STOOL_ANGLES = 2.0 * np.pi / 3.0 * np.arange(3)
_BLEND = 80.0  # [1/m] of what is joined smoothly


def level_mesh(function: Function, low: np.ndarray, high: np.ndarray, spacing: float) -> Mesh:
    """Triangles of the surface on which a function of points (..., 3), negative inside, is zero."""
    # The grid has no place of symmetry: flat sides between its planes make no triangles without an area.
    start = low - spacing * np.array([0.37, 0.29, 0.41])
    axes = [np.arange(a, b + spacing, spacing) for a, b in zip(start, high, strict=True)]
    surface = surface_net(axes, function(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)))
    return np.asarray(surface.vertices, dtype=float), np.asarray(surface.faces, dtype=int)


def capsule(p: np.ndarray, a: np.ndarray, b: np.ndarray, radius: float) -> np.ndarray:
    """The distance from one between two points."""
    along = b - a
    part = np.clip((p - a) @ along / (along @ along), 0.0, 1.0)
    out: np.ndarray = np.linalg.norm(p - a - part[..., None] * along, axis=-1) - radius
    return out


def joined(*distances: np.ndarray) -> np.ndarray:
    """The union of what distances are from, with its hollow edges filled."""
    out: np.ndarray = -np.log(sum(np.exp(-np.clip(_BLEND * d, -50.0, 50.0)) for d in distances)) / _BLEND
    return out


def cow(spacing: float = 0.006) -> Mesh:
    """A body of 19 cm with four legs, a head with two horns, and a tail."""
    ends: list[tuple[tuple[float, ...], tuple[float, ...], float]] = [((-0.06, 0.0, 0.0), (0.06, 0.0, 0.0), 0.035)]
    for x in (-0.055, 0.055):
        ends += [((x, y, -0.02), (1.1 * x, 1.1 * y, -0.08), 0.012) for y in (-0.025, 0.025)]
    ends.append(((0.06, 0.0, 0.01), (0.11, 0.0, 0.045), 0.02))
    ends += [((0.1, side * 0.02, 0.06), (0.115, side * 0.035, 0.08), 0.01) for side in (-1.0, 1.0)]
    ends.append(((-0.08, 0.0, 0.02), (-0.12, 0.0, -0.02), 0.01))

    def function(p: np.ndarray) -> np.ndarray:
        return joined(*(capsule(p, np.array(a), np.array(b), radius) for a, b, radius in ends))

    return level_mesh(function, np.array([-0.16, -0.08, -0.12]), np.array([0.16, 0.08, 0.12]), spacing)


def stool_feet() -> np.ndarray:
    """The middles of the ends of its legs (3, 3)."""
    out, down = STOOL_OUT * np.ones(3), -STOOL_DOWN * np.ones(3)
    return np.stack([out * np.cos(STOOL_ANGLES), out * np.sin(STOOL_ANGLES), down], axis=1)


def stool(spacing: float = 0.008) -> Mesh:
    """A seat, a flat ellipsoid about the origin, on three legs."""

    def function(p: np.ndarray) -> np.ndarray:
        scaled = np.linalg.norm(p / STOOL_SEAT, axis=-1)
        seat = scaled * (scaled - 1.0) / np.maximum(np.linalg.norm(p / STOOL_SEAT**2, axis=-1), 1e-9)
        return joined(
            seat, *(capsule(p, np.array([*(0.7 * foot[:2]), 0.0]), foot, STOOL_FOOT) for foot in stool_feet())
        )

    high = STOOL_SEAT[0] + 0.02
    return level_mesh(function, np.array([-high, -high, -0.16]), np.array([high, high, 0.05]), spacing)


def mug(spacing: float = 0.002) -> Mesh:
    """A cup with sharp edges and a round handle."""

    def function(p: np.ndarray) -> np.ndarray:
        r, z = np.hypot(p[..., 0], p[..., 1]), p[..., 2]
        whole = np.maximum(r - MUG_OUT, np.maximum(-z, z - MUG_HIGH))
        cup = np.maximum(whole, -np.maximum(r - MUG_IN, MUG_FLOOR - z))
        d = p - HANDLE_AT
        ring = np.hypot(np.hypot(d[..., 1], d[..., 2]) - HANDLE, d[..., 0]) - HANDLE_TUBE
        out: np.ndarray = np.minimum(cup, np.maximum(ring, 0.5 * (MUG_OUT + MUG_IN) - r))
        return out

    return level_mesh(function, np.array([-0.045, -0.045, -0.01]), np.array([0.045, 0.1, 0.13]), spacing)
