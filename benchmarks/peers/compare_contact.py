"""Lasting contact: run time against error, contactvi beside Drake (CENIC and discrete) and MuJoCo, in one run.

    python benchmarks/peers/compare_contact.py [--cases ball,rod] [--peers contactvi,drake] [--repeats 5] [-o DIR]
                                               [--plot FILE.png]

Scenes and their exact answers: contact_cases.py. How each simulator is set up: contact_contactvi.py, contact_drake.py,
contact_mujoco.py. Interpreters of the peers as in compare.py.

- time: median of the repeats [ms of wall time per simulated s], states taken at the samples (every 0.05 s, every 0.02 s
  of the rod), one thread; a run that takes longer than --slow is run once (*).
- error: largest distance over the samples of the observed points from where they are in the exact answer [m]. Contacts
  of the peers are soft, which is part of it. Without an exact answer: from contactvi's finest run.
- own error: the same from the simulator's own finest run of its kind (FINEST), which may be of softer contacts.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import contact_cases
import numpy as np
from bars import describe
from compare import call, interpreter, versions
from matplotlib.figure import Figure

PEERS = ("contactvi", "drake", "mujoco")
TARGETS = (1e-2, 1e-3, 1e-4, 1e-6, 1e-8)  # m
SMALLEST = 1e-14  # m: smaller errors are drawn here
LARGEST = 1.0  # m: what has left the scene is not drawn
Settings = list[dict[str, Any]]
Row = dict[str, Any]


def over(key: str, values: tuple[float, ...], **fixed: Any) -> Settings:
    return [{**fixed, key: value} for value in values]


def kinds(sample: float) -> dict[str, Settings]:
    """Return the settings of each kind of run, coarse to fine."""
    parts: dict[int, tuple[float, ...]] = {2: (5, 10, 50, 250), 4: (1, 2, 5, 10), 8: (0.5, 1, 2, 5)}
    own = {
        f"contactvi, order {order}": over("dt", tuple(sample / part for part in chosen), order=order)
        for order, chosen in parts.items()
    }
    return {
        **own,
        "contactvi, auto": over("tol", (1e-4, 1e-6, 1e-8), dt="auto"),
        "drake, CENIC": over("accuracy", (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)),
        "drake, CENIC, stiff": over("accuracy", (1e-2, 1e-3, 1e-4, 1e-5), stiffness=1e8),
        "drake, SAP": over("dt", (1e-2, 5e-3, 1e-3, 1e-4), approximation="sap"),
        "drake, SAP, stiff": over("dt", (5e-3, 1e-3, 1e-4), approximation="sap", stiffness=1e9),
        "drake, lagged": over("dt", (1e-2, 5e-3, 1e-3, 1e-4), approximation="lagged"),
        "mujoco, Euler": over("dt", (5e-3, 2e-3, 1e-3, 1e-4), integrator="Euler"),
        "mujoco, implicit": over("dt", (5e-3, 2e-3, 1e-3, 1e-4), integrator="implicit"),
        "mujoco, RK4": over("dt", (5e-3, 2e-3, 1e-3, 1e-4), integrator="RK4"),
        "mujoco, implicit, stiff": over("dt", (5e-3, 2e-3, 1e-3, 1e-4), integrator="implicit", stiff=True),
        "mujoco, RK4, stiff": over("dt", (5e-3, 2e-3, 1e-3, 1e-4), integrator="RK4", stiff=True),
    }


FINEST: dict[str, dict[str, Any]] = {  # not timed; of a kind, or of a peer
    "contactvi": {"order": 2, "dt": 2e-5},
    "drake, CENIC": {"accuracy": 1e-7},
    "drake, CENIC, stiff": {"accuracy": 1e-7, "stiffness": 1e8},
    "drake, SAP": {"dt": 2e-5, "approximation": "sap"},
    "drake, SAP, stiff": {"dt": 2e-5, "approximation": "sap", "stiffness": 1e9},
    "drake, lagged": {"dt": 2e-5, "approximation": "lagged"},
    "mujoco, Euler": {"dt": 2e-5, "integrator": "Euler"},
    "mujoco, implicit": {"dt": 2e-5, "integrator": "implicit"},
    "mujoco, RK4": {"dt": 2e-5, "integrator": "RK4"},
    "mujoco, implicit, stiff": {"dt": 2e-5, "integrator": "implicit", "stiff": True},
    "mujoco, RK4, stiff": {"dt": 2e-5, "integrator": "RK4", "stiff": True},
}


def peer_of(kind: str) -> str:
    return kind.split(",")[0]


def distance(found: Any, other: np.ndarray) -> float:
    """Largest distance of observed points over the samples [m]; infinite where a run is not finite."""
    rows = np.array(found, dtype=float)
    if rows.shape != other.shape or not np.isfinite(rows).all():
        return np.inf
    return float(np.linalg.norm((rows - other).reshape(len(rows), -1, 3), axis=2).max())


def finest(kind: str, job: dict[str, Any], folder: Path, timeout: float) -> np.ndarray | None:
    """The rows of the kind's finest run; None where it fails."""
    setting = FINEST[peer_of(kind) if peer_of(kind) == "contactvi" else kind]
    result = call(peer_of(kind), {**job, "settings": [setting]}, folder, 0, 0.0, timeout)[0]
    return None if result.get("failed") else np.array(result["q"], dtype=float)


def measure(name: str, peers: list[str], folder: Path, args: argparse.Namespace) -> list[Row]:
    """Return a row per setting of all peers on one scene."""
    job, exact = contact_cases.CASES[name]()
    samples = np.arange(1, round(job["duration"] / job["sample"]) + 1) * job["sample"]
    mine = finest("contactvi", job, folder, args.timeout) if "contactvi" in peers else None
    reference = mine if exact is None else exact(samples)
    rows: list[Row] = []
    for kind, settings in kinds(job["sample"]).items():
        peer = peer_of(kind)
        if peer not in peers:
            continue
        fine = mine if peer == "contactvi" else finest(kind, job, folder, args.timeout)
        results = call(peer, {**job, "settings": settings}, folder, args.repeats, args.slow, args.timeout)
        for result in results:
            row = {"case": name, "kind": kind, "setting": result["setting"], "failed": result.get("failed", "")}
            row.update(error=np.nan, own=np.nan, ms_per_s=np.nan, runs=len(result["times"]), known=exact is not None)
            rows.append(row)
            if row["failed"]:
                continue
            row["ms_per_s"] = 1e3 * float(np.median(result["times"])) / job["duration"]
            row["counts"] = result.get("counts", {})
            if reference is not None:
                row["error"] = distance(result["q"], reference)
            if fine is not None:
                row["own"] = distance(result["q"], fine)
        print(f"{name} {kind}", file=sys.stderr, flush=True)
    return rows


def every_run(rows: list[Row]) -> list[str]:
    """Return a table of all runs of each scene."""
    lines: list[str] = []
    for case in dict.fromkeys(row["case"] for row in rows):
        group = [row for row in rows if row["case"] == case]
        origin = "the exact answer" if group[0]["known"] else "contactvi's finest run"
        lines += ["", f"**{case}**, error from {origin}:", ""]
        lines += ["| simulator | setting | ms per s | error m | own error m |", "|---|---|---|---|---|"]
        for row in group:
            cells = [row["kind"], describe(shown(row["setting"]))]
            if row["failed"]:
                cells += [f"cannot: {' '.join(row['failed'].split())[:140]}", "", ""]
            else:
                cells += [time_of(row), f"{row['error']:.1e}", f"{row['own']:.1e}"]
            lines.append("| " + " | ".join(cells) + " |")
    return lines


def shown(setting: dict[str, Any]) -> dict[str, Any]:
    """What the name of the kind does not say."""
    return {key: setting[key] for key in ("dt", "accuracy", "tol") if key in setting and setting[key] != "auto"}


def time_of(row: Row) -> str:
    return f"{row['ms_per_s']:.3g}" + ("*" if row["runs"] < 2 else "")


def front(rows: list[Row]) -> list[str]:
    """Return the tables of the least time for an error: of each kind the fastest run of that error or a smaller one."""
    lines: list[str] = []
    for case in dict.fromkeys(row["case"] for row in rows):
        lines += ["", f"| {case} | " + " | ".join(f"{target:.0e}" for target in TARGETS) + " |"]
        lines.append("|---" * (1 + len(TARGETS)) + "|")
        for name in dict.fromkeys(row["kind"] for row in rows):
            group = [row for row in rows if (row["case"], row["kind"]) == (case, name)]
            cells = []
            for target in TARGETS:
                good = [row for row in group if row["error"] <= target]
                best = min(good, key=lambda row: row["ms_per_s"], default=None)
                cells.append(time_of(best) if best else "cannot" if all(row["failed"] for row in group) else "-")
            lines.append("| " + " | ".join([name, *cells]) + " |")
    return lines


def failures(rows: list[Row]) -> list[str]:
    """Return what a simulator says where it cannot do a scene, or a run did not end."""
    groups: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        if row["failed"]:
            reason = " ".join(row["failed"].split())[:300]
            groups.setdefault((row["case"], row["kind"], reason), []).append(describe(shown(row["setting"])))
    return [f"- {case}, {kind} ({'; '.join(which)}): {why}" for (case, kind, why), which in groups.items()]


def honesty(rows: list[Row]) -> list[str]:
    """Return the table of what dt = "auto" was asked for, has estimated and has reached."""
    lines = ["| scene | tol | estimate | error m |", "|---|---|---|---|"]
    for row in rows:
        if row["kind"] == "contactvi, auto" and not row["failed"]:
            cells = (row["setting"]["tol"], row["counts"]["estimate"], row["error"])
            lines.append(f"| {row['case']} | " + " | ".join(f"{cell:.1e}" for cell in cells) + " |")
    return lines


def picture(rows: list[Row], path: Path) -> None:
    """One panel for each scene: time over error, a line for each kind of run."""
    cases, names = (list(dict.fromkeys(row[key] for row in rows)) for key in ("case", "kind"))
    columns = min(4, len(cases))
    height = -(-len(cases) // columns)
    figure = Figure(figsize=(3.8 * columns, 3.4 * height), layout="constrained")
    panels = figure.subplots(height, columns, squeeze=False).ravel()
    colours = {"contactvi": ("#c8371b", "#e07b39", "#8c1c13", "#000000"),
               "drake": ("#4b2e83", "#8a6fc1", "#1f5fa8", "#6fa8dc", "#99aabb"),
               "mujoco": ("#0b6e4f", "#2f9e83", "#7fb069", "#9bc53d", "#bcb88a")}  # fmt: skip
    for panel in panels[len(cases) :]:
        panel.axis("off")  # some panels are left
    for panel, case in zip(panels, cases, strict=False):
        used = dict.fromkeys(colours, 0)
        for name in names:
            peer = peer_of(name)
            colour = colours[peer][used[peer] % len(colours[peer])]
            used[peer] += 1
            mine = [r for r in rows if (r["case"], r["kind"]) == (case, name) and r["error"] < LARGEST]
            x, y = [max(r["error"], SMALLEST) for r in mine], [r["ms_per_s"] for r in mine]
            panel.loglog(x, y, "s-" if "auto" in name else "o-", color=colour, ms=3.5, lw=1.2, label=name)
        panel.set_title(case, fontsize=10)
        panel.grid(alpha=0.25)
    for panel in panels[::columns]:
        panel.set_ylabel("ms per simulated s")
    for panel in panels[max(0, len(cases) - columns) : len(cases)]:
        panel.set_xlabel("error [m]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
    figure.savefig(path, dpi=80)


def text_of(rows: list[Row], peers: list[str], missing: list[str]) -> str:
    head = f"{time.strftime('%Y-%m-%d')}; " + ", ".join(f"{k} {v}" for k, v in versions(peers).items()) + "."
    lines = [head, *(f"{peer} is not installed (CONTACTVI_PEER_{peer.upper()}) and was left out." for peer in missing)]
    lines += ["", "Milliseconds of wall time per simulated second to reach an error (median; `*`: run once;",
              "`-`: with no setting tried; `cannot`: no run ended).", *front(rows)]  # fmt: skip
    failed = failures(rows)
    if failed:
        lines += ["", "What did not run, with what the simulator says:", "", *failed]
    if "contactvi" in peers:
        lines += ["", 'contactvi with dt="auto":', "", *honesty(rows)]
    return "\n".join([*lines, *every_run(rows), ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", default=",".join(contact_cases.CASES))
    parser.add_argument("--peers", default=",".join(PEERS))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--slow", type=float, default=1.0, help="a first run longer than this is the only one [s]")
    parser.add_argument("--timeout", type=float, default=120.0, help="of one kind of run on one scene [s]")
    parser.add_argument("--plot", type=Path, help="also draw time over error into this file")
    parser.add_argument("-o", "--output", type=Path, help="also write contact.json and contact.md into this folder")
    args = parser.parse_args()
    for given, known in ((args.cases, contact_cases.CASES), (args.peers, PEERS)):
        if not set(given.split(",")) <= set(known):
            parser.error(f"{given}: expected a list of {', '.join(known)}")
    asked = args.peers.split(",")
    peers = [peer for peer in asked if interpreter(peer)]
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as name:
        for case in args.cases.split(","):
            rows += measure(case, peers, Path(name), args)
            if args.output:  # a run that is interrupted leaves its rows
                args.output.mkdir(parents=True, exist_ok=True)
                (args.output / "contact.json").write_text(json.dumps(rows, indent=1))
    text = text_of(rows, peers, [peer for peer in asked if peer not in peers])
    if args.output:
        (args.output / "contact.md").write_text(text)
    if args.plot:
        picture(rows, args.plot)
    print(text)


if __name__ == "__main__":
    main()
