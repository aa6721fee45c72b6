"""A pendulum on a cart follows a desired swing: the optimisation of trep's example, by crocoddyl's FDDP.

trep (Johnson, Murphey; its examples/pend-on-cart-optimization.py) moves a pendulum of 1 kg and 1 m on a cart of 10 kg
from 0 to 130 degrees and back by a force on the cart: 999 steps of 10 ms, the cost 1/2 sum (x - x_d)^T Q (x - x_d) +
u^T R u in x = (q, p). A torque on the pendulum helps at first, is made dearer in stages, and is taken away. With f, fdx
and fdu of DiscreteSystem FDDP converges linearly (trep's quasi); with fdxdx, fdxdu and fdudu along the costates
quadratically, as trep's Newton method does. trep gives no numbers to compare with.

python examples/cart_optimization.py [PICTURE.png]
"""

import sys
import time
from typing import Any

import crocoddyl
import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi.trep import DiscreteSystem

T = np.arange(1000) * 0.01  # [s]
WANTED = np.where((T >= 3) & (T <= 7), (1 - np.cos(np.pi / 2 * (T - 3))) * np.radians(130) / 2, 0)  # angle [rad]
GOAL, Q = np.column_stack([0 * T, WANTED, 0 * T, 0 * T]), np.diag([0.01, 100.0, 0.01, 0.01])


def cart() -> cvi.Scene:
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -9.8])
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    hinge = model.addJoint(slide, pin.JointModelRY(), pin.SE3.Identity(), "theta")
    for joint, mass, z in ((slide, 10.0, 0.0), (hinge, 1.0, -1.0)):
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.array([0.0, 0.0, z]), np.zeros((3, 3))), pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model, name="cart")
    scene.set_joint("*", damping=0.01)
    return scene


class Step(crocoddyl.ActionModelAbstract):
    """Step k of the system with its cost; the last one is the end."""

    def __init__(self, system: DiscreteSystem, k: int, R: np.ndarray, costates: list[np.ndarray]):
        super().__init__(crocoddyl.StateVector(system.nX), 0 if k == system.kf() else system.nU, 0)
        self.system, self.k, self.goal, self.R, self.costates = system, k, GOAL[k], R, costates

    def calc(self, data: Any, x: np.ndarray, u: Any = None) -> None:
        data.cost = 0.5 * (x - self.goal) @ Q @ (x - self.goal)
        if self.nu and u is not None:
            self.system.set(x, u, self.k)
            data.xnext, data.cost = self.system.f(), data.cost + 0.5 * u @ self.R @ u

    def calcDiff(self, data: Any, x: np.ndarray, u: Any = None) -> None:
        data.Lx, data.Lxx = Q @ (x - self.goal), Q
        if self.nu and u is not None:
            f = self.system
            f.set(x, u, self.k)
            data.Fx, data.Fu, data.Lu, data.Luu = f.fdx(), f.fdu(), self.R @ u, self.R
            if self.costates:
                z = self.costates[self.k + 1]
                data.Lxx, data.Lxu, data.Luu = Q + f.fdxdx(z), f.fdxdu(z), self.R + f.fdudu(z)


def optimize(system: DiscreteSystem, X: Any, U: Any, R: list[float], quasi: int, newton: int = 0) -> Any:
    """Return states, inputs, costs and slopes of iterations without and with second derivatives of the steps."""
    costates: list[np.ndarray] = []
    *steps, end = [Step(system, k, np.diag(R), costates) for k in range(len(T))]
    solver = crocoddyl.SolverFDDP(crocoddyl.ShootingProblem(GOAL[0], steps, end))
    solver.setCallbacks([log := crocoddyl.CallbackLogger()])
    for iterations in (quasi, *newton * [1]):
        solver.solve(list(X), list(U), iterations, True)
        X, U, costates[:] = np.array(solver.xs), np.array(solver.us), np.array(solver.Vx)
    print(f"weights {R}, {quasi} iterations and {newton} of Newton: cost, slope")
    print(*(f"{cost:.6g}, {slope:.1e}" for cost, slope in zip(log.costs, log.stops, strict=True)), sep="; ")
    return X, U, list(log.costs), list(log.stops)


start = time.perf_counter()
helped, system = DiscreteSystem(cart(), T), DiscreteSystem(cart(), T, inputs=["x"])
X, U = helped.build_trajectory()
for dear, iterations in ((0.01, 2), (100.0, 10), (1e6, 2)):
    X, U = optimize(helped, X, U, [0.01, dear], iterations)[:2]
U = system.convert_trajectory(helped, X, U).U
X, U, costs, slopes = optimize(system, system.simulate(X[0], U).X, U, [0.01], 3, 3)
print(f"{time.perf_counter() - start:.1f} s; cost {costs[-1]:.6f}; the force is at most {np.abs(U).max():.1f} N")
A, B = system.linearize_trajectory(X, U)
z, slope, along = Q @ (X[-1] - GOAL[-1]), 0.0, np.sin(T[1:, None])
for k in reversed(range(len(U))):  # what the cost of the states changes by along a change of the force, by the costates
    slope, z = slope + (B[k].T @ z) @ along[k], A[k].T @ z + Q @ (X[k] - GOAL[k])
ends = [system.simulate(X[0], U + step * along).X - GOAL for step in (1e-5, -1e-5)]
near = np.sum((ends[0] - ends[1]) @ Q * (ends[0] + ends[1])) / 4e-5
print(f"change of the states' cost along one of the force {slope:.8f}, by differences {near:.8f}")
if len(sys.argv) > 1:
    shown = np.column_stack([np.degrees(GOAL[:, 1]), np.degrees(X[:, 1]), 10 * X[:, 0], np.append(U, np.nan)])
    plt.plot(T, shown, label=["desired angle [deg]", "angle [deg]", "cart [10 cm]", "force [N]"])
    plt.legend()
    plt.savefig(sys.argv[1])
assert slopes[-1] < 0.01 * slopes[-2] < costs[0] - costs[-1]  # Newton's method converges quadratically
assert abs(slope - near) < 1e-6 * abs(slope)
