"""Motion of a tree of bodies and its derivatives, by passes over its joints.

All joints must have motion subspaces S that are constant in the frame of the body they move, as those of the engine do.
Twists and forces are spatial vectors (linear, angular) in world axes about the world's origin. With the twist V and the
acceleration A of the body that carries the joint of dof i, a dof moves all that its joint carries by S_i; along it

    psi = V x S_i,    psi' = A x S_i + V x psi,    S_i' = V_i x S_i,

V_i the twist of its own joint, are what the derivatives are made of (Singh, Russell and Wensing, Efficient analytical
derivatives of rigid-body dynamics using spatial vector algebra, 2022). A pin.Data has them in tensors of the size nv^3,
beside matrices of the size nv^2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.importing.kinematics import Joints

Array = NDArray[np.float64]


def _cross_tensor() -> Array:
    """Return the tensor (6, 6, 6) whose product with a twist x is the matrix of the product of x with twists."""
    tensor = np.zeros((6, 6, 6))
    for k, (linear, angular) in enumerate(np.eye(6).reshape(6, 2, 3)):
        v, w = pin.skew(linear), pin.skew(angular)
        tensor[:, :, k] = np.block([[w, v], [np.zeros((3, 3)), w]])
    return tensor


# For two twists x and y, and a force f (linear, angular): (CROSS @ x) @ y = x x y, (DUAL @ f) @ x = x x* f.
CROSS = _cross_tensor()
DUAL = -np.einsum("fyx->yxf", CROSS)


class PointMotion(NamedTuple):
    """Place, velocity and acceleration of a point (3,), world, and derivatives (3, nv) in q, v and a."""

    place: Array
    velocity: Array
    acceleration: Array
    J: Array
    velocity_q: Array
    acceleration_q: Array
    acceleration_v: Array


class TreeMotion:
    """A model at q (nq,), v (nv,), a (nv,) = dv/dt.

    Attributes:
        places: where the joint frames are in the world, one for each joint, the universe first.
    """

    def __init__(self, model: pin.Model, q: Array, v: Array, a: Array) -> None:
        nv, parents = int(model.nv), list(model.parents)
        self._model, self._parents = model, parents
        self._dofs = [slice(int(first), int(first) + int(n)) for first, n in zip(model.idx_vs, model.nvs, strict=True)]
        self._dofs[0] = slice(0, 0)
        self.places = [pin.SE3.Identity()]
        self._chains = [np.zeros(0, dtype=np.int64)]  # dofs that move each joint, those of the first joint first
        self._twists, self._accelerations = np.zeros((len(parents), 6)), np.zeros((len(parents), 6))
        self._S, self._psi, self._psi_rate, self._S_rate = (np.zeros((6, nv)) for _ in range(4))
        self._joint = np.zeros(nv, dtype=np.int64)  # of each dof
        for k, joint in enumerate(Joints(model, range(1, len(parents))).at(q), 1):
            below, dofs = parents[k], self._dofs[k]
            self.places.append(self.places[below] * joint.in_parent)
            self._chains.append(np.concatenate([self._chains[below], np.arange(dofs.start, dofs.stop)]))
            self._joint[dofs] = k
            S = self._S[:, dofs] = self.places[k].action @ joint.subspace
            self._twists[k] = self._twists[below] + S @ v[dofs]
            S_rate = self._S_rate[:, dofs] = (CROSS @ self._twists[k]) @ S
            self._accelerations[k] = self._accelerations[below] + S @ a[dofs] + S_rate @ v[dofs]
            psi = self._psi[:, dofs] = (CROSS @ self._twists[below]) @ S
            self._psi_rate[:, dofs] = (CROSS @ self._accelerations[below]) @ S + (CROSS @ self._twists[below]) @ psi

    def point(self, joint: int, x: Array) -> PointMotion:
        """Return the motion of a point (3,) [m] of a body, given in the frame of its joint; 0 is the world."""
        nv = int(self._model.nv)
        if joint == 0:
            none, still = np.zeros((3, nv)), np.zeros(3)
            return PointMotion(x, still, still, none, none, none, none)
        place, V, A = self.places[joint].act(x), self._twists[joint], self._accelerations[joint]
        chain = self._chains[joint]
        S, psi = self._S[:, chain], self._psi[:, chain]
        V_q = psi - (CROSS @ V) @ S
        A_q = self._psi_rate[:, chain] - (CROSS @ A) @ S - (CROSS @ V) @ psi
        A_v = V_q + self._S_rate[:, chain]
        at, w = pin.skew(place), pin.skew(V[3:])  # a spatial vector (l, w) is l - at w at the point
        velocity = V[:3] - at @ V[3:]
        J = S[:3] - at @ S[3:]
        velocity_q = V_q[:3] - at @ V_q[3:] + w @ J
        turning = pin.skew(velocity)
        acceleration_q = A_q[:3] - at @ A_q[3:] + pin.skew(A[3:]) @ J - turning @ V_q[3:] + w @ velocity_q
        acceleration_v = A_v[:3] - at @ A_v[3:] - turning @ S[3:] + w @ J
        parts = []
        for part in (J, velocity_q, acceleration_q, acceleration_v):
            whole = np.zeros((3, nv))
            whole[:, chain] = part
            parts.append(whole)
        return PointMotion(place, velocity, A[:3] - at @ A[3:] + w @ velocity, *parts)

    def turned_force(self, joint: int, x: Array, force: Array) -> Array:
        """Return d(J^T force)/dq of a point's Jacobian J at a constant force (3,) [N], world axes, (nv, nv)."""
        T = np.zeros((int(self._model.nv),) * 2)
        chain, place = self._chains[joint], self.places[joint].act(x)
        S = self._S[:, chain]
        carries = self._joint[chain][:, None] <= self._joint[chain]  # whether dof i moves the subspace of dof k
        wrench = np.concatenate([force, np.cross(place, force)])  # of the force, about the origin
        # Of S_i x S_k the power with the wrench; and that of the point's own displacement along S_i.
        power = np.einsum("ai,ak->ki", -(DUAL @ wrench) @ S, S)
        J = S[:3] - pin.skew(place) @ S[3:]
        T[np.ix_(chain, chain)] = np.where(carries.T, power, 0.0) + np.cross(force, S[3:], axisb=0) @ J
        return T

    def force_derivatives(self) -> tuple[Array, Array]:
        """Return the derivatives in q and v of the forces that the accelerations a need, (nv, nv) each.

        That is of M a + b, gravity in it, at a constant a.
        """
        model, nv, parents = self._model, int(self._model.nv), self._parents
        gravity = -np.array(model.gravity.vector)  # the world accelerates against it
        psi_rate = self._psi_rate + (CROSS @ gravity) @ self._S
        by_speed = self._psi + self._S_rate
        inertias, bodies = np.zeros((len(parents), 6, 6)), np.zeros((len(parents), 6, 6))
        forces = np.zeros((len(parents), 6))
        by_q, by_v = np.zeros((nv, nv)), np.zeros((nv, nv))
        for k in range(len(parents) - 1, 0, -1):
            V, X = (CROSS @ self._twists[k]), np.array(self.places[k].actionInverse)
            inertia = X.T @ model.inertias[k].matrix() @ X
            momentum = inertia @ self._twists[k]
            inertias[k] += inertia
            bodies[k] += -V.T @ inertia - inertia @ V + (DUAL @ momentum)
            forces[k] += inertia @ (self._accelerations[k] + gravity) - V.T @ momentum
            dofs, chain, above = self._dofs[k], self._chains[k], self._chains[parents[k]]
            S = self._S[:, dofs]
            by_q[dofs, chain] = S.T @ (inertias[k] @ psi_rate[:, chain] + bodies[k] @ self._psi[:, chain])
            by_v[dofs, chain] = S.T @ (inertias[k] @ by_speed[:, chain] + bodies[k] @ self._S[:, chain])
            turned = inertias[k] @ psi_rate[:, dofs] + bodies[k] @ self._psi[:, dofs] + (DUAL @ forces[k]) @ S
            by_q[above, dofs] = self._S[:, above].T @ turned
            by_v[above, dofs] = self._S[:, above].T @ (inertias[k] @ by_speed[:, dofs] + bodies[k] @ S)
            inertias[parents[k]] += inertias[k]
            bodies[parents[k]] += bodies[k]
            forces[parents[k]] += forces[k]
        return by_q, by_v
