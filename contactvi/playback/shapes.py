"""Shapes of a picture as meshcat geometries, and where the camera stands."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from meshcat import geometry as mg
from numpy.typing import NDArray

from contactvi.playback.animation import Frames
from contactvi.playback.lines import path_of, rotate
from contactvi.playback.visuals import Visual

Array = NDArray[np.float64]
Part = tuple[Any, Any, Array]  # geometry, material, placement of shape (4, 4)

ARROW_COLOR = 0xE0431F  # of an impulse
FORCE_COLOR = 0x1E4FBF
ARROW_LENGTH = 0.4  # of the size of the bodies
_MARKER_COLOR = 0xF6A21B
_FLOOR_COLOR = 0xD3DAE2
_WALL_COLOR = 0xB8C6D6
_MESH_COLOR = 0xC4CAD1
_LINE_COLOR = 0x93A1B1
# Colour-blind safe tones (Okabe, Ito), for plain shapes whose model names no colour.
_PALETTE = (0x5B8DB8, 0xE69F00, 0x2F9E83, 0xC77CA3, 0x56B4E9, 0xD98232, 0x8C8F94)
_CREASE = np.cos(np.radians(35.0))  # faces that meet at a sharper angle keep their edge
_FITTED = 200  # frames used to place the camera
_FAR = 3.0  # sizes of the start within which motion counts for the camera
_Y_TO_Z = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])  # three.js cylinders stand on y


class _Data(mg.Geometry):  # type: ignore[misc]  # meshcat has no types
    """A three.js geometry given by its JSON fields."""

    def __init__(self, kind: str, **fields: Any) -> None:
        super().__init__()
        self._kind, self._fields = kind, fields

    def lower(self, object_data: Any) -> dict[str, Any]:
        return {"uuid": self.uuid, "type": self._kind, **self._fields}


def draw(visual: Visual, index: int) -> Iterator[Part]:
    """Yield the parts of one shape (not a halfspace); `index` picks the colour where the model names none."""
    material = _material(visual, index)
    if visual.shape == "mesh":
        yield _mesh(visual), material, np.eye(4)
    elif visual.shape == "box":
        x, y, z = (2.0 * side for side in visual.sizes)
        yield _Data("BoxGeometry", width=x, height=y, depth=z), material, np.eye(4)
    elif visual.shape == "sphere":
        yield from _ball(visual.sizes[0], material, np.eye(4), marked=visual.joint > 0)
    elif visual.shape == "ellipsoid":
        yield from _ball(1.0, material, np.diag([*visual.sizes, 1.0]), marked=visual.joint > 0)
    elif visual.shape in ("cylinder", "capsule", "cone"):
        radius, half = visual.sizes
        yield _cylinder(0.0 if visual.shape == "cone" else radius, radius, 2.0 * half), material, _Y_TO_Z
        if visual.shape == "capsule":
            for side in (-half, half):
                yield _sphere(radius), material, _shift(0.0, 0.0, side)


def floor(visual: Visual, view: dict[str, Any]) -> Iterator[Part]:
    """Yield a halfspace as a thin box with lines on it, beneath the scene and much larger (walls: a little larger)."""
    normal, offset = np.array(visual.sizes[:3]), visual.sizes[3]
    level = float((visual.placement[:3, :3] @ normal)[2]) > 0.9
    size, thick = (16.0 if level else 3.0) * view["radius"], 0.02 * view["radius"]
    # `visual.placement` is applied afterwards: bring the centre of the scene into the frame of the halfspace.
    center = np.linalg.solve(visual.placement, np.append(view["center"], 1.0))[:3]
    foot = center - (normal @ center - offset) * normal
    frame = _frame(normal, foot)
    material = mg.MeshPhongMaterial(
        color=_FLOOR_COLOR if level else _WALL_COLOR,
        opacity=1.0 if level else 0.45,
        transparent=not level,
        shininess=5,
    )
    yield _Data("BoxGeometry", width=size, height=size, depth=thick), material, frame @ _shift(0, 0, -0.5 * thick)
    lift = _shift(0.0, 0.0, 0.002 * view["radius"])
    lines = mg.LineBasicMaterial(color=_LINE_COLOR, opacity=0.7, transparent=True)
    yield mg.LineSegments(_grid(0.5 * size, _round_number(view["radius"] / 2.0)), lines), None, frame @ lift


def _grid(half: float, step: float) -> Any:
    """Return the lines of a grid in the plane z = 0 from -half to half."""
    count = int(half / step)
    ends = step * np.arange(-count, count + 1)
    # In pieces: software renderers drop a line one end of which is behind the camera.
    cuts = np.linspace(-step * count, step * count, 9)
    across = np.array([((x, a, 0.0), (x, b, 0.0)) for x in ends for a, b in zip(cuts, cuts[1:], strict=False)])
    points = np.concatenate([across.reshape(-1, 3), across.reshape(-1, 3)[:, [1, 0, 2]]]).astype(np.float32)
    return mg.PointsGeometry(points.T)


def line(visual: Visual, radius: float) -> Part:
    """Return a piece of a line, [0, 1] along z; its length comes by its scale."""
    return _cylinder(radius, radius, 1.0), _material(visual, 0), _shift(0, 0, 0.5) @ _Y_TO_Z


def point_marker(size: float) -> Part:
    """Return the sphere that marks a contact point."""
    return _sphere(0.014 * size), _sign(_MARKER_COLOR), np.eye(4)


def arrow(size: float, color: int = ARROW_COLOR) -> Iterator[Part]:
    """Yield an arrow of length ARROW_LENGTH size along z from the origin; scaled by the impulse or force."""
    length = ARROW_LENGTH * size
    head, radius = 0.25 * length, 0.02 * length
    shaft = length - head
    yield _cylinder(radius, radius, shaft), _sign(color), _shift(0, 0, 0.5 * shaft) @ _Y_TO_Z
    yield _cylinder(0.0, 3.0 * radius, head), _sign(color), _shift(0, 0, shaft + 0.5 * head) @ _Y_TO_Z


def fit(visuals: list[Visual], frames: Frames) -> dict[str, Any]:
    """Return the picture's frame: center [m] of what moves, radius [m] around it, size [m] of the things, direction
    from the center to the camera, and spread [m], how far it reaches to the sides, up and towards the camera.

    Halfspaces do not count, they have no end; nor does what flies far away from where everything starts.
    """
    solid = [visual for visual in visuals if visual.shape != "halfspace"]
    spots = [_Spot.of(visual, frames) for visual in solid] or [_Spot(np.zeros((1, 1, 3)), 1.0)]
    home, far = _home(spots)
    near = [spot for spot in (spot.within(home, far) for spot in spots) if len(spot.points)]
    low, high = _box(near)
    center = 0.5 * (low + high)
    direction = _direction(high - low, center, visuals)
    side = np.cross([0.0, 0.0, 1.0], direction)
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(direction, side), direction])
    reach = [np.abs((spot.points - center) @ axes.T).max(axis=(0, 1)) + spot.margin for spot in near]
    radius = max(0.5 * float(np.linalg.norm(high - low)), 1e-3)
    return {
        "center": center.tolist(),
        "radius": radius,
        "size": min(radius, 6.0 * max((spot.size for spot in spots if not spot.thin), default=radius)),
        "direction": direction.tolist(),
        "spread": np.max(reach, axis=0).tolist(),
    }


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
        low, high, margin = _bounds(visual)
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


def _direction(extent: Array, center: Array, visuals: list[Visual]) -> Array:
    """Return the unit vector from the scene to the camera: across a flat scene, never from behind a wall."""
    x, y = float(extent[0]), float(extent[1])
    if x > 2.0 * y:
        choices = [(0.25, -1.0, 0.22), (-0.25, -1.0, 0.22), (0.25, 1.0, 0.22), (-0.25, 1.0, 0.22)]
    elif y > 2.0 * x:
        choices = [(1.0, -0.25, 0.22), (1.0, 0.25, 0.22), (-1.0, -0.25, 0.22), (-1.0, 0.25, 0.22)]
    else:
        choices = [(1.0, -0.75, 0.6), (1.0, 0.75, 0.6), (-1.0, -0.75, 0.6), (-1.0, 0.75, 0.6)]
    normals = [v.placement[:3, :3] @ np.array(v.sizes[:3]) for v in visuals if v.shape == "halfspace"]
    open_side = [choice for choice in choices if all(float(np.dot(n, choice)) > 0.0 for n in normals)]
    best = np.array((open_side or choices)[0])
    return np.asarray(best / np.linalg.norm(best))


def _bounds(visual: Visual) -> tuple[Array, Array, float]:
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


def _material(visual: Visual, index: int) -> Any:
    if visual.color is None and visual.shape == "mesh":
        return mg.MeshPhongMaterial(color=_MESH_COLOR, shininess=40)
    if visual.color is None:
        return mg.MeshPhongMaterial(color=_PALETTE[(visual.joint or index) % len(_PALETTE)], shininess=40)
    red, green, blue, opacity = visual.color
    # Dark tones are lifted: on black no shading is visible.
    levels = [round(255 * min(1.0, 0.1 + 0.9 * max(0.0, level))) for level in (red, green, blue)]
    color = (levels[0] << 16) + (levels[1] << 8) + levels[2]
    return mg.MeshPhongMaterial(color=color, opacity=opacity, transparent=opacity < 1.0, shininess=40)


def _sign(color: int) -> Any:
    """Return the material of a marker: seen through whatever is in front of it."""
    return mg.MeshBasicMaterial(color=color, opacity=0.95, transparent=True, depthTest=False, depthWrite=False)


def _ball(radius: float, material: Any, matrix: Array, marked: bool) -> Iterator[Part]:
    """Yield a sphere; one that can turn gets four darker patches, else its spin would not be seen."""
    yield _sphere(radius), material, matrix
    if not marked:
        return
    dark = mg.MeshPhongMaterial(
        color=_darker(material.color), opacity=material.opacity, transparent=material.transparent, shininess=40
    )
    quarter = 0.5 * np.pi
    for k in range(4):
        patch = _Data(
            "SphereGeometry",
            radius=1.002 * radius,
            widthSegments=16,
            heightSegments=16,
            phiStart=k * quarter,
            phiLength=quarter,
            thetaStart=(k % 2) * quarter,
            thetaLength=quarter,
        )
        yield patch, dark, matrix


def _darker(color: int) -> int:
    parts = [(color >> shift) & 255 for shift in (16, 8, 0)]
    return sum(round(0.62 * part) << shift for part, shift in zip(parts, (16, 8, 0), strict=True))


def _sphere(radius: float) -> Any:
    return _Data("SphereGeometry", radius=radius, widthSegments=48, heightSegments=32)


def _cylinder(top: float, bottom: float, height: float) -> Any:
    return _Data("CylinderGeometry", radiusTop=top, radiusBottom=bottom, height=height, radialSegments=40)


def _shift(x: float, y: float, z: float) -> Array:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def _frame(normal: Array, origin: Array) -> Array:
    """Return a frame whose z axis is `normal` and whose x axis is as level as it can be."""
    side = np.cross([0.0, 0.0, 1.0], normal)
    if np.linalg.norm(side) < 1e-9:
        side = np.array([1.0, 0.0, 0.0])
    side = side / np.linalg.norm(side)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([side, np.cross(normal, side), normal], axis=1)
    matrix[:3, 3] = origin
    return matrix


def _round_number(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `value`."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-12)) * power)


def _mesh(visual: Visual) -> Any:
    vertices, normals, faces = creased(visual.vertices, visual.faces)
    return _Data(
        "BufferGeometry",
        data={
            "attributes": {
                "position": mg.pack_numpy_array(vertices.T),
                "normal": mg.pack_numpy_array(normals.T),
            },
            "index": mg.pack_numpy_array(faces.T),
        },
    )


def creased(
    vertices: NDArray[np.float32], faces: NDArray[np.uint32]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint32]]:
    """Return vertices, unit normals and faces such that round parts look round and edges sharp.

    At a vertex the faces are averaged (weighted by area) that turn less than 35 degrees from the one in question;
    corners with different results become different vertices.
    """
    points = vertices.astype(float)
    corner = faces.astype(np.int64).reshape(-1)
    across = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    area = np.linalg.norm(across, axis=1)
    unit = across / np.maximum(area, 1e-300)[:, None]
    face = np.repeat(np.arange(len(faces)), 3)
    # All pairs of corners that share a vertex: corners sorted by vertex, each paired with its whole group.
    order = np.argsort(corner, kind="stable")
    count = np.bincount(corner, minlength=len(points))
    first = np.cumsum(count) - count
    group = count[corner[order]]
    mine = np.repeat(order, group)
    step = np.arange(len(mine)) - np.repeat(np.cumsum(group) - group, group)
    other = order[np.repeat(first[corner[order]], group) + step]
    near = np.einsum("ij,ij->i", unit[face[mine]], unit[face[other]]) > _CREASE
    normal = np.stack(
        [np.bincount(mine[near], across[face[other[near]], k], minlength=len(corner)) for k in range(3)], axis=1
    )
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 0, normal / np.maximum(length, 1e-300), unit[face])
    key = np.column_stack([corner, np.rint(normal * 500).astype(np.int64)])
    _, kept, index = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return (
        vertices[corner[kept]].astype(np.float32),
        normal[kept].astype(np.float32),
        index.reshape(-1, 3).astype(np.uint32),
    )
