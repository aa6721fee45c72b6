"""Springs and strings in a playback: where the points of their lines are, frame by frame.

A line goes through points that joints carry (a Visual of shape "line"). World frame, metres.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from contactvi.playback.animation import Poses
from contactvi.playback.visuals import Visual

Array = NDArray[np.float64]


def path_of(visual: Visual, poses: Mapping[int, Poses]) -> list[Array]:
    """Return the points of a line in the world, (F, 3) each; F = 1 for one that stands still."""
    joints = (poses[int(joint)] for joint in visual.sizes)
    points = visual.vertices.astype(float)
    return [pose.position + rotate(pose.quaternion, point) for pose, point in zip(joints, points, strict=True)]


def rotate(quaternion: Array, vector: Array) -> Array:
    """Rotate one vector, or one for each, by quaternions x y z w, shape (F, 4) -> (F, 3)."""
    axis, w = quaternion[:, :3], quaternion[:, 3:]
    twice = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + w * twice + np.cross(axis, twice))
