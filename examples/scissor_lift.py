"""A scissor lift with three loops on loops: a prescribed motion of its foot lifts it, and all loops stay closed.

python examples/scissor_lift.py [PLAYBACK.html]
"""

import sys
from pathlib import Path

import numpy as np

import contactvi as cvi

models = Path(__file__).resolve().parents[1] / "models"
stages, platform, bar, slider, gravity = 3, 5.0, 1.0, 0.5, 9.81  # of the file [kg]; bars of 1 m
low, high, duration = 0.3, 1.1, 2.0  # angle of the bars at the start and at the end [rad], time of the lift [s]

scene = cvi.Scene(gravity=(0, 0, -gravity))
scene.add_urdf(models / "scissor_lift.urdf", limits=False)
loops = [scene.add_point("foot", "b1", (0, 0, 0), (0.5, 0, 0))]
# The points have three rows and the mechanism is planar: one of each is redundant, which does no harm.
for k in range(1, stages):
    loops.append(scene.add_point(f"a{k}", f"b{k + 1}", (1, 0, 0), (0.5, 0, 0)))
loops.append(scene.add_point(f"a{stages}", "top", (1, 0, 0), (0, 0, 0)))


def foot(t):
    """Place of the foot, from cos(low) to cos(high) and then at rest: smooth to the third derivative."""
    s = min(t / duration, 1.0)
    return np.cos(low) + (np.cos(high) - np.cos(low)) * s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)


scene.prescribe("foot_slide", foot, name="motor")
guess = {f"hinge_{side}{k}": 2 * low * sign for k in (1, 2, 3) for side, sign in (("a", 1), ("b", -1))}
q0 = scene.assemble(scene.configuration({**guess, "hinge_a1": low, "hinge_platform": low, "foot_slide": foot(0.0)}))

balance = []
for dt in (1e-2, 5e-3):
    traj = cvi.simulate(scene, q0, duration=2.5, dt=dt)
    balance.append(np.abs(traj.energy - traj.energy[0] - traj.work.prescribed).max())

core = scene.core()
loop = max(np.abs(core.constraint_residual(q, t)).max() for t, q in zip(traj.t, traj.q, strict=True))
at = scene.q_index("foot_slide")
height = traj.potential_energy / gravity  # [kg m]: every weight is at a known fraction of the platform's height
x = traj.q[:, at].ravel()
exact = (bar * stages**2 + (platform + slider) * stages) * np.sqrt(1 - x**2) + platform * 0.05
# At rest the motor holds dV/dx, by virtual work.
hold = -(bar * stages**2 + (platform + slider) * stages) * gravity * x[-1] / np.sqrt(1 - x[-1] ** 2)
force = traj.reactions("motor")[-1, 0]
order = np.log2(balance[0] / balance[1])
print(f"{len(traj) - 1} steps, platform from {stages * np.sqrt(1 - x[0] ** 2):.4f} to {stages * np.sin(high):.4f} m")
print(f"loops open by at most {loop:.1e}; heights off by {np.abs(height - exact).max():.1e} kg m")
print(
    f"work of the motor {traj.work.prescribed[-1]:.6f} J, energy less work off by {balance[1]:.1e} J, order {order:.3f}"
)
print(f"force at rest {force:.9f} N, by virtual work {hold:.9f} N")
if len(sys.argv) > 1:
    traj.to_html(sys.argv[1], overwrite=True, title="scissor lift")
if loop > 1e-10 or np.abs(height - exact).max() > 1e-8 or abs(order - 2) > 0.1 or abs(force - hold) > 1e-9 * abs(hold):
    raise SystemExit("the lift does not keep its laws")
