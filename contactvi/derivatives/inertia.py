"""First and second derivatives of the mass matrix, for changes of variables between velocities and momenta.

Derivatives with respect to a configuration are those of d -> M(q (+) d) at d = 0, (+) being Pinocchio's `integrate`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.importing.engine_model import engine_model

Array = NDArray[np.float64]
Twists = tuple[Array, Array, Array]  # m twists (6, m), first (6, nv, m) and second (6, nv, nv, m) derivatives in q


class MassDerivatives:
    """The mass matrix M(q) of a model and its derivatives along vectors.

    All joints must have motion subspaces that are constant in the frame of the body they move, as those of the engine
    do.
    """

    def __init__(self, model: pin.Model) -> None:
        weightless = model.copy()
        weightless.gravity = pin.Motion.Zero()
        self._engine, self._rest = engine_model(weightless), np.zeros(int(model.nv))
        numbers = range(1, int(model.njoints))
        self._joints = [_Joint(model, k) for k in numbers]
        self._inertias = [np.array(model.inertias[k].matrix()) for k in numbers]

    def mass(self, q: Array) -> Array:
        """Return M(q), shape (nv, nv)."""
        return np.asarray(self._engine.mass_matrix(q))

    def first(self, q: Array, w: Array) -> Array:
        """Return the derivative of M(q) w in q, shape (nv, nv): without gravity the forces of the acceleration w."""
        return np.asarray(self._engine.motion(q, self._rest, w).force_derivatives()[0])

    def second(self, q: Array, y: Array, w: Array) -> Array:
        """Return the second derivative of y^T M(q) w in q, shape (nv, nv), symmetric.

        y^T M w is the sum over the bodies of V_y^T I V_w with their inertias I and the twists V that y and w give them.
        """
        total = np.zeros((len(y), len(y)))
        twists = self._twists(q, np.stack([y, w], axis=-1))
        for inertia, (value, first, second) in zip(self._inertias, twists, strict=True):
            a, b = inertia @ value[:, 0], inertia @ value[:, 1]
            mixed = first[:, :, 0].T @ inertia @ first[:, :, 1]
            total += mixed + mixed.T + np.tensordot(b, second[..., 0], 1) + np.tensordot(a, second[..., 1], 1)
        return total

    def _twists(self, q: Array, w: Array) -> Iterator[Twists]:
        """Yield the twists of all bodies that the columns of w (nv, m) give them at q, in their own frames, see Twists.

        A joint turned on by d moves its body's frame by exp(S d), which changes a twist X V of its parent to
        (1 - ad(S d) + ad(S d)^2 / 2 - ...) X V; what the joint adds to it, S w, stays.
        """
        n, m = w.shape
        found: dict[int, Twists] = {0: (np.zeros((6, m)), np.zeros((6, n, m)), np.zeros((6, n, n, m)))}
        last_child = {joint.parent: number for number, joint in enumerate(self._joints, 1)}
        for number, joint in enumerate(self._joints, 1):
            X, dofs, crosses = joint.from_parent(q), joint.dofs, joint.crosses
            value, first, second = ((X @ part.reshape(6, -1)).reshape(part.shape) for part in found[joint.parent])
            turned = np.tensordot(crosses, first, 1).swapaxes(0, 1)
            second[:, dofs] -= turned
            second[:, :, dofs] -= turned.swapaxes(1, 2)
            once = np.tensordot(crosses, value, 1).swapaxes(0, 1)
            twice = np.tensordot(crosses, once, 1).swapaxes(0, 1)
            second[:, dofs, dofs] += 0.5 * (twice + twice.swapaxes(1, 2))
            first[:, dofs] -= once
            if last_child[joint.parent] == number:  # an entry is of the size nv^2
                del found[joint.parent]
            twists = value + joint.S @ w[dofs], first, second
            if number in last_child:
                found[number] = twists
            yield twists


class _Joint:
    """A joint of a model.

    Attributes:
        parent: number of the joint that carries it. dofs: its places in v.
        S, crosses: its motion subspace (6, dofs) in its own frame, and ad of the columns of S, (dofs, 6, 6).
    """

    def __init__(self, model: pin.Model, number: int) -> None:
        self._joint, self._placement = model.joints[number], model.jointPlacements[number]
        self._data = self._joint.createData()
        self._joint.calc(self._data, pin.neutral(model))
        self.parent = int(model.parents[number])
        self.dofs = slice(int(self._joint.idx_v), int(self._joint.idx_v) + int(self._joint.nv))
        self.S = np.array(self._data.S).reshape(6, -1)
        self.crosses = np.array([_cross(column) for column in self.S.T]).reshape(-1, 6, 6)

    def from_parent(self, q: Array) -> Array:
        """Return the matrix (6, 6) that takes twists in the parent's frame to the joint's at q (nq,)."""
        self._joint.calc(self._data, q)
        return np.array((self._placement * self._data.M).actionInverse)


def _cross(twist: Any) -> Array:
    """Return the matrix of the product of a twist (linear, angular) with twists, ad(twist)."""
    linear, angular = pin.skew(twist[:3]), pin.skew(twist[3:])
    return np.block([[angular, linear], [np.zeros((3, 3)), angular]])
