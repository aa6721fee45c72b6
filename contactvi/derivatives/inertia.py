"""First and second derivatives of the mass matrix, for changes of variables between velocities and momenta.

Derivatives with respect to a configuration are those of d -> M(q (+) d) at d = 0, (+) being Pinocchio's `integrate`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]
Twists = tuple[Array, Array, Array]  # m twists (6, m), first (6, nv, m) and second (6, nv, nv, m) derivatives in q


class MassDerivatives:
    """The mass matrix M(q) of a model and its derivatives along vectors.

    All joints must have motion subspaces that are constant in the frame of the body they move, as those of the engine
    do.
    """

    def __init__(self, model: pin.Model) -> None:
        self._model = model.copy()
        self._model.gravity = pin.Motion.Zero()
        self._data = self._model.createData()
        self._rest = np.zeros(int(model.nv))
        pin.computeJointJacobians(self._model, self._data, pin.neutral(self._model))
        self._joints = [self._joint(k) for k in range(1, int(model.njoints))]
        self._inertias = [np.array(model.inertias[k].matrix()) for k in range(1, int(model.njoints))]

    def _joint(self, k: int) -> tuple[int, int, slice, Array, Array]:
        """Return a joint, its parent, its dofs, its subspace S (6, dofs) and ad of its columns (dofs, 6, 6)."""
        joint = self._model.joints[k]
        dofs = slice(int(joint.idx_v), int(joint.idx_v) + int(joint.nv))
        S = np.array(pin.getJointJacobian(self._model, self._data, k, pin.LOCAL))[:, dofs]
        crosses = np.array([_cross(column) for column in S.T]).reshape(-1, 6, 6)
        return k, int(self._model.parents[k]), dofs, S, crosses

    def mass(self, q: Array) -> Array:
        """Return M(q), shape (nv, nv)."""
        upper = np.triu(pin.crba(self._model, self._data, q))
        return np.asarray(upper + np.triu(upper, 1).T)

    def first(self, q: Array, w: Array) -> Array:
        """Return the derivative of M(q) w in q, shape (nv, nv): without gravity the forces of the acceleration w."""
        pin.computeRNEADerivatives(self._model, self._data, q, self._rest, w)
        return np.array(self._data.dtau_dq)

    def second(self, q: Array, y: Array, w: Array) -> Array:
        """Return the second derivative of y^T M(q) w in q, shape (nv, nv), symmetric.

        y^T M w is the sum over the bodies of V_y^T I V_w with their inertias I and the twists V that y and w give them.
        """
        pin.forwardKinematics(self._model, self._data, q)
        total = np.zeros((len(y), len(y)))
        for inertia, (value, first, second) in zip(
            self._inertias, self._twists(np.stack([y, w], axis=-1)), strict=True
        ):
            a, b = inertia @ value[:, 0], inertia @ value[:, 1]
            mixed = first[:, :, 0].T @ inertia @ first[:, :, 1]
            total += mixed + mixed.T + np.tensordot(b, second[..., 0], 1) + np.tensordot(a, second[..., 1], 1)
        return total

    def _twists(self, w: Array) -> list[Twists]:
        """Return the twists of all bodies that the columns of w (nv, m) give them, in their own frames, see Twists.

        A joint turned on by d moves its body's frame by exp(S d), which changes a twist X V of its parent to
        (1 - ad(S d) + ad(S d)^2 / 2 - ...) X V; what the joint adds to it, S w, stays.
        """
        n, m = w.shape
        found: list[Twists] = [(np.zeros((6, m)), np.zeros((6, n, m)), np.zeros((6, n, n, m)))]
        for k, parent, dofs, S, crosses in self._joints:
            X = np.array(self._data.liMi[k].actionInverse)
            value, first, second = ((X @ part.reshape(6, -1)).reshape(part.shape) for part in found[parent])
            turned = np.tensordot(crosses, first, 1).swapaxes(0, 1)
            second[:, dofs] -= turned
            second[:, :, dofs] -= turned.swapaxes(1, 2)
            once = np.tensordot(crosses, value, 1).swapaxes(0, 1)
            twice = np.tensordot(crosses, once, 1).swapaxes(0, 1)
            second[:, dofs, dofs] += 0.5 * (twice + twice.swapaxes(1, 2))
            first[:, dofs] -= once
            found.append((value + S @ w[dofs], first, second))
        return found[1:]


def _cross(twist: Any) -> Array:
    """Return the matrix of the product of a twist (linear, angular) with twists, ad(twist)."""
    linear, angular = pin.skew(twist[:3]), pin.skew(twist[3:])
    return np.block([[angular, linear], [np.zeros((3, 3)), angular]])
