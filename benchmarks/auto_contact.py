"""dt = "auto" where contacts persist, beside the same run with dt=1e-3: time, error, and how good its estimate is.

    python benchmarks/auto_contact.py [--tol 1e-6] [--scenes ur5 hand] [--finer 16]

Limp arms that fall on their limits and links for 2 s, a limp Talos that is dropped on the ground, the ball of
models/allegro_ball.toml that falls into the hand. For each: the time of a call with dt=1e-3 [s], that of dt="auto" over
it, the contact steps of its last run over those of dt=1e-3, the error of q (largest over a hundred times), the estimate
over the error, what was warned of, and how far the reference itself is from one with contact steps twice as long. The
reference has contact steps that are shorter by the factor `--finer` than the shortest ones of the run; where it is not
much closer to its own companion than to the run, the motion multiplies errors, and of the error the order is known.
Times are CPU times of this process.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parent / "scale"))

import scale_scenes

import contactvi as cvi
from contactvi.states import States

ROOT = Path(__file__).resolve().parents[1]
LOOKS = 100  # times at which q is compared
BAR = 10.0  # times as long as with dt=1e-3, at most
LONGEST = 5e-3  # [s] smooth step of the references, of order 16
Case = tuple[cvi.Scene, Any, Any, float]  # scene, q0, v0, duration [s]


def arm(name: str) -> Case:
    made = scale_scenes.arm(name)
    return made.scene, made.q0, made.v0, 2.0


def talos() -> Case:
    """Talos in its stance, 15 cm above the ground, without servos, which need steps of one length."""
    made = scale_scenes.robot("talos", held=False)
    return made.scene, made.q0, made.v0, 0.6


def hand() -> Case:
    scene = cvi.load_scene(ROOT / "models" / "allegro_ball.toml")
    scene.settings = {}
    return scene, None, None, 1.0


CASES: dict[str, Callable[[], Case]] = {
    "ur5": lambda: arm("ur5"),
    "kinova": lambda: arm("kinova"),
    "so100": lambda: arm("so100"),
    "talos": talos,
    "hand": hand,
}


def run(case: Case, **options: Any) -> tuple[cvi.Trajectory, float, str]:
    """Return the run, the time of the call [s] and what it warned of."""
    scene, q0, v0, duration = case
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        began = time.process_time()
        traj = cvi.simulate(scene, q0, v0, duration, throw=False, **options)
        seconds = time.process_time() - began
    return traj, seconds, "; ".join(str(item.message) for item in caught)


def distance(one: cvi.Trajectory, other: cvi.Trajectory, duration: float) -> float:
    """Return the largest |q - q'| at times that both runs have reached."""
    end = min(duration, float(one.t[-1]), float(other.t[-1]))
    times = np.linspace(0.0, end, LOOKS + 1)[1:]
    return float(States(one.scene.model).distance(one.at(times).q, other.at(times).q).max())


def fixed(duration: float, contact: float) -> dict[str, Any]:
    """Return the options of a reference with contact steps of at most so many seconds."""
    dt = duration / np.ceil(duration / LONGEST)
    return {"dt": dt, "order": 16, "solver_tol": 1e-13, "dt_contact": dt / np.ceil(dt / contact),
            "contact_mode": "events", "record_contacts": False}  # fmt: skip


class Compared(NamedTuple):
    """A scene with dt=1e-3 and with dt="auto".

    Attributes:
        plain, auto: the runs.
        seconds, took: the times of their calls [s].
        warned: what the second one warned of.
    """

    plain: cvi.Trajectory
    auto: cvi.Trajectory
    seconds: float
    took: float
    warned: str


def compare(case: Case, tol: float) -> Compared:
    run(case, dt=1e-3)
    plain, seconds, _ = run(case, dt=1e-3)
    auto, took, warned = run(case, dt="auto", tol=tol)
    return Compared(plain, auto, seconds, took, warned)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tol", type=float, default=1e-6)
    parser.add_argument("--scenes", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--finer", type=float, default=16.0)
    given = parser.parse_args()
    print(f"{'scene':7} {'1e-3 s':>8} {'auto':>6} {'steps':>6} {'dt_contact':>10} {'error':>8} {'estimate/error':>14}"
          f" {'reference':>9}  status, warning")  # fmt: skip
    for name in given.scenes:
        case = CASES[name]()
        plain, auto, seconds, took, warned = compare(case, given.tol)
        steps = auto.stats.contact_steps / max(1, plain.stats.contact_steps)
        phases = auto.phases or {"dt": np.ones(1), "kind": np.array(["free"])}
        held = np.asarray(phases["dt"])[np.asarray(phases["kind"]) == "persistent"]
        contact = float(held.min()) if len(held) else 1e-3
        print(f"{name:7} {seconds:8.3f} {took / seconds:6.1f} {steps:6.1f} {contact:10.2e}", end="", flush=True)
        finer = [run(case, **fixed(case[3], contact * part / given.finer))[0] for part in (1.0, 2.0)]
        error = distance(auto, finer[0], case[3])
        print(f" {error:8.1e} {auto.error_estimate / error:14.2g} {distance(finer[0], finer[1], case[3]):9.1e}"
              f"  {auto.status.code.name} {warned}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
