"""A wavy ground, z = .05 sin 3x cos 3y, with its derivatives, as functions of many points."""

from __future__ import annotations

import numpy as np

HIGH, WAVE = 0.05, 3.0  # [m, 1/m]: a ball of up to 1 / (HIGH WAVE^2) = 2.2 m has one nearest point in a valley


def waves(p: np.ndarray) -> np.ndarray:
    """Heights (n,) at points (n, 2)."""
    return HIGH * np.sin(WAVE * p[:, 0]) * np.cos(WAVE * p[:, 1])


def slope(p: np.ndarray) -> np.ndarray:
    """Their gradients (n, 2)."""
    x, y = WAVE * p.T
    return HIGH * WAVE * np.stack([np.cos(x) * np.cos(y), -np.sin(x) * np.sin(y)], axis=1)


def bend(p: np.ndarray) -> np.ndarray:
    """Their Hessians (n, 2, 2)."""
    x, y = WAVE * p.T
    same, mixed = -np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y)
    return HIGH * WAVE**2 * np.array([[same, mixed], [mixed, same]]).transpose(2, 0, 1)
