"""S7 in contactvi. setting: order, dt, dt_contact. Timed: simulate() as a user calls it, all contact forces kept."""

from __future__ import annotations

import numpy as np
from worker import Run, steps_per_sample

import contactvi as cvi

COUNTS = (
    "steps", "sweeps", "impacts", "seconds", "guards_evaluated", "guards_skipped", "held_steps", "contact_rounds",
    "cone_problems", "cone_iterations", "cone_fallbacks", "contact_seconds",
)  # fmt: skip


def build(job: dict) -> tuple[cvi.Scene, np.ndarray]:
    """The scene and its start."""
    scene, ball = cvi.Scene(), job["ball"]
    hand = scene.add_urdf(job["urdf_file"], base="fixed")
    scene.add_sphere("ball", ball["radius"], ball["mass"], placement=ball["position"])
    scene.set_contact(restitution=0.0, friction=job["friction"])
    scene.disable_pair(hand, hand)
    for name, goal in zip(job["joints"], job["goal"], strict=True):
        scene.set_joint(name, stiffness=job["stiffness"], damping=job["damping"], rest=goal, limits=False)
    q0 = scene.neutral()
    q0[[scene.model.joints[scene.model.getJointId(name)].idx_q for name in job["joints"]]] = job["q0"]
    return scene, q0


def prepare(job: dict, setting: dict) -> Run:
    scene, q0 = build(job)
    at = [scene.model.joints[scene.model.getJointId(name)].idx_q for name in job["joints"]]  # idx_v is the same
    every = steps_per_sample(job, setting["dt"])

    def run() -> tuple[np.ndarray, np.ndarray, dict]:
        traj = cvi.simulate(scene, q0, np.zeros(scene.nv), job["duration"], record_every=every, **setting)
        counts = {name: getattr(traj.stats, name) for name in COUNTS}
        counts["overlap"] = -float(traj.contacts.array("gap").min())  # of every step
        counts["contacts"] = len(traj.contacts.at(traj.t[-1]))
        q, v = traj.q[1:], traj.v[1:]
        return np.hstack([q[:, at], q[:, 16:19]]), np.hstack([v[:, at], v[:, 16:]]), counts

    return run
