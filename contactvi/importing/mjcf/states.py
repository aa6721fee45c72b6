"""The maps between MuJoCo's qpos, qvel and Pinocchio's q, v of the converted model.

Joint values are the file's. Quaternions are (w, x, y, z) in qpos and (x, y, z, w) in q; the linear velocity of a free
joint has world axes in qvel and body axes in v; all else is equal.
"""

from __future__ import annotations

import numpy as np

from contactvi.importing.mjcf.compiler import Source, rotation, unit


def configuration_of(source: Source, qpos: np.ndarray) -> np.ndarray:
    """Return q, shape (nq,), of a qpos, shape (nq,)."""
    q = np.array(qpos, dtype=float)
    for first in _quaternions(source):
        w, x, y, z = unit(q[first : first + 4])
        q[first : first + 4] = x, y, z, w
    return q


def velocity_of(source: Source, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """Return v, shape (nv,), of a qvel, shape (nv,), at a qpos, shape (nq,)."""
    v, m = np.array(qvel, dtype=float), source.m
    for j in _joints(source, "FREE"):
        first, quaternion = int(m.jnt_dofadr[j]), int(m.jnt_qposadr[j]) + 3
        v[first : first + 3] = rotation(qpos[quaternion : quaternion + 4]).T @ v[first : first + 3]
    return v


def inside_limits(source: Source, qpos: np.ndarray) -> np.ndarray:
    """Return a qpos whose joints are in their ranges, and note the joints that were not."""
    m, found = source.m, np.array(qpos, dtype=float)
    if source.off("LIMIT"):
        return found
    for j in (*_joints(source, "HINGE"), *_joints(source, "SLIDE")):
        address, (low, high) = int(m.jnt_qposadr[j]), m.jnt_range[j]
        if m.jnt_limited[j] and not low <= found[address] <= high:
            text = f"the file's start {found[address]:.6g} is outside of its range: moved into it"
            source.report.note("changed", "joint", source.names["joint"][j], text)
            found[address] = min(max(found[address], low), high)
    return found


def _joints(source: Source, kind: str) -> list[int]:
    return [int(j) for j in np.flatnonzero(np.asarray(source.m.jnt_type) == source.number("Joint", kind))]


def _quaternions(source: Source) -> list[int]:
    address = source.m.jnt_qposadr
    return [int(address[j]) + 3 for j in _joints(source, "FREE")] + [int(address[j]) for j in _joints(source, "BALL")]
