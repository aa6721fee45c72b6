"""S7, contact that lasts: the Allegro hand closes around a ball, in contactvi and MuJoCo, in one run.

    python benchmarks/peers/compare_hand.py [-o DIR] [--passes 3] [--repeats 5]

Peers, interpreters and timing as in compare.py; the scene is hand.py's. There is no reference: contact with friction is
of another kind in each peer, so the table says what each one arrives at. Writes hand.json and hand.md into DIR and
prints the tables.

- time: fastest run of all passes [ms of wall time per simulated s]; ratio: to the fastest of MuJoCo at dt = 1e-3 s.
- overlap: deepest one, of every step in contactvi, of the samples every 0.1 s in MuJoCo.
- ball: its place at the end and its speed (rest: 0). contacts: points at the end.
- energy: kinetic, potential and spring energy at the end, all by the same formula.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import hand
import numpy as np
from bars import describe
from compare import call, interpreter, versions
from settings import settings

PEERS = ("contactvi", "mujoco")
Rows = list[dict[str, Any]]


def measure(peer: str, job: dict[str, Any], folder: Path, args: argparse.Namespace) -> Rows:
    """Rows of one pass through the settings of a peer."""
    rows = []
    for result in call(peer, {**job, "settings": settings(peer, "S7")}, folder, args.repeats, args.slow, args.timeout):
        row = {"peer": peer, "setting": result["setting"], "failed": result.get("failed", "")}
        rows.append(row)
        if row["failed"]:
            continue
        q, v = np.array(result["q"]), np.array(result["v"])
        row.update(
            ms_per_s=1e3 * min(result["times"]) / job["duration"], runs=len(result["times"]), ball=q[-1, 16:].tolist(),
            speed=float(np.linalg.norm(v[-1, 16:19])), energy=hand.energy(job, q[-1], v[-1]), counts=result["counts"],
        )  # fmt: skip
    return rows


def merge(rows: dict[str, dict[str, Any]], more: Rows) -> None:
    """Add the rows of a pass; of a setting measured before the faster time counts."""
    for row in more:
        known = rows.setdefault(json.dumps([row["peer"], row["setting"]]), row)
        if known is not row and not row["failed"] and not known["failed"]:
            known["ms_per_s"] = min(known["ms_per_s"], row["ms_per_s"])
            known["runs"] += row["runs"]


def outcomes(rows: Rows) -> list[str]:
    """What each setting takes and what it arrives at."""
    rivals = [r["ms_per_s"] for r in rows if r["peer"] == "mujoco" and r["setting"]["dt"] == 1e-3 and not r["failed"]]
    rival = min(rivals, default=float("nan"))
    lines = [
        "| peer | setting | ms per s | ratio | overlap m | ball x y z m | its speed m/s | contacts | energy J |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [row["peer"], describe(row["setting"])]
        if row["failed"]:
            lines.append("| " + " | ".join([*cells, row["failed"]]) + " | | | | | | |")
            continue
        counts = row["counts"]
        cells += [
            f"{row['ms_per_s']:.3g}", f"{row['ms_per_s'] / rival:.2f}", f"{max(0.0, counts['overlap']):.1e}",
            " ".join(f"{x:.5f}" for x in row["ball"]), f"{row['speed']:.1e}", str(counts["contacts"]),
            f"{row['energy']:.5f}",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def work(rows: Rows) -> list[str]:
    """Where contactvi's time goes: guards (pairs), contact problems, held steps."""
    lines = [
        "| setting | guards evaluated, skipped | impacts | held steps | rounds, contact problems per held step "
        "| cone iterations per problem | fallbacks | us per held step | in them | inside the engine |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        if row["peer"] != "contactvi" or row["failed"]:
            continue
        c = row["counts"]
        held, problems = max(1, c["held_steps"]), max(1, c["cone_problems"])
        cells = [
            describe(row["setting"]), f"{c['guards_evaluated']}, {c['guards_skipped']}", str(c["impacts"]),
            str(c["held_steps"]), f"{c['contact_rounds'] / held:.2f}, {c['cone_problems'] / held:.2f}",
            f"{c['cone_iterations'] / problems:.2f}", str(c["cone_fallbacks"]),
            f"{1e6 * c['contact_seconds'] / held:.1f}", f"{c['contact_seconds'] / c['seconds']:.0%}",
            f"{1e3 * c['seconds']:.1f} ms",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--passes", type=int, default=3, help="through everything; the fastest time counts")
    parser.add_argument("--slow", type=float, default=1.5, help="a first run longer than this is the only one [s]")
    parser.add_argument("--timeout", type=float, default=60.0, help="of one peer in one pass [s]")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/hand"))
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    peers = [peer for peer in PEERS if interpreter(peer)]
    found: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        job = hand.job(folder)
        for _ in range(args.passes):
            for peer in peers:
                merge(found, measure(peer, job, folder, args))
    rows = list(found.values())
    head = f"{time.strftime('%Y-%m-%d')}; " + ", ".join(f"{k} {v}" for k, v in versions(peers).items())
    missing = [peer for peer in PEERS if peer not in peers]
    head += f". Not installed: {', '.join(missing)}." if missing else "."
    text = "\n".join([head, "", *outcomes(rows), "", "contactvi, of the first run:", "", *work(rows), ""])
    (args.output / "hand.json").write_text(json.dumps(rows, indent=1) + os.linesep)
    (args.output / "hand.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
