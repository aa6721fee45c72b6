"""Pictures of the reproduction, each a PNG with the numbers it shows in a CSV of the same name."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from contactvi.files import write_atomic
from contactvi.reproduce.ensemble import Ensemble
from contactvi.reproduce.runs import BALL_STEP, HEIGHTS, L2_STEP, LONG_STEP, Convergence, Dense, LongRun
from contactvi.reproduce.systems import GRAVITY, MAPS, run_b

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
_COLOR = {"ctec": "#1f5fa8", "dtec": "#e08a00", "mhc": "#2f9e83"}
_MARK = {"ctec": "o", "dtec": "s", "mhc": "^"}
_WIDTH = 8.5  # [inch], with 130 dpi a little more than the text of a report
_SHORT = 20.0  # [s] of Fig. 1
_MEAN_OVER = 10.0  # [s], window of the running mean


@dataclass(frozen=True)
class Picture:
    """A figure in the folder: names of its PNG and CSV, and its caption."""

    png: str
    csv: str
    caption: str


def energy_figure(folder: Path) -> Picture:
    """Fig. 1 of the paper: energy of the three methods, double pendulum at a wall."""
    runs = {name: run_b(name, LONG_STEP, _SHORT) for name in MAPS}
    t = runs["ctec"].t
    change = {name: traj.energy - traj.energy[0] for name, traj in runs.items()}
    figure = Figure(figsize=(_WIDTH, 5.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    impacts = runs["ctec"].events.array("time")
    for axis, names in ((upper, MAPS), (lower, ("ctec", "mhc"))):
        axis.vlines(impacts, 0.0, 1.0, transform=axis.get_xaxis_transform(), color="0.85", lw=1.0, label="impact")
        axis.axhline(0.0, color="0.4", lw=0.7)
        for name in names:
            axis.plot(t, 1e3 * change[name], color=_COLOR[name], lw=1.3, label=name.upper())
        _finish(axis, "H - H(0) [mJ]", loc="lower left", columns=4)
    lower.set_title("CTEC and MHC alone", fontsize=9, loc="left")
    lower.set_ylim(bottom=-1.9)  # room for the legend
    lower.set_xlabel("time [s]")
    lower.set_xlim(0.0, _SHORT)
    figure.suptitle(f"Energy of the double pendulum at a wall, h = {LONG_STEP:g} s, elastic impacts", fontsize=11)
    columns = {"t_s": t} | {f"energy_change_{name}_J": change[name] for name in MAPS}
    start = float(runs["ctec"].energy[0])
    return _write(
        folder,
        "fig1_energy",
        figure,
        columns,
        f"Fig. 1: energy of the three methods, problem B; H(0) = {start:.4g} J. CTEC keeps H at an impact; MHC keeps "
        "the modified energy, about which H oscillates in between; DTEC keeps neither, and H jumps at every impact.",
    )


def long_run_figure(data: LongRun, folder: Path) -> Picture:
    """Energy over 1000 s: running means and decile means."""
    figure = Figure(figsize=(_WIDTH, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    window = round(_MEAN_OVER / LONG_STEP)
    count = (len(data.t) - 1) // window
    middle = data.t[1 : count * window + 1].reshape(count, window).mean(axis=1)
    columns = {"t_s": middle}
    for name in MAPS:
        mean = data.energy[name][1 : count * window + 1].reshape(count, window).mean(axis=1)
        columns[f"mean_energy_change_{name}_J"] = mean
        for axis in (upper, lower):
            if axis is upper or name != "dtec":
                axis.plot(middle, 1e3 * mean, color=_COLOR[name], lw=1.1, label=name.upper())
    for axis in (upper, lower):
        axis.axhline(0.0, color="0.4", lw=0.7)
        _finish(axis, "mean of H - H(0) [mJ]", loc="lower left" if axis is upper else "center right")
    lower.set_title("CTEC and MHC alone", fontsize=9, loc="left")
    lower.set_xlabel("time [s]")
    lower.set_xlim(0.0, data.t[-1])
    figure.suptitle(
        f"Problem B for {data.t[-1]:.0f} s, h = {LONG_STEP:g} s, {data.impacts['ctec']} impacts, "
        f"means over {_MEAN_OVER:g} s",
        fontsize=11,
    )
    return _write(
        folder,
        "long_run_energy",
        figure,
        columns,
        f"Long-run energy, means over {_MEAN_OVER:g} s: MHC's is constant, CTEC's is bounded, DTEC's drifts at random.",
    )


def convergence_figure(table: Convergence, fine: Convergence, folder: Path) -> Picture:
    """|q(3) - ref| and |q(3) - ref| / h^2 over the step; `table` at the steps of the table, `fine` at many."""
    figure = Figure(figsize=(_WIDTH, 4.3), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name in MAPS:
        marks: dict[str, Any] = {"color": _COLOR[name], "marker": _MARK[name], "mfc": "none", "mew": 1.4, "ls": "none"}
        for axis, power in ((left, 0), (right, 2)):
            axis.plot(fine.h, fine.error[name] / fine.h**power, ".", color=_COLOR[name], ms=2.5)
            axis.plot(table.h, table.error[name] / table.h**power, label=name.upper(), **marks)
    scale = 0.35 * table.error["mhc"][-1] / table.h[-1] ** 2
    left.plot(table.h, scale * table.h**2, color="0.3", lw=1.0, ls="--", label="order 2")
    left.set_yscale("log")
    for axis in (left, right):
        axis.set_xscale("log")
        axis.set_xlabel("step h [s]")
        axis.set_xticks(table.h, [f"{h:g}" for h in table.h])
        axis.minorticks_off()
    _finish(left, "|q(3) - ref| [rad]", loc="upper left")
    _finish(right, "|q(3) - ref| / h$^2$ [rad/s$^2$]", loc="")
    right.set_ylim(bottom=0.0)
    columns = {"h_s": np.concatenate([table.h, fine.h])}
    columns |= {f"error_q3_{name}_rad": np.concatenate([table.error[name], fine.error[name]]) for name in MAPS}
    return _write(
        folder,
        "convergence",
        figure,
        columns,
        "Convergence on problem B against the DOP853 reference: marks at the steps of the table, dots at many steps. "
        "CTEC and MHC are smooth in h; DTEC's error depends on where in its step an impact falls.",
    )


def ensemble_figure(data: Ensemble, folder: Path) -> Picture:
    """Long runs from many starts and with several steps: how much the mean energy changes, and how far off it is."""
    figure = Figure(figsize=(_WIDTH, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    lines = dict(zip(data.deciles, ("--", "-", ":"), strict=True))
    for h, line in lines.items():
        spread, mean = data.spread(h), np.abs(data.mean(h))
        share = (np.arange(len(spread)) + 1.0) / len(spread)
        for k, name in enumerate(MAPS):
            label = name.upper() if line == "-" else None
            for axis, values in ((left, spread), (right, mean)):
                axis.step(np.sort(values[:, k]), share, where="post", color=_COLOR[name], ls=line, lw=1.2, label=label)
    for axis in (left, right):
        axis.set_xscale("log")
    left.set_xlabel("range of the means over the tenths of 1000 s [J]")
    right.set_xlabel("|mean of H - H(0)| [J]")
    _finish(left, "share of starts below", loc="lower right")
    _finish(right, "", loc="")
    steps = ", ".join(f"{h:g} s {name}" for h, name in zip(lines, ("dashed", "solid", "dotted"), strict=True))
    number = {h: len(values) for h, values in data.deciles.items()}
    start = np.concatenate([data.start[:count] for count in number.values()])
    columns = {"h_s": np.repeat(list(number), list(number.values()))}
    columns |= {"start_angle_1_rad": start[:, 0], "start_angle_2_rad": start[:, 1]}
    for k, name in enumerate(MAPS):
        columns[f"spread_{name}_J"] = np.concatenate([data.spread(h)[:, k] for h in number])
        columns[f"mean_{name}_J"] = np.concatenate([data.mean(h)[:, k] for h in number])
    figure.suptitle(f"Long runs from {len(data.start)} starts near problem B, h = {steps}", fontsize=11)
    return _write(
        folder,
        "ensemble",
        figure,
        columns,
        "The long run over an ensemble: MHC's energy is the flattest from nearly every start (left); whose mean is "
        "nearest to H(0) depends on the start (right).",
    )


def dense_figure(data: Dense, folder: Path) -> Picture:
    """Largest relative energy error so far of the bouncing ball, one panel per drop height."""
    figure = Figure(figsize=(_WIDTH, 4.8), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    floor = 1e-16  # where an error of zero is drawn
    keep = np.unique(np.linspace(1, len(data.t) - 1, 1000).round().astype(int))
    columns = {"t_s": data.t[keep]}
    for k, (axis, height) in enumerate(zip(axes.flat, HEIGHTS, strict=True)):
        for name in MAPS:
            largest = np.maximum.accumulate(np.abs(data.errors[name][k]))[keep]
            columns[f"error_{name}_{height:g}m"] = largest
            style = (0, (4, 3)) if name == "mhc" else "-"
            width = 2.2 if name == "ctec" else 1.4  # CTEC and MHC coincide on the ball: one is seen under the other
            axis.semilogy(
                data.t[keep], np.maximum(largest, floor), color=_COLOR[name], lw=width, ls=style, label=name.upper()
            )
        flight = 2.0 * np.sqrt(2.0 * height / GRAVITY)
        axis.set_title(f"drop {height:g} m, a bounce every {flight / BALL_STEP:.1f} steps", fontsize=9, loc="left")
        _finish(axis, "" if k % 2 else "energy error / (m g drop)", loc="center right" if k == 0 else "")
        axis.set_ylim(floor, 1.0)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    figure.suptitle(f"Elastic ball, h = {BALL_STEP:g} s: largest energy error so far", fontsize=11)
    return _write(
        folder,
        "dense_impacts",
        figure,
        columns,
        "Dense impacts: the lower the drop, the more impacts per step. CTEC and MHC coincide on the ball.",
    )


def l2_figure(start: Array, errors: Array, folder: Path) -> Picture:
    """Distribution of the L2 errors over random starts, and their ratio to CTEC's."""
    figure = Figure(figsize=(_WIDTH, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    share = (np.arange(len(errors)) + 1.0) / len(errors)
    for k, name in enumerate(MAPS):
        left.step(1e3 * np.sort(errors[:, k]), share, where="post", color=_COLOR[name], lw=1.3, label=name.upper())
        if k:
            ratio = np.sort(errors[:, k] / errors[:, 0])
            right.step(ratio, share, where="post", color=_COLOR[name], lw=1.3, label=f"{name.upper()} / CTEC")
    left.set_xlim(*_middle(1e3 * errors))
    left.set_xlabel("L2 error over 3 s [mrad]")
    right.axvline(1.0, color="0.4", lw=0.8)
    right.set_xlim(*_middle(errors[:, 1:] / errors[:, :1]))
    right.set_xlabel("ratio of L2 errors")
    _finish(left, "share of starts below", loc="lower right")
    _finish(right, "", loc="lower right")
    figure.suptitle(f"{len(errors)} random starts near problem B, h = {L2_STEP:g} s", fontsize=11)
    columns = {"start_angle_1_rad": start[:, 0], "start_angle_2_rad": start[:, 1]}
    columns |= {f"l2_error_{name}_rad": errors[:, k] for k, name in enumerate(MAPS)}
    return _write(
        folder,
        "l2_errors",
        figure,
        columns,
        "L2 error over random starts, all but the outermost hundredth: which map is best changes from start to start, "
        "and DTEC's errors spread most.",
    )


def save_csv(columns: Mapping[str, Array], path: Path) -> Path:
    """Write columns of equal length as a CSV file with their names first; return its path."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow([f"{value:.10g}" for value in row])
    return write_atomic(path, lambda file: file.write(text.getvalue().encode("utf-8")))


def _write(folder: Path, name: str, figure: Figure, columns: Mapping[str, Array], caption: str) -> Picture:
    write_atomic(folder / f"{name}.png", lambda file: figure.savefig(file, format="png", dpi=130))
    save_csv(columns, folder / f"{name}.csv")
    return Picture(f"{name}.png", f"{name}.csv", caption)


def _middle(values: Array) -> tuple[float, float]:
    """Return limits of an axis that show all but the last hundredth on either side."""
    low, high = np.quantile(values, [0.01, 0.99])
    return float(low - 0.05 * (high - low)), float(high + 0.05 * (high - low))


def _finish(axis: Axes, label: str, loc: Any, columns: int = 1) -> None:
    axis.set_ylabel(label)
    axis.grid(alpha=0.25)
    if loc:
        axis.legend(fontsize=8, loc=loc, framealpha=0.9, ncols=columns)
