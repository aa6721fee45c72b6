"""Plots of a run over time: energy, impacts and gaps, and the forces of persistent contacts."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from contactvi.errors import InputError
from contactvi.files import write_atomic
from contactvi.records.codes import Change, GuardKind
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ENERGY, _MODIFIED, _CORRECTED, _IMPACT, _LIMIT = "#1f5fa8", "#e08a00", "#2f9e83", "#c8371b", "#7a5ab5"
_DISCRETE = "#7d6608"
_CHANGE = {"slip": "#c77ca3", "stick": "#56b4e9", "release": "#8c8f94", "begin": "#8c8f94"}
_MAX_MARKS = 400  # impacts, or changes of one kind, drawn as lines
_MAX_PAIRS = 6  # gaps drawn
_FEW_NODES = 200


def _check(traj: object) -> None:
    if not isinstance(traj, Trajectory):
        raise InputError(
            "Argument traj",
            name="traj",
            expected="a Trajectory",
            got=type(traj).__name__,
            remedy="Give what simulate or Trajectory.load returned",
        )


def plot(traj: Trajectory) -> Figure:
    """Return a figure of a run: energy relative to its start, the same with losses put back, gaps of touching pairs.

    The figure belongs to no window (matplotlib.figure.Figure): notebooks show it, `figure.savefig` writes it.
    """
    _check(traj)
    gap_time, gap_pairs, gap = traj.gaps
    rows = 3 if len(gap_pairs) else 2
    figure = Figure(figsize=(9.0, 2.6 * rows + 0.6), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    for axis in axes:
        _mark_impacts(axis, traj, named=axis is axes[0])
        axis.grid(alpha=0.25)
        axis.margins(x=0.01)
    _draw_energy(axes[0], traj)
    _draw_error(axes[1], traj)
    if len(gap_pairs):
        _draw_gaps(axes[2], gap_time, gap_pairs, gap)
    axes[-1].set_xlabel("time [s]")
    state = "" if traj.status.ok else f", {traj.status.code.name} at {traj.status.time:.6g} s"
    figure.suptitle(
        f"{traj.t[-1] - traj.t[0]:.6g} s, {traj.stepping}, {len(traj.events)} impacts "
        f"({traj.events.method.upper()}){state}",
        fontsize=11,
    )
    return figure


def save_plot(traj: Trajectory, path: str | os.PathLike[str]) -> Path:
    """Write the figure of `plot` as a PNG file, whole or not at all; return its path."""
    figure = plot(traj)
    return write_atomic(path, lambda file: figure.savefig(file, format="png", dpi=130))


def plot_forces(traj: Trajectory) -> Figure:
    """Return a figure of the contact forces of a run: along the normal and along the surface, a line per pair.

    Each pair has the sum of its points, a mean over every step with persistent contact; impacts have no force. A run
    without forces has an empty figure. The figure belongs to no window (matplotlib.figure.Figure).
    """
    _check(traj)
    figure = Figure(figsize=(9.0, 5.8), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    forces = [(pair, *_pair_force(traj, pair)) for pair in traj.contacts.pairs]
    forces = [entry for entry in forces if len(entry[1])]
    forces.sort(key=lambda entry: -float(entry[2].max()))
    for (a, b), time, normal, along in forces[:_MAX_PAIRS]:
        for axis, values in zip(axes, (normal, along), strict=True):
            axis.plot(time, values, lw=1.2, label=f"{a} | {b}")
    for axis in axes:
        _mark_changes(axis, traj, named=axis is axes[1])
        axis.grid(alpha=0.25)
        axis.margins(x=0.01)
        if forces:
            _legend(axis)
    more = f" ({_MAX_PAIRS} of {len(forces)} pairs)" if len(forces) > _MAX_PAIRS else ""
    axes[0].set_ylabel(f"normal force [N]{more}")
    axes[1].set_ylabel("friction force [N]")
    axes[1].set_xlabel("time [s]")
    figure.suptitle(f"Contact forces, {traj.stepping}", fontsize=11)
    return figure


def save_force_plot(traj: Trajectory, path: str | os.PathLike[str]) -> Path:
    """Write the figure of `plot_forces` as a PNG file, whole or not at all; return its path."""
    figure = plot_forces(traj)
    return write_atomic(path, lambda file: figure.savefig(file, format="png", dpi=130))


def _pair_force(traj: Trajectory, pair: tuple[str, str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (k,) [s] and the force of a pair along its normals and across them, (k,) [N]; gaps are NaN."""
    log = traj.contacts.of(*pair)
    rows = np.flatnonzero(log.has_force & (log.array("kind") == GuardKind.CONTACT))
    if not len(rows):
        return np.zeros(0), np.zeros(0), np.zeros(0)
    start, group = np.unique(log.t[rows], return_inverse=True)
    group = group.reshape(-1)
    normal = np.bincount(group, log.normal_impulse[rows] / log.h[rows], minlength=len(start))
    along = log.normal_impulse[rows, None] * log.array("normal")[rows]
    across = (log.impulse[rows] - along) / log.h[rows, None]
    total = np.zeros((len(start), 3))
    np.add.at(total, group, across)
    end = np.zeros(len(start))
    end[group] = log.end[rows]
    # Lines are broken where the pair separated, but not where a part of a step is too short to be drawn.
    apart = 1 + np.flatnonzero(start[1:] - end[:-1] > 1e-2 * log.h.max())
    columns = (0.5 * (start + end), normal, np.linalg.norm(total, axis=1))
    time, *values = (np.insert(column, apart, np.nan) for column in columns)
    return time, values[0], values[1]


def _mark_changes(axis: Axes, traj: Trajectory, named: bool) -> None:
    times, kinds = traj.contact_changes.array("time"), traj.contact_changes.array("change")
    for kind, color in _CHANGE.items():
        _mark(axis, times[kinds == Change[kind.upper()]], color, 0.6, kind if named else None)


def _mark(axis: Axes, times: np.ndarray, color: str, alpha: float, label: str | None) -> None:
    """Draw a line over the whole height at each time, at _MAX_MARKS of them where there are more.

    The lines are one artist: a legend looks for its place at every one.
    """
    if not len(times):
        return
    times = np.unique(times)
    if len(times) > _MAX_MARKS:
        times = times[np.linspace(0, len(times) - 1, _MAX_MARKS).astype(int)]
    lines = np.stack([np.column_stack([times, np.full(len(times), end)]) for end in (0.0, 1.0)], axis=1)
    marks = LineCollection(
        list(lines), colors=color, linewidths=0.7, alpha=alpha, zorder=0, label=label or "_nolegend_",
        transform=axis.get_xaxis_transform(),
    )  # fmt: skip
    axis.add_collection(marks, autolim=False)


def _draw_energy(axis: Axes, traj: Trajectory) -> None:
    """Draw the energy with its jumps: each impact has two points of its own, before and after."""
    t, change = _with_jumps(traj)
    axis.plot(t, change, color=_ENERGY, lw=1.4, marker=_marker(traj), ms=4, label="H - H(0)")
    axis.set_ylabel("energy change [J]")
    _legend(axis)


def _draw_error(axis: Axes, traj: Trajectory) -> None:
    """Draw the energies with the losses of the impacts put back, in bold what the impact map of the run conserves.

    For a system without damping and inputs what remains is the error of the integrator and of the impact map.
    """
    own, lost = traj.events.method, traj.impact_loss + traj.friction_loss
    curves = [
        ("ctec", "H - H(0) + losses", traj.energy, _CORRECTED, "-"),
        ("mhc", "the same of the modified H", traj.modified_energy, _MODIFIED, (0, (4, 3))),
    ]
    if own == "dtec":  # it has gaps, because where an impact cuts a step DTEC conserves the energy of the two parts
        curves.append(("dtec", "the same of the discrete energy of whole steps", traj.discrete_energy, _DISCRETE, "-"))
    for method, name, energy, color, style in curves:
        change = energy + lost
        known = change[np.isfinite(change)]
        if not len(known):
            continue
        kept = "kept across the parts of cut steps by DTEC" if own == "dtec" else f"conserved by {own.upper()}"
        label, width = (f"{name} ({kept})", 1.8) if method == own else (name, 1.0)
        axis.plot(traj.t, change - known[0], color=color, lw=width, ls=style, marker=_marker(traj), ms=4, label=label)
    axis.set_ylabel("damping, inputs,\nintegrator [J]")
    axis.ticklabel_format(axis="y", style="sci", scilimits=(-3, 3))
    _legend(axis)


def _draw_gaps(axis: Axes, time: np.ndarray, pairs: list[tuple[str, str]], gap: np.ndarray) -> None:
    order = np.argsort(gap.min(axis=0))[:_MAX_PAIRS]
    for k in order:
        axis.plot(time, gap[:, k], lw=1.1, label=f"{pairs[k][0]} | {pairs[k][1]}")
    axis.axhline(0.0, color="black", lw=0.8)
    more = f" ({len(order)} of {len(pairs)} pairs that touched)" if len(pairs) > len(order) else ""
    axis.set_ylabel(f"gap [m]{more}")
    _legend(axis)


def _marker(traj: Trajectory) -> str:
    """Return the marker of nodes, none where they are many: energies are known at nodes and impacts only."""
    return "." if len(traj) <= _FEW_NODES else ""


def _with_jumps(traj: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return times and H - H(0) with two points at each impact, so that a loss is drawn as a step."""
    change = traj.energy - traj.energy[0]
    time, jump = traj.events.array("time"), traj.events.energy_change
    total = np.cumsum(jump)
    if not len(time):
        return traj.t, change
    smooth = np.interp(time, traj.t, change - traj.impact_energy)  # without the impacts there are no jumps
    t = np.concatenate([traj.t, time, time])
    values = np.concatenate([change, smooth + total - jump, smooth + total])
    rank = np.concatenate([np.full(len(traj.t), 2.0), np.zeros(len(time)), np.ones(len(time))])
    # Impacts at one instant keep their order, each with its points before and after.
    count = np.concatenate([np.full(len(traj.t), len(time)), np.arange(len(time)), np.arange(len(time))])
    order = np.lexsort((rank, count, t))
    return t[order], values[order]


def _mark_impacts(axis: Axes, traj: Trajectory, named: bool) -> None:
    times, kinds = traj.events.array("time"), traj.events.array("kind")
    for kind, color in ((GuardKind.CONTACT, _IMPACT), (GuardKind.LIMIT, _LIMIT)):
        _mark(axis, times[kinds == kind], color, 0.45, ("impact", "joint limit")[kind] if named else None)


def _legend(axis: Axes) -> None:
    axis.legend(fontsize=8, loc="best", framealpha=0.85)
