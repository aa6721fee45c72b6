"""The reactions of the constraints of a run as a figure: of loops, followers, motions and driven lengths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactvi.importing.joint_kinds import joint_kind
from contactvi.records.work import ConstraintRows
from contactvi.trajectory.plot_layout import (
    FIRST_COLORS,
    MOST_NAMED,
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
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]

_FORCE, _TORQUE, _UNKNOWN = "N", "N m", "N or N m"
_WRENCH = (("x", _FORCE), ("y", _FORCE), ("z", _FORCE), ("x", _TORQUE), ("y", _TORQUE), ("z", _TORQUE))
# Axis and unit of the rows of each kind, as of Trajectory.reactions; of one row there is no axis. Kinds that are not in
# it act on a joint, whose type has the unit.
_ROWS = {
    "point": _WRENCH[:3],
    "distance": (("", _FORCE),),
    "weld": _WRENCH,
    "screw": (("x", _FORCE), ("y", _FORCE), ("y", _TORQUE), ("-x", _TORQUE), ("z", _FORCE)),
    "prescribe_pose": _WRENCH,
}
_WORDS = {_FORCE: "force", _TORQUE: "torque", _UNKNOWN: "force or torque"}
_STYLES: dict[str, Any] = {"": "-", "x": "-", "-x": "-", "y": (0, (5, 2)), "z": (0, (1, 1.2))}


class _Curve(NamedTuple):
    """A row of a constraint over time: its name, the number of the constraint, its axis, values (N - 1,)."""

    name: str
    constraint: int
    along: str
    values: Array


def reaction_figure(
    traj: Trajectory,
    window: tuple[float, float],
    size: tuple[float, float] | None,
    names: Sequence[str] | None,
    instants: Sequence[Instants],
) -> RunFigure:
    """Return the figure of contactvi.plot_reactions.

    Args:
        window: the times that are drawn [s].
        names: of the constraints; None: all.

    Raises:
        InputError: an unknown name.
    """
    rows = traj.constraints
    for name in names or ():
        traj.reactions(name)  # says what names there are
    if names is not None:
        rows = [row for row in rows if row.name in names]
    by_unit: dict[str, list[_Curve]] = {unit: [] for unit in _WORDS}
    for k, row in enumerate(rows):
        values = traj.reactions(row.name)[1:]
        for (along, unit), column in zip(_axes(traj, row), values.T, strict=True):
            by_unit[unit].append(_Curve(f"{row.name}.{along}" if along else row.name, k, along, column))
    units = [unit for unit, curves in by_unit.items() if curves]
    figure, axes = panels(f"Reactions of constraints, {traj.stepping}", window, max(1, len(units)), instants, size)
    middle = 0.5 * (traj.t[1:] + traj.t[:-1])  # a reaction is the mean since the node before
    inside = (traj.t[1:] >= window[0]) & (traj.t[:-1] <= window[1])
    for axis, unit in zip(axes, units, strict=False):
        curves = by_unit[unit]
        if len(curves) > MOST_NAMED:
            draw_curves(axis, middle, [(curve.name, curve.values) for curve in curves])
        else:
            for curve in curves:
                color = FIRST_COLORS[curve.constraint % len(FIRST_COLORS)]
                draw_curve(axis, middle, curve.values, curve.name, lw=1.1, color=color, ls=_STYLES[curve.along])
            legend(axis)
        shown = [curve.values[inside] for curve in curves]
        scale_forces(axis, shown, largest_force(shown), signed=True, none="no force")
        axis.set_ylabel(f"{_WORDS[unit]} of constraint [{unit}]\n(on its second body, or joint)")
        zero_line(axis, always=True)
    if not units:
        write_in_middle(axes[0], "no constraint")
    return figure


def _axes(traj: Trajectory, row: ConstraintRows) -> Sequence[tuple[str, str]]:
    """Return axis and unit of each row of a constraint."""
    return _ROWS[row.kind] if row.kind in _ROWS else (("", _unit_of_joint(traj, row.name)),)


def _unit_of_joint(traj: Trajectory, name: str) -> str:
    """Return the unit of what a constraint does at its joint; a run read from a file may lack the constraint."""
    built = traj.scene.built()
    for row in built.elements.constraints:
        if row.name == name:
            return _FORCE if joint_kind(built.model.joints[row.b[0]]) == "prismatic" else _TORQUE
    return _UNKNOWN
