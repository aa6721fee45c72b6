"""Cubic splines with equal spacing through given values: their B-spline coefficients.

At both ends the third derivative is continuous over the first inner place ("not-a-knot"; de Boor, "A practical guide to
splines", 2001, chapter IV), so that cubic polynomials are met exactly and the error is of fourth order up to the ends.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def coefficients(values: Array) -> Array:
    """Return the coefficients of the spline through values (n, ...), n >= 2, along the first axis: (n + 2, ...)."""
    from scipy.linalg import solve_banded

    n = len(values)
    bend = np.zeros_like(values)  # second derivatives, in units of the spacing squared
    if n > 2:
        change = values[:-2] - 2.0 * values[1:-1] + values[2:]
        # The condition at the ends makes the first and the last inner ones those of the parabola there.
        bend[1], bend[-2] = change[0], change[-1]
        if n > 4:
            right = 6.0 * change[1:-1]
            right[0] -= bend[1]
            right[-1] -= bend[-2]
            bands = np.ones((3, n - 4))
            bands[1] = 4.0
            bend[2:-2] = solve_banded((1, 1), bands, right.reshape(n - 4, -1)).reshape(right.shape)
        two = 2 if n > 3 else 1  # three values lie on one parabola
        bend[0] = 2.0 * bend[1] - bend[two]
        bend[-1] = 2.0 * bend[-2] - bend[-1 - two]
    inner = values - bend / 6.0
    first = bend[:1] + 2.0 * inner[:1] - inner[1:2]
    last = bend[-1:] + 2.0 * inner[-1:] - inner[-2:-1]
    return np.concatenate([first, inner, last])


def along_all(values: Array) -> Array:
    """Return the coefficients of the tensor product of splines through values, two more along each axis."""
    for axis in range(values.ndim):
        values = np.moveaxis(coefficients(np.moveaxis(values, axis, 0)), 0, axis)
    return np.ascontiguousarray(values)


def weights(t: Array) -> tuple[Array, Array]:
    """Return the four B-splines of a cell, and their first derivatives, at places t (n,) in it, 0..1: (n, 4) each."""
    s = 1.0 - t
    value = np.stack([s**3, 4.0 - 6.0 * t**2 + 3.0 * t**3, 4.0 - 6.0 * s**2 + 3.0 * s**3, t**3], axis=1) / 6.0
    first = np.stack([-(s**2), 3.0 * t**2 - 4.0 * t, 4.0 * s - 3.0 * s**2, t**2], axis=1) / 2.0
    return value, first


def basis(n: int, parts: int) -> Array:
    """Return the n + 2 B-splines at all n places and `parts - 1` between two: ((n - 1) parts + 1, n + 2)."""
    count = (n - 1) * parts + 1
    cell = np.minimum(np.arange(count) // parts, n - 2)
    t = np.arange(count) / parts - cell
    rows = np.zeros((count, n + 2))
    np.put_along_axis(rows, cell[:, None] + np.arange(4), weights(t)[0], axis=1)
    return rows
