"""Constraints, springs, forces and servos in files: scene files, mimic tags, equality of MJCF, stored scenes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from contactvi.scene.toml import load_scene
from helpers.loop_scenes import arm_scene, four_bar, four_bar_start, urdf

TIMES = [0.0, 0.5, 1.0]
INF = float("inf")


def notes(scene: cvi.Scene, use: str) -> dict[str, str]:
    return {note.name: note.text for note in scene.report.all_notes(use)}


# -- files ------------------------------------------------------------------------------------------------------------

PAGE = """
[[sphere]]
name = "a"
radius = 0.1
[[sphere]]
name = "b"
radius = 0.1
xyz = [1, 0, 0]
[[point]]
a = "world"
b = "a"
[[distance]]
a = "a"
b = "b"
length = { times = [0, 1, 2], values = [1.0, 1.1, 1.2] }
name = "winch"
[[weld]]
a = "a"
b = "b"
xyz = [1, 0, 0]
[[screw]]
a = "world"
b = "b"
pitch = 0.1
frame_a = { xyz = [1, 0, 0], rpy = [0, 0.5, 0] }
[[spring]]
a = "a"
b = "b"
stiffness = 10
damping = 1
[[tape_spring]]
points = [["world", [0, 0, 1]], ["a", [0, 0, 0]], ["b", [0, 0, 0]]]
stiffness = 5
tension_only = true
[[wrench]]
body = "b"
force = [0, 0, 1]
axes = "body"
"""
JOINTS = """
[[urdf]]
path = "arm.urdf"
friction = true
[[joint]]
name = "j*"
spring = [1.0, 2.0]
armature = 0.1
[[equality]]
joint = "j1"
other = "j2"
coefficients = [0.1, 2.0]
[[prescribe]]
joint = "j2"
motion = 0.3
[[servo]]
joint = "j1"
kp = 5
kd = 1
target = 0.5
[[actuator]]
joint = "j2"
effort = true
velocity = 3
[initial]
assemble = true
"""


def test_scene_files(tmp_path: Path):
    (tmp_path / "page.toml").write_text(PAGE)
    scene = load_scene(tmp_path / "page.toml")
    assert [element.name for element in scene.elements] == [
        *("point_1", "winch", "weld_1", "screw_1", "spring_1", "tape_spring_1", "wrench_1"),
    ]
    assert scene.core().constraint_rows == [3, 1, 6, 5]
    assert scene.v0 is None  # The run starts with the velocity that the driven length gives.


def test_scene_files_of_joints(tmp_path: Path):
    (tmp_path / "arm.urdf").write_text(urdf())
    (tmp_path / "page.toml").write_text(JOINTS)
    scene = load_scene(tmp_path / "page.toml")
    arrays = scene.built().arrays
    assert np.array_equal(arrays.joint_friction, [0.3, 0.0])
    assert np.array_equal(arrays.actuator, [[INF, 4.0], [INF, 3.0]])
    assert arrays.targets["j1"].constant == 0.5
    assert scene.q0 == pytest.approx([0.7, 0.3], abs=1e-12)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (PAGE.replace('b = "a"\n[[dist', 'c = "a"\n[[dist'), "unknown key 'c' in [point]"),
        (PAGE.replace("pitch = 0.1\n", ""), "lacks 'pitch'"),
        (PAGE.replace("rpy = [0, 0.5, 0] }", "yaw = 1 }"), "[[screw]] 1: Value of frame_a"),
        (PAGE.replace('body = "b"\nforce', 'body = "x"\nforce'), "[[wrench]] 1: Unknown body"),
        (PAGE.replace("times = [0, 1, 2]", "times = [0, 2, 1]"), "[[distance]] 1: Times of length of 'winch'"),
    ],
)
def test_bad_scene_files(tmp_path: Path, text: str, expected: str):
    (tmp_path / "page.toml").write_text(text)
    with pytest.raises(cvi.ContactviError) as caught:
        load_scene(tmp_path / "page.toml")
    assert expected in str(caught.value)


# -- constraints of models' files -------------------------------------------------------------------------------------


def test_mimic_tags_are_constraints(tmp_path: Path):
    file = tmp_path / "arm.urdf"
    file.write_text(urdf(two='<mimic joint="j1" multiplier="-2" offset="0.1"/>'))
    scene = cvi.Scene()
    scene.add_urdf(file, prefix="r_")
    (element,) = scene.elements
    assert (element.name, element.joint, element.other) == ("mimic_r_j2", "r_j2", "r_j1")
    assert scene.neutral() == pytest.approx([0.0, 0.1])
    assert "mimic tag: a coupled joint, -2 * j1 + 0.1" in notes(scene, "used").values()
    free = cvi.Scene()
    free.add_urdf(file, mimic=False)
    assert not free.elements
    assert np.array_equal(free.neutral(), [0.0, 0.0])
    assert "independent" in notes(free, "ignored")["j2"] or "mimic" in str(free.report)


@pytest.mark.parametrize(
    ("tag", "text"),
    [
        ('<mimic joint="j7"/>', "the name of another joint"),
        ('<mimic joint="j2"/>', "the name of another joint"),
        ('<mimic joint="j1" multiplier="two"/>', "multiplier of <mimic>"),
    ],
)
def test_bad_mimic_tags(tmp_path: Path, tag: str, text: str):
    (tmp_path / "arm.urdf").write_text(urdf(two=tag))
    with pytest.raises(cvi.SceneError, match=text):
        cvi.Scene().add_urdf(tmp_path / "arm.urdf")


def test_a_mimic_of_a_continuous_joint_stays_independent(tmp_path: Path):
    text = urdf(two='<mimic joint="j1"/>').replace('"j1" type="revolute"', '"j1" type="continuous"')
    (tmp_path / "arm.urdf").write_text(text)
    scene = cvi.Scene()
    scene.add_urdf(tmp_path / "arm.urdf")
    assert not scene.elements
    assert "'j1' is continuous" in str(scene.report)


# -- stored scenes ----------------------------------------------------------------------------------------------------


def everything() -> cvi.Scene:
    scene = four_bar(effort=3.0, velocity=2.0, friction=0.5)
    scene.add_sphere("ball", 0.05, placement=(0, 0, 1))
    scene.add_distance("world", "ball", (0, 0, 2.0), length=(TIMES, [1.0, 1.1, 1.3]), name="winch")
    scene.add_weld("j1", "ball", ((0, 0, 1), (0.1, 0.2, 0.3)))
    scene.add_screw("world", "ball", 0.1)
    scene.add_joint_equality("j2", "j1", (0.0, 1.0, 0.5))
    scene.prescribe("j1", 0.2)
    scene.add_tape_spring([("world", (0, 0, 1)), ("j1", (0.1, 0, 0)), ("ball", (0, 0, 0))], 3.0, damping=1.0)
    scene.add_wrench("ball", (0, 0, 1), (1, 0, 0), (0.1, 0, 0), "body")
    scene.set_joint("j3", spring=[1.0, 2.0], rest=0.1, friction=True, armature=0.2)
    scene.set_servo("j1", 3.0, 2.0, target=(TIMES, [0.0, 0.1, 0.2]))
    scene.set_servo("j2", 3.0, 2.0, effort=INF)
    scene.set_actuator("j1", effort=True)
    return scene


def test_elements_survive_as_data():
    scene = everything()
    again = cvi.Scene.from_dict(scene.to_dict())
    assert [e.name for e in again.elements] == [e.name for e in scene.elements]
    one, two = scene.built(), again.built()
    q = scene.configuration({"j1": 0.3, "j2": 0.4, "ball": ((0.1, 0.2, 0.3), (0.3, 0.2, 0.1))})
    for t in (0.0, 0.4):
        assert np.array_equal(scene.core().constraint_residual(q, t), again.core().constraint_residual(q, t))
    for name in ("stiffness", "rest", "joint_friction", "servo", "actuator"):
        assert np.array_equal(getattr(one.arrays, name), getattr(two.arrays, name)), name
    assert two.arrays.targets["j1"](0.3) == one.arrays.targets["j1"](0.3)
    assert two.arrays.polynomials[0][1] == 0.1
    assert np.array_equal(two.model.armature, one.model.armature)


def test_functions_are_not_stored_and_said_to_be_missing():
    scene = four_bar()
    scene.add_force(lambda t, q, v: 0.0 * v, name="wind")
    scene.prescribe("j1", math.sin, name="crank")
    scene.set_servo("j2", 1.0, 1.0, target=math.sin)
    again = cvi.Scene.from_dict(scene.to_dict())
    ignored = notes(again, "ignored")
    assert {"wind", "crank", "target of j2"} <= set(ignored)
    assert "add it again" in ignored["wind"]
    with pytest.raises(cvi.SceneError, match=r"lacks 'wind', 'crank', 'target of j2'.*Add them again"):
        cvi.simulate(again, duration=0.1)
    again.add_force(lambda t, q, v: 0.0 * v, name="wind")
    again.set_servo("j2", 1.0, 1.0, target=math.sin)
    again.remove("crank")
    assert not again.missing
    assert four_bar_start(again).shape == (3,)


def test_the_ledger_of_a_stored_run_without_its_functions(tmp_path: Path):
    scene = arm_scene(2)
    scene.add_potential(lambda q: 3.0 * math.sin(q[0]), lambda q: np.array([3.0 * math.cos(q[0]), 0.0]), name="hill")
    scene.prescribe("j2", lambda t: 0.1 * t * t, name="crank")
    traj = cvi.simulate(scene, duration=0.1, dt=1e-3)
    again = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    assert np.array_equal(again.ledger.energy, traj.ledger.energy)
    assert np.array_equal(again.ledger.energy_balance, traj.ledger.energy_balance)
    assert np.abs(again.ledger.energy_balance).max() < 1e-4
    assert np.array_equal(again.ledger.persistent, traj.ledger.persistent)
    assert np.array_equal(again.modified_energy, traj.modified_energy)
    assert np.isnan(again.ledger.modified_energy).all()
