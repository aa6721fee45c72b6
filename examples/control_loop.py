"""A controller in the loop: a PD law (the D part implicit) holds the Allegro hand while a ball falls on it.

python examples/control_loop.py
"""

import numpy as np

import contactvi as cvi

scene = cvi.Scene()
scene.add_urdf(
    "example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf",
    placement=((0, 0, 0), (0, -np.pi / 2, np.pi)),  # palm up
)
scene.add_sphere("ball", radius=0.03, mass=0.1, placement=(-0.04, 0.01, 0.2))
# Damping belongs into the engine, where it is implicit: in the loop, on links of 1.7e-5 kg m^2, it would be unstable.
scene.set_joint("joint_*", damping=0.03)
scene.set_contact(restitution=0.5)

hand = slice(0, 16)  # the hand was added first: its 16 joints come first in q and v
target = np.full(16, 0.45)
q0 = scene.neutral()
q0[hand] = target

sim = cvi.Simulator(scene, dt=5e-4)
sim.reset(q0, np.zeros(scene.nv))
while sim.t < 0.3 - 1e-9:
    tau = np.zeros(scene.nv)
    tau[hand] = 3.0 * (target - sim.q[hand])
    status = sim.step(tau)
    if not status.ok:
        raise SystemExit(str(status))

print(f"t = {sim.t:.4f} s, largest joint error {np.abs(sim.q[hand] - target).max():.3f} rad")
for event in sim.events:
    print(event)
