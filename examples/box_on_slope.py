"""A box slides down a slope: with enough friction it stops for good, with less it slides on, as in the closed form.

python examples/box_on_slope.py
"""

import numpy as np

import contactvi as cvi

slope, speed, gravity = np.radians(20.0), 1.0, 9.81  # [rad], [m/s], [m/s^2]
normal = np.array([-np.sin(slope), 0.0, np.cos(slope)])
uphill = np.array([np.cos(slope), 0.0, np.sin(slope)])

for friction in (0.5, 0.2):  # tan(20 deg) = 0.364
    scene = cvi.Scene(gravity=(0, 0, -gravity))
    scene.add_halfspace(normal=normal, name="slope")
    scene.add_box("box", size=(0.2, 0.2, 0.2), mass=2.0, placement=(0.1 * normal, (0, -slope, 0)))
    scene.set_contact(restitution=0.0, friction=friction)
    traj = cvi.simulate(scene, v0=scene.velocity({"box": -speed * uphill}), duration=1.0, dt=1e-2)

    slower = gravity * (friction * np.cos(slope) - np.sin(slope))  # deceleration [m/s^2]
    way = speed**2 / (2 * slower) if slower > speed else speed - 0.5 * slower
    print(f"friction {friction}: " + (f"it has to stop at {speed / slower:.9f} s" if slower > speed else "it goes on"))
    for time in sorted({change.time for change in traj.contact_changes}):
        changes = [change.change for change in traj.contact_changes if change.time == time]
        print(f"  t = {time:.9f} s  {changes[0]}, {len(changes)} points")
    middles, force = traj.contacts.on("box")  # [s], sum over the points [N], world axes
    for k in (10, -1):
        t, mode = middles[k], traj.contacts.at(middles[k])[0].mode
        print(f"  t = {t:.3f} s        {mode}: {force[k] @ uphill:.6f} N uphill, {force[k] @ normal:.6f} N normal")
    print(f"  way {(traj.q[0] - traj.q[-1])[:3] @ uphill:.9f} m, by the closed form {way:.9f} m")
    print(f"  energy lost {traj.energy[0] - traj.energy[-1]:.9f} J, by friction {traj.friction_loss[-1]:.9f} J")
