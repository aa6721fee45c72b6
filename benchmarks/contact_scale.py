"""Contact at scale: contactvi beside MuJoCo on the same scenes with the same step, in one run, against bars.

    python benchmarks/contact_scale.py [--only heaps,rest,idle,flight,gas,drop,robots,limp,reset,s7] [--quick]
                                       [--match TEXT] [--budget 60] [--jobs 1] [--option NAME=VALUE] [-o FILE.json]

Needs mujoco in this environment. Each measurement runs in a process of its own, MuJoCo's first: one that hangs, crashes
or eats more than 6 GB is a row of the table. The budget [s] is of wall time, once for making the scene and once for
runs and measures; MuJoCo has four times as much. With -o the rows are written after each one, so that an interrupted
benchmark leaves what it has.

- time: CPU time of the process without making the scene, the best of up to three runs; ratio: over MuJoCo's.
- gap: the worst one at 16 nodes [m], by coal; below 0 shapes overlap. Of MuJoCo's states by the same check. Of
  contactvi also those of its own contacts at every step, where one is less.
- energy: the largest rise above the least value so far, over the largest kinetic energy or, where that is more, the
  weight times 1 mm. With servos contactvi's energy balance instead, and nothing of MuJoCo.
- residual: of contactvi how far the worst impulse is outside of its cone, over the largest impulse (those at the end of
  steps and of impacts); of MuJoCo the scaled gradient at which its solver stopped.

What is measured and the bars: scale/rows.py; the scenes: scale/scale_scenes.py and contactvi.bench.heaps; MuJoCo's
model of a scene: contactvi.bench.mujoco_peer.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import select
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any

import contactvi as cvi

HERE = Path(__file__).resolve().parent / "scale"
sys.path.insert(0, str(HERE))
from rows import MEDIAN, WORST, Row, rows  # noqa: E402

STARTING = 30.0  # [s] for imports
UNITS = {
    "ms_per_s": ("ms/s", 1.0), "us_per_step": ("us/step", 1.0), "us_per_impact": ("us/impact", 1.0), "ms": ("ms", 1.0),
    "share": ("%", 100.0),
}  # fmt: skip
Result = dict[str, Any]


# --- running ----------------------------------------------------------------------------------------------------------
def measure(engine: str, job: Result, budget: float) -> Result:
    """Run one measurement in a process of its own and return what it told until its end or that of the budget."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [sys.executable, str(HERE / "worker.py"), engine],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment,
    )  # fmt: skip
    assert process.stdin is not None
    process.stdin.write(json.dumps(job).encode())
    process.stdin.close()
    found: Result = {}
    for told in lines_of(process, budget):
        found.update(told)
    if not found.pop("done", False):
        late = process.poll() is None
        process.kill()
        process.wait()
        if "status" not in found:
            found["status"] = "TIMEOUT" if late else f"CRASH ({process.returncode})"
        else:
            found["unmeasured"] = "accuracy: out of time" if late else f"accuracy: crash ({process.returncode})"
    process.wait()
    return found


def lines_of(process: subprocess.Popen[bytes], budget: float) -> Iterator[Result]:
    """The dicts that a process writes, until it ends or no time is left; the budget begins anew at "ready"."""
    assert process.stdout is not None
    file, rest = process.stdout.fileno(), b""
    deadline = time.monotonic() + STARTING + budget
    while True:
        ready, *_ = select.select([file], [], [], max(0.0, deadline - time.monotonic()))
        data = os.read(file, 1 << 16) if ready else b""
        if not data:
            return
        *lines, rest = (rest + data).split(b"\n")
        for told in map(json.loads, lines):
            if told.get("ready"):
                deadline = time.monotonic() + budget
            yield told


def run(row: Row, budget: float) -> Result:
    """Both engines, and the verdict."""
    result: Result = {"section": row.section, "name": row.name, "unit": row.unit, "job": row.job}
    # Without MuJoCo's time there is no ratio, whatever contactvi does: it may take longer.
    for engine, allowed in (("mujoco", 4.0 * budget), ("contactvi", budget)):
        result[engine] = measure(engine, row.job, allowed)
    mine, peer = (value_of(result[engine], "seconds") for engine in ("contactvi", "mujoco"))
    result["ratio"] = mine / peer if mine is not None and peer else None
    result["bars"] = {"ratio": row.ratio, row.unit: row.bar, **row.extra}
    result["bars"] = {name: bar for name, bar in result["bars"].items() if bar is not None}
    values = {**result["contactvi"], "ratio": result["ratio"]}
    missed = [name for name, bar in result["bars"].items() if not meets(values.get(name), bar)]
    if result["contactvi"].get("status") != "SUCCESS":
        missed.insert(0, "status")
    result["missed"] = missed
    return result


def value_of(found: Result, unit: str) -> float | None:
    return found.get(unit) if found.get("status") in ("SUCCESS", "UNSTABLE") else None


def meets(value: float | None, bar: float) -> bool:
    return value is not None and math.isfinite(value) and value <= bar


# --- the table --------------------------------------------------------------------------------------------------------
HEAD = (
    "| scene | contactvi | MuJoCo | ratio | bar | verdict | gap m | energy | residual "
    "| MuJoCo: gap m | energy | residual | remarks |"
)


def table(results: list[Result]) -> str:
    """A row per measurement, then what the heaps have in common."""
    lines = [HEAD, "|---" * (HEAD.count("|") - 1) + "|"]
    lines += ["| " + " | ".join(cells(result)) + " |" for result in results]
    lines += summary([result for result in results if result["section"] == "heaps"])
    bars = [result for result in results if result["bars"]]
    met = sum(not result["missed"] for result in bars)
    return "\n".join([*lines, "", f"{met} of {len(bars)} rows meet their bars."])


def cells(result: Result) -> list[str]:
    mine, peer = result["contactvi"], result["mujoco"]
    name, factor = UNITS[result["unit"]]
    shown = [time_cell(found, result["unit"], name, factor) for found in (mine, peer)]
    bars = []
    for key, bar in result["bars"].items():
        label, scale = UNITS.get(key, ("times" if key == "ratio" else key, 1.0))
        bars.append(f"{scale * bar:.3g} {label}")
    verdict = "-" if not result["bars"] else "pass" if not result["missed"] else "MISS"
    energy = [mine["rise"] if "rise" in mine else mine.get("balance"), peer.get("rise")]
    return [
        result["name"], *shown, number(result["ratio"], 3), ", ".join(bars) or "-", verdict,
        number(worst_gap(mine), 2), number(energy[0], 2), number(mine.get("residual"), 2),
        number(peer.get("gap"), 2), number(energy[1], 2), number(peer.get("gradient"), 2), remark(mine),
    ]  # fmt: skip


def worst_gap(found: Result) -> float | None:
    known = [found[name] for name in ("gap", "gap_rows") if name in found]
    return min(known, default=None)


def time_cell(found: Result, unit: str, name: str, factor: float) -> str:
    for key, word, scale in ((unit, name, factor), ("ms_per_s", "ms/s", 1.0)):  # MuJoCo has no impacts to divide by
        value = value_of(found, key)
        if value is not None:
            return f"{scale * value:.3g} {word}"
    reached = f" at {found['time']:.3g} s" if "time" in found else ""
    if "so_far" in found:
        reached += f", {found['so_far']:.3g} ms/s so far"
    return f"{found.get('status', 'no answer')}{reached}"


def remark(found: Result) -> str:
    """What is worth a word: the end, the counts, what was changed in the model."""
    parts = [found.get("unmeasured", "")]
    if found.get("status") != "SUCCESS":
        parts.append(found.get("message", ""))
    counts = found.get("counts", {})
    for key in ("impacts", "dense_steps", "cone_fallbacks"):
        if counts.get(key):
            parts.append(f"{key.replace('_', ' ')} {counts[key]}")
    if found.get("drift"):
        parts.append(f"drift {found['drift']:.3g}")
    if "ms_first" in found:
        parts.append(f"first one {found['ms_first']:.3g} ms, {found['pairs']} pairs")
    parts += found.get("notes", [])
    return "; ".join(part for part in parts if part).replace("|", "/").replace("\n", " ")[:300]


def number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}g}"


def summary(heaps: list[Result]) -> list[str]:
    """The bars on all heaps together. A scene without an end counts as infinitely slow."""
    if not heaps:
        return []
    ended = sum(result["contactvi"].get("status") == "SUCCESS" for result in heaps)
    rivals = sum(result["mujoco"].get("status") == "SUCCESS" for result in heaps)
    ratios = [math.inf if result["ratio"] is None else result["ratio"] for result in heaps]
    gaps = [gap for result in heaps if (gap := worst_gap(result["contactvi"])) is not None]
    rises = [result["contactvi"]["rise"] for result in heaps if "rise" in result["contactvi"]]
    median, worst = statistics.median(ratios), max(ratios)
    return [
        "",
        f"Heaps: {ended} of {len(heaps)} end with SUCCESS (bar: all), {rivals} in MuJoCo. Time over MuJoCo's: median "
        f"{median:.3g} (bar {MEDIAN:g}), worst {worst:.3g} (bar {WORST:g}). Of those measured the worst gap is "
        f"{min(gaps, default=math.nan):.2g} m, the largest rise of the energy "
        f"{max(rises, default=math.nan):.2g}.",
    ]


# --- the command ------------------------------------------------------------------------------------------------------
def chosen_rows(args: argparse.Namespace, parser: argparse.ArgumentParser) -> list[Row]:
    found = [row for row in rows() if row.quick] if args.quick else rows()
    sections = {row.section for row in rows()}
    if args.only:
        wanted = set(args.only.split(","))
        if not wanted <= sections:
            parser.error(f"--only takes a list of {', '.join(sorted(sections))}")
        found = [row for row in found if row.section in wanted]
    return [row for row in found if args.match in row.name]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="sections, separated by commas; by default all")
    parser.add_argument("--match", default="", help="rows whose name holds this text")
    parser.add_argument("--quick", action="store_true", help="a selection that takes less than three minutes")
    parser.add_argument("--budget", type=float, help="of one measurement [s]; by default 60, of a quick run 5")
    parser.add_argument("--option", action="append", default=[], help="of contactvi's simulator, NAME=VALUE")
    parser.add_argument("--jobs", type=int, default=1, help="rows at the same time")
    parser.add_argument("-o", "--output", type=Path, help="JSON file")
    args = parser.parse_args()
    budget = args.budget or (5.0 if args.quick else 60.0)
    names = chosen_rows(args, parser)
    options = dict(option.split("=", 1) for option in args.option)
    for row in names:
        row.job["options"] = options
    about = {"contactvi": cvi.__version__} | {name: version(name) for name in ("mujoco", "pin", "coal")}
    head = {
        "date": time.strftime("%Y-%m-%d"),
        "machine": platform.machine(),
        "versions": about,
        "budget": budget,
        "options": options,
    }
    results: list[Result] = []
    with ThreadPoolExecutor(args.jobs) as pool:
        for result in pool.map(lambda row: run(row, budget), names):
            results.append(result)
            print(" | ".join(cells(result)[:6]), file=sys.stderr, flush=True)
            if args.output:
                args.output.parent.mkdir(parents=True, exist_ok=True)
                args.output.write_text(json.dumps({**head, "rows": results}, indent=1) + "\n")
    text = ", ".join(f"{name} {number}" for name, number in about.items())
    print(f"{head['date']}; {text}; budget {budget:g} s.\n\n{table(results)}")


if __name__ == "__main__":
    main()
