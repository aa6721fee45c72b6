"""Numbers that depend on another one, a speed or the time: tables, functions of Python, compiled functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactvi.elements.user_functions import called, checked
from contactvi.errors import InputError, UserFunctionError
from contactvi.inputs import array, real, real_numbers, short


@dataclass(frozen=True)
class NumberTable:
    """A number given by a table: straight lines between places, constant beyond the ends."""

    places: tuple[float, ...]
    values: tuple[float, ...]
    storable = True

    def at(self, place: float, name: str = "") -> float:
        """Return the number at a place; `name` is for messages."""
        return float(np.interp(place, self.places, self.values))

    def engine(self, name: str) -> Any:
        """Return it as the engine takes it."""
        return list(self.places), list(self.values)

    def to_data(self) -> Any:
        """Return it as plain data."""
        return [list(self.places), list(self.values)]


@dataclass(frozen=True)
class NumberCallable:
    """A number given by a function of Python, or compiled, by the address of a C function double f(double)."""

    function: Callable[[float], float]
    low: float
    high: float
    unit: str
    storable = False

    def at(self, place: float, name: str) -> float:
        """Return the number at a place; `name` is for the messages of what goes wrong in the function."""
        return self._value(name, place)

    def engine(self, name: str) -> Any:
        """Return it as the engine takes it; `name` is for the messages of what goes wrong in it."""
        address = getattr(self.function, "address", None)
        if isinstance(address, int):
            return address

        return lambda place: self._value(name, place)

    def _value(self, name: str, place: float) -> float:
        result = float(checked(called(self.function, name, None, place), name, None, (), "one number"))
        if not self.low <= result <= self.high:
            raise UserFunctionError(
                f"{name} is outside of its range at {place:.6g} {self.unit}", function=name,
                expected=f"a number in [{self.low:g}, {self.high:g}]", got=f"{result:.6g}",
                remedy="Correct the function, or clip what it returns",
            )  # fmt: skip
        return result


NumberFunction = NumberTable | NumberCallable


def number_function(name: str, value: Any, low: float, high: float, unit: str = "m/s") -> NumberFunction:
    """Return a checked number that depends on a speed or on the time, with values in [low, high].

    Args:
        value: a table (n, 2) of places (speeds, times) and values, a function of the place, or a compiled one with an
            `address` (numba.cfunc with the signature float64(float64)).
        unit: of the places.

    Raises:
        InputError: neither, or places that do not ascend, or values that are outside.
    """
    if callable(value):
        return NumberCallable(value, low, high, unit)
    what = f"a table of rows (place in {unit}, value), places ascending from 0 or more"
    rows = real_numbers(value)
    if rows is None or rows.ndim != 2 or rows.shape[1] != 2 or not len(rows):
        raise InputError(
            f"{name} is not usable", name=name, expected=f"a number, {what}, or a function",
            got=short(value), remedy=f"For example {name}=[(0, 0.8), (1, 0.5)]",
        )  # fmt: skip
    rows = array(name, value, rows.shape, what)
    if rows[0, 0] < 0.0 or np.any(np.diff(rows[:, 0]) <= 0.0):
        raise InputError(
            f"The places of {name} do not ascend", name=name, expected=what, got=short(rows[:, 0].tolist()),
            remedy="Sort the rows by their first number, each once",
        )  # fmt: skip
    for number in rows[:, 1]:
        real(f"a value of {name}", float(number), low, high)
    return NumberTable(tuple(map(float, rows[:, 0])), tuple(map(float, rows[:, 1])))
