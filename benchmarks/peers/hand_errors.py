"""S7: the time that an error of the ball's place and of the contact forces costs, contactvi beside MuJoCo, in one run.

    python benchmarks/peers/hand_errors.py [-o DIR] [--passes 3] [--repeats 5]

Each simulator is compared with its own limit, its run at the smallest step (LIMIT), because contact with friction is of
another kind in each. place: distance of the ball at the end from that of the limit. force: relative error of the mean,
over the last half second, of the sum of the normal forces of all contacts. A bar is met at a step if this step and all
smaller ones meet it; the fastest such step counts. Times, interpreters and peers as in compare_hand.py.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import hand
import numpy as np
from bars import describe
from compare import call, interpreter, versions

PLACE, FORCE = 2e-4, 0.01  # the bars: [m], relative
BARS = (("place 0.2 mm", "place", PLACE), ("force 1 %", "force", FORCE))  # name, measure, bar
LIMIT = 2e-5  # s
STEPS = (2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5)  # s
KINDS: dict[str, dict[str, Any]] = {
    "contactvi": {"order": 2},
    "mujoco": {"integrator": "implicitfast"},
    "mujoco, stiff": {"integrator": "implicitfast", "cone": "elliptic", "stiff": True},
}
Row = dict[str, Any]


def errors(kind: str, job: dict[str, Any], folder: Path, timeout: float) -> list[Row]:
    """A row per step: its errors, from runs that are not timed."""
    settings = [{**KINDS[kind], "dt": dt, "squeeze": True} for dt in (LIMIT, *STEPS)]
    limit, *others = call(kind.split(",")[0], {**job, "settings": settings}, folder, 0, 0.0, timeout)
    found = []
    for dt, result in zip(STEPS, others, strict=True):
        row = {
            "kind": kind,
            "setting": {**KINDS[kind], "dt": dt},
            "failed": result.get("failed", ""),
            "seconds": np.inf,
        }
        found.append(row)
        if row["failed"]:
            continue
        ends = [np.array(r["q"][-1][16:]) for r in (result, limit)]
        squeeze, exact = result["counts"]["squeeze"], limit["counts"]["squeeze"]
        row.update(place=float(np.linalg.norm(ends[0] - ends[1])), force=abs(squeeze / exact - 1.0), squeeze=squeeze)
    return found


def clock(
    kind: str, job: dict[str, Any], rows: list[Row], folder: Path, repeats: int, slow: float, timeout: float
) -> None:
    """One pass through the steps of a kind; of each the fastest time counts."""
    mine = [row for row in rows if row["kind"] == kind and not row["failed"]]
    timed = {**job, "settings": [row["setting"] for row in mine]}
    results = call(kind.split(",")[0], timed, folder, repeats, slow, timeout)
    for row, result in zip(mine, results, strict=True):
        row["seconds"] = min([row["seconds"], *result["times"]])


def fastest(rows: list[Row], measure: str, bar: float) -> Row | None:
    """The fastest row among those that meet the bar, as all smaller steps do."""
    good: list[Row] = []
    for row in reversed(rows):
        if row["failed"] or not row[measure] <= bar:
            break
        good.append(row)
    return min(good, key=lambda row: row["seconds"], default=None)


def tables(rows: list[Row], duration: float) -> list[str]:
    lines = ["| | setting | ms per s | place mm | force | sum of normal forces N |", "|---|---|---|---|---|---|"]
    for row in rows:
        if row["failed"]:
            lines.append(f"| {row['kind']} | {describe(row['setting'])} | {row['failed'][:80]} | | | |")
            continue
        cells = [
            row["kind"], describe(row["setting"]), f"{1e3 * row['seconds'] / duration:.3g}",
            f"{1e3 * row['place']:.2g}", f"{row['force']:.1e}", f"{row['squeeze']:.4f}",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", "dt [s]: ms per s.", "", "| bar | " + " | ".join(KINDS) + " |", "|---" * (1 + len(KINDS)) + "|"]
    for name, measure, bar in BARS:
        best = [fastest([r for r in rows if r["kind"] == kind], measure, bar) for kind in KINDS]
        cells = [f"{r['setting']['dt']:g}: {1e3 * r['seconds'] / duration:.3g}" if r else "not met" for r in best]
        lines.append("| " + " | ".join([name, *cells]) + " |")
    return lines


def measure(passes: int, repeats: int, slow: float, timeout: float) -> tuple[list[Row], float]:
    """Return a row per kind and step, with its errors and its time, and the duration of the run [s]."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        job = hand.job(folder)
        rows = [row for kind in KINDS for row in errors(kind, job, folder, timeout)]
        for _ in range(passes):
            for kind in KINDS:
                clock(kind, job, rows, folder, repeats, slow, timeout)
    return rows, float(job["duration"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--passes", type=int, default=3, help="through everything; the fastest time counts")
    parser.add_argument("--slow", type=float, default=1.0, help="a first run longer than this is the only one [s]")
    parser.add_argument("--timeout", type=float, default=300.0, help="of one peer in one pass [s]")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/hand"))
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    if not interpreter("mujoco"):
        parser.error("MuJoCo is not installed (CONTACTVI_PEER_MUJOCO)")
    rows, duration = measure(args.passes, args.repeats, args.slow, args.timeout)
    head = f"{time.strftime('%Y-%m-%d')}; " + ", ".join(
        f"{k} {v}" for k, v in versions(["contactvi", "mujoco"]).items()
    )
    text = "\n".join([head + ".", "", *tables(rows, duration), ""])
    (args.output / "hand_errors.json").write_text(json.dumps(rows, indent=1))
    (args.output / "hand_errors.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
