"""Pairs of points that are fixed on two bodies each: the Jacobian of their relative velocity, and its change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactvi.importing.engine_model import EngineModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointPairs:
    """n pairs of points fixed on bodies, at a configuration.

    Attributes:
        model: the bodies, as the engine has them.
        q: configuration, shape (nq,).
        joints: joints that carry the first and the second points, shape (2, n); 0 is the world.
        points: where the first and the second points are [m], world frame, shape (2, n, 3).
        axes: R_WC, the axes C in which the second point's velocity relative to the first is expressed, (n, 3, 3).
    """

    model: EngineModel
    q: Array
    joints: NDArray[np.int64]
    points: Array
    axes: Array

    def jacobian(self) -> Array:
        """Return J_C, shape (3 n, nv): J_C v is the velocity of the second points relative to the first, in C."""
        joints, of_point = self._joints()
        *places, J = map(np.asarray, self.model.jacobians(joints, self.q))
        local, R_CB = self._carried(places, of_point)
        first, second = R_CB @ (J[of_point, :3] - skew(local) @ J[of_point, 3:])
        return np.asarray((second - first).reshape(-1, self.model.nv))

    def bias_acceleration(self, v: Array) -> Array:
        """Return the accelerations of the second points relative to the first where dv/dt = 0, in C, (3 n,) [m/s^2]."""
        joints, of_point = self._joints()
        *places, twists = map(np.asarray, self.model.motions(joints, self.q, v))
        local, R_CB = self._carried(places, of_point)
        both = twists.reshape(-1, 2, 2, 3)
        (velocity, spin), (linear, angular) = both[of_point].transpose(2, 3, 0, 1, 4)[..., None]
        S, x = skew(spin[..., 0]), local[..., None]
        acceleration = linear + skew(angular[..., 0]) @ x + S @ (velocity + S @ x)
        first, second = R_CB @ acceleration
        return np.asarray((second - first).reshape(-1))

    def chosen(self, at: list[int], turned: NDArray[np.bool_], axes: Array) -> PointPairs:
        """Return some pairs, those where `turned` (m,) with the two points in the other order, in axes (m, 3, 3)."""
        joints, points = self.joints[:, at], self.points[:, at]
        joints[:, turned], points[:, turned] = joints[::-1, turned], points[::-1, turned]
        return PointPairs(self.model, self.q, joints, points, axes)

    def _joints(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the joints that carry points, and of each point the place of its joint among them, (2, n)."""
        joints = np.array(sorted(set(self.joints.ravel().tolist())), dtype=np.int64)
        return joints, np.searchsorted(joints, self.joints)

    def _carried(self, places: list[Array], of_point: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return where each point is in its body, (2, n, 3), and the axes R_CB, (2, n, 3, 3), by places of joints."""
        R_WB, p_WB = (part[of_point] for part in places)
        local = ((self.points - p_WB)[..., None, :] @ R_WB)[..., 0, :]
        return local, self.axes.transpose(0, 2, 1) @ R_WB


def skew(x: Array) -> Array:
    """Return the matrices of the cross products with x (..., 3), shape (..., 3, 3)."""
    S = np.zeros((*x.shape, 3))
    S[..., 0, 1], S[..., 0, 2], S[..., 1, 2] = -x[..., 2], x[..., 1], -x[..., 0]
    S[..., 1, 0], S[..., 2, 0], S[..., 2, 1] = x[..., 2], -x[..., 1], x[..., 0]
    return S
