"""Signals: prescribed functions of time, as value, rate and acceleration.

A signal is given as

- a number: constant;
- a table (times, values): the cubic spline through it, twice continuously differentiable, not-a-knot at its ends; two
  or three times give the polynomial through them. Its first and last polynomials go on for 1 ms beyond its times, so
  that a run over exactly these times has the accelerations at both ends; farther outside it is not defined. Between
  times that are far apart for what the values do, the spline overshoots them;
- a function t -> value, (value, rate) or (value, rate, acceleration). What is missing follows from differences of five
  points, up to 2 ms around t: of a smooth function the rate is then good to about 1e-11 of its size, and the
  acceleration to 1e-9. Rate and acceleration should be given where they are known;
- an object that is called with t and has .derivative(), such as the splines of scipy.interpolate.

Units: the value's (rad or m), over s and s^2.
"""

from __future__ import annotations

import warnings
from bisect import bisect_right
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.elements.user_functions import at, called
from contactvi.errors import InputError, UserFunctionError
from contactvi.inputs import LARGEST, real, short

Array = NDArray[np.float64]
_RATE_STEP, _ACCELERATION_STEP = 1e-4, 1e-3  # [s] distances of the points of differences
_JUMP = 100.0  # ratio of one slope to the sum of the others from which a function jumps
_SLOW = 1e-3  # [rad/s, m/s] slope below which no function is said to jump
_PARTS = ("value", "rate", "acceleration")
BEYOND = 1e-3  # [s] by which a table goes on: over which the engine takes differences at a node
_SLACK = 1e-9  # relative to the span of a table; a run's last time is off by rounding


class Signal:
    """A signal with a name, called as signal(t) -> (value, rate, acceleration); t [s].

    Attributes:
        name: for messages.
        times, values: of a table, (n,); None otherwise.
        constant: its number; None otherwise.
        function: as given by the user; None for numbers and tables.

    Raises:
        InputError: The source is no signal. A call raises UserFunctionError with the name, the time and the part.
    """

    def __init__(self, source: Any, name: str) -> None:
        self.name = name
        self.times: Array | None = None
        self.values: Array | None = None
        self.constant: float | None = None
        self.function: Any = None
        self._last: tuple[float, tuple[float, float, float]] = (np.nan, (0.0, 0.0, 0.0))
        self._call: Callable[[float], tuple[float, float, float]]
        if isinstance(source, Signal):
            source = source.source
        if isinstance(source, Mapping) and set(source) == {"times", "values"}:
            source = (source["times"], source["values"])
        if callable(source):
            self.function = source
            self._call = self._derived if hasattr(source, "derivative") else self._differenced
            self._splines = self._derivatives(source) if hasattr(source, "derivative") else ()
        elif np.ndim(_plain(source)) == 0 and not isinstance(source, str):
            self.constant = number = real(name, source)
            self._call = lambda t: (number, 0.0, 0.0)
        else:
            self.times, self.values = _table(source, name)
            self._pieces = _pieces(self.times, self.values, name)
            self._call = self._tabled

    @property
    def source(self) -> Any:
        """The number, (times, values) or function it was made of."""
        if self.function is not None:
            return self.function
        return self.constant if self.constant is not None else (self.times, self.values)

    @property
    def storable(self) -> bool:
        """Whether a file can store it: it is data and no function."""
        return self.function is None

    def __call__(self, t: float) -> tuple[float, float, float]:
        """Return value, rate and acceleration at t [s]."""
        if t != self._last[0]:  # The engine asks several times for one instant.
            self._last = t, self._call(t)
        return self._last[1]

    def given(self, t: float) -> tuple[float, ...]:
        """Return what a function of the user gives at t [s]: value, perhaps rate and acceleration."""
        return self(t) if self._call != self._differenced else self._ask(t)

    def __deepcopy__(self, memo: Any) -> Signal:
        return self  # A signal is constant, and functions of the user are not to be copied.

    def to_data(self) -> Any:
        """Return it as plain data: a number or {"times": [...], "values": [...]}; None for a function."""
        if self.times is not None and self.values is not None:
            return {"times": self.times.tolist(), "values": self.values.tolist()}
        return self.constant

    def _tabled(self, t: float) -> tuple[float, float, float]:
        assert self.times is not None
        low, high = float(self.times[0]), float(self.times[-1])
        slack = BEYOND + _SLACK * (high - low)
        if not low - slack <= t <= high + slack:
            raise UserFunctionError(
                f"{self.name} is asked for outside its table{at(t)}",
                function=self.name,
                time=t,
                expected=f"times within {low:.9g} .. {high:.9g} s",
                got=f"t = {t:.9g} s",
                remedy="Give a longer table, or a shorter duration",
            )
        # The polynomials are evaluated here, because a call of SciPy's spline takes as long as a step of the engine.
        breaks, pieces = self._pieces
        k = min(max(bisect_right(breaks, t) - 1, 0), len(pieces) - 1)
        x, (c3, c2, c1, c0) = t - breaks[k], pieces[k]
        return ((c3 * x + c2) * x + c1) * x + c0, (3.0 * c3 * x + 2.0 * c2) * x + c1, 6.0 * c3 * x + 2.0 * c2

    def _derived(self, t: float) -> tuple[float, float, float]:
        value, rate, acceleration = (
            self._number(called(spline, self.name, t, t), t, part)
            for spline, part in zip(self._splines, _PARTS, strict=True)
        )
        return value, rate, acceleration

    def _refuse_jump(self, around: list[float], t: float) -> None:
        """Raise UserFunctionError where one of the differences between five points is far from the others."""
        slopes = np.abs(np.diff(around) / np.array([1.0, 2.0, 1.0])) / _RATE_STEP
        if slopes.max() <= _JUMP * (slopes.sum() - slopes.max()) + _SLOW:
            return
        raise UserFunctionError(
            f"{self.name} jumps{at(t)}",
            function=self.name,
            time=t,
            expected="a continuous motion",
            got=f"a change of {np.ptp(around):.6g} within {4.0 * _RATE_STEP:g} s",
            remedy="Let it change within some time, or return its rate too if the change is meant",
        )

    def _differenced(self, t: float) -> tuple[float, float, float]:
        known = self._ask(t)
        if len(known) == 3:
            return known[0], known[1], known[2]
        around = [self._ask(t + k * _RATE_STEP)[-1] for k in (-2, -1, 1, 2)]
        if len(known) == 1:
            self._refuse_jump(around, t)
        first = (around[0] - 8.0 * around[1] + 8.0 * around[2] - around[3]) / (12.0 * _RATE_STEP)
        if len(known) == 2:
            return known[0], known[1], first
        wide = [self._ask(t + k * _ACCELERATION_STEP)[0] for k in (-2, -1, 1, 2)]
        second = 16.0 * (wide[1] + wide[2]) - wide[0] - wide[3] - 30.0 * known[0]
        return known[0], first, second / (12.0 * _ACCELERATION_STEP**2)

    def _ask(self, t: float) -> tuple[float, ...]:
        result = called(self.function, self.name, t, t)
        count = len(result) if isinstance(result, (tuple, list)) else 1
        parts = list(result) if isinstance(result, (tuple, list)) else [result]
        if isinstance(result, np.ndarray) and result.ndim == 1:
            parts, count = list(result), len(result)
        if not 1 <= count <= 3:
            raise UserFunctionError(
                f"{self.name} returned the wrong thing{at(t)}",
                function=self.name,
                time=t,
                expected="value, (value, rate) or (value, rate, acceleration)",
                got=f"{count} numbers",
                remedy=f"Return one to three numbers from {self.name}; those left out are found by differences",
            )
        return tuple(self._number(value, t, part) for value, part in zip(parts, _PARTS, strict=False))

    def _number(self, value: Any, t: float, part: str) -> float:
        try:
            number = None if np.iscomplexobj(value) else float(value)
        except (TypeError, ValueError, OverflowError):
            number = None
        if number is None or not np.isfinite(number):
            raise UserFunctionError(
                f"{self.name} returned no finite {part}{at(t)}",
                function=self.name,
                time=t,
                entry=part,
                expected="a finite number",
                got=repr(value) if number is None else f"{number}",
                remedy=f"Correct what {self.name} returns as {part} at that time",
            )
        return number

    def _derivatives(self, source: Any) -> tuple[Any, Any, Any]:
        rate = called(source.derivative, f"derivative of {self.name}", None)
        return source, rate, called(rate.derivative, f"derivative of {self.name}", None)


def _plain(source: Any) -> Any:
    try:
        return np.asarray(source, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return [()]  # Its dimension is not that of a number.


def _table(source: Any, name: str) -> tuple[Array, Array]:
    expected = "a number, (times, values) of one length, or a function of t"
    if not isinstance(source, (tuple, list)) or len(source) != 2:
        raise InputError(
            f"Signal {name}",
            name=name,
            expected=expected,
            got=short(source),
            remedy="Give a number for a constant, or lists of numbers ([0.0, 1.0], [0.0, 0.5]) for a table",
        )
    try:
        times, values = (np.array(part, dtype=float) for part in source)
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            f"Signal {name}",
            name=name,
            expected=expected,
            got=short(source),
            remedy="Give a number for a constant, or lists of numbers ([0.0, 1.0], [0.0, 0.5]) for a table",
        ) from None
    if times.ndim != 1 or times.shape != values.shape or len(times) < 2:
        got = f"shapes {times.shape} and {values.shape}"
        raise InputError(
            f"Table of {name}",
            name=name,
            expected="two arrays of one length >= 2",
            got=got,
            remedy="Give one value for each time, and at least two times; a constant is a plain number",
        )
    if not (np.isfinite(times).all() and np.isfinite(values).all()):
        raise InputError(
            f"Table of {name}",
            name=name,
            expected="finite numbers",
            got="nan or inf",
            remedy="Leave out the times at which the value is not known",
        )
    late = np.flatnonzero(times[1:] <= times[:-1])
    if len(late):
        got = f"{times[late[0]]:.9g} before {times[late[0] + 1]:.9g}"
        raise InputError(
            f"Times of {name}",
            name=name,
            expected="times that increase",
            got=got,
            remedy="Sort the table by time, and keep one value for each time",
        )
    return times, values


def _pieces(times: Array, values: Array, name: str) -> tuple[list[float], list[tuple[float, ...]]]:
    """Return the breaks of the cubic spline and the coefficients of its pieces, highest power first.

    Raises:
        InputError: there is no such spline in doubles, or its value, rate or acceleration is too large.
    """
    from scipy.interpolate import CubicSpline
    from scipy.linalg import LinAlgWarning

    # SciPy warns where its linear system has lost its digits, and raises ValueError for coefficients that overflow.
    with warnings.catch_warnings(), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        warnings.simplefilter("error", LinAlgWarning)
        try:
            spline = CubicSpline(times, values, bc_type="not-a-knot")
            largest = max(float(np.abs(spline(times, order)).max()) for order in range(len(_PARTS)))
        except (ValueError, np.linalg.LinAlgError, LinAlgWarning):
            largest = np.inf
        closest = np.diff(times).min()
    if not (largest <= LARGEST and np.isfinite(spline.c).all()):
        raise InputError(
            f"Table of {name}",
            name=name,
            expected=f"a spline whose value, rate and acceleration are at most {LARGEST:g}",
            got=f"values up to {np.abs(values).max():.3g} at times as close as {closest:.3g} s",
            remedy="Give values of another unit, or leave out times next to others",
        )
    return spline.x.tolist(), [tuple(piece) for piece in spline.c.T.tolist()]
