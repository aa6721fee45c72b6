"""The collision meshes of a URDF, read here and not by Pinocchio's reader of geometry.

Pinocchio's reader makes a tree of oriented boxes over the triangles of each mesh, which takes longer than the rest of
the import and is never used: a mesh is soon replaced by its hull. So the reader gets a sphere in the place of each
mesh, and the mesh is read with the quickest tree, once for all links that use it, where its hull is not in the cache.
"""

from __future__ import annotations

from xml.etree import ElementTree

import coal
import pinocchio as pin

from contactvi.importing.mesh_hulls import MeshFile, MeshHulls


def collision_geometry(model: pin.Model, xml: str, hulls: MeshHulls) -> pin.GeometryModel:
    """Return the collision shapes of a URDF that read_urdf has checked; raises what Pinocchio and coal raise.

    Args:
        hulls: gives the shapes of mesh files.
    """
    root = ElementTree.fromstring(xml)
    files = [_take_mesh(shape, holder, k) for k, (shape, holder) in enumerate(_meshes(root))]
    geometry = pin.GeometryModel()  # that which Pinocchio makes itself is never freed
    text = ElementTree.tostring(root, encoding="unicode")
    pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION, geometry)
    for item in geometry.geometryObjects:
        shape = item.geometry
        if isinstance(shape, coal.Sphere) and shape.radius < 0.0:
            hulls.take(item, files[round(-shape.radius) - 1])
    return geometry


def visual_geometry(model: pin.Model, xml: str) -> pin.GeometryModel:
    """Return the pictures of a URDF; raises what Pinocchio raises."""
    geometry = pin.GeometryModel()
    pin.buildGeomFromUrdfString(model, xml, pin.GeometryType.VISUAL, geometry)
    return geometry


def _meshes(root: ElementTree.Element) -> list[tuple[ElementTree.Element, ElementTree.Element]]:
    """Return the <mesh> elements of collisions, each with the element that holds it."""
    holders = root.findall("link/collision/geometry")
    return [(mesh, holder) for holder in holders if (mesh := holder.find("mesh")) is not None]


def _take_mesh(mesh: ElementTree.Element, holder: ElementTree.Element, index: int) -> MeshFile:
    """Put a sphere in the place of a mesh; its radius -1 - index is none of a sphere in a checked file."""
    holder[list(holder).index(mesh)] = ElementTree.Element("sphere", radius=str(-1 - index))
    x, y, z = (float(factor) for factor in (mesh.get("scale") or "1 1 1").split())
    return MeshFile(mesh.get("filename", ""), (x, y, z))
