"""Cost of an evaluation, of a smooth step and of an impact, beside rnea and aba of Pinocchio in the same run.

    python benchmarks/step_cost.py [--steps 2000] [--models "Allegro hand"]
    python benchmarks/step_cost.py --standing    robots on their feet: dense steps beside those with located events

Times are the fastest of several blocks: contactvi's measured in C++, with no Python in the loop; those of Pinocchio of
calls from Python, less what a call takes. Machines are noisy: quote the ratios.

- Evaluation: contactvi's kernel on each instruction set, nanoseconds for one stage when 1, 4 or 8 stages are done at
  once; `_core.kernel_seconds` documents its columns.
- Step: each order at its own h (one that reaches about the same error), tol 1e-12, on the best and on the plain
  instruction set; the error is that of q after 0.1 s against a run of order 16 with a step four times shorter.
- Midpoint step of the Allegro hand at h = 1e-3, tol 1e-12 in units of one rnea: at most 3 is wanted.
- Impact: median time of steps with one impact less that of steps without, midpoint rule.
- Standing: robots of scale/scale_scenes.py that servos hold, put on the ground and let stand for 1.2 s; then .2 s at
  1 ms in each contact mode, the fastest of three.
"""

from __future__ import annotations

import argparse
import sys
import timeit
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi import _core
from models import all_models, start, with_floor

sys.path.insert(0, str(Path(__file__).parent / "scale"))
import scale_scenes

STEPS = {2: 1e-3, 4: 5e-3, 8: 1e-2, 12: 2e-2, 16: 2e-2}  # order -> h [s]
ENDS = 0.1  # s, where the error is taken
STANDS = 0.2  # s, of a robot on its feet


def engine(scene: cvi.Scene, dt: float, order: int = 2, tol: float = 1e-12) -> _core.Simulator:
    options = _core.SimulatorOptions()
    options.dt, options.tol, options.order = dt, tol, order
    return _core.Simulator(scene.core(), options)


def pinocchio_seconds(model: pin.Model, q: np.ndarray, v: np.ndarray) -> tuple[float, float]:
    """Time of one rnea and of one aba of pip's Pinocchio [s], without that of a call from Python.

    What a call takes is measured on a model that has no joint.
    """
    data, force = model.createData(), np.ones(model.nv)
    empty, none = pin.Model(), np.zeros(0)
    nothing = empty.createData()
    call = called(lambda: pin.rnea(empty, nothing, none, none, none))
    return (
        called(lambda: pin.rnea(model, data, q, v, force)) - call,
        called(lambda: pin.aba(model, data, q, v, force)) - call,
    )


def called(function: Callable[[], object], calls: int = 50, blocks: int = 30) -> float:
    """Time of a call from Python [s]."""
    return min(timeit.repeat(function, number=calls, repeat=blocks)) / calls


def evaluation_rows(name: str, scene: cvi.Scene, q: np.ndarray, v: np.ndarray) -> list[dict[str, float | str]]:
    """Nanoseconds per stage of each kernel function on each instruction set, for 1, 4 and 8 stages."""
    rows: list[dict[str, float | str]] = []
    for isa in _core.instruction_sets():
        for stages in (1, 4, 8):
            found = _core.kernel_seconds(scene.core(), q, v, stages, isa)
            rows.append({"model": name, "set": isa, "stages": stages, **{k: 1e9 * s for k, s in found.items()}})
    return rows


def smooth_cost(
    scene: cvi.Scene, q: np.ndarray, v: np.ndarray, order: int, dt: float, steps: int
) -> tuple[float, float, int]:
    """Time of a step [s], stage iterations per step, steps that were cut; NaN where the run fails."""
    simulator, best, iterations, halved = engine(scene, dt, order), np.nan, np.nan, 0
    for _ in range(7):
        simulator.reset(q, v)
        out = simulator.advance(steps, record_every=steps)
        stats = out["stats"]
        assert stats["guards_evaluated"] == 0  # a scene without pairs pays nothing for guards
        if out["code"] == 0:
            best = np.fmin(best, stats["seconds"] / steps)
            iterations, halved = stats["stage_iterations"] / steps, stats["halved"]
    return float(best), iterations, halved


def end_error(scene: cvi.Scene, q: np.ndarray, v: np.ndarray, order: int, dt: float) -> float:
    ends = []
    for method, h, tol in ((order, dt, 1e-12), (16, STEPS[16] / 4, 1e-15)):
        simulator = engine(scene, h, method, tol)
        simulator.reset(q, v)
        simulator.advance(round(ENDS / h), record_every=10**9)
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


def print_table(title: str, rows: list[dict[str, float | str]]) -> None:
    heads = list(dict.fromkeys(key for row in rows for key in row))
    print(f"\n{title}\n\n| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for row in rows:
        print(
            "| " + " | ".join(f"{x:.3g}" if isinstance(x := row.get(h, "-"), float) else str(x) for h in heads) + " |"
        )


def smooth_scene(model: pin.Model) -> cvi.Scene:
    scene = cvi.Scene.from_pinocchio(model)
    for joint in model.names[1:]:
        scene.set_joint(joint, limits=False)
    return scene


def step_rows(name: str, scene: cvi.Scene, steps: int, rnea: float, aba: float) -> list[dict[str, float | str]]:
    q, v = start(scene.model)
    sets, chosen = _core.instruction_sets(), _core.instruction_set()
    rows: list[dict[str, float | str]] = []
    for order, dt in STEPS.items():
        count = max(10, int(steps * STEPS[2] / dt))
        for isa in dict.fromkeys((sets[-1], sets[0])):
            _core.instruction_set(isa)
            seconds, iterations, halved = smooth_cost(scene, q, v, order, dt, count)
            rows.append({
                "model": name, "order": order, "h [s]": dt, "set": isa, "step us": 1e6 * seconds,
                "step/rnea": seconds / rnea, "step/aba": seconds / aba, "ms per s": 1e3 * seconds / dt,
                "iterations": iterations, "halved": halved, "error of q": f"{end_error(scene, q, v, order, dt):.1e}",
            })  # fmt: skip
    _core.instruction_set(chosen)
    return rows


def standing_rows() -> list[dict[str, float | str]]:
    """Time of a step of robots that stand, in both contact modes."""
    rows: list[dict[str, float | str]] = []
    for name in ("anymal_c", "hyq", "a1", "g1", "icub"):
        made = scale_scenes.robot(name)
        q = made.q0.copy()
        q[2] -= scale_scenes.DROP - 1e-6
        rest = cvi.simulate(made.scene, q, made.v0, 1.2, dt=1e-3)
        seconds = {}
        for mode in ("events", "steps"):
            runs = [
                cvi.simulate(made.scene, rest.q[-1], rest.v[-1], STANDS, dt=1e-3, contact_mode=mode) for _ in range(3)
            ]
            seconds[mode] = min(run.stats.seconds for run in runs) / (STANDS / 1e-3)
        rows.append({
            "robot": name, "nv": made.scene.nv, "events us": 1e6 * seconds["events"],
            "dense us": 1e6 * seconds["steps"],
            "ratio": seconds["steps"] / seconds["events"],
        })  # fmt: skip
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=2000, help="of 1e-3 s; a tenth of it for large models")
    parser.add_argument("--models", default="")
    parser.add_argument("--standing", action="store_true")
    args = parser.parse_args()
    if args.standing:
        print_table("Robots that stand, h = 1e-3 s", standing_rows())
        return
    tables: dict[str, list[dict[str, float | str]]] = {"base": [], "evaluations": [], "steps": [], "impacts": []}
    for name, model in all_models().items():
        if args.models and name not in args.models.split(","):
            continue
        q, v = start(model)
        scene, steps = smooth_scene(model), args.steps if model.nv < 50 else args.steps // 10
        rnea, aba = pinocchio_seconds(model, q, v)
        midpoint = smooth_cost(scene, q, v, 2, 1e-3, steps)[0]
        tables["base"].append({
            "model": name, "nv": model.nv, "rnea us": 1e6 * rnea, "aba us": 1e6 * aba, "midpoint us": 1e6 * midpoint,
            "midpoint/rnea": midpoint / rnea,
        })  # fmt: skip
        tables["evaluations"] += evaluation_rows(name, scene, q, v)
        tables["steps"] += step_rows(name, scene, steps, rnea, aba)
        impact, seen = impact_cost(model, q, v, 1e-3, steps)
        tables["impacts"].append({"model": name, "impact us": 1e6 * impact, "impacts seen": seen})
    print(f"Instruction sets: {', '.join(_core.instruction_sets())}; used: {_core.instruction_set()}.")
    print_table("Pinocchio, and the midpoint step at h = 1e-3 s, tol 1e-12", tables["base"])
    print_table("Evaluations, ns per stage", tables["evaluations"])
    print_table("Steps, tol 1e-12", tables["steps"])
    print_table("Impacts", tables["impacts"])


if __name__ == "__main__":
    main()
