"""Digests of runs, so that what was computed can be compared bit by bit between runs, processes and builds."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np


def digest(arrays: list[Any]) -> str:
    """Return the SHA-256 of arrays: types, shapes and bytes."""
    found = hashlib.sha256()
    for values in arrays:
        array = np.ascontiguousarray(values)
        found.update(f"{array.dtype.str}{array.shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()[:24]


def of_trajectory(traj: Any) -> dict[str, Any]:
    """Return the digests of one trajectory."""
    forces = [] if traj.forces is None else [traj.forces.values, traj.forces.reactions]
    return {
        "status": traj.status.code.name,
        "nodes": len(traj.t),
        "time": digest([traj.t]),
        "q": digest([traj.q]),
        "p": digest([traj.p]),
        "v": digest([traj.v]),
        "events": digest(list(traj.events.arrays.values())),
        "contacts": digest(list(traj.contacts.arrays.values())),
        "changes": digest(list(traj.contact_changes.arrays.values())),
        "forces": digest(forces),
    }
