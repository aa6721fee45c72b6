"""dt = "auto" with many bodies that do not meet: time of one run of all over that of a run of each alone.

    python benchmarks/auto_islands.py [--counts 1 4 16 64] [--tol 1e-6] [--repeats 5]

Kinds of scenes: balls that bounce; boxes that slide; balls that lie still beside one that bounces. Each body starts
from a state of its own (--seed). The last column is the largest distance of a body from its run alone [m, rad].
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin

import contactvi as cvi

GAP = 3.0  # [m] between bodies
DURATION = 1.0  # [s]
Start = tuple[float, np.ndarray]  # height [m], velocity (6,)
Placed = tuple[object, np.ndarray]  # a body and its velocity
Add = Callable[[cvi.Scene, int, float, Start], Placed]


def ball(scene: cvi.Scene, k: int, x: float, start: Start) -> Placed:
    return scene.add_sphere(f"ball {k}", 0.1, 1.0, placement=(x, 0.0, 0.1 + start[0])), start[1]


def still(scene: cvi.Scene, k: int, x: float, start: Start) -> Placed:
    """The first one bounces."""
    return ball(scene, k, x, (0.0, np.zeros(6)) if k else start)


def box(scene: cvi.Scene, k: int, x: float, start: Start) -> Placed:
    v = np.array([2.0 * start[1][0], start[1][1], 0.0, 0.0, 0.0, 0.0])
    return scene.add_box(f"box {k}", (0.2, 0.3, 0.1), 1.0, placement=(x, 0.0, 0.05)), v


KINDS: dict[str, Add] = {"ball": ball, "box": box, "still": still}


def made(kind: str, starts: list[Start], which: list[int]) -> cvi.Scene:
    """Return a scene with some of the bodies, each where it is among all."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.set_contact(restitution=0.5, friction=0.3)
    speeds = {}
    for k in which:
        body, v = KINDS[kind](scene, k, GAP * k, starts[k])
        speeds[body] = (v[:3], v[3:])
    scene.v0 = scene.velocity(speeds)
    return scene


def timed(scene: cvi.Scene, tol: float, repeats: int) -> tuple[float, cvi.Trajectory]:
    """Return the least CPU time of a call [s], after a first one, and the run."""
    traj, times = cvi.simulate(scene, duration=DURATION, tol=tol), []
    for _ in range(repeats):
        begin = time.process_time()
        cvi.simulate(scene, duration=DURATION, tol=tol)
        times.append(time.process_time() - begin)
    return min(times), traj


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--counts", type=int, nargs="+", default=[1, 4, 16, 64])
    parser.add_argument("--tol", type=float, default=1e-6)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print("| kind | bodies | all [ms] | each alone, sum [ms] | ratio | apart from alone |\n|---|---|---|---|---|---|")
    for kind in KINDS:
        rng = np.random.default_rng(args.seed)
        most = max(args.counts)
        starts = [(float(rng.uniform(0.2, 1.0)), rng.uniform(-0.7, 0.7, 6)) for _ in range(most)]
        alone = [timed(made(kind, starts, [k]), args.tol, args.repeats) for k in range(most)]
        for count in args.counts:
            scene = made(kind, starts, list(range(count)))
            seconds, traj = timed(scene, args.tol, args.repeats)
            total = sum(own for own, _ in alone[:count])
            apart = max(
                float(np.linalg.norm(pin.difference(run.scene.model, run.q[-1], traj.q[-1, 7 * k : 7 * k + 7])))
                for k, (_, run) in enumerate(alone[:count])
            )
            print(
                f"| {kind} | {count} | {1e3 * seconds:.3g} | {1e3 * total:.3g} | {seconds / total:.2f} | {apart:.1e} |"
            )


if __name__ == "__main__":
    main()
