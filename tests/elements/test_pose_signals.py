"""Prescribed poses: tables, functions and placements, with the velocities that belong to them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.elements.pose_signals import PoseSignal

AXIS = np.array([0.3, 0.5, -1.0])


def screw(t: float) -> pin.SE3:
    return pin.SE3(pin.exp3(AXIS * np.sin(2.0 * t)), np.array([np.sin(t), t, 0.3 * np.cos(2.0 * t)]))


def screw_velocity(t: float) -> tuple[np.ndarray, np.ndarray]:
    """World axes: the axis of the turn is constant."""
    return np.array([np.cos(t), 1.0, -0.6 * np.sin(2.0 * t)]), AXIS * 2.0 * np.cos(2.0 * t)


def moved(signal: PoseSignal, t: float, step: float = 1e-5) -> np.ndarray:
    """The velocity at t by central differences of the poses, (linear, angular)."""
    before, after = signal(t - step), signal(t + step)
    turn = pin.log3(after.rotation @ before.rotation.T)
    return np.concatenate([after.position - before.position, turn]) / (2.0 * step)


@pytest.mark.parametrize("given", ["pose", "pose and velocity", "numbers", "position and quaternion"])
def test_functions(given):
    def function(t):
        place = screw(t)
        q = pin.SE3ToXYZQUAT(place)
        return {
            "pose": place,
            "pose and velocity": (place, screw_velocity(t)),
            "numbers": q,
            "position and quaternion": (q[:3], q[3:]),
        }[given]

    signal = PoseSignal(function, "motion")
    state = signal(0.7)
    np.testing.assert_allclose(state.position, screw(0.7).translation, atol=1e-15)
    np.testing.assert_allclose(state.rotation, screw(0.7).rotation, atol=1e-15)
    v, w = screw_velocity(0.7)
    exact = 0.0 if given == "pose and velocity" else 1e-10  # five points 1e-4 s apart: rounding 1e-16 / 1e-4
    np.testing.assert_allclose(state.velocity, v, atol=exact)
    np.testing.assert_allclose(state.angular_velocity, w, atol=exact)
    assert signal.gives_velocity(0.7) == (given == "pose and velocity")
    assert not signal.storable


def test_velocities_in_other_forms():
    v, w = screw_velocity(0.2)
    for velocity in (np.concatenate([v, w]), [v, w], pin.Motion(v, w)):
        state = PoseSignal(lambda t, velocity=velocity: (screw(t), velocity), "motion")(0.2)
        np.testing.assert_array_equal(state.angular_velocity, w)


def test_a_table_goes_through_its_poses_smoothly():
    times = np.array([0.0, 0.2, 0.5, 0.7, 1.1, 1.3])
    signal = PoseSignal((times, [screw(t) for t in times]), "motion")
    for t in times:
        np.testing.assert_allclose(signal(t).rotation, screw(t).rotation, atol=1e-14)
        np.testing.assert_allclose(signal(t).position, screw(t).translation, atol=1e-15)
    for t in (0.1, 0.33, 0.69, 1.2):
        state = signal(t)
        np.testing.assert_allclose(state.rotation @ state.rotation.T, np.eye(3), atol=1e-14)
        np.testing.assert_allclose([*state.velocity, *state.angular_velocity], moved(signal, t), atol=1e-8)
    for t in times[1:-1]:  # velocities and accelerations are continuous
        for order, size in ((0, 1e-12), (1, 1e-4)):
            ends = []
            for side in (-1.0, 1.0):
                near = [np.concatenate(signal(t + side * step)[2:]) for step in (1e-9, 1e-6)]
                ends.append(near[0] if order == 0 else (near[1] - near[0]) / (side * (1e-6 - 1e-9)))
            np.testing.assert_allclose(ends[0], ends[1], atol=size + 1e-7 * (order == 0))


def test_a_table_converges_to_the_motion_as_a_cubic_spline_does():
    errors = []
    for n in (11, 21, 41):
        times = np.linspace(0.0, 1.0, n)
        signal = PoseSignal({"times": times, "poses": [pin.SE3ToXYZQUAT(screw(t)) for t in times]}, "motion")
        middle = np.linspace(0.3, 0.7, 57)  # away from the ends, whose conditions cost order
        off = [pin.log6(pin.SE3(signal(t).rotation, signal(t).position).actInv(screw(t))).vector for t in middle]
        errors.append(np.abs(off).max())
    assert errors[2] < 1e-5
    assert errors[0] / errors[1] > 10.0  # fourth order: 16
    assert errors[1] / errors[2] > 10.0


def test_data_and_back():
    times = [0.0, 0.5, 1.0]
    table = PoseSignal((times, [pin.SE3ToXYZQUAT(screw(t)) for t in times]), "motion")
    again = PoseSignal(table.to_data(), "motion")
    np.testing.assert_array_equal(again(0.3).rotation, table(0.3).rotation)
    still = PoseSignal(((0.1, 0.2, 0.3), (0.0, 0.5, 0.0)), "motion")
    assert still.storable
    np.testing.assert_allclose(PoseSignal(still.to_data(), "motion")(5.0).rotation, still(0.0).rotation, atol=1e-15)
    np.testing.assert_array_equal(still(1.0).velocity, np.zeros(3))
    assert PoseSignal(screw, "motion").to_data() is None


def test_a_table_goes_on_over_the_differences_at_its_ends():
    """Position along a cubic, which is its own spline; farther out there is nothing."""
    times = np.linspace(0.0, 1.0, 5)
    table = PoseSignal((times, [(0.0, 0.0, t**3 - t, 0.0, 0.0, 0.0, 1.0) for t in times]), "motion")
    for t in (-9e-4, 1.0 + 9e-4):
        np.testing.assert_allclose(table(t).position, [0.0, 0.0, t**3 - t], atol=1e-15)
        np.testing.assert_allclose(table(t).velocity, [0.0, 0.0, 3.0 * t**2 - 1.0], atol=1e-14)
    for t in (-1.1e-3, 1.0 + 1.1e-3):
        with pytest.raises(cvi.UserFunctionError, match="outside its table"):
            table(t)


def test_bad_sources_and_results():
    with pytest.raises(cvi.InputError, match="one length"):
        PoseSignal(([0.0, 1.0], [screw(0.0)]), "motion")
    with pytest.raises(cvi.InputError, match="half a turn"):
        PoseSignal(([0.0, 1.0], [(0, 0, 0, 0, 0, 0, 1), (0, 0, 0, 1, 0, 0, 0)]), "motion")
    with pytest.raises(cvi.InputError, match="increase"):
        PoseSignal(([0.0, 0.0], [screw(0.0), screw(1.0)]), "motion")
    with pytest.raises(cvi.InputError, match="Placement"):
        PoseSignal("up", "motion")
    table = PoseSignal(([0.0, 1.0], [screw(0.0), screw(1.0)]), "motion of 'hand'")
    with pytest.raises(cvi.UserFunctionError, match="outside its table"):
        table(1.5)
    for result, words in ((None, "no pose"), ((1.0, 2.0), "no pose"), ((screw(0.0), 3.0), "no velocity")):
        with pytest.raises(cvi.UserFunctionError, match=f"motion of 'hand' returned {words}.*t = 0.5 s"):
            PoseSignal(lambda t, result=result: result, "motion of 'hand'")(0.5)
    with pytest.raises(cvi.UserFunctionError, match="jumps"):
        PoseSignal(lambda t: (0.0, 0.0, float(t > 0.5)), "motion")(0.5)
    with pytest.raises(cvi.UserFunctionError, match="ZeroDivisionError"):
        PoseSignal(lambda t: 1 / 0, "motion")(0.5)
