"""The numbers and derivatives of oracles.precise against identities, in floats and in sixty digits."""

from __future__ import annotations

import decimal
from decimal import Decimal

import numpy as np
import pytest

from oracles import derivative_step as discrete
from oracles import precise
from oracles.gauss_step import gauss_table

EPS = np.finfo(float).eps


def test_sine_and_cosine_of_decimals():
    """sin^2 + cos^2 = 1 and the double angle in 60 digits, and the values of floats."""
    with decimal.localcontext() as context:
        context.prec = 60
        for x in (Decimal(0), Decimal("0.3"), Decimal("-2.7"), Decimal(9)):
            s, c = precise.sin(x), precise.cos(x)
            assert abs(s * s + c * c - 1) <= Decimal("1e-58")
            assert abs(precise.sin(2 * x) - 2 * s * c) <= Decimal("1e-58")
            assert abs(float(s) - np.sin(float(x))) <= 2 * EPS


def test_gradients_nest_and_keep_their_levels_apart():
    """d/dx (x d/dy (x y^2 / cos y)) is 2 x d/dy (y^2 / cos y); a confusion of levels would give d/dx alone, or zero."""

    def inner(x, y):
        return precise.gradient(lambda w: x * w[0] * w[0] / precise.cos(w[0]), [y])[1][0]

    x, y = 0.7, 1.1
    slope = precise.gradient(lambda w: w[0] * inner(w[0], y), [x])[1][0]
    want = 2 * x * (2 * y / np.cos(y) + y * y * np.sin(y) / np.cos(y) ** 2)
    assert abs(slope - want) <= 8 * EPS * want
    third = precise.gradient(lambda w: precise.gradient(lambda u: inner(u[0], w[0]), [x])[1][0], [y])[1][0]
    c, s = np.cos(y), np.sin(y)
    assert abs(third - (2 / c + 4 * y * s / c**2 + y * y * (1 / c + 2 * s * s / c**3))) <= 32 * EPS * third


@pytest.mark.parametrize("s", [1, 2, 3, 4, 8])
def test_gauss_table(s):
    """Against Legendre's in floats, and order 2s of the quadrature in 60 digits."""
    for mine, other in zip(discrete.gauss_table(s, float), gauss_table(s), strict=True):
        assert np.abs(mine - other).max() <= 4 * EPS
    with decimal.localcontext() as context:
        context.prec = 60
        c, b, a = discrete.gauss_table(s, Decimal)
        assert max(abs(b @ c ** (k - 1) - Decimal(1) / k) for k in range(1, 2 * s + 1)) <= Decimal("1e-53")
        assert abs(a.sum(axis=1) - c).max() <= Decimal("1e-53")  # coefficients of P_8: 1e5


def test_solve_linear():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(5, 5)), rng.normal(size=(5, 2))
    x = precise.solve_linear(a, b).astype(float)
    assert np.abs(x - np.linalg.solve(a, b)).max() <= 100 * EPS * np.linalg.cond(a)
