"""Constraints, springs, forces and servos as the scene takes them: bad input, names, reports, files, stored scenes."""

from __future__ import annotations

import math

import numpy as np
import pytest

import contactvi as cvi
from contactvi import _core
from helpers.loop_scenes import BAR, arm_scene

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
        (
            lambda s: s.add_joint_equality("j1", "j2", np.array("x")),
            "coefficients of 'equality_1'",
            "a list of numbers",
        ),
        (lambda s: s.add_point("world", "j1", name=["rod"]), "name", "a non-empty str"),
        (lambda s: s.add_wrench("j1", (1, 0, 0), axes=np.eye(2)), "axes", "'world' or 'body'"),
        (lambda s: s.add_spring("world", "j1", 10**400), "stiffness of 'spring_1'", ">= 0"),
        (lambda s: s.add_force(np.sin, check=[]), "check", "True or False"),
        (lambda s: s.remove(None), "name", "an element of the scene"),
        (lambda s: s.assemble(fixed="j9"), "joint", "Unknown joint"),
        (lambda s: s.assemble(t=math.nan), "t", "a finite number"),
        (lambda s: s.consistent_velocity(t="now"), "t", "a finite number"),
        (lambda s: s.prescribe("ball", 1.0), "motion of 'ball'", "quaternion xyzw"),
        (lambda s: s.prescribe("world", (0, 0, 1)), "joint", "The world does not move"),
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
        (lambda s: s.add_urdf("x.urdf", mimic="no"), "mimic", ""),
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


# -- meaning ----------------------------------------------------------------------------------------------------------


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
    assert scene.built().elements.springs[0][3] == pytest.approx(2 * BAR)


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


def test_a_gear_without_a_rotor_is_reported():
    scene = arm_scene(1)
    scene.set_joint("j1", gear_ratio=100.0)
    assert "rotor_inertia" in notes(scene, "ignored")["j1"]
    scene.set_joint("j1", rotor_inertia=1e-4)
    assert "j1" not in notes(scene, "ignored") or "gear_ratio" not in notes(scene, "ignored")["j1"]
    assert scene.model.armature[0] == pytest.approx(1.0)


def test_limits_of_the_file_are_off_by_default():
    scene = arm_scene(2, effort=3.0, velocity=2.0, friction=0.5)
    arrays = scene.built().arrays
    assert not np.isfinite(arrays.actuator).any()
    assert not arrays.joint_friction.any()
    scene.set_actuator("j1", effort=True, velocity=5.0)
    scene.set_joint("j2", friction=True)
    scene.set_servo("j2", 10.0, 1.0)
    arrays = scene.built().arrays
    assert np.array_equal(arrays.actuator, [[3.0, INF], [5.0, INF]])
    assert np.array_equal(arrays.joint_friction, [0.0, 0.5])
    assert np.array_equal(arrays.servo, [[0.0, 10.0], [0.0, 1.0], [0.0, 3.0]])
    assert scene.servo_joints == ["j2"]
    scene.set_actuator("j1", effort=False, velocity=False)
    scene.set_joint("j2", friction=False)
    assert not np.isfinite(scene.built().arrays.actuator).any()
    assert not scene.built().arrays.joint_friction.any()


def test_the_report_lists_everything():
    scene = arm_scene(2, effort=3.0, friction=0.5)
    assert "ignored" in {note.use for note in scene.report.all_notes() if "joint friction" in note.text}
    scene.add_distance("world", "j2", (0, 0, 1.0), name="rod")
    scene.add_spring("world", "j2", 5.0, name="band", tension_only=True)
    scene.add_wrench("j2", (0, 0, 1.0), name="push")
    scene.add_force(lambda t, q, v: 0 * v, name="mine")
    scene.set_joint("j*", friction=True, spring=[1.0, 0.0, 2.0])
    scene.set_servo("j1", 10.0, 1.0)
    scene.set_joint("j1", damping=4.0)
    scene.set_actuator("j2", effort=True)
    used = notes(scene, "used")
    for name, words in {"rod": "distance", "band": "only in tension", "push": "wrench", "mine": "Python"}.items():
        assert words in used[name]
    text = str(scene.report)
    for words in (
        "joint friction of the file 0.5",
        "servo with kp 10",
        "kp = 0.5 s",
        "effort limit of the file 3",
        "1, 0, 2",
    ):
        assert words in text
    assert "joint friction of the file: not used" not in text


def test_functions_are_not_asked_where_there_is_no_state():
    """Diverging iterations hand on numbers that are not finite: what a function made of them was said to be wrong."""
    scene, asked = cvi.Scene(), []
    scene.add_sphere("ball", 0.1)

    def force(t, q, v):
        asked.append((q, v))
        return np.zeros(6)

    def value(q):
        asked.append((q, q))
        return 0.0

    scene.add_force(force, check=False)
    scene.add_potential(value, lambda q: 0.0 * np.asarray(q)[:6], check=False)
    core, q = scene.core(), scene.neutral()
    assert np.isfinite(_core.passive_forces(core, q, np.zeros(6))).all()
    asked.clear()
    for broken, v in ((np.full(7, np.nan), np.zeros(6)), (q, np.full(6, np.inf))):
        assert not np.isfinite(_core.passive_forces(core, broken, v)).all()
    assert all(np.isfinite(q).all() and np.isfinite(v).all() for q, v in asked)
