"""What a picture has to show: the places of all shapes in the course of a run, and from where they are seen best.

Halfspaces do not count, they have no end; nor does what flies far away from where everything starts. What touches is
in the middle half of the picture: the outline is continued beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactvi.playback.animation import Frames, Poses
from contactvi.playback.lines import path_of, rotate
from contactvi.playback.open_side import open_side
from contactvi.playback.sight import bounds
from contactvi.playback.touches import Touches
from contactvi.playback.visuals import Visual

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_FITTED = 200  # frames that are looked at
_FAR = 2.0  # sizes of the start within which motion counts
_BEYOND = 1.0 / 3.0  # of the way from the contacts to a border that there is on their other side at least
_OUTLINE = 240  # directions whose outermost points are kept: a picture from any side is off by about a percent


@dataclass(frozen=True)
class View:
    """The frame of a picture.

    Attributes:
        center, radius: of the ball around the box of what moves [m].
        size: of the bodies [m], for arrows.
        direction: unit vector to the camera that sees most.
        outline: outermost points of all that is shown and of the room around the contacts [m], (k, 3).
        middle: mean of the contact points [m], (3,), which is in the middle half of the picture; None without any.
    """

    center: Array
    radius: float
    size: float
    direction: Array
    outline: Array
    middle: Array | None = None

    def around(self, points: Array) -> View:
        """Return the frame of a picture that shows these points (n, 3) [m], too."""
        return self if not len(points) else replace(
            self, outline=np.concatenate([self.outline, _with_room(points, self.middle)])
        )  # fmt: skip


def fit(
    visuals: list[Visual], frames: Frames, trees: Indices, moment: float | None = None, touches: Touches | None = None
) -> View:
    """Return the frame of the picture of a run; `trees` as of `trees_of`.

    Args:
        moment: time [s] from the start of the run that the picture shows alone; None: all of the run.
        touches: where the bodies touch; None: nothing is known of it.
    """
    solid = [visual for visual in visuals if visual.shape != "halfspace"]
    spots = [_Spot.of(visual, frames) for visual in solid] or [_Spot(np.zeros((1, 1, 3)), 1.0)]
    home, far = _home(spots)
    if touches is not None:
        touches = touches.near(home, far) if moment is None else touches.near(home, far).at(moment)
        touches = touches if len(touches) else None
    whole = frames
    if moment is not None:
        frames = _at(frames, moment)
        spots = [_Spot.of(visual, frames) for visual in solid] or spots
    near = [spot for spot in (spot.within(home, far) for spot in spots) if len(spot.points)] or spots
    low, high = _box(near)
    outline = _outline(near)
    center = 0.5 * (low + high)
    radius = max(0.5 * float(np.linalg.norm(high - low)), 1e-3)
    size = min(radius, 6.0 * max((spot.size for spot in spots if not spot.thin), default=radius))
    direction = open_side(visuals, whole if touches else frames, trees, high - low, center, radius, touches)
    middle = None if touches is None else touches.center()
    if middle is not None:
        outline = _with_room(outline, middle)
        low, high = outline.min(axis=0), outline.max(axis=0)
        center, radius = 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), radius)
    return View(center=center, radius=radius, size=size, direction=direction, outline=outline, middle=middle)


def _with_room(points: Array, middle: Array | None) -> Array:
    """Return points and others beyond the contacts: a picture of all of them has these in its middle half, from
    whatever side it is taken."""
    return points if middle is None else np.concatenate([points, (1.0 + _BEYOND) * middle - _BEYOND * points])


def _at(frames: Frames, moment: float) -> Frames:
    """Return the frame nearest to a time, twice, so that what moves is still told from what does not."""
    row = [int(np.argmin(np.abs(frames.times - moment)))] * 2
    return Frames(frames.times[row], {
        joint: Poses(poses.position[row], poses.quaternion[row]) if poses.moves else poses
        for joint, poses in frames.poses.items()
    })  # fmt: skip


def _outline(spots: list[_Spot]) -> Array:
    """Return the outermost points of all spots, one for each of many directions."""
    k = np.arange(_OUTLINE) + 0.5
    z, turn = 1.0 - 2.0 * k / _OUTLINE, np.pi * (1.0 + 5.0**0.5) * k
    across = np.sqrt(1.0 - z * z)
    directions = np.column_stack([across * np.cos(turn), across * np.sin(turn), z])
    best, points = np.full(_OUTLINE, -np.inf), np.zeros((_OUTLINE, 3))
    for spot in spots:
        flat = spot.points.reshape(-1, 3)
        reach = flat @ directions.T
        row = reach.argmax(axis=0)
        value = reach[row, np.arange(_OUTLINE)] + spot.margin
        better = value > best
        best[better] = value[better]
        points[better] = flat[row[better]] + spot.margin * directions[better]
    return np.unique(points, axis=0)


_FARTHEST = 1e15  # [m] from the origin; what is farther away is no picture, and its squares might overflow


class _Spot:
    """Where a shape is in the course of a run: points (F, k, 3) and a margin around them [m]."""

    def __init__(self, points: Array, margin: float, thin: bool = False) -> None:
        self.points, self.margin, self.thin = np.clip(points, -_FARTHEST, _FARTHEST), min(margin, _FARTHEST), thin

    @classmethod
    def of(cls, visual: Visual, frames: Frames) -> _Spot:
        """Return the spot of a shape: a sphere is a point with a margin, other shapes are the corners of their box.

        A line is given by its points; it is thin and does not count for the size of the bodies.
        """
        if visual.shape == "line":
            path = np.broadcast_arrays(*path_of(visual, frames.poses))
            rows = np.unique(np.linspace(0, len(path[0]) - 1, _FITTED).astype(int))
            return cls(np.stack([points[rows] for points in path], axis=1), 0.0, thin=True)
        poses = frames.poses[visual.joint]
        low, high, margin = bounds(visual)
        corners = np.array([(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        corners = np.unique(corners, axis=0) @ visual.placement[:3, :3].T + visual.placement[:3, 3]
        rows = np.unique(np.linspace(0, len(poses.position) - 1, _FITTED).astype(int))
        turned = np.stack([rotate(poses.quaternion[rows], corner) for corner in corners], axis=1)
        return cls(poses.position[rows, None] + turned, margin)

    @property
    def size(self) -> float:
        """Half the diagonal of the shape [m]."""
        return self.margin + 0.5 * float(np.linalg.norm(np.ptp(self.points[0], axis=0)))

    def within(self, home: Array, far: float) -> _Spot:
        """Return the part of the spot that is not further than `far` from `home`."""
        near = np.linalg.norm(self.points - home, axis=2).max(axis=1) <= far
        return _Spot(self.points[near], self.margin, self.thin)


def _home(spots: list[_Spot]) -> tuple[Array, float]:
    """Return where things start [m], and how far from there the picture may reach [m].

    A few times the size of that place, or as far as an ordinary body of the scene travels (a lone ball is followed).
    """
    low, high = _box([_Spot(spot.points[:1], spot.margin) for spot in spots])
    home, size = 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1e-3)
    paths = [float(np.linalg.norm(spot.points - home, axis=2).max()) for spot in spots if len(spot.points) > 1]
    ordinary = float(np.quantile(paths, 0.5, method="lower")) if paths else 0.0
    return home, max(_FAR * size, 1.01 * ordinary)


def _box(spots: list[_Spot]) -> tuple[Array, Array]:
    """Return the corners of the box around all spots."""
    low = np.min([spot.points.min(axis=(0, 1)) - spot.margin for spot in spots], axis=0)
    high = np.max([spot.points.max(axis=(0, 1)) + spot.margin for spot in spots], axis=0)
    return low, high
