"""The convex hulls of meshes; those that an earlier process has made come from the cache on disk.

A file whose hull is in the cache is not read as a mesh at all. A file has one hull, whatever number of geometries it
has.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import coal
import numpy as np
import pinocchio as pin

from contactvi import cache
from contactvi.importing.hulls import check_shape, crowded_text, faces_by_engine, hull_by_engine, hull_of_points
from contactvi.importing.kept_hulls import KeptHull, find_hull, keep_hull
from contactvi.importing.paths import mesh_error
from contactvi.importing.report import PartReport, number
from contactvi.importing.submeshes import volume_of

if TYPE_CHECKING:
    from concurrent.futures import Future, ThreadPoolExecutor

SELF_CONTAINED = (".stl", ".obj", ".ply", ".dae")  # formats whose vertices stand in the file itself


@dataclass(frozen=True)
class MeshFile:
    """A mesh file and the factors (x, y, z) of its coordinates."""

    path: str
    scale: tuple[float, float, float]

    def read(self) -> coal.BVHModelBase:
        """Return the mesh; its numbers are those that Pinocchio's reader finds. Raises what coal raises."""
        return coal.MeshLoader(coal.BV_AABB).load(self.path, np.array(self.scale))

    def key(self) -> str | None:
        """Return the name of its hull in the cache; None where the file does not tell all."""
        path = Path(self.path)
        if path.suffix.lower() not in SELF_CONTAINED:
            return None
        try:
            return cache.key("hull of a mesh file", path.suffix.lower(), path.read_bytes(), *self.scale)
        except OSError:
            return None  # its reader says what is wrong


@dataclass(frozen=True)
class MeshHull:
    """The hull of a mesh.

    Attributes:
        shape: the hull.
        count: number of vertices of the mesh. volume: of the mesh [m^3], which means nothing for an open surface.
    """

    shape: coal.Convex
    count: int
    volume: float

    @staticmethod
    def found(name: str) -> MeshHull | None:
        """Return the hull in the cache."""
        kept = find_hull(name)
        if kept is None or kept.numbers.shape != (2,):
            return None
        count, volume = kept.numbers.tolist()
        return MeshHull(hull_by_engine(kept.vertices, kept.faces), int(count), volume)

    def keep(self, name: str) -> None:
        """Write it into the cache."""
        numbers = np.array([self.count, self.volume])
        keep_hull(name, KeptHull(np.array(self.shape.points()), faces_by_engine(self.shape), numbers))


class MeshHulls:
    """The hulls of the meshes of one model."""

    def __init__(self) -> None:
        self._files: dict[str, MeshFile] = {}  # of geometries, by their names
        self._keys: dict[MeshFile, str | None] = {}
        self._hulls: dict[MeshFile, MeshHull] = {}
        self._meshes: dict[MeshFile, coal.BVHModelBase] = {}
        self._made: dict[MeshFile, Future[coal.Convex]] = {}
        self._maker: ThreadPoolExecutor | None = None

    def take(self, geometry: pin.GeometryObject, file: MeshFile) -> None:
        """Give a geometry the hull of a file, where the cache has it, else its mesh.

        The hull of the mesh is made in a thread of its own, while the next files are read.

        Raises:
            SceneError: for a file that is no mesh.
        """
        if file not in self._keys:
            key = self._keys[file] = file.key()
            hull = MeshHull.found(key) if key is not None else None
            if hull is not None:
                self._hulls[file] = hull
            else:
                mesh = self._meshes[file] = self._read(file, geometry.name)
                self._made[file] = self._start(mesh, f"{geometry.name} ({Path(file.path).name})")
        self._files[geometry.name] = file
        geometry.geometry = self._hulls[file].shape if file in self._hulls else self._meshes[file]
        geometry.meshPath, geometry.meshScale = file.path, np.array(file.scale)

    def of(self, geometry: pin.GeometryObject) -> MeshHull | None:
        """Return the hull of a geometry with a mesh; None for another shape.

        Raises:
            SceneError: for a mesh without one.
        """
        file = self._files.get(geometry.name)
        if file is not None and file in self._hulls:
            return self._hulls[file]
        mesh = geometry.geometry
        if not isinstance(mesh, coal.BVHModelBase):
            return None
        if file is None:
            return _hull_of(mesh, geometry.name)
        shape = self._made[file].result()
        volume = volume_of(mesh, file.path, np.array(file.scale))
        hull = self._hulls[file] = MeshHull(shape, int(mesh.num_vertices), volume)
        if (key := self._keys[file]) is not None:
            hull.keep(key)
        return hull

    @staticmethod
    def _read(file: MeshFile, name: str) -> coal.BVHModelBase:
        try:
            return file.read()
        except (ValueError, RuntimeError) as error:
            raise mesh_error(file.path, error, name) from error

    def _start(self, mesh: coal.BVHModelBase, name: str) -> Future[coal.Convex]:
        """Start making a hull."""
        if self._maker is None:
            from concurrent.futures import ThreadPoolExecutor  # here: it takes time to import

            self._maker = ThreadPoolExecutor(1)
        return self._maker.submit(hull_of_points, mesh.vertices(), name)


def prepare_geometry(geometry: pin.GeometryObject, report: PartReport, hulls: MeshHulls) -> str:
    """Put a usable shape into a collision geometry and return what was done to it ("" = nothing).

    Raises:
        SceneError: a shape the engine cannot use, or a size that is not positive and finite.
    """
    hull = hulls.of(geometry)
    if hull is None:
        return check_shape(geometry)
    volume, filled = hull.shape.computeVolume(), abs(hull.volume)  # It is negative for a mirrored mesh.
    geometry.geometry = hull.shape
    # The volume of an open or badly oriented surface means nothing, and then there is no ratio.
    ratio = volume / filled if 0.0 < filled <= volume * (1.0 + 1e-9) else np.nan
    text = f"mesh of {hull.count} vertices -> hull of {hull.shape.num_points}"
    if np.isfinite(ratio):
        text += f", volume x {number(ratio)}"
    if crowded := crowded_text(hull.shape):
        text += f", {crowded}"
    report.note("changed", "mesh", geometry.name, "replaced by its convex hull")
    if np.isfinite(ratio) and ratio > 2.0:
        report.note("suspicious", "mesh", geometry.name, "the hull has more than twice the volume of the mesh")
    return text


def _hull_of(mesh: coal.BVHModelBase, name: str) -> MeshHull:
    """Return the hull of a mesh that is of no file; its triangles show in the volume alone."""
    volume = float(mesh.computeVolume())
    key = cache.key("hull of a mesh", np.array(mesh.vertices()).tobytes(), volume)
    if (found := MeshHull.found(key)) is not None:
        return found
    made = MeshHull(hull_of_points(mesh.vertices(), name), int(mesh.num_vertices), volume)
    made.keep(key)
    return made
