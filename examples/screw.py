"""A nut runs down a vertical screw, a free body on five constraints: acceleration and bearing force in closed form.

python examples/screw.py
"""

import numpy as np

import contactvi as cvi

mass, radius, pitch, gravity = 2.0, 0.05, 0.02, 9.81  # [kg, m, m/rad, m/s^2]
inertia = 0.5 * mass * radius**2  # about the screw [kg m^2]

scene = cvi.Scene(gravity=(0, 0, -gravity))
scene.add_cylinder("nut", radius=radius, length=0.04, mass=mass)
scene.add_screw("world", "nut", pitch, name="thread")

# L = (m pitch^2 + I) q'^2 / 2 - m g pitch q, z = pitch q: constant acceleration, which the midpoint rule has exactly.
fall = -gravity * mass * pitch**2 / (mass * pitch**2 + inertia)
bearing = mass * (gravity + fall)

traj = cvi.simulate(scene, duration=2.0, dt=1e-2)
core = scene.core()
place = np.abs(traj.q[:, 2] - 0.5 * fall * traj.t**2).max()
spin = np.abs(traj.v[:, 5] - fall / pitch * traj.t).max()
acceleration = np.diff(traj.v[:, 2]) / np.diff(traj.t)
reaction = traj.reactions("thread")[1:]  # two forces across, two torques, the force along the thread
open_by = max(np.abs(core.constraint_residual(q, t)).max() for t, q in zip(traj.t, traj.q, strict=True))
turns = traj.q[-1, 2] / (2 * np.pi * pitch)

print(f"the nut sinks by {-traj.q[-1, 2]:.6f} m in {-turns:.3f} turns")
print(f"acceleration {acceleration.mean():.12f} m/s^2, closed form {fall:.12f}, scatter {np.ptp(acceleration):.1e}")
print(f"place off by {place:.1e} m, spin by {spin:.1e} rad/s; thread off by {open_by:.1e}")
print(f"force of the thread {reaction[:, 4].mean():.9f} N, closed form {bearing:.9f} N; ", end="")
print(f"across it {np.abs(reaction[:, :4]).max():.1e}")
ok = [np.abs(acceleration - fall).max() < 1e-8, place < 1e-9, spin < 1e-7, open_by < 1e-10]
if not all(ok) or np.abs(reaction[:, 4] - bearing).max() > 1e-6 or np.abs(reaction[:, :4]).max() > 1e-6:
    raise SystemExit("the nut does not follow the closed form")
