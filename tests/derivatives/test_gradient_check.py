"""cvi.check_gradient: what it believes of columns with known answers."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.test_persistent_sensitivity import arm, ball_on_ball
from derivatives.test_sensitivity import at_wall, falling
from helpers import constrained_scenes
from helpers.run_scenes import slider_scene


def test_parameters_of_the_scene_are_not_compared():
    with pytest.raises(cvi.InputError, match="mass:ball"):
        cvi.check_gradient(cvi.Scene(), duration=0.1, dt=0.01, wrt=["mass:ball"])


def test_all_columns_of_a_turning_box_agree():
    scene, q, v = falling("box", e=0.6, mu=0.1)
    found = cvi.check_gradient(scene, q, v, duration=0.3, dt=0.01, order=4)
    assert found.ok
    assert found.of == len(found.columns) == 20
    assert {column.believe for column in found.columns} == {"both"}
    by_name = {column.name: column for column in found.columns}
    assert by_name["friction"].state.size > 1.0
    assert by_name["v0[2] body[2]"].times.size > 0.01
    for column in found.columns:
        assert column.worse.relative_difference <= 1e-7
        assert column.worse.relative_own <= 1e-6
    assert str(found) == "20 of 20 columns compared: 20 agree to 1e-07"


def test_inputs_are_those_of_the_run():
    """A feedback law and the start of a servo are no part of the derivative."""
    scene, q, v = at_wall(0.7)
    scene.set_servo("*", kp=20.0, kd=2.0)
    options = {"duration": 0.3, "dt": 0.01, "order": 2, "wrt": ["q0", "v0"]}
    found = cvi.check_gradient(scene, q, v, control=lambda t, q, v: -3.0 * q, **options)
    assert [column.believe for column in found.columns] == ["both"] * 4


HELD = {
    "an arm slips": (lambda: arm(0.1), 0.7),
    "an arm with joint friction": (lambda: arm(0.2, 1.0), 0.7),
    "a ball slips, and leaves a ball": (lambda: ball_on_ball(0.1), 0.6),
    "a four-bar linkage": (constrained_scenes.linkage, 0.2),
    "a four-bar linkage with joint friction": (lambda: constrained_scenes.linkage(joint_friction=1.0), 0.2),
}


@pytest.mark.thinned(3)
@pytest.mark.parametrize("order", [4, 6])
@pytest.mark.parametrize("name", HELD)
def test_differences_have_the_steps_of_runs_for_derivatives(name, order):
    """Of the order of the run, with contacts, joint friction and constraints."""
    make, duration = HELD[name]
    scene, q, v = make()
    if "linkage" in name:
        q, v = constrained_scenes.on_constraints(scene, q, v)
    # What sticks when is a matter of the steps, which makes jumps of their error in the differences.
    found = cvi.check_gradient(scene, q, v, duration, 0.005, order=order)
    assert {column.believe for column in found.columns} == {"both"}
    assert max(column.worse.relative_difference for column in found.columns) <= 1e-8


@pytest.mark.parametrize("e", [0.4, 1.0])
def test_restitution_of_limits_also_at_the_end_of_its_range(e):
    """One-sided differences at 1. At 0 the joint stays at its limit: a persistent contact."""
    scene = slider_scene(e)
    scene.set_contact(restitution=0.3)
    found = cvi.check_gradient(scene, duration=0.3, dt=0.01, order=4, wrt=["v0", "restitution", "control"])
    assert [column.believe for column in found.columns] == ["both"] * 3
    assert found.columns[1].state.size > 0.1


def test_one_pair_alone():
    scene, q, v = falling("box", mu=0.1)
    found = cvi.check_gradient(scene, q, v, 0.4, 0.01, wrt=["restitution:body|ground", "friction:ground|body"])
    assert [column.name for column in found.columns] == ["restitution:body|ground", "friction:ground|body"]
    assert found.ok
    assert all(column.state.size > 0.1 for column in found.columns)


def test_a_chaotic_run_believes_the_exact_derivative():
    """Where changes grow beyond what differences can follow, that is said, and is no fault."""
    scene, q, v = at_wall(1.0)
    found = cvi.check_gradient(scene, 2.0 * q, 4.0 * v, 20.0, 0.02, order=4, wrt="v0", tolerance=1e-14)
    assert found.ok
    assert {column.believe for column in found.columns} == {"exact"}
    assert "digits lost" in found.columns[0].reason


def test_a_sample_has_all_names_and_is_the_same_again():
    scene, q, v = falling("sphere")
    twice = [cvi.check_gradient(scene, q, v, 0.05, 0.01, columns=5, seed=3).columns for _ in range(2)]
    assert [column.name for column in twice[0]] == [column.name for column in twice[1]]
    assert {column.name.partition("[")[0] for column in twice[0]} == {
        "q0", "v0", "control", "restitution", "friction"
    }  # fmt: skip


def test_progress_and_what_is_refused():
    scene, q, v = falling("sphere")
    seen = []
    cvi.check_gradient(scene, q, v, 0.05, 0.01, wrt="v0", progress=lambda done, text: seen.append((done, text)))
    assert [text for _, text in seen] == [f"v0[{k}] body[{k}]" for k in range(6)]
    with pytest.raises(cvi.InputError, match="columns"):
        cvi.check_gradient(scene, q, v, 0.05, 0.01, columns=1.5)
    flat = cvi.Scene()
    flat.add_box("body", [0.2, 0.3, 0.25])
    flat.add_halfspace()
    start = pin.neutral(flat.model)
    start[2] = 0.3
    with pytest.raises(cvi.NotDifferentiable):
        cvi.check_gradient(flat, start, np.zeros(6), 0.3, 0.01)
