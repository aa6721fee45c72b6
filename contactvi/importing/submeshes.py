"""Meshes of files that consist of several, mended: coal's reader gives them torn.

Its numbers of the vertices of a face count from the start of a mesh within the file, as those of the importer below it
do, where they should count from the start of all vertices: the faces of the second material are drawn between vertices
of the first, and vertices at the end are in no face. The vertices themselves are right, and so are hulls. Such a mesh
is read again piece by piece, each in a file that has no other: an OBJ without its groups and materials, a COLLADA file
with one primitive of one instance.
"""

from __future__ import annotations

import copy
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
from numpy.typing import NDArray

from contactvi.errors import TornMeshWarning
from contactvi.importing.hulls import faces_of_mesh

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

_PRIMITIVES = ("triangles", "polylist", "polygons", "tristrips", "trifans")
_GROUPS = ("o", "g", "s", "usemtl", "mtllib")  # what divides an OBJ


def surface_of(mesh: coal.BVHModelBase, path: str, scale: Array) -> tuple[Array, Faces]:
    """Return vertices (n, 3) and faces (m, 3) of a mesh that coal has read from a file, mended where it is torn.

    Args:
        path: of the file, "" where there is none. scale: factors of its coordinates, (3,).

    Warns (TornMeshWarning) of a torn mesh that stays so.
    """
    vertices, faces = arrays_of(mesh)
    unused = unused_vertices(vertices, faces)
    if not unused or Path(path).suffix.lower() not in (".dae", ".obj"):
        return vertices, faces
    try:
        pieces = [arrays_of(piece) for piece in _pieces(Path(path), scale)]
    except (OSError, ValueError, RuntimeError, StopIteration, ElementTree.ParseError):
        pieces = []
    if pieces:
        starts = np.cumsum([0, *(len(points) for points, _ in pieces[:-1])])
        found = np.concatenate([points for points, _ in pieces])
        joined = np.concatenate([own + start for (_, own), start in zip(pieces, starts, strict=True)])
        # Groups of an OBJ share vertices once they are one.
        same = len(joined) == len(faces) and np.array_equal(np.unique(found, axis=0), np.unique(vertices, axis=0))
        if same and unused_vertices(found, joined) < unused:
            return found, joined
    warnings.warn(
        f"{Path(path).name} is drawn torn: {unused} of {len(vertices)} vertices are in no face. It consists of several"
        " meshes, which are not told apart; write it as one mesh, without materials",
        TornMeshWarning, stacklevel=2,
    )  # fmt: skip
    return vertices, faces


def volume_of(mesh: coal.BVHModelBase, path: str, scale: Array) -> float:
    """Return the volume of a mesh from a file [m^3], that of the mended one; see `surface_of`."""
    # An STL has no numbers of vertices: each of them is the corner of a triangle.
    if Path(path).suffix.lower() == ".stl" or not unused_vertices(*arrays_of(mesh)):
        return float(mesh.computeVolume())
    vertices, faces = surface_of(mesh, path, scale)
    return volume_inside(vertices, faces)


def volume_inside(vertices: NDArray[Any], faces: NDArray[Any]) -> float:
    """Return the volume inside of a closed surface [m^3]."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def unused_vertices(vertices: Array, faces: Faces) -> int:
    """Return how many vertices are in no face."""
    return len(vertices) - int(np.count_nonzero(np.bincount(faces.ravel())))


def arrays_of(mesh: coal.BVHModelBase) -> tuple[Array, Faces]:
    """Return vertices (n, 3) and faces (m, 3) of a mesh of coal."""
    return np.array(mesh.vertices(), dtype=float).reshape(-1, 3), faces_of_mesh(mesh)


def _pieces(path: Path, scale: Array) -> Iterator[coal.BVHModelBase]:
    """Yield the meshes of a file, one by one; raises what coal and the reader of XML raise."""
    texts = _of_obj(path) if path.suffix.lower() == ".obj" else _of_collada(path)
    with tempfile.TemporaryDirectory(prefix="contactvi-") as folder:
        for text in texts:
            piece = Path(folder) / f"piece{path.suffix.lower()}"
            piece.write_bytes(text)
            yield coal.MeshLoader(coal.BV_AABB).load(str(piece), np.asarray(scale, dtype=float))


def _of_obj(path: Path) -> Iterator[bytes]:
    lines = path.read_bytes().splitlines(keepends=True)
    words = tuple(word.encode() for word in _GROUPS)
    yield b"".join(line for line in lines if line.split(None, 1)[:1] not in [[word] for word in words])


def _of_collada(path: Path) -> Iterator[bytes]:
    """Yield a COLLADA file for each primitive of each instance of a geometry, in the order of the file."""
    root = ElementTree.parse(path).getroot()
    space = root.tag.partition("}")[0] + "}" if root.tag.startswith("{") else ""
    if space:
        ElementTree.register_namespace("", space.strip("{}"))
    instances = list(root.iter(f"{space}instance_geometry"))
    for k, instance in enumerate(instances):
        wanted = (instance.get("url") or "").removeprefix("#")
        geometry = next(g for g in root.iter(f"{space}geometry") if g.get("id") == wanted)
        count = sum(1 for part in geometry.iter() if part.tag.removeprefix(space) in _PRIMITIVES)
        for chosen in range(count):
            yield ElementTree.tostring(_alone(copy.deepcopy(root), space, k, wanted, chosen))


def _alone(root: ElementTree.Element, space: str, instance: int, geometry: str, primitive: int) -> ElementTree.Element:
    """Return a document with one instance of one geometry alone, of which it keeps one primitive."""
    instances = list(root.iter(f"{space}instance_geometry"))
    primitives = [part for g in root.iter(f"{space}geometry") if g.get("id") == geometry
                  for part in g.iter() if part.tag.removeprefix(space) in _PRIMITIVES]  # fmt: skip
    others = [g for g in root.iter(f"{space}geometry") if g.get("id") != geometry]
    gone = {id(part) for part in (*instances[:instance], *instances[instance + 1 :], *others)}
    gone |= {id(part) for k, part in enumerate(primitives) if k != primitive}
    for parent in list(root.iter()):
        for child in list(parent):
            if id(child) in gone:
                parent.remove(child)
    return root
