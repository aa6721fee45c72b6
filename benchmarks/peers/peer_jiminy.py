"""Jiminy. setting: tol of its adaptive Dormand-Prince; with contacts stiffness [N/m] and damping [N s/m].

Its ground is a height map at z = 0, so S4 is turned by a quarter: the wall becomes the ground, gravity points along it.
It has no contact between two moving bodies: S6 is skipped. Its other contact model has no restitution.
"""

from __future__ import annotations

import math
import os
import tempfile

import jiminy_py.core as jiminy
import numpy as np
from jiminy_py.core.pinocchio import SE3
from worker import Run, measure, without_shapes


def turned(urdf: str, lift: float) -> str:
    """x becomes -z, z becomes x, then up by `lift`: the first joint's origin is the only one in the base."""
    head, tail = urdf.split('<parent link="base"/>')
    place = 'xyz="0.0 0.0 0.0" rpy="0.0 0.0 0.0"'
    for zero in ("-0.0 0.0 0.0", "0.0 -0.0 0.0", "0.0 0.0 -0.0", "-0.0 0.0 -0.0", "-0.0 -0.0 0.0"):
        tail = tail.replace(f'rpy="{zero}"', 'rpy="0.0 0.0 0.0"', 1)
    if place not in tail:
        raise ValueError("the base joint is not at the origin")
    return head + '<parent link="base"/>' + tail.replace(place, f'xyz="0 0 {lift!r}" rpy="0 {math.pi / 2!r} 0"', 1)


def prepare(job: dict, setting: dict) -> Run:
    urdf, gravity = without_shapes(job["urdf"]), [0.0, 0.0, -job["gravity"], 0.0, 0.0, 0.0]
    if job["wall"] is not None:
        urdf, gravity = turned(urdf, job["wall"] - job["balls"][0]["radius"]), [-job["gravity"], 0, 0, 0, 0, 0]
    with tempfile.NamedTemporaryFile("w", suffix=".urdf", delete=False) as file:
        file.write(urdf)
    robot = jiminy.Robot()
    robot.initialize(file.name, bool(job["base"]), [], False)
    os.unlink(file.name)
    options = robot.get_options()
    for key in options["model"]["joints"]:
        if key.startswith("enable"):
            options["model"]["joints"][key] = False
    robot.set_options(options)
    if job["balls"]:  # a contact is a point: the ball's centre over a raised ground, or its lowest point
        ball = job["balls"][0]
        low = 0.0 if job["wall"] is not None else ball["radius"]
        point = np.array(ball["centre"]) - [0.0, 0.0, low]
        robot.add_frame("tip", f"L{ball['joint']}", SE3(np.eye(3), point))
        robot.add_contact_points(["tip"])
    engine = jiminy.Engine()
    engine.add_robot(robot)
    options = engine.get_options()
    options["world"]["gravity"] = np.array(gravity, float)
    options["stepper"].update(odeSolver="runge_kutta_dopri", tolRel=setting["tol"], tolAbs=0.1 * setting["tol"],
                              dtMax=0.02, successiveIterFailedMax=100_000)  # fmt: skip
    for key in options["telemetry"]:
        if key.startswith("enable"):
            options["telemetry"][key] = False
    if job["balls"]:
        options["contacts"].update(model="spring_damper", stiffness=setting["stiffness"], damping=setting["damping"],
                                   friction=0.0, transitionEps=1e-9)  # fmt: skip
    engine.set_options(options)
    model = robot.pinocchio_model
    joints = [model.joints[model.getJointId(name)] for name in job["joints"]]
    at_q = [*range(len(job["base"])), *(joint.idx_q for joint in joints)]
    at_v = [*range(len(job["base_v"])), *(joint.idx_v for joint in joints)]
    q0, v0 = np.zeros(model.nq), np.zeros(model.nv)
    q0[at_q], v0[at_v] = job["base"] + job["q0"], job["base_v"] + job["v0"]

    def run() -> tuple[list, list]:
        if engine.is_simulation_running:
            engine.stop()
        engine.reset()
        engine.start(q0, v0)
        out: tuple[list, list] = ([], [])
        for _ in range(round(job["duration"] / job["sample"])):
            engine.step(job["sample"])
            state = engine.get_robot_state("")
            out[0].append(np.array(state.q)[at_q])
            out[1].append(np.array(state.v)[at_v])
        engine.stop()
        return out

    return run


if __name__ == "__main__":
    measure(prepare)
