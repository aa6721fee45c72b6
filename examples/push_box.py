"""A ball pushes a box over a plane to a goal: receding-horizon control with derivatives through contact.

The pusher, a ball on two slides, starts behind a box that rests, off its middle. Nothing in the plan says when it
touches the box, or where the box slides: the forces on the pusher over the next 0.5 s follow from the gradient of a cost
through the run (contactvi.gradient). The box sticks and slides on four corners that come to rest together, and is hit
while it rests: there the run has kinks, and on_kink="taken" gives the derivative of what it did. Every 0.1 s some
iterations of scipy's L-BFGS-B improve the last plan, and its beginning is applied.

python examples/push_box.py [--quick] [PICTURE.png]
"""

import sys
import time

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

import contactvi as cvi

DT, HOLD, PLAN, LIMIT = 0.01, 10, 5, 10.0  # [s]; steps per force, forces per plan; largest force [N]
GOAL = np.array([0.35, 0.06])  # of the box's middle [m]
BEHIND = 0.14 * GOAL / np.linalg.norm(GOAL)  # the place of the box from that where the pusher belongs [m]
PLACE, SPEED = 0.05, 1e-3  # weights of the pusher's place and of its speed beside the box's place


def table() -> cvi.Scene:
    model, geometry, ground = pin.Model(), pin.GeometryModel(), pin.SE3.Identity()
    slide = model.addJoint(0, pin.JointModelPX(), ground, "pusher_x")
    slide = model.addJoint(slide, pin.JointModelPY(), pin.SE3.Identity(), "pusher_y")
    model.appendBodyToJoint(slide, pin.Inertia.FromSphere(0.5, 0.04), pin.SE3.Identity())
    box = model.addJoint(0, pin.JointModelTranslation(), ground, "box_place")
    box = model.addJoint(box, pin.JointModelSpherical(), pin.SE3.Identity(), "box_turn")
    model.appendBodyToJoint(box, pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.1), pin.SE3.Identity())
    up = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))
    geometry.addGeometryObject(pin.GeometryObject("pusher", slide, up, pin.hppfcl.Sphere(0.04)))
    geometry.addGeometryObject(pin.GeometryObject("box", box, pin.SE3.Identity(), pin.hppfcl.Box(0.2, 0.2, 0.1)))
    scene = cvi.Scene.from_pinocchio(model, geometry, name="table")
    scene.add_halfspace(name="ground")
    scene.set_joint("pusher_*", limits=False)
    scene.set_contact(restitution=0.0, friction=0.3)
    scene.disable_pair("pusher", "ground")
    return scene


def control(forces: np.ndarray) -> np.ndarray:
    """Return the generalized forces of all steps under forces on the pusher, (forces, 2)."""
    return np.repeat(np.hstack([forces, np.zeros((len(forces), 6))]), HOLD, axis=0)


def planned(x: np.ndarray, q: np.ndarray, v: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the cost of a plan from a state and its gradient."""
    run = cvi.simulate(scene, q, v, PLAN * HOLD * DT, DT, control=control(x.reshape(PLAN, 2)), record="gradient")
    way, off, speed = run.q[:, 2:4] - GOAL, run.q[:, :2] - run.q[:, 2:4] + BEHIND, run.v[:, :2]
    lq, lv = np.zeros((2, len(run.t), scene.nv))
    lq[:, :2], lq[:, 2:4], lv[:, :2] = PLACE * off, way - PLACE * off, SPEED * speed
    slope = cvi.gradient(run, (lq, lv), "control", on_kink="taken")[1]["control"][:, :2]
    value = 0.5 * float(np.sum(way**2) + PLACE * np.sum(off**2) + SPEED * np.sum(speed**2))
    return value, slope.reshape(PLAN, HOLD, 2).sum(axis=1).ravel()


def push(seconds: float, iterations: int) -> tuple[cvi.Trajectory, int, int]:
    """Return the run of the controller, how many plans it has looked at, and how many had no derivative."""
    sim, plan, looks, refused = cvi.Simulator(scene, dt=DT), np.zeros((PLAN, 2)), 0, 0
    q = pin.neutral(scene.model)
    q[:2], q[4] = START, 0.05
    sim.reset(q, np.zeros(scene.nv))

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal refused
        try:
            return planned(x, sim.q, sim.v)
        except cvi.NotDifferentiable as e:
            print(e)
            refused += 1
            return np.inf, np.zeros(x.size)

    for _ in range(round(seconds / (HOLD * DT))):
        plan = np.vstack([plan[1:], plan[-1:]])
        found = minimize(cost, plan.ravel(), jac=True, method="L-BFGS-B", bounds=[(-LIMIT, LIMIT)] * plan.size,
                         options={"maxiter": iterations})  # fmt: skip
        plan, looks = found.x.reshape(PLAN, 2), looks + found.nfev
        print(sim.t, sim.q[:4], found.fun, plan[0])
        assert sim.run(HOLD, control(plan[:1])).ok
    return sim.trajectory(), looks, refused


START = np.array([-0.2, 0.02])
scene = table()
start = time.perf_counter()
traj, looks, refused = push(4.0, 8)
print(f"{looks} plans, {refused} refused, {time.perf_counter() - start:.1f} s")
print(np.linalg.norm(traj.q[-1, 2:4] - GOAL))
