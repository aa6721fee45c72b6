"""The meshes of a URDF, read here and not by Pinocchio's reader of geometry.

Pinocchio's reader makes a tree of oriented boxes over the triangles of each mesh, which takes longer than the rest of
the import and is never used: a mesh is soon replaced by its hull, or drawn. So the reader gets a sphere in the place of
each mesh, and the mesh is read with the quickest tree, once for all links that use it, where its hull or its surface is
not in the cache.
"""

from __future__ import annotations

from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from contactvi.importing.mesh_hulls import MeshFile, MeshHulls
from contactvi.importing.pictures import Picture, Surface, surface_of_file


def collision_geometry(model: pin.Model, xml: str, hulls: MeshHulls) -> pin.GeometryModel:
    """Return the collision shapes of a URDF that read_urdf has checked; raises what Pinocchio and coal raise.

    Args:
        hulls: gives the shapes of mesh files.
    """
    geometry, files = _without_meshes(model, xml, pin.GeometryType.COLLISION)
    for item in geometry.geometryObjects:
        if (file := _file_of(item, files)) is not None:
            hulls.take(item, file)
    return geometry


def pictures_of_urdf(model: pin.Model, xml: str) -> list[Picture]:
    """Return the pictures of a URDF that read_urdf has checked; raises what Pinocchio and coal raise."""
    geometry, files = _without_meshes(model, xml, pin.GeometryType.VISUAL)
    surfaces: dict[MeshFile, Surface] = {}
    pictures = []
    for item in geometry.geometryObjects:
        file = _file_of(item, files)
        if file is not None:
            item.meshPath, item.meshScale = file.path, np.array(file.scale)
            if file not in surfaces:
                surfaces[file] = surface_of_file(file)
        pictures.append(Picture(item, None if file is None else surfaces[file]))
    return pictures


def _without_meshes(model: pin.Model, xml: str, kind: pin.GeometryType) -> tuple[pin.GeometryModel, list[MeshFile]]:
    """Return the shapes of a URDF with a sphere in the place of each mesh, and the files of the meshes."""
    root = ElementTree.fromstring(xml)
    files = [_take_mesh(shape, holder, k) for k, (shape, holder) in enumerate(_meshes(root, kind))]
    geometry = pin.GeometryModel()  # that which Pinocchio makes itself is never freed
    pin.buildGeomFromUrdfString(model, ElementTree.tostring(root, encoding="unicode"), kind, geometry)
    return geometry, files


def _file_of(geometry: pin.GeometryObject, files: list[MeshFile]) -> MeshFile | None:
    """Return the file of the mesh that a geometry should have; None for another shape."""
    shape = geometry.geometry
    return files[round(-shape.radius) - 1] if isinstance(shape, coal.Sphere) and shape.radius < 0.0 else None


def _meshes(root: ElementTree.Element, kind: pin.GeometryType) -> list[tuple[ElementTree.Element, ElementTree.Element]]:
    """Return the <mesh> elements of collisions or pictures, each with the element that holds it."""
    holders = root.findall(f"link/{'visual' if kind == pin.GeometryType.VISUAL else 'collision'}/geometry")
    return [(mesh, holder) for holder in holders if (mesh := holder.find("mesh")) is not None]


def _take_mesh(mesh: ElementTree.Element, holder: ElementTree.Element, index: int) -> MeshFile:
    """Put a sphere in the place of a mesh; its radius -1 - index is none of a sphere in a checked file."""
    holder[list(holder).index(mesh)] = ElementTree.Element("sphere", radius=str(-1 - index))
    x, y, z = (float(factor) for factor in (mesh.get("scale") or "1 1 1").split())
    return MeshFile(mesh.get("filename", ""), (x, y, z))
