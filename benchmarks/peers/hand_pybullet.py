"""S7 in PyBullet, contacts as it has them. setting: dt.

Each step is a call from Python, and so is the PD controller: joint states, torques by NumPy, one call that sets them,
all at the start of the step (explicit). The count `inside` is the time spent in stepSimulation alone.
"""

from __future__ import annotations

import math
import time

import numpy as np
import pybullet as pb
from worker import Run, steps_per_sample


def build(job: dict, setting: dict, world: dict) -> tuple[int, list[int], int]:
    """The hand, its joints, the ball."""
    pb.setGravity(0, 0, -job["gravity"], **world)
    pb.setTimeStep(setting["dt"], **world)
    hand = pb.loadURDF(job["urdf_file"], useFixedBase=True, flags=pb.URDF_USE_INERTIA_FROM_FILE, **world)
    number = {pb.getJointInfo(hand, k, **world)[1].decode(): k for k in range(pb.getNumJoints(hand, **world))}
    joints = [number[name] for name in job["joints"]]
    shape = pb.createCollisionShape(pb.GEOM_SPHERE, radius=job["ball"]["radius"], **world)
    ball = pb.createMultiBody(job["ball"]["mass"], shape, **world)
    # A pair has the product of the frictions of its bodies.
    surface = {"restitution": 0, "lateralFriction": math.sqrt(job["friction"]), "spinningFriction": 0}
    still = {"rollingFriction": 0, "linearDamping": 0, "angularDamping": 0, "jointDamping": 0}
    for body, link in ((ball, -1), (hand, -1), *((hand, joint) for joint in joints)):
        pb.changeDynamics(body, link, **surface, **still, **world)
    inertia = 0.4 * job["ball"]["mass"] * job["ball"]["radius"] ** 2
    pb.changeDynamics(ball, -1, localInertiaDiagonal=[inertia] * 3, **world)
    for joint in joints:  # lower above upper: no limits
        pb.changeDynamics(hand, joint, jointLowerLimit=1, jointUpperLimit=-1, **world)
    pb.setJointMotorControlArray(hand, joints, pb.VELOCITY_CONTROL, forces=[0] * len(joints), **world)
    return hand, joints, ball


def prepare(job: dict, setting: dict) -> Run:
    world = {"physicsClientId": pb.connect(pb.DIRECT)}
    hand, joints, ball = build(job, setting, world)
    goal, kp, kd, effort = np.array(job["goal"]), job["kp"], job["kd"], job["effort"]
    steps, samples = steps_per_sample(job, setting["dt"]), round(job["duration"] / job["sample"])
    start = setting.get("start", job["start"])

    def reset() -> None:
        for joint, q, v in zip(joints, start["q"], start["v"], strict=False):
            pb.resetJointState(hand, joint, q, v, **world)
        pb.resetBasePositionAndOrientation(ball, start["q"][16:], [0, 0, 0, 1], **world)
        pb.resetBaseVelocity(ball, start["v"][16:19], start["v"][19:], **world)

    def state() -> tuple[np.ndarray, np.ndarray]:
        found = pb.getJointStates(hand, joints, **world)
        return np.array([s[0] for s in found]), np.array([s[1] for s in found])

    def run() -> tuple[list, list, dict]:
        reset()
        out: tuple[list, list] = ([], [])
        inside = 0.0
        for _ in range(samples):
            for _ in range(steps):
                q, v = state()
                torque = np.clip(kp * (goal - q) - kd * v, -effort, effort)
                pb.setJointMotorControlArray(hand, joints, pb.TORQUE_CONTROL, forces=torque, **world)
                began = time.perf_counter()
                pb.stepSimulation(**world)
                inside += time.perf_counter() - began
            q, v = state()
            out[0].append(np.concatenate([q, pb.getBasePositionAndOrientation(ball, **world)[0]]))
            out[1].append(np.concatenate([v, *pb.getBaseVelocity(ball, **world)]))
        return *out, {"inside": inside}

    return run
