"""contactvi. setting: order, dt (a number or "auto"), impact, tol. Timed: simulate() as a user calls it, and q, v.

A dt that divides the sample time has its nodes at the samples; a longer one and "auto" are sampled from the polynomials
of the steps. The error is taken at the samples either way. S7: hand_contactvi.py, lasting
contact: contact_contactvi.py.
"""

from __future__ import annotations

import contact_contactvi
import hand_contactvi
import numpy as np
from worker import Run, measure

import contactvi as cvi

COUNTS = ("steps", "sweeps", "halved", "rejected", "impacts", "seconds")  # seconds: inside the engine


def build(job: dict) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_urdf(job["urdf_file"], base="free" if job["base"] else "fixed", mimic=bool(job["followers"]))
    scene.set_contact(restitution=job["restitution"])
    for joint in job["joints"]:
        scene.set_joint(joint, limits=False)
    if job["wall"] is not None:
        scene.add_halfspace(normal=(-1.0, 0.0, 0.0), offset=-job["wall"], name="wall")
    if job["floor"]:
        scene.add_halfspace(name="floor")
    if job["neighbours"]:
        bodies = [f"L{ball['joint']}" for ball in job["balls"]]
        for a, b in zip(bodies, bodies[1:], strict=False):
            scene.enable_pair(a, b)
    return scene


def start(scene: cvi.Scene, job: dict) -> tuple[np.ndarray, np.ndarray, list[int], list[int]]:
    """q0, v0 and where the job's numbers stand in q and v."""
    joints = [scene.model.joints[scene.model.getJointId(name)] for name in job["joints"]]
    at_q = [*range(len(job["base"])), *(joint.idx_q for joint in joints)]
    at_v = [*range(len(job["base_v"])), *(joint.idx_v for joint in joints)]
    q0, v0 = scene.neutral(), np.zeros(scene.model.nv)
    q0[at_q], v0[at_v] = job["base"] + job["q0"], job["base_v"] + job["v0"]
    return q0, v0, at_q, at_v


def options(job: dict, setting: dict) -> dict:
    """Arguments of simulate for this setting."""
    chosen = {name: value for name, value in setting.items() if name in ("dt", "order", "impact", "tol", "solver_tol")}
    every = None if setting["dt"] == "auto" else job["sample"] / setting["dt"]
    if every is not None and every > 0.99 and abs(every - round(every)) < 1e-6:
        # A dt written as a decimal would miss the duration by rounding.
        chosen.update(dt=job["sample"] / round(every), record_every=round(every), dense=False)
    else:
        chosen["sample_dt"] = job["sample"]
    return chosen


def prepare(job: dict, setting: dict) -> Run:
    if job["name"] == "S7":
        return hand_contactvi.prepare(job, setting)
    if job["name"].startswith("contact "):
        return contact_contactvi.prepare(job, setting)
    scene = build(job)
    q0, v0, at_q, at_v = start(scene, job)
    duration, chosen = job["duration"], options(job, setting)

    def run() -> tuple[np.ndarray, np.ndarray, dict]:
        traj = cvi.simulate(scene, q0, v0, duration, **chosen)
        counts = {name: getattr(traj.stats, name, None) for name in COUNTS}
        return traj.q[1:, at_q], traj.v[1:, at_v], counts

    return run


if __name__ == "__main__":
    measure(prepare)
