"""Meshes that are only drawn: plain arrays, of which coal makes nothing until somebody asks for its meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import coal
import numpy as np
import pytest

import contactvi as cvi
from contactvi import cache
from contactvi.importing.hulls import faces_of_mesh
from contactvi.importing.mesh_hulls import MeshFile
from contactvi.importing.pictures import find_surface, surface_of_file
from contactvi.importing.submeshes import arrays_of
from contactvi.playback import scene_visuals, visuals
from helpers.extras import mujoco_module

COUNT = 24  # points around a bumpy ball
URDF = """<robot name="r"><link name="l"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><origin xyz="0 0 .1"/><geometry><mesh filename="ball.stl" scale=".5 .5 .5"/></geometry></visual>
<visual><geometry><mesh filename="ball.obj"/></geometry><material name="red"><color rgba="1 0 0 1"/></material></visual>
<visual><geometry><box size="1 1 1"/></geometry></visual>
<collision><geometry><sphere radius=".1"/></geometry></collision></link></robot>"""
MJCF = """<mujoco><asset><mesh name="a" file="ball.stl"/><mesh name="b" file="ball.obj" scale=".5 .5 .5"/></asset>
<worldbody><body><freejoint/><geom name="solid" size=".1" mass="1"/>
<geom name="a" type="mesh" mesh="a" contype="0" conaffinity="0" mass="0"/>
<geom name="b" type="mesh" mesh="b" contype="0" conaffinity="0" mass="0" rgba="1 0 0 1"/></body></worldbody></mujoco>"""


def bumpy_ball() -> tuple[np.ndarray, np.ndarray]:
    """A closed surface of 2 COUNT^2 triangles or so, which is not convex."""
    theta, phi = np.meshgrid(np.pi * np.arange(1, COUNT) / COUNT, 2 * np.pi * np.arange(COUNT) / COUNT, indexing="ij")
    radius = 1.0 + 0.2 * np.sin(3 * theta) * np.cos(4 * phi)
    ring = radius * np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    here = np.arange((COUNT - 1) * COUNT).reshape(COUNT - 1, COUNT)
    beside = np.roll(here, -1, axis=1)
    top, bottom = np.full(COUNT, here.size), np.full(COUNT, here.size + 1)
    triangles = [(here[:-1], here[1:], beside[:-1]), (beside[:-1], here[1:], beside[1:])]
    triangles += [(top, here[0], beside[0]), (bottom, beside[-1], here[-1])]
    faces = np.concatenate([np.stack([np.ravel(x) for x in corners], axis=1) for corners in triangles])
    return np.concatenate([ring.reshape(3, -1).T, [[0, 0, 1], [0, 0, -1]]]), faces


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with mesh files and models that show them, and an empty cache."""
    monkeypatch.setenv("CONTACTVI_CACHE", str(tmp_path / "cache"))
    vertices, faces = bumpy_ball()
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    (tmp_path / "ball.obj").write_text("\n".join(lines) + "\n")
    rows = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    rows["corners"] = vertices[faces]
    (tmp_path / "ball.stl").write_bytes(bytes(80) + len(faces).to_bytes(4, "little") + rows.tobytes())
    (tmp_path / "r.urdf").write_text(URDF)
    (tmp_path / "m.xml").write_text(MJCF)
    return tmp_path


@pytest.fixture(params=["r.urdf", "m.xml"])
def model(request: pytest.FixtureRequest, folder: Path) -> Path:
    """A model with two meshes that are drawn."""
    if request.param == "m.xml":
        mujoco_module()
    return folder / request.param


def loaded(model: Path) -> cvi.Scene:
    scene = cvi.Scene()
    if model.suffix == ".xml":
        scene.add_mjcf(model)
    else:
        scene.add_urdf(model, base="free")
    return scene


def plain(shown: list[visuals.Visual]) -> list[tuple[Any, ...]]:
    """Visuals as values that can be compared."""
    return [
        (v.name, v.joint, v.placement.tobytes(), v.shape, v.sizes, v.color, v.vertices.tobytes(), v.faces.tobytes())
        for v in shown
    ]


def no_tree(*_: object, **__: object) -> None:
    raise AssertionError("a tree of boxes for a mesh that is only drawn")


def test_meshes_that_are_drawn_get_no_trees(model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """From loading to the page: coal makes no mesh for an MJCF, and for a URDF only what its reader of files makes."""
    monkeypatch.setattr(coal.BVHModelBase, "beginModel", no_tree)
    read = coal.MeshLoader

    def quickest(kind: object) -> coal.MeshLoader:
        assert kind == coal.BV_AABB
        return read(kind)

    monkeypatch.setattr(coal, "MeshLoader", quickest)
    scene = loaded(model)
    run = cvi.simulate(scene, duration=0.01, dt=1e-3)
    run.save(tmp_path / "run.npz")
    run.to_html(tmp_path / "run.html")
    assert sum(visual.shape == "mesh" for visual in run.visuals) == 2


def test_loading_reads_no_mesh_that_is_only_drawn(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(MeshFile, "read", no_tree)
    loaded(folder / "r.urdf").core()


def test_pictures_are_the_meshes_of_the_visual_model(model: Path):
    """The visual model has coal's meshes, with trees; vertices and triangles are those of the pictures."""
    scene = loaded(model)
    shown = {visual.name: visual for visual in scene_visuals.from_scene(scene)}
    meshes = [item for item in scene.visual_model.geometryObjects if isinstance(item.geometry, coal.BVHModelBase)]
    assert len(meshes) == 2
    for item in meshes:
        vertices, faces = arrays_of(item.geometry)
        np.testing.assert_array_equal(shown[item.name].vertices, vertices.astype(np.float32))
        np.testing.assert_array_equal(shown[item.name].faces, faces)
        assert item.geometry.build_state == coal.BVHBuildState.BVH_BUILD_STATE_PROCESSED
        assert len(faces) == len(bumpy_ball()[1])
        np.testing.assert_allclose(shown[item.name].placement, item.placement.homogeneous)


def test_a_stored_run_brings_its_meshes(model: Path, tmp_path: Path):
    """Each mesh once; it is shown where the files of the model are not."""
    scene = loaded(model)
    before = cvi.simulate(scene, duration=0.01, dt=1e-3)
    path = before.save(tmp_path / "run.npz")
    for file in (*tmp_path.glob("ball.*"), model):
        file.unlink()
    after = cvi.Trajectory.load(path)
    assert plain(after.visuals) == plain(before.visuals)
    with np.load(path) as file:
        arrays = [file[name] for name in file.files if name.startswith("array/")]
    stored = [(array.shape, array.dtype.str, array.tobytes()) for array in arrays]
    assert len(set(stored)) == len(stored)
    assert path.stat().st_size > sum(array.nbytes for array in arrays), "nothing is compressed"
    after.to_html(tmp_path / "run.html")


def test_pictures_from_the_cache_are_those_that_are_read(model: Path, monkeypatch: pytest.MonkeyPatch):
    before = plain(scene_visuals.from_scene(loaded(model)))
    monkeypatch.setattr(MeshFile, "read", no_tree)
    assert plain(scene_visuals.from_scene(loaded(model))) == before


def test_pictures_are_loaded_once_for_copies_of_a_scene(folder: Path, monkeypatch: pytest.MonkeyPatch):
    scene = loaded(folder / "r.urdf")
    twin = scene.copy()
    before = plain(scene_visuals.from_scene(scene))
    monkeypatch.setattr(MeshFile, "key", no_tree)
    assert plain(scene_visuals.from_scene(twin)) == before


def test_thinned_meshes_from_the_cache_are_those_that_are_made(folder: Path, monkeypatch: pytest.MonkeyPatch):
    found = scene_visuals.from_scene(loaded(folder / "r.urdf"))
    made = plain(visuals.thin_out(found, 600))
    monkeypatch.setattr(visuals, "_clustered", no_tree)
    assert plain(visuals.thin_out(found, 600)) == made


def test_changed_files_have_other_pictures(folder: Path):
    file = MeshFile(str(folder / "ball.obj"), (1.0, 1.0, 1.0))
    before = surface_of_file(file, "ball")
    text = (folder / "ball.obj").read_text()
    (folder / "ball.obj").write_text(text.replace("v 0.0 0.0 1.0", "v 0.0 0.0 2.0"))
    assert surface_of_file(file, "ball").vertices[:, 2].max() == pytest.approx(2.0)
    assert before.vertices[:, 2].max() < 1.5


def test_entries_that_are_no_surfaces_are_made_again(folder: Path):
    file = MeshFile(str(folder / "ball.obj"), (1.0, 1.0, 1.0))
    key = file.key("surface of a mesh file")
    assert key is not None
    before = surface_of_file(file, "ball")
    points, corners = np.zeros((3, 3), np.float32), np.array([[0, 1, 3]], np.uint32)
    for arrays in ([points], [points, corners], [points, corners.astype(np.int64)], [points.ravel(), corners]):
        cache.keep(key, arrays)
        assert find_surface(key) is None
        np.testing.assert_array_equal(surface_of_file(file, "ball").vertices, before.vertices)


@pytest.mark.parametrize("count", [3, 400])
def test_faces_of_a_mesh_are_taken_at_once_and_one_by_one(count: int):
    """A vertex with more neighbours than coal can count makes the difference."""
    angles = 2.0 * np.pi * np.arange(count) / count
    rim = np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
    fan = np.stack([np.zeros(count), 1 + np.arange(count), 1 + np.roll(np.arange(count), -1)], axis=1).astype(np.int64)
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(count, count + 1)
    mesh.addVertices(np.concatenate([[[0.0, 0.0, 0.0]], rim]))
    mesh.addTriangles(fan)
    mesh.endModel()
    np.testing.assert_array_equal(faces_of_mesh(mesh), fan)
