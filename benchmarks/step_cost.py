"""Cost of a smooth midpoint step and of an impact, beside one rnea of Pinocchio in the same run.

    python benchmarks/step_cost.py [--dt 1e-3] [--steps 3000]

Times are the fastest of several blocks, measured in C++ (no Python in the loop). Machines are noisy: quote the ratios.
The error beside each time is that of the configuration at the end of 0.1 s against a run with dt/16.
"""

from __future__ import annotations

import argparse

import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi import _core
from models import all_models, start, with_floor


def engine(scene: cvi.Scene, dt: float) -> _core.Simulator:
    return _core.Simulator(scene.core(), dt)


def rnea_seconds(model: pin.Model, q: np.ndarray, v: np.ndarray) -> float:
    buffer = pin.serialization.StreamBuffer()
    model.saveToBinary(buffer)
    return _core.rnea_seconds(buffer.tobytes(), q, v)


def smooth_cost(scene: cvi.Scene, q: np.ndarray, v: np.ndarray, dt: float, steps: int) -> tuple[float, dict]:
    simulator, best, stats = engine(scene, dt), np.inf, {}
    for _ in range(7):
        simulator.reset(q, v)
        out = simulator.advance(steps, record_every=steps)
        if out["code"] == 0 and out["stats"]["seconds"] < best:
            best, stats = out["stats"]["seconds"], out["stats"]
    return best / steps, stats


def end_error(scene: cvi.Scene, q: np.ndarray, v: np.ndarray, dt: float, duration: float = 0.1) -> float:
    ends = []
    for refine in (1, 16):
        simulator = engine(scene, dt / refine)
        simulator.reset(q, v)
        simulator.advance(round(duration / dt) * refine, record_every=10**9)
        ends.append(simulator.q)
    return float(np.linalg.norm(pin.difference(scene.model, *ends)))


def impact_cost(model: pin.Model, q: np.ndarray, v: np.ndarray, dt: float, steps: int) -> tuple[float, int]:
    """Median time of steps with exactly one impact, less the median of those without."""
    simulator = engine(with_floor(model, q), dt)
    simulator.reset(q, v)
    plain, hit, before = [], [], 0
    for _ in range(steps):
        out = simulator.advance(1)
        if out["code"] != 0:
            break
        impacts = out["stats"]["impacts"] - before
        before = out["stats"]["impacts"]
        (plain if impacts == 0 else hit).append(out["stats"]["seconds"] / max(1, impacts))
    if not hit:
        return float("nan"), 0
    return float(np.median(hit) - np.median(plain)), len(hit)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dt", type=float, default=1e-3)
    parser.add_argument("--steps", type=int, default=3000)
    args = parser.parse_args()
    print(f"dt = {args.dt} s, tolerance 1e-12\n")
    print("| model | nv | rnea us | step us | step/rnea | iterations | error of q(0.1) | impact us | impacts seen |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, model in all_models().items():
        q, v = start(model)
        scene = cvi.Scene.from_pinocchio(model)
        for joint in model.names[1:]:
            scene.set_joint(joint, limits=False)
        steps = args.steps if model.nv < 50 else args.steps // 10
        rnea = 1e6 * rnea_seconds(model, q, v)
        step, stats = smooth_cost(scene, q, v, args.dt, steps)
        impact, seen = impact_cost(model, q, v, args.dt, steps)
        assert stats["guards_evaluated"] == 0  # a scene without pairs pays nothing for guards
        print(
            f"| {name} | {model.nv} | {rnea:.2f} | {1e6 * step:.2f} | {1e6 * step / rnea:.2f} "
            f"| {stats['iterations'] / stats['steps']:.1f} | {end_error(scene, q, v, args.dt):.1e} "
            f"| {1e6 * impact:.1f} | {seen} |"
        )


if __name__ == "__main__":
    main()
