"""A bouncing ball against its closed form: impact n is at t1 (1 + 2 (e + ... + e^(n-1))).

python examples/bouncing_ball.py
"""

import numpy as np

import contactvi as cvi

restitution, height, gravity = 0.9, 1.0, 9.81

scene = cvi.Scene(gravity=(0, 0, -gravity))
scene.add_sphere("ball", radius=0.1, mass=1.0, placement=(0, 0, 0.1 + height))
scene.add_halfspace()
scene.set_contact(restitution=restitution)

# The impacts accumulate at t1 (1+e)/(1-e) = 8.58 s; in a longer run the ball rests from then on (traj.contact_changes).
traj = cvi.simulate(scene, duration=8.0, dt=1e-2)

first = np.sqrt(2 * height / gravity)
for n, event in enumerate(traj.events, start=1):
    exact = first * (1 + 2 * sum(restitution**k for k in range(1, n)))
    print(f"impact {n:2d}  t = {event.time:.12f} s  error {event.time - exact:9.1e} s  impulse {event.impulse:.6f} N s")
