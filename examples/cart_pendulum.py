"""A pendulum on a cart that is moved: the cart follows exactly, and the force for it is that of the closed form.

python examples/cart_pendulum.py
"""

from math import cos, sin
from pathlib import Path

import numpy as np

import contactvi as cvi

models = Path(__file__).resolve().parents[1] / "models"
cart, mass, length = 1.0, 1.0, 1.0  # of the file [kg, kg, m]
amplitude, omega = 0.2, 5.0  # of the cart [m, rad/s]


def motion(t):
    """Place, velocity and acceleration of the cart."""
    angle = omega * t
    return amplitude * sin(angle), amplitude * omega * cos(angle), -amplitude * omega**2 * sin(angle)


scene = cvi.Scene()
scene.add_urdf(models / "cart_pendulum.urdf", limits=False)
scene.prescribe("slide", motion, name="motion")
q0 = scene.configuration({"hinge": 0.5})
v0 = scene.consistent_velocity(q0)  # the cart starts with the speed of its motion, least energy


def measure(dt):
    """Return how far the cart is from its motion [m], and the largest errors of the force [N] and of the energy [J]."""
    traj = cvi.simulate(scene, q0, v0, duration=5.0, dt=dt)
    place = np.array([motion(t)[0] for t in traj.t])
    # The reaction is a mean over a step, to O(dt^2) the force of the closed form at its middle.
    x2 = np.array([motion(t)[2] for t in 0.5 * (traj.t[1:] + traj.t[:-1])])
    angle, rate = (0.5 * (x[1:, 1] + x[:-1, 1]) for x in (traj.q, traj.v))
    turn = -(9.81 * np.sin(angle) + x2 * np.cos(angle)) / length
    force = (cart + mass) * x2 + mass * length * (turn * np.cos(angle) - rate**2 * np.sin(angle))
    off = np.abs(traj.q[:, 0] - place).max()
    error = np.abs(traj.reactions("motion")[1:, 0] - force).max()
    balance = np.abs(traj.energy - traj.energy[0] - traj.work.prescribed).max()
    print(f"dt {dt:.3f} s  cart off by {off:.1e} m  force off by {error:.2e} of {np.abs(force).max():.1f} N", end="  ")
    print(f"energy less the work of the motion {balance:.2e} J")
    return off, error, balance


coarse, fine = np.array(measure(1e-2)), np.array(measure(5e-3))
order = np.log2(coarse[1:] / fine[1:])
print(f"orders: force {order[0]:.3f}, energy {order[1]:.3f} (expected 2)")
if fine[0] > 1e-10 or np.any(np.abs(order - 2) > 0.1):
    raise SystemExit("the cart does not follow its motion, or not with the force of the closed form")
