"""Hulls of mesh files, which are made in other threads while the next files are read."""

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from contactvi.errors import SceneError
from contactvi.importing.hulls import faces_of, hull_of_points
from contactvi.importing.mesh_hulls import MeshFile, MeshHulls
from helpers.touching_pairs import random_hull


def write(path: Path, points: np.ndarray) -> MeshFile:
    """Write points as the corners of triangles."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    lines += [f"f {k} {k + 1} {k + 2}" for k in range(1, len(points) - 1)]
    path.write_text("\n".join(lines) + "\n")
    return MeshFile(str(path), (1.0, 1.0, 1.0))


def geometry_of(name: str) -> pin.GeometryObject:
    return pin.GeometryObject(name, 0, pin.SE3.Identity(), coal.Sphere(1.0))


@pytest.fixture(autouse=True)
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CONTACTVI_CACHE", str(tmp_path / "cache"))


def test_each_file_has_its_own_hull(tmp_path: Path):
    files = [write(tmp_path / f"{k}.obj", random_hull(np.random.default_rng(k), 40 + k)) for k in range(12)]
    hulls, geometries = MeshHulls(), [geometry_of(f"link {k}") for k in range(12)]
    for geometry, file in zip(geometries, files, strict=True):
        hulls.take(geometry, file)
    for geometry, file in zip(geometries, files, strict=True):
        found, wanted = hulls.of(geometry), hull_of_points(file.read().vertices(), "again")
        assert found is not None
        assert found.count == file.read().num_vertices
        np.testing.assert_array_equal(found.shape.points(), wanted.points())
        np.testing.assert_array_equal(faces_of(found.shape), faces_of(wanted))
    again = MeshHulls()
    for geometry, file in zip(geometries, files, strict=True):
        again.take(geometry, file)  # from the cache
        np.testing.assert_array_equal(geometry.geometry.points(), hulls.of(geometry).shape.points())


def test_a_mesh_without_a_hull_is_an_error_of_its_geometry(tmp_path: Path):
    flat = np.random.default_rng(0).random((9, 3)) * [1.0, 1.0, 0.0]
    good, bad = write(tmp_path / "good.obj", flat + np.eye(9, 3)), write(tmp_path / "bad.obj", flat)
    hulls, geometries = MeshHulls(), [geometry_of("upper"), geometry_of("lower")]
    hulls.take(geometries[0], bad)
    hulls.take(geometries[1], good)
    assert hulls.of(geometries[1]) is not None, "an error waits until its hull is asked for"
    for _ in range(2):
        with pytest.raises(SceneError, match=r"upper \(bad.obj\)"):
            hulls.of(geometries[0])
