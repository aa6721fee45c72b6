"""contactvi. setting: impact, dt. Timed: simulate() as a user calls it, and the velocities at the samples."""

from __future__ import annotations

import numpy as np
from worker import Run, measure, steps_per_sample

import contactvi as cvi


def prepare(job: dict, setting: dict) -> Run:
    scene = cvi.Scene()
    scene.add_urdf(job["urdf_file"])
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
    q0 = scene.configuration(dict(zip(job["joints"], job["q0"], strict=True)))
    v0 = scene.velocity(dict(zip(job["joints"], job["v0"], strict=True)), q0)
    columns = [scene.q_index(joint).start for joint in job["joints"]]
    every = steps_per_sample(job, setting["dt"])
    duration = round(job["duration"] / job["sample"]) * every * setting["dt"]

    def run() -> tuple[np.ndarray, np.ndarray]:
        traj = cvi.simulate(scene, q0, v0, duration, setting["dt"], impact=setting["impact"], record_every=every)
        return traj.q[1:, columns], traj.v[1:, columns]

    return run


if __name__ == "__main__":
    measure(prepare)
