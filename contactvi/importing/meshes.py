"""The shapes of a URDF, those that Pinocchio's reader of geometry does not know, or takes too long for, read here.

Pinocchio's reader makes a tree of oriented boxes over the triangles of each collision mesh, which takes longer than the
rest of the import and is never used: a mesh is soon replaced by its hull. So the reader gets a sphere in the place of
each mesh, and the mesh is read with the quickest tree, once for all links that use it, where its hull is not in the
cache. It drops capsules and ellipsoids; these are spheres to it as well, in pictures too.
"""

from __future__ import annotations

from xml.etree import ElementTree

import coal
import pinocchio as pin

from contactvi.importing.mesh_hulls import MeshFile, MeshHulls
from contactvi.importing.xml import Element, parsed

_OWN = ("capsule", "drake:ellipsoid")


def collision_geometry(model: pin.Model, xml: str, hulls: MeshHulls) -> pin.GeometryModel:
    """Return the collision shapes of a URDF that read_urdf has checked; raises what Pinocchio and coal raise.

    Args:
        hulls: gives the shapes of mesh files.
    """
    geometry, replaced = _read(model, xml, "collision", ("mesh", *_OWN))
    for item, shape in replaced:
        if shape.tag == "mesh":
            x, y, z = (float(factor) for factor in (shape.get("scale") or "1 1 1").split())
            hulls.take(item, MeshFile(shape.get("filename", ""), (x, y, z)))
        else:
            item.geometry = _made(shape)
    return geometry


def visual_geometry(model: pin.Model, xml: str) -> pin.GeometryModel:
    """Return the pictures of a URDF; raises what Pinocchio raises."""
    geometry, replaced = _read(model, xml, "visual", _OWN)
    for item, shape in replaced:
        item.geometry = _made(shape)
    return geometry


def without_shapes(xml: str) -> str:
    """Return a URDF without shapes, of which Pinocchio's reader makes the same model, and says nothing on stderr."""
    root = parsed(xml)
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    return ElementTree.tostring(root, encoding="unicode")


def _read(
    model: pin.Model, xml: str, role: str, tags: tuple[str, ...]
) -> tuple[pin.GeometryModel, list[tuple[pin.GeometryObject, Element]]]:
    """Return the shapes of a URDF, and those with one of these tags, which have a sphere in its place."""
    root = parsed(xml)
    found: list[Element] = []
    for holder in root.findall(f"link/{role}/geometry"):
        if (shape := next(iter(holder), None)) is not None and shape.tag in tags:
            # A radius that no sphere of a checked file has.
            holder[0] = ElementTree.Element("sphere", radius=str(-1 - len(found)))
            found.append(shape)
    kind = pin.GeometryType.COLLISION if role == "collision" else pin.GeometryType.VISUAL
    geometry = pin.GeometryModel()  # that which Pinocchio makes itself is never freed
    pin.buildGeomFromUrdfString(model, ElementTree.tostring(root, encoding="unicode"), kind, geometry)
    replaced = []
    for item in geometry.geometryObjects:
        if isinstance(item.geometry, coal.Sphere) and item.geometry.radius < 0.0:
            replaced.append((item, found[round(-item.geometry.radius) - 1]))
    return geometry, replaced


def _made(shape: Element) -> coal.CollisionGeometry:
    """Return coal's capsule or ellipsoid."""
    if shape.tag == "capsule":
        return coal.Capsule(float(shape.get("radius", "")), float(shape.get("length", "")))
    return coal.Ellipsoid(*(float(shape.get(key, "")) for key in ("a", "b", "c")))
