"""The Allegro hand moves a ball in its palm by sampling-based control (MPPI): no gradient, only many short runs.

In every control cycle the engine's threads make K runs from the present state of the simulator, contacts included, with
random changes of the servos' targets that fade in. The cost of each is the distance of the ball from its wanted place;
the changes are averaged with weights exp(-cost / temperature), and the hand makes the first part of the result.

python examples/hand_mppi.py [PICTURE.png] [--cycles 40] [--samples 64]
"""

import argparse
import time
import warnings

import matplotlib.pyplot as plt
import numpy as np
from hand_control.scene import hand

import contactvi as cvi

DT, CYCLE, HORIZON, KNOTS = 2e-3, 10, 75, 3  # [s], steps; steps between two decisions, of a plan; numbers of a target
FROM, TO = (-0.065, 0.03), (-0.04, 0.0)  # of the ball in the palm, along the fingers and across [m]
SPREAD = np.array([0.002, 0.05, 0.05] + [0.02] * 16)  # of the samples: lift [m], pitch, roll, fingers [rad]
REACH = 4.0 * SPREAD  # how far targets go from those that hold the ball
TEMPERATURE = 0.05  # of the spread of the costs

parser = argparse.ArgumentParser()
parser.add_argument("picture", nargs="?")
parser.add_argument("--cycles", type=int, default=40)
parser.add_argument("--samples", type=int, default=64)
arguments = parser.parse_args()
warnings.simplefilter("ignore", cvi.DenseStepWarning)
rng = np.random.default_rng(0)

(scene, start, held), wanted = hand(FROM), np.array(TO)
times = (np.arange(HORIZON) + 1.0) / HORIZON * KNOTS
basis = np.maximum(0.0, 1.0 - np.abs(times[:, None] - np.arange(KNOTS + 1.0)))  # (HORIZON, KNOTS + 1), linear
ball, spin = slice(19, 21), slice(19, 21)  # its place in q and its velocity in v


def cost(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the cost of runs at their nodes (runs, nodes, ...): off the wanted place, and speed there."""
    off, speed = q[:, :, ball] - wanted, v[:, :, spin]
    running = (off**2).sum(axis=2) + 0.01 * (speed**2).sum(axis=2)
    lost = np.abs(q[:, -1, 21] - q[:, 0, 21]) > 0.02  # [m] the ball rolls off the palm
    return 1e4 * (running.mean(axis=1) + running[:, -1]) + 1e3 * lost


def control() -> tuple[np.ndarray, float, int]:
    """Return the places of the ball in every cycle (cycles + 1, 2), seconds of a cycle, and the number of runs."""
    sim = cvi.Simulator(scene, dt=DT, record=False)
    sim.reset(start)
    plan = np.zeros((KNOTS + 1, 19))
    places, runs, began = [sim.q[ball]], 0, time.perf_counter()
    for _ in range(arguments.cycles):
        samples = plan + SPREAD * rng.standard_normal((arguments.samples, KNOTS + 1, 19))
        samples[0], samples[:, 0] = plan, plan[0]  # a plan goes on from where the targets are
        samples = np.clip(samples, -REACH, REACH)
        result = cvi.simulate_batch(sim, target=held + basis @ samples, duration=DT * HORIZON, keep="nodes")
        costs = np.where(result.ok, cost(np.nan_to_num(result.q), np.nan_to_num(result.v)), np.inf)
        scale = TEMPERATURE * max(np.std(costs[result.ok]), 1e-9)
        weights = np.exp(-(costs - costs.min()) / scale)
        plan = np.einsum("k,kij->ij", weights / weights.sum(), samples)
        sim.run(CYCLE, target=held + basis[:CYCLE] @ plan)
        later = np.minimum(np.arange(KNOTS + 1.0) + CYCLE / HORIZON * KNOTS, KNOTS)  # the plan, a cycle later
        plan = np.maximum(0.0, 1.0 - np.abs(later[:, None] - np.arange(KNOTS + 1.0))) @ plan
        places.append(sim.q[ball])
        runs += arguments.samples
    return np.array(places), (time.perf_counter() - began) / arguments.cycles, runs


def main() -> None:
    places, seconds, runs = control()
    span = DT * CYCLE * arguments.cycles
    idle = cvi.simulate(scene, start, target=np.tile(held, (CYCLE * arguments.cycles, 1)), duration=span, dt=DT)
    idle_off = np.linalg.norm(idle.q[::CYCLE, ball] - wanted, axis=1)
    off = np.linalg.norm(places - wanted, axis=1)
    print(f"{runs} runs of {DT * HORIZON:g} s, {1e3 * seconds:.0f} ms a cycle of {1e3 * DT * CYCLE:g} ms")
    print(f"after {span:g} s the ball is {1e3 * off[-1]:.1f} mm from its wanted place, {1e3 * off[0]:.1f} mm before")
    print(f"with a hand that does nothing it is {1e3 * idle_off[-1]:.1f} mm from there")
    assert off[-1] < (0.2 if arguments.cycles >= 40 else 0.95) * idle_off[-1]
    if arguments.picture:
        figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
        clock = DT * CYCLE * np.arange(len(off))
        axes[0].plot(clock, 1e3 * off, label="MPPI")
        axes[0].plot(clock, 1e3 * idle_off, "--", label="nothing done")
        axes[0].set(xlabel="time [s]", ylabel="ball to wanted place [mm]")
        axes[0].legend()
        axes[1].plot(*(1e3 * places.T), ".-")
        axes[1].plot(*(1e3 * wanted), "k+", markersize=12)
        axes[1].set(xlabel="along the fingers [mm]", ylabel="across [mm]", aspect="equal")
        figure.savefig(arguments.picture, dpi=110)


if __name__ == "__main__":
    main()
