"""A wrong entry of a user's derivative is found and named; correct derivatives pass, on Lie groups too."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.loop_scenes import arm_scene


def scene_with_ball() -> cvi.Scene:
    scene = arm_scene(2)
    scene.add_sphere("ball", 0.1, placement=((0.3, 0.2, 1.0), (0.3, 0.2, 0.1)))
    return scene


class Anchor:
    """A quadratic potential of the tangent distance from neutral; entry `wrong` of the gradient has the wrong sign."""

    def __init__(self, scene: cvi.Scene, wrong: int | None = None) -> None:
        self.model, self.start = scene.model, scene.neutral()
        self.weights = np.arange(1.0, self.model.nv + 1.0)
        self.wrong = wrong

    def value(self, q):
        away = pin.difference(self.model, self.start, q)
        return 0.5 * away @ (self.weights * away)

    def gradient(self, q):
        away = pin.difference(self.model, self.start, q)
        result = pin.dDifference(self.model, self.start, q, pin.ARG1).T @ (self.weights * away)
        if self.wrong is not None:
            result[self.wrong] *= -1.0
        return result


def drag(t, q, v):
    return -np.abs(v) * v


def drag_derivatives(t, q, v, wrong=()):
    n = len(v)
    by_q, by_v = np.zeros((n, n)), np.diag(-2.0 * np.abs(v))
    for row, column in wrong:
        by_v[row, column] += 1e-3
    return by_q, by_v


def test_right_derivatives_pass():
    scene = scene_with_ball()
    scene.add_potential(Anchor(scene))
    scene.add_force(drag, drag_derivatives)
    scene.prescribe("j1", lambda t: (math.sin(t), math.cos(t), -math.sin(t)))
    cvi.check_derivatives(scene)
    cvi.check_derivatives(scene, scene.neutral(), np.ones(scene.nv), 0.3)


@pytest.mark.parametrize("wrong", [0, 1, 4, 7])
def test_a_wrong_gradient_is_named(wrong):
    scene = scene_with_ball()
    scene.add_potential(Anchor(scene, wrong), name="anchor")
    with pytest.raises(cvi.DerivativeError) as caught:
        cvi.check_derivatives(scene)
    error = caught.value
    name = ["j1", "j2", *(f"ball[{k}]" for k in range(6))][wrong]
    assert (error.function, error.column, error.dof) == ("gradient of 'anchor'", wrong, (name,))
    assert f"at entry {wrong} ({name})" in str(error)
    expected = float(str(error.expected).split()[0])
    assert expected == pytest.approx(-float(error.got), rel=1e-6)


def test_a_wrong_entry_of_a_matrix_is_named():
    scene = scene_with_ball()
    scene.add_force(drag, lambda t, q, v: drag_derivatives(t, q, v, [(1, 4)]), name="drag")
    with pytest.raises(cvi.DerivativeError) as caught:
        cvi.check_derivatives(scene)
    error = caught.value
    assert (error.function, error.row, error.column) == ("df_dv of 'drag'", 1, 4)
    assert error.dof == ("j2", "ball[2]")
    assert error.error == pytest.approx(1e-3, rel=1e-6)
    assert "in row 1 (j2), column 4 (ball[2])" in str(error)


def test_several_wrong_entries_are_counted():
    scene = scene_with_ball()
    scene.add_force(drag, lambda t, q, v: drag_derivatives(t, q, v, [(0, 0), (3, 2)]))
    with pytest.raises(cvi.DerivativeError, match="2 of 64 entries are wrong"):
        cvi.check_derivatives(scene)


def test_a_wrong_rate_of_a_motion_is_named():
    scene = scene_with_ball()
    scene.prescribe("j1", lambda t: (math.sin(t), math.sin(t)))
    with pytest.raises(cvi.DerivativeError, match="rate of motion of joint 'j1'"):
        cvi.check_derivatives(scene)


def test_functions_alone_can_be_checked():
    good = (drag, drag_derivatives)
    cvi.check_derivatives(good, np.zeros(3), np.array([1.0, -2.0, 0.5]))
    bad = (drag, lambda t, q, v: (np.zeros((3, 3)), np.diag(np.abs(v))))
    with pytest.raises(cvi.DerivativeError, match="df_dv"):
        cvi.check_derivatives(bad, np.zeros(3), np.array([1.0, -2.0, 0.5]))
    scene = scene_with_ball()
    cvi.check_derivatives(Anchor(scene), scene=scene)
    with pytest.raises(cvi.InputError, match="a pair"):
        cvi.check_derivatives(3)


@pytest.mark.parametrize("value", [np.zeros(3), math.nan])
def test_wrong_shapes_and_numbers_are_named(value):
    scene = scene_with_ball()

    def gradient(q):
        result = np.zeros(8)
        result[3] = math.nan
        return value if np.shape(value) == (3,) else result

    scene.add_potential(lambda q: 0.0, gradient, name="odd")
    with pytest.raises(cvi.UserFunctionError, match="gradient of 'odd'") as caught:
        cvi.check_derivatives(scene)
    if np.shape(value) == ():
        assert caught.value.entry == "at entry 3 (ball[1])"


def test_the_start_of_a_run_checks_too():
    scene = scene_with_ball()
    name = scene.add_potential(Anchor(scene, 3))
    q = pin.integrate(scene.model, scene.neutral(), np.full(scene.nv, 0.1))
    with pytest.raises(cvi.DerivativeError):
        cvi.Simulator(scene, dt=1e-3).reset(q)
    scene.remove(name)
    scene.add_potential(Anchor(scene, 3), check=False)
    cvi.Simulator(scene, dt=1e-3).reset(q)


@pytest.mark.parametrize(
    "bad", [{"v": [1.0]}, {"v": "ab"}, {"t": "now"}, {"t": math.nan}, {"tolerance": -1.0}, {"q": [1.0]}, {"scene": 3}]
)
def test_bad_arguments_are_named(bad):
    scene = scene_with_ball()
    (name,) = bad
    with pytest.raises(cvi.InputError) as caught:
        cvi.check_derivatives(scene, **bad)
    assert caught.value.name == name


def test_what_vanishes_at_the_start_is_checked_beside_it():
    scene = arm_scene(2)
    scene.add_potential(lambda q: q[0] ** 2 * q[1], lambda q: np.array([2.0 * q[0] * q[1], -(q[0] ** 2)]), name="hill")
    with pytest.raises(cvi.DerivativeError, match=r"gradient of 'hill' is wrong at entry 1"):
        cvi.simulate(scene, scene.neutral(), duration=0.01, dt=1e-3)


def test_a_function_need_not_be_defined_beside_the_start():
    scene = arm_scene(1)
    scene.add_potential(lambda q: 0.0 if q[0] < 1e-3 else math.sqrt(-q[0]), lambda q: np.zeros(1))
    cvi.simulate(scene, scene.neutral(), np.zeros(1), duration=2e-3, dt=1e-3)
