"""Runs inside a peer's interpreter: reads a job, times every setting, writes the states. Needs numpy only.

    python peer_NAME.py JOB.json OUT.json REPEATS SLOW

A peer's file defines prepare(job, setting) -> run, where run() simulates the whole scene once from its start and
returns (q, v) at the samples, joints in the job's order, after a free base's position and quaternion (x, y, z, w); a
third value is a dict of counts to keep. Loading belongs into prepare, which is not timed. The first run is a warm-up;
where it takes longer than SLOW seconds it is the measurement. A short run is repeated more often, for all peers alike.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
import numpy as np

Run = Callable[[], tuple]
SHORT, MOST = 0.01, 30  # repeats of a run: as many as fit into SHORT [s], at most MOST


def steps_per_sample(job: dict[str, Any], dt: float) -> int:
    """Number of steps between two samples."""
    steps = round(job["sample"] / dt)
    if abs(steps * dt - job["sample"]) > 1e-9:
        raise ValueError(f"dt = {dt} does not divide the sample time {job['sample']}")
    return steps


def coordinate_rate(q: np.ndarray, v: np.ndarray, free: bool) -> np.ndarray:
    """Rate of Pinocchio's configuration: v itself, but for a free base's first 7 numbers (v in the base's frame)."""
    if not free:
        return v
    x, y, z, w = q[3:7]
    a, b, c = v[3:6]
    u = v[:3]
    t = 2.0 * np.array([y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0]])
    moved = u + w * t + np.array([y * t[2] - z * t[1], z * t[0] - x * t[2], x * t[1] - y * t[0]])
    spin = 0.5 * np.array(
        [w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a, -x * a - y * b - z * c]
    )  # fmt: skip
    return np.concatenate([moved, spin, v[6:]])


def without_shapes(urdf: str) -> str:
    """The URDF's text without its collision geometry, for peers that are given it by hand."""
    return "\n".join(line[: line.index("<collision>")] if "<collision>" in line else line for line in urdf.splitlines())


def measure(prepare: Callable[[dict[str, Any], dict[str, Any]], Run]) -> None:
    """The main program of a peer's file."""
    job = json.loads(Path(sys.argv[1]).read_text())
    repeats, slow = int(sys.argv[3]), float(sys.argv[4])
    results: list[dict[str, Any]] = []
    waiting: list[tuple[dict[str, Any], Run, int]] = []
    for setting in job["settings"]:
        result: dict[str, Any] = {"setting": setting, "times": []}
        results.append(result)
        try:
            run = prepare(job, setting)
            began = time.perf_counter()
            q, v, *counts = run()
            result["times"] = [time.perf_counter() - began]
            result["q"], result["v"] = np.asarray(q).tolist(), np.asarray(v).tolist()
            result["counts"] = counts[0] if counts else {}
        except Exception as error:
            result["failed"] = "".join(traceback.format_exception_only(error)).strip()[:300]
            continue
        if result["times"][0] < slow:
            waiting.append((result, run, max(1, min(MOST, int(SHORT / result["times"][0])))))
            result["times"] = []
    for _ in range(repeats):  # one repeat of every setting, then the next
        for result, run, times in waiting:
            for _ in range(times):
                began = time.perf_counter()
                run()
                result["times"].append(time.perf_counter() - began)
    Path(sys.argv[2]).write_text(json.dumps(results))
