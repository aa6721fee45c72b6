"""A double pendulum tracks a motion through its impact at a wall, by LQR whose reference goes on beyond the impact.

The gains are those of the discrete time-varying LQR problem along a motion with one impact; the derivative of the step
with the impact is exact (contactvi.trep). A disturbed run hits the wall earlier or later than the reference. In between
one of the two has its speed turned back already, and feedback on their difference pushes hard the wrong way. With the
extension of hybrid LQR (Kong, Li, Council, Johnson, "Saltation matrices", arXiv:2306.06862) a run that has not hit yet
follows the motion before the impact, which goes on as if there were no wall, and one that has hit follows the motion
after the impact, followed back in time; gains there are the last and the first of each side.

python examples/lqr_through_impact.py [PICTURE.png]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import contactvi as cvi
from contactvi.trep import DiscreteSystem

DT, STEPS, NEAR = 0.005, 180, 0.05  # [s]; the last state of a run that has kept to its motion is so near
scene = cvi.load_scene(Path(__file__).resolve().parents[1] / "models" / "double_pendulum_wall.toml")
free = scene.copy()
free.disable_pair("wall", "*")


def motion(scene: cvi.Scene, q: np.ndarray, v: np.ndarray, steps: int) -> np.ndarray:
    """Return the states (q, v) of a run, (steps + 1, 4)."""
    traj = cvi.simulate(scene, q, v, duration=steps * DT, dt=DT, order=4)
    return np.hstack([traj.q, traj.v])


system = DiscreteSystem(scene, dt=DT, steps=STEPS, order=4, state="velocity")
EVENT = int(cvi.simulate(scene, duration=STEPS * DT, dt=DT, order=4).events[0].time / DT)  # the step with the impact
reference, still = motion(scene, np.array([0.3, 0.2]), np.zeros(2), STEPS), np.zeros((STEPS, 2))
before, after = reference.copy(), reference.copy()
before[EVENT:] = motion(free, reference[EVENT, :2], reference[EVENT, 2:], STEPS - EVENT)
back = motion(free, reference[EVENT + 1, :2], -reference[EVENT + 1, 2:], EVENT + 1)  # the motion is reversible
after[: EVENT + 2] = (back * [1, 1, -1, -1])[::-1]

gains = system.calc_feedback_controller(reference, still, Q=np.diag([100.0, 100.0, 1.0, 1.0]), R=0.1 * np.eye(2)).Kproj
gains_before, gains_after = gains.copy(), gains.copy()
gains_before[EVENT:], gains_after[: EVENT + 1] = gains[EVENT - 1], gains[EVENT + 1]


def track(start: np.ndarray, extended: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the states and the torques of a run with feedback from a disturbed start."""
    sim, states, torques = cvi.Simulator(scene, dt=DT, order=4), [start], []
    sim.reset(start[:2], start[2:])
    for k in range(STEPS):
        wanted, K = reference[k], gains[k]
        if extended:
            wanted, K = (after[k], gains_after[k]) if sim.impacts else (before[k], gains_before[k])
        torques.append(-K @ (states[-1] - wanted))
        assert sim.step(torques[-1]).ok
        states.append(np.concatenate([sim.q, sim.v]))
    return np.array(states), np.array(torques)


directions = np.random.default_rng(0).standard_normal((20, 4)) * [0.05, 0.05, 0.3, 0.3]  # [rad, rad/s]
kept: dict[bool, float] = {}
table = []
# At 0.02 runs hit in the same step as the motion; at 1 the linearization is what fails.
print("disturbance   worst and mean error at the end, largest torque: without | with the extension")
for size in (0.02, 0.05, 0.1, 0.3, 1.0):
    row = []
    for extended in (False, True):
        runs = [track(reference[0] + size * d, extended) for d in directions]
        errors = [float(np.linalg.norm(states[-1] - reference[-1])) for states, _ in runs]
        row.append((max(errors), float(np.mean(errors)), max(float(np.abs(torques).max()) for _, torques in runs)))
        if max(errors) < NEAR:
            kept[extended] = size
    table.append(row)
    print(f"{size:11.2f}   " + " | ".join(f"{worst:.4f}  {mean:.4f}  {peak:6.2f} N m" for worst, mean, peak in row))
print(f"all runs end within {NEAR} of the motion up to {kept[False]} without, {kept[True]} with the extension")
if len(sys.argv) > 1:
    time = DT * np.arange(STEPS)
    for extended, style in ((False, "-"), (True, "--")):
        for d in directions[:3]:
            label = f"{'with' if extended else 'without'} the extension"
            plt.plot(time, np.linalg.norm(track(reference[0] + 0.1 * d, extended)[1], axis=1), style, label=label)
    plt.gca().set(xlabel="time [s]", ylabel="norm of the torques [N m], three disturbances")
    plt.legend()
    plt.savefig(sys.argv[1])
assert kept[True] > kept[False]
assert all(with_it[1] < without[1] and with_it[2] < 0.5 * without[2] for without, with_it in table[1:4])
