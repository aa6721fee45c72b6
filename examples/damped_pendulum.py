"""A damped pendulum: what its energy loses is what the damper took, and the motion is that of an accurate reference.

python examples/damped_pendulum.py
"""

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import contactvi as cvi

models = Path(__file__).resolve().parents[1] / "models"
mass, centre, inertia, damping, gravity = 2.0, 0.5, 2.0 / 3.0, 0.4, 9.81  # of the file: a bar of 1 m and 2 kg

scene = cvi.Scene(gravity=(0, 0, -gravity))
scene.add_urdf(models / "damped_pendulum.urdf")  # the file's damping is used
q0 = scene.configuration({"hinge": 2.5})


def equation(t, y):
    """Equation of motion, inertia a = -damping w - m g c sin(angle)."""
    return [y[1], -(damping * y[1] + mass * gravity * centre * np.sin(y[0])) / inertia]


def measure(dt):
    """Return the largest error of the angle [rad] and of the energy balance [J]."""
    traj = cvi.simulate(scene, q0, duration=5.0, dt=dt)
    exact = solve_ivp(equation, (0, 5), [2.5, 0], method="DOP853", t_eval=traj.t, rtol=1e-12, atol=1e-13).y[0]
    turn = np.arctan2(traj.q[:, 1], traj.q[:, 0]) - exact  # a continuous joint has cos and sin in q
    error = np.abs(np.sin(turn / 2)).max() * 2
    balance = np.abs(traj.ledger.energy_balance).max()
    lost, taken = traj.energy[0] - traj.energy[-1], traj.work.damping[-1]
    print(f"dt {dt:.4f} s  angle off by {error:.2e} rad  energy lost {lost:.6f} J, by the damper {taken:.6f} J")
    return error, balance


coarse, fine = np.array(measure(1e-2)), np.array(measure(5e-3))
order = np.log2(coarse / fine)
print(f"orders: angle {order[0]:.3f}, energy balance {order[1]:.3f} (expected 2)")
if np.any(np.abs(order - 2) > 0.1) or fine[0] > 1e-3:
    raise SystemExit("the pendulum does not converge with order 2")
