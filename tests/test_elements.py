"""Constraints, springs, forces and drives as the scene takes them: bad input, names, reports, files, stored scenes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from loop_scenes import BAR, arm_scene, four_bar, four_bar_start, urdf

import contactvi as cvi
from contactvi.scene_file import load_scene

TIMES = [0.0, 0.5, 1.0]
INF = float("inf")


def notes(scene: cvi.Scene, use: str) -> dict[str, str]:
    return {note.name: note.text for note in scene.report.all_notes(use)}


# -- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "name", "text"),
    [
        (lambda s: s.add_point("world", "j3"), "b", "Unknown b"),
        (lambda s: s.add_point("worlt", "j1"), "a", "Did you mean 'world'?"),
        (lambda s: s.add_point("j1", "j1"), "b", "two different bodies"),
        (lambda s: s.add_point("world", "arm"), "b", "'arm' has 2 bodies"),
        (lambda s: s.add_point("j1", "j2", (0, 0)), "point_a of 'point_1'", "(3,)"),
        (lambda s: s.add_distance("j1", "j2", length=0.0), "length of 'distance_1'", "> 0"),
        (lambda s: s.add_distance("j1", "j2", length="long"), "length of 'distance_1'", "'long'"),
        (lambda s: s.add_weld("world", "j2", "here"), "placement of 'weld_1'", "pin.SE3"),
        (lambda s: s.add_screw("world", "j2", math.nan), "pitch of 'screw_1'", "nan"),
        (lambda s: s.add_joint_equality("j1", "j1"), "other", "two different joints"),
        (lambda s: s.add_joint_equality("j1", "j2", []), "coefficients of 'equality_1'", "a list of numbers"),
        (lambda s: s.add_joint_equality("j*", "j2"), "joint", "one joint"),
        (lambda s: s.add_joint_equality("ball", "j2"), "joint", "a free joint"),
        (lambda s: s.prescribe("ball", 1.0), "joint", "6 degrees of freedom"),
        (lambda s: s.prescribe("j1", ([0, 1], [0])), "motion of joint 'j1'", "shapes (2,) and (1,)"),
        (lambda s: s.add_spring("j1", "j2", -1.0), "stiffness of 'spring_1'", ">= 0"),
        (lambda s: s.add_spring("j1", "j1", 1.0), "points", "2 points on 1 body"),
        (lambda s: s.add_tape_spring([("j1", (0, 0, 0))], 1.0), "points", "1 points on 1 body"),
        (lambda s: s.add_tape_spring([("j1",), ("j2",)], 1.0), "points", "(x, y, z)"),
        (lambda s: s.add_spring("j1", "j2", 1.0, tension_only=1), "tension_only", "True or False"),
        (lambda s: s.add_wrench("j1"), "force", "a torque or both"),
        (lambda s: s.add_wrench("j1", (1, 2)), "force of 'wrench_1'", "(3,)"),
        (lambda s: s.add_wrench("j1", (1, 2, 3), axes="joint"), "axes", "'world' or 'body'"),
        (lambda s: s.add_potential(3.0), "value", "a function"),
        (lambda s: s.add_potential(lambda q: 0.0), "gradient", "a function"),
        (lambda s: s.add_force(None), "function", "a function"),
        (lambda s: s.add_force(lambda t, q, v: v, 3), "derivatives", "a function"),
        (lambda s: s.set_joint("j1", friction=-1.0), "friction of 'j1'", ">= 0"),
        (lambda s: s.set_joint("ball", friction=1.0), "friction", "a free joint"),
        (lambda s: s.set_joint("j1", spring=3.0), "spring of 'j1'", "a list of numbers"),
        (lambda s: s.set_joint("ball", spring=[1.0]), "joint", "one number in q"),
        (lambda s: s.set_joint("ball", armature=1.0), "armature", "a free joint"),
        (lambda s: s.set_joint("j1", armature=-1.0), "armature of 'j1'", ">= 0"),
        (lambda s: s.set_servo("ball", 1.0, 1.0), "joint", "a free joint"),
        (lambda s: s.set_servo("j1", -1.0, 1.0), "kp of the servo of 'j1'", ">= 0"),
        (lambda s: s.set_servo("j1", 1.0, 1.0, effort=0.0), "effort of the servo of 'j1'", "> 0"),
        (lambda s: s.set_actuator("j1", effort=True), "effort", "none in the file"),
        (lambda s: s.set_actuator("j1", velocity=-2.0), "velocity of 'j1'", "> 0"),
        (lambda s: s.add_urdf("x.urdf", mimic="no"), "path", ""),
        (lambda s: s.remove("point_7"), "name", "an element of the scene"),
        (lambda s: s.add_point("world", "j1", name=""), "name", "non-empty"),
    ],
)
def test_bad_input_is_named(call, name, text):
    scene = arm_scene(2)
    scene.add_sphere("ball", 0.1, placement=(0, 2, 0))
    with pytest.raises((cvi.InputError, cvi.SceneError)) as caught:
        call(scene)
    if isinstance(caught.value, cvi.InputError):
        assert caught.value.name == name
    assert text in str(caught.value)
    assert not scene.elements


def test_names_are_unique_and_numbered():
    scene = arm_scene(2)
    assert [scene.add_point("world", "j2"), scene.add_point("world", "j1")] == ["point_1", "point_2"]
    with pytest.raises(cvi.InputError, match=r"'point_2' already.*remove"):
        scene.add_weld("world", "j1", name="point_2")
    scene.remove("point_1")
    assert scene.add_point("j1", "j2") == "point_1"


def test_a_distance_of_nothing_is_refused():
    scene = arm_scene(2)
    scene.add_distance("j1", "j2", (BAR, 0, 0), (0, 0, 0))
    with pytest.raises(cvi.InputError, match="lie on each other"):
        scene.neutral()


# -- what is meant ----------------------------------------------------------------------------------------------------


def test_neutral_gives_what_is_none():
    scene = arm_scene(2)
    scene.add_point("world", "j2", (BAR, 0.0, 0.1), None)
    scene.add_distance("world", "j2", (0, 0, 1.0), (BAR, 0, 0))
    scene.add_weld("j1", "j2")
    scene.add_screw("world", "j2", 0.1, ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)))
    scene.add_spring("world", "j2", 1.0, point_b=(BAR, 0, 0))
    scene.add_joint_equality("j2", "j1", (0.0, 2.0, 1.0))
    core = scene.core()
    assert core.constraint_rows == [3, 1, 6, 5, 1]
    assert core.constraint_residual(scene.neutral(), 0.0) == pytest.approx(np.zeros(16), abs=1e-15)
    assert scene._complete().elements.springs[0][3] == pytest.approx(2 * BAR)


def test_neutral_moves_joints_that_follow():
    scene = arm_scene(3)
    scene.set_joint("j1", limits=(0.2, 1.0))
    scene.add_joint_equality("j3", "j2", (0.0, 0.5))
    scene.add_joint_equality("j2", "j1", (0.1, -1.0))
    assert scene.neutral() == pytest.approx([0.2, -0.1, -0.05], abs=1e-16)
    assert scene.spring_rest() == pytest.approx(scene.neutral())


def test_armature_and_rotor():
    scene = arm_scene(2)
    scene.set_joint("j1", rotor_inertia=1e-4)
    scene.set_joint("j*", armature=0.01, gear_ratio=-50.0)
    assert scene.model.armature == pytest.approx([0.01 + 1e-4 * 2500.0, 0.01])
    assert scene.to_dict()["joints"][0]["armature"] == pytest.approx([0.26])
    assert cvi.Scene.from_dict(scene.to_dict()).model.armature == pytest.approx([0.26, 0.01])


def test_limits_of_the_file_are_off_by_default():
    scene = arm_scene(2, effort=3.0, velocity=2.0, friction=0.5)
    arrays = scene._complete().arrays
    assert not np.isfinite(arrays.actuator).any()
    assert not arrays.dry_friction.any()
    scene.set_actuator("j1", effort=True, velocity=5.0)
    scene.set_joint("j2", friction=True)
    scene.set_servo("j2", 10.0, 1.0)
    arrays = scene._complete().arrays
    assert np.array_equal(arrays.actuator, [[3.0, INF], [5.0, INF]])
    assert np.array_equal(arrays.dry_friction, [0.0, 0.5])
    assert np.array_equal(arrays.servo, [[0.0, 10.0], [0.0, 1.0], [0.0, 3.0]])
    assert scene.servo_joints == ["j2"]
    scene.set_actuator("j1", effort=False, velocity=False)
    scene.set_joint("j2", friction=False)
    assert not np.isfinite(scene._complete().arrays.actuator).any()
    assert not scene._complete().arrays.dry_friction.any()


def test_the_report_lists_everything():
    scene = arm_scene(2, effort=3.0, friction=0.5)
    assert "ignored" in {note.use for note in scene.report.all_notes() if "Coulomb" in note.text}
    scene.add_distance("world", "j2", (0, 0, 1.0), name="rod")
    scene.add_spring("world", "j2", 5.0, name="band", tension_only=True)
    scene.add_wrench("j2", (0, 0, 1.0), name="push")
    scene.add_force(lambda t, q, v: 0 * v, name="mine")
    scene.set_joint("j*", friction=True, spring=[1.0, 0.0, 2.0])
    scene.set_servo("j1", 10.0, 1.0)
    scene.set_actuator("j2", effort=True)
    used = notes(scene, "used")
    for name, words in {"rod": "distance", "band": "only in tension", "push": "wrench", "mine": "Python"}.items():
        assert words in used[name]
    text = str(scene.report)
    for words in ("dry friction of the file 0.5", "servo with kp 10", "effort limit of the file 3", "1, 0, 2"):
        assert words in text
    assert "Coulomb friction in the joint" not in text


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
    assert scene.v0 is None  # of a driven length: what goes with it


def test_scene_files_of_joints(tmp_path: Path):
    (tmp_path / "arm.urdf").write_text(urdf())
    (tmp_path / "page.toml").write_text(JOINTS)
    scene = load_scene(tmp_path / "page.toml")
    arrays = scene._complete().arrays
    assert np.array_equal(arrays.dry_friction, [0.3, 0.0])
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
    assert "mimic tag: a constraint, -2 * j1 + 0.1" in notes(scene, "used").values()
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


MJCF = """<mujoco model="m"><compiler angle="radian"/><worldbody>
<body name="a"><joint name="x" type="hinge" axis="0 1 0"/><geom type="sphere" size="0.1" pos="0.2 0 0"/>
<body name="b" pos="0.4 0 0"><joint name="y" type="hinge" axis="0 1 0"/><geom type="sphere" size="0.1" pos="0.2 0 0"/>
</body></body>
<body name="c" pos="0 0 1"><freejoint/><geom type="sphere" size="0.1"/></body>
</worldbody><equality>
<connect name="pin" body1="b" anchor="0.4 0 0"/>
<weld body1="a" body2="c" relpose="0 0 1 0.7071067811865476 0 0 0.7071067811865476"/>
<weld name="asis" body1="a" body2="c"/>
<joint name="gear" joint1="y" joint2="x" polycoef="0.1 -2 0 0 0"/>
<connect name="off" body1="a" body2="b" anchor="0 0 0" active="false"/>
<connect name="sites" site1="s" site2="t"/>
<tendon name="rope" tendon1="t"/>
</equality></mujoco>"""


def test_equality_of_mjcf(tmp_path: Path):
    (tmp_path / "m.xml").write_text(MJCF)
    scene = cvi.Scene()
    scene.add_mjcf(tmp_path / "m.xml", prefix="m_")
    kinds = {element.name: element.kind for element in scene.elements}
    assert kinds == {"m_pin": "point", "m_weld_2": "weld", "m_asis": "weld", "m_gear": "equality"}
    ignored = {note.name for note in scene.report.all_notes("ignored", "equality")}
    assert ignored == {"m_off", "m_sites", "m_rope"}
    residual = scene.core().constraint_residual(scene.neutral(), 0.0)
    assert scene.neutral()[scene.q_index("m_y")] == pytest.approx(0.1)
    assert residual[:3] == pytest.approx(np.zeros(3), abs=1e-15)
    assert residual[9:] == pytest.approx(np.zeros(7), abs=1e-15)  # as it is, and the gear
    assert np.linalg.norm(residual[6:9]) == pytest.approx(2 * np.sin(np.pi / 4), abs=1e-9)  # turned by 90 degrees
    off = cvi.Scene()
    off.add_mjcf(tmp_path / "m.xml", equality=False)
    assert not off.elements


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
    one, two = scene._complete(), again._complete()
    q = scene.configuration({"j1": 0.3, "j2": 0.4, "ball": ((0.1, 0.2, 0.3), (0.3, 0.2, 0.1))})
    for t in (0.0, 0.4):
        assert np.array_equal(scene.core().constraint_residual(q, t), again.core().constraint_residual(q, t))
    for name in ("stiffness", "rest", "dry_friction", "servo", "actuator"):
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
    assert not again._edits.missing
    assert four_bar_start(again).shape == (3,)
