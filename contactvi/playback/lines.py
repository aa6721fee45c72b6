"""Springs and strings in a playback: where the pieces of their lines are, frame by frame. Knows nothing of meshcat.

A line goes through points that joints carry (a Visual of shape "line"). A piece is what lies between two of them: a
cylinder along z of length 1, turned and scaled in every frame. World frame, metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactvi.playback.animation import Poses, near_turns
from contactvi.playback.visuals import Visual

Array = NDArray[np.float64]
_LEAST = 1e-9  # [m] a piece has at least this length: nothing is scaled by 0


@dataclass(frozen=True)
class Piece:
    """Start [m] (F, 3), quaternion x y z w (F, 4) that turns z along it, length [m] (F,); F = 1: it does not move."""

    start: Array
    quaternion: Array
    length: Array

    @property
    def moves(self) -> bool:
        """True when there is more than one frame."""
        return len(self.length) > 1


def pieces_of(visual: Visual, poses: Mapping[int, Poses]) -> list[Piece]:
    """Return the pieces of a line, from its first point to its last."""
    points = path_of(visual, poses)
    pieces = []
    for a, b in zip(points[:-1], points[1:], strict=True):
        count = max(len(a), len(b))
        start, along = np.broadcast_to(a, (count, 3)), np.broadcast_to(b - a, (count, 3))
        length = np.maximum(np.linalg.norm(along, axis=1), _LEAST)
        pieces.append(Piece(start, near_turns(turns(along / length[:, None])), length))
    return pieces


def path_of(visual: Visual, poses: Mapping[int, Poses]) -> list[Array]:
    """Return the points of a line in the world, (F, 3) each; F = 1 for one that stands still."""
    joints = (poses[int(joint)] for joint in visual.sizes)
    points = visual.vertices.astype(float)
    return [pose.position + rotate(pose.quaternion, point) for pose, point in zip(joints, points, strict=True)]


def turns(directions: Array) -> Array:
    """Return the least turns of the z axis into unit vectors (F, 3), quaternions x y z w (F, 4); (1 0 0 0) for -z."""
    x, y, z = directions.T
    across = x * x + y * y
    w = np.where(z < 0.0, across / (1.0 - np.minimum(z, 0.0)), 1.0 + z)  # 1 + z without cancellation
    found = np.column_stack([-y, x, np.zeros(len(x)), w])
    size = np.linalg.norm(found, axis=1, keepdims=True)
    return np.where(size > 0.0, found / np.where(size > 0.0, size, 1.0), [1.0, 0.0, 0.0, 0.0])


def rotate(quaternion: Array, vector: Array) -> Array:
    """Rotate one vector by quaternions x y z w, shape (F, 4) -> (F, 3)."""
    axis, w = quaternion[:, :3], quaternion[:, 3:]
    twice = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + w * twice + np.cross(axis, twice))
