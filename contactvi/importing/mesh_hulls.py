"""The convex hulls of meshes; those that an earlier process has made come from the cache on disk.

A file whose hull is in the cache is not read as a mesh at all. A file has one hull, whatever number of geometries it
has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi import cache
from contactvi.importing.hulls import check_shape, crowded_text, faces_by_engine, hull_by_engine, hull_of_points
from contactvi.importing.kept_hulls import KeptHull, find_hull, keep_hull
from contactvi.importing.paths import mesh_error
from contactvi.importing.report import PartReport, number
from contactvi.importing.submeshes import Array, surface_of, volume_inside, volume_of

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

    def read_for(self, name: str) -> coal.BVHModelBase:
        """Return the mesh of a geometry with this name.

        Raises:
            SceneError: for a file that is no mesh.
        """
        try:
            return self.read()
        except (ValueError, RuntimeError) as error:
            raise mesh_error(self.path, error, name) from error

    def key(self, what: str = "hull of a mesh file") -> str | None:
        """Return the name of what is made of it in the cache; None where the file does not tell all."""
        path = Path(self.path)
        if path.suffix.lower() not in SELF_CONTAINED:
            return None
        try:
            return cache.key(what, path.suffix.lower(), path.read_bytes(), *self.scale)
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


class _Started(NamedTuple):
    """A hull that is being made: of so many vertices, with the name of its entry in the cache."""

    made: Future[coal.Convex]
    key: str | None
    vertices: int
    volume: Callable[[], float]

    def finish(self) -> MeshHull:
        """Wait for the hull and keep it; raises what making it raises."""
        hull = MeshHull(self.made.result(), self.vertices, self.volume())
        if self.key is not None:
            hull.keep(self.key)
        return hull


class GivenMesh(NamedTuple):
    """A mesh of a model: its name, or that of its file, and what returns its vertices (n, 3) and triangles (m, 3)."""

    name: str
    load: Callable[[], tuple[NDArray[Any], NDArray[Any]]]


class MeshHulls:
    """The hulls of the meshes of one model.

    A mesh is a file, or the name that its hull has in the cache.
    """

    def __init__(self) -> None:
        self._given: dict[str, GivenMesh] = {}  # of geometries, by their names
        self._sources: dict[str, MeshFile | str] = {}  # of geometries, by their names
        self._keys: dict[MeshFile, str | None] = {}
        self._hulls: dict[MeshFile | str, MeshHull] = {}
        self._meshes: dict[MeshFile, coal.BVHModelBase] = {}
        self._started: dict[MeshFile | str, _Started] = {}
        self._maker: ThreadPoolExecutor | None = None

    def take(self, geometry: pin.GeometryObject, file: MeshFile) -> None:
        """Give a geometry the hull of a file, where the cache has it, else its mesh.

        The hull of the mesh is made in another thread, while the next files are read.

        Raises:
            SceneError: for a file that is no mesh.
        """
        if file not in self._keys:
            key = self._keys[file] = file.key()
            hull = MeshHull.found(key) if key is not None else None
            if hull is not None:
                self._hulls[file] = hull
            else:
                mesh = self._meshes[file] = file.read_for(geometry.name)
                name = f"{geometry.name} ({Path(file.path).name})"
                self._start(file, key, mesh.vertices(), name, lambda: volume_of(mesh, file.path, np.array(file.scale)))
        self._sources[geometry.name], name = file, geometry.name
        self._given[name] = GivenMesh(
            Path(file.path).name, lambda: surface_of(file.read_for(name), file.path, np.array(file.scale))
        )
        geometry.geometry = self._hulls[file].shape if file in self._hulls else self._meshes[file]
        geometry.meshPath, geometry.meshScale = file.path, np.array(file.scale)

    def take_surface(
        self, geometry: pin.GeometryObject, vertices: NDArray[Any], faces: NDArray[Any], title: str = ""
    ) -> None:
        """Let a geometry have the hull of vertices (n, 3) [m] and triangles (m, 3), made as those of files are.

        title: name of the mesh.
        """
        self._given[geometry.name] = GivenMesh(title, lambda: (vertices, faces))
        points = np.ascontiguousarray(vertices, dtype=float)
        volume = volume_inside(points, faces)
        key = self._sources[geometry.name] = cache.key("hull of a mesh", points.tobytes(), volume)
        if key in self._hulls or key in self._started:
            return
        hull = MeshHull.found(key)
        if hull is not None:
            self._hulls[key] = hull
        else:
            self._start(key, key, points, geometry.name, lambda: volume)

    def mesh_of(self, name: str) -> GivenMesh | None:
        """Return the mesh of a geometry by its name; None for another shape."""
        return self._given.get(name)

    def drop(self, name: str) -> None:
        """Let a geometry have no hull: another shape has taken its place."""
        del self._sources[name], self._given[name]

    def of(self, geometry: pin.GeometryObject) -> MeshHull | None:
        """Return the hull of a geometry with a mesh; None for another shape.

        Raises:
            SceneError: for a mesh without one.
        """
        source = self._sources.get(geometry.name)
        if source is None:
            mesh = geometry.geometry
            return _hull_of(mesh, geometry.name) if isinstance(mesh, coal.BVHModelBase) else None
        if source not in self._hulls:
            self._hulls[source] = self._started[source].finish()
        return self._hulls[source]

    def _start(
        self, source: MeshFile | str, key: str | None, points: Array, name: str, volume: Callable[[], float]
    ) -> None:
        """Start making the hull of points (n, 3); name: for errors."""
        if self._maker is None:
            from concurrent.futures import ThreadPoolExecutor  # here: it takes time to import

            from contactvi.threads import cores

            self._maker = ThreadPoolExecutor(cores())
        self._started[source] = _Started(self._maker.submit(hull_of_points, points, name), key, len(points), volume)


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
