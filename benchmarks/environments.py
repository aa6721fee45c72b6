"""Steps per second of the environments of contactvi.gym: in the engine's threads, one after the other, in processes.

python benchmarks/environments.py [--numbers 1 8 64] [--steps 25] [--rounds 9] [--pictures]

Episodes of equal seeds are made again and again with actions that are zero, the ways in turn. Of each step of all
environments together the least time counts, and a number is that of steps over the sum of these times: other programs
only make steps longer. A step of an environment is 20 ms. Processes are gymnasium's AsyncVectorEnv, one for each
environment, with shared memory. CPU: processor time of a step of one environment, in threads and one by one, the least
of the rounds, which other programs change less.

With --pictures instead the processor time of a picture of render_mode="rgb_array", 480x360 pixels, after each of 20
steps: the least and the mean. Of these two environments and of a scene of seven shapes without meshes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorEnv

import contactvi as cvi
import contactvi.gym
from contactvi.playback.sketch import Sketch
from contactvi.threads import cores

PICTURES = 20
NAMES = ("contactvi/HandBall-v0", "contactvi/QuadrupedStand-v0")


def cpu(envs: VectorEnv, steps: int) -> float:
    """Return the processor time of this process for a step of one environment [s]."""
    began = time.process_time()
    times(envs, steps)
    return (time.process_time() - began) / steps / envs.num_envs


def times(envs: VectorEnv, steps: int) -> list[float]:
    """Return how long each step takes [s], in episodes of the same seeds."""
    envs.reset(seed=0)
    actions = np.zeros(envs.action_space.shape, np.float32)
    found = []
    for _ in range(steps):
        began = time.perf_counter()
        envs.step(actions)
        found.append(time.perf_counter() - began)
    return found


def ways(name: str, number: int) -> dict[str, VectorEnv]:
    def make() -> gymnasium.Env:
        return gymnasium.make(f"contactvi.gym:{name}")

    makers: dict[str, Callable[[], VectorEnv]] = {
        "threads": lambda: contactvi.gym.make_vec(name, number),
        "one by one": lambda: SyncVectorEnv([make] * number),
        "processes": lambda: AsyncVectorEnv([make] * number),
    }
    return {way: maker() for way, maker in makers.items()}


def seven_shapes() -> cvi.Scene:
    """Return boxes, balls, capsules and cylinders above a plane."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(2):
        scene.add_box(f"box{k}", (0.2, 0.15, 0.1), placement=(0.4 * k, 0.0, 0.3))
        scene.add_sphere(f"ball{k}", 0.08, placement=(0.4 * k, 0.4, 0.3))
        scene.add_capsule(f"capsule{k}", 0.05, 0.15, placement=(0.4 * k, -0.4, 0.3))
    scene.add_cylinder("cylinder", 0.06, 0.2, placement=(-0.4, 0.0, 0.3))
    return scene


def picture_times() -> None:
    """Print the processor time of pictures [ms]."""
    shapes = seven_shapes()
    simulator = cvi.Simulator(shapes, dt=1e-3)
    simulator.reset()
    sketch = Sketch(shapes, shapes.neutral(), size=(480, 360))
    drawn: dict[str, tuple[Callable[[], object], Callable[[], object]]] = {
        "seven shapes": (lambda: simulator.run(20), lambda: sketch.draw(simulator.q))
    }
    for name in NAMES:
        env = gymnasium.make(f"contactvi.gym:{name}", render_mode="rgb_array")
        env.reset(seed=0)
        still = np.zeros(env.action_space.shape, np.float32)
        drawn[name] = (lambda env=env, still=still: env.step(still)), env.render
    print(f"{'picture':<28}{'least [ms]':>12}{'mean [ms]':>12}")
    for name, (step, draw) in drawn.items():
        draw()
        found = []
        for _ in range(PICTURES):
            step()
            began = time.process_time()
            draw()
            found.append(1e3 * (time.process_time() - began))
        print(f"{name:<28}{min(found):>12.1f}{np.mean(found):>12.1f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--numbers", type=int, nargs="+", default=[1, 8, 64])
    parser.add_argument("--steps", type=int, default=25)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--pictures", action="store_true", help="what pictures cost, instead")
    arguments = parser.parse_args()
    if arguments.pictures:
        return picture_times()
    print(f"{cores()} threads; steps per second")
    print(f"{'environment':<28}{'number':>7}{'threads':>10}{'one by one':>12}{'processes':>11}{'CPU [us]':>14}")
    for name in NAMES:
        for number in arguments.numbers:
            envs = ways(name, number)
            best = {way: np.full(arguments.steps, np.inf) for way in envs}
            for _ in range(arguments.rounds):
                for way, env in envs.items():
                    best[way] = np.minimum(best[way], times(env, arguments.steps))
            rates = [number * arguments.steps / best[way].sum() for way in envs]
            ours, theirs = (
                1e6 * min(cpu(envs[way], arguments.steps) for _ in range(3)) for way in ("threads", "one by one")
            )
            print(
                f"{name:<28}{number:>7}{rates[0]:>10.0f}{rates[1]:>12.0f}{rates[2]:>11.0f}{ours:>8.0f},{theirs:>5.0f}",
                flush=True,
            )
            for env in envs.values():
                env.close()


if __name__ == "__main__":
    main()
