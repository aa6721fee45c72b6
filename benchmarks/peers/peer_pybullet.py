"""PyBullet, fixed step. setting: dt. One call from Python per step: there is no batched one. S7: hand_pybullet.py."""

from __future__ import annotations

import hand_pybullet
import pybullet as pb
from worker import Run, measure, steps_per_sample


def prepare(job: dict, setting: dict) -> Run:
    if job["name"] == "S7":
        return hand_pybullet.prepare(job, setting)
    world = {"physicsClientId": pb.connect(pb.DIRECT)}
    pb.setGravity(0, 0, -job["gravity"], **world)
    pb.setTimeStep(setting["dt"], **world)
    if job["balls"]:
        pb.setPhysicsEngineParameter(numSolverIterations=200, restitutionVelocityThreshold=0, erp=0, contactERP=0,
                                     contactBreakingThreshold=1e-5, **world)  # fmt: skip
    flags = pb.URDF_USE_INERTIA_FROM_FILE | (pb.URDF_USE_SELF_COLLISION if job["neighbours"] else 0)
    robot = pb.loadURDF(job["urdf_file"], useFixedBase=True, flags=flags, **world)
    number = {pb.getJointInfo(robot, k, **world)[1].decode(): k for k in range(pb.getNumJoints(robot, **world))}
    joints = [number[name] for name in job["joints"]]
    surface = {"lateralFriction": 0, "spinningFriction": 0, "rollingFriction": 0}
    still = {"linearDamping": 0, "angularDamping": 0, "jointDamping": 0}
    for link in (-1, *joints):
        pb.changeDynamics(robot, link, restitution=job["restitution"], **still, **surface, **world)
    for link in joints:  # lower above upper: no limits
        pb.changeDynamics(robot, link, jointLowerLimit=1, jointUpperLimit=-1, **world)
    pb.setJointMotorControlArray(robot, joints, pb.VELOCITY_CONTROL, forces=[0] * len(joints), **world)
    place = [job["wall"] + 1, 0, 0] if job["wall"] is not None else [0, 0, -1] if job["floor"] else None
    if place is not None:
        half = [1, 5, 5] if job["wall"] is not None else [5, 5, 1]
        box = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=half, **world)
        solid = pb.createMultiBody(0, box, basePosition=place, **world)
        pb.changeDynamics(solid, -1, restitution=1, **surface, **world)  # the pair has the product
    steps, samples = steps_per_sample(job, setting["dt"]), round(job["duration"] / job["sample"])

    def run() -> tuple[list, list]:
        for joint, q, v in zip(joints, job["q0"], job["v0"], strict=True):
            pb.resetJointState(robot, joint, q, v, **world)
        out: tuple[list, list] = ([], [])
        for _ in range(samples):
            for _ in range(steps):
                pb.stepSimulation(**world)
            states = pb.getJointStates(robot, joints, **world)
            out[0].append([state[0] for state in states])
            out[1].append([state[1] for state in states])
        return out

    return run


if __name__ == "__main__":
    measure(prepare)
