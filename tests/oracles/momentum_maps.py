"""Spatial linear and angular momentum about the world origin, from (q, p)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin


def spatial_momentum(model: pin.Model, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(linear, angular) summed over all trees, shape (6,). Every tree must start with a free-flyer.

    The momentum conjugate to a free-flyer's body twist is the whole tree's spatial momentum in that
    body's frame, so p alone is enough.
    """
    total = pin.Force.Zero()
    for i in range(1, model.njoints):
        if model.parents[i] == 0:
            j = model.joints[i]
            if j.shortname() != "JointModelFreeFlyer":
                raise ValueError(f"tree {model.names[i]} is not free")
            x = q[j.idx_q : j.idx_q + 7]
            rotation = pin.Quaternion(x[3:] / np.linalg.norm(x[3:])).matrix()
            placement = model.jointPlacements[i] * pin.SE3(rotation, x[:3].copy())
            total += placement.act(pin.Force(p[j.idx_v : j.idx_v + 6].copy()))
    return total.vector.copy()


def spatial_momentum_from_velocity(model: pin.Model, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The same from the velocities of all bodies, by pin's centroidal momentum, shape (6,)."""
    data = model.createData()
    pin.computeCentroidalMomentum(model, data, q, v)
    com, h = data.com[0], data.hg
    return np.concatenate([h.linear, h.angular + np.cross(com, h.linear)])
