"""Shapes of a picture as plain data for the page: what it is made of, where, in which colour."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.playback.arrays import packed
from contactvi.playback.visuals import Visual

Array = NDArray[np.float64]

_MESH_COLOR = (0.74, 0.77, 0.80)
# Colour-blind safe tones (Okabe, Ito), for plain shapes whose model names no colour.
_PALETTE = (0x5B8DB8, 0xE69F00, 0x2F9E83, 0xC77CA3, 0x56B4E9, 0xD98232, 0x8C8F94)
_CREASE = np.cos(np.radians(35.0))  # faces that meet at a sharper angle keep their edge
_ROUNDED = 1e-5  # of the size of a mesh: files have six digits
_DARKEST, _BRIGHTEST = 0.42, 0.88  # of a colour's lightest part: on black no shading is seen, on white no outline


def shape_data(visual: Visual, index: int, bodies: Mapping[int, int]) -> dict[str, Any]:
    """Return one shape for the page.

    Args:
        index: picks the colour where the model names none.
        bodies: joint -> place in the list of bodies.
    """
    data: dict[str, Any] = {"name": visual.name, "shape": visual.shape, "color": color_of(visual, index)}
    data["opacity"] = 1.0 if visual.color is None else float(np.clip(visual.color[3], 0.0, 1.0))
    if visual.shape == "line":
        points = visual.vertices.astype(float).round(9).tolist()
        return data | {"bodies": [bodies[joint] for joint in visual.joints], "points": points}
    data |= {"body": bodies[visual.joint], "placement": visual.placement.reshape(-1).tolist()}
    if visual.shape == "mesh":
        vertices, normals, faces = creased(visual.vertices, visual.faces)
        return data | {
            "vertices": packed(vertices, "f4"),
            "normals": packed(np.rint(32767.0 * normals), "i2"),
            "faces": packed(faces, "u2" if len(vertices) <= 65_536 else "u4"),
            "closed": is_closed(visual.vertices, visual.faces),
        }
    return data | {"sizes": list(visual.sizes)}


def is_closed(vertices: NDArray[np.float32], faces: NDArray[np.uint32]) -> bool:
    """Return whether a mesh is a solid whose faces are seen from outside: every side of a face has one in return.

    Vertices of one place count as one, to a part of the size of the mesh that files round away.
    """
    points = vertices.astype(float)
    points -= points.mean(axis=0)
    places, same = np.unique(np.rint(points / (_ROUNDED * np.ptp(points))), axis=0, return_inverse=True)
    corners = same.reshape(-1)[faces.astype(np.int64)]
    corners = corners[(corners != corners[:, [1, 2, 0]]).all(axis=1)]
    start, end = corners.reshape(-1), corners[:, [1, 2, 0]].reshape(-1)
    there, back = np.sort(start * len(places) + end), np.sort(end * len(places) + start)
    a, b, c = (places[corners[:, k]] for k in range(3))
    return np.array_equal(there, back) and float(np.einsum("ij,ij->", a, np.cross(b, c))) > 0.0


def color_of(visual: Visual, index: int) -> str:
    """Return the colour of a shape as #rrggbb, black and white drawn nearer to grey."""
    if visual.color is not None:
        red, green, blue = (float(np.clip(level, 0.0, 1.0)) for level in visual.color[:3])
    elif visual.shape == "halfspace":
        red, green, blue = 0.80, 0.82, 0.845
    elif visual.shape == "mesh":
        red, green, blue = _MESH_COLOR
    else:
        tone = _PALETTE[(visual.joint or index) % len(_PALETTE)]
        return f"#{tone:06x}"
    levels = np.array([red, green, blue])
    top = float(levels.max())
    levels = levels + max(0.0, _DARKEST - top)
    levels = levels * min(1.0, _BRIGHTEST / max(float(levels.min()), 1e-9))
    return "#" + "".join(f"{round(255 * min(1.0, level)):02x}" for level in levels)


def creased(
    vertices: NDArray[np.float32], faces: NDArray[np.uint32]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint32]]:
    """Return vertices, unit normals and faces such that round parts look round and edges sharp.

    Two faces at an edge that turn by less than 35 degrees are one surface there. At a vertex the faces of one surface
    share the mean of their normals, weighted by area; corners of different surfaces become different vertices.
    """
    points, corner = vertices.astype(float), faces.astype(np.int64).reshape(-1)
    across = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    area = np.linalg.norm(across, axis=1)
    unit = across / np.maximum(area, 1e-300)[:, None]
    surface = _surfaces(faces.astype(np.int64), unit)
    normal = np.stack([np.bincount(surface, np.repeat(across[:, k], 3)) for k in range(3)], axis=1)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    _, kept = np.unique(surface, return_index=True)
    normal = np.where(length > 0.0, normal / np.maximum(length, 1e-300), unit[kept // 3])
    return (
        vertices[corner[kept]].astype(np.float32),
        normal.astype(np.float32),
        surface.reshape(-1, 3).astype(np.uint32),
    )


def _surfaces(faces: NDArray[np.int64], unit: Array) -> NDArray[np.int64]:
    """Number the corners (3 m,) of faces: those of one surface at one vertex have one number; unit normals (m, 3)."""
    count = len(faces)
    # The two ends of each side of each face, as corners (3 face + place), the lower vertex first.
    start = np.arange(3 * count).reshape(-1, 3)
    ends = np.stack([start, start[:, [1, 2, 0]]], axis=2).reshape(-1, 2)
    vertex = faces.reshape(-1)[ends]
    ends = np.where((vertex[:, 0] > vertex[:, 1])[:, None], ends[:, ::-1], ends)
    vertex = np.sort(vertex, axis=1)
    edge = vertex[:, 0] * (1 + int(faces.max(initial=0))) + vertex[:, 1]
    order = np.argsort(edge, kind="stable")
    ends, edge = ends[order], edge[order]
    links = []
    for apart in (1, 2, 3):  # sides of one edge follow each other; where sheets meet there are more than two
        same = edge[apart:] == edge[:-apart]
        mine, other = ends[:-apart][same], ends[apart:][same]
        smooth = np.einsum("ij,ij->i", unit[mine[:, 0] // 3], unit[other[:, 0] // 3]) > _CREASE
        links += [np.stack([mine[smooth, k], other[smooth, k]], axis=1) for k in (0, 1)]
    return components(3 * count, np.concatenate(links))


def components(count: int, links: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number the connected components of a graph: the number of each of `count` nodes, for links (m, 2) between them.

    Components are numbered in the order of their first nodes. Every node points to one of its component that is not
    behind it; the roots at the two ends of a link are joined until all links have one (Shiloach, Vishkin 1982).
    scipy.sparse.csgraph takes longer to import than a page takes to write.
    """
    root = np.arange(count)
    while True:
        ends = np.sort(root[links], axis=1)
        ends = ends[ends[:, 0] != ends[:, 1]]
        if not len(ends):
            return np.unique(root, return_inverse=True)[1].reshape(-1).astype(np.int64)
        np.minimum.at(root, ends[:, 1], ends[:, 0])
        while np.any(root[root] != root):
            root = root[root]
