"""Bodies made of a mesh: its convex hull, or convex pieces by CoACD, with mass and inertia of what is simulated.

CoACD: Wei, Liu, Ling, Su, "Approximate convex decomposition for 3D meshes with collision-aware concavity and tree
search", ACM Transactions on Graphics 41 (2022). It is asked with a fixed seed, so that equal meshes have equal pieces.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi import cache
from contactvi.errors import InputError, SceneError
from contactvi.importing.hulls import crowded_text, faces_of, hull_of_points
from contactvi.importing.mesh_hulls import MeshFile, MeshHulls
from contactvi.importing.paths import mesh_error, resolve_path, unreadable
from contactvi.importing.submeshes import surface_of
from contactvi.inputs import real, real_numbers, short

Array = NDArray[np.float64]

CONCAVITY = 0.05  # CoACD's own default: largest concavity of a piece, of the mesh scaled to a cube of edge 2


class MeshSource(NamedTuple):
    """A mesh as the user gives it: a file, or vertices (n, 3) [m], perhaps with triangles (m, 3)."""

    file: MeshFile | None
    vertices: Array | None
    faces: NDArray[np.int64] | None

    def arrays(self, name: str) -> tuple[Array, NDArray[np.int64]]:
        """Return vertices and triangles. Raises InputError for points without triangles, SceneError for a bad file."""
        if self.file is not None:
            return surface_of(_read(self.file), self.file.path, np.array(self.file.scale))
        if self.faces is None or self.vertices is None:
            raise InputError(
                f"The mesh of {name!r} has no faces", name="mesh", expected="a closed surface to be decomposed",
                got="points", remedy="Give (vertices, faces), faces of shape (m, 3), or a file; or decompose=False",
            )  # fmt: skip
        return self.vertices, self.faces


def mesh_source(name: str, mesh: Any, scale: Any, folder: Path | None = None) -> MeshSource:
    """Return a checked mesh; arguments as in Scene.add_mesh, a relative path is relative to `folder`."""
    factors = _scale(name, scale)
    if isinstance(mesh, (str, os.PathLike)):
        x, y, z = factors.tolist()
        return MeshSource(MeshFile(str(resolve_path(mesh, folder)), (x, y, z)), None, None)
    if isinstance(mesh, tuple) and len(mesh) == 2:
        points, faces = real_numbers(mesh[0]), real_numbers(mesh[1])
    else:
        points, faces = real_numbers(mesh), None
    if points is None or points.ndim != 2 or points.shape[1] != 3:
        raise InputError(
            f"The mesh of {name!r} is not usable", name="mesh", got=short(mesh),
            expected="a path, vertices (n, 3), or (vertices, faces)",
            remedy="Give the path of an STL, OBJ, PLY or DAE file, or points in rows of three numbers",
        )  # fmt: skip
    return MeshSource(None, points * factors, None if faces is None else _faces(name, faces, len(points)))


def mesh_shapes(name: str, source: MeshSource, decompose: Any) -> tuple[list[coal.Convex], str]:
    """Return the convex shapes of a mesh and what was done to it.

    Args:
        decompose: False, True, or the largest concavity of a piece.

    Raises:
        SceneError: a mesh without a hull; CoACD is not installed.
    """
    if decompose is False:
        if source.file is not None:
            return _hull_of_file(name, source.file)
        assert source.vertices is not None
        hull = hull_of_points(source.vertices, name)
        return [hull], f"{len(source.vertices)} vertices -> {_text(hull)}"
    concavity = CONCAVITY
    if decompose is not True:
        words = "True, False, or the largest concavity of a piece in [0.01, 1]"
        concavity = real(f"decompose of {name!r}", decompose, 0.01, 1.0, expected=words)
    vertices, faces = source.arrays(name)
    pieces = [
        hull_of_points(points, f"{name}, piece {k}") for k, points in enumerate(_pieces(vertices, faces, concavity))
    ]
    return pieces, f"mesh of {len(vertices)} vertices -> {len(pieces)} convex pieces"


def solid_inertia(name: str, hulls: Sequence[coal.Convex], mass: Any, density: Any) -> pin.Inertia:
    """Return the inertia of solid hulls of one density; mass [kg] of all, or density [kg/m^3], or neither: 1 kg."""
    return _of_solids(name, [_solid(np.array(hull.points()), faces_of(hull)) for hull in hulls], mass, density)


def _of_solids(name: str, solids: Sequence[pin.Inertia], mass: Any, density: Any) -> pin.Inertia:
    if mass is not None and density is not None:
        raise InputError(
            f"{name!r} has a mass and a density", name="density", expected="one of them", got="both",
            remedy="Leave mass or density out",
        )  # fmt: skip
    volume = sum(solid.mass for solid in solids)
    if density is not None:
        factor = real(f"density of {name!r}", density, 0.0, open_low=True)
    else:
        factor = real(f"mass of {name!r}", 1.0 if mass is None else mass, 0.0, open_low=True) / volume
    total = pin.Inertia.Zero()
    for solid in solids:
        total += pin.Inertia(factor * solid.mass, solid.lever, factor * solid.inertia)
    return total


def mesh_inertia(name: str, vertices: Array, faces: NDArray[np.int64], mass: Any, density: Any) -> pin.Inertia:
    """Return the inertia of a closed mesh with outward triangles; mass and density as in `solid_inertia`."""
    return _of_solids(name, [_solid(vertices, faces)], mass, density)


def _solid(vertices: Array, faces: NDArray[np.int64]) -> pin.Inertia:
    """Return the inertia of a closed surface with outward triangles, filled with a density of 1 kg/m^3.

    It is the sum of the tetrahedra between the triangles and a point inside, which keeps its digits far from the
    origin: of a tetrahedron (0, a, b, c) with six times the volume d, the integral of x x^T is
    d (a a^T + b b^T + c c^T + s s^T) / 120, s = a + b + c.
    """
    inside = vertices.mean(axis=0)
    a, b, c = (vertices[faces[:, k]] - inside for k in range(3))
    d = np.einsum("ij,ij->i", a, np.cross(b, c))
    volume = d.sum() / 6.0
    s = a + b + c
    lever = d @ s / (24.0 * volume)
    second = sum(np.einsum("i,ij,ik->jk", d, x, x) for x in (a, b, c, s)) / 120.0
    second = second - volume * np.outer(lever, lever)
    return pin.Inertia(float(volume), inside + lever, np.trace(second) * np.eye(3) - second)


def _hull_of_file(name: str, file: MeshFile) -> tuple[list[coal.Convex], str]:
    """Return the hull of a file, from the cache on disk where it is there."""
    geometry = pin.GeometryObject(name, 0, pin.SE3.Identity(), coal.Sphere(1.0))
    hulls = MeshHulls()
    _checked(file, lambda: hulls.take(geometry, file))
    found = hulls.of(geometry)
    assert found is not None
    return [found.shape], f"mesh of {found.count} vertices -> {_text(found.shape)}"


def _text(hull: coal.Convex) -> str:
    return ", ".join(filter(None, (f"hull of {hull.num_points}", crowded_text(hull))))


def _read(file: MeshFile) -> coal.BVHModelBase:
    found: list[coal.BVHModelBase] = []
    _checked(file, lambda: found.append(file.read()))
    return found[0]


def _checked(file: MeshFile, read: Any) -> None:
    try:
        read()
    except (ValueError, RuntimeError) as error:  # of coal's reader
        raise mesh_error(file.path, error, "") from error
    except OSError as error:
        raise unreadable(Path(file.path), error) from error


# In a process of its own: CoACD ends the process on some meshes.
_DECOMPOSE = """
import sys
import coacd
import numpy as np

mesh = np.load(sys.argv[1])
coacd.set_log_level("error")
made = coacd.run_coacd(coacd.Mesh(mesh["vertices"], mesh["faces"]), threshold=float(mesh["concavity"]), seed=0)
np.savez(sys.argv[2], *[points for points, _ in made])
"""


def _pieces(vertices: Array, faces: NDArray[np.int64], concavity: float) -> list[Array]:
    """Return the vertices of the pieces of a closed surface, from the cache on disk where they are there."""
    key = cache.key("pieces of a mesh", vertices.tobytes(), faces.tobytes(), concavity)
    if found := cache.find(key):
        return [np.array(points, dtype=float) for points in found]
    if importlib.util.find_spec("coacd") is None:
        raise SceneError(
            "Meshes are decomposed by CoACD, which is not installed", expected="the package coacd", got="none",
            remedy='pip install "contactvi[decompose]", or use decompose=False, the hull',
        )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        mesh, result = Path(folder) / "mesh.npz", Path(folder) / "pieces.npz"
        np.savez(mesh, vertices=vertices, faces=faces.astype(np.int32), concavity=concavity)
        done = subprocess.run(
            [sys.executable, "-c", _DECOMPOSE, str(mesh), str(result)], capture_output=True, text=True, check=False
        )
        if done.returncode != 0 or not result.exists():
            why = (done.stderr.strip().splitlines() or [f"it ended with {done.returncode}"])[-1]
            raise SceneError(
                "CoACD did not decompose a mesh", expected="a closed surface that it takes", got=short(why),
                remedy="Join vertices at one place and take out triangles without an area, or use decompose=False, "
                'the hull, or shape="field"',
            )  # fmt: skip
        with np.load(result) as made:
            pieces = [np.array(made[name], dtype=float) for name in made.files]
    cache.keep(key, pieces)
    return pieces


def _scale(name: str, scale: Any) -> Array:
    factors = real_numbers(scale)
    if factors is not None and factors.shape in ((), (3,)) and np.all(np.isfinite(factors)) and np.all(factors != 0.0):
        return np.broadcast_to(factors, (3,)).copy()
    raise InputError(
        f"scale of {name!r} is not usable", name="scale", expected="a number, or three of them, none 0",
        got=short(scale), remedy="Use scale=0.001 for a mesh in millimetres",
    )  # fmt: skip


def _faces(name: str, faces: Array, count: int) -> NDArray[np.int64]:
    whole = faces.ndim == 2 and faces.shape[1] == 3 and np.array_equal(faces, np.round(faces))
    if whole and len(faces) and faces.min() >= 0 and faces.max() < count:
        return faces.astype(np.int64)
    raise InputError(
        f"The faces of {name!r} are not usable", name="mesh", got=short(faces),
        expected=f"rows of three numbers of vertices below {count}",
        remedy="Give triangles, shape (m, 3), counting vertices from 0",
    )  # fmt: skip
