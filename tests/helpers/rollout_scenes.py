"""Scenes and starts of the tests of batches of runs: each run has an impact."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import contactvi as cvi

MODELS = Path(__file__).resolve().parents[2] / "models"
STEPS = 70  # a step is 10 ms, and the pendulum hits the wall at 0.657 s
SETTINGS: dict[str, Any] = {"dt": 0.01, "order": 4, "solver_tol": 1e-14}
Start = tuple[cvi.Scene, np.ndarray, np.ndarray]


def at_wall() -> Start:
    """A double pendulum that hits a wall."""
    scene = cvi.load_scene(MODELS / "double_pendulum_wall.toml")
    scene.set_contact(restitution=0.7)
    return scene, np.array([0.3, 0.2]), np.array([0.1, -0.2])


def servo_arm() -> Start:
    """The double pendulum with two servos."""
    scene, q, v = at_wall()
    for joint in list(scene.model.names)[1:]:
        scene.set_servo(str(joint), kp=20.0, kd=2.0)
    return scene, q, v


def thrown_ball() -> Start:
    """A turning ball that bounces on the ground with friction; q has a quaternion."""
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1, mass=2.0)
    scene.add_halfspace()
    scene.set_contact(restitution=0.6, friction=0.2)
    turn = pin.exp3_quat(np.array([0.3, -0.5, 0.8]))
    return scene, np.r_[0.1, 0.2, 0.4, turn], np.array([1.0, 0.5, 0.0, 2.0, -3.0, 1.0])


def thrown_box() -> Start:
    """A turning box that hits the ground with friction."""
    scene = cvi.Scene()
    scene.add_box("box", (0.2, 0.3, 0.25), mass=1.3)
    scene.add_halfspace()
    scene.set_contact(restitution=0.6, friction=0.25)
    q = pin.SE3ToXYZQUAT(pin.SE3(pin.rpy.rpyToMatrix(0.4, 0.7, 0.2), np.array([0.0, 0.0, 0.5])))
    return scene, q, np.array([2.0, 0.5, 0.0, 1.0, -2.0, 0.5])


def starts(q: np.ndarray, count: int) -> np.ndarray:
    """Starts near q, (count, nq)."""
    return q + 0.01 * np.arange(count)[:, None]
