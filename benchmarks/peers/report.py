"""The table and the picture of compare.py."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

TARGETS = (1e-2, 1e-4, 1e-6, 1e-8)
COLORS = {
    "contactvi": "#c8371b", "scipy": "#1f5fa8", "mujoco": "#2f9e83", "drake": "#7a5ab5", "jiminy": "#e08a00",
    "pybullet": "#777777",
}  # fmt: skip
SMALLEST = 1e-13  # smaller errors are drawn here
Rows = list[dict[str, Any]]


def cell(rows: Rows, target: float) -> str:
    """Time of the fastest setting with at most this error; a setting counts only if the finer ones keep the error.

    One that meets the target while a slower one of the same method misses it by a factor of 3 did so by luck.
    """
    good = [row for row in rows if row["error"] <= target and not _lucky(row, rows, target)]
    if not good:
        return "never"
    best = min(good, key=lambda row: row["ms_per_s"])
    return f"{best['ms_per_s']:.3g}" + ("*" if best["runs"] < 2 else "")


def _method(row: dict[str, Any]) -> tuple:
    varied = ("dt", "rtol", "accuracy", "tol", "stiffness", "damping", "kdt2")
    return tuple(sorted((k, v) for k, v in row["setting"].items() if k not in varied))


def _lucky(row: dict[str, Any], rows: Rows, target: float) -> bool:
    """Whether a slower setting of the same method, within 4 times the time, has an error 3 times over the target.

    Not asked of a contact stiffness: softer contact is another model, and its error another error.
    """
    if "stiffness" in row["setting"] or "kdt2" in row["setting"]:
        return False
    same = [r for r in rows if _method(r) == _method(row) and not r["failed"]]
    return any(row["ms_per_s"] < r["ms_per_s"] <= 4 * row["ms_per_s"] and r["error"] > 3 * target for r in same)


def markdown(rows: Rows, own: dict[str, float], peers: list[str], missing: list[str], versions: dict[str, str]) -> str:
    lines = [
        f"{time.strftime('%Y-%m-%d')}; " + ", ".join(f"{k} {v}" for k, v in versions.items()) + "."
        + (f" Not installed: {', '.join(missing)}." if missing else ""),
        "",
        "Milliseconds of wall time per simulated second to reach an error (fastest run).",
        "`never`: with no setting tried; `*`: run once (slow); `-`: not run.",
        "",
        "| scene | error | " + " | ".join(peers) + " |",
        "|---|---|" + "---|" * len(peers),
    ]  # fmt: skip
    for scene in own:
        for target in TARGETS:
            cells = []
            for peer in peers:
                mine = [row for row in rows if row["scene"] == scene and row["peer"] == peer]
                cells.append(cell(mine, target) if mine else "-")
            lines.append(f"| {scene} | {target:.0e} | " + " | ".join(cells) + " |")
    lines += [
        "",
        "Smallest error of each peer, at its time [ms per simulated s], with the energy error at the end [J]:",
        "",
    ]
    lines += ["| scene (reference's own error) | " + " | ".join(peers) + " |", "|---|" + "---|" * len(peers)]
    for scene, error in own.items():
        cells = [best_cell([r for r in rows if r["scene"] == scene and r["peer"] == peer]) for peer in peers]
        lines.append(f"| {scene} ({error:.0e}) | " + " | ".join(cells) + " |")
    lines += maps_table(rows, own)
    groups: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        if row["failed"]:
            reason = row["failed"].strip().splitlines()[-1][:200]
            setting = ", ".join(f"{k} {v:g}" if isinstance(v, float) else f"{v}" for k, v in row["setting"].items())
            groups.setdefault((row["scene"], row["peer"], reason), []).append(setting)
    failed = [f"- {scene} {peer} ({'; '.join(which)}): {why}" for (scene, peer, why), which in groups.items()]
    if failed:
        lines += ["", "Settings that failed:", "", *failed]
    return "\n".join(lines) + "\n"


def maps_table(rows: Rows, own: dict[str, float]) -> list[str]:
    """contactvi's maps beside each other where there are impacts."""
    mine = [row for row in rows if row["peer"] == "contactvi"]
    maps = list(dict.fromkeys(row["setting"]["impact"] for row in mine))
    if len(maps) < 2:
        return []
    lines = [
        "",
        "contactvi by impact map [ms per simulated s], and the order over all dt whose error is above 1e-9:",
        "",
    ]
    lines += ["| scene | error | " + " | ".join(maps) + " |", "|---|---|" + "---|" * len(maps)]
    for scene in own:
        by_map = [[r for r in mine if r["scene"] == scene and r["setting"]["impact"] == name] for name in maps]
        if not all(by_map):
            continue
        for target in TARGETS:
            lines.append(f"| {scene} | {target:.0e} | " + " | ".join(cell(group, target) for group in by_map) + " |")
        lines.append(f"| {scene} | order | " + " | ".join(order(group) for group in by_map) + " |")
    return lines


def order(rows: Rows) -> str:
    """Least squares in the logarithms over the settings with an error in (1e-9, 0.1)."""
    points = [(row["setting"]["dt"], row["error"]) for row in rows if 1e-9 < row["error"] < 0.1]
    if len(points) < 3:
        return "exact" if rows and max(row["error"] for row in rows) < 1e-9 else "-"
    return f"{np.polyfit(*np.log(points).T, 1)[0]:.2f}"


def best_cell(rows: Rows) -> str:
    rows = [row for row in rows if np.isfinite(row["error"])]
    if not rows:
        return "-"
    best = min(rows, key=lambda row: row["error"])
    energy = f", {best['energy_error']:.0e} J" if np.isfinite(best["energy_error"]) else ""
    return f"{best['error']:.1e} at {best['ms_per_s']:.3g}{energy}"


def picture(rows: Rows, own: dict[str, float], path: Path) -> None:
    """One panel for each scene: time over error, the lower left front of each peer as a line."""
    columns = min(3, len(own))
    lines = -(-len(own) // columns)
    figure = Figure(figsize=(4.6 * columns, 3.5 * lines), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for panel in panels[len(own) :]:
        panel.axis("off")
    for panel, (scene, error) in zip(panels, own.items(), strict=False):
        for peer, color in COLORS.items():
            mine = [r for r in rows if r["scene"] == scene and r["peer"] == peer and np.isfinite(r["error"])]
            if not mine:
                continue
            x, y = [max(r["error"], SMALLEST) for r in mine], [r["ms_per_s"] for r in mine]
            front = [k for k in range(len(x)) if not any(x[j] < x[k] and y[j] <= y[k] for j in range(len(x)))]
            front.sort(key=lambda k: x[k])
            panel.loglog(x, y, ".", color=color, ms=4, alpha=0.4)
            wide = 2.0 if peer == "contactvi" else 1.1
            panel.loglog([x[k] for k in front], [y[k] for k in front], "o-", color=color, ms=3.5, lw=wide, label=peer)
        panel.axvline(error, color="#888888", lw=0.8, ls=":")
        panel.set_title(scene, fontsize=10)
        panel.grid(alpha=0.25)
        panel.set_xlim(left=max(panel.get_xlim()[0], 0.5 * SMALLEST))
    for panel in panels[::columns]:
        panel.set_ylabel("ms per simulated s")
    for panel in panels[max(0, len(own) - columns) : len(own)]:
        panel.set_xlabel("error |q - q_ref| [rad, m]")
    panels[0].legend(fontsize=7)
    figure.savefig(path, dpi=110)
