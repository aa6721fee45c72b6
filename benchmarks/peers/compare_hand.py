"""S7, persistent contact: the Allegro hand closes around a ball, in contactvi, MuJoCo, Drake and PyBullet, in one run.

    python benchmarks/peers/compare_hand.py [-o DIR] [--peers contactvi,mujoco] [--passes 3] [--repeats 5]

Peers, interpreters and timing as in compare.py; the scene is hand.py's, the measures are hand_measures.py's: the same
formulas for all, from states every millisecond of a run that is not timed. There is no reference: contact with friction
is of another kind in each peer, so the tables show the end state of each one. Writes hand.json and hand.md into DIR and
prints the tables.

- time: fastest run of all passes [ms of wall time per simulated s], states taken every 0.1 s; ratio: to the fastest of
  MuJoCo at dt = 1e-3 s.
- held: two parts of the hand touch the ball at the end, and it drifts less than 1 mm in the last 0.2 s and moves at
  less than 1 cm/s. Upside down: whether it is held after 0.5 s more with gravity reversed, and how far it moved.
- overlap: deepest penetration, and that at the end. speed, drift, slip: of the ball at the end, its motion in the last
  0.2 s, and its longest path of slip on a part of the hand in that time.
- gained: all rises of kinetic, potential and spring energy between samples; only a simulator's error, or energy that
  came back from its soft contacts, can raise it.
- flight: largest |q - q_ref| before anything touches, against DOP853. joints, ball: largest angle and the distance at
  the end from contactvi's finest run (2e-5 s), ball (own): from the peer's own finest of its kind.
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
from hand_measures import Measures
from settings import HAND_FINE, settings

PEERS = ("contactvi", "mujoco", "drake", "pybullet")
SEEN = 1e-3  # [s] between the samples of a run that is not timed, at least one step
ERROR_CONTROLLED = 0.01  # [s] between samples where the simulator chooses its steps
UPSIDE_DOWN = 0.5  # s
Rows = list[dict[str, Any]]


def sampled(peer: str, job: dict[str, Any], rows: Rows, folder: Path, timeout: float) -> list[dict[str, Any]]:
    """A result of one run per setting, not timed, with many samples; and the sample time of each."""
    groups: dict[float, list[int]] = {}
    for k, setting in enumerate(rows):
        dt = setting.get("dt", ERROR_CONTROLLED)
        groups.setdefault(dt * max(1, round(SEEN / dt)), []).append(k)
    found: dict[int, dict[str, Any]] = {}
    for sample, numbers in groups.items():
        seen = {**job, "sample": sample, "settings": [rows[k] for k in numbers]}
        for k, result in zip(numbers, call(peer, seen, folder, 0, 0.0, timeout), strict=True):
            found[k] = {**result, "sample": sample}
    return [found[k] for k in range(len(rows))]


def measures(job: dict[str, Any], result: dict[str, Any]) -> Measures:
    q, v = np.array(result["q"], dtype=float), np.array(result["v"], dtype=float)
    if not (np.isfinite(q).all() and np.isfinite(v).all()):
        raise ValueError("not finite")
    start = result["setting"].get("start", job["start"])
    return Measures({**job, "start": start, "sample": result["sample"]}, hand.model(), q, v)


def judge(peer: str, job: dict[str, Any], folder: Path, timeout: float) -> Rows:
    """Return a row per setting: its end state, and that of the run with gravity reversed."""
    rows: Rows = []
    for result in sampled(peer, job, settings(peer, "S7"), folder, timeout):
        row = {"peer": peer, "setting": result["setting"], "failed": result.get("failed", ""), "runs": 0}
        rows.append(row)
        if row["failed"]:
            continue
        try:
            seen = measures(job, result)
        except ValueError as error:
            row["failed"] = str(error)
            continue
        names = ("held", "touching", "overlap", "overlap_end", "speed", "drift", "slip", "gained", "flight_error")
        row.update({name: getattr(seen, name) for name in names}, counts=result["counts"])
        row["first_seconds"] = result["times"][0]
        row.update(q=seen.q[-1].tolist(), energy=float(seen.energy[-1]), v=seen.v[-1].tolist())
    upside_down(peer, job, [row for row in rows if not row["failed"]], folder, timeout)
    return rows


def upside_down(peer: str, job: dict[str, Any], rows: Rows, folder: Path, timeout: float) -> None:
    """Continue from the end of each row with gravity reversed."""
    turned = {**job, "gravity": -job["gravity"], "duration": UPSIDE_DOWN}
    starts = [{**row["setting"], "start": {"q": row["q"], "v": row["v"]}} for row in rows]
    for row, result in zip(rows, sampled(peer, turned, starts, folder, timeout), strict=True):
        if result.get("failed"):
            row.update(still_held=False, moved=float("nan"), turned_failed=result["failed"])
            continue
        seen = measures(turned, result)
        row.update(still_held=seen.held, moved=seen.moved)


def compare_ends(rows: Rows, fine: list[float]) -> None:
    """How far each row's end is from contactvi's finest and from the finest of its own kind."""
    for row in rows:
        if row["failed"]:
            continue
        kin = [r for r in rows if not r["failed"] and r["peer"] == row["peer"] and "dt" in r["setting"]]
        kin = [r for r in kin if r["setting"].get("stiff") == row["setting"].get("stiff")]
        own = min(kin, key=lambda r: r["setting"]["dt"])["q"] if kin else row["q"]
        own = fine if row["peer"] == "contactvi" else own
        apart, kept = np.array(row["q"]) - fine, np.array(row["q"]) - own
        row["joints"], row["ball"] = float(np.abs(apart[:16]).max()), float(np.linalg.norm(apart[16:]))
        row["ball_own"] = float(np.linalg.norm(kept[16:]))


def clock(peer: str, job: dict[str, Any], rows: Rows, folder: Path, args: argparse.Namespace) -> None:
    """One pass through the settings of a peer; of each the fastest time counts."""
    mine = [row for row in rows if row["peer"] == peer and not row["failed"]]
    timed = {**job, "settings": [row["setting"] for row in mine]}
    for row, result in zip(mine, call(peer, timed, folder, args.repeats, args.slow, args.timeout), strict=True):
        if result.get("failed"):
            row["failed"] = result["failed"]
            continue
        best = min([*result["times"], row.get("seconds", np.inf)])
        if result["counts"].get("seconds", np.inf) < row["counts"].get("seconds", 0.0):
            row["counts"] = result["counts"]
        row.update(seconds=best, runs=row["runs"] + len(result["times"]), ms_per_s=1e3 * best / job["duration"])


def ratio(rows: Rows, row: dict[str, Any]) -> float:
    rivals = [r["ms_per_s"] for r in rows if r["peer"] == "mujoco" and r["setting"]["dt"] == 1e-3 and not r["failed"]]
    return row["ms_per_s"] / min(rivals, default=float("nan"))


def outcomes(rows: Rows) -> list[str]:
    """Return the table of times, and whether the ball is held."""
    lines = [
        "| peer | setting | ms per s | ratio | held | touching | upside down: held, moved mm "
        "| overlap um: deepest, last | speed um/s | drift um | slip um |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [row["peer"], describe(row["setting"])]
        if row["failed"]:
            lines.append("| " + " | ".join([*cells, row["failed"].replace("\n", " ")[:120]]) + " |" * 9)
            continue
        cells += [
            f"{row['ms_per_s']:.3g}", f"{ratio(rows, row):.2f}", _yes(row["held"]), " ".join(row["touching"]),
            f"{_yes(row['still_held'])}, {1e3 * row['moved']:.3g}",
            f"{_micro(row['overlap'])}, {_micro(row['overlap_end'])}",
            *(_micro(row[name]) for name in ("speed", "drift", "slip")),
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def errors(rows: Rows) -> list[str]:
    """Return the table of end states and their errors."""
    lines = [
        "| peer | setting | ball x y z mm | ball mm | ball (own) mm | joints rad | flight rad, m | gained mJ "
        "| energy J |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        if row["failed"]:
            continue
        cells = [
            row["peer"], describe(row["setting"]), " ".join(f"{1e3 * x:.2f}" for x in row["q"][16:]),
            f"{1e3 * row['ball']:.2g}", f"{1e3 * row['ball_own']:.2g}", f"{row['joints']:.1e}",
            f"{row['flight_error']:.1e}", f"{1e3 * row['gained']:.2g}", f"{row['energy']:.5f}",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _yes(value: bool) -> str:
    return "yes" if value else "NO"


def _micro(value: float) -> str:
    """A length [m] or speed [m/s] in millionths; below 1e-12 it is rounding."""
    number = 0.0 if value < 1e-12 else 1e6 * value
    return f"{number:.0f}" if number >= 10.0 else f"{number:.2g}"


def work(rows: Rows) -> list[str]:
    """Where contactvi's time goes: guards (pairs), contact problems, steps in contact."""
    lines = [
        "| setting | guards evaluated, skipped | impacts | contact steps "
        "| contact iterations, contact problems per contact step "
        "| cone iterations per problem | fallbacks | us per contact step | in them | inside the engine |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        if row["peer"] != "contactvi" or row["failed"]:
            continue
        c = row["counts"]
        steps, problems = max(1, c["held_steps"]), max(1, c["cone_problems"])
        cells = [
            describe(row["setting"]), f"{c['guards_evaluated']}, {c['guards_skipped']}", str(c["impacts"]),
            str(c["held_steps"]), f"{c['contact_rounds'] / steps:.2f}, {c['cone_problems'] / steps:.2f}",
            f"{c['cone_iterations'] / problems:.2f}", str(c["cone_fallbacks"]),
            f"{1e6 * c['contact_seconds'] / steps:.1f}", f"{c['contact_seconds'] / c['seconds']:.0%}",
            f"{1e3 * c['seconds']:.1f} ms",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def remarks(rows: Rows, missing: list[str]) -> list[str]:
    """What was not measured, and which controller ran."""
    lines = [f"{peer} is not installed (CONTACTVI_PEER_{peer.upper()}) and was left out." for peer in missing]
    mine = [row for row in rows if row["peer"] == "contactvi" and not row["failed"]]
    if mine:
        kind = "servos" if mine[0]["counts"]["servo"] else "springs and dampers of the joints, no effort limit"
        exact = max(row["counts"]["gap_error"] for row in mine)
        lines.append(f"contactvi's controller: {kind}. Its deepest overlap, of every step: {exact:.1e} m.")
    for row in rows:
        if row["peer"] == "pybullet" and not row["failed"]:
            inside = row["counts"]["inside"] / row["first_seconds"]
            lines.append(f"PyBullet, {describe(row['setting'])}: {inside:.0%} of the time is its own step.")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", default=",".join(PEERS))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--passes", type=int, default=3, help="through everything; the fastest time counts")
    parser.add_argument("--slow", type=float, default=1.5, help="a first run longer than this is the only one [s]")
    parser.add_argument("--timeout", type=float, default=120.0, help="of one peer in one pass [s]")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/hand"))
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    asked = args.peers.split(",")
    if not set(asked) <= set(PEERS):
        parser.error(f"--peers takes a list of {', '.join(PEERS)}")
    peers = [peer for peer in asked if interpreter(peer)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        job = hand.job(folder)
        rows = [row for peer in peers for row in judge(peer, job, folder, args.timeout)]
        fine = sampled("contactvi", job, [HAND_FINE], folder, args.timeout)[0]
        compare_ends(rows, fine["q"][-1])
        for _ in range(args.passes):
            for peer in peers:
                clock(peer, job, rows, folder, args)
    head = f"{time.strftime('%Y-%m-%d')}; " + ", ".join(f"{k} {v}" for k, v in versions(peers).items()) + "."
    body = [*outcomes(rows), "", *errors(rows), "", *remarks(rows, [peer for peer in asked if peer not in peers])]
    text = "\n".join([head, "", *body, "", "contactvi, the fastest warm-up:", "", *work(rows), ""])
    (args.output / "hand.json").write_text(json.dumps(rows, indent=1) + os.linesep)
    (args.output / "hand.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
