"""Scenes of contact_cases.py in MuJoCo. setting: integrator, dt; stiff: the contact's time constant is 2 dt and the
friction cone is elliptic, else as MuJoCo has them.

Servos are position actuators with kp and kv (the implicit integrators take the kv implicitly, Euler does not). A
motion is that of a mass of HEAVY on a spring, because a mocap body has no velocity for friction. Frames without mass
are merged into the body they carry.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
from worker import Run, steps_per_sample

HEAVY = 1e6  # kg
KINDS = {"slide": mujoco.mjtJoint.mjJNT_SLIDE, "hinge": mujoco.mjtJoint.mjJNT_HINGE}


def quaternion(rpy: list[float]) -> list[float]:
    """Turns about the fixed axes x, y, z, as w x y z."""
    out = np.array([1.0, 0.0, 0.0, 0.0])
    for axis, angle in zip(np.eye(3), rpy, strict=True):
        turn, before = np.zeros(4), out.copy()
        mujoco.mju_axisAngle2Quat(turn, axis, angle)
        mujoco.mju_mulQuat(out, turn, before)
    return out.tolist()


def pose_of(given: dict[str, Any]) -> dict[str, Any]:
    return {"pos": given.get("xyz", [0.0, 0.0, 0.0]), "quat": quaternion(given.get("rpy", [0.0, 0.0, 0.0]))}


def add_shape(spec: mujoco.MjSpec, body: Any, name: str, given: dict[str, Any], job: dict[str, Any]) -> None:
    if "sphere" in given:
        kind, size = mujoco.mjtGeom.mjGEOM_SPHERE, [given["sphere"], 0.0, 0.0]
    elif "box" in given:
        kind, size = mujoco.mjtGeom.mjGEOM_BOX, [0.5 * side for side in given["box"]]
    else:
        kind, size = mujoco.mjtGeom.mjGEOM_PLANE, [5.0, 5.0, 1.0]
    friction = [job["friction"], 0.005, 0.0001]  # sliding; the others need condim > 3
    # The bodies of a pair have neighbouring bits: the first touches the second, and nothing else does.
    first, second = (any(pair[k] == name for pair in job["pairs"]) for k in (0, 1))
    body.add_geom(type=kind, size=size, friction=friction, contype=int(first), conaffinity=int(second), mass=0.0,
                  **pose_of(given))  # fmt: skip


def build(job: dict[str, Any], setting: dict[str, Any]) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.autolimits = False
    bodies: dict[str, Any] = {"world": spec.worldbody}
    for item in job["bodies"]:
        name, parent = item["name"], bodies[item["parent"]]
        merged = item["parent"] != "world" and any(b["name"] == item["parent"] and not b["mass"] for b in job["bodies"])
        fixed = item["joint"] == "fixed"
        bodies[name] = parent if merged or fixed else parent.add_body(name=name, **pose_of(item.get("pose", {})))
        if item["joint"] == "free":
            bodies[name].add_freejoint(name=name)
        elif not fixed:
            joint = bodies[name].add_joint(name=name, type=KINDS[item["joint"]], axis=item["axis"])
            joint.stiffness[0] = item.get("stiffness", 0.0)  # of a polynomial
        if item.get("mass"):
            mass = HEAVY if "motion" in item else item["mass"]
            full, body = np.array(item["inertia"]), bodies[name]
            body.mass, body.ipos, body.explicitinertial = mass, item["com"], True
            body.fullinertia = [full[0, 0], full[1, 1], full[2, 2], full[0, 1], full[0, 2], full[1, 2]]
        if "motion" in item:
            joint.stiffness[0] = HEAVY * item["motion"]["rate"] ** 2
        if "servo" in item:
            servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            servo.set_to_position(kp=item["servo"]["kp"], kv=item["servo"]["kd"])
        for shape in item["shapes"]:
            add_shape(spec, bodies[name], name, shape, job)
    for k, loop in enumerate(job["loops"]):
        sites = []
        for side in "ab":
            site = bodies[loop[side]].add_site(name=f"loop{k}{side}", pos=loop[f"point_{side}"])
            sites.append(site.name)
        equality = spec.add_equality(name=f"loop{k}", type=mujoco.mjtEq.mjEQ_CONNECT, name1=sites[0], name2=sites[1])
        equality.objtype = mujoco.mjtObj.mjOBJ_SITE
        if setting.get("stiff"):
            equality.solref = [2.0 * setting["dt"], 1.0]
    for name, point in job["observe"]:
        spec_body = bodies[name]
        spec_body.add_site(name=f"seen {name} {point}", pos=point)
    model = spec.compile()
    model.opt.timestep = setting["dt"]
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{setting['integrator'].upper()}")
    model.opt.gravity[:] = 0.0, 0.0, -job["gravity"]
    if setting.get("stiff"):
        model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        model.geom_solref[:, 0] = 2.0 * setting["dt"]
    return model


def prepare(job: dict[str, Any], setting: dict[str, Any]) -> Run:
    model = build(job, setting)
    data = mujoco.MjData(model)
    q0, v0 = np.zeros(model.nq), np.zeros(model.nv)
    for name, value in job["start"]["q"].items():
        joint = model.joint(name)
        at, to = int(joint.qposadr[0]), int(joint.dofadr[0])
        speed = job["start"]["v"][name]
        if np.ndim(value):  # the spin is in the axes of the body
            q0[at : at + 7], v0[to : to + 3] = np.array(value)[[0, 1, 2, 6, 3, 4, 5]], speed[:3]
            turned, back = np.zeros(3), np.zeros(4)
            mujoco.mju_negQuat(back, q0[at + 3 : at + 7])
            mujoco.mju_rotVecQuat(turned, np.array(speed[3:], dtype=float), back)
            v0[to + 3 : to + 6] = turned
        else:
            q0[at], v0[to] = value, speed
    sites = [model.site(f"seen {name} {point}").id for name, point in job["observe"]]
    targets = [item["servo"]["target"] for item in job["bodies"] if "servo" in item]
    steps, samples = steps_per_sample(job, setting["dt"]), round(job["duration"] / job["sample"])

    def run() -> tuple[list, list]:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q0, v0, targets
        rows = []
        for _ in range(samples):
            mujoco.mj_step(model, data, steps)
            mujoco.mj_kinematics(model, data)
            rows.append(data.site_xpos[sites].ravel().copy())
        if not math.isfinite(float(np.sum(rows))):
            raise ValueError("not finite")
        return rows, []

    return run
