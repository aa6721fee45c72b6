"""Numbers of as many digits as wanted, and exact derivatives: what the oracles of derivatives compute with.

Three kinds of numbers pass through the same functions: `float`, `complex` (a derivative by a complex step) and
`decimal.Decimal` (a derivative by plain differences: with 60 digits a step of 1e-15 loses nothing that counts).
Constants in such functions are integers, everything else comes in as an argument, because a Decimal refuses to be
added to a float. `gradient` gives first derivatives of any such function by dual numbers (Griewank, Walther,
"Evaluating Derivatives", 2008, chapter 3), and may be nested for higher ones.
"""

from __future__ import annotations

import decimal
import itertools
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal

import numpy as np

DIGITS = 60  # of the numbers while a difference is taken
STEP = Decimal("1e-15")  # of central differences: truncation 1e-30 times a third derivative, rounding 1e-45
SECOND_STEP = Decimal("1e-12")  # of second differences: truncation 1e-24 times a fourth derivative, rounding 1e-36

Inputs = Mapping[str, object]


# --- sine and cosine of every kind of number ------------------------------------------------------------------------
def _series(x: Decimal, first: Decimal, n: int) -> Decimal:
    """Sum of first (1 - x^2 / ((n+1)(n+2)) + ..), in ten digits more than asked for."""
    with decimal.localcontext() as context:
        context.prec += 10
        total, term, square = first, first, -x * x
        while total + term * Decimal("1e-3") != total:
            n += 2
            term = term * square / (n * (n - 1))
            total += term
    return +total


def sin(x):
    """Sine of a float, complex, Decimal or Dual number."""
    if isinstance(x, Dual):
        return Dual(sin(x.value), times(x.slope, cos(x.value)), x.level)
    if isinstance(x, Decimal):
        return _series(x, x, 1) if x else x
    return np.sin(x)


def cos(x):
    """Cosine of a float, complex, Decimal or Dual number."""
    if isinstance(x, Dual):
        return Dual(cos(x.value), times(x.slope, -sin(x.value)), x.level)
    if isinstance(x, Decimal):
        return _series(x, Decimal(1), 0)
    return np.cos(x)


# --- dual numbers ---------------------------------------------------------------------------------------------------
_levels = itertools.count()


class Dual:
    """A value with its derivatives `slope`, a list of n, with respect to the n arguments of one call of `gradient`.

    A number of an older level, or of none, is a constant with respect to the arguments of a newer one.
    """

    __slots__ = ("value", "slope", "level")
    __array_ufunc__ = None  # no array takes a Dual for an element of its own type without being asked

    def __init__(self, value, slope: list, level: int):
        self.value, self.slope, self.level = value, slope, level

    def _split(self, other):
        """(value, slope) of both with respect to the newer level of the two, slope None of a constant; the level."""
        level = max(self.level, other.level) if isinstance(other, Dual) else self.level

        def parts(x):
            mine = isinstance(x, Dual) and x.level == level
            return (x.value, x.slope) if mine else (x, None)

        return *parts(self), *parts(other), level

    def __add__(self, other):
        a, da, b, db, level = self._split(other)
        return Dual(a + b, _sum(da, db), level)

    def __mul__(self, other):
        a, da, b, db, level = self._split(other)
        return Dual(a * b, _sum(times(da, b), times(db, a)), level)

    def __truediv__(self, other):
        a, da, b, db, level = self._split(other)
        quotient = a / b
        one = None if da is None else [x / b for x in da]
        two = None if db is None else [-x * quotient / b for x in db]
        return Dual(quotient, _sum(one, two), level)

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self):
        return Dual(-self.value, [-x for x in self.slope], self.level)

    def __sub__(self, other):
        return self + (-other)

    def __rsub__(self, other):
        return -self + other

    def __rtruediv__(self, other):
        quotient = other / self.value
        return Dual(quotient, [-x * quotient / self.value for x in self.slope], self.level)


def _sum(one: list | None, two: list | None):
    if one is None or two is None:
        return two if one is None else one
    return [x + y for x, y in zip(one, two, strict=True)]


def times(slope: list | None, factor):
    """Every element of `slope` times one number of any kind; None stays None."""
    return None if slope is None else [x * factor for x in slope]


def unit_of(x):
    """One, as a number of the kind that x is made of."""
    while isinstance(x, Dual):
        x = x.value
    return type(x)(1)


def vector(x: Sequence) -> np.ndarray:
    """The numbers of x as they are, shape (n,), dtype object."""
    out = np.empty(len(x), dtype=object)
    for i, number in enumerate(x):
        out[i] = number
    return out


def gradient(f: Callable, x: Sequence):
    """(f(x), df/dx) of a function of a list of numbers; f returns one number or a list.

    df/dx has shape (n,), of a list (m, n). The numbers of the result are of the kind of those that go in, and may be
    Dual themselves: gradient of a gradient is the second derivative.
    """
    level = next(_levels)
    one = unit_of(x[0])
    seeds = [[one if i == j else 0 * one for j in range(len(x))] for i in range(len(x))]
    out = f([Dual(number, row, level) for number, row in zip(x, seeds, strict=True)])

    def split(y):
        mine = isinstance(y, Dual) and y.level == level
        return (y.value, y.slope) if mine else (y, [0 * one] * len(x))

    if not isinstance(out, (list, tuple, np.ndarray)):
        value, slope = split(out)
        return value, vector(slope)
    values, slopes = zip(*(split(y) for y in out), strict=True)
    return vector(values), np.array(slopes, dtype=object).reshape(len(values), len(x))


# --- kinds of numbers -----------------------------------------------------------------------------------------------
def convert(x, kind: Callable):
    """x with each of its numbers turned into `kind`: a number, or nested lists and arrays as arrays of objects."""
    if isinstance(x, (list, tuple, np.ndarray)):
        return vector([convert(y, kind) for y in x])
    return kind(x)


def to_float(x) -> float:
    """The real part as a float."""
    return float(x.real) if isinstance(x, (complex, np.complexfloating)) else float(x)


def as_floats(inputs: Inputs) -> dict:
    """A dict of inputs with all their numbers as floats."""
    return {name: convert(x, to_float) for name, x in inputs.items()}


def as_decimals(inputs: Inputs) -> dict:
    """A dict of inputs with all their numbers as Decimal, exactly."""
    return {name: convert(x, lambda y: Decimal(float(y))) for name, x in inputs.items()}


def solve_linear(a: np.ndarray, b: Sequence) -> np.ndarray:
    """x with a x = b for numbers of any kind, by Gaussian elimination with pivots; b (n,) or (n, m)."""
    rows = np.array(b, dtype=object)
    a, n = np.hstack([np.array(a, dtype=object), rows.reshape(len(rows), -1)]), len(rows)
    for k in range(n):
        pivot = max(range(k, n), key=lambda i: abs(a[i, k]))
        a[[k, pivot]] = a[[pivot, k]]
        for i in range(k + 1, n):
            a[i] = a[i] - a[k] * (a[i, k] / a[k, k])
    x = a[:, n:]
    for k in reversed(range(n)):
        x[k] = (x[k] - a[k, k + 1 : n] @ x[k + 1 :] if k + 1 < n else x[k]) / a[k, k]
    return x.reshape(rows.shape)


def newton(residual: Callable, start: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """(root, inverse of the derivative there) of equations in floats, by Newton's method with complex steps.

    A matrix serves as long as each iteration with it gains two digits.
    """
    z, last, inverse = np.array([float(x) for x in start]), np.inf, None
    for _ in range(100):
        if inverse is None:
            inverse = np.linalg.inv(complex_jacobian(residual, z))
        change = inverse @ np.array(residual(z), dtype=float)
        z, size = z - change, np.abs(change).max() / (1.0 + np.abs(z).max())
        if size <= 1e-9:
            return z, np.linalg.inv(complex_jacobian(residual, z))
        last, inverse = size, (inverse if size <= 1e-2 * last else None)
    raise ArithmeticError(f"Newton's method in floats did not converge: last change {last:.1e}")


def refine(residual: Callable, z: np.ndarray, inverse: np.ndarray, kind: type) -> np.ndarray:
    """The root near z in numbers of `kind`: each iteration with the given matrix gains the digits it is good for."""
    inverse, z = (np.vectorize(kind, otypes=[object])(x) for x in (inverse, z))
    limit = Decimal(10) ** (4 - decimal.getcontext().prec) if kind is Decimal else 8 * np.finfo(float).eps
    done = 0
    for _ in range(60):
        change = inverse @ vector(list(residual(z)))
        z = z - change
        done += max(abs(y) for y in change) <= limit * (1 + max(abs(y) for y in z))
        if done == 3:  # once more for the imaginary part of complex numbers, and for the last digit
            return z
    raise ArithmeticError("the digits did not converge: singular equations?")


def frozen(inputs: Inputs) -> tuple:
    """The inputs rounded to ten digits, as a key of caches: what only starts an iteration may be shared."""

    def plain(x):
        return tuple(plain(y) for y in x) if isinstance(x, (list, tuple, np.ndarray)) else float(f"{to_float(x):.9e}")

    return tuple((name, plain(x)) for name, x in sorted(inputs.items()))


# --- derivatives of whole computations ------------------------------------------------------------------------------
def complex_jacobian(f: Callable, x: np.ndarray, step: float = 1e-40) -> np.ndarray:
    """df/dx (m, n) of a function that takes complex numbers: f(x + i step e) / step, without a difference."""
    x = np.array(x, dtype=float)
    columns = [np.array(f(x + 1j * step * e), dtype=complex).imag / step for e in np.eye(len(x))]
    return np.array(columns).T


def _moved(inputs: dict, name: str, index: tuple, amount) -> dict:
    moved = dict(inputs)
    if index == ():
        moved[name] = moved[name] + amount
    else:
        moved[name] = moved[name].copy()
        moved[name][index] = moved[name][index] + amount
    return moved


def _places(inputs: Inputs, wrt: Sequence[str]) -> list[tuple[str, tuple]]:
    return [(name, index) for name in wrt for index in np.ndindex(np.shape(inputs[name]))]


def differences(f: Callable[[dict], Sequence], inputs: Inputs, wrt: Sequence[str]) -> np.ndarray:
    """df/d(inputs of the names `wrt`, one after the other) in Decimal, shape (m, n), as floats: good to rounding.

    f takes a dict of numbers and returns m of them; inputs are floats, and stand for themselves exactly.
    """
    with decimal.localcontext() as context:
        context.prec = DIGITS
        exact, columns = as_decimals(inputs), []
        for name, index in _places(inputs, wrt):
            plus, minus = (vector(list(f(_moved(exact, name, index, s * STEP)))) for s in (1, -1))
            columns.append((plus - minus) / (2 * STEP))
    return np.array(columns).T.astype(float)


def second_differences(f: Callable[[dict], Sequence], inputs: Inputs, one: Inputs, two: Inputs) -> np.ndarray:
    """d2f(one, two) (m,): second derivative along two directions, each a dict of the inputs that it moves."""
    with decimal.localcontext() as context:
        context.prec = DIGITS
        exact, one, two = as_decimals(inputs), as_decimals(one), as_decimals(two)
        total = 0
        for a, b in itertools.product((1, -1), repeat=2):
            at = dict(exact)
            for sign, direction in ((a, one), (b, two)):
                for name, d in direction.items():
                    at[name] = at[name] + d * (sign * SECOND_STEP)
            total = total + vector(list(f(at))) * (a * b)
        return (total / (4 * SECOND_STEP**2)).astype(float)


def complex_differences(f: Callable[[dict], Sequence], inputs: Inputs, wrt: Sequence[str]) -> np.ndarray:
    """The same as `differences` by complex steps: faster, good to the rounding of floats times the conditions."""
    plain = {name: convert(x, lambda y: complex(float(y))) for name, x in inputs.items()}
    step, columns = 1e-40, []
    for name, index in _places(inputs, wrt):
        columns.append([y.imag / step for y in f(_moved(plain, name, index, 1j * step))])
    return np.array(columns).T
