"""Exponential of SO(3), its logarithm and right Jacobians, exact to rounding also for small rotations.

Conventions: R' = R exp(w); the right Jacobian J satisfies exp(phi + d) = exp(phi) exp(J d + O(d^2)).
Closed forms: Sola, Deray, Atchuthan, "A micro Lie theory", eqs. 143-144. Below SERIES_ANGLE the
coefficients come from their Taylor series, because the closed forms cancel there.
"""

from __future__ import annotations

import math

import numpy as np

SERIES_ANGLE = 0.5
# Bernoulli numbers B_2, B_4, ... for the coefficient (1 - (t/2) cot(t/2)) / t^2.
_BERNOULLI = (1 / 6, -1 / 30, 1 / 42, -1 / 30, 5 / 66, -691 / 2730, 7 / 6, -3617 / 510, 43867 / 798, -174611 / 330)


def hat(w: np.ndarray) -> np.ndarray:
    """Matrix of the cross product, hat(w) x = w x x, shape (3, 3)."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def _one_minus_cos_over_square(t: float) -> float:
    s = math.sin(0.5 * t) / (0.5 * t) if t > 0 else 1.0
    return 0.5 * s * s


def _t_minus_sin_over_cube(t: float) -> float:
    if t > SERIES_ANGLE:
        return (t - math.sin(t)) / t**3
    return sum((-1) ** k * t ** (2 * k) / math.factorial(2 * k + 3) for k in range(9))


def right_jacobian(phi: np.ndarray) -> np.ndarray:
    """J(phi) = sum_k (-hat(phi))^k / (k+1)!, shape (3, 3)."""
    t, x = float(np.linalg.norm(phi)), hat(phi)
    return np.eye(3) - _one_minus_cos_over_square(t) * x + _t_minus_sin_over_cube(t) * x @ x


def right_jacobian_inverse(phi: np.ndarray) -> np.ndarray:
    """J(phi)^-1 for |phi| < 2 pi, shape (3, 3)."""
    t, x = float(np.linalg.norm(phi)), hat(phi)
    if t > SERIES_ANGLE:
        c = (1.0 - 0.5 * t / math.tan(0.5 * t)) / t**2
    else:
        c = sum(abs(b) * t ** (2 * k) / math.factorial(2 * k + 2) for k, b in enumerate(_BERNOULLI))
    return np.eye(3) + 0.5 * x + c * x @ x


def exp(phi: np.ndarray) -> np.ndarray:
    """Rotation matrix of the rotation vector phi [rad], shape (3, 3)."""
    t, x = float(np.linalg.norm(phi)), hat(phi)
    sinc = math.sin(t) / t if t > 0 else 1.0
    return np.eye(3) + sinc * x + _one_minus_cos_over_square(t) * x @ x


def quat_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Product of quaternions in Pinocchio's order (x, y, z, w)."""
    return np.concatenate([a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3]), [a[3] * b[3] - a[:3] @ b[:3]]])


def quat_exp(phi: np.ndarray) -> np.ndarray:
    """Unit quaternion (x, y, z, w) of the rotation vector phi [rad]."""
    t = float(np.linalg.norm(phi))
    s = math.sin(0.5 * t) / t if t > 0 else 0.5
    return np.append(s * phi, math.cos(0.5 * t))


def quat_log(u: np.ndarray) -> np.ndarray:
    """Rotation vector of a quaternion (x, y, z, w), |phi| <= pi; exact for small rotations."""
    s, w = float(np.linalg.norm(u[:3])), float(u[3])
    if s == 0.0:
        return np.zeros(3)
    angle = 2.0 * math.atan2(s, abs(w))
    return math.copysign(angle / s, w) * u[:3]


def quat_difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """phi with b = a exp(phi)."""
    return quat_log(quat_product(np.append(-a[:3], a[3]), b))
