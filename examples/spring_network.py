"""A net of springs under tension: its drum modes have the frequencies of the closed form, dampers take what is lost.

python examples/spring_network.py [PLAYBACK.html]
"""

import sys

import numpy as np

import contactvi as cvi

n, mass, spacing, stiffness, rest = 4, 0.1, 0.1, 50.0, 0.06  # n x n knots [kg], pitch [m], springs [N/m], length [m]
tension = stiffness * (spacing - rest)  # [N]


def net(damping):
    """Return a scene of n x n small balls; each is joined to its neighbours, the outer ones to a frame."""
    scene = cvi.Scene(gravity=(0, 0, 0))
    inner = range(1, n + 1)
    for i in inner:
        for j in inner:
            scene.add_sphere(f"knot_{i}{j}", radius=0.01, mass=mass, placement=(i * spacing, j * spacing, 0))

    def join(a, b):
        ends = []
        for i, j in (a, b):
            free = i in inner and j in inner
            ends.append((f"knot_{i}{j}", (0, 0, 0)) if free else ("world", (i * spacing, j * spacing, 0)))
        (first, at), (second, to) = ends
        scene.add_spring(first, second, stiffness, rest_length=rest, damping=damping, point_a=at, point_b=to)

    for i in inner:
        for j in range(n + 1):
            join((i, j), (i, j + 1))
            join((j, i), (j + 1, i))
    return scene


def mode(r, s):
    """Return the shape (n n,) of the drum mode (r, s) and its frequency [rad/s].

    m z'' = -(tension / spacing) (4 z - neighbours) gives w^2 = 4 tension / (m spacing) (sin^2 a + sin^2 b).
    """
    k = np.arange(1, n + 1) * np.pi / (n + 1)
    a, b = (0.5 * x * np.pi / (n + 1) for x in (r, s))
    return np.outer(np.sin(r * k), np.sin(s * k)).ravel(), np.sqrt(
        4 * tension / (mass * spacing) * (np.sin(a) ** 2 + np.sin(b) ** 2)
    )


def deflected(scene, shape, height):
    """Return the configuration with the knots lifted by height times the shape [m]."""
    q = scene.neutral()
    q[2::7] = height * shape
    return q


scene, worst = net(0.0), 0.0
for r, s in ((1, 1), (2, 1), (3, 3), (4, 4)):
    shape, omega = mode(r, s)
    # Lifted by a micrometre the net is linear; order 4 measures the frequency to more than the amplitude spoils.
    traj = cvi.simulate(scene, deflected(scene, shape, 1e-6), duration=1.0, dt=5e-3, order=4)
    z = traj.q[:, 2::7] @ shape / (1e-6 * shape @ shape)
    error = np.abs(z - np.cos(omega * traj.t)).max()
    worst = max(worst, error)
    print(f"mode ({r}, {s})  {omega / (2 * np.pi):.6f} Hz  off cos(w t) by {error:.1e} of its height")

balance, scene = [], net(0.5)
start = deflected(scene, mode(1, 1)[0] + 0.5 * mode(3, 2)[0], 0.05)  # large: springs get twice as long
for dt in (4e-3, 2e-3):
    traj = cvi.simulate(scene, start, duration=2.0, dt=dt)
    balance.append(np.abs(traj.ledger.energy_balance).max())
order = np.log2(balance[0] / balance[1])
print(f"with dampers the energy falls from {traj.energy[0]:.4f} to {traj.energy[-1]:.4f} J, they take", end=" ")
print(f"{traj.work.damping[-1]:.4f} J; balance off by {balance[1]:.1e} J, order {order:.2f}")
if len(sys.argv) > 1:
    traj.to_html(sys.argv[1], overwrite=True, title="a net of springs")
if worst > 1e-4 or abs(order - 2) > 0.2:
    raise SystemExit("the net has other frequencies, or loses another energy than its dampers take")
