"""A ball on a string that a winch pulls in: it spins up, and the winch pays for it.

python examples/string_winch.py [PLAYBACK.html]
"""

import sys

import numpy as np

import contactvi as cvi

mass, long, speed, rate = 0.5, 1.0, 2.0, 0.25  # [kg], string at the start [m], of the ball, of the winch [m/s]

scene = cvi.Scene(gravity=(0, 0, 0))
ball = scene.add_sphere("ball", radius=0.03, mass=mass, placement=(long, 0, 0))
scene.add_distance("world", "ball", length=lambda t: (long - rate * t, -rate, 0.0), name="string")
v0 = scene.consistent_velocity(v=scene.velocity({ball: (0, speed, 0)}))


def measure(dt):
    """Return the largest errors of the angle [rad], the tension [N] and the winch's work [J]."""
    traj = cvi.simulate(scene, v0=v0, duration=2.0, dt=dt)
    length, middle = long - rate * traj.t, long - rate * 0.5 * (traj.t[1:] + traj.t[:-1])
    # The string's force is central: length^2 omega is constant, and the tension m (length omega^2 - length'').
    turned = long * speed * traj.t / length  # integral of long speed / length^2
    angle = np.abs(np.unwrap(np.arctan2(traj.q[:, 1], traj.q[:, 0])) - turned).max()
    tension = np.abs(-traj.reactions("string")[1:, 0] - mass * (long * speed) ** 2 / middle**3).max()
    work = np.abs(traj.work.prescribed - 0.5 * mass * ((long * speed / length) ** 2 - speed**2)).max()
    off = np.abs(np.linalg.norm(traj.q[:, :3], axis=1) - length).max()
    print(f"dt {dt:.4f} s  string off by {off:.1e} m, angle by {angle:.2e} rad, tension by {tension:.2e} N", end=", ")
    print(f"work by {work:.2e} J of {traj.work.prescribed[-1]:.4f} J")
    return off, angle, tension, work


coarse, fine = np.array(measure(1e-2)), np.array(measure(5e-3))
order = np.log2(coarse[1:] / fine[1:])
print(f"orders: angle {order[0]:.3f}, tension {order[1]:.3f}, work {order[2]:.3f} (expected 2)")
if len(sys.argv) > 1:
    cvi.simulate(scene, v0=v0, duration=2.0, dt=5e-3).to_html(
        sys.argv[1], overwrite=True, title="a winch pulls a string in"
    )
if fine[0] > 1e-10 or np.any(np.abs(order - 2) > 0.1):
    raise SystemExit(
        "the string has not the length that the winch prescribes, or the ball does not follow the closed form"
    )
