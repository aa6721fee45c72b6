"""Where the bodies are at the nodes of a run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.elements.element import WORLD
from contactvi.importing.kinematics import JointChains
from contactvi.playback.animation import near_turns
from contactvi.scene.build import Built

Array = NDArray[np.float64]


class Poses(NamedTuple):
    """Poses of a body: t (n,) [s], position (n, 3) of its frame's origin [m] and quaternion (n, 4), x y z w, in the
    world. q and -q are one rotation; the sign is that of the nearer one to the row before."""

    t: Array
    position: Array
    quaternion: Array


def moving_bodies(model: pin.Model) -> list[str]:
    """Return the names of the bodies that hang on some joint, in the order of the model."""
    frames = (frame for frame in model.frames if frame.type == pin.FrameType.BODY and frame.parentJoint)
    return list(dict.fromkeys(str(frame.name) for frame in frames))


def body_poses(model: pin.Model, q: Array, bodies: Sequence[str]) -> tuple[Array, Array]:
    """Return positions (n, len(bodies), 3) [m] and quaternions (n, len(bodies), 4) at configurations q (n, nq)."""
    frames = [model.frames[_frame(model, name)] for name in bodies]
    carrying = JointChains(model, [int(frame.parentJoint) for frame in frames])
    position, quaternion = np.zeros((len(q), len(bodies), 3)), np.zeros((len(q), len(bodies), 4))
    for row, values in enumerate(q):
        for k, (place, frame) in enumerate(zip(carrying.places(values), frames, strict=True)):
            pose = place * frame.placement
            position[row, k] = pose.translation
            quaternion[row, k] = pin.Quaternion(pose.rotation).coeffs()
    for k in range(len(bodies)):
        quaternion[:, k] = near_turns(quaternion[:, k])
    return position, quaternion


def point_jacobians(built: Built, q: Array, body: str, point: Array) -> Array:
    """Return the Jacobians (n, 3, nv) of the velocity of a point (3,) [m] of a body, given in the body's frame.

    World axes; at configurations q (n, nq).
    """
    frame = built.model.frames[_frame(built.model, body)]
    joint, rows = np.array([frame.parentJoint], dtype=np.int64), np.zeros((len(q), 3, built.model.nv))
    in_joint = pin.skew(frame.placement.act(point))
    for row, values in zip(rows, q, strict=True):
        (rotation,), _, (J,) = map(np.asarray, built.engine.model.jacobians(joint, values))
        row[:] = rotation @ (J[:3] - in_joint @ J[3:])
    return rows


def _frame(model: pin.Model, name: str) -> int:
    """Return the frame of a body; a geometry may hang on a frame of another type, which then counts as one."""
    if name == WORLD:
        return 0
    found = [k for k, frame in enumerate(model.frames) if frame.name == name]
    return next((k for k in found if model.frames[k].type == pin.FrameType.BODY), found[0])
