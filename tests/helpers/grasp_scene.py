"""The Allegro hand closes around a ball that falls into it: many impacts, beginnings, releases, sticks and slips."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import contactvi as cvi
from helpers.run_scenes import HAND_URDF

# By the number in the joint's name.
OPEN = (0.0, 0.2, 0.2, 0.2) * 3 + (0.8, 0.3, 0.2, 0.2)
CLOSED = (0.0, 1.4, 1.2, 0.8) * 3 + (1.2, 0.3, 0.3, 0.9)


def closed(scene: cvi.Scene) -> np.ndarray:
    """Return the references of the servos, shape (16,)."""
    return np.array([CLOSED[_number(name)] for name in _joints(scene)])


def _joints(scene: cvi.Scene) -> list[str]:
    return [name for name in scene.model.names if name.startswith("joint_")]


def _number(joint: str) -> int:
    return int(joint.removeprefix("joint_").removesuffix(".0"))


def grasp(restitution: float, friction: float) -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
    """Return the scene and its start; all joints are driven by servos, contacts are those of the ball alone."""
    scene = cvi.Scene()
    scene.add_urdf(HAND_URDF, placement=((0.0, 0.0, 0.0), (0.0, -np.pi / 2, 0.0)), limits=False)
    for a, b in list(scene.pair_names):
        scene.disable_pair(a, b)
    joints = _joints(scene)
    for name in joints:
        scene.set_joint(name, damping=0.0, friction=0.0)
    scene.add_sphere("ball", 0.03, mass=0.1)
    scene.set_contact(restitution=restitution, friction=friction)
    q = pin.neutral(scene.model)
    for name in joints:
        number, joint = _number(name), scene.model.getJointId(name)
        scene.set_servo(name, kp=0.5, kd=0.01, target=CLOSED[number])
        q[scene.model.idx_qs[joint]] = OPEN[number]
    q[-7:-4] = [-0.003, -0.016, 0.05]
    return scene, q, np.zeros(scene.nv)
