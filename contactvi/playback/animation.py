"""The frames of a playback as plain arrays: when, and where every body is.

Times in seconds from the start of the run, positions in metres, world frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from contactvi.importing.kinematics import JointChains
from contactvi.playback.visuals import Visual
from contactvi.records.contacts import ChangeLog, ContactLog
from contactvi.records.events import EventLog
from contactvi.scene.scene import Scene

Array = NDArray[np.float64]

MAX_FRAMES = 6000
MAX_POSES = 130_000  # frames x moving bodies, 37 bytes each: about 5 MB of the page
_STILL = 1e-7  # [m], and for the entries of a quaternion [1]


class Run(Protocol):
    """The part of a run that is played; contactvi.Trajectory has it."""

    t: Array
    events: EventLog
    contacts: ContactLog
    contact_changes: ChangeLog

    @property
    def scene(self) -> Scene: ...

    @property
    def visuals(self) -> list[Visual]: ...

    def resample(self, times: ArrayLike) -> Array: ...


@dataclass(frozen=True)
class Poses:
    """Position [m] (F, 3) and quaternion x y z w (F, 4) of a joint frame; F = 1 for one that does not move."""

    position: Array
    quaternion: Array

    @property
    def moves(self) -> bool:
        """True when there is more than one pose."""
        return len(self.position) > 1


@dataclass(frozen=True)
class Frames:
    """Times (F,) [s] from the start of the run, and poses per joint index."""

    times: Array
    poses: dict[int, Poses]


def frames_of(run: Run, fps: float) -> Frames:
    """Return the frames of a run, at most `fps` per second of simulated time plus one at each impact.

    Long runs get fewer: at most MAX_FRAMES, and MAX_POSES poses in all.
    """
    joints = sorted({joint for visual in run.visuals for joint in visual.joints})
    times = frame_times(run, fps, max(1, len(joints)))
    poses = joint_poses(run.scene.model, run.resample(times), joints)
    return Frames(times - run.t[0], poses)


def frame_times(run: Run, fps: float, bodies: int) -> Array:
    """Return the times of the frames [s], run time, increasing; start, end and impacts are met exactly."""
    start, end = float(run.t[0]), float(run.t[-1])
    if end <= start:
        return np.array([start])
    most = max(2, min(MAX_FRAMES, MAX_POSES // bodies))
    impacts = np.unique(run.events.array("time"))
    impacts = impacts[(impacts > start) & (impacts < end)]
    if len(impacts) > most // 2:
        impacts = impacts[np.linspace(0, len(impacts) - 1, most // 2).astype(int)]
    count = max(2, min(most - len(impacts), int(np.ceil((end - start) * fps)) + 1))
    grid = np.linspace(start, end, count)
    if len(impacts):
        # Frames of the grid very close to an impact show the same and are dropped.
        nearest = np.abs(impacts[np.clip(np.searchsorted(impacts, grid), 0, len(impacts) - 1)] - grid)
        before = np.abs(impacts[np.clip(np.searchsorted(impacts, grid) - 1, 0, len(impacts) - 1)] - grid)
        close = np.minimum(nearest, before) < 0.05 * (grid[1] - grid[0])
        close[[0, -1]] = False
        grid = grid[~close]
    return np.asarray(np.union1d(grid, impacts), dtype=float)


def joint_poses(model: pin.Model, configurations: Array, joints: Sequence[int]) -> dict[int, Poses]:
    """Return the poses of these joint frames for every configuration; a joint that stands still has one pose."""
    position = np.zeros((len(joints), len(configurations), 3))
    quaternion = np.zeros((len(joints), len(configurations), 4))
    free = [k for k, joint in enumerate(joints) if is_free(model, joint)]
    for k in free:
        position[k], quaternion[k] = _free_poses(model, joints[k], np.asarray(configurations))
    linked = [(k, joint) for k, joint in enumerate(joints) if joint and k not in free]
    places = JointChains(model, [joint for _, joint in linked])
    rows = [k for k, _ in linked]
    for column, q in enumerate(configurations) if linked else ():
        found = places.poses(np.asarray(q))
        position[rows, column], quaternion[rows, column] = found[:, :3], found[:, 3:]
    if 0 in joints:
        quaternion[list(joints).index(0)] = [0.0, 0.0, 0.0, 1.0]
    poses = {}
    for k, joint in enumerate(joints):
        quaternion[k] = near_turns(quaternion[k])
        still = max(np.ptp(position[k], axis=0).max(), np.ptp(quaternion[k], axis=0).max()) < _STILL
        kept = slice(0, 1) if still else slice(None)
        poses[joint] = Poses(position[k, kept], quaternion[k, kept])
    return poses


def is_free(model: pin.Model, joint: int) -> bool:
    """Return whether a joint is that of a free body in the world."""
    return joint > 0 and model.parents[joint] == 0 and model.joints[joint].shortname() == "JointModelFreeFlyer"


def _free_poses(model: pin.Model, joint: int, configurations: Array) -> tuple[Array, Array]:
    """Return the poses of a free body, which its numbers in q are: heaps have many of them."""
    place, at = model.jointPlacements[joint], model.idx_qs[joint]
    base = pin.Quaternion(place.rotation).coeffs()
    own = configurations[:, at + 3 : at + 7]
    axis = base[3] * own[:, :3] + own[:, 3:] * base[:3] + np.cross(base[:3], own[:, :3])
    turn = np.column_stack([axis, base[3] * own[:, 3] - own[:, :3] @ base[:3]])
    return configurations[:, at : at + 3] @ place.rotation.T + place.translation, turn


def near_turns(quaternion: Array) -> Array:
    """Return quaternions (F, 4) with the signs that make each one near its predecessor: q and -q are one rotation."""
    flip = np.cumprod(np.where(np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0, -1.0, 1.0))
    return np.concatenate([quaternion[:1], quaternion[1:] * flip[:, None]])


def drawn_side(scene: Scene, pair: int) -> float:
    """Return +1 to draw impulse or force on the second shape of a pair, -1 for the first.

    A free body comes before a linked one, a linked one before the world, the second before the first.
    """
    solids, pairs = scene.collision_model.geometryObjects, scene.collision_model.collisionPairs
    if pair >= len(pairs):
        return 1.0
    first, second = solids[pairs[pair].first].parentJoint, solids[pairs[pair].second].parentJoint
    return -1.0 if _freedom(scene.model, first) > _freedom(scene.model, second) else 1.0


def _freedom(model: pin.Model, joint: int) -> int:
    if joint == 0:
        return -1
    return int(model.joints[joint].nv) if model.parents[joint] == 0 else 0
