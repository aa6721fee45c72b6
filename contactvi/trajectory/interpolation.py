"""Configurations between those of a run, for pictures, and times that lie in it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import InputError

Array = NDArray[np.float64]


def times_within(times: ArrayLike, start: float, end: float) -> Array:
    """Return times [s] as an array (n,). Raises InputError where one is outside of the run from `start` to `end`."""
    try:
        wanted = np.asarray(times, dtype=float).reshape(-1)
    except (TypeError, ValueError, OverflowError):
        wanted = np.array([np.nan])
    slack = 1e-9 * max(1.0, abs(end))
    if not np.all((wanted >= start - slack) & (wanted <= end + slack)):
        raise InputError(
            "Time outside the run",
            name="t",
            expected=f"a time in [{start:.9g}, {end:.9g}] s",
            got=np.array2string(wanted, threshold=4),
            remedy="Ask for times within the run, or run it for longer",
        )
    return np.asarray(np.clip(wanted, start, end))


def interpolated(model: pin.Model, t: Array, q: Array, wanted: Array) -> Array:
    """Return the configurations at `wanted` (n,) [s], shape (n, nq), between those known, q (k, nq) at t (k,).

    Times may be in any order, and the first of equal ones counts. Every joint moves with constant velocity in between;
    free and planar bodies as R^3 x SO(3) and R^2 x SO(2), as the engine steps them.
    """
    known, first = np.unique(t, return_index=True)
    q = q[first]
    left = np.clip(np.searchsorted(known, wanted, side="right") - 1, 0, max(0, len(known) - 2))
    result = np.empty((len(wanted), q.shape[1]))
    linear = _linear_entries(model)
    for row, (time, k) in enumerate(zip(wanted, left, strict=True)):
        right = min(k + 1, len(known) - 1)
        span = known[right] - known[k]
        s = min(1.0, max(0.0, (time - known[k]) / span)) if span > 0 else 0.0
        result[row] = pin.interpolate(model, q[k], q[right], s)
        result[row, linear] = (1.0 - s) * q[k, linear] + s * q[right, linear]
    return result


def _linear_entries(model: pin.Model) -> NDArray[np.int64]:
    """Return the entries of q that are Cartesian positions of free and planar bodies."""
    entries: list[int] = []
    for joint in model.joints[1:]:
        count = {"JointModelFreeFlyer": 3, "JointModelPlanar": 2}.get(joint.shortname(), 0)
        entries += range(joint.idx_q, joint.idx_q + count)
    return np.array(entries, dtype=np.int64)
