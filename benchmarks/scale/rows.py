"""The rows of contact_scale.py: what is measured, and the bar that each has to reach."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from contactvi.bench import heaps

# (restitution, friction) of the six runs of a family, with the seeds 0 to 5 in this order; of the large ones the seeds
# 0 to 2.
CONTACTS = ((0.0, 0.0), (0.0, 0.5), (0.0, 0.8), (0.3, 0.5), (0.8, 0.0), (0.8, 0.5))
LARGE = {"funnel": 50, "spheres": 200, "wall": 30, "bin": 20}
LARGE_CONTACTS = ((0.0, 0.5), (0.3, 0.5), (0.8, 0.5))
QUADRUPEDS = ("anymal_c", "hyq", "solo12", "a1", "go1")
WORST, MEDIAN = 15.0, 3.0  # of the times of the heaps over MuJoCo's


@dataclass
class Row:
    """A measurement.

    Attributes:
        section, name: of the table.
        job: what the worker is asked for: scene, measure, dt, ...
        unit: the result that is compared and shown, in the worker's words: ms_per_s, us_per_step, us_per_impact, ...
        ratio: the bar on the time over MuJoCo's; bar: that on contactvi's result itself. None: no bar.
        extra: bars on other results of contactvi, name -> upper bound.
        quick: whether it is part of a quick run.
    """

    section: str
    name: str
    job: dict[str, Any]
    unit: str = "ms_per_s"
    ratio: float | None = None
    bar: float | None = None
    extra: dict[str, float] = field(default_factory=dict)
    quick: bool = False


def rows() -> list[Row]:
    """All rows, section by section."""
    return [*heap_rows(), *rest_rows(), *body_rows(), *robot_rows()]


def heap_rows() -> list[Row]:
    found = []
    for family in heaps.FAMILIES:
        for seed, contact in enumerate(CONTACTS):
            found.append(heap_row(family, seed, contact, None, quick=seed == 1))
    for family, count in LARGE.items():
        for seed, contact in enumerate(LARGE_CONTACTS):
            found.append(heap_row(family, seed, contact, count, quick=False))
    return found


def heap_row(family: str, seed: int, contact: tuple[float, float], count: int | None, quick: bool) -> Row:
    restitution, friction = contact
    chosen = {"family": family, "seed": seed, "restitution": restitution, "friction": friction, "count": count}
    job = {"scene": {"kind": "heap", **chosen}, "measure": "run", "dt": 1e-3}
    job["duration"] = heaps.make(**chosen).duration
    size = f" of {count}" if count else ""
    name = f"{family}{size}, seed {seed}, e {restitution:g}, mu {friction:g}"
    return Row("heaps", name, job, ratio=WORST, quick=quick)


def rest_rows() -> list[Row]:
    found = []
    for shape, count, bar in (("box", 10, 250.0), ("sphere", 30, 200.0)):
        for awake in (True, False):
            scene = {"kind": "resting", "shape": shape, "count": count}
            job = {"scene": scene, "measure": "rest", "dt": 1e-3, "duration": 0.5, "awake": awake}
            plural = "boxes" if shape == "box" else "spheres"
            name = f"{count} resting {plural}, {'awake' if awake else 'asleep'}"
            found.append(Row("rest", name, job, unit="us_per_step", bar=bar if awake else 5.0, quick=True))
    scene = {"kind": "idle", "count": 1000}
    for name, every in (("every state kept", 1), ("one state in 100 kept", 100)):
        job = {"scene": scene, "measure": "idle", "dt": 1e-3, "duration": 1.0, "record_every": every}
        row = f"1000 idle bodies beside a moving hand, {name}: share of the hand's time"
        found.append(Row("idle", row, job, "share", bar=0.1))
    return found


def body_rows() -> list[Row]:
    job = {"scene": {"kind": "flight", "count": 300}, "measure": "run", "dt": 2e-3, "duration": 0.8}
    found = [Row("flight", "300 bodies in flight", job, unit="us_per_step", bar=150.0, quick=True)]
    for count, duration in ((10, 5.0), (100, 0.5), (1000, 0.3)):
        job = {"scene": {"kind": "gas", "count": count}, "measure": "run", "dt": 1e-2, "duration": duration}
        name = f"elastic gas of {count}"
        found.append(Row("gas", name, job, "us_per_impact", bar=50.0, extra={"drift": 1e-12}, quick=count < 1000))
    for count, bar in ((20, 1e3), (200, 20e3)):
        chosen = {"family": "spheres", "seed": 0, "restitution": 0.2, "friction": 0.5, "count": count}
        job = {"scene": {"kind": "heap", **chosen}, "measure": "run", "dt": 1e-3, "duration": 1.0}
        found.append(Row("drop", f"drop of {count} spheres", job, bar=bar, quick=count == 20))
    return found


def robot_rows() -> list[Row]:
    found = []
    bars = dict.fromkeys(QUADRUPEDS, 2.0) | {"bolt": None, "g1": 3.0, "talos": 4.0, "icub": 4.0}
    for name, bar in bars.items():
        job = {"scene": {"kind": "robot", "name": name}, "measure": "run", "dt": 1e-3, "duration": 1.0}
        found.append(Row("robots", f"{name} dropped", job, ratio=bar, quick=name in ("anymal_c", "solo12")))
    for name in ("ur5", "panda", "kinova", "xarm7"):
        job = {"scene": {"kind": "arm", "name": name}, "measure": "run", "dt": 1e-3, "duration": 2.0}
        found.append(Row("limp", f"limp {name}", job, ratio=4.0, quick=name == "ur5"))
    for name in ("g1", "talos"):
        job = {"scene": {"kind": "robot", "name": name}, "measure": "reset", "dt": 1e-3}
        found.append(Row("reset", f"reset of {name}", job, unit="ms", bar=5.0, quick=name == "talos"))
    found.append(Row("s7", "S7, the hand closes around a ball", {"measure": "hand", "dt": 1e-3}, ratio=3.4, quick=True))
    return found
