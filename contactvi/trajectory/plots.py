"""Plots of a run over time: energy and gaps, states, the forces of persistent contacts, reactions of constraints."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from contactvi.errors import InputError
from contactvi.files import write_atomic
from contactvi.importing.joint_kinds import joint_kind
from contactvi.inputs import check_choice, flag, listed, positive, real, short, vector, words
from contactvi.records.codes import GuardKind
from contactvi.records.pair_colors import pair_colors
from contactvi.scene.coordinates import coordinates
from contactvi.trajectory.angles import turned_angles
from contactvi.trajectory.force_plots import force_figure, span_of
from contactvi.trajectory.plot_layout import Instants, draw_curve, draw_curves, legend, panels, zero_line
from contactvi.trajectory.reaction_plots import reaction_figure
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ENERGY, _MODIFIED, _CORRECTED, _IMPACT, _LIMIT = "#1f5fa8", "#e08a00", "#2f9e83", "#c8371b", "#7a5ab5"
_DISCRETE = "#7d6608"
_MAX_PAIRS = 6  # gaps drawn
_FEW_NODES = 200
# The panels of the states: what they show, and the unit of the numbers that belong there.
_STATES = (("position", "m"), ("angle", "rad"), ("velocity", "m/s"), ("angular velocity", "rad/s"))
_IN_OWN_AXES = {"velocity": {"free", "planar"}, "angular velocity": {"free", "spherical"}}  # types of joints


def _check(traj: object) -> None:
    if not isinstance(traj, Trajectory):
        raise InputError(
            "Argument traj",
            name="traj",
            expected="a Trajectory",
            got=type(traj).__name__,
            remedy="Give what simulate or Trajectory.load returned",
        )


def plot(
    traj: Trajectory,
    *,
    size: Sequence[float] | None = None,
    window: Sequence[float] | None = None,
    pairs: Sequence[Sequence[Any]] | None = None,
) -> Figure:
    """Return a figure of a run: energy relative to its start, its balance, gaps of touching pairs.

    The balance is the energy with what impacts, friction of contacts and joints, and damping took put back, less the
    work of inputs and prescribed motions: it is flat but for the error of the steps.

    Impacts are lines, where they are many a strip whose colour is their density. The figure belongs to no window
    (matplotlib.figure.Figure): a notebook shows it where it is the last line of a cell, `figure.savefig` writes it.

    Args:
        size: width and height of the figure [in]; None: ten inches wide.
        window: times between which it is drawn [s]; None: all of the run.
        pairs: whose gaps are drawn, as of `plot_forces`.

    Raises:
        InputError: a bad argument; two that never touched.
    """
    _check(traj)
    shown, chosen = _window(traj, window), _pairs(traj, pairs)
    gap_time, gap_pairs, gap = traj.gaps
    if chosen is not None:
        kept = [k for k, pair in enumerate(gap_pairs) if pair in chosen]
        gap_pairs, gap = [gap_pairs[k] for k in kept], gap[:, kept]
    state = "" if traj.status.ok else f", {traj.status.code.name} at {traj.status.time:.6g} s"
    title = (
        f"{traj.t[-1] - traj.t[0]:.6g} s, {traj.stepping}, {len(traj.events)} impacts "
        f"({traj.events.method.upper()}){state}"
    )
    figure, axes = panels(title, shown, 3 if len(gap_pairs) else 2, _impacts(traj), _size(size))
    _draw_energy(axes[0], traj)
    _draw_error(axes[1], traj)
    if len(gap_pairs):
        _draw_gaps(axes[2], gap_time, gap_pairs, gap, pair_colors(traj.events, traj.contacts))
    return figure


def plot_states(
    traj: Trajectory, *, size: Sequence[float] | None = None, window: Sequence[float] | None = None
) -> Figure:
    """Return a figure of the coordinates and velocities of a run, a panel for each unit.

    Names are those of contactvi.scene.coordinates.Coordinates; more than ten in a panel get a scale of colours.
    Velocities of free, planar and spherical joints are Pinocchio's, in the axes of their bodies, which the labels say.
    Quaternions are left out, and of a joint without end there is the angle over whole turns, JOINT.angle. The figure is
    one as that of `plot`, and so are size, window and the errors.
    """
    _check(traj)
    shown = _window(traj, window)
    named = coordinates(traj.scene.model)
    numbers = [*zip(named.q.items(), traj.q.T, strict=True), *zip(named.v.items(), traj.v.T, strict=True)]
    numbers += [((name, "rad"), angle) for name, angle in turned_angles(traj).items()]
    groups = [(what, unit, [(name, y) for (name, of), y in numbers if of == unit]) for what, unit in _STATES]
    groups = [group for group in groups if group[2]]
    figure, axes = panels(f"States, {traj.stepping}", shown, max(1, len(groups)), _impacts(traj), _size(size))
    kinds = {joint_kind(joint) for joint in list(traj.scene.model.joints)[1:]}
    for axis, (what, unit, curves) in zip(axes, groups, strict=False):
        draw_curves(axis, traj.t, curves)
        zero_line(axis)
        turning = bool(kinds & _IN_OWN_AXES.get(what, set()))
        axis.set_ylabel(f"{what} [{unit}]" + ("\n(bodies: own axes)" if turning else ""))
    return figure


def plot_forces(
    traj: Trajectory,
    by: str = "pair",
    *,
    size: Sequence[float] | None = None,
    window: Sequence[float] | None = None,
    pairs: Sequence[Sequence[Any]] | None = None,
) -> Figure:
    """Return a figure of the contact forces of a run. Impacts have no force.

    Args:
        by: "pair": forces along the normal and along the surface, a line per pair with the sum of its points, a mean
            over every step with persistent contact; and how much of the friction cone each contact point uses,
            friction / (mu normal), which is 1 where it slides. "body": the sum of all contact forces on each body,
            also on those fixed to the world, along the axes of the world. "joint": what servos and inputs do at the
            driven joints (`Trajectory.effort`), in N m and in N; positive where it pushes towards larger coordinates.
        size, window: as of `plot`.
        pairs: (a, b) of those whose contacts are drawn, each a shape, body or part as in `contacts.of`; None: all.

    Forces that have a sign have a line at zero, and their labels say where positive ones point.

    Of many pairs or bodies those are drawn whose impulses are the largest, which the legend says. A run without forces
    has empty panels. The figure is one as that of `plot`.
    """
    _check(traj)
    check_choice("by", by, ("pair", "body", "joint"), "Unknown sum of forces")
    if by == "joint" and pairs is not None:
        raise InputError(
            "Pairs of a figure of joints", name="pairs", expected='None with by="joint"', got=short(pairs),
            remedy='Leave pairs out, or use by="pair"',
        )  # fmt: skip
    return force_figure(traj, by, _window(traj, window), _size(size), _pairs(traj, pairs))


def plot_reactions(
    traj: Trajectory,
    constraints: Sequence[str] | None = None,
    *,
    size: Sequence[float] | None = None,
    window: Sequence[float] | None = None,
) -> Figure:
    """Return a figure of the reactions of the constraints of a run: what keeps loops closed and drives motions.

    Loops, joints that follow others, driven lengths, and the forces of motors that follow a motion. They are those of
    `Trajectory.reactions`, with its signs and axes: means over the time between two nodes, in whose middle they are
    drawn, impacts included, a panel for forces [N] and one for torques [N m]. A constraint has one colour in both; x is
    solid, y dashed and z dotted. More than ten curves in a panel get a scale of colours.

    Args:
        constraints: names of those that are drawn (`traj.constraints`); None: all.
        size, window: as of `plot`.

    The figure is one as that of `plot`. A run without constraints has an empty panel.

    Raises:
        InputError: a bad argument; an unknown name.
    """
    _check(traj)
    names = None
    if constraints is not None:
        names = [words("constraints", name) for name in listed("constraints", constraints, "names of constraints")]
    return reaction_figure(traj, _window(traj, window), _size(size), names, _impacts(traj))


def _size(size: Sequence[float] | None) -> tuple[float, float] | None:
    """Return width and height of a figure [in], or None. Raises InputError."""
    if size is None:
        return None
    width, height = vector("size", size, 2).tolist()
    return positive("size", width, "inches > 0"), positive("size", height, "inches > 0")


def _window(traj: Trajectory, window: Sequence[float] | None) -> tuple[float, float]:
    """Return the first and the last time that are drawn [s]. Raises InputError."""
    first, last = span_of(traj)
    if window is None:
        return first, last
    start, end = vector("window", window, 2).tolist()
    if not first <= start < end <= last:
        raise InputError(
            "Times of a figure", name="window", expected=f"two times of the run in order, {first:g} to {last:g} s",
            got=f"({start:g}, {end:g})", remedy=f"Use window=({first:g}, {last:g}) or a part of it",
        )  # fmt: skip
    return start, end


def _pairs(traj: Trajectory, pairs: Sequence[Sequence[Any]] | None) -> set[tuple[str, str]] | None:
    """Return the pairs of shapes that are drawn; None for all. Raises InputError."""
    if pairs is None:
        return None
    for pair in (given := listed("pairs", pairs, "pairs (a, b)")):
        if len(listed("pairs", pair, "two names")) != 2:
            raise InputError(
                "A pair of two", name="pairs", expected="(a, b)", got=short(pair), remedy='Use pairs=[("a", "b")]'
            )
    return {found for a, b in given for found in traj.contacts.of(a, b).pairs}


def save_figure(
    figure: Figure,
    path: str | os.PathLike[str],
    overwrite: bool = False,
    *,
    dpi: float = 130.0,
    transparent: bool = False,
) -> Path:
    """Write a figure as an SVG, where the name ends in .svg, else as a PNG file, whole or not at all; return its path.

    Args:
        figure: such as of `plot`, `plot_states`, `plot_forces` and `plot_reactions`.
        path: ends with .png or .svg.
        overwrite: whether a file of this name is replaced.
        dpi: pixels per inch of a PNG; figures of runs are ten inches wide. In an SVG lines have no pixels, dots of
            force plots have.
        transparent: leave the background out.

    Raises:
        OverwriteError: there is such a file, without `overwrite`.
        InputError: a bad argument.
    """
    kind = "svg" if Path(path).suffix.lower() == ".svg" else "png"
    style: dict[str, Any] = {
        "format": kind,
        "dpi": real("dpi", dpi, 10.0, 2400.0, expected="10 to 2400 pixels per inch"),
        "transparent": flag("transparent", transparent),
    }
    return write_atomic(path, lambda file: figure.savefig(file, **style), overwrite)


def _impacts(traj: Trajectory) -> list[Instants]:
    times, kinds = traj.events.array("time"), traj.events.array("kind")
    found = (("impacts", GuardKind.CONTACT, _IMPACT), ("at joint limits", GuardKind.LIMIT, _LIMIT))
    return [Instants(name, times[kinds == kind], color) for name, kind, color in found]


def _draw_energy(axis: Axes, traj: Trajectory) -> None:
    """Draw the energy with its jumps: each impact has two points of its own, before and after."""
    t, change = _with_jumps(traj)
    draw_curve(axis, t, change, "H - H(0)", color=_ENERGY, lw=1.4, marker=_marker(traj), ms=4)
    axis.set_ylabel("energy change [J]")
    zero_line(axis)
    legend(axis)


def _draw_error(axis: Axes, traj: Trajectory) -> None:
    """Draw the energies less what was put in, with what was taken put back, in bold what the impact map conserves.

    What remains is the error of the integrator and of the impact map.
    """
    own, lost, name = traj.events.method, traj.impact_loss + traj.friction_loss, "H - H(0) + losses"
    if traj.forces is not None:
        work = traj.work
        lost = lost + work.damping + work.joint_friction - work.input - work.prescribed
        name += " - work put in" * bool(np.any(work.input) or np.any(work.prescribed))
    curves = [
        ("ctec", name, traj.energy, _CORRECTED, "-"),
        ("mhc", "the same of the modified H", traj.modified_energy, _MODIFIED, (0, (4, 3))),
    ]
    if own == "dtec":  # it has gaps, because where an impact cuts a step DTEC conserves the energy of the two parts
        curves.append(("dtec", "the same of E_d of whole steps", traj.discrete_energy, _DISCRETE, "-"))
    for method, name, energy, color, style in curves:
        change = energy + lost
        known = change[np.isfinite(change)]
        if not len(known):
            continue
        kept = f"conserved by {own.upper()} in impacts"
        if own == "dtec":
            kept = "kept across the parts of\ncut steps by DTEC"
        label, width = (f"{name},\n{kept}", 1.8) if method == own else (name, 1.0)
        draw_curve(axis, traj.t, change - known[0], label, color=color, lw=width, ls=style, marker=_marker(traj), ms=4)
    unknown = "" if traj.forces is not None else "damping, inputs,\n"
    axis.set_ylabel(f"{unknown}error of energy [J]")
    zero_line(axis)
    axis.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))
    legend(axis)


def _draw_gaps(
    axis: Axes,
    time: np.ndarray,
    pairs: list[tuple[str, str]],
    gap: np.ndarray,
    colors: dict[tuple[str, str], str],
) -> None:
    ranked = list(colors)  # by impulse: the first ones have colours of their own
    order = sorted(range(len(pairs)), key=lambda k: ranked.index(pairs[k]))[:_MAX_PAIRS]
    zero_line(axis, always=True)
    more = f"{len(order)} of {len(pairs)} pairs that touched, by impulse" if len(pairs) > len(order) else ""
    for k in order:
        draw_curve(axis, time, gap[:, k], " | ".join(pairs[k]), color=colors[pairs[k]], lw=1.1)
    legend(axis, more)
    axis.set_ylabel("gap [m]")


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
