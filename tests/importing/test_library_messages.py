"""Errors that begin in a library name the geometry and the file, and have none of the places in its sources."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi

BROKEN = {
    "empty.stl": b"",
    "words.stl": b"solid x\nfacet\n",
    "short.stl": b"\0" * 80 + b"\x05\0\0\0" + b"\0" * 60,
    "words.obj": b"hello",
    "corner.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    "empty.dae": b"<COLLADA/>",
    "header.ply": b"ply\nformat ascii 1.0\nelement vertex 1\n",
    "unknown.xyz": b"1 2 3",
    "flat.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "nan.obj": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\n",
}


def check(error: cvi.ContactviError, *names: str) -> None:
    text = str(error)
    assert "message:" not in text
    assert "in function" not in text
    assert "\n" not in text
    for name in names:
        assert name in text
    assert error.remedy


@pytest.mark.parametrize("name", BROKEN)
def test_meshes_that_cannot_be_read(name: str, tmp_path: Path):
    file = tmp_path / name
    file.write_bytes(BROKEN[name])
    with pytest.raises(cvi.ContactviError) as caught:
        cvi.Scene().add_mesh("part", file)
    check(caught.value, name, "part")
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(
        f'<robot name="r"><link name="base"><collision><geometry><mesh filename="{name}"/></geometry></collision>'
        "</link></robot>"
    )
    with pytest.raises(cvi.ContactviError) as caught:
        cvi.Scene().add_urdf(urdf)
    check(caught.value, name, "base_0")


def test_a_picture_whose_vertices_are_not_finite(tmp_path: Path):
    (tmp_path / "nan.obj").write_bytes(BROKEN["nan.obj"])
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(
        '<robot name="r"><link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"'
        ' iyz="0"/></inertial><visual><geometry><mesh filename="nan.obj"/></geometry></visual></link></robot>'
    )
    scene = cvi.Scene()
    scene.add_urdf(urdf, base="free")
    traj = cvi.simulate(scene, duration=0.01, dt=1e-3)
    with pytest.raises(cvi.ContactviError) as caught:
        traj.to_html(tmp_path / "run.html")
    check(caught.value, "nan.obj", "base_0")


@pytest.mark.parametrize("name", [name for name in BROKEN if name not in ("flat.obj", "nan.obj")])
def test_pictures_that_cannot_be_read(name: str, tmp_path: Path):
    (tmp_path / name).write_bytes(BROKEN[name])
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(
        f'<robot name="r"><link name="base"><visual><geometry><mesh filename="{name}"/></geometry></visual></link>'
        "</robot>"
    )
    scene = cvi.Scene()
    scene.add_urdf(urdf)
    with pytest.raises(cvi.ContactviError) as caught:
        scene.pictures()
    check(caught.value, name, "base_0")


def triangles(rows: list[tuple[int, int, int]]) -> coal.StdVec_Triangle:
    result = coal.StdVec_Triangle()
    for row in rows:
        result.append(coal.Triangle(*row))
    return result


def points(rows: np.ndarray) -> coal.StdVec_Vec3s:
    result = coal.StdVec_Vec3s()
    for row in np.asarray(rows, dtype=float):
        result.append(row)
    return result


CORNERS = np.vstack([np.zeros(3), np.eye(3)])
SHAPES = {
    "an empty hull": lambda: coal.Convex(),
    "a hull without triangles": lambda: coal.Convex.convexHull(points(CORNERS), False, ""),
    "an open surface": lambda: coal.Convex(points(CORNERS), triangles([(0, 2, 1), (0, 1, 3)])),
    "a cone": lambda: coal.Cone(1.0, 1.0),
}


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_from_python(name: str):
    model, geometry = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    geometry.addGeometryObject(pin.GeometryObject("own shape", joint, pin.SE3.Identity(), SHAPES[name]()))
    with pytest.raises(cvi.ContactviError) as caught:
        cvi.Scene.from_pinocchio(model, geometry)
    check(caught.value, "own shape")
