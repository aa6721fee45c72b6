"""The table and the picture of compare.py."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from bars import OWN, TARGETS, best, describe, orders, spread, table, time_of
from matplotlib.figure import Figure
from settings import ESTIMATE

COLORS = {
    "contactvi": "#c8371b", "contactvi auto": "#e58a75", ESTIMATE: "#000000", "scipy": "#1f5fa8",
    "mujoco": "#2f9e83", "drake": "#7a5ab5", "jiminy": "#e08a00", "pybullet": "#777777",
}  # fmt: skip
SMALLEST = 1e-13  # smaller errors are drawn here
Rows = list[dict[str, Any]]


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
                cells.append(time_of(best(mine, target)) if mine else "-")
            lines.append(f"| {scene} | {target:.0e} | " + " | ".join(cells) + " |")
    if any(row["peer"] in OWN for row in rows):
        lines += table(rows, list(own)) + spread(rows, list(own)) + orders(rows, own)
    lines += [
        "",
        "Smallest error of each peer, at its time [ms per simulated s], with the energy error at the end [J]:",
        "",
    ]
    lines += ["| scene (reference's own error) | " + " | ".join(peers) + " |", "|---|" + "---|" * len(peers)]
    for scene, error in own.items():
        cells = [best_cell([r for r in rows if r["scene"] == scene and r["peer"] == peer]) for peer in peers]
        lines.append(f"| {scene} ({error:.0e}) | " + " | ".join(cells) + " |")
    groups: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        if row["failed"]:
            reason = row["failed"].strip().splitlines()[-1][:200]
            groups.setdefault((row["scene"], row["peer"], reason), []).append(describe(row["setting"]))
    failed = [f"- {scene} {peer} ({_some(which)}): {why}" for (scene, peer, why), which in groups.items()]
    if failed:
        lines += ["", "Settings that failed:", "", *failed]
    return "\n".join(lines) + "\n"


def _some(names: list[str], most: int = 4) -> str:
    return "; ".join(names[:most]) + (f"; and {len(names) - most} more" if len(names) > most else "")


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
