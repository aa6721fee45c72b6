"""MuJoCo. setting: integrator, dt; with contacts kdt2, the contact stiffness being kdt2 / dt^2.

Its contact is soft by design. Here it is a spring of that stiffness (solref = -k, -b, impedance 0.9999) with the
damping that gives the wanted restitution. Mimic joints, which its reader makes joint equalities, are springs of that
stiffness, too, critically damped. All steps between two samples are one call. S7:
hand_mujoco.py, lasting contact: contact_mujoco.py.
"""

from __future__ import annotations

import math

import contact_mujoco
import hand_mujoco
import mujoco
import numpy as np
from worker import Run, measure, steps_per_sample


def damping_ratio(restitution: float) -> float:
    """Ratio of a spring-damper that pushes only and returns a mass with this restitution; by bisection.

    In units of the natural frequency x = exp(-z t) sin(w t) / w; contact ends where the force x + 2 z x' is zero.
    """
    low, high = 0.0, 0.99
    for _ in range(60):
        z = 0.5 * (low + high)
        w = math.sqrt(1.0 - z * z)
        end = math.atan2(2 * z * w, 2 * z * z - 1.0) / w
        back = -math.exp(-z * end) * (math.cos(w * end) - z / w * math.sin(w * end))
        low, high = (z, high) if back > restitution else (low, z)
    return low if restitution < 1.0 else 0.0


def prepare(job: dict, setting: dict) -> Run:
    if job["name"] == "S7":
        return hand_mujoco.prepare(job, setting)
    if job["name"].startswith("contact "):
        return contact_mujoco.prepare(job, setting)
    dt, plane = setting["dt"], mujoco.mjtGeom.mjGEOM_PLANE
    spec = mujoco.MjSpec.from_file(job["urdf_file"])
    if job["wall"] is not None:
        turn = [math.sqrt(0.5), 0.0, -math.sqrt(0.5), 0.0]  # the plane's normal along -x
        spec.worldbody.add_geom(type=plane, size=[5, 5, 1], pos=[job["wall"], 0, 0], quat=turn)
    if job["floor"]:
        spec.worldbody.add_geom(type=plane, size=[5, 5, 1])
    if job["base"]:
        spec.worldbody.first_body().add_freejoint()
    model = spec.compile()
    model.opt.timestep = dt
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{setting['integrator'].upper()}")
    model.opt.gravity[:] = 0.0, 0.0, -job["gravity"]
    model.jnt_limited[:] = 0
    if "kdt2" in setting:
        stiffness = setting["kdt2"] / dt**2
        model.eq_solref[:] = -stiffness, -2.0 * math.sqrt(stiffness)
        model.eq_solimp[:] = 0.9999, 0.9999, 0.001, 0.5, 2.0
        model.geom_solref[:] = -stiffness, -2.0 * damping_ratio(job["restitution"]) * math.sqrt(stiffness)
        model.geom_solimp[:] = 0.9999, 0.9999, 0.001, 0.5, 2.0
        model.geom_condim[:] = 1
        model.opt.tolerance = 1e-14
    if not job["balls"]:
        model.geom_contype[:] = model.geom_conaffinity[:] = 0
    data = mujoco.MjData(model)
    joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in job["joints"]]
    at_q, at_v = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    base = 7 if job["base"] else 0  # position and quaternion, w first
    steps, samples = steps_per_sample(job, dt), round(job["duration"] / job["sample"])

    def run() -> tuple[list, list]:
        mujoco.mj_resetData(model, data)
        data.qpos[at_q], data.qvel[at_v] = job["q0"], job["v0"]
        if base:  # upright at the start: world and body axes agree
            data.qpos[:7], data.qvel[:6] = np.array(job["base"])[[0, 1, 2, 6, 3, 4, 5]], job["base_v"]
        q: list[np.ndarray] = []
        v: list[np.ndarray] = []
        for _ in range(samples):
            mujoco.mj_step(model, data, steps)
            place = data.qpos[[0, 1, 2, 4, 5, 6, 3][:base]]
            q.append(np.concatenate([place, data.qpos[at_q]]))
            v.append(data.qvel[at_v].copy())
        return q, v

    return run


if __name__ == "__main__":
    measure(prepare)
