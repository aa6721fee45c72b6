"""Pictures: what is drawn of a model, in which meshes are plain arrays.

Coal makes a tree of boxes over the triangles of each mesh, for distances between meshes. Pictures have none: a mesh
gets its tree where somebody asks for Pinocchio's model of the pictures (`with_meshes`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi import cache
from contactvi.importing.mesh_hulls import MeshFile
from contactvi.importing.paths import mesh_error, unreadable
from contactvi.importing.submeshes import surface_of, unused_vertices


class Surface(NamedTuple):
    """A mesh that is drawn: vertices (n, 3) [m], and triangles (m, 3), which count vertices."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


@dataclass(frozen=True, eq=False)
class Picture:
    """A geometry that is drawn.

    Attributes:
        geometry: its name, place, colour and shape. surface: the mesh to be drawn, in the place of the shape; None for
            a shape that is drawn itself.
    """

    geometry: pin.GeometryObject
    surface: Surface | None = None

    def with_mesh(self) -> pin.GeometryObject:
        """Return the geometry with a mesh of coal in the place of the surface, read from its file where it has one."""
        if self.surface is None:
            return self.geometry
        made = self.geometry.copy()
        made.geometry = _mesh_of_file(made) if made.meshPath else _mesh_of(self.surface)
        return made


def pictures_of(geometry: pin.GeometryModel) -> list[Picture]:
    """Return the pictures of shapes, which are drawn as they are."""
    return [Picture(item) for item in geometry.geometryObjects]


def with_meshes(pictures: Iterable[Picture]) -> pin.GeometryModel:
    """Return Pinocchio's model of pictures."""
    visual = pin.GeometryModel()
    for picture in pictures:
        visual.addGeometryObject(picture.with_mesh())
    return visual


def surface_of_file(file: MeshFile, name: str) -> Surface:
    """Return the mesh of a file, mended where coal reads it torn; from the cache on disk where it is there.

    Warns (TornMeshWarning) of a torn mesh that stays so, which is not kept.

    Args:
        name: of the geometry, for errors.

    Raises:
        SceneError: for a file that is no mesh.
    """
    key = file.key("surface of a mesh file")
    kept = find_surface(key) if key is not None else None
    if kept is not None:
        return kept
    vertices, faces = surface_of(file.read_for(name), file.path, np.array(file.scale))
    found = Surface(vertices.astype(np.float32), faces.astype(np.uint32))
    if key is not None and (Path(file.path).suffix.lower() == ".stl" or not unused_vertices(vertices, faces)):
        cache.keep(key, found)
    return found


def find_surface(name: str) -> Surface | None:
    """Return the surface of an entry of the cache; None where there is none, or one that is not a surface."""
    arrays = cache.find(name)
    if arrays is None or [array.dtype.name for array in arrays] != ["float32", "uint32"]:
        return None
    vertices, faces = arrays
    if any(array.ndim != 2 or array.shape[1] != 3 for array in arrays):
        return None
    found = Surface(vertices.astype(np.float32, copy=False), faces.astype(np.uint32, copy=False))
    return found if not len(faces) or int(faces.max()) < len(vertices) else None


def _mesh_of_file(geometry: pin.GeometryObject) -> coal.BVHModelBase:
    try:
        return coal.MeshLoader(coal.BV_OBBRSS).load(geometry.meshPath, np.array(geometry.meshScale))
    except OSError as error:  # it was there when the surface was read
        raise unreadable(Path(geometry.meshPath), error) from error
    except (ValueError, RuntimeError) as error:
        raise mesh_error(geometry.meshPath, error, geometry.name) from error


def _mesh_of(surface: Surface) -> coal.BVHModelBase:
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(surface.faces), len(surface.vertices))
    mesh.addVertices(surface.vertices.astype(float))
    mesh.addTriangles(surface.faces.astype(np.int64))
    mesh.endModel()
    return mesh
