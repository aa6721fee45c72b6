"""The frictionless impacts of a run at one instant, one contact after the other, with dense matrices.

In x = L^T v, M = L L^T, the kinetic metric is Euclid's: a contact's row W becomes a = L^-1 W^T and a single elastic
impact is the reflection of x in the plane a.x = 0. Plastic impacts are least-squares problems with pushing impulses.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Array = NDArray[np.float64]

ENDLESS = 1e-9  # of the first closing speeds: where an endless sequence ends plastically
TIE = 1e-12  # of the closing speed: which contact closes faster is decided by its number
ROUNDING = 1e-15  # of the sizes of the factors: a slower closing speed is rounding


def velocity_after(M: Array, rows: Sequence[Array], e: Sequence[float], v: Array, most: int = 20_000) -> Array:
    """Return the velocity after the sequence that a run takes, shape (nv,).

    The elastic contact (e > 0) that closes fastest is struck first; where none closes, all plastic contacts at once;
    again until none closes. rows: W of each contact, shape (nv,).
    """
    lower = np.linalg.cholesky(M)
    a = np.array([np.linalg.solve(lower, row) for row in rows])
    x = lower.T @ v
    least = ENDLESS * np.abs(a @ x).max(initial=0.0)
    plastic = [i for i, value in enumerate(e) if value == 0.0]
    for _ in range(most):
        speed = a @ x
        closing = [i for i in range(len(a)) if speed[i] < -least]
        elastic = [i for i in closing if e[i] > 0.0]
        if elastic:
            fastest = min(speed[i] for i in elastic)
            i = next(i for i in elastic if speed[i] <= fastest * (1.0 - TIE))
            x = x - (1.0 + e[i]) * speed[i] / (a[i] @ a[i]) * a[i]
        elif closing:
            x = settled(a[plastic], x)
        else:
            return np.linalg.solve(lower.T, settled(a, x))
    return np.linalg.solve(lower.T, settled(a, x))


def settled(a: Array, x: Array) -> Array:
    """Return x after the contacts with rows a end plastically as one problem: the nearest x with a x >= 0."""
    size = np.linalg.norm(a, axis=1, keepdims=True) * np.linalg.norm(x)
    if not len(a) or np.all(a @ x >= -ROUNDING * size[:, 0]):  # of speeds that are rounding nnls makes large impulses
        return x
    impulse, _ = nnls(a.T, -x)
    return x + a.T @ impulse
