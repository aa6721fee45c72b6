"""Gradients in the numbers of configurations, and in tangent vectors of Pinocchio.

A configuration holds quaternions and pairs (cos, sin), so that it has more numbers than there are directions to move.
With J = dq/dw of q = integrate(q, w) at w = 0 a gradient in the numbers of q is one in tangent vectors by J^T.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]
Jacobian = Callable[[Array], Array]


def in_tangents(model: pin.Model, q: Array, gradients: Array) -> Array:
    """Return gradients in tangent vectors at the configurations q (N, nq) from those in their numbers (N, nq)."""
    if model.nq == model.nv:  # all joints have coordinates that add
        return gradients
    result = np.empty((len(q), model.nv))
    for of_q, of_v, jacobian, _ in _joints(model):
        part = gradients[:, of_q]
        result[:, of_v] = part if jacobian is None else np.einsum("nij,ni->nj", jacobian(q[:, of_q]), part)
    return result


def in_numbers(model: pin.Model, q: Array, gradient: Array) -> Array:
    """Return the gradient in the numbers of q (nq,) from that in tangent vectors (nv,).

    It is that of a function which takes q for the configuration nearest to it: numbers are brought to unit norm before
    a run starts. So it has no part along a change of that norm. It is the product with the pseudoinverse of J,
    transposed: columns of J are orthogonal, of length 1, or 1/2 in quaternions.
    """
    if model.nq == model.nv:
        return gradient
    result = np.empty(model.nq)
    for of_q, of_v, jacobian, quaternion in _joints(model):
        if jacobian is None:
            result[of_q] = gradient[of_v]
            continue
        part = jacobian(q[None, of_q])[0] @ gradient[of_v]
        part[quaternion] *= 4.0
        result[of_q] = part
    return result


def _joints(model: pin.Model) -> Iterator[tuple[slice, slice, Jacobian | None, slice]]:
    """Yield the entries of q and of v of each joint, its J, None for the identity, and where its quaternion is."""
    none = slice(0, 0)
    for joint in list(model.joints)[1:]:
        of_q, of_v = slice(joint.idx_q, joint.idx_q + joint.nq), slice(joint.idx_v, joint.idx_v + joint.nv)
        if joint.shortname() == "JointModelPlanar":
            yield of_q, of_v, _of_planar, none
        elif (joint.nq, joint.nv) == (7, 6):
            yield of_q, of_v, _of_free_flyer, slice(3, 7)
        elif (joint.nq, joint.nv) == (4, 3):
            yield of_q, of_v, _of_quaternion, slice(0, 4)
        elif (joint.nq, joint.nv) == (2, 1):
            yield of_q, of_v, _of_circle, none
        else:
            yield of_q, of_v, None, none


def _of_quaternion(q: Array) -> Array:
    """J of quaternions (N, 4): x y z w, by the body's angular velocity."""
    x, y, z, w = q.T
    rows = [[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]]
    return 0.5 * np.moveaxis(np.array(rows), 2, 0)


def _of_circle(q: Array) -> Array:
    """J of pairs (cos, sin), (N, 2)."""
    return np.stack([-q[:, 1], q[:, 0]], axis=1)[:, :, None]


def _of_free_flyer(q: Array) -> Array:
    """J of places and quaternions (N, 7), by body twists."""
    result = np.zeros((len(q), 7, 6))
    x, y, z, w = q[:, 3:].T
    rows = [[1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)]]  # fmt: skip
    result[:, :3, :3] = np.moveaxis(np.array(rows), 2, 0)
    result[:, 3:, 3:] = _of_quaternion(q[:, 3:])
    return result


def _of_planar(q: Array) -> Array:
    """J of places and pairs (cos, sin), (N, 4), by body twists."""
    result = np.zeros((len(q), 4, 3))
    c, s = q[:, 2:].T
    result[:, :2, :2] = np.moveaxis(np.array([[c, -s], [s, c]]), 2, 0)
    result[:, 2:, 2:] = _of_circle(q[:, 2:])
    return result
