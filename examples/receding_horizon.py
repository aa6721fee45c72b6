"""A paddle keeps a ball bouncing at a height: receding-horizon control with gradients through the impacts.

A force moves a paddle of 1 kg on a vertical slide; the ball loses a fifth of its speed in each bounce. Every 40 ms the
controller looks 1 s ahead from the simulator's state, with a force that is constant over 40 ms, improves the last plan
by some iterations of scipy's L-BFGS-B, tries its beginning on a copy of the simulator, and applies it. Impacts have
exact times inside of steps, so the cost is smooth in the force as long as the bounces are the same ones, and its
gradient is exact (contactvi.gradient). The cost holds the ball to one that bounces without loss, the paddle to zero.

python examples/receding_horizon.py [PICTURE.png]
"""

import sys
import time

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

import contactvi as cvi

DT, HOLD, PLAN, HEIGHT, G = 0.01, 4, 25, 0.5, 9.81  # [s]; steps per force, forces per plan; wanted top [m]; [m/s^2]
WEIGHT = 0.02  # of the paddle's place and speed, and of its force over its weight / 100


def juggler() -> cvi.Scene:
    model, geometry = pin.Model(), pin.GeometryModel()
    shapes = {"paddle": (1.0, pin.hppfcl.Box(0.4, 0.4, 0.02), -0.01), "ball": (0.1, pin.hppfcl.Sphere(0.03), 0.03)}
    for name, (mass, shape, z) in shapes.items():
        joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
        geometry.addGeometryObject(pin.GeometryObject(name, joint, pin.SE3(np.eye(3), np.array([0.0, 0.0, z])), shape))
    scene = cvi.Scene.from_pinocchio(model, geometry, name="juggler")
    scene.set_joint("*", limits=False)
    scene.set_contact(restitution=0.8)
    return scene


def control(forces: np.ndarray) -> np.ndarray:
    """Return the generalized forces of all steps under forces on the paddle over its weight."""
    return np.column_stack([np.repeat(G + forces, HOLD), np.zeros(HOLD * len(forces))])


def wanted(t: np.ndarray) -> np.ndarray:
    """Return the height of a ball that bounces without loss, at the top at t = 0."""
    half = np.sqrt(2 * HEIGHT / G)
    return HEIGHT - 0.5 * G * ((t + half) % (2 * half) - half) ** 2


def planned(forces: np.ndarray, now: float, q: np.ndarray, v: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the cost of a plan from a state and its gradient."""
    run = cvi.simulate(scene, q, v, PLAN * HOLD * DT, DT, order=4, control=control(forces), record="gradient")
    off = np.column_stack([WEIGHT * run.q[:, 0], run.q[:, 1] - wanted(now + run.t)])
    rate = np.column_stack([0.1 * WEIGHT * run.v[:, 0], 0 * run.t])
    slope = cvi.gradient(run, (off, rate), ["control"])[1]["control"][:, 0].reshape(PLAN, HOLD).sum(axis=1)
    value = 0.5 * (np.sum(off[:, 0] * run.q[:, 0]) + np.sum(off[:, 1] ** 2) + np.sum(rate[:, 0] * run.v[:, 0]))
    return float(value + 0.5 * 1e-4 * WEIGHT * forces @ forces), slope + 1e-4 * WEIGHT * forces


def keep_bouncing(seconds: float, iterations: int) -> tuple[cvi.Trajectory, int]:
    """Return the run of the controller, and how many plans it has looked at; none without iterations."""
    sim, plan, looks = cvi.Simulator(scene, dt=DT, order=4), np.zeros(PLAN), 0
    sim.reset([0.0, 0.3], [0.0, 0.0])
    for _ in range(round(seconds / (HOLD * DT))):
        plan = np.append(plan[1:], 0.0)
        if iterations:
            found = minimize(planned, plan, (sim.t, sim.q, sim.v), "L-BFGS-B", True, bounds=[(-60, 60)] * PLAN,
                             options={"maxiter": iterations})  # fmt: skip
            plan, looks = found.x, looks + found.nfev
        trial = sim.copy()
        assert trial.run(HOLD, control(plan[:1])).ok
        assert sim.run(HOLD, control(plan[:1])).ok
        assert np.array_equal(trial.q, sim.q)  # a copy goes on to the bit
    return sim.trajectory(), looks


scene = juggler()
x, h = 3.0 * np.sin(np.arange(PLAN)), 1e-6 * np.cos(np.arange(PLAN))
state = 0.0, np.array([0.0, 0.5]), np.zeros(2)
near = (planned(x + h, *state)[0] - planned(x - h, *state)[0]) / 2e-6
exact = planned(x, *state)[1] @ h * 1e6
print(f"gradient through the bounces along a change of the plan {exact:.8f}, by differences {near:.8f}")
start = time.perf_counter()
traj, looks = keep_bouncing(5.0, 8)
tops = traj.q[:, 1] + traj.v[:, 1] ** 2 / (2 * G)  # where the ball rises to
heights = np.array([tops[np.searchsorted(traj.t, event.time)] for event in traj.events])
print(f"{looks} plans of {PLAN * HOLD} steps and their gradients in {time.perf_counter() - start:.1f} s")
print(f"dropped from 0.3 m; heights after each bounce {np.round(heights, 3)} m, wanted {HEIGHT}")
idle = keep_bouncing(1.0, 0)[0]
print(f"without control the ball is at {idle.q[-1, 1]:.2f} m after 1 s, and the paddle at {idle.q[-1, 0]:.2f} m")
if len(sys.argv) > 1:
    plt.plot(traj.t, np.column_stack([traj.q, wanted(traj.t)]), label=["paddle", "ball", "ball as wanted"])
    plt.gca().set(xlabel="time [s]", ylabel="height [m]")
    plt.legend()
    plt.savefig(sys.argv[1])
assert abs(exact - near) <= 1e-6 * abs(exact)
assert np.all(np.abs(heights[2:] - HEIGHT) < 0.01)
