"""The shapes of an MJCF's geoms for coal."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import coal
import numpy as np

from contactvi.importing.height_fields import MOST_PRISMS, HeightField, count_prisms, prisms
from contactvi.importing.mjcf.compiler import Source

HFIELDS = ("prisms", "smooth")  # how height fields are taken


class Shape(NamedTuple):
    """A shape of a geom: what follows the geom's name, its solid for coal, and the number of its mesh if it has one.

    The solid of a mesh is an empty one, in whose place a hull or a surface comes. A height field has a halfspace, in
    whose place it stands.
    """

    suffix: str
    solid: coal.CollisionGeometry
    mesh: int | None = None
    field: HeightField | None = None


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

    def __init__(self, source: Source, hfield: str) -> None:
        self._source, self._hfield = source, hfield
        self._found: dict[int, list[Shape]] = {}

    def of(self, geom: int) -> list[Shape]:
        """Return the shapes of a geom: one, prisms of a height field, or none where there is no such shape."""
        if geom not in self._found:
            self._found[geom] = _shapes_of(self._source, geom, self._hfield)
        return self._found[geom]


def _shapes_of(source: Source, geom: int, hfield: str) -> list[Shape]:
    m, kind = source.m, source.word("Geom", source.m.geom_type[geom])
    if kind in _PRIMITIVES:
        return [Shape("", _PRIMITIVES[kind](np.array(m.geom_size[geom], dtype=float)))]
    if kind == "hfield":
        return _height_field(source, geom, hfield)
    if kind in ("mesh", "sdf"):
        if kind == "sdf":
            source.lose(
                "geom",
                source.names["geom"][geom],
                "signed distance field: of the mesh that MuJoCo makes of it, as of others",
            )
        return [Shape("", coal.BVHModelOBBRSS(), int(m.geom_dataid[geom]))]
    source.lose("geom", source.names["geom"][geom], f"shape {kind}")
    return []


def _height_field(source: Source, geom: int, hfield: str) -> list[Shape]:
    m, k, name = source.m, int(source.m.geom_dataid[geom]), source.names["geom"][geom]
    rows, columns = int(m.hfield_nrow[k]), int(m.hfield_ncol[k])
    half_x, half_y, top, base = (float(x) for x in m.hfield_size[k])
    first = int(m.hfield_adr[k])
    z = top * np.array(m.hfield_data[first : first + rows * columns], dtype=float).reshape(rows, columns)
    field = HeightField(z, 2.0 * np.array([half_x, half_y]))
    if hfield == "smooth":
        off = field.from_triangles()
        text = f"height field taken smooth: {off.largest:.3g} m from the file's triangles at most, {off.mean:.3g} m in "
        source.report.note("changed", "geom", name, text + "the mean; it has no bottom")
        return [Shape("", coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0), field=field)]
    if count_prisms(z) > MOST_PRISMS:
        source.lose("geom", name, f"height field of more than {MOST_PRISMS // 2} cells")
        return []
    source.report.note("used", "geom", name, "height field taken as prisms of the file's triangles: 0 m from them")
    return [Shape(suffix, solid) for suffix, solid in prisms(z, field.size, base, name)]


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


__all__ = ["HFIELDS", "MOST_PRISMS", "Shape", "Shapes", "color_of", "in_pictures"]
