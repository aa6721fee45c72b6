"""The shapes of an MJCF's geoms for coal."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import coal
import numpy as np

from contactvi.importing.hulls import hull_of_points
from contactvi.importing.mjcf.compiler import Source

MOST_PRISMS = 2000  # of which a height field is made: more would take minutes to load


class Shape(NamedTuple):
    """A shape of a geom: what follows the geom's name, its solid for coal, and the number of its mesh if it has one.

    The solid of a mesh is an empty one, in whose place a hull or a surface comes.
    """

    suffix: str
    solid: coal.CollisionGeometry
    mesh: int | None = None


_PRIMITIVES: dict[str, Callable[[np.ndarray], coal.CollisionGeometry]] = {
    # The size of a plane is for pictures alone: in contact it has no end.
    "plane": lambda size: coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0),
    "sphere": lambda size: coal.Sphere(size[0]),
    "capsule": lambda size: coal.Capsule(size[0], 2.0 * size[1]),
    "cylinder": lambda size: coal.Cylinder(size[0], 2.0 * size[1]),
    "ellipsoid": lambda size: coal.Ellipsoid(*size),
    "box": lambda size: coal.Box(*(2.0 * size)),
}


class Shapes:
    """The shapes of geoms in their frames, each made once."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._found: dict[int, list[Shape]] = {}

    def of(self, geom: int) -> list[Shape]:
        """Return the shapes of a geom: one, prisms of a height field, or none where there is no such shape."""
        if geom not in self._found:
            self._found[geom] = _shapes_of(self._source, geom)
        return self._found[geom]


def _shapes_of(source: Source, geom: int) -> list[Shape]:
    m, kind = source.m, source.word("Geom", source.m.geom_type[geom])
    if kind in _PRIMITIVES:
        return [Shape("", _PRIMITIVES[kind](np.array(m.geom_size[geom], dtype=float)))]
    if kind == "hfield":
        return _prisms(source, geom)
    if kind in ("mesh", "sdf"):
        if kind == "sdf":
            source.lose("geom", source.names["geom"][geom], "signed distance field: the hull of its mesh is used")
        return [Shape("", coal.BVHModelOBBRSS(), int(m.geom_dataid[geom]))]
    source.lose("geom", source.names["geom"][geom], f"shape {kind}")
    return []


def _prisms(source: Source, geom: int) -> list[Shape]:
    """Return the convex prisms of a height field, two for each cell, cut as MuJoCo cuts them."""
    m, k, name = source.m, int(source.m.geom_dataid[geom]), source.names["geom"][geom]
    rows, columns = int(m.hfield_nrow[k]), int(m.hfield_ncol[k])
    count = 2 * (rows - 1) * (columns - 1)
    if count > MOST_PRISMS:
        source.lose("geom", name, f"height field of more than {MOST_PRISMS // 2} cells")
        return []
    half_x, half_y, top, base = (float(x) for x in m.hfield_size[k])
    first = int(m.hfield_adr[k])
    z = top * np.array(m.hfield_data[first : first + rows * columns], dtype=float).reshape(rows, columns)
    x, y = np.linspace(-half_x, half_x, columns), np.linspace(-half_y, half_y, rows)
    found = []
    for r, c in itertools.product(range(rows - 1), range(columns - 1)):
        a, b, d, e = (r, c), (r, c + 1), (r + 1, c), (r + 1, c + 1)
        for half, corners in enumerate(((d, a, e), (a, e, b))):
            points = [(x[j], y[i], height) for i, j in corners for height in (z[i, j], -base)]
            found.append(Shape(f"_{r}_{c}_{half}", hull_of_points(np.array(points), f"{name}_{r}_{c}_{half}")))
    return found


def color_of(source: Source, geom: int) -> np.ndarray:
    """Return the colour rgba of a geom: its own, or its material's."""
    m, own = source.m, np.array(source.m.geom_rgba[geom], dtype=float)
    material = int(m.geom_matid[geom])
    default = np.allclose(own, (0.5, 0.5, 0.5, 1.0))
    return np.array(m.mat_rgba[material], dtype=float) if material >= 0 and default else own


def in_pictures(source: Source) -> list[int]:
    """Return the geoms that MuJoCo's viewer shows, those of groups 0 to 2; all where there are none."""
    shown = [int(g) for g in np.flatnonzero(np.asarray(source.m.geom_group) < 3)]
    return shown or list(range(source.m.ngeom))


__all__ = ["MOST_PRISMS", "Shape", "Shapes", "color_of", "in_pictures"]
