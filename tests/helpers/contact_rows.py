"""Rows of contacts of random problems: directions, and the velocity of a body's point."""

from __future__ import annotations

import numpy as np


def frame(normal: np.ndarray) -> np.ndarray:
    """Rows n, t1, t2 of a contact with this normal, of any length."""
    n = normal / np.linalg.norm(normal)
    t1 = np.cross(n, [1.0, 0.0, 0.0] if abs(n[0]) < 0.9 else [0.0, 1.0, 0.0])
    t1 /= np.linalg.norm(t1)
    return np.array([n, t1, np.cross(n, t1)])


def point_velocity(arm: np.ndarray) -> np.ndarray:
    """Velocity (3, 6) of a body's point from (linear, angular) velocity."""
    x, y, z = arm
    return np.hstack([np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]])
