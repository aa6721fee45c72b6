"""A scene as plain data and back: the same numbers, without files and without the engine."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi
from contactvi.errors import SceneError
from contactvi.scene.scene import Scene

ALLEGRO = "example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf"
EPS = np.finfo(float).eps
IDENTITY = pin.SE3.Identity()
SLANTED = np.array([1.0, 2.0, 2.0]) / 3.0


def every_joint_type() -> Scene:
    model, geometry = pin.Model(), pin.GeometryModel()
    # In pin 4.1 Python can make this joint only from a URDF.
    slanted = pin.buildModelFromXML(
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>'
        '<child link="b"/><axis xyz="1 2 2"/></joint></robot>'
    ).joints[1]
    kinds = [
        pin.JointModelRY(),
        pin.JointModelRevoluteUnaligned(SLANTED),
        pin.JointModelRUBZ(),
        slanted,
        pin.JointModelPZ(),
        pin.JointModelPrismaticUnaligned(SLANTED),
        pin.JointModelHX(0.3),
        pin.JointModelHelicalUnaligned(SLANTED, -0.2),
        pin.JointModelPlanar(),
        pin.JointModelTranslation(),
        pin.JointModelSpherical(),
        pin.JointModelFreeFlyer(),
    ]
    for k, kind in enumerate(kinds):
        where = pin.SE3(pin.rpy.rpyToMatrix(0.1 * k, 0.2, 0.3), np.array([0.1, -0.2, 0.3 * k]))
        joint = model.addJoint(k, kind, where, f"j{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromEllipsoid(1.0 + k, 0.1, 0.2, 0.3), where)
    shapes = [
        coal.Sphere(0.1),
        coal.Box(0.1, 0.2, 0.3),
        coal.Capsule(0.1, 0.2),
        coal.Cylinder(0.1, 0.3),
        coal.Ellipsoid(0.1, 0.2, 0.3),
        coal.Halfspace(np.array([0.0, 0.0, 1.0]), -30.0),
    ]
    for k, shape in enumerate(shapes):
        geometry.addGeometryObject(pin.GeometryObject(f"g{k}", k, pin.SE3(np.eye(3), 0.1 * np.ones(3)), shape))
    model.armature[:4] = 0.01
    return Scene.from_pinocchio(model, geometry)


def full_scene() -> Scene:
    scene = Scene(gravity=(0.1, 0.2, -9.0))
    scene.add_urdf(ALLEGRO, prefix="h_", placement=((1, 2, 3), (0.1, 0.2, 0.3)))
    scene.add_sphere("ball", 0.03, 0.1, placement=(0, 0, 1))
    scene.add_halfspace()
    scene.set_contact(restitution=0.7, friction=0.3)
    scene.set_contact("ball", "ground", restitution=0.9)
    scene.set_joint("h_joint_*", stiffness=0.5, rest=0.4, damping=0.01, restitution=0.2)
    scene.set_joint("h_joint_3.0", limits=False)
    scene.disable_pair("ball", "h_palm_link")
    scene.q0, scene.v0, scene.settings = scene.neutral(), np.ones(scene.nv), {"dt": 1e-3}
    return scene


def assert_same(a: Any, b: Any, path: str = "") -> None:
    if isinstance(a, dict):
        assert a.keys() == b.keys(), path
        for key in a:
            assert_same(a[key], b[key], f"{path}/{key}")
    elif isinstance(a, (list, np.ndarray)) and len(a) > 0 and not isinstance(a[0], (dict, str)):
        assert np.array_equal(a, b), path
    elif isinstance(a, list):
        assert len(a) == len(b), path
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same(x, y, f"{path}/{k}")
    else:
        assert a == b, path


@pytest.mark.parametrize("make", [every_joint_type, full_scene])
def test_round_trip_is_exact(make):
    scene = make()
    data = scene.to_dict()
    again = Scene.from_dict(data)
    assert_same(data | {"parts": None}, again.to_dict() | {"parts": None})
    model, q = scene.model, pin.integrate(scene.model, scene.neutral(), 0.3 * np.sin(np.arange(scene.nv)))
    v = np.cos(np.arange(scene.nv))
    one = pin.rnea(model, model.createData(), q, v, v)
    two = pin.rnea(again.model, again.model.createData(), q, v, v)
    assert np.max(np.abs(one - two)) <= 64 * EPS * np.max(np.abs(one))
    assert [part.name for part in again.parts] == [part.name for part in scene.parts]


def test_hull_and_engine_survive():
    points = np.random.default_rng(1).normal(size=(60, 3))
    cloud = coal.BVHModelOBBRSS()
    cloud.beginModel(20, 60)
    for k in range(20):
        cloud.addTriangle(*points[3 * k : 3 * k + 3])
    cloud.endModel()
    model, geometry = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), IDENTITY, "body")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), IDENTITY)
    geometry.addGeometryObject(pin.GeometryObject("hull", joint, IDENTITY, cloud))
    scene = Scene.from_pinocchio(model, geometry)
    scene.add_halfspace((0, 0, 1), -5.0)
    again = Scene.from_dict(scene.to_dict())
    q = scene.configuration({"body": ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6))})
    gap, other = scene.core().gaps(q)[0], again.core().gaps(q)[0]
    lowest = (points @ pin.XYZQUATToSE3(q).rotation.T + q[:3])[:, 2].min()
    assert np.array_equal(gap, other)
    assert gap == pytest.approx([lowest + 5.0], abs=2 * scene.core().rounding[0] + 1e-12)


def test_data_are_plain():
    def plain(value: Any) -> Any:
        assert isinstance(value, np.ndarray), type(value)
        return value.tolist()

    data = json.loads(json.dumps(full_scene().to_dict(), default=plain))
    assert Scene.from_dict(data).nv == full_scene().nv


def test_a_stored_scene_can_be_edited():
    scene = Scene.from_dict(full_scene().to_dict())
    pairs = len(scene.pair_names)
    scene.add_box("crate", (0.1, 0.1, 0.1), placement=(0, 0, 3))
    scene.set_contact("crate", "ground", restitution=0.1)
    assert len(scene.pair_names) == pairs + 23
    assert dict(zip(scene.pair_names, scene.pair_restitution, strict=True))["ground", "crate"] == 0.1


@pytest.mark.parametrize("damage", ["format", "version", "joints", "geometries", "start", "pairs", "gravity"])
def test_damaged_data_are_an_error(damage):
    data = copy.deepcopy(full_scene().to_dict())
    data[damage] = [["nonsense"]]
    with pytest.raises(SceneError):
        Scene.from_dict(data)
    del data[damage]
    with pytest.raises(SceneError):
        Scene.from_dict(data)


def test_no_dictionary_is_an_error():
    with pytest.raises(SceneError, match="contactvi-scene"):
        Scene.from_dict([1, 2])  # type: ignore[arg-type]


def test_stored_scenes_need_no_engine(tmp_path: Path):
    file = tmp_path / "scene.json"
    file.write_text(json.dumps(full_scene().to_dict(), default=lambda value: value.tolist()))
    code = f"""
import sys; sys.path.insert(0, {str(Path(contactvi.__file__).parents[1])!r})
sys.modules["contactvi._core"] = None
import json
import subprocess
import sys
from contactvi.scene.scene import Scene
scene = Scene.from_dict(json.load(open({str(file)!r})))
print(scene.model.nq, len(scene.visual_model.geometryObjects), len(scene.pair_names) > 200)
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout.split()) == (0, ["23", "23", "True"]), run.stderr
