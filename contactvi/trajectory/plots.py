"""Pictures of a run that are no animation: energy, impacts and gaps over time; the forces of lasting contacts."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from contactvi.files import write_atomic
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ENERGY, _MODIFIED, _CORRECTED, _IMPACT, _LIMIT = "#1f5fa8", "#e08a00", "#2f9e83", "#c8371b", "#7a5ab5"
_DISCRETE = "#7d6608"
_CHANGE = {"slip": "#c77ca3", "stick": "#56b4e9", "release": "#8c8f94", "begin": "#8c8f94"}
_MAX_MARKS = 400  # impacts drawn as lines
_MAX_PAIRS = 6  # gaps drawn
_FEW_NODES = 200


def plot(traj: Trajectory) -> Figure:
    """Return a figure of a run: energy relative to its start, the same with losses put back, gaps of touching pairs.

    The figure belongs to no window (matplotlib.figure.Figure): notebooks show it, `figure.savefig` writes it.
    """
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

    Of each pair the sum of its points, mean over every step in which it was held; impacts have no force. A run without
    forces has an empty figure. The figure belongs to no window, as that of `plot`.
    """
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
    held = np.flatnonzero(log.lasting & (log.array("kind") == 0))
    if not len(held):
        return np.zeros(0), np.zeros(0), np.zeros(0)
    start, group = np.unique(log.t[held], return_inverse=True)
    group = group.reshape(-1)
    normal = np.bincount(group, log.normal_impulse[held] / log.h[held], minlength=len(start))
    along = log.normal_impulse[held, None] * log.array("normal")[held]
    across = (log.impulse[held] - along) / log.h[held, None]
    total = np.zeros((len(start), 3))
    np.add.at(total, group, across)
    end = np.zeros(len(start))
    end[group] = log.end[held]
    # Lines are broken where the pair was apart, not where a part of a step is too short to be drawn.
    apart = 1 + np.flatnonzero(start[1:] - end[:-1] > 1e-2 * log.h.max())
    columns = (0.5 * (start + end), normal, np.linalg.norm(total, axis=1))
    time, *values = (np.insert(column, apart, np.nan) for column in columns)
    return time, values[0], values[1]


def _mark_changes(axis: Axes, traj: Trajectory, named: bool) -> None:
    for kind, color in _CHANGE.items():
        chosen = [change.time for change in traj.contact_changes if change.change == kind][:_MAX_MARKS]
        for k, time in enumerate(chosen):
            axis.axvline(time, color=color, lw=0.7, alpha=0.6, zorder=0, label=kind if named and k == 0 else None)


def _draw_energy(axis: Axes, traj: Trajectory) -> None:
    """Energy with its jumps: the impacts are put in as points of their own, before and after."""
    t, change = _with_jumps(traj)
    axis.plot(t, change, color=_ENERGY, lw=1.4, marker=_marker(traj), ms=4, label="H - H(0)")
    axis.set_ylabel("energy change [J]")
    _legend(axis)


def _draw_error(axis: Axes, traj: Trajectory) -> None:
    """Energies with the losses of the impacts put back; the thick one is what the impact map of the run conserves.

    For a system without damping and inputs the rest is the error of the integrator and of the impact map.
    """
    own, lost = traj.events.method, traj.impact_loss + traj.friction_loss
    curves = [
        ("ctec", "H - H(0) + losses", traj.energy, _CORRECTED, "-"),
        ("mhc", "the same of the modified H", traj.modified_energy, _MODIFIED, (0, (4, 3))),
    ]
    if own == "dtec":  # has gaps where an impact cuts the step: what DTEC keeps is that of the parts of those steps
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
    """Nodes are marked where there are few: energies are known at nodes and impacts only."""
    return "." if len(traj) <= _FEW_NODES else ""


def _with_jumps(traj: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return times and H - H(0) with two points at each impact, so that a loss is drawn as a step."""
    change = traj.energy - traj.energy[0]
    time, jump = traj.events.array("time"), traj.events.energy_change
    total = np.cumsum(jump)
    if not len(time):
        return traj.t, change
    smooth = np.interp(time, traj.t, change - traj.impact_energy)  # what is not from impacts has no jumps
    t = np.concatenate([traj.t, time, time])
    values = np.concatenate([change, smooth + total - jump, smooth + total])
    rank = np.concatenate([np.full(len(traj.t), 2.0), np.zeros(len(time)), np.ones(len(time))])
    # Impacts at one instant keep their order: before and after of each, one after the other.
    count = np.concatenate([np.full(len(traj.t), len(time)), np.arange(len(time)), np.arange(len(time))])
    order = np.lexsort((rank, count, t))
    return t[order], values[order]


def _mark_impacts(axis: Axes, traj: Trajectory, named: bool) -> None:
    times, kinds = traj.events.array("time"), traj.events.array("kind")
    for kind, color in ((0, _IMPACT), (1, _LIMIT)):
        chosen: Any = np.unique(times[kinds == kind])
        if len(chosen) > _MAX_MARKS:
            chosen = chosen[np.linspace(0, len(chosen) - 1, _MAX_MARKS).astype(int)]
        name = ("impact", "joint limit")[kind]
        for k, time in enumerate(chosen):
            axis.axvline(time, color=color, lw=0.7, alpha=0.45, zorder=0, label=name if named and k == 0 else None)


def _legend(axis: Axes) -> None:
    axis.legend(fontsize=8, loc="best", framealpha=0.85)
