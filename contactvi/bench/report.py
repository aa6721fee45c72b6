"""What `contactvi bench` writes: a table, a CSV file, a log-log picture, one line of advice."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from contactvi.bench.bench import Bench, Row
from contactvi.files import write_atomic
from contactvi.tables import text_table

COLUMNS = ("order", "impact", "dt_s", "error", "slope", "energy_error_J", "seconds", "impacts", "note")
_PRINTED = ("order", "map", "dt [s]", "error", "slope", "energy [J]", "time", "impacts", "note")
_COLORS = dict(zip(range(2, 17, 2), ("#1f5fa8", "#e08a00", "#7a5ab5", "#2f9e83", "#7d6608", "#8c8c8c", "#d05a9c",
                                     "#c8371b"), strict=True))  # fmt: skip
_MARKS = {"ctec": "o", "dtec": "s", "mhc": "^"}
_MAX_TARGETS = 3


def advice(result: Bench) -> str:
    """Return one line: which order, map and dt for which error."""
    good = [row for row in result.good() if row.error > 0]
    if not good:
        return "No advice: no run of the ladder follows the reference; use a smaller dt or a shorter duration."
    chosen: dict[str, str] = {}  # setting -> the smallest error it is advised for
    for target in targets([row.error for row in good]):
        row = result.best(target)
        assert row is not None
        chosen[_setting(row)] = f"error {10.0 ** np.ceil(np.log10(max(row.error, 1e-16))):.0e}"
    smallest = min(good, key=lambda row: row.error)
    if result.best(smallest.error) is smallest:
        chosen.setdefault(_setting(smallest), f"smallest measured, {smallest.error:.1e}")
    return "; ".join(f"{error}: {setting}" for setting, error in chosen.items()) + "."


def targets(errors: list[float]) -> list[float]:
    """Return powers of ten that the errors can meet, large to small, at most three."""
    low, high = np.ceil(np.log10(min(errors))), np.ceil(np.log10(max(errors)))
    count = int(min(_MAX_TARGETS, high - low + 1))
    return [float(10.0 ** round(e)) for e in dict.fromkeys(np.rint(np.linspace(high, low, count)))]


def _setting(row: Row) -> str:
    return f"order {row.order}, {row.impact}, dt = {row.dt:.6g} s ({_time(row.seconds)})"


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms" if seconds < 1.0 else f"{seconds:.3g} s"


def heading(result: Bench) -> str:
    """Return the line above the table: over which time, against what."""
    span = f"{result.horizon:.6g} s" + ("" if result.horizon >= result.duration else f" of {result.duration:.6g} s")
    return (
        f"Run time and error over {span}, {result.impacts} impacts; reference of order 16, dt = "
        f"{result.reference_dt:.3g} s, its own error at most about {result.reference_error:.1e}"
    )


def table(result: Bench) -> Table:
    """Return the table: a row per run, an empty one between two ladders."""
    rows: list[list[str]] = []
    last: tuple[int, str] | None = None
    for row in result.rows:
        if last is not None and (row.order, row.impact) != last:
            rows.append([""] * len(_PRINTED))
        last = row.order, row.impact
        slope = f"{row.slope:.2f}" if np.isfinite(row.slope) else ""
        numbers = [f"{row.dt:.6g}", f"{row.error:.2e}", slope, f"{row.energy_error:.2e}", _time(row.seconds)]
        rows.append([str(row.order), row.impact, *numbers, str(row.impacts), row.note])
    return text_table(_PRINTED, rows, right=_PRINTED[2:-1])


def notes(result: Bench) -> list[str]:
    """Return the lines below the table: orders seen, what an error is, warnings."""
    slopes = [f"{name} {slope:.2f}".replace("nan", "none seen") for name, slope in _slopes(result)]
    return [
        "order seen over the ladder: " + ", ".join(slopes),
        "error: largest |q - q_ref| at common nodes, m and rad together; energy: without what impacts took",
        *(f"note: {text}" for text in result.warnings),
    ]


def _slopes(result: Bench) -> list[tuple[str, float]]:
    ladders = dict.fromkeys((row.order, row.impact) for row in result.rows)
    return [(f"{order} {impact}", result.slope(impact, order)) for order, impact in ladders]


def save_csv(result: Bench, path: str | os.PathLike[str]) -> Path:
    """Write the rows as CSV, SI units; return the path."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in result.rows:
        writer.writerow(
            [row.order, row.impact, *map(repr, (row.dt, row.error, row.slope, row.energy_error, row.seconds))]
            + [row.impacts, row.note]
        )
    return write_atomic(path, lambda file: file.write(text.getvalue().encode()))


def save_plot(result: Bench, path: str | os.PathLike[str], title: str = "") -> Path:
    """Write the work-precision picture: time over error left, error over dt right; return the path."""
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    work, ladder = figure.subplots(1, 2)
    for order, impact in dict.fromkeys((row.order, row.impact) for row in result.rows):
        color, mark = _COLORS.get(order, "black"), _MARKS.get(impact, "x")
        own = [row for row in result.rows if (row.order, row.impact) == (order, impact) and row.error > 0]
        good, poor = [row for row in own if not row.note], [row for row in own if row.note]
        slope = result.slope(impact, order)
        label = f"{order} {impact}" + (f", seen {slope:.1f}" if np.isfinite(slope) else ", none seen")
        for axis, x, y in ((work, "error", "seconds"), (ladder, "dt", "error")):
            axis.loglog([getattr(r, x) for r in good], [getattr(r, y) for r in good], mark + "-", color=color,
                        ms=5, lw=1.3, alpha=0.85, label=label)  # fmt: skip
            axis.loglog([getattr(r, x) for r in poor], [getattr(r, y) for r in poor], mark, mfc="none", color=color)
    if result.reference_error > 0 and result.good():
        work.axvline(result.reference_error, color="#888888", lw=0.9, ls=":")
        ladder.axhline(result.reference_error, color="#888888", lw=0.9, ls=":", label="reference's own error")
    work.set_xlabel("error |q - q_ref| [m, rad]")
    work.set_ylabel(f"run time [s] for {result.horizon:.4g} s")
    ladder.set_xlabel("dt [s]")
    ladder.set_ylabel("error |q - q_ref| [m, rad]")
    for axis in (work, ladder):
        axis.grid(alpha=0.25, which="both")
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7)
    empty = ", open marks: see the table's notes" if len(result.good()) < len(result.rows) else ""
    figure.suptitle(f"{title}: {result.horizon:.4g} s, {result.impacts} impacts{empty}".lstrip(": "), fontsize=11)
    return write_atomic(path, lambda file: figure.savefig(file, format="png", dpi=130))
