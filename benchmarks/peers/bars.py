"""contactvi beside the best peer: the fastest setting for an error, the factor, the bar it should reach."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from settings import ESTIMATE, HANDS

TARGETS = (1e-2, 1e-4, 1e-6, 1e-8)
OWN = ("contactvi", "contactvi auto")
Rows = list[dict[str, Any]]


def bar(scene: str, target: float) -> float:
    """Wanted factor to the best peer; NaN where nothing is promised."""
    if scene in ("S1", "S3", "S2_n10"):
        return 25.0 if target <= 1e-8 else 10.0
    if scene in ("S2_n40", "S2_n100"):
        return 7.0 if target <= 1e-8 else 2.5
    if scene in HANDS and target == 1e-6:
        return 10.0
    return 5.0 if scene[0] == "S" else float("nan")


def best(rows: Rows, target: float) -> dict[str, Any] | None:
    """The fastest setting with at most this error, of the rows of one scene and one peer; None where there is none.

    A setting of contactvi counts only if no step of it was cut in two, and if every finer one tried (a smaller dt at
    the same order, map and tol; with dt = "auto" a smaller tol) meets the error too. The peers have no such rule.
    """
    good = [row for row in rows if row["error"] <= target and not _by_luck(row, rows, target)]
    return min(good, key=lambda row: row["ms_per_s"], default=None)


def ladder(row: dict[str, Any]) -> tuple[str, float]:
    """Return the key of the ladder that a setting of contactvi belongs to, and its place on it."""
    setting = row["setting"]
    key = "tol" if setting.get("dt") == "auto" else "dt"
    return json.dumps({k: v for k, v in setting.items() if k != key}, sort_keys=True), setting[key]


def _by_luck(row: dict[str, Any], rows: Rows, target: float) -> bool:
    if row["peer"] not in OWN:
        return False
    if row["setting"].get("dt") != "auto" and row["counts"].get("halved"):
        return True
    family, size = ladder(row)
    return any(not r["error"] <= target for r in rows if ladder(r)[0] == family and ladder(r)[1] < size)


def time_of(row: dict[str, Any] | None) -> str:
    if row is None:
        return "never"
    return f"{row['ms_per_s']:.3g}" + ("*" if row["runs"] < 2 else "")


def describe(setting: dict[str, Any]) -> str:
    return ", ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in setting.items())


def _ratio(rival: dict[str, Any] | None, mine: dict[str, Any] | None) -> float:
    if mine is None:
        return float("nan")
    return rival["ms_per_s"] / mine["ms_per_s"] if rival else float("inf")


def _number(value: float) -> str:
    return "-" if np.isnan(value) else "alone" if np.isinf(value) else f"{value:.3g}"


def compared(rows: Rows, scene: str, target: float) -> dict[str, Any]:
    """One cell: contactvi, its automatic step, the best peer, the estimate; factors above 1: contactvi is faster."""
    by_peer: dict[str, Rows] = {}
    for row in rows:
        if row["scene"] == scene:
            by_peer.setdefault(row["peer"], []).append(row)
    found = {peer: best(group, target) for peer, group in by_peer.items()}
    rivals = [row for peer, row in found.items() if row and peer not in (*OWN, ESTIMATE)]
    rival = min(rivals, key=lambda row: row["ms_per_s"], default=None)
    mine, auto, estimate = (found.get(peer) for peer in (*OWN, ESTIMATE))
    factor, wanted = _ratio(rival, mine), bar(scene, target)
    verdict = "-" if np.isnan(wanted) else "met" if factor >= wanted else "MISSED"
    return {
        "mine": mine, "auto": auto, "rival": rival, "estimate": estimate, "factor": factor, "bar": wanted,
        "verdict": verdict, "auto_factor": _ratio(rival, auto),
        "estimate_factor": _ratio(estimate, mine) if estimate else float("nan"),
    }  # fmt: skip


def table(rows: Rows, scenes: list[str]) -> list[str]:
    """contactvi against the best peer at each error, with a verdict."""
    lines = [
        "",
        "contactvi against the best peer [ms per simulated s]; factors above 1 are contactvi's. A setting of contactvi",
        "counts only if every finer one tried meets the error too; the peers' best may be luck. dop853: the estimate.",
        "",
        "| scene | error | contactvi | its setting | auto | best peer | factor | bar | verdict | auto's factor "
        "| dop853 | factor |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for scene in scenes:
        for target in TARGETS:
            c = compared(rows, scene, target)
            rival = f"{time_of(c['rival'])} {c['rival']['peer']}" if c["rival"] else "never"
            cells = [
                scene, f"{target:.0e}", time_of(c["mine"]), describe(c["mine"]["setting"]) if c["mine"] else "-",
                time_of(c["auto"]), rival, _number(c["factor"]), _number(c["bar"]), c["verdict"],
                _number(c["auto_factor"]), time_of(c["estimate"]) if c["estimate"] else "-",
                _number(c["estimate_factor"]),
            ]  # fmt: skip
            lines.append("| " + " | ".join(cells) + " |")
    return lines


def spread(rows: Rows, scenes: list[str]) -> list[str]:
    """Median and least factor over the scenes at each error, of the fixed settings and of the automatic step.

    A scene on which contactvi or all peers never reach the error counts as the worst.
    """
    lines = ["", "| error | factor: median, least | auto's factor: median, least |", "|---|---|---|"]
    for target in TARGETS:
        cells = []
        for key in ("factor", "auto_factor"):
            found = {scene: np.nan_to_num(compared(rows, scene, target)[key], posinf=np.inf) for scene in scenes}
            least = min(found, key=lambda scene: found[scene])
            shown = [_number(value) if value else "never" for value in (np.median(list(found.values())), found[least])]
            cells.append(f"{shown[0]}, {shown[1]} {least}")
        lines.append(f"| {target:.0e} | {' | '.join(cells)} |")
    return lines


def orders(rows: Rows, own: dict[str, float]) -> list[str]:
    """Measured order of convergence of contactvi with the tightest tolerance of each order and map."""
    mine = [row for row in rows if row["peer"] == "contactvi"]
    kinds = sorted({(row["setting"]["order"], row["setting"]["impact"]) for row in mine}, key=lambda k: (k[1], k[0]))
    if not kinds:
        return []
    lines = ["", "Measured order of contactvi: log-log fit over the dt whose error is below .1 and above rounding.", ""]
    heads = " | ".join(f"{name} {order}" for order, name in kinds)
    lines += [f"| scene | {heads} |", "|---|" + "---|" * len(kinds)]
    for scene, error in own.items():
        cells = []
        for order, name in kinds:
            kind = {"order": order, "impact": name}
            same = [r for r in mine if r["scene"] == scene and kind.items() <= r["setting"].items()]
            tight = min((r["setting"]["solver_tol"] for r in same), default=0.0)
            cells.append(_slope([r for r in same if r["setting"]["solver_tol"] == tight], max(1e-10, 30 * error)))
        lines.append(f"| {scene} | " + " | ".join(cells) + " |")
    return lines


def _slope(rows: Rows, floor: float) -> str:
    points = [(row["setting"]["dt"], row["error"]) for row in rows if floor < row["error"] < 0.1]
    if len(points) < 2:
        return "exact" if rows and max(row["error"] for row in rows) < 1e-9 else "-"
    return f"{np.polyfit(*np.log(points).T, 1)[0]:.1f}"
