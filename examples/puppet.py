"""A puppet walks on the spot and waves: seven strings of prescribed length move a free torso with arms and legs.

python examples/puppet.py [PLAYBACK.html]
"""

import sys
from math import pi, sin
from pathlib import Path

import numpy as np

import contactvi as cvi

models = Path(__file__).resolve().parents[1] / "models"

scene = cvi.Scene()
scene.add_urdf(models / "puppet.urdf", base="free", placement=(0, 0, 1), limits=False)
hand, knee = (0, 0, -0.16), (0, 0, -0.2)  # in forearm and thigh


def pulled(length, by, phase):
    """Length of a string that is pulled in by up to `by` [m] and let out, once in 1.6 s, softly from t = 0.5 s on."""

    def motion(t):
        s = min(max(t - 0.5, 0.0), 1.0)
        soft = s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
        return length - by * soft * 0.5 * (1 - sin(2 * pi * t / 1.6 + phase))

    return motion


# The cross that the strings hang from is 0.9 m above the torso; each string ends at a point of a body.
strings = [scene.add_distance("world", "torso", (0.0, y, 1.9), (0.0, y, 0.17), 0.73, f"{s}_shoulder_string")
           for s, y in (("left", 0.1), ("right", -0.1))]  # fmt: skip
strings.append(scene.add_distance("world", "torso", (-0.35, 0, 1.9), (-0.05, 0, -0.15), 1.07, "back_string"))
for side, y, phase in (("left", 0.13, pi / 2), ("right", -0.13, -pi / 2)):
    length = pulled(0.85, 0.2, phase)
    strings.append(scene.add_distance("world", f"{side}_forearm", (0.3, 1.5 * y, 1.9), hand, length, f"{side}_hand"))
    length = pulled(1.15, 0.15, -phase)
    strings.append(scene.add_distance("world", f"{side}_thigh", (0.25, y, 1.9), knee, length, f"{side}_knee"))
guess = {f"{side}_{joint}": angle for side in ("left", "right")
         for joint, angle in (("shoulder_swing", 0.5), ("elbow", 0.8), ("hip_swing", 0.5), ("knee", -0.5))}  # fmt: skip
q0 = scene.assemble(scene.configuration(guess))
# Find where it hangs at rest: start again from rest where it is fastest, which is near the equilibrium.
for _ in range(40):
    traj = cvi.simulate(scene, q0, duration=0.5, dt=4e-3)
    q0 = traj.q[np.argmax(traj.kinetic_energy)]

core = scene.core()
balance = []
for dt in (4e-3, 2e-3):
    traj = cvi.simulate(scene, q0, duration=8.0, dt=dt)
    balance.append(np.abs(traj.ledger.energy_balance).max())
off = max(np.abs(core.constraint_residual(q, t)).max() for t, q in zip(traj.t, traj.q, strict=True))
pull = {name: -traj.reactions(name)[1:, 0] for name in strings}  # [N]
lift = traj.q[:, scene.q_index("left_knee")].ravel()
for name, force in pull.items():
    print(f"{name:22s} pulls with {force.min():6.3f} to {force.max():6.3f} N")
print(f"{len(traj) - 1} steps; strings too long or short by at most {off:.1e} m; knee bends from", end=" ")
print(f"{lift.min():.2f} to {lift.max():.2f} rad")
print(f"strings' work {traj.work.prescribed[-1]:.4f} J, dampers' {traj.work.damping[-1]:.4f} J,", end=" ")
order = np.log2(balance[0] / balance[1])
print(f"energy balance off by {balance[1]:.1e} J, order {order:.2f}")
if len(sys.argv) > 1:
    traj.to_html(sys.argv[1], overwrite=True, title="puppet on strings")
if off > 1e-10 or min(force.min() for force in pull.values()) <= 0.0 or abs(order - 2) > 0.3:
    raise SystemExit("a string is slack, or not as long as it should be")
