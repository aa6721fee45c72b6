"""Runs inside a peer's interpreter: reads a job, times every setting, writes the states. Needs numpy only.

    python peer_NAME.py JOB.json OUT.json REPEATS SLOW

A peer's file defines prepare(job, setting) -> run, where run() simulates the whole scene once from its start and
returns (q, v) at the samples, joints in the job's order. Loading belongs into prepare, which is not timed. The first
run is a warm-up; where it takes longer than SLOW seconds it is the measurement.
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

Run = Callable[[], tuple[Any, Any]]


def steps_per_sample(job: dict[str, Any], dt: float) -> int:
    """Number of steps between two samples."""
    steps = round(job["sample"] / dt)
    if abs(steps * dt - job["sample"]) > 1e-9:
        raise ValueError(f"dt = {dt} does not divide the sample time {job['sample']}")
    return steps


def without_shapes(urdf: str) -> str:
    """The URDF's text without its collision geometry, for peers that are given it by hand."""
    return "\n".join(line[: line.index("<collision>")] if "<collision>" in line else line for line in urdf.splitlines())


def measure(prepare: Callable[[dict[str, Any], dict[str, Any]], Run]) -> None:
    """The main program of a peer's file."""
    job = json.loads(Path(sys.argv[1]).read_text())
    repeats, slow = int(sys.argv[3]), float(sys.argv[4])
    results: list[dict[str, Any]] = []
    waiting: list[tuple[dict[str, Any], Run]] = []
    for setting in job["settings"]:
        result: dict[str, Any] = {"setting": setting, "times": []}
        results.append(result)
        try:
            run = prepare(job, setting)
            began = time.perf_counter()
            q, v = run()
            result["times"] = [time.perf_counter() - began]
            result["q"], result["v"] = np.asarray(q).tolist(), np.asarray(v).tolist()
        except Exception as error:
            result["failed"] = "".join(traceback.format_exception_only(error)).strip()[:300]
            continue
        if result["times"][0] < slow:
            result["times"] = []
            waiting.append((result, run))
    for _ in range(repeats):  # one repeat of every setting, then the next
        for result, run in waiting:
            began = time.perf_counter()
            run()
            result["times"].append(time.perf_counter() - began)
    Path(sys.argv[2]).write_text(json.dumps(results))
