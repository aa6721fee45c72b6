"""Scenes of contact_cases.py in contactvi. setting: order and dt, or dt "auto" and tol.

Timed: simulate() as a user calls it, and the places of the points that are observed, in NumPy. States between nodes are
taken from the polynomials of the steps.
"""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
from worker import Run

import contactvi as cvi

JOINTS = {"slide": pin.JointModelPrismaticUnaligned, "hinge": pin.JointModelRevoluteUnaligned}
COUNTS = ("steps", "sweeps", "held_steps", "impacts", "seconds")


def placement(given: dict[str, Any]) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(*given.get("rpy", (0.0, 0.0, 0.0))), np.array(given.get("xyz", (0.0, 0.0, 0.0))))


def shape_of(given: dict[str, Any]) -> Any:
    if "sphere" in given:
        return coal.Sphere(given["sphere"])
    return coal.Box(*given["box"]) if "box" in given else coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)


def build(job: dict[str, Any], springs: bool) -> cvi.Scene:
    """The scene; its servos as springs and dampers of joints, if asked for: the same law, which dt = "auto" takes."""
    model, geometry = pin.Model(), pin.GeometryModel()
    shapes: dict[str, list[int]] = {"world": []}
    model.gravity.linear = np.array([0.0, 0.0, -job["gravity"]])
    numbers = {"world": 0}
    for body in job["bodies"]:
        name, parent = body["name"], numbers[body["parent"]]
        numbers[name], shapes[name] = parent, []
        if body["joint"] != "fixed":
            free = body["joint"] == "free"
            joint = pin.JointModelFreeFlyer() if free else JOINTS[body["joint"]](np.array(body["axis"], dtype=float))
            numbers[name] = model.addJoint(parent, joint, placement(body.get("pose", {})), name)
            inertia = pin.Inertia(body["mass"], np.array(body["com"]), np.array(body["inertia"]))
            model.appendBodyToJoint(numbers[name], inertia, pin.SE3.Identity())
        for k, given in enumerate(body["shapes"]):
            item = pin.GeometryObject(f"{name}_{k}", numbers[name], placement(given), shape_of(given))
            shapes[name].append(geometry.addGeometryObject(item))
    for a, b in job["pairs"]:
        for i in shapes[a]:
            for j in shapes[b]:
                geometry.addCollisionPair(pin.CollisionPair(i, j))
    scene = cvi.Scene.from_pinocchio(model, geometry)
    scene.set_contact(restitution=0.0, friction=job["friction"])
    for body in job["bodies"]:
        if "stiffness" in body:
            scene.set_joint(body["name"], stiffness=body["stiffness"])
        if "servo" in body:
            kp, kd, target = (body["servo"][key] for key in ("kp", "kd", "target"))
            if springs:
                scene.set_joint(body["name"], stiffness=kp, damping=kd, rest=target)
            else:
                scene.set_servo(body["name"], kp, kd, target=target)
        if "motion" in body:
            scene.prescribe(body["name"], motion_of(**body["motion"]))
    for loop in job["loops"]:
        scene.add_point(loop["a"], loop["b"], loop["point_a"], loop["point_b"])
    return scene


def motion_of(amplitude: float, rate: float) -> Any:
    def motion(t: float) -> tuple[float, float, float]:
        sine, cosine = np.sin(rate * t), np.cos(rate * t)
        return amplitude * sine, amplitude * rate * cosine, -amplitude * rate**2 * sine

    return motion


def start_of(scene: cvi.Scene, job: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    q, v = scene.neutral(), np.zeros(scene.nv)
    for name, value in job["start"]["q"].items():
        q[scene.q_index(name)] = value
    for name, value in job["start"]["v"].items():
        if np.ndim(value):  # from world axes to those of the body
            turn = pin.Quaternion(*q[scene.q_index(name)][[6, 3, 4, 5]]).matrix()
            value = np.concatenate([turn.T @ value[:3], turn.T @ value[3:]])
        v[scene.v_index(name)] = value
    return q, v


def prepare(job: dict[str, Any], setting: dict[str, Any]) -> Run:
    scene = build(job, springs=setting["dt"] == "auto")
    q0, v0 = start_of(scene, job)
    model, data = scene.model, scene.model.createData()
    observed = [(model.getJointId(name), np.array(point)) for name, point in job["observe"]]
    options = dict(setting)
    every = 0.0 if setting["dt"] == "auto" else job["sample"] / setting["dt"]
    if every > 0.99 and abs(every - round(every)) < 1e-6:
        # A dt written as a decimal would miss the duration by rounding.
        # The polynomials of the steps are kept from order 4 on, where they are what a user has without asking.
        options.update(dt=job["sample"] / round(every), record_every=round(every), dense=setting["order"] > 2)
    else:
        options["sample_dt"] = job["sample"]

    def run() -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
        traj = cvi.simulate(scene, q0, v0, job["duration"], **options)
        rows = []
        for q in traj.q[1:]:
            pin.forwardKinematics(model, data, q)
            rows.append(np.concatenate([data.oMi[j].act(point) for j, point in observed]))
        counts = {name: getattr(traj.stats, name, None) for name in COUNTS}
        if setting["dt"] == "auto":
            counts["estimate"] = traj.error_estimate
        return np.array(rows), np.zeros(0), counts

    return run
