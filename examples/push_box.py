"""A ball pushes a box over a plane to a goal: receding-horizon control with derivatives through contact.

The pusher, a ball on two slides, starts behind a box that rests, off its middle. Nothing in the plan says when it
touches the box, or where that slides: the forces on the pusher over the next 0.4 s follow from the gradient of a cost
through the run (contactvi.gradient). The box sticks and slides on four corners that come to rest together, and is hit
while it rests: there the run has kinks, and on_kink="taken" gives the derivative of what it did. Every 50 ms some
iterations of scipy's L-BFGS-B improve the last plan, and its beginning is applied. A plan whose run has no derivative
that is known counts as one of infinite cost, from which the search steps back.

python examples/push_box.py [--quick] [PICTURE.png]
"""

import sys
import time

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

import contactvi as cvi

DT, HOLD, PLAN, LIMIT = 0.01, 5, 8, 6.0  # [s]; steps per force, forces per plan; largest force [N]
GOAL = np.array([0.35, 0.06])  # of the box's middle [m]
BEHIND = 0.14 * GOAL / np.linalg.norm(GOAL)  # the place of the box from that where the pusher belongs [m]
PLACE, SPEED = 0.05, 1e-3  # weights of the pusher's place and of its speed beside the box's place


def table() -> cvi.Scene:
    model, geometry, here = pin.Model(), pin.GeometryModel(), pin.SE3.Identity()
    slide = model.addJoint(
        model.addJoint(0, pin.JointModelPX(), here, "pusher_x"), pin.JointModelPY(), here, "pusher_y"
    )
    model.appendBodyToJoint(slide, pin.Inertia.FromSphere(0.5, 0.04), here)
    box = model.addJoint(0, pin.JointModelTranslation(), here, "box_place")
    box = model.addJoint(box, pin.JointModelSpherical(), here, "box_turn")
    model.appendBodyToJoint(box, pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.1), here)
    up = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))
    geometry.addGeometryObject(pin.GeometryObject("pusher", slide, up, pin.hppfcl.Sphere(0.04)))
    geometry.addGeometryObject(pin.GeometryObject("box", box, here, pin.hppfcl.Box(0.2, 0.2, 0.1)))
    scene = cvi.Scene.from_pinocchio(model, geometry, name="table")
    scene.add_halfspace(name="ground")
    scene.set_contact(restitution=0.0, friction=0.3)
    scene.disable_pair("pusher", "ground")
    return scene


def control(forces: np.ndarray) -> np.ndarray:
    """Return the generalized forces of all steps under forces on the pusher, (forces, 2)."""
    return np.repeat(np.hstack([forces, np.zeros((len(forces), 6))]), HOLD, axis=0)


def planned(x: np.ndarray, q: np.ndarray, v: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the cost of a plan from a state and its gradient."""
    forces = control(x.reshape(PLAN, 2))
    run = cvi.simulate(scene, q, v, PLAN * HOLD * DT, DT, control=forces, record="gradient", contact_mode="events")
    way, off, speed = run.q[:, 2:4] - GOAL, run.q[:, :2] - run.q[:, 2:4] + BEHIND, run.v[:, :2]
    lq, lv = np.zeros((2, len(run.t), scene.nv))
    lq[:, :2], lq[:, 2:4], lv[:, :2] = PLACE * off, way - PLACE * off, SPEED * speed
    slope = cvi.gradient(run, (lq, lv), "control", on_kink="taken")[1]["control"][:, :2]
    value = 0.5 * float(np.sum(way**2) + PLACE * np.sum(off**2) + SPEED * np.sum(speed**2))
    return value, slope.reshape(PLAN, HOLD, 2).sum(axis=1).ravel()


def push(seconds: float, iterations: int) -> tuple[cvi.Trajectory, int, int]:
    """Return the run of the controller, how many plans it has looked at, and how many had no derivative."""
    sim, plan, looks, refused = cvi.Simulator(scene, dt=DT), np.zeros((PLAN, 2)), 0, 0
    sim.reset([-0.2, 0.02, 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0], np.zeros(scene.nv))

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal looks, refused
        looks += 1
        try:
            return planned(x, sim.q, sim.v)
        except (cvi.NotDifferentiable, cvi.SimulationError):
            refused += 1
            return np.inf, np.zeros(x.size)

    for _ in range(round(seconds / (HOLD * DT))):
        plan = np.vstack([plan[1:], plan[-1:]])
        found = minimize(cost, plan.ravel(), jac=True, method="L-BFGS-B", bounds=[(-LIMIT, LIMIT)] * plan.size,
                         options={"maxiter": iterations, "maxfun": 2 * iterations})  # fmt: skip
        plan = found.x.reshape(PLAN, 2)
        assert sim.run(HOLD, control(plan[:1])).ok
    return sim.trajectory(), looks, refused


scene, quick = table(), "--quick" in sys.argv
start = time.perf_counter()
traj, looks, refused = push(*((0.4, 3) if quick else (2.0, 8)))
way = np.linalg.norm(traj.q[:, 2:4] - GOAL, axis=1)
print(f"{looks} plans, {refused} of them without a derivative, in {time.perf_counter() - start:.1f} s")
print(f"the box was {way[0]:.3f} m from the goal, and is {way[-1]:.3f} m from it after {traj.t[-1]:.1f} s")
if sys.argv[-1].endswith(".png"):
    plt.plot(*traj.q[:, 2:4].T, label="box")
    plt.plot(*traj.q[:, :2].T, label="pusher")
    plt.plot(*GOAL, "x", label="goal, in m")
    plt.legend()
    plt.savefig(sys.argv[-1])
assert way[-1] < (1.0 if quick else 0.1) * way[0]
