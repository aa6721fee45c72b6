"""A four-bar linkage in its one coordinate, the angle of the crank: the reference for loops as constraints.

The angles of the bars follow from the crank's by two triangles, and their derivatives by it, r and then s, from those
of the loop sum_k l_k e(theta_k) = const. With the places c_k(phi) of the mass centres of uniform bars,

    sum_k m_k c_k' . (c_k' phi'' + c_k'' phi'^2) + I_k r_k (r_k phi'' + s_k phi'^2) = -V',

which DOP853 integrates to 1e-13.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81


def angles(lengths: Sequence[float], phi: float) -> np.ndarray:
    """Return the angles of crank, coupler and rocker to the x axis [rad], (3,); the coupler lies above the ground."""
    crank, coupler, rocker, ground = lengths
    x, z = ground - crank * np.cos(phi), -crank * np.sin(phi)
    s, across = np.hypot(x, z), np.arctan2(z, x)
    first = across + np.arccos((coupler**2 + s * s - rocker**2) / (2.0 * coupler * s))
    last = across - np.arccos((rocker**2 + s * s - coupler**2) / (2.0 * rocker * s))
    return np.array([phi, first, last])


def coefficients(lengths: Sequence[float], phi: float) -> tuple[float, float, float]:
    """Return a, b, c with a phi'' + b phi'^2 + c = torque on the crank, of bars of 1 kg/m."""
    bars, theta = np.array(lengths[:3]), angles(lengths, phi)
    along = np.stack([np.cos(theta), np.sin(theta)])  # e and its derivative by the angle, (2, 3)
    across = np.stack([-np.sin(theta), np.cos(theta)])
    moved = bars * across
    r = np.append(1.0, np.linalg.solve(moved[:, 1:], -moved[:, 0]))
    s = np.append(0.0, np.linalg.solve(moved[:, 1:], (bars * along) @ r**2))
    inertia = bent = weight = 0.0
    end1, end2 = np.zeros(2), np.zeros(2)  # derivatives of the place where a bar begins
    for k, length in enumerate(bars):
        step1, step2 = length * across[:, k] * r[k], length * (across[:, k] * s[k] - along[:, k] * r[k] ** 2)
        centre1, centre2 = end1 + 0.5 * step1, end2 + 0.5 * step2
        inertia += length * centre1 @ centre1 + length**3 / 12.0 * r[k] ** 2
        bent += length * centre1 @ centre2 + length**3 / 12.0 * r[k] * s[k]
        weight += length * GRAVITY * centre1[1]
        end1, end2 = end1 + step1, end2 + step2
    return float(inertia), float(bent), float(weight)


def acceleration(lengths: Sequence[float], phi: float, rate: float) -> float:
    """Return phi'' [rad/s^2] of bars of 1 kg/m."""
    inertia, bent, weight = coefficients(lengths, phi)
    return -(bent * rate**2 + weight) / inertia


def geared(lengths: Sequence[float], phi: float, ahead: float, rate: float, times: np.ndarray) -> np.ndarray:
    """Return phi and the impulse of the gear on the second linkage of two, (n, 2).

    Their cranks turn together, that of the second one by `ahead` [rad] further than the first, at phi.
    """

    def right_side(_t: float, y: np.ndarray) -> list[float]:
        first, second = (np.array(coefficients(lengths, angle)) for angle in (y[0], y[0] + ahead))
        inertia, bent, weight = first + second
        bend = -(bent * y[1] ** 2 + weight) / inertia
        return [y[1], bend, second @ (bend, y[1] ** 2, 1.0)]

    found = solve_ivp(
        right_side, (times[0], times[-1]), [phi, rate, 0.0], method="DOP853", rtol=1e-13, atol=1e-14, t_eval=times
    )
    return np.asarray(found.y[[0, 2]].T)


def motion(lengths: Sequence[float], phi: float, rate: float, times: np.ndarray) -> np.ndarray:
    """Return (phi, phi') at the times from this start at the first of them, shape (n, 2)."""

    def right_side(_t: float, y: np.ndarray) -> list[float]:
        return [y[1], acceleration(lengths, y[0], y[1])]

    found = solve_ivp(
        right_side, (times[0], times[-1]), [phi, rate], method="DOP853", rtol=1e-13, atol=1e-14, t_eval=times
    )
    return np.asarray(found.y.T)
