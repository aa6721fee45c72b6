"""What hides contact points: lines of sight through bodies, whose shapes stand for their boxes or ellipsoids.

A shape on which a point lies may hide it by a little, where the line grazes it, or by all of its thickness; any other
one that is in the way hides it.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.playback.animation import Frames
from contactvi.playback.visuals import Visual

Array = NDArray[np.float64]

_OWN = 1.05  # half sides from the middle of a shape within which a point counts as its own


def covered(visuals: list[Visual], frames: Frames, frame: int, points: Array, directions: Array) -> Array:
    """Return how much of their own shapes is between points (k, 3) and a camera far away [m], shape (directions, k).

    It is infinite where a shape is in the way on which the point does not lie.

    Args:
        frame: number of the frame that says where the shapes are.
        directions: unit vectors to the camera, (d, 3).
    """
    total = np.zeros((len(directions), len(points)))
    for visual in visuals:
        if visual.shape in ("halfspace", "line"):
            continue
        poses = frames.poses[visual.joint]
        row = frame if poses.moves else 0
        turn = pin.Quaternion(poses.quaternion[row]).matrix()
        low, high, margin = bounds(visual)
        half = np.maximum(0.5 * (high - low) + margin, 1e-9)
        rotation = turn @ visual.placement[:3, :3]
        middle = poses.position[row] + turn @ visual.placement[:3, 3] + rotation @ (0.5 * (low + high))
        # In units of the half sides, where the box is a cube and the ellipsoid a ball.
        start, way = (points - middle) @ rotation / half, directions @ rotation / half
        round_one = visual.shape in ("sphere", "ellipsoid")
        length = (_in_ball if round_one else _in_cube)(start[None], way[:, None])
        own = (np.linalg.norm(start, axis=1) if round_one else np.abs(start).max(axis=1)) <= _OWN
        total += np.where(own | (length <= 0.0), length, np.inf)
    return total


def _in_cube(start: Array, way: Array) -> Array:
    """Return for how long start + t way, t >= 0, is in the cube of half side 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.array([(-1.0 - start) / way, (1.0 - start) / way])
    ends = np.where(np.isnan(ends), 0.0, ends)  # along a face: it counts as outside
    enters, leaves = np.maximum(ends.min(axis=0).max(axis=-1), 0.0), ends.max(axis=0).min(axis=-1)
    return np.asarray(np.maximum(leaves - enters, 0.0))


def _in_ball(start: Array, way: Array) -> Array:
    """Return for how long start + t way, t >= 0, is in the ball of radius 1."""
    square, along = (way * way).sum(axis=-1), (start * way).sum(axis=-1)
    root = np.sqrt(np.maximum(along**2 - square * ((start * start).sum(axis=-1) - 1.0), 0.0))
    return np.asarray(np.maximum((root - along) / square, 0.0) - np.maximum((-root - along) / square, 0.0))


def bounds(visual: Visual) -> tuple[Array, Array, float]:
    """Return the corners of the box of a shape, in its own frame, and a margin around it [m]."""
    sizes = np.array(visual.sizes)
    if visual.shape == "mesh":
        return visual.vertices.min(axis=0).astype(float), visual.vertices.max(axis=0).astype(float), 0.0
    if visual.shape == "sphere":
        return np.zeros(3), np.zeros(3), float(sizes[0])
    if visual.shape == "capsule":
        end = np.array([0.0, 0.0, sizes[1]])
        return -end, end, float(sizes[0])
    half = sizes[[0, 0, 1]] if visual.shape in ("cylinder", "cone") else sizes
    return -half, half, 0.0
