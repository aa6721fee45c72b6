"""Distances of segments and circles from lines, by searching."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

Segment = tuple[np.ndarray, np.ndarray]


def to_segment(x: np.ndarray, segment: Segment) -> float:
    """Distance of a point from a segment (start, end)."""
    start, end = segment
    along = end - start
    s = np.clip((x - start) @ along / (along @ along), 0.0, 1.0)
    return float(np.linalg.norm(x - start - s * along))


def segments(a: Segment, b: Segment) -> float:
    """Distance of two segments: of the points of a from b it is a convex function of the place along a."""
    low, high = 0.0, 1.0
    golden = (np.sqrt(5.0) - 1.0) / 2.0

    def distance(s: float) -> float:
        return to_segment(a[0] + s * (a[1] - a[0]), b)

    best = min(distance(low), distance(high))
    for _ in range(120):
        left, right = high - golden * (high - low), low + golden * (high - low)
        best = min(best, distance(left), distance(right))
        low, high = (left, high) if distance(left) > distance(right) else (low, right)
    return best


def circle_and_line(center: np.ndarray, axis: np.ndarray, radius: float, start: np.ndarray, end: np.ndarray) -> float:
    """Least distance of a circle from a segment, by searching along the circle."""
    u = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    u /= np.linalg.norm(u)
    w = np.cross(axis, u)

    def distance(angle: float) -> float:
        return to_segment(center + radius * (np.cos(angle) * u + np.sin(angle) * w), (start, end))

    coarse = np.linspace(0.0, 2 * np.pi, 1441)
    best = coarse[np.argmin([distance(a) for a in coarse])]
    found = minimize_scalar(distance, bounds=(best - 0.01, best + 0.01), method="bounded", options={"xatol": 1e-13})
    return float(found.fun)
