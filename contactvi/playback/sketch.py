"""Pictures of a scene at a configuration, drawn by NumPy alone: no browser, no window, no graphics card.

They are for loops that need many of them, as environments of Gymnasium do. Forces and labels are not drawn; pictures
for papers are those of `contactvi.playback.render`.

Triangles are drawn into a depth buffer (Catmull 1974) at twice the size, with normals shaded at their corners (Gouraud
1971), and the picture is scaled down. A halfspace is a plane with a grid that every ray of the picture meets once.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.playback.animation import Frames, Poses
from contactvi.playback.framing import View, fit
from contactvi.playback.lathe import outline_mesh
from contactvi.playback.lines import rotate
from contactvi.playback.live_frames import BodyPoses
from contactvi.playback.open_side import trees_of
from contactvi.playback.picture_size import picture_size
from contactvi.playback.scene_visuals import from_scene
from contactvi.playback.shapes import color_of, creased
from contactvi.playback.touches import Touches
from contactvi.playback.visuals import Visual, thin_out
from contactvi.scene.camera import Camera, camera_of
from contactvi.scene.scene import Scene

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Picture = NDArray[np.uint8]

MAX_TRIANGLES = 12_000  # of all meshes: a picture then takes tens of milliseconds
_SAMPLES = 2  # along each side of a pixel
_HALF_ANGLE = np.radians(15.0)  # of the shorter side of the picture; the page has 30 degrees, too
_MARGIN = 1.12  # between what is shown and the border
_LIGHT = np.array([0.35, -0.45, 0.82])  # direction to it in the world
_AMBIENT = 0.45
_SKY = np.array([238.0, 241.0, 245.0])
_TILES = 8.0  # of a halfspace, across what is shown
_AT_ONCE = 4_000_000  # rows of triangles, or pixels, that are looked at together
_ROUNDING = 1e-9  # [pixels] so that the pixels on an edge belong to both of its triangles, and to none never
_PRESETS = {"front": (1.0, 0.0, 0.0), "side": (0.0, -1.0, 0.0), "top": (0.0, -1e-3, 1.0)}


class Sketch:
    """Draws a scene. The camera stays where the start, and what will touch, was seen best, or follows a body.

    Args:
        scene: what is drawn. q: the configuration to which the picture is fitted, shape (nq,).
        size: width and height [pixels].
        camera: as of `Trajectory.to_html`; None: the scene's, else "auto".

    Raises:
        InputError: for a size or a camera that is not usable.
    """

    def __init__(self, scene: Scene, q: Array, *, size: Any = (480, 360), camera: Any = None) -> None:
        self.width, self.height = picture_size(size)
        visuals = thin_out(from_scene(scene), MAX_TRIANGLES)
        self._planes = [(v, _rgb(color_of(v, k))) for k, v in enumerate(visuals) if v.shape == "halfspace"]
        self._lines = [v for v in visuals if v.shape == "line"]
        self._bodies = [
            _Body.of(v, _rgb(color_of(v, k))) for k, v in enumerate(visuals) if v.shape not in ("halfspace", "line")
        ]
        self._joints = sorted({joint for visual in visuals for joint in visual.joints})
        self._poses = BodyPoses(scene.model, self._joints)
        chosen = camera_of(camera if camera is not None else scene.camera or "auto")
        self._followed = _joint_of(scene, chosen)
        poses = self._poses.at(q)
        frames = Frames(
            np.array([0.0, 1.0]),
            {j: Poses(np.array([p[:3]] * 2), np.array([p[3:]] * 2)) for j, p in zip(self._joints, poses, strict=True)},
        )
        trees = trees_of(scene.model)
        view = fit(visuals, frames, trees, touches=Touches.expected(scene, q, trees))
        self._eye, self._target = _placed(view, chosen, self.width / self.height)
        self._tile = max(2.0 * view.radius / _TILES, 1e-6)
        self._kept: _Canvas | None = None  # planes and what is fixed, where neither planes nor the camera move

    def draw(self, q: Array) -> Picture:
        """Return the picture at q (nq,), shape (height, width, 3), red, green, blue."""
        poses = dict(zip(self._joints, self._poses.at(q), strict=True))
        eye, target = self._eye, self._target
        if self._followed is not None:
            shift = poses[self._followed][:3] - target
            eye, target = eye + shift, target + shift
        canvas = self._still(eye, target, poses)
        for body in self._bodies:
            if body.joint != 0:
                _draw(canvas, body, poses[body.joint])
        for line in self._lines:
            ends = zip(line.joints, line.vertices.astype(float), strict=True)
            path = [poses[joint][:3] + rotate(poses[joint][None, 3:], end)[0] for joint, end in ends]
            canvas.line(np.array(path), 255.0 * np.array(line.color or (0.2, 0.2, 0.2, 1.0))[:3])
        return canvas.picture()

    def _still(self, eye: Array, target: Array, poses: dict[int, Array]) -> _Canvas:
        """Return the canvas with the halfspaces on it, and with the bodies that are fixed to the world."""
        if self._kept is not None:
            return self._kept.copy()
        canvas = _Canvas(self.width * _SAMPLES, self.height * _SAMPLES, eye, target)
        for plane, color in self._planes:
            pose = poses[plane.joint]
            normal = plane.placement[:3, :3] @ np.array(plane.sizes[:3])
            point = plane.placement[:3, 3] + plane.sizes[3] * normal
            turn = pose[None, 3:]
            canvas.plane(rotate(turn, normal)[0], pose[:3] + rotate(turn, point)[0], color, self._tile)
        for body in self._bodies:
            if body.joint == 0:
                _draw(canvas, body, poses[0])
        if self._followed is None and all(plane.joint == 0 for plane, _ in self._planes):
            self._kept = canvas.copy()
        return canvas


@dataclass(frozen=True)
class _Body:
    """A mesh in the frame of its joint: points and unit normals (n, 3), triangles (m, 3), colour 0..255.

    closed: whether its outside hides its inside, and all triangles turn the same way; it is not known of meshes.
    """

    joint: int
    points: Array
    normals: Array
    faces: Indices
    color: Array
    closed: bool

    @classmethod
    def of(cls, visual: Visual, color: Array) -> _Body:
        mesh = (visual.vertices, visual.faces) if visual.shape == "mesh" else outline_mesh(visual.shape, visual.sizes)
        points, normals, faces = creased(*mesh)
        turn, place = visual.placement[:3, :3], visual.placement[:3, 3]
        return cls(
            visual.joint,
            points @ turn.T + place,
            normals @ turn.T,
            faces.astype(np.int64),
            color,
            visual.shape != "mesh",
        )


class _Canvas:
    """A picture that is being drawn, seen from `eye` [m]."""

    def __init__(self, width: int, height: int, eye: Array, target: Array) -> None:
        self.width, self.height, self._eye = width, height, eye
        away = (eye - target) / np.linalg.norm(eye - target)
        side = np.cross([0.0, 0.0, 1.0], away)
        side /= np.linalg.norm(side)
        self._axes = np.array([side, np.cross(away, side), -away])  # right, up, ahead
        self._scale = 0.5 * min(width, height) / np.tan(_HALF_ANGLE)  # [pixels] of what is 1 aside at a depth of 1
        self._near = 1e-3 * float(np.linalg.norm(eye - target))
        self._color = np.tile(_SKY.astype(np.float32), (width * height, 1))
        self._nearness = np.zeros(width * height)  # 1 / depth [1/m]

    def copy(self) -> _Canvas:
        """Return a canvas with the same picture."""
        twin = copy.copy(self)
        twin._color, twin._nearness = self._color.copy(), self._nearness.copy()
        return twin

    def plane(self, normal: Array, point: Array, color: Array, tile: float) -> None:
        """Draw a plane with a grid of squares of side `tile` [m], and fade it into the distance."""
        across, along = np.meshgrid(
            np.arange(self.width) + 0.5 - 0.5 * self.width, 0.5 * self.height - np.arange(self.height) - 0.5
        )
        rays = np.column_stack([across.ravel() / self._scale, along.ravel() / self._scale, np.ones(across.size)])
        rays = rays @ self._axes
        slope, height = rays @ normal, float((point - self._eye) @ normal)
        nearness = np.divide(slope, height, out=np.zeros_like(slope), where=height != 0.0)
        seen = np.flatnonzero(nearness > np.maximum(self._nearness, 1e-9))
        if not len(seen) or height > 0.0:
            return  # from below the solid of the halfspace would hide all else
        hit = self._eye + rays[seen] / nearness[seen, None]
        first = np.cross(normal, [0.0, 1.0, 0.0] if abs(normal[1]) < 0.9 else [1.0, 0.0, 0.0])
        first /= np.linalg.norm(first)
        squares = np.floor(hit @ first / tile) + np.floor(hit @ np.cross(normal, first) / tile)
        tone = np.where(squares % 2.0 == 0.0, 1.0, 0.93)[:, None] * color
        far = np.clip(1.0 / (nearness[seen, None] * 60.0 * tile), 0.0, 1.0)
        self._color[seen], self._nearness[seen] = (1.0 - far) * tone + far * _SKY, nearness[seen]

    def add(self, points: Array, normals: Array, body: _Body) -> None:
        """Draw the triangles of a body; of a closed one those that are turned to the eye."""
        seen = (points - self._eye) @ self._axes.T
        ahead = seen[:, 2]
        place = self._scale * seen[:, :2] / np.maximum(ahead, self._near)[:, None]
        x, y = place[:, 0] + 0.5 * self.width, 0.5 * self.height - place[:, 1]
        shade = _AMBIENT + (1.0 - _AMBIENT) * np.clip(normals @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
        a, b, c = body.faces.T
        area = (x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a])
        front = (area < 0.0 if body.closed else area != 0.0) & (ahead[body.faces].min(axis=1) > self._near)
        corners = body.faces[front]
        self._fill(x[corners], y[corners], 1.0 / ahead[corners], shade[corners], body.color)

    def line(self, path: Array, color: Array) -> None:
        """Draw a line of a few pixels through points (k, 3)."""
        seen = (path - self._eye) @ self._axes.T
        for start, end in zip(seen[:-1], seen[1:], strict=True):
            if min(start[2], end[2]) <= self._near:
                continue
            nearness = 1.0 / np.array([start[2], end[2]])
            ends = self._scale * np.array([start[:2], end[:2]]) * nearness[:, None]
            share = np.linspace(0.0, 1.0, int(min(np.abs(ends[1] - ends[0]).max(), 1e4)) + 2)[:, None]
            place, depth = (1.0 - share) * ends[0] + share * ends[1], (1.0 - share) * nearness[0] + share * nearness[1]
            column = (place[:, :1] + 0.5 * self.width + np.arange(-1, 2).repeat(3)).astype(int)
            row = (0.5 * self.height - place[:, 1:] + np.tile(np.arange(-1, 2), 3)).astype(int)
            kept = (column >= 0) & (column < self.width) & (row >= 0) & (row < self.height)
            pixel = (row * self.width + column)[kept]
            self._put(pixel, np.broadcast_to(depth, column.shape)[kept], np.ones(len(pixel)), color)

    def picture(self) -> Picture:
        """Return the picture at its own size."""
        fine = self._color.reshape(self.height, self.width, 3)
        parts = [fine[i::_SAMPLES, j::_SAMPLES] for i in range(_SAMPLES) for j in range(_SAMPLES)]
        mean = sum(parts[1:], start=parts[0]) / np.float32(len(parts))
        return np.asarray(np.rint(np.clip(mean, 0.0, 255.0)), np.uint8)

    def _fill(self, x: Array, y: Array, nearness: Array, shade: Array, color: Array) -> None:
        """Draw triangles of places x, y [pixels], 1 / depth [1/m] and shades at their corners, (m, 3) each.

        Each is cut into its rows, and each row into the span between two edges: both are linear in the place, and so
        are depth and shade along it.
        """
        top = np.maximum(np.ceil(y.min(axis=1) - 0.5), 0.0).astype(np.int64)
        bottom = np.minimum(np.floor(y.max(axis=1) - 0.5), self.height - 1.0).astype(np.int64)
        rows = np.maximum(bottom - top + 1, 0)
        parts = np.cumsum(rows) // _AT_ONCE
        for part in np.unique(parts):
            own, row = _counted(np.flatnonzero((parts == part) & (rows > 0)), rows)
            self._spans(own, top[own] + row, x, y, nearness, shade, color)

    def _spans(
        self, own: Indices, row: Indices, x: Array, y: Array, nearness: Array, shade: Array, color: Array
    ) -> None:
        """Draw rows of triangles: own (n,) says of which, row (n,) which of the picture; the rest as `_fill`."""
        low, high = np.full(len(own), -np.inf), np.full(len(own), np.inf)
        height = row + 0.5
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            xi, yi, rise = x[own, i], y[own, i], y[own, j] - y[own, i]
            steep = rise != 0.0
            cut = xi + np.divide((height - yi) * (x[own, j] - xi), rise, out=np.zeros(len(own)), where=steep)
            # An edge that ends at or above the row of centres and begins below it bounds the span there.
            crossed = steep & (np.minimum(yi, yi + rise) <= height) & (height <= np.maximum(yi, yi + rise))
            low = np.where(crossed, np.where(np.isinf(low), cut, np.minimum(low, cut)), low)
            high = np.where(crossed, np.where(np.isinf(high), cut, np.maximum(high, cut)), high)
        known = np.isfinite(low)
        first = np.ceil(np.clip(low[known] - 0.5 - _ROUNDING, 0.0, self.width)).astype(np.int64)
        last = np.floor(np.clip(high[known] - 0.5 + _ROUNDING, -1.0, self.width - 1.0)).astype(np.int64)
        own, row, count = own[known], row[known], np.maximum(last - first + 1, 0)
        slopes = _slopes(x, y, nearness), _slopes(x, y, shade)
        starts = [
            values[own, 0] + along[own] * (first + 0.5 - x[own, 0]) + down[own] * (row + 0.5 - y[own, 0])
            for values, (along, down) in zip((nearness, shade), slopes, strict=True)
        ]
        parts = np.cumsum(count) // _AT_ONCE
        for part in np.unique(parts):
            span, place = _counted(np.flatnonzero((parts == part) & (count > 0)), count)
            depth, tone = (
                start[span] + along[own[span]] * place for start, (along, _) in zip(starts, slopes, strict=True)
            )
            self._put(self.width * row[span] + first[span] + place, depth, tone, color)

    def _put(self, pixel: Indices, nearness: Array, tone: Array, color: Array) -> None:
        """Set pixels to tones of a colour where nothing nearer is; of one pixel's several to that of the nearest."""
        kept = np.flatnonzero(nearness > self._nearness[pixel])
        pixel, nearness = pixel[kept], nearness[kept]
        np.maximum.at(self._nearness, pixel, nearness)
        seen = nearness == self._nearness[pixel]
        self._color[pixel[seen]] = tone[kept[seen], None] * color


def _draw(canvas: _Canvas, body: _Body, pose: Array) -> None:
    canvas.add(pose[:3] + rotate(pose[None, 3:], body.points), rotate(pose[None, 3:], body.normals), body)


def _counted(chosen: Indices, counts: Indices) -> tuple[Indices, Indices]:
    """Return each of `chosen` as often as `counts` says of it, and beside it 0, 1, 2, ... for its repetitions."""
    own = counts[chosen]
    return np.repeat(chosen, own), np.arange(own.sum()) - np.repeat(np.cumsum(own) - own, own)


def _slopes(x: Array, y: Array, values: Array) -> tuple[Array, Array]:
    """Return by how much linear functions with these values at corners, (m, 3), change along x and y, (m,) each."""
    whole = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    one, two = values[:, 1] - values[:, 0], values[:, 2] - values[:, 0]
    along = (one * (y[:, 2] - y[:, 0]) - two * (y[:, 1] - y[:, 0])) / whole
    return along, (two * (x[:, 1] - x[:, 0]) - one * (x[:, 2] - x[:, 0])) / whole


def _placed(view: View, camera: Camera, aspect: float) -> tuple[Array, Array]:
    """Return eye and target [m] of a camera, far enough that all of the view's outline is in the picture."""
    if camera.eye is not None and camera.target is not None:
        return np.array(camera.eye), np.array(camera.target)
    direction = np.array(_PRESETS.get(camera.preset or "auto", tuple(view.direction)))
    direction /= np.linalg.norm(direction)
    side = np.cross([0.0, 0.0, 1.0], direction)
    side /= np.linalg.norm(side)
    half = np.tan(_HALF_ANGLE) * np.array([max(aspect, 1.0), max(1.0 / aspect, 1.0)])
    own = view.outline - view.center
    reach = np.abs(own @ np.array([side, np.cross(direction, side)]).T) * _MARGIN
    away = float(((reach / half).max(axis=1) + own @ direction).max())
    return view.center + max(away, 1.1 * view.radius) * direction, view.center


def _joint_of(scene: Scene, camera: Camera) -> int | None:
    """Return the joint of the body that the camera follows; None where it follows none."""
    if camera.follow is None:
        return None
    model = scene.model
    if model.existJointName(camera.follow):
        return int(model.getJointId(camera.follow))
    for shape in scene.collision_model.geometryObjects:
        if shape.name == camera.follow:
            return int(shape.parentJoint)
    if model.existFrame(camera.follow):
        return int(model.frames[model.getFrameId(camera.follow)].parentJoint)
    raise InputError(
        "The camera follows an unknown body", name="camera", expected="a joint, a link or a shape of the scene",
        got=repr(camera.follow), remedy="Take one of scene.model.names",
    )  # fmt: skip


def _rgb(color: str) -> Array:
    return np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)], float)
