"""The contact forces of a run as a figure: per pair with the use of the friction cones, or per body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactvi.elements.element import WORLD
from contactvi.records.codes import CHANGES, GuardKind
from contactvi.records.contacts import ContactLog
from contactvi.records.pair_colors import pair_colors
from contactvi.trajectory.plot_layout import (
    FIRST_COLORS,
    Instants,
    RunFigure,
    draw_curve,
    draw_curves,
    largest_force,
    legend,
    panels,
    scale_forces,
    write_in_middle,
    zero_line,
)
from contactvi.trajectory.tables import friction_ratio
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
_CHANGE = {"begin": "#55585c", "stick": "#2b8cc4", "slip": "#c77ca3", "release": "#8c8f94"}
_MOST = 6  # pairs or bodies drawn


class Steps(NamedTuple):
    """Sums over the contacts of a pair or a body, step by step: starts and lengths (k,) [s], impulses (k, n) [N s]."""

    start: Array
    h: Array
    impulse: Array


def span_of(traj: Trajectory) -> tuple[float, float]:
    """Return the first and the last time of a run [s]."""
    return float(traj.t[0]), float(traj.t[-1])


def force_figure(
    traj: Trajectory,
    by: str,
    window: tuple[float, float],
    size: tuple[float, float] | None = None,
    pairs: set[tuple[str, str]] | None = None,
) -> RunFigure:
    """Return the figure of contactvi.plot_forces.

    Args:
        window: the times that are drawn [s]. pairs: of shapes; None: all.
    """
    if by == "joint":
        return _joint_figure(traj, window, size)
    log = traj.contacts
    rows = log.has_force & (log.array("kind") == GuardKind.CONTACT) & (log.end >= window[0]) & (log.t <= window[1])
    if pairs is not None:
        rows &= np.array([pair in pairs for pair in traj.scene.pair_names])[np.where(rows, log.array("index"), 0)]
    log = log.rows(rows)
    changes = traj.contact_changes
    kind, time = changes.array("change"), changes.array("time")
    instants = [Instants(name, time[kind == CHANGES.index(name)], color) for name, color in _CHANGE.items()]
    title = f"Contact forces{' on bodies' if by == 'body' else ''}, {traj.stepping}"
    figure, axes = panels(title, window, 3, instants, size)
    if by == "body":
        _draw_bodies(axes, traj, log)
    else:
        _draw_pairs(axes, traj, log)
    return figure


def _joint_figure(traj: Trajectory, window: tuple[float, float], size: tuple[float, float] | None) -> RunFigure:
    """Return the figure of what servos and inputs do at joints. Raises InputError where that was not kept."""
    found = traj.efforts()
    units = [(what, unit) for what, unit in (("torque", "N m"), ("force", "N")) if unit in found.joints.values()]
    figure, axes = panels(f"Efforts of joints, {traj.stepping}", window, max(1, len(units)), (), size)
    for axis, (what, unit) in zip(axes, units, strict=False):
        curves = [(joint, found.values[:, k]) for k, (joint, of) in enumerate(found.joints.items()) if of == unit]
        draw_curves(axis, found.t, curves)
        axis.set_ylabel(f"{what} of servo and input [{unit}]\n(+ towards larger coordinates)")
        zero_line(axis, always=True)
    if not units:
        write_in_middle(axes[0], "no joint is driven")
    return figure


def _draw_pairs(axes: Sequence[Axes], traj: Trajectory, log: ContactLog) -> None:
    index = log.array("index")
    touching = {log.label(int(GuardKind.CONTACT), pair): pair for pair in np.unique(index).tolist()}
    ratio = friction_ratio(traj.scene, log)
    drawn_values: tuple[list[Array], list[Array]] = [], []
    colors = pair_colors(traj.events, traj.contacts)
    drawn = [pair for pair in colors if pair in touching][:_MOST]
    for pair in drawn:
        rows, color = np.flatnonzero(index == touching[pair]), colors[pair]
        name = " | ".join(pair)
        along = log.normal_impulse[rows, None] * log.array("normal")[rows]
        steps = _summed(log, rows, np.column_stack([log.normal_impulse[rows], log.impulse[rows] - along]))
        force = steps.impulse / steps.h[:, None]
        normal, across = force[:, 0], np.linalg.norm(force[:, 1:], axis=1)
        for axis, values, kept in zip(axes, (normal, across), drawn_values, strict=False):
            kept.append(values)
            draw_curve(axis, *_broken(steps, values), name, color=color, lw=1.1)
        known = np.isfinite(ratio[rows])
        middle = (log.t + 0.5 * log.h)[rows][known]
        if not len(middle):
            continue  # nothing that a legend could name
        axes[2].plot(middle, ratio[rows][known], ls="", marker=".", ms=1.5, color=color, label=name, rasterized=True)
    if len(drawn) and not np.any(np.isfinite(ratio)):
        write_in_middle(
            axes[2], "no cone of one coefficient: no friction,\nor it is a function of the slip, or adhesion"
        )
    else:
        axes[2].axhline(1.0, color="black", lw=0.8, ls="--", label="on the cone: it slides" if len(drawn) else None)
    for axis, values in zip(axes, drawn_values, strict=False):
        scale_forces(axis, values, largest_force(values), signed=False)
    axes[2].set_ylim(-0.03, 1.1 if not np.any(ratio > 1.07) else None)
    axes[0].set_ylabel("normal force [N]")
    axes[1].set_ylabel("friction force [N]")
    axes[2].set_ylabel("friction / (mu normal)\nof each point")
    for axis in axes:
        legend(axis, _chosen(len(drawn), len(touching), "pairs"))


def _draw_bodies(axes: Sequence[Axes], traj: Trajectory, log: ContactLog) -> None:
    sides = _body_sides(traj)
    index = log.array("index")
    sums = {}
    for body, sign in sides.items():
        rows = np.flatnonzero(sign[index] != 0.0)
        if len(rows):
            sums[body] = _summed(log, rows, sign[index[rows], None] * log.impulse[rows])
    order = sorted(sums, key=lambda body: -float(np.linalg.norm(sums[body].impulse, axis=1).sum()))
    forces = [sums[body].impulse / sums[body].h[:, None] for body in order[:_MOST]]
    for k, (body, force) in enumerate(zip(order, forces, strict=False)):
        for axis, values in zip(axes, force.T, strict=True):
            draw_curve(axis, *_broken(sums[body], values), body, color=FIRST_COLORS[k], lw=1.1)
    largest = largest_force([force.ravel() for force in forces])
    for k, (axis, name) in enumerate(zip(axes, "xyz", strict=True)):
        axis.set_ylabel(f"force on the body [N]\n(+ along {name})")
        zero_line(axis, always=True)
        scale_forces(axis, [force[:, k] for force in forces], largest, signed=True)
        legend(axis, _chosen(min(_MOST, len(order)), len(order), "bodies"))


def _body_sides(traj: Trajectory) -> dict[str, Array]:
    """Return of each body with shapes its side of the pairs, (npairs,): +1 second, -1 first, 0 neither or both.

    Bodies that can move come before those fixed to the world; what Pinocchio has in its universe is the world's.
    """
    frames, shapes = traj.scene.model.frames, traj.scene.collision_model.geometryObjects
    pairs = [(pair.first, pair.second) for pair in traj.scene.collision_model.collisionPairs]
    bodies = [str(frames[shape.parentFrame].name) if shape.parentFrame else WORLD for shape in shapes]
    order = sorted(range(len(bodies)), key=lambda k: shapes[k].parentJoint == 0)
    return {
        body: np.array([(bodies[b] == body) * 1.0 - (bodies[a] == body) * 1.0 for a, b in pairs])
        for body in dict.fromkeys(bodies[k] for k in order)
    }


def _summed(log: ContactLog, rows: NDArray[np.int64], impulse: Array) -> Steps:
    """Return the sums of impulses (m, n) of these rows over the points of each step."""
    start, group = np.unique(log.t[rows], return_inverse=True)
    group = group.reshape(-1)
    total, h = np.zeros((len(start), impulse.shape[1])), np.zeros(len(start))
    np.add.at(total, group, impulse)
    h[group] = log.h[rows]
    return Steps(start, h, total)


def _broken(steps: Steps, values: Array) -> tuple[Array, Array]:
    """Return the middles of the steps and values with NaN where contact was lost, but not where a part of a step is too
    short to be drawn."""
    apart = 1 + np.flatnonzero(steps.start[1:] - (steps.start + steps.h)[:-1] > 1e-2 * steps.h.max(initial=0.0))
    return np.insert(steps.start + 0.5 * steps.h, apart, np.nan), np.insert(values, apart, np.nan)


def _chosen(drawn: int, known: int, what: str) -> str:
    return f"{drawn} of {known} {what}, by impulse" if known > drawn else ""
