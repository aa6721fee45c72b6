"""From which side a scene is seen best: never from behind a wall, across a flat scene, and where little hides the rest.

Points are scattered over all shapes at a few times of the run and looked at from candidate directions on a coarse grid:
the nearest point of a cell hides the others. The direction that sees most of what moves is taken; every tree of bodies
counts the same, a ball as much as the hand it lies in. Contact points count as much as all of this: each by its
impulse and by how little hides it. The times are then those at which the impulses are passed on.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.playback.animation import Frames
from contactvi.playback.sight import covered
from contactvi.playback.touches import Touches
from contactvi.playback.visuals import Visual

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_USUAL = np.array([1.0, -0.75, 0.6]) / np.linalg.norm([1.0, -0.75, 0.6])
_PREFERENCE = 0.05  # share of what moves that the usual direction may see less than the opposite one
_POINTS = 300  # on each shape
_CELLS = 40  # across the picture: a shape's points are denser than that
_MOMENTS = (0.2, 0.5, 1.0)  # of the run
_SHARES = (0.2, 0.5, 0.8)  # of the whole impulse, where there are contacts
_HIDING = 0.1  # radii of the picture of its own bodies in front of a contact point that leave 1/e of it


def open_side(
    visuals: list[Visual],
    frames: Frames,
    trees: Indices,
    extent: Array,
    center: Array,
    radius: float,
    touches: Touches | None = None,
) -> Array:
    """Return the unit vector from the scene to the camera.

    Args:
        trees: the tree that each joint belongs to, (njoints,).
        extent: sides [m] of the box of all motion, (3,).
        center, radius: of the picture [m].
        touches: where bodies touch, at times of `frames`.
    """
    choices = _choices(extent)
    normals = [v.placement[:3, :3] @ np.array(v.sizes[:3]) for v in visuals if v.shape == "halfspace"]
    for normal in normals:
        choices = choices[choices @ normal > 0.05] if np.any(choices @ normal > 0.05) else choices
    surfaces = [
        (v.joint, _surface(v) @ v.placement[:3, :3].T + v.placement[:3, 3])
        for v in visuals if v.shape not in ("halfspace", "line")
    ]  # fmt: skip
    span = float(frames.times[-1])
    moments = [share * span for share in _MOMENTS] if touches is None else touches.moments(_SHARES)
    score = _PREFERENCE * choices @ _USUAL
    for moment in moments:
        cloud = _scattered(surfaces, frames, moment, center, radius)
        if cloud is not None:
            score += [_seen(direction, trees, *cloud) / len(moments) for direction in choices]
        if touches is not None and len(now := touches.at(moment)):
            frame = int(np.argmin(np.abs(frames.times - moment)))
            in_sight = np.exp(-covered(visuals, frames, frame, now.point, choices) / (_HIDING * radius))
            score += in_sight @ now.weight / (now.weight.sum() * len(moments))
    return np.asarray(choices[np.argmax(score)])


def _choices(extent: Array) -> Array:
    """Return candidate directions (k, 3): all around, or across a flat scene."""
    x, y = float(extent[0]), float(extent[1])
    if max(x, y) > 2.0 * min(x, y):
        a, b = np.meshgrid([-0.25, 0.25], [-1.0, 1.0])
        flat = np.column_stack([a.ravel(), b.ravel(), np.full(4, 0.22)])
        found = flat if x > y else flat[:, [1, 0, 2]]
    else:
        turn = np.radians(np.arange(12) * 30.0 + 15.0)
        found = np.concatenate([
            np.column_stack([np.cos(turn), np.sin(turn), np.full(12, rise)]) for rise in (0.42, 0.75)
        ])  # fmt: skip
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def _scattered(
    surfaces: list[tuple[int, Array]], frames: Frames, moment: float, center: Array, radius: float
) -> tuple[Array, Indices, Indices] | None:
    """Return points (n, 3) in units of the picture, their joints (n,), and which joints move; None where none does.

    Args:
        surfaces: joints, and points in their frames (k, 3) [m].
        moment: time [s], of which the nearest frame is taken.
    """
    points, joints, frame = [], [], int(np.argmin(np.abs(frames.times - moment)))
    for joint, local in surfaces:
        poses = frames.poses[joint]
        row = frame if poses.moves else 0
        turn = pin.Quaternion(poses.quaternion[row]).matrix()
        points.append((local @ turn.T + poses.position[row] - center) / radius)
        joints.append(np.full(len(local), joint))
    moving = np.array([joint for joint, poses in frames.poses.items() if joint and poses.moves], dtype=np.int64)
    if not points or not len(moving):
        return None
    joined, owner = np.concatenate(points), np.concatenate(joints)
    near = np.abs(joined).max(axis=1) <= 1.5
    return (joined[near], owner[near], moving) if np.isin(owner[near], moving).any() else None


def _seen(direction: Array, trees: Indices, points: Array, joints: Indices, moving: Indices) -> float:
    """Return the share of the moving bodies that is not hidden along a direction: the mean of the trees' means."""
    cell = _cells(direction, points)
    owner = np.full(_CELLS * _CELLS, -1)
    order = np.argsort(points @ direction, kind="stable")
    owner[cell[order]] = joints[order]  # the nearest one is written last
    most = int(joints.max()) + 1
    covered = np.zeros((most, _CELLS * _CELLS), bool)  # by each joint, were it alone
    covered[joints, cell] = True
    alone = covered.sum(axis=1)
    visible = np.bincount(owner[owner >= 0], minlength=most)
    visible = np.append(visible, np.zeros(max(0, most - len(visible))))
    present = moving[moving < most]
    present = present[alone[present] > 0]
    share = visible[present] / alone[present]
    return float(np.mean([share[trees[present] == tree].mean() for tree in np.unique(trees[present])]))


def _cells(direction: Array, points: Array) -> Indices:
    """Return the cell of the grid across a direction in which each point is, (n,)."""
    side = np.cross([0.0, 0.0, 1.0], direction)
    side /= np.linalg.norm(side)
    up = np.cross(direction, side)
    column, row = (
        np.clip(((points @ axis + 1.5) / 3.0 * _CELLS).astype(np.int64), 0, _CELLS - 1) for axis in (side, up)
    )
    return np.asarray(row * _CELLS + column)


def _surface(visual: Visual) -> Array:
    """Return points on a shape, in its own frame; the same ones each time."""
    random = np.random.default_rng(0)
    sizes = np.array(visual.sizes)
    if visual.shape == "mesh":
        corners = visual.vertices.astype(float)[visual.faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        chosen = corners[random.choice(len(corners), _POINTS, p=area / area.sum())] if area.sum() > 0 else corners
        weights = random.dirichlet(np.ones(3), len(chosen))
        return np.asarray(np.einsum("nk,nkx->nx", weights, chosen))
    directions = random.normal(size=(_POINTS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    if visual.shape in ("sphere", "ellipsoid"):
        return np.asarray(sizes * directions)
    half = sizes if visual.shape == "box" else sizes[[0, 0, 1]]
    if visual.shape == "capsule":
        half = half + [0.0, 0.0, sizes[0]]
    return np.asarray(half * directions / np.abs(directions).max(axis=1, keepdims=True))


def trees_of(model: pin.Model) -> Indices:
    """Return the child of the world above each joint, (njoints,)."""
    trees = np.zeros(model.njoints, np.int64)
    for joint in range(1, model.njoints):
        trees[joint] = trees[model.parents[joint]] or joint
    return trees
