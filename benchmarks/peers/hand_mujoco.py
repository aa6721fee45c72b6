"""S7 in MuJoCo. setting: integrator, dt, cone, stiff (the contact's time constant is 2 dt, else as MuJoCo has it),
squeeze (whether the contact forces are summed, as in hand.py; such a run is not for timing).

The controllers are position actuators with kp and kv (implicitfast takes the kv implicitly, Euler does not); ball
against hand only, by contact bits.
"""

from __future__ import annotations

import mujoco
import numpy as np
from worker import Run, steps_per_sample


def build(job: dict, setting: dict) -> mujoco.MjModel:
    spec, ball = mujoco.MjSpec.from_file(job["urdf_file"]), job["ball"]
    friction = [job["friction"], 0.005, 0.0001]  # sliding; the others need condim > 3
    for geom in spec.geoms:
        geom.contype, geom.conaffinity, geom.friction = 1, 2, friction
    body = spec.worldbody.add_body(name="ball")
    body.add_freejoint()
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[ball["radius"], 0, 0], mass=ball["mass"], contype=2, conaffinity=1,
        friction=friction,
    )  # fmt: skip
    for name in job["joints"]:
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=job["kp"], kv=job["kd"])
        servo.forcelimited, servo.forcerange = 1, [-job["effort"], job["effort"]]
    model = spec.compile()
    model.opt.timestep = setting["dt"]
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{setting['integrator'].upper()}")
    model.opt.cone = getattr(mujoco.mjtCone, f"mjCONE_{setting.get('cone', 'pyramidal').upper()}")
    model.opt.gravity[:] = 0.0, 0.0, -job["gravity"]
    model.jnt_limited[:] = 0
    if setting.get("stiff"):
        model.geom_solref[:, 0] = 2.0 * setting["dt"]
    return model


SQUEEZE = 0.5  # s, as in hand.py, which needs packages that this interpreter may lack


def total_normal_force(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Of all contacts in the step just made [N]."""
    force, total = np.zeros(6), 0.0
    for k in range(data.ncon):
        mujoco.mj_contactForce(model, data, k, force)
        total += float(force[0])
    return total


def prepare(job: dict, setting: dict) -> Run:
    model = build(job, setting)
    data = mujoco.MjData(model)
    joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in job["joints"]]
    at_q, at_v = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    ball_q, ball_v = model.nq - 7, model.nv - 6
    steps, samples = steps_per_sample(job, setting["dt"]), round(job["duration"] / job["sample"])
    start = setting.get("start", job["start"])
    spin = np.zeros(3)

    def run() -> tuple[list, list, dict]:
        mujoco.mj_resetData(model, data)
        data.qpos[at_q], data.qpos[ball_q : ball_q + 3] = start["q"][:16], start["q"][16:]
        data.qvel[at_v], data.qvel[ball_v:] = start["v"][:16], start["v"][16:]
        data.ctrl[:] = job["goal"]
        q: list[np.ndarray] = []
        v: list[np.ndarray] = []
        late = []
        for _ in range(samples):
            if setting.get("squeeze"):
                for _ in range(steps):
                    mujoco.mj_step(model, data)
                    if data.time > job["duration"] - SQUEEZE + 0.5 * setting["dt"]:
                        late.append(total_normal_force(model, data))
            else:
                mujoco.mj_step(model, data, steps)
            mujoco.mju_rotVecQuat(spin, data.qvel[ball_v + 3 :], data.qpos[ball_q + 3 :])
            q.append(np.concatenate([data.qpos[at_q], data.qpos[ball_q : ball_q + 3]]))
            v.append(np.concatenate([data.qvel[at_v], data.qvel[ball_v : ball_v + 3], spin]))
        counts = {"contacts": int(data.ncon)}
        return q, v, {**counts, "squeeze": float(np.mean(late))} if late else counts

    return run
