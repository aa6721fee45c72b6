"""The shapes of a URDF; those that Pinocchio's reader of geometry does not know, or takes too long for, are read here.

Pinocchio's reader makes a tree of oriented boxes over the triangles of each mesh, which takes longer than the rest of
the import and is never used: a mesh is soon replaced by its hull, or drawn. So the reader gets a sphere in the place of
each mesh, and the mesh is read with the quickest tree, once for all links that use it, where its hull or its surface is
not in the cache. It drops capsules and ellipsoids; these are spheres to it as well.
"""

from __future__ import annotations

from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from contactvi.importing.mesh_hulls import MeshFile, MeshHulls
from contactvi.importing.pictures import Picture, Surface, surface_of_file
from contactvi.importing.xml import Element, parsed

_REPLACED = ("mesh", "capsule", "drake:ellipsoid")


def collision_geometry(model: pin.Model, xml: str, hulls: MeshHulls) -> pin.GeometryModel:
    """Return the collision shapes of a URDF that read_urdf has checked; raises what Pinocchio raises.

    Args:
        hulls: gives the shapes of mesh files.
    """
    geometry, replaced = _read(model, xml, "collision")
    for item, element in zip(geometry.geometryObjects, replaced, strict=True):
        if element is None:
            continue
        if element.tag == "mesh":
            hulls.take(item, _file_of(element))
        else:
            item.geometry = _solid_of(element)
    return geometry


def pictures_of_urdf(model: pin.Model, xml: str) -> list[Picture]:
    """Return the pictures of a URDF that read_urdf has checked; raises what Pinocchio raises.

    Raises:
        SceneError: for a file that is no mesh.
    """
    geometry, replaced = _read(model, xml, "visual")
    surfaces: dict[MeshFile, Surface] = {}
    pictures = []
    for item, element in zip(geometry.geometryObjects, replaced, strict=True):
        surface = None
        if element is not None and element.tag == "mesh":
            file = _file_of(element)
            item.meshPath, item.meshScale = file.path, np.array(file.scale)
            if file not in surfaces:
                surfaces[file] = surface_of_file(file, item.name)
            surface = surfaces[file]
        elif element is not None:
            item.geometry = _solid_of(element)
        pictures.append(Picture(item, surface))
    return pictures


def without_shapes(xml: str) -> str:
    """Return a URDF without shapes, of which Pinocchio's reader makes the same model, and says nothing on stderr."""
    root = parsed(xml)
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    return ElementTree.tostring(root, encoding="unicode")


def _read(model: pin.Model, xml: str, role: str) -> tuple[pin.GeometryModel, list[Element | None]]:
    """Return the shapes of a URDF, and for each the element in whose place it has a sphere; None where it is right.

    Args:
        role: "collision" or "visual".
    """
    root = parsed(xml)
    found: list[Element] = []
    for holder in root.findall(f"link/{role}/geometry"):
        if (element := next(iter(holder), None)) is not None and element.tag in _REPLACED:
            # A radius that no sphere of a checked file has.
            holder[0] = ElementTree.Element("sphere", radius=str(-1 - len(found)))
            found.append(element)
    kind = pin.GeometryType.COLLISION if role == "collision" else pin.GeometryType.VISUAL
    geometry = pin.GeometryModel()  # that which Pinocchio makes itself is never freed
    pin.buildGeomFromUrdfString(model, ElementTree.tostring(root, encoding="unicode"), kind, geometry)
    shapes = [item.geometry for item in geometry.geometryObjects]
    replaced = [isinstance(shape, coal.Sphere) and shape.radius < 0.0 for shape in shapes]
    return geometry, [
        found[round(-shape.radius) - 1] if was else None for shape, was in zip(shapes, replaced, strict=True)
    ]


def _file_of(mesh: Element) -> MeshFile:
    """Return the file of a <mesh>."""
    x, y, z = (float(factor) for factor in (mesh.get("scale") or "1 1 1").split())
    return MeshFile(mesh.get("filename", ""), (x, y, z))


def _solid_of(element: Element) -> coal.CollisionGeometry:
    """Return coal's capsule or ellipsoid."""
    if element.tag == "capsule":
        return coal.Capsule(float(element.get("radius", "")), float(element.get("length", "")))
    return coal.Ellipsoid(*(float(element.get(key, "")) for key in ("a", "b", "c")))
