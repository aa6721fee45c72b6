"""What a picture of a scene consists of: shapes on joints, as plain data that can be stored.

Heavy meshes are thinned out by merging the vertices within a cell of a grid (Rossignac, Borrel 1993) into the point
that is nearest to the planes of their faces (Lindstrom 2000).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from contactvi import cache
from contactvi.errors import SceneError
from contactvi.importing.hulls import faces_of
from contactvi.importing.pictures import Picture, Surface, find_surface
from contactvi.importing.submeshes import surface_of
from contactvi.inputs import is_rigid

Color = tuple[float, float, float, float]
SPRING_COLOR: Color = (0.12, 0.55, 0.42, 1.0)
STRING_COLOR: Color = (0.2, 0.22, 0.26, 1.0)
NO_SHAPE_COLOR: Color = (0.5, 0.55, 0.62, 1.0)  # of links of models without shapes
MAX_TRIANGLES = 150_000  # of a whole scene: about 4 MB of page, what a browser turns at 60 frames per second
_UNSET_COLORS = ((0.9, 0.9, 0.9, 1.0), (0.0, 0.0, 0.0, 1.0))  # Pinocchio's own: the file named no colour
_SIZES: dict[str, tuple[str, ...]] = {
    "Sphere": ("radius",),
    "Capsule": ("radius", "halfLength"),
    "Cylinder": ("radius", "halfLength"),
    "Cone": ("radius", "halfLength"),
}
_FREE = 1e-2  # of the largest eigenvalue; below, faces say nothing of a direction: they turn by less than 6 degrees
_DAMAGED = "The file is damaged: run the scene again"
# How many sizes a shape has.
_COUNTS = {
    "sphere": 1, "box": 3, "capsule": 2, "cylinder": 2, "cone": 2, "ellipsoid": 3, "halfspace": 4, "mesh": 0,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Visual:
    """One shape.

    Attributes:
        name: of the geometry.
        joint: index of the joint that carries it, 0 for the world.
        placement: in the frame of the joint, homogeneous matrix, shape (4, 4).
        shape: "sphere", "box", "capsule", "cylinder", "cone", "ellipsoid", "halfspace", "mesh" or "line".
        sizes: [m] sphere (radius), box (half sides), capsule, cylinder and cone (radius, half length along z),
            ellipsoid (radii), halfspace (normal, offset: the solid is n.x <= offset), mesh (); of a line no lengths but
            the joints that carry its vertices, each in the frame of its own (`joint` is 0, `placement` is not used).
        color: red, green, blue, opacity in 0..1; None where the model names none.
        vertices: [m], shape (n, 3) float32.
        faces: shape (m, 3) uint32. Empty unless it is a mesh; a line has vertices.
    """

    name: str
    joint: int
    placement: NDArray[np.float64]
    shape: str
    sizes: tuple[float, ...]
    color: Color | None
    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]

    @property
    def joints(self) -> tuple[int, ...]:
        """Indices of the joints that carry it."""
        return tuple(int(joint) for joint in self.sizes) if self.shape == "line" else (self.joint,)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain data and arrays."""
        return {
            "name": self.name,
            "joint": self.joint,
            "placement": self.placement.tolist(),
            "shape": self.shape,
            "sizes": list(self.sizes),
            "color": None if self.color is None else list(self.color),
            "vertices": self.vertices,
            "faces": self.faces,
        }

    @classmethod
    def from_dict(cls, fields: dict[str, Any]) -> Visual:
        """Return the visual that `to_dict` described; SceneError where the fields do not fit together."""
        vertices = np.asarray(fields["vertices"], dtype=np.float32).reshape(-1, 3)
        faces = np.asarray(fields["faces"], dtype=np.uint32).reshape(-1, 3)
        if len(faces) and int(faces.max()) >= len(vertices):
            raise SceneError(
                f"Mesh {fields['name']!r} of a stored picture",
                body=str(fields["name"]),
                expected=f"faces of its {len(vertices)} vertices",
                got=f"vertex {int(faces.max())}",
                remedy=_DAMAGED,
            )
        shape, sizes = str(fields["shape"]), tuple(float(size) for size in fields["sizes"])
        placement = np.array(fields["placement"], dtype=float).reshape(4, 4)
        count = len(vertices) if shape == "line" else _COUNTS.get(shape)
        if shape == "line" and len(vertices) < 2:
            raise SceneError(
                f"Line {fields['name']!r} of a stored picture",
                body=str(fields["name"]),
                expected="two vertices or more",
                got=len(vertices),
                remedy=_DAMAGED,
            )
        if count != len(sizes) or not (_finite(sizes) and _finite(placement) and _finite(vertices)):
            raise SceneError(
                f"Shape {fields['name']!r} of a stored picture",
                body=str(fields["name"]),
                expected=f"a known shape with {count} finite sizes",
                got=f"{shape!r} with {len(sizes)} sizes, or nan",
                remedy=_DAMAGED,
            )
        if not is_rigid(placement):
            raise SceneError(
                f"Placement of shape {fields['name']!r} of a stored picture",
                body=str(fields["name"]),
                expected="a rotation and a position",
                got=str(placement.tolist()),
                remedy=_DAMAGED,
            )
        color = None if fields["color"] is None else tuple(float(part) for part in fields["color"])
        if color is not None and not (len(color) == 4 and _finite(color)):
            raise SceneError(
                f"Colour of shape {fields['name']!r} of a stored picture",
                body=str(fields["name"]),
                expected="red, green, blue and opacity, finite",
                got=str(color),
                remedy=_DAMAGED,
            )
        return cls(
            name=str(fields["name"]),
            joint=int(fields["joint"]),
            placement=placement,
            shape=shape,
            sizes=sizes,
            color=None if color is None else (color[0], color[1], color[2], color[3]),
            vertices=vertices,
            faces=faces,
        )


def line(name: str, joints: Sequence[int], points: ArrayLike, color: Color) -> Visual:
    """Return a line through points (n, 3) [m], each in the frame of its joint."""
    vertices = np.asarray(points, dtype=np.float32).reshape(-1, 3)
    carriers = tuple(float(joint) for joint in joints)
    return Visual(name, 0, np.eye(4), "line", carriers, color, vertices, np.zeros((0, 3), np.uint32))


def from_picture(picture: Picture) -> Visual | None:
    """Return what is drawn of a picture; None for a kind that cannot be drawn and for an empty mesh."""
    shape, solid = picture.geometry, picture.geometry.geometry
    kind = type(solid).__name__
    name, sizes = "mesh", tuple[float, ...]()
    vertices, faces = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)
    if picture.surface is not None:
        vertices, faces = picture.surface
    elif kind in _SIZES:
        name, sizes = kind.lower(), tuple(float(getattr(solid, size)) for size in _SIZES[kind])
    elif kind == "Box":
        name, sizes = "box", tuple(float(size) for size in solid.halfSide)
    elif kind == "Ellipsoid":
        name, sizes = "ellipsoid", tuple(float(size) for size in solid.radii)
    elif kind in ("Halfspace", "Plane"):
        name, sizes = "halfspace", (*(float(x) for x in solid.n), float(solid.d))
    elif kind.startswith("BVHModel"):
        points, corners = surface_of(solid, str(shape.meshPath), np.array(shape.meshScale))
        vertices, faces = points.astype(np.float32), corners.astype(np.uint32)
    elif kind == "Convex":
        vertices = np.array(solid.points(), dtype=np.float32)
        faces = faces_of(solid).astype(np.uint32)
    else:
        return None
    if name == "mesh" and not len(faces):
        return None
    if not _finite(vertices):
        raise SceneError(
            f"Picture of geometry {shape.name!r}",
            path=shape.meshPath or None,
            body=shape.name,
            expected="vertices that are finite in single precision",
            got=f"nan or inf in {shape.meshPath or 'its mesh'}",
            remedy="Repair the mesh, or take its <visual> out of the file",
        )
    return Visual(
        name=str(shape.name),
        joint=int(shape.parentJoint),
        placement=np.array(shape.placement.homogeneous),
        shape=name,
        sizes=sizes,
        color=_color(shape),
        vertices=vertices.reshape(-1, 3),
        faces=faces.reshape(-1, 3),
    )


def thin_out(visuals: list[Visual], most: int) -> list[Visual]:
    """Return the visuals with their meshes reduced in proportion, to about `most` triangles in all."""
    total = sum(len(visual.faces) for visual in visuals)
    if total <= most:
        return visuals
    thinned = []
    for visual in visuals:
        surface = Surface(visual.vertices, visual.faces)
        vertices, faces = _thinned(surface, max(200, len(visual.faces) * most // total))
        thinned.append(replace(visual, vertices=vertices, faces=faces))
    return thinned


def _thinned(surface: Surface, most: int) -> Surface:
    """Return a mesh reduced to at most `most` triangles, from the cache on disk where it is there."""
    if len(surface.faces) <= most:
        return surface
    key = cache.key("thinned mesh", *(array.tobytes() for array in surface), float(most))
    found = find_surface(key)
    if found is None:
        found = _clustered(*surface, most)
        cache.keep(key, found)
    return found


def _clustered(vertices: NDArray[np.float32], faces: NDArray[np.uint32], most: int) -> Surface:
    """Return the mesh with at most `most` triangles (coarser grids are tried until it is)."""
    # About two triangles per occupied cell, and a surface crosses about 3 k^2 cells of a grid of k^3.
    cells = max(2, int(np.sqrt(most)))
    points = np.ascontiguousarray(vertices.T)  # sums over rows of three numbers take ten times as long
    from_low = points - points.min(axis=1, keepdims=True)
    extent = max(float(from_low.max()), 1e-9)
    while True:
        size = extent / cells
        group = np.unique(_numbered(np.floor(from_low / size).astype(np.int64)), return_inverse=True)[1]
        a, b, c = corners = group[faces.T]
        corners = corners[:, (a != b) & (b != c) & (c != a)]
        # One triangle per set of corners: merging lays several on top of each other.
        first = np.unique(_numbered(np.sort(corners, axis=0)), return_index=True)[1]
        if len(first) <= most or cells <= 2:
            merged = _merged(points.astype(float), faces, group, size)
            return Surface(merged.astype(np.float32), np.ascontiguousarray(corners[:, np.sort(first)].T, np.uint32))
        cells = int(cells * 0.8)


def _numbered(columns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a number for each column (a, b, c) of numbers from 0 to below 2^21, in the order of the columns."""
    numbers: NDArray[np.int64] = (columns[0] << 42) | (columns[1] << 21) | columns[2]
    return numbers


def _merged(
    points: NDArray[np.float64], faces: NDArray[np.uint32], group: NDArray[np.int64], size: float
) -> NDArray[np.float64]:
    """Return the place in each cell of points (3, n) with the least squares of distances to the planes of its faces.

    It is near the mean of the points.

    Where faces leave a direction free (a plane, an edge) the mean of the vertices decides: flat stays flat, and edges
    sharp. The mean alone would dent both.
    """
    cells = int(group.max()) + 1
    count = np.bincount(group)
    means = np.stack([np.bincount(group, coordinate) / count for coordinate in points])
    a, b, c = (points[:, faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a, axis=0)
    normal /= np.sqrt(np.maximum(np.sqrt((normal * normal).sum(axis=0)), 1e-300))  # its square is the area
    square, side = np.zeros((3, 3, cells)), np.zeros((3, cells))
    for k in range(3):
        cell = group[faces[:, k]]
        distance = (normal * (a - means[:, cell])).sum(axis=0)
        for i in range(3):
            side[i] += np.bincount(cell, normal[i] * distance, minlength=cells)
            for j in range(i + 1):
                square[i, j] += np.bincount(cell, normal[i] * normal[j], minlength=cells)
    values, axes = np.linalg.eigh(np.moveaxis(square, 2, 0))  # which reads the lower triangle
    fixed = values > _FREE * values[:, 2:]
    along = np.einsum("cji,jc->ci", axes, side)
    along = np.where(fixed & (values > 0.0), along / np.where(values > 0.0, values, 1.0), 0.0)
    return np.asarray(means.T + np.clip(np.einsum("cij,cj->ci", axes, along), -0.5 * size, 0.5 * size))


def _finite(values: Any) -> bool:
    return bool(np.isfinite(values).all())


def _color(shape: pin.GeometryObject) -> Color | None:
    red, green, blue, opacity = (round(float(x), 6) for x in shape.meshColor)
    if (red, green, blue, opacity) in _UNSET_COLORS and not shape.overrideMaterial:
        return None
    return red, green, blue, max(opacity, 0.1)
