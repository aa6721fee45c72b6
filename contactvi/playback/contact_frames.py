"""Contact points in a playback: where they are at every frame, what they do and with which force.

A frame has the contacts of the step around it, one row per point. The log has where a point is at the end of a step;
within it the point moves there from where it was at the end of the step before. `next` names the same point of a pair
in the next frame, so that between frames it moves; other points stay until the next frame. World frame, run time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactvi.playback.animation import Array, Run, drawn_side, joint_poses
from contactvi.playback.lines import rotate
from contactvi.records.codes import ContactMode, GuardKind
from contactvi.records.contacts import ContactLog

Indices = NDArray[np.int64]

MAX_ROWS = 60_000  # points x frames, about 45 bytes each: 2.7 MB of the page
ROLL = 4  # a mode of the picture: a point that sticks and travels over both bodies; the others are ContactMode
_FULL = 0.98  # share of the forces up to the full force: peaks at touch-down do not set the scale
_ROLLING = 0.01  # of the size of the bodies per second: slower travel is not seen, and differences of poses are noise


@dataclass(frozen=True)
class ContactFrames:
    """The contact points of a run, frame by frame.

    Attributes:
        times: of the frames [s], (F,).
        first: rows first[k] to first[k + 1] are those of frame k, (F + 1,).
        point: [m], (n, 3).
        force: [N] on the body that can move more freely, friction included, mean of the step, (n, 3).
        mode: number of a ContactMode, or ROLL, (n,).
        pair: index of the pair, (n,).
        next: row of the same point in the next frame, -1 where it has none, (n,).
        full: force that has an arrow of full length [N], > 0.
    """

    times: Array
    first: Indices
    point: Array
    force: Array
    mode: Indices
    pair: Indices
    next: Indices
    full: float


def contact_frames(run: Run, times: Array, size: float) -> ContactFrames | None:
    """Return the contact points at the frames of a run; None without persistent contact.

    Args:
        times: of the frames (F,) [s], run time.
        size: of the bodies [m], the scale of what counts as rolling.
    """
    log = run.contacts
    drawn = (log.array("kind") == GuardKind.CONTACT) & (log.h > 0.0) & np.isfinite(log.position).all(axis=1)
    if not drawn.any() or len(times) < 2:
        return None
    rows = np.flatnonzero(drawn)
    key = _keys(log, rows)
    source, known = _with_force(log, rows, key)
    rows, key, source = rows[known], key[known], source[known]
    first, count = _frames_of_rows(log, rows, times)
    every = max(1, int(np.ceil(count.sum() / MAX_ROWS)))
    if every > 1:
        times = np.unique(np.append(times[::every], times[-1]))
        first, count = _frames_of_rows(log, rows, times)
    frame = np.repeat(first, count) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    order = np.lexsort((np.repeat(key, count), frame))
    frame, which = frame[order], np.repeat(np.arange(len(rows)), count)[order]
    if not len(frame):
        return None
    following = _followers(frame, key[which])
    pair = log.array("index")[rows[which]]
    force = log.force[source[which]]
    strength = np.linalg.norm(force, axis=1)
    sides = {int(k): drawn_side(run.scene, int(k)) for k in np.unique(pair)}
    mode = log.array("mode")[rows[which]].astype(np.int64)
    mode[_rolls(run, rows[which], following, size) & (mode == ContactMode.STICK)] = ROLL
    return ContactFrames(
        times=times,
        first=np.searchsorted(frame, np.arange(len(times) + 1)),
        point=_points(log, rows, key, which, times[frame]),
        force=np.array([sides[int(k)] for k in pair])[:, None] * force,
        mode=mode,
        pair=pair,
        next=following,
        full=max(float(np.quantile(strength[strength > 0.0], _FULL)) if np.any(strength > 0.0) else 1.0, 1e-30),
    )


def _keys(log: ContactLog, rows: Indices) -> Indices:
    """Number the contact points: one number for each point of each pair."""
    points = np.column_stack([log.array("index")[rows], log.array("point")[rows]])
    return np.unique(points, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _points(log: ContactLog, rows: Indices, key: Indices, which: Indices, times: Array) -> Array:
    """Return where the points are at times [s] within their steps, (n, 3); which (n,) are places in rows and key.

    In the first step of a contact a point moves as in the second one, where there is one.
    """
    order = np.lexsort((log.t[rows], key))
    mine, t, end, last = key[order], log.t[rows][order], log.end[rows][order], log.position[rows][order]
    slack = 1e-9 * max(1.0, float(np.abs(end).max()))
    goes_on = np.flatnonzero((mine[1:] == mine[:-1]) & (t[1:] <= end[:-1] + slack)) + 1
    sorted_start = last.copy()
    rate = (last[goes_on] - last[goes_on - 1]) / (end - t)[goes_on, None]
    sorted_start[goes_on - 1] = last[goes_on - 1] - rate * (end - t)[goes_on - 1, None]
    sorted_start[goes_on] = last[goes_on - 1]  # after the line before: those that go on begin where they were
    start = np.empty_like(sorted_start)
    start[order] = sorted_start
    share = np.clip((times - log.t[rows[which]]) / log.h[rows[which]], 0.0, 1.0)[:, None]
    return np.asarray((1.0 - share) * start[which] + share * log.position[rows[which]])


def _with_force(log: ContactLog, rows: Indices, key: Indices) -> tuple[Indices, NDArray[np.bool_]]:
    """Return for each row the row whose force it shows, and whether there is one.

    A part of a step that is too brief for a force of its own (ContactLog.has_force) has that of the step before it, or
    after it, in the same uninterrupted contact: otherwise an arrow would go out for a frame.
    """
    order = np.lexsort((log.t[rows], key))
    mine, t, end = key[order], log.t[rows][order], log.end[rows][order]
    slack = 1e-9 * max(1.0, float(np.abs(end).max()))
    begins = np.concatenate([[True], (mine[1:] != mine[:-1]) | (t[1:] > end[:-1] + slack)])
    span = np.cumsum(begins)
    good, places = log.has_force[rows][order], np.arange(len(order))
    before = np.maximum.accumulate(np.where(good, places, -1))
    after = np.minimum.accumulate(np.where(good, places, len(order))[::-1])[::-1]
    found = np.where((before >= 0) & (span[before] == span), before, after)
    known = found < len(order)
    known[known] = span[found[known]] == span[known]
    source, has = np.zeros(len(rows), np.int64), np.zeros(len(rows), bool)
    source[order[known]], has[order[known]] = rows[order[found[known]]], True
    return source, has


def _frames_of_rows(log: ContactLog, rows: Indices, times: Array) -> tuple[Indices, Indices]:
    """Return the first frame at which each row acts, and at how many frames."""
    slack = 1e-12 * max(1.0, abs(float(times[-1])))  # t + h and the start of the next step differ by rounding
    first = np.searchsorted(times, log.t[rows] - slack)
    after = np.searchsorted(times, log.end[rows] - slack)
    after[log.end[rows] >= times[-1] - 1e-9 * max(1.0, abs(float(times[-1])))] = len(times)  # end of the last step
    return first, np.maximum(after - first, 0)


def _followers(frame: Indices, key: Indices) -> Indices:
    """Return the row of the same point in the next frame, -1 where it has none; rows are sorted by frame and key."""
    number = frame * (int(key.max()) + 1) + key
    wanted = number + int(key.max()) + 1
    at = np.minimum(np.searchsorted(number, wanted), len(number) - 1)
    return np.where(number[at] == wanted, at, -1)


def _rolls(run: Run, rows: Indices, following: Indices, size: float) -> NDArray[np.bool_]:
    """Return where a contact point travels over both bodies: seen from each, it moves from one frame to the next."""
    log, scene = run.contacts, run.scene
    solids, pairs = scene.collision_model.geometryObjects, scene.collision_model.collisionPairs
    here, there = np.flatnonzero(following >= 0), following[following >= 0]
    rolls = np.zeros(len(rows), bool)
    index = log.array("index")[rows]
    if not len(here) or index.max() >= len(pairs):
        return rolls
    ends, at = np.unique(log.end[rows], return_inverse=True)
    at = at.reshape(-1)
    carriers = np.array([[solids[p.first].parentJoint, solids[p.second].parentJoint] for p in pairs], dtype=np.int64)
    joints = np.unique(carriers[np.unique(index)])
    poses = joint_poses(scene.model, run.resample(np.clip(ends, run.t[0], run.t[-1])), joints.tolist())
    span = log.end[rows[there]] - log.end[rows[here]]
    slowest = np.full(len(here), np.inf)
    for side in (0, 1):
        carrier = carriers[index, side]
        local = np.zeros((len(rows), 3))
        for joint in np.unique(carrier):
            mine = np.flatnonzero(carrier == joint)
            position, quaternion = poses[int(joint)].position, poses[int(joint)].quaternion
            row = at[mine] if len(position) > 1 else np.zeros(len(mine), np.int64)
            turned_back = quaternion[row] * [-1.0, -1.0, -1.0, 1.0]
            local[mine] = rotate(turned_back, log.position[rows[mine]] - position[row])
        travel = np.linalg.norm(local[there] - local[here], axis=1)
        slowest = np.minimum(slowest, np.divide(travel, span, out=np.zeros(len(here)), where=span > 0.0))
    rolls[here] = slowest > _ROLLING * size
    last = following < 0  # a point that ends here does what it did in the frame before
    before = np.full(len(rows), -1)
    before[there] = here
    inherits = np.flatnonzero(last & (before >= 0))
    rolls[inherits] = rolls[before[inherits]]
    return rolls
