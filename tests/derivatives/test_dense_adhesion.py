"""The derivatives of dense steps with adhesion, by the time and of bodies, against differences of the runs, and the
adjoint against the tangent."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import transpose_error
from derivatives.test_dense_sensitivity import DENSE, Start, compare


def pull(t: float) -> float:
    return 5.0 + 2.0 * math.sin(5.0 * t)


def body(shape: str, gravity: list[float], friction: float, **contact) -> Start:
    """A ball or box near the ground, turned and moved."""
    scene = cvi.Scene(gravity=gravity)
    scene.add_halfspace(name="ground")
    if shape == "ball":
        scene.add_sphere("body", 0.1, mass=0.7)
    else:
        scene.add_box("body", (0.2, 0.3, 0.25), mass=0.7)
    scene.set_contact("body", "ground", restitution=0.0, friction=friction, **contact)
    turned = np.array([0.0, 0.0, 0.0, 0.4, -0.3, 0.2])
    q = pin.integrate(scene.model, pin.neutral(scene.model), turned)
    up = pin.Quaternion(q[3:7]).matrix()[2]
    q[2] = (0.1 if shape == "ball" else np.abs(up) @ [0.1, 0.15, 0.125]) + 0.001
    v = np.array([0.3, -0.2, -0.1, 0.5, 1.0, -0.4])
    v[:3] = pin.Quaternion(q[3:7]).matrix().T @ v[:3]  # down, in the axes of the body
    return scene, q, v


def two_balls() -> Start:
    """One under the other; what both of them have on their bodies holds the upper one to the lower one."""
    scene = cvi.Scene(gravity=(0.5, 0.0, -9.81))
    scene.add_halfspace(name="ground")
    scene.add_sphere("lower", 0.1, mass=1.0)
    scene.add_sphere("upper", 0.08, mass=0.4)
    scene.set_contact(restitution=0.0, friction=0.3)
    scene.set_contact("lower", "upper", adhesion=3.0)
    scene.set_body_adhesion("upper", lambda t: 2.0 + t)
    q = np.array([0.0, 0.0, 0.1005, 0, 0, 0, 1, 0.03, 0.02, 0.278, 0, 0, 0, 1], dtype=float)
    return scene, q, np.array([0.1, 0.0, -0.1, 0.0, 0.3, 0.2, 0.1, 0.2, -0.2, 0.4, 0.0, 0.1])


DOWN, UP, SLOPE = [0.0, 0.0, -9.81], [0.0, 0.0, 4.0], [2.0, 0.0, -9.0]
STARTS = {
    "a ball that slips": lambda: body("ball", SLOPE, 0.3, adhesion=pull),
    "a ball without friction": lambda: body("ball", SLOPE, 0.0, adhesion=pull),
    "a ball that hangs": lambda: body("ball", UP, 0.3, adhesion=pull),
    "a ball that is let go": lambda: body("ball", UP, 0.3, adhesion=[(0.0, 6.0), (0.05, 6.0), (0.1, 0.5), (1.0, 0.5)]),
    "a corner": lambda: body("box", DOWN, 0.4, adhesion=4.0),
    "two balls": two_balls,
}


@pytest.mark.filterwarnings("ignore::contactvi.ApproximateDerivativeWarning")
@pytest.mark.parametrize("name", STARTS)
def test_derivatives_are_those_of_differences(name: str) -> None:
    start = STARTS[name]()
    scene, q, v = start
    options = {"duration": 0.15, "dt": 0.01, **DENSE}
    run = cvi.simulate(scene, q, v, record="gradient", **options)
    assert len(run.dense_steps)
    assert len(run.contacts)
    S = run.sensitivity()
    assert transpose_error(run, ["q0", "v0", "control", "gravity"]) <= 1e-9
    directions = np.random.default_rng(3).standard_normal((2 * scene.nv, 4))
    compare(S, start, directions / np.linalg.norm(directions, axis=0), (1e-6, 5e-7), options)


def test_a_stored_run_has_the_same_derivatives(tmp_path) -> None:
    scene, q, v = body("ball", SLOPE, 0.3, adhesion=4.0)
    run = cvi.simulate(scene, q, v, record="gradient", duration=0.15, dt=0.01, **DENSE)
    run.save(tmp_path / "run.npz")
    again = cvi.Trajectory.load(tmp_path / "run.npz")
    assert np.array_equal(run.sensitivity().matrix, again.sensitivity().matrix)
