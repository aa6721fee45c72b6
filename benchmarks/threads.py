"""One run in several threads: the islands of a scene side by side.

    python benchmarks/threads.py [--threads 2] [--repeats 3]

Wall time of a run with one thread and with several, each the least of the repeats; both have to end in the same bits.
Boxes are thrown on a plane, each an island of its own, for .3 s in steps of 1 ms; those in flight are the ones of
`contact_scale.py`, for .4 s in steps of 2 ms.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import contactvi as cvi

sys.path.insert(0, str(Path(__file__).resolve().parent / "scale"))
from scale_scenes import flight, grid

Start = tuple[cvi.Scene, np.ndarray, np.ndarray]


def thrown(count: int) -> Start:
    """Return boxes over a plane that cannot meet, with their starts."""
    random, scene = np.random.default_rng(0), cvi.Scene()
    scene.add_halfspace(name="ground")
    q, v = [], []
    for k, place in enumerate(grid(count, 0.6)):
        scene.add_box(f"box{k}", (0.2, 0.16, 0.1))
        turn = random.normal(size=4)
        q += [*(place + [0.0, 0.0, 0.25]), *turn / np.linalg.norm(turn)]
        v += list(random.normal(size=6))
    scene.set_contact(restitution=0.3, friction=0.5)
    return scene, np.array(q), np.array(v)


def flying(count: int) -> Start:
    made = flight(count)
    return made.scene, made.q0, made.v0


def least_time(start: Start, threads: int, dt: float, steps: int, repeats: int) -> tuple[float, np.ndarray]:
    """Return the wall time of the run [s] and its end."""
    scene, q, v = start
    simulator = cvi.Simulator(scene, dt=dt, threads=threads, record=False)
    times = []
    for _ in range(repeats):
        simulator.reset(q, v)
        began = time.perf_counter()
        simulator.run(steps)
        times.append(time.perf_counter() - began)
    return min(times), simulator.q.copy()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    print(f"| scene | one thread [s] | {given.threads} threads [s] | ratio |\n|---|---|---|---|")
    for name, make, count, dt, steps in (
        ("thrown boxes", thrown, 64, 1e-3, 300), ("thrown boxes", thrown, 400, 1e-3, 300),
        ("bodies in flight", flying, 300, 2e-3, 200), ("bodies in flight", flying, 1000, 2e-3, 200),
    ):  # fmt: skip
        start = make(count)
        (one, end), (several, other) = (least_time(start, n, dt, steps, given.repeats) for n in (1, given.threads))
        if not np.array_equal(end, other):
            raise SystemExit(f"{count} {name}: other bits with {given.threads} threads")
        print(f"| {count} {name} | {one:.3g} | {several:.3g} | {one / several:.2f} |", flush=True)


if __name__ == "__main__":
    main()
