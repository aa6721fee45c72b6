"""How the plots of a run are laid out: panels above each other with one time axis, which is the same in all figures.

Legends stand at the right of the panels. Instants (impacts, changes of contacts) are lines while these cover little of
the panels; where there are more of them each kind gets a strip above the panels, whose colour is their density.
"""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.colors import TABLEAU_COLORS, BoundaryNorm, LinearSegmentedColormap, ListedColormap, PowerNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from contactvi.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

_WIDTH, _LEFT, _RIGHT, _TOP, _BOTTOM, _SPACE, _STRIP = 10.0, 1.1, 2.6, 0.3, 0.5, 0.3, 0.13  # [in]
_LABEL = 0.72  # from the panels to the labels of their values, which stand below each other [in]
_LEAST_WIDTH, _LEAST_HEIGHT = 1.5, 0.9  # of a panel [in]
_SMALL, _TITLE = 7, 10  # letters of legends, of titles [pt]
_TITLE_LETTERS = 105  # of a line
_MARGIN = 0.01  # of the span of the run, at both ends of the time axis
_LINE = 0.7  # width of the line of an instant [pt]
_COVERED = 0.1  # part of the width that lines of instants may cover
_MOST_INSTANTS = int(_COVERED * 72 * (_WIDTH - _LEFT - _RIGHT) / _LINE)
_BINS = 300  # of a strip or band, 1.5 points wide
_MOST_SWINGS = _BINS / 4  # from its least to its greatest value, of a curve that is drawn as a line
_SEEN = 1e-6  # part of its size by which a curve has to change for that to be seen
MOST_NAMED = 10  # curves that a legend names; more get a scale of colours
_MOST_TICKS = 20  # names beside such a scale
_LONGEST = 36  # letters of a line of a legend
# Where the largest force is so many times the median of those that count, the scale is logarithmic: on a linear one
# half of the curve would lie within a line's width of its axis. Forces count down to a part of the largest, the scale's
# end.
_PEAK, _LEAST = 100.0, 1e-4

FIRST_COLORS = tuple(TABLEAU_COLORS.values())


class RunFigure(Figure):
    """A figure of a run that belongs to no window: notebooks show it as the last line of a cell."""

    def _repr_png_(self) -> bytes:
        page = io.BytesIO()
        self.savefig(page, format="png", dpi=100)
        return page.getvalue()


class Instants(NamedTuple):
    """Instants of one kind: times (n,) [s]."""

    name: str
    time: Array
    color: str


class Panels(NamedTuple):
    """A figure with its panels, from top to bottom."""

    figure: RunFigure
    axes: list[Axes]


def panels(
    title: str,
    span: tuple[float, float],
    count: int,
    instants: Sequence[Instants] = (),
    size: tuple[float, float] | None = None,
) -> Panels:
    """Return so many panels over the time of a run, from span[0] to span[1] [s], with the instants that lie in it.

    Args:
        size: width and height of the figure [in]; None: ten inches wide, and as high as so many panels need.

    Raises:
        InputError: a size in which labels and names would be cut, or panels have no room.
    """
    shown = [(kind, kind.time[(kind.time >= span[0]) & (kind.time <= span[1])]) for kind in instants]
    instants = [Instants(kind.name, time, kind.color) for kind, time in shown if len(time)]
    wide = _WIDTH if size is None else size[0]
    strips = instants if sum(len(np.unique(kind.time)) for kind in instants) > _MOST_INSTANTS else []
    height = 2.1 if count > 1 else 3.2
    gaps = [*([0.06] * (len(strips) - 1)), *([0.22] if strips else []), *([_SPACE] * (count - 1))]
    lines = textwrap.wrap(title, max(1, int(_TITLE_LETTERS * wide / _WIDTH)))
    above = _TOP + len(lines) * 1.35 * _TITLE / 72
    other = above + len(strips) * _STRIP + sum(gaps) + _BOTTOM
    if size is not None:
        height = (size[1] - other) / count
        least = [math.ceil(10.0 * x) / 10.0 for x in (_LEFT + _RIGHT + _LEAST_WIDTH, other + count * _LEAST_HEIGHT)]
        if wide < least[0] or height < _LEAST_HEIGHT:
            raise InputError(
                "Size of a figure", name="size", got=f"({wide:g}, {size[1]:g})",
                expected=f"at least {least[0]:g} inches of width and {least[1]:g} of height, for {count} panels with"
                " their labels and names", remedy=f"Use size=({max(least[0], wide):g}, {max(least[1], size[1]):g})",
            )  # fmt: skip
    inches = [*([_STRIP] * len(strips)), *([height] * count)]
    total = other + count * height
    figure = RunFigure(figsize=(wide, total))
    axes: list[Axes] = []
    top = total - above
    for k, inch in enumerate(inches):
        place = (_LEFT / wide, (top - inch) / total, (wide - _LEFT - _RIGHT) / wide, inch / total)
        axes.append(figure.add_axes(place, sharex=axes[0] if axes else None))
        top -= inch + (gaps[k] if k < len(gaps) else 0.0)
    for kind, strip in zip(strips, axes, strict=False):
        _draw_strip(strip, kind, span)
    own = axes[len(strips) :]
    for axis in own:
        axis.grid(alpha=0.25)
        axis.tick_params(labelbottom=axis is own[-1])
        axis.yaxis.set_label_coords(-_LABEL / (wide - _LEFT - _RIGHT), 0.5)
        if not strips:
            for kind in instants:
                _draw_lines(axis, kind, named=axis is own[0])
    room = _MARGIN * (span[1] - span[0]) or 1.0  # of a run without a step
    own[-1].set_xlim(span[0] - room, span[1] + room)
    own[-1].set_xlabel("time [s]")
    figure.suptitle("\n".join(lines), fontsize=_TITLE, x=_LEFT / wide, y=1.0 - 0.08 / total, ha="left", va="top")
    return Panels(figure, own)


def _draw_lines(axis: Axes, kind: Instants, named: bool) -> None:
    name = f"{kind.name} ({len(kind.time)})" if named else None
    ends = [[(time, 0.0), (time, 1.0)] for time in np.unique(kind.time).tolist()]
    across = axis.get_xaxis_transform()  # time [s], and heights from 0 to 1
    lines = LineCollection(ends, colors=kind.color, linewidths=_LINE, alpha=0.5, zorder=0, label=name, transform=across)
    axis.add_collection(lines, autolim=False)


def _draw_strip(axis: Axes, kind: Instants, span: tuple[float, float]) -> None:
    count, edges = np.histogram(kind.time, bins=_BINS, range=span)
    shades = LinearSegmentedColormap.from_list(kind.name, ["white", kind.color])
    # The root of the counts: a single instant is seen beside hundreds.
    norm = PowerNorm(0.5, vmin=0.0, vmax=float(count.max()))
    axis.imshow(count[None], aspect="auto", extent=(*span, 0.0, 1.0), cmap=shades, norm=norm, interpolation="nearest")
    axis.set_yticks([])
    axis.tick_params(bottom=False, labelbottom=False)
    text = f"{kind.name}: {len(kind.time)}, up to {count.max()} in {edges[1] - edges[0]:.2g} s"
    axis.text(1.015, 0.5, text, transform=axis.transAxes, fontsize=_SMALL, va="center", ha="left", color=kind.color)


def draw_curve(axis: Axes, t: Array, y: Array, name: str | None, **style: Any) -> None:
    """Draw y (n,) over t (n,) [s], as far as the panel shows; NaN are gaps. Of a curve with more swings than a panel
    can show, the band of its values."""
    low, high = axis.get_xlim()
    inside = np.flatnonzero((t >= low) & (t <= high))
    if len(inside):  # with the points beside them, to which the lines go on
        shown_part = slice(max(0, inside[0] - 1), inside[-1] + 2)
        t, y = t[shown_part], y[shown_part]
    known = np.isfinite(y)
    shown = y[known]
    height = max(np.ptp(shown), _SEEN * np.abs(shown).max()) if len(shown) else 0.0
    if np.abs(np.diff(shown)).sum() <= _MOST_SWINGS * height:
        axis.plot(t, y, label=name, **style)
        return
    edges = np.linspace(max(t[known][0], low), min(t[known][-1], high), _BINS + 1)
    place = np.clip(np.searchsorted(edges, t[known], side="right") - 1, 0, _BINS - 1)
    least, most = np.full(_BINS, np.inf), np.full(_BINS, -np.inf)
    np.minimum.at(least, place, shown)
    np.maximum.at(most, place, shown)
    least[np.isinf(least)], most[np.isinf(most)] = np.nan, np.nan
    label = None if name is None else f"{name} (band)"
    axis.fill_between(
        edges, np.append(least, least[-1]), np.append(most, most[-1]), step="post", color=style.get("color"),
        alpha=0.35, lw=0.5, label=label, zorder=style.get("zorder", 2),
    )  # fmt: skip


def zero_line(axis: Axes, always: bool = False) -> None:
    """Draw a line at zero, where the panel shows zero, or always; values above and below have different signs."""
    low, high = sorted(axis.get_ylim())
    if always or low <= 0.0 <= high:
        axis.axhline(0.0, color="black", lw=0.8, zorder=1)


def scale_forces(
    axis: Axes, values: Sequence[Array], largest: float, *, signed: bool, none: str = "no contact lasted"
) -> None:
    """Let the axis of forces have zero, or be logarithmic where peaks hide the rest.

    Args:
        largest: of all panels that are compared [N]: beside it rounding is to look like nothing.
        signed: whether forces may have a sign.
        none: what is written where there is no force.
    """
    force = np.concatenate([np.zeros(1), *values])
    size = np.abs(force)[np.abs(force) > _LEAST * largest]
    if not largest:
        write_in_middle(axis, none)
        return
    peaks = len(size) > 0 and float(size.max()) > _PEAK * float(np.median(size))
    if peaks and signed:
        axis.set_yscale("symlog", linthresh=10.0 ** np.floor(np.log10(np.median(size))))
    elif peaks:
        axis.set_yscale("log")
        axis.set_ylim(_LEAST * largest, 2.0 * largest)
    else:
        axis.set_ylim(float(force.min()) - 0.05 * largest * signed, float(force.max()) + 0.05 * largest)


def write_in_middle(axis: Axes, text: str) -> None:
    """Write what is to be said instead of curves."""
    axis.text(0.5, 0.5, text, transform=axis.transAxes, ha="center", va="center", color="0.5")


def largest_force(forces: Sequence[Array]) -> float:
    """Return the largest amount, 0 without any."""
    return max((float(np.abs(force).max(initial=0.0)) for force in forces), default=0.0)


def draw_curves(axis: Axes, t: Array, curves: Sequence[tuple[str, Array]], title: str = "") -> None:
    """Draw several curves with a legend, or a scale of colours with their names where they are many."""
    if len(curves) <= MOST_NAMED:
        for k, (name, y) in enumerate(curves):
            draw_curve(axis, t, y, name, color=FIRST_COLORS[k % len(FIRST_COLORS)], lw=1.1)
        legend(axis, title)
        return
    shades = colormaps["turbo"](np.linspace(0.03, 0.97, len(curves)))
    for (_, y), color in zip(curves, shades, strict=True):
        draw_curve(axis, t, y, None, color=color, lw=0.9)
    _draw_scale(axis, [name for name, _ in curves], shades)


def _draw_scale(axis: Axes, names: Sequence[str], shades: Array) -> None:
    box = axis.get_position()
    scale = axis.figure.add_axes((box.x1 + 0.012, box.y0, 0.012, box.height))
    norm = BoundaryNorm(np.arange(len(names) + 1), len(names))
    scale.imshow(
        np.arange(len(names))[:, None] + 0.5, aspect="auto", cmap=ListedColormap(shades), norm=norm, origin="upper",
        interpolation="nearest",
    )  # fmt: skip
    shown = range(0, len(names), -(-len(names) // _MOST_TICKS))
    scale.set_yticks(shown, [shorten(names[k]) for k in shown], fontsize=_SMALL - 1)
    scale.yaxis.tick_right()
    scale.set_xticks([])


def legend(axis: Axes, title: str = "") -> None:
    """Put the names of the curves at the right of a panel."""
    handles, names = axis.get_legend_handles_labels()
    if not handles:
        return
    axis.legend(
        handles, [_folded(name) for name in names], loc="upper left", bbox_to_anchor=(1.01, 1.02),
        borderaxespad=0.0, fontsize=_SMALL, frameon=False, title=title or None, title_fontsize=_SMALL,
        alignment="left", handlelength=1.6, markerscale=4.0,
    )  # fmt: skip


def _folded(name: str) -> str:
    """Return a name in lines that fit: of a long pair the second one begins a line."""
    lines = name.split("\n")
    if len(name) > _LONGEST and len(lines) == 1:
        first, mark, second = name.partition(" | ")
        lines = [first + " |", second] if mark else [name]
    return "\n".join(shorten(line) for line in lines)


def shorten(name: str, most: int = _LONGEST) -> str:
    """Return a name with its middle left out where it is long."""
    return name if len(name) <= most else f"{name[: most // 2 - 1]}…{name[-(most - most // 2) :]}"
