"""Times of importing contactvi, of building scenes, and of steps of long chains, beside their bars.

    python benchmarks/building.py

Each number is the least of several processes of their own, since caches of a process hide what a user waits for. Files
of the robots are in the cache of the operating system. Without "again" a process has an empty cache of hulls, and fills
it; with "again" it has that of the process before. Peak memory is that of the whole process.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import NamedTuple

Measured = dict[str, float]

DATA = "example-robot-data://robots/"
ROBOTS = {
    "talos": DATA + "talos_data/robots/talos_full_v2.urdf",
    "g1": DATA + "g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "g1 with hands": DATA + "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf",
    "centauro": DATA + "centauro_description/urdf/centauro.urdf",
}
STEPS, DT = 50_000, 1e-3  # steps of all links together, [s]
FEW, MANY, RATIO = 10, 1000, 1.3  # links whose iterations are compared, per link, and the bar


class Row(NamedTuple):
    """A measurement: its title, the function and its arguments, bars for [s] and [MB], inf for none, and whether an
    earlier process has filled the cache of hulls."""

    title: str
    function: str
    argument: str
    seconds: float
    megabytes: float = float("inf")
    again: bool = False


ROWS = (
    Row("import contactvi, with Scene", "importing", "", 0.4),
    Row("build talos", "robot", "talos", 0.4),
    Row("build talos again", "robot", "talos", 0.1, again=True),
    Row("build g1", "robot", "g1", 0.8),
    Row("build g1 again", "robot", "g1", 0.1, again=True),
    Row("build g1 with hands", "robot", "g1 with hands", float("inf")),
    Row("build centauro", "robot", "centauro", 1.5),
    Row("build centauro again", "robot", "centauro", 0.1, again=True),
    Row("build a chain of 1000 links", "links", "1000", 1.0, 300.0),
    Row("build a chain of 1000 links, all pairs", "links_with_shapes", "1000", 1.0, 300.0),
)


def importing(_: str) -> Measured:
    """Import the package."""
    start = time.perf_counter()
    import contactvi

    _ = contactvi.Scene
    return {"seconds": time.perf_counter() - start}


def robot(name: str) -> Measured:
    """Load a robot with its meshes and hand it to the engine."""
    import contactvi

    scene = contactvi.Scene()
    start = time.perf_counter()
    scene.add_urdf(ROBOTS[name], base="free")
    scene.add_halfspace()
    scene.core()
    return {"seconds": time.perf_counter() - start}


def links(count: str) -> Measured:
    """Build a chain, and let it swing."""
    return chain(int(count), False)


def links_with_shapes(count: str) -> Measured:
    """Build a chain whose links may touch each other."""
    return chain(int(count), True)


def chain(count: int, shapes: bool) -> Measured:
    """Build a chain, and let it swing: seconds, of the build and of a stage iteration per link."""
    import coal
    import numpy as np
    import pinocchio as pin

    import contactvi

    model, geometry, centre = pin.Model(), pin.GeometryModel(), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.05]))
    for k in range(count):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1 if k else 0.0]))
        joint = model.addJoint(k, (pin.JointModelRX, pin.JointModelRY)[k % 2](), place, f"joint{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromCapsule(0.1, 0.02, 0.1), centre)
        if shapes:
            geometry.addGeometryObject(pin.GeometryObject(f"link{k}", joint, centre, coal.Capsule(0.02, 0.05)))
    _ = contactvi.Scene
    start = time.perf_counter()
    scene = contactvi.Scene.from_pinocchio(model, geometry)
    scene.core()
    built = time.perf_counter() - start
    q = scene.neutral()
    q[0] = 0.5
    seconds, iterations = [], []
    few = max(1, STEPS // count)
    for steps in (few, few, 5 * few):  # the first one imports; differences leave out what a run costs besides steps
        start = time.perf_counter()
        run = contactvi.simulate(scene, q, duration=steps * DT, dt=DT)
        seconds.append(time.perf_counter() - start)
        iterations.append(run.stats.stage_iterations)
    return {"seconds": built, "iteration": (seconds[2] - seconds[1]) / (iterations[2] - iterations[1]) / count}


FUNCTIONS: dict[str, Callable[[str], Measured]] = {
    function.__name__: function for function in (importing, robot, links, links_with_shapes)
}


def least(function: str, argument: str, repeats: int, again: bool = False) -> Measured:
    """Return the least of each number over several processes."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        if again:
            measure(function, argument, folder)
        for k in range(repeats):
            found.append(measure(function, argument, folder if again else f"{folder}/{k}"))
    return {key: min(row[key] for row in found) for key in found[0]}


def measure(function: str, argument: str, cache: str) -> Measured:
    """Measure in a process of its own, with the folder of a cache of hulls."""
    command = [sys.executable, __file__, "--measure", function, argument]
    done = subprocess.run(
        command, check=True, capture_output=True, text=True, env=os.environ | {"CONTACTVI_CACHE": cache}
    )
    found: Measured = json.loads(done.stdout.splitlines()[-1])
    return found


def least_of(row: Row, repeats: int) -> Measured:
    """Return the least of each number of a row over several processes."""
    return least(row.function, row.argument, repeats, row.again)


def iteration_times(repeats: int) -> tuple[float, float]:
    """Return the time of a stage iteration per link of few and of many links [s]."""
    few, many = (least("links", str(count), repeats)["iteration"] for count in (FEW, MANY))
    return few, many


def measure_all(repeats: int) -> None:
    """Print the table."""
    for row in ROWS:
        found = least_of(row, repeats)
        met = found["seconds"] <= row.seconds and found["megabytes"] <= row.megabytes
        print(
            f"{row.title:40s} {found['seconds']:7.3f} s (bar {row.seconds:g})  {found['megabytes']:5.0f} MB "
            f"(bar {row.megabytes:g})  {'met' if met else 'MISSED'}",
            flush=True,
        )
    few, many = iteration_times(repeats)
    print(
        f"per link and stage iteration: {1e9 * many:.0f} ns of {MANY} links, {1e9 * few:.0f} ns of {FEW}; "
        f"ratio {many / few:.2f} (bar {RATIO:g})  {'met' if many <= RATIO * few else 'MISSED'}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5, help="processes for each number")
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        name, argument = arguments.measure
        found = FUNCTIONS[name](argument)
        print(json.dumps(found | {"megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0}))
        return
    measure_all(arguments.repeats)


if __name__ == "__main__":
    main()
