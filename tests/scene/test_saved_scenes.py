"""Scenes written as scene files: what is read back is the scene; what no file holds is refused by name."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.extras import needs_mujoco
from helpers.run_scenes import HAND_URDF, ball_scene

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
MODELS = sorted((ROOT / "models").glob("*.toml"))
RUN = {"dt": 1e-3, "duration": 0.2}


def check_equal(scene: cvi.Scene, read: cvi.Scene) -> None:
    """By what the scenes simulate: names, sizes, masses, contacts, start, settings, and a run of both."""
    assert list(read.model.names) == list(scene.model.names)
    assert [g.name for g in read.collision_model.geometryObjects] == [
        g.name for g in scene.collision_model.geometryObjects
    ]
    assert read.pair_names == scene.pair_names
    np.testing.assert_array_equal(read.pair_restitution, scene.pair_restitution)
    np.testing.assert_array_equal(read.pair_friction, scene.pair_friction)
    for one, other in zip(scene.model.inertias, read.model.inertias, strict=True):
        np.testing.assert_allclose(other.toDynamicParameters(), one.toDynamicParameters(), rtol=1e-12, atol=1e-15)
    assert sorted((e.name, e.kind) for e in read.elements) == sorted((e.name, e.kind) for e in scene.elements)
    np.testing.assert_array_equal(read.gravity, scene.gravity)
    assert read.camera == scene.camera
    assert read.settings == scene.settings
    q = scene.neutral() if scene.q0 is None else scene.q0
    np.testing.assert_allclose(read.q0, q, rtol=0, atol=1e-14)
    runs = [cvi.simulate(of, **RUN, contact_mode="events") for of in (scene, read)]
    # Turns are written as angles, whose rounding 0.2 s of these motions multiply by less than 1000.
    np.testing.assert_allclose(runs[1].q, runs[0].q, rtol=0, atol=1e-12)
    assert [event.pair for event in runs[1].events] == [event.pair for event in runs[0].events]


def workshop() -> cvi.Scene:
    """Parts in an order of their own, and something of everything that files hold."""
    scene = cvi.Scene(gravity=(0.0, 0.1, -9.7))
    scene.add_halfspace(name="floor")
    arm = scene.add_urdf(ROOT / "models" / "double_pendulum.urdf", placement=((0.0, 3.0, 2.0), (0.0, 0.0, 0.3)))
    box = scene.add_box("box", size=np.array([0.1, 0.2, 0.3]), mass=2.0, placement=((0, 0, 0.8), (0.3, -0.2, 0.1)))
    ball = scene.add_sphere("ball", 0.1, placement=pin.XYZQUATToSE3(np.array([1.0, 0.0, 0.5, 0.0, 0.6, 0.0, 0.8])))
    scene.add_capsule("rod", radius=0.05, length=0.3, placement=(2.0, 0.0, 0.5), color=(0.1, 0.2, 0.3, 1.0))
    scene.add_halfspace(normal=(1.0, 0.0, 0.0), offset=-3.0, name="wall")
    scene.set_contact(restitution=0.3, friction=0.5)
    scene.set_contact(box, restitution=0.7)
    scene.set_contact(ball, "floor", friction=0.9, restitution=0.1)
    scene.disable_pair(box, "rod")
    scene.set_joint(arm.joints[0], damping=0.1, stiffness=2.0, rest=0.2)
    scene.set_servo(arm.joints[1], kp=30.0, kd=2.0, target=0.4)
    scene.add_spring(box, ball, point_a=(0.05, 0.0, 0.0), stiffness=20.0, rest_length=0.5, damping=0.1)
    scene.add_point("rod", "world", point_a=(0.0, 0.0, 0.15), point_b=(2.0, 0.0, 0.65))
    gone = scene.add_wrench(box, force=(100.0, 0.0, 0.0))
    scene.remove(gone)
    scene.add_wrench(ball, force=(1.0, 0.0, 0.0), name="push")
    scene.q0 = scene.configuration({arm.joints[0]: 0.5, ball: (1.0, 0.0, 0.6)})
    scene.v0 = scene.velocity({box: ((1.0, 2.0, 0.5), (0.1, -0.2, 3.0)), arm.joints[1]: 0.7}, scene.q0)
    scene.settings = {"dt": 1e-3, "duration": 0.5, "ledger": {"own_jump": 1e-3}, "zeno": "hold"}
    scene.camera = {"follow": "box"}
    return scene


@pytest.mark.parametrize("file", MODELS, ids=lambda file: file.stem)
def test_scene_files_are_written_again(tmp_path, file):
    scene = cvi.load_scene(file)
    saved = scene.save(tmp_path / "again.toml")
    check_equal(scene, cvi.load_scene(saved))
    title = tomllib.loads(file.read_text())["scene"].get("title")
    assert tomllib.loads(saved.read_text())["scene"].get("title") == title


def test_a_scene_made_in_python_is_written(tmp_path):
    scene = workshop()
    saved = scene.save(tmp_path / "workshop.toml")
    check_equal(scene, cvi.load_scene(saved))
    text = saved.read_text()
    assert 'order = ["halfspace", "urdf", "box", "sphere", "capsule", "halfspace"]' in text
    assert "100.0" not in text  # of the wrench that was removed
    assert [path.name for path in tmp_path.iterdir()] == ["workshop.toml"]


def test_a_copy_is_written_with_what_was_added_to_it(tmp_path):
    scene = ball_scene()
    twin = scene.copy()
    twin.add_sphere("more", 0.1, placement=(1.0, 0.0, 1.0))
    assert "more" in cvi.load_scene(twin.save(tmp_path / "twin.toml")).names.bodies
    assert "more" not in cvi.load_scene(scene.save(tmp_path / "scene.toml")).names.bodies


def test_a_call_that_fails_leaves_nothing_in_the_file(tmp_path):
    scene = ball_scene()
    with pytest.raises(cvi.InputError):
        scene.add_sphere("bad", -1.0)
    with pytest.raises(cvi.InputError):
        scene.set_contact(restitution=7.0)
    check_equal(scene, cvi.load_scene(scene.save(tmp_path / "scene.toml")))


def test_paths_are_relative_to_the_file(tmp_path, monkeypatch):
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "arm.urdf").write_text((ROOT / "models" / "double_pendulum.urdf").read_text())
    monkeypatch.chdir(tmp_path)
    scene = cvi.Scene()
    scene.add_urdf("robots/arm.urdf")
    (tmp_path / "scenes").mkdir()
    saved = scene.save("scenes/arm.toml")
    assert 'path = "../robots/arm.urdf"' in saved.read_text()
    monkeypatch.chdir("/")
    check_equal(scene, cvi.load_scene(tmp_path / "scenes" / "arm.toml"))
    robot = cvi.Scene()
    robot.add_urdf(HAND_URDF)
    assert HAND_URDF in robot.save(tmp_path / "hand.toml").read_text()


@needs_mujoco
def test_a_scene_of_an_mjcf_is_written(tmp_path):
    (tmp_path / "ball.xml").write_text(
        '<mujoco><option gravity="0 0 -5"/><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 1" name="ball">'
        '<freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    scene = cvi.Scene.from_mjcf(tmp_path / "ball.xml", restitution=0.4)
    check_equal(scene, cvi.load_scene(scene.save(tmp_path / "ball.toml")))


def arrays(scene: cvi.Scene) -> cvi.Scene:
    scene.add_mesh("stone", np.vstack([np.zeros(3), 0.1 * np.eye(3)]), placement=(3.0, 0.0, 1.0))
    return scene


def law(scene: cvi.Scene) -> cvi.Scene:
    scene.set_contact(friction=lambda speed: 0.5)
    return scene


def force(scene: cvi.Scene) -> cvi.Scene:
    scene.add_force(lambda q, v, t: -0.1 * v, name="drag")
    return scene


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (arrays, r"add_mesh\('stone'\): mesh is an array"),
        (law, r"set_contact\(\): friction is a function"),
        (force, r"add_force\(\), which takes functions"),
        (lambda scene: cvi.Scene.from_pinocchio(scene.model), "pin.Model"),
        (lambda scene: pickle.loads(pickle.dumps(scene)), "comes from a stored run or from pickle"),
        (lambda scene: scene.with_parameters({"mass:ball": 3.0}), "with_parameters"),
    ],
)
def test_what_no_file_holds_is_refused_by_name(tmp_path, change, says):
    with pytest.raises(cvi.SceneError, match=says):
        change(ball_scene()).save(tmp_path / "scene.toml")
    assert not list(tmp_path.iterdir())


def test_a_force_that_was_removed_does_not_matter(tmp_path):
    scene = force(ball_scene())
    scene.remove("drag")
    check_equal(scene, cvi.load_scene(scene.save(tmp_path / "scene.toml")))


def test_a_scene_file_is_replaced_on_request_only(tmp_path):
    (tmp_path / "scene.toml").write_text("precious")
    with pytest.raises(cvi.OverwriteError):
        ball_scene().save(tmp_path / "scene.toml")
    assert (tmp_path / "scene.toml").read_text() == "precious"
    assert "ball" in ball_scene().save(tmp_path / "scene.toml", overwrite=True).read_text()
    with pytest.raises(cvi.InputError, match="Create the folder"):
        ball_scene().save(tmp_path / "none" / "scene.toml")


@pytest.mark.parametrize("order", ['["sphere"]', '["sphere", "sphere", "halfspace"]', '["sphere", "box"]', "3"])
def test_an_order_that_does_not_fit_is_refused(tmp_path, order):
    file = tmp_path / "scene.toml"
    file.write_text(f'[scene]\norder = {order}\n[[halfspace]]\n[[sphere]]\nname = "ball"\nradius = 0.1\n')
    with pytest.raises(cvi.SceneError, match=r"order of the parts.*sphere, halfspace"):
        cvi.load_scene(file)
