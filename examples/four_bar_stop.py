"""A four-bar linkage swings against a stop, e = 1: no impact changes the energy, and the loop stays closed.

python examples/four_bar_stop.py
"""

from pathlib import Path

import numpy as np

import contactvi as cvi

models = Path(__file__).resolve().parents[1] / "models"

scene = cvi.Scene()
scene.add_urdf(models / "four_bar.urdf", limits=False)
scene.add_point("world", "rocker", (1, 0, 0), (0.7, 0, 0), name="loop")
scene.add_halfspace(normal=(1, 0, 0), offset=0.55, name="stop")  # solid where x <= 0.55 m
scene.set_contact(restitution=1.0)

# Crank at 0.4 rad; the pin of coupler and rocker then lies near (0.9, 0.7).
guess = {"hinge_crank": 0.4, "hinge_coupler": 0.5, "hinge_rocker": -2.3}
q0 = scene.assemble(scene.configuration(guess), fixed=["hinge_crank"])
v0 = scene.consistent_velocity(q0, scene.velocity({"hinge_crank": 5.0, "hinge_coupler": -5.0}))

core = scene.core()
spread = []
for dt in (2e-3, 1e-3):
    traj = cvi.simulate(scene, q0, v0, duration=10.0, dt=dt)
    spread.append(np.ptp(traj.energy))

loop = max(np.abs(core.constraint_residual(q, t)).max() for t, q in zip(traj.t, traj.q, strict=True))
angles = np.cumsum(traj.q, axis=1)  # from the horizontal
end = np.array([np.cos(angles), np.sin(angles)]) @ [0.3, 0.9, 0.7]  # of the rocker
closed = np.abs(end.T - [1, 0]).max()
jump = max(abs(event.energy_change) for event in traj.events) / traj.kinetic_energy.max()
restitution = max(abs(event.gamma_plus + event.gamma_minus) for event in traj.events)
after = [core.constraint_jacobian(e.q, e.time) @ core.velocity(e.q[None], e.p_plus[None])[0] for e in traj.events]
print(f"{len(traj.events)} impacts in 10 s, {len(traj) - 1} steps")
for event in list(traj.events)[:4]:
    print(event)
print(f"energy changes at an impact by at most {jump:.1e} of the kinetic energy, speeds by {restitution:.1e} m/s")
print(f"loop open by at most {loop:.1e} m ({closed:.1e} m by trigonometry), speed at it after impacts", end=" ")
print(f"{np.abs(after).max():.1e} m/s; energy between impacts varies by {spread[1]:.1e} J (dt 2e-3: {spread[0]:.1e} J)")
if len(traj.events) < 10 or jump > 1e-12 or restitution > 1e-11 or max(loop, closed) > 1e-10 or spread[1] > 1e-3:
    raise SystemExit("the linkage loses energy at an impact, or opens")
