"""CTEC impact in NumPy: p+ = p- + lambda W^T, lambda = -(1 + e) gamma / G_c.

W is the gradient of the gap in Pinocchio's tangent space, by differences of any gap function or from
pin's Jacobians; G_c = W M^-1 W^T does not depend on the coordinates of the tangent space.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin


@dataclass(frozen=True)
class Impact:
    """gamma_minus, gamma_plus [m/s], G_c [1/kg], impulse [N s], W (nv,), p_plus (nv,)."""

    gamma_minus: float
    gamma_plus: float
    inverse_inertia: float
    impulse: float
    gradient: np.ndarray
    p_plus: np.ndarray


def mass_matrix(model: pin.Model, q: np.ndarray) -> np.ndarray:
    m = np.triu(pin.crba(model, model.createData(), q, pin.Convention.WORLD))
    return m + np.triu(m, 1).T


def gap_gradient(model: pin.Model, q: np.ndarray, gap: Callable[[np.ndarray], float], eps: float = 1e-3) -> np.ndarray:
    """dphi/dq in Pinocchio's tangent space by sixth-order central differences, shape (nv,)."""
    w = np.zeros(model.nv)
    for i in range(model.nv):
        d = np.zeros(model.nv)
        d[i] = eps
        phi = [gap(pin.integrate(model, q, s * d)) for s in (-3, -2, -1, 1, 2, 3)]
        w[i] = (45 * (phi[3] - phi[2]) - 9 * (phi[4] - phi[1]) + phi[5] - phi[0]) / (60 * eps)
    return w


def geometry_gap(model: pin.Model, geometry: pin.GeometryModel, pair: int) -> Callable[[np.ndarray], float]:
    """Signed distance of a collision pair as a function of q, by coal through pin."""
    data, gdata = model.createData(), geometry.createData()

    def gap(q: np.ndarray) -> float:
        pin.updateGeometryPlacements(model, data, geometry, gdata, q)
        return float(pin.computeDistance(geometry, gdata, pair).min_distance)

    return gap


def point_gradient(model, q, joint_a, point_a, joint_b, point_b, normal) -> np.ndarray:
    """W = n^T (J_B(x_B) - J_A(x_A)) for world points on two bodies (joint 0 = world), shape (nv,)."""
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    w = np.zeros(model.nv)
    for joint, point, sign in ((joint_a, point_a, -1.0), (joint_b, point_b, 1.0)):
        if joint > 0:
            j = pin.getJointJacobian(model, data, joint, pin.WORLD)
            w += sign * normal @ (j[:3] - np.cross(point, j[3:], axisb=0, axisc=0))
    return w


def impact(model: pin.Model, q: np.ndarray, p_minus: np.ndarray, gradient: np.ndarray, restitution: float) -> Impact:
    """Apply the map; p in Pinocchio coordinates."""
    response = np.linalg.solve(mass_matrix(model, q), np.column_stack([p_minus, gradient]))
    gamma, inverse = float(gradient @ response[:, 0]), float(gradient @ response[:, 1])
    impulse = -(1.0 + restitution) * gamma / inverse
    p_plus = p_minus + impulse * gradient
    return Impact(gamma, gamma + impulse * inverse, inverse, impulse, gradient, p_plus)
