"""Runs with forces that no accuracy can be kept with: they end, and say why."""

from __future__ import annotations

import warnings

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi

FAR = (4e16, 0.0, 0.0)


def test_a_truncation_that_is_rounding_does_not_shorten_steps():
    """A constant force of 4e16 N: polynomials of degree 2 leave nothing out, and rounding is meters."""
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1, placement=(0.0, 0.0, 1.0))
    scene.add_tape_spring([("ball", (0.0, 0.0, 0.0)), ("world", FAR)], 1.0, rest_length=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cvi.AccuracyWarning)
        traj = cvi.simulate(scene, dt="auto", duration=1.0)
    assert traj.stats.steps < 1000
    assert traj.stats.rejected < 1000
    assert traj.error_estimate > 1.0  # [m]: and it says so
    # The harmonic motion around the far end of the tape, of unit mass and stiffness; the spin stays zero.
    assert traj.q[-1, 0] == pytest.approx(FAR[0] * (1.0 - np.cos(1.0)), rel=1e-12)


def test_too_many_steps_for_the_memory_end_a_run():
    """A pendulum with a force that lets it swing 3e7 times a second: 1e8 steps, tens of gigabytes."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0])))
    model.addFrame(pin.Frame("bob", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    scene = cvi.Scene.from_pinocchio(model)
    scene.add_tape_spring([("bob", (0.0, 0.0, -1.0)), ("world", FAR)], 1.0, rest_length=1.0)
    with pytest.raises(cvi.SimulationError, match="TOO_MANY_STEPS: the accuracy needs steps of .*larger tol") as caught:
        cvi.simulate(scene, dt="auto", duration=1.0)
    assert caught.value.trajectory.status.code == cvi.StatusCode.TOO_MANY_STEPS
    assert cvi.simulate(scene, dt="auto", duration=1e-7).status.ok  # the same motion, for some swings


@pytest.mark.parametrize("dt", [1e-2, "auto"])
def test_a_start_of_infinite_energy_is_refused(dt):
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1, placement=(0.0, 0.0, 1.0))
    for name in ("one", "two"):  # each is finite, and their sum is not
        scene.add_potential(lambda q: 1e308 + q[2], lambda q: np.eye(6)[2], check=False, name=name)
    with pytest.raises(cvi.SimulationError, match="energy of the start state is not finite"):
        cvi.simulate(scene, duration=0.1, dt=dt)
