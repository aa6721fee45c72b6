"""Two free boxes collide in zero gravity: total linear and angular momentum stay, energy follows the restitution.

python examples/two_bodies.py
"""

import numpy as np

import contactvi as cvi

scene = cvi.Scene(gravity=(0, 0, 0))
scene.add_box("left", size=(0.2, 0.3, 0.1), mass=1.0)
scene.add_box("right", size=(0.2, 0.2, 0.2), mass=2.0, placement=((0.6, 0.05, 0.02), (0.3, 0.2, 0.1)))
scene.set_contact(restitution=0.8)

v0 = np.zeros(scene.nv)
v0[:6] = [2.0, 0.0, 0.0, 0.5, 0.0, 1.0]  # body twist of "left": linear [m/s], angular [rad/s]
traj = cvi.simulate(scene, v0=v0, duration=1.0, dt=1e-3)

momentum = scene.core().spatial_momentum(traj.q, traj.p)  # linear, angular about the origin
print(f"{len(traj.events)} impact(s); momentum changes by {np.abs(momentum - momentum[0]).max():.1e}")
for event in traj.events:
    loss = 0.5 * (1 - event.restitution**2) * event.gamma_minus**2 / event.G_c
    print(event, f" energy change {event.energy_change:.12f} J, by the law {-loss:.12f} J")
