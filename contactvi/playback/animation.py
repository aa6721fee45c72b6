"""The frames of a playback as plain arrays: when, where every body is, which impacts show.

Knows nothing of meshcat. Times in seconds from the start of the run, positions in metres, world frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from contactvi.playback.visuals import Visual
from contactvi.records.contacts import ContactLog
from contactvi.records.events import EventLog
from contactvi.scene.scene import Scene

Array = NDArray[np.float64]

MAX_FRAMES = 6000
MAX_POSES = 130_000  # frames x (moving bodies and pieces of lines), 32 bytes each: about 4 MB of the page
MAX_IMPACTS = 3000  # shown of a run, about 0.3 MB of the page
MAX_MARKERS = 24  # impacts shown at the same time
_MARKER_TIME = 0.25  # [s] for which an impact is visible
_STILL = 1e-7  # [m], and for the entries of a quaternion [1]


class Run(Protocol):
    """The part of a run that is played; contactvi.Trajectory has it."""

    t: Array
    events: EventLog
    contacts: ContactLog

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


@dataclass
class Marker:
    """A contact marker that is used for one impact after the other.

    Attributes:
        start, end: times between which it shows [s], shape (k,).
        point: (k, 3).
        direction: unit vector of the impulse that is drawn (k, 3).
        impulse: [N s], shape (k,).
    """

    start: list[float] = field(default_factory=list)
    end: list[float] = field(default_factory=list)
    point: list[Array] = field(default_factory=list)
    direction: list[Array] = field(default_factory=list)
    impulse: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Frames:
    """Times (F,) [s] from the start of the run, poses per joint index, and the markers of the impacts."""

    times: Array
    poses: dict[int, Poses]
    markers: list[Marker]


def frames_of(run: Run, fps: float) -> Frames:
    """Return the frames of a run, at most `fps` per second of simulated time plus one at each impact.

    Long runs get fewer: at most MAX_FRAMES, and MAX_POSES poses in all.
    """
    joints = sorted({joint for visual in run.visuals for joint in visual.joints})
    pieces = sum(len(visual.vertices) - 1 for visual in run.visuals if visual.shape == "line")
    times = frame_times(run, fps, max(1, len(joints) + pieces))
    poses = joint_poses(run.scene.model, run.resample(times), joints)
    return Frames(times - run.t[0], poses, markers_of(run))


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
        # Frames of the grid too close to an impact are dropped: three.js keeps times as float32.
        nearest = np.abs(impacts[np.clip(np.searchsorted(impacts, grid), 0, len(impacts) - 1)] - grid)
        before = np.abs(impacts[np.clip(np.searchsorted(impacts, grid) - 1, 0, len(impacts) - 1)] - grid)
        close = np.minimum(nearest, before) < 0.05 * (grid[1] - grid[0])
        close[[0, -1]] = False
        grid = grid[~close]
    times = np.union1d(grid, impacts)
    apart = np.concatenate([[True], np.diff(times.astype(np.float32)) > 0])
    return np.asarray(times[apart], dtype=float)


def joint_poses(model: pin.Model, configurations: Array, joints: Sequence[int]) -> dict[int, Poses]:
    """Return the poses of these joint frames for every configuration; a joint that stands still has one pose."""
    data = model.createData()
    position = np.zeros((len(joints), len(configurations), 3))
    quaternion = np.zeros((len(joints), len(configurations), 4))
    for row, q in enumerate(configurations):
        pin.forwardKinematics(model, data, q)
        for k, joint in enumerate(joints):
            pose = data.oMi[joint]
            position[k, row] = pose.translation
            quaternion[k, row] = pin.Quaternion(pose.rotation).coeffs()
    poses = {}
    for k, joint in enumerate(joints):
        quaternion[k] = near_turns(quaternion[k])
        still = max(np.ptp(position[k], axis=0).max(), np.ptp(quaternion[k], axis=0).max()) < _STILL
        rows = slice(0, 1) if still else slice(None)
        poses[joint] = Poses(position[k, rows], quaternion[k, rows])
    return poses


def near_turns(quaternion: Array) -> Array:
    """Return quaternions (F, 4) with the signs that make each one near its predecessor: q and -q are one rotation."""
    flip = np.cumprod(np.where(np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0, -1.0, 1.0))
    return np.concatenate([quaternion[:1], quaternion[1:] * flip[:, None]])


def markers_of(run: Run) -> list[Marker]:
    """Distribute the shown contacts over as few markers as show them all, at most MAX_MARKERS at a time."""
    start, span = float(run.t[0]), float(run.t[-1] - run.t[0])
    shown_for = min(_MARKER_TIME, max(span / 12.0, 1e-6))
    events = run.events
    points, normals = events.array("point"), events.array("normal")
    drawn = (events.array("kind") == 0) & np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1)
    markers: list[Marker] = []
    shown = shown_impacts(run)
    for k in shown[drawn[shown]]:
        time = float(events.array("time")[k]) - start
        free = next((marker for marker in markers if marker.end[-1] <= time), None)
        if free is None and len(markers) < MAX_MARKERS:
            free = Marker()
            markers.append(free)
        if free is None:  # all are in use: the oldest one is taken
            free = min(markers, key=lambda marker: marker.start[-1])
            free.end[-1] = time
        free.start.append(time)
        free.end.append(time + shown_for)
        free.point.append(points[k])
        free.direction.append(normals[k] * drawn_side(run.scene, int(events.array("index")[k])))
        free.impulse.append(float(events.array("impulse")[k]))
    return markers


def shown_impacts(run: Run) -> NDArray[np.int64]:
    """Return the indices of the events that are shown: all of them, or MAX_IMPACTS spread over the run."""
    count = len(run.events)
    return np.unique(np.linspace(0, count - 1, min(count, MAX_IMPACTS)).astype(np.int64))


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
