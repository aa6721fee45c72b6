"""Times of questions about the equations of motion of a scene, on chains of revolute joints.

    python benchmarks/dynamics.py [--links 6 32 300] [--repeats 15]

Each is the least of the repeats, a mean of many calls; the scene is built before. Beside them Pinocchio's nle, the
recursion of bias_forces, on a pin.Data that is there, and the time to make that, whose tensors have the size nv^3.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin

import contactvi as cvi

# [us] by the number of links
BARS = {"bias_forces": {6: 15.0, 32: 60.0}, "forward_dynamics_derivatives": {6: 250.0}}


def chain(links: int) -> pin.Model:
    """Boxes of 1 kg one below the other, on joints about x and y in turn."""
    model = pin.Model()
    for k in range(links):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3 if k else 0.0]))
        joint = model.addJoint(k, (pin.JointModelRX, pin.JointModelRY)[k % 2](), place, f"j{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.1, 0.2, 0.3), pin.SE3.Identity())
    return model


def least(call: Callable[[], object], repeats: int) -> float:
    """Return the least mean time of a call [us], over bundles of about 10 ms."""
    start = time.perf_counter()
    call()
    count = max(1, int(0.01 / (time.perf_counter() - start)))
    found = []
    for _ in range(repeats):
        start = time.perf_counter()
        for _ in range(count):
            call()
        found.append((time.perf_counter() - start) / count)
    return 1e6 * min(found)


def measure(links: int, repeats: int) -> dict[str, float]:
    """Return the times [us] by the name of what is asked."""
    model, rng = chain(links), np.random.default_rng(0)
    scene = cvi.Scene.from_pinocchio(model, name="chain")
    q, v = rng.normal(size=(2, links))
    data = model.createData()
    return {
        "bias_forces": least(lambda: scene.bias_forces(q, v), repeats),
        "pin.nle": least(lambda: pin.nle(model, data, q, v), repeats),
        "mass_matrix": least(lambda: scene.mass_matrix(q), repeats),
        "forward_dynamics_derivatives": least(lambda: cvi.forward_dynamics_derivatives(scene, q, v), repeats),
        "pin.Data": least(model.createData, 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--links", nargs="+", type=int, default=[6, 32, 300])
    parser.add_argument("--repeats", type=int, default=15)
    given = parser.parse_args()
    for k, links in enumerate(given.links):
        found = measure(links, given.repeats)
        if k == 0:
            print("| links | " + " | ".join(f"{name} [us]" for name in found) + " |")
            print("|---" * (len(found) + 1) + "|")
        print(f"| {links} | " + " | ".join(f"{value:.3g}" for value in found.values()) + " |", flush=True)


if __name__ == "__main__":
    main()
