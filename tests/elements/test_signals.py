"""Signals: values, rates and accelerations of numbers, tables, functions and splines; anything else is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import contactvi as cvi
from contactvi.elements.signals import Signal

EPS = np.finfo(float).eps
TIMES = np.linspace(0.0, 2.0, 21)


@pytest.mark.parametrize(
    ("source", "got"),
    [
        (None, "None"),
        ("fast", "'fast'"),
        (math.nan, "nan"),
        ([1.0, 2.0, 3.0], "[1.0, 2.0, 3.0]"),
        ((TIMES, TIMES[:-1]), "shapes (21,) and (20,)"),
        (([0.0], [1.0]), "shapes (1,) and (1,)"),
        (([0.0, 1.0, 1.0], [0.0, 0.0, 0.0]), "1 before 1"),
        (([0.0, math.inf], [0.0, 0.0]), "nan or inf"),
        ({"times": [0.0, 1.0]}, "{'times': [0.0, 1.0]}"),
    ],
)
def test_what_is_no_signal_is_refused(source, got):
    with pytest.raises(cvi.InputError) as caught:
        Signal(source, "motion of 'j'")
    assert caught.value.name == "motion of 'j'"
    assert got in str(caught.value.got)


@pytest.mark.parametrize(
    ("times", "values"),
    [
        ([0.0, 1.0, 2.0], [0.0, 1.7e308, 0.3]),
        ([0.0, 1.0, 2.0, 3.0], [0.0, 1e60, 0.3, 0.0]),
        ([0.0, 1.0], [-1e308, 1e308]),
        ([-1.7e308, 1.7e308], [0.0, 1.0]),
        ([0.0, 5e-324], [0.0, 1.0]),
        ([0.0, 5e-324, 1.0], [0.0, 1.0, 2.0]),
        ([0.0, 1e-20, 2e-20], [0.0, 1.0, 0.0]),
        ([0.0, 1e-40, 1.0, 2.0], [0.0, 1.0, 0.0, 1.0]),
        ([-1.7e308, 0.0, 1.7e308, 1.75e308], [0.0, 1.0, 0.0, 1.0]),
    ],
)
@pytest.mark.filterwarnings("error")
def test_tables_whose_spline_overflows_are_refused(times, values):
    with pytest.raises(cvi.InputError, match="a spline whose value, rate and acceleration are at most") as caught:
        Signal((times, values), "motion of 'j'")
    assert caught.value.name == "motion of 'j'"
    assert f"{np.abs(values).max():.3g}" in caught.value.got
    assert caught.value.remedy


def failing(t: float) -> float:
    raise KeyError("no such key")


@pytest.mark.parametrize(
    ("function", "entry", "text"),
    [
        (failing, None, "KeyError"),
        (lambda t: math.nan, "value", "nan"),
        (lambda t: (0.0, math.inf), "rate", "inf"),
        (lambda t: (0.0, 0.0, "x"), "acceleration", "'x'"),
        (lambda t: (1, 2, 3, 4), None, "4 numbers"),
        (lambda t: np.zeros((2, 2)), "value", "array"),
    ],
)
def test_functions_that_fail_are_named_with_the_time(function, entry, text):
    with pytest.raises(cvi.UserFunctionError) as caught:
        Signal(function, "motion of 'j'")(0.25)
    error = caught.value
    assert (error.function, error.time, error.entry) == ("motion of 'j'", 0.25, entry)
    assert "at t = 0.25 s" in str(error)
    assert text in str(error)
    assert isinstance(error, cvi.InputError)


def test_the_cause_is_kept():
    with pytest.raises(cvi.UserFunctionError) as caught:
        Signal(failing, "motion")(0.0)
    assert isinstance(caught.value.__cause__, KeyError)


def test_a_number_stands_still():
    assert Signal(2, "x")(5.0) == (2.0, 0.0, 0.0)


def test_a_table_is_a_spline_with_continuous_acceleration():
    signal = Signal((TIMES, TIMES**3 - TIMES), "x")  # Not-a-knot splines reproduce a cubic exactly.
    for t in (0.0, 0.333, 1.0, 2.0):
        assert signal(t) == pytest.approx((t**3 - t, 3 * t**2 - 1, 6 * t), abs=1e4 * EPS)
    bent = Signal((TIMES, np.abs(TIMES - 1.0)), "x")
    for k in range(1, 20):
        before, after = bent(TIMES[k] - 1e-9), bent(TIMES[k] + 1e-9)
        assert before == pytest.approx(after, abs=1e-5)  # third derivative times 2e-9


def test_a_table_ends_where_it_ends():
    signal = Signal((TIMES, TIMES), "motion of 'j'")
    assert signal(2.0 + 1e-10)[0] == pytest.approx(2.0)  # A run's last time is off by rounding.
    with pytest.raises(cvi.UserFunctionError, match=r"outside its table at t = 2.5 s: expected times within 0 .. 2 s"):
        signal(2.5)


def test_missing_derivatives_follow_from_differences():
    def exact(t: float) -> tuple[float, float, float]:
        return math.sin(3 * t), 3 * math.cos(3 * t), -9 * math.sin(3 * t)

    for given in (1, 2, 3):
        signal = Signal(lambda t, n=given: exact(t)[0] if n == 1 else exact(t)[:n], "x")
        value, rate, acceleration = signal(0.7)
        wanted = exact(0.7)
        assert value == wanted[0]
        assert rate == pytest.approx(wanted[1], abs=1e-10)  # eps / 1e-4 s
        assert acceleration == pytest.approx(wanted[2], abs=1e-8)  # eps / (1e-3 s)^2


def test_a_spline_of_scipy_brings_its_derivatives():
    spline = CubicSpline(TIMES, np.sin(TIMES))
    assert Signal(spline, "x")(0.6) == pytest.approx([float(spline(0.6, k)) for k in range(3)], abs=1e4 * EPS)


def test_data_survive_and_functions_do_not():
    for source in (1.5, (TIMES, TIMES**2)):
        signal = Signal(source, "x")
        assert signal.storable
        again = Signal(signal.to_data(), "x")
        assert again(0.4) == signal(0.4)
    assert not Signal(math.sin, "x").storable


def test_a_function_is_asked_once_for_an_instant():
    calls = []

    def motion(t: float) -> tuple[float, float, float]:
        calls.append(t)
        return 0.0, 0.0, 0.0

    signal = Signal(motion, "x")
    for _ in range(3):
        signal(0.5)
    assert calls == [0.5]
