"""Starts that satisfy the constraints of a scene, near a given one that does: a smooth function of what is changed."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.trajectory.compiled import CompiledScene

Array = NDArray[np.float64]

_RANK = 1e-9  # relative singular value below which constraints count as dependent on others
_ITERATIONS = 60
_CLOSED = 1e-13  # of the size of q and v: to which a start satisfies the constraints
_STEP = 2e-3  # of the differences of starts, whose error is then 1e-12 where q and v are of size 1
_CENTRAL = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}


class ConstrainedStarts:
    """The starts near (q, v) at t [s], which satisfies the constraints of the scene."""

    def __init__(self, compiled: CompiledScene, q: Array, v: Array, t: float) -> None:
        self._core, self._model = compiled.core, compiled.built.model
        self._q, self._v, self._t = q, v, t
        self._back = np.linalg.pinv(np.asarray(self._core.constraint_jacobian(q, t)), rcond=_RANK)

    def near(self, dq: Array, dv: Array) -> tuple[Array, Array] | None:
        """Return the start at the tangent vector dq and with the velocity v + dv, brought back to the constraints.

        Coordinates go back along the gradients of the constraints at the given start, and velocities to the nearest
        ones. None: there is no such start.
        """
        q = np.asarray(pin.integrate(self._model, self._q, dq))
        size = 1.0 + float(np.abs(q).max(initial=0.0))
        least = np.inf
        for _ in range(_ITERATIONS):
            phi = np.asarray(self._core.constraint_residual(q, self._t))
            off = float(np.abs(phi).max(initial=0.0))
            if off <= _CLOSED * size and off >= 0.5 * least:
                break
            least = min(least, off)
            q = np.asarray(pin.integrate(self._model, q, -self._back @ phi))
        if not off <= _CLOSED * size:
            return None
        J = np.asarray(self._core.constraint_jacobian(q, self._t))
        back, rate = np.linalg.pinv(J, rcond=_RANK), np.asarray(self._core.constraint_rate(q, self._t))
        v = self._v + dv
        for _ in range(2):  # The second projection removes the rounding of the first.
            v = v - back @ (J @ v + rate)
        return q, v

    def changes(self) -> Array:
        """Return the derivative of the start (q, v) by (dq, dv), shape (2 nv, 2 nv)."""
        nv = len(self._v)
        found = np.zeros((2 * nv, 2 * nv))
        for k in range(2 * nv):
            for count, weight in _CENTRAL.items():
                d = count * _STEP * np.eye(2 * nv)[k]
                start = self.near(d[:nv], d[nv:])
                if start is None:
                    return np.full((2 * nv, 2 * nv), np.nan)
                moved = tangent(self._model, self._q, start[0])
                found[:, k] += weight / _STEP * np.concatenate([moved, start[1] - self._v])
        return found


def tangent(model: pin.Model, a: Array, b: Array) -> Array:
    """Return the tangent vector from a to b, with which Pinocchio's `integrate` leads from a to b.

    Pinocchio's own has 1e-8 of noise where q holds (cos, sin), from an arc cosine; there the angle w is taken by
    arctan2. A planar joint moves by an arc: in the axes of a, its chord is V(w) times the tangent, and
    V(w)^-1 = (c, w/2; -w/2, c) with c = (w/2) / tan(w/2).
    """
    found = np.array(pin.difference(model, a, b))
    for k in range(1, model.njoints):
        i, iv, kind = model.idx_qs[k], model.idx_vs[k], model.joints[k].shortname()
        planar = "Planar" in kind
        if not planar and (model.nqs[k], model.nvs[k]) != (2, 1):
            continue
        at = i + 2 * planar
        c0, s0, c1, s1 = *a[at : at + 2], *b[at : at + 2]
        angle = np.arctan2(c0 * s1 - s0 * c1, c0 * c1 + s0 * s1)
        found[iv + 2 * planar] = angle
        if planar:
            half = 0.5 * angle
            c = half / np.tan(half) if half else 1.0
            chord = np.array([[c0, s0], [-s0, c0]]) @ (b[i : i + 2] - a[i : i + 2])
            found[iv : iv + 2] = np.array([[c, half], [-half, c]]) @ chord
    return found
