"""Contact points the slow way: every vertex carried into the world by itself, faces cut by intersecting all lines.

Nothing here knows features, edges or candidates; flat overlaps come from brute force over half planes.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial import ConvexHull


def box_vertices(half: np.ndarray) -> np.ndarray:
    """Corners of a box of half sizes half [m], shape (8, 3)."""
    return np.array([[x, y, z] for x in (-half[0], half[0]) for y in (-half[1], half[1]) for z in (-half[2], half[2])])


def vertex_gaps(vertices: np.ndarray, R: np.ndarray, p: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Heights [m] of vertices (N, 3) of a body at the pose (R, p) over the halfspace normal.x <= offset, (N,)."""
    heights = []
    for x in vertices:
        moved = np.array([sum(R[i][j] * x[j] for j in range(3)) + p[i] for i in range(3)])
        heights.append(sum(normal[i] * moved[i] for i in range(3)) - offset)
    return np.array(heights)


def circle_gap(center: np.ndarray, axis: np.ndarray, radius: float, normal: np.ndarray, offset: float) -> float:
    """Least height [m] of a circle over a plane, by searching along the circle."""
    u = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    u /= np.linalg.norm(u)
    w = np.cross(axis, u)

    def height(angle: float) -> float:
        return float(normal @ (center + radius * (np.cos(angle) * u + np.sin(angle) * w)) - offset)

    coarse = np.linspace(0, 2 * np.pi, 721)
    best = coarse[np.argmin([height(a) for a in coarse])]
    return minimize_scalar(height, bounds=(best - 0.02, best + 0.02), method="bounded", options={"xatol": 1e-12}).fun


def half_planes(points: np.ndarray) -> np.ndarray:
    """Half planes (n, offset) of the convex hull of points (N, 2) in the plane: n.x <= offset, shape (M, 3)."""
    equations = ConvexHull(points).equations
    return np.column_stack([equations[:, :2], -equations[:, 2]])


def overlap(points_a: np.ndarray, points_b: np.ndarray, tolerance: float = 1e-9) -> np.ndarray:
    """Corners of the intersection of two convex polygons given by points (N, 2): all crossings of all border lines,
    those kept that lie inside of both; shape (M, 2), in no order.
    """
    planes = np.vstack([half_planes(points_a), half_planes(points_b)])
    corners: list[np.ndarray] = []
    for i, j in combinations(range(len(planes)), 2):
        A = planes[[i, j], :2]
        if abs(np.linalg.det(A)) < 1e-7:
            continue
        x = np.linalg.solve(A, planes[[i, j], 2])
        inside = np.all(planes[:, :2] @ x <= planes[:, 2] + tolerance)
        if inside and all(np.linalg.norm(x - y) > 10 * tolerance for y in corners):
            corners.append(x)
    return np.array(corners).reshape(-1, 2)


def area(points: np.ndarray) -> float:
    """Area [m^2] of the convex hull of points (N, 2)."""
    return ConvexHull(points).volume if len(points) > 2 else 0.0


def largest_area(points: np.ndarray, count: int) -> float:
    """Largest area [m^2] of the convex hull of count of the points (N, 2), by trying all choices."""
    return max(area(points[list(choice)]) for choice in combinations(range(len(points)), min(count, len(points))))
