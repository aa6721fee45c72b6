"""Laws of contacts given by functions of arrays, or compiled: a number for one to three numbers of many contacts.

Derivatives that are not given are found by central differences of fourth order, from points that stay on the side of
zero on which the law is known. The normal force of an impact is infinite; by it there is no derivative.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from contactvi.elements.user_functions import called, checked
from contactvi.errors import InputError, SceneError, UserFunctionError
from contactvi.inputs import short

Array = NDArray[np.float64]
# Of a number, of its differences: their error is then that of the fifth derivative times 1e-16, and rounding 1e-12.
_STEP = 1e-4
_AGREE = 1e-5  # of the largest derivative: what given ones and differences may differ by


@dataclass(frozen=True)
class Number:
    """One of the numbers that a law depends on.

    Attributes:
        name, unit: for messages.
        least: size below which it is taken as this for the steps of differences.
        signed: whether it may be negative.
    """

    name: str
    unit: str
    least: float
    signed: bool = False


DEPTH = Number("depth", "m", 1e-12)
RATE = Number("rate", "m/s", 1e-3, True)
NORMAL = Number("normal force", "N", 1e-9)
SLIP = Number("slip", "m/s", 1e-6)
CLOSING = Number("closing speed", "m/s", 1e-6)
TIME = Number("time", "s", 1e-3, True)


@dataclass(frozen=True, eq=False)
class ContactFunction:
    """A law of contacts.

    Attributes:
        name: for messages.
        numbers: what it depends on, one to three.
        function: of arrays (n,), one for each number, returns (n,); or compiled, with an `address`; None: a stored
            scene has lost it.
        derivatives: of the same arrays, returns one array (n,) for each number; None: by differences.
        meaning: of the value, with its unit.
        pushes: whether the value may not be negative.
        most: the largest value that it may have.
    """

    storable: ClassVar[bool] = False

    name: str
    numbers: tuple[Number, ...]
    function: Callable[..., Any] | None
    derivatives: Callable[..., Any] | None
    meaning: str
    pushes: bool = False
    most: float = np.inf

    def __deepcopy__(self, memo: dict[int, Any]) -> ContactFunction:
        """Return itself: a constant, whose functions need not be ones that can be copied."""
        return self

    @property
    def address(self) -> int | None:
        """The address of a compiled function."""
        address = getattr(self.function, "address", None)
        return address if isinstance(address, int) else None

    def put(self, scene: Any, pair: tuple[str, str]) -> int:
        """Hand it to the engine's scene; returns its number there. Raises SceneError without a function."""
        if self.function is None:
            raise SceneError(
                f"The compliance of {pair[0]!r} and {pair[1]!r} has no law", expected="the function that gave it",
                got="a stored scene, which cannot hold functions",
                remedy=f"Give it again: scene.set_compliance({pair[0]!r}, {pair[1]!r}, law=...)",
            )  # fmt: skip
        return self.added(scene)

    def added(self, scene: Any) -> int:
        """Hand it to the engine's scene; returns its number there."""
        given = self.rows if self.address is None else self.address
        return int(scene.add_contact_function(given, len(self.numbers)))

    def rows(self, points: Array, derivatives: bool) -> Array:
        """Return rows of the value (n, 1), or of value and derivatives, at rows of two or three numbers.

        With derivatives (n, 3) of one or two numbers, (n, 4) of three.

        Raises:
            UserFunctionError: the function raised, or returned something else than finite numbers of the right shape.
        """
        if not derivatives:
            return self.values(points)[:, None]
        rows = np.zeros((len(points), 1 + max(2, len(self.numbers))))
        rows[:, 0] = self.values(points)
        rows[:, 1 : 1 + len(self.numbers)] = self.slopes(points)
        return rows

    def values(self, points: Array) -> Array:
        """Return the values at rows of numbers, shape (n,); raises as `rows`."""
        if self.address is not None:
            return _compiled(self.address, len(self.numbers), points)[:, 0]
        assert self.function is not None
        return self._asked(self.function, self.name, points)

    def slopes(self, points: Array) -> Array:
        """Return the derivatives by each number at rows of them, shape (n, numbers); raises as `rows`."""
        if self.address is not None and len(self.numbers) > 1:
            return _compiled(self.address, len(self.numbers), points)[:, 1:]
        if self.derivatives is None:
            return self.differences(points)
        impacts = np.isinf(points).any(axis=1)
        if impacts.any():
            found = np.zeros((len(points), len(self.numbers)))
            found[impacts] = self.differences(points[impacts])
            if not impacts.all():
                found[~impacts] = self.slopes(points[~impacts])
            return found
        what, columns = f"the derivatives of {self.name}", points.T[: len(self.numbers)]
        value = called(self.derivatives, what, None, *columns)
        if not isinstance(value, (tuple, list)) or len(value) != len(self.numbers):
            raise UserFunctionError(
                f"{what} are not {len(self.numbers)} arrays", function=what,
                expected=" and ".join(f"the derivatives by the {number.name}" for number in self.numbers),
                got=short(value), remedy="Return one array for each, as a tuple",
            )  # fmt: skip
        shape = (len(points),)
        return np.stack([checked(part, what, None, shape, "one number for each contact") for part in value], axis=1)

    def differences(self, points: Array) -> Array:
        """Return the derivatives by differences; see `slopes`."""
        count = len(self.numbers)
        steps, places = np.zeros((len(points), count)), []
        for k, number in enumerate(self.numbers):
            size = np.maximum(np.abs(points[:, k]), number.least)
            steps[:, k] = np.where(np.isinf(size), 1.0, _STEP * size)
            for by in (-2.0, -1.0, 1.0, 2.0):
                moved = points.copy()
                moved[:, k] = (points[:, k] if number.signed else size) + by * steps[:, k]
                places.append(moved)
        values = self.values(np.concatenate(places)).reshape(count, 4, len(points))
        sums = np.einsum("kin,i->nk", values, np.array([1.0, -8.0, 8.0, -1.0]))
        return np.asarray(sums / (12.0 * steps))

    def _asked(self, function: Callable[..., Any], what: str, points: Array) -> Array:
        columns = np.ascontiguousarray(points.T[: len(self.numbers)])
        value = called(function, what, None, *columns)
        asks = f"{self.meaning} of each contact: it gets arrays of shape {columns[0].shape}, and returns one"
        found = checked(value, what, None, (len(points),), asks)
        bad = self._forbidden(found)
        if bad.any():
            k = int(np.argmax(bad))
            upper = "" if np.isinf(self.most) else f" and <= {self.most:g}"
            raise UserFunctionError(
                f"{what} is outside of its range" if upper else f"{what} is negative", function=what,
                expected=f"{self.meaning} >= 0{upper}, or it would make energy",
                got=f"{found[k]:.6g} at {self._at(points[k])}", remedy="Correct the function, or clip what it returns",
            )  # fmt: skip
        return found

    def check(self, argument: str, points: Array) -> None:
        """Try the function at rows of numbers.

        Raises:
            UserFunctionError: see `rows`.
            InputError: values that are not finite; given derivatives that are not those of the function.
        """
        values, given = self.values(points), self.slopes(points)
        bad = ~(np.isfinite(values) & np.isfinite(given).all(axis=1)) | self._forbidden(values)
        if bad.any():
            raise InputError(
                f"{self.name} is not usable", name=argument,
                expected="finite numbers and derivatives" + (", values >= 0" if self.pushes else "")
                + ("" if np.isinf(self.most) else f" and <= {self.most:g}"),
                got=f"{values[bad][0]} at {self._at(points[bad][0])}",
                remedy="Look in the function for a division by zero, or for a root or logarithm of a negative number",
            )  # fmt: skip
        if self.derivatives is None and self.address is None:
            return
        found = self.differences(points)
        off = np.abs(given - found).max(axis=1)
        scale = np.abs(found).max(axis=1) + np.abs(values) * 1e-6 + np.finfo(float).tiny
        # At a kink differences say nothing: most of the points decide.
        if np.median(off / scale) > _AGREE:
            k = int(np.argsort(off / scale)[len(off) // 2])
            raise InputError(
                f"The derivatives of {self.name} are not its own", name="derivatives",
                expected=f"{short(found[k].tolist())} at {self._at(points[k])}, by differences",
                got=short(given[k].tolist()), remedy="Correct them, or leave them out: differences are taken then",
            )  # fmt: skip

    def _forbidden(self, values: Array) -> NDArray[np.bool_]:
        """Whether values are beyond their range, each."""
        return (self.pushes & (values < 0.0)) | (values > self.most)

    def _at(self, point: Array) -> str:
        numbers = zip(self.numbers, point.tolist(), strict=False)
        return ", ".join(f"{number.name} {value:g} {number.unit}" for number, value in numbers)


def contact_function(
    argument: str, name: str, numbers: tuple[Number, ...], function: Any, derivatives: Any, meaning: str,
    pushes: bool = False, most: float = np.inf,
    example: str = "law=lambda depth, rate: 1e5 * depth**1.5 * (1 + 0.3 * rate)",
) -> ContactFunction:  # fmt: skip
    """Return a law of checked arguments. Raises InputError."""
    compiled = isinstance(getattr(function, "address", None), int)
    if not callable(function) and not compiled:
        raise InputError(
            f"{name} is no function", name=argument,
            expected=f"a function of {' and '.join(number.name for number in numbers)}, arrays of shape (n,), or an "
            "object with the address of a C function", got=short(function),
            remedy=f"For example {example}",
        )  # fmt: skip
    if derivatives is not None and (compiled or not callable(derivatives)):
        raise InputError(
            f"The derivatives of {name}", name="derivatives",
            expected="None: a compiled function sets them itself" if compiled else "a function, or None",
            got=short(derivatives), remedy="Leave them out: they are then found by differences",
        )  # fmt: skip
    return ContactFunction(name, numbers, function, derivatives, meaning, pushes, most)


def state_law(argument: str, name: str, numbers: tuple[Number, ...], value: Any, meaning: str, most: float,
              samples: Array, example: str) -> ContactFunction:  # fmt: skip
    """Return a coefficient that is a function of the state of a contact, checked and tried at samples (n, numbers).

    Args:
        value: the function, compiled or not, or a pair of it and its derivatives.

    Raises:
        InputError: no function, or derivatives that are not its own.
        UserFunctionError: it failed, or its values are not finite or beyond their range.
    """
    derivatives = None
    if isinstance(value, (tuple, list)):
        if len(value) != 2:
            raise InputError(
                f"{argument} is not usable", name=argument, expected="a function, or a pair of it and its derivatives",
                got=f"{len(value)} things", remedy=f"For example {argument}=(law, derivatives)",
            )  # fmt: skip
        value, derivatives = value
    found = contact_function(argument, name, numbers, value, derivatives, meaning, True, most, example)
    impacts = np.isinf(samples).any(axis=1)
    found.check(argument, samples[~impacts])
    if impacts.any():
        try:
            found.check(argument, samples[impacts])
        except UserFunctionError as error:
            raise InputError(
                f"{name} has no value in an impact", name=argument,
                expected=f"{meaning} also at an infinite normal force, which impacts have", got=str(error.got),
                remedy="Return there what bodies have that hit each other: np.where(np.isinf(normal), 0.3, ...)",
            ) from error  # fmt: skip
    return found


def _compiled(address: int, numbers: int, points: Array) -> Array:
    """Call a compiled function at each point, as the engine does: rows of value and derivatives."""
    rows = np.full((len(points), 1 + max(2, numbers)), np.nan)
    if numbers == 1:
        of_one = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(address)
        rows[:, 0] = [of_one(float(point[0])) for point in points]
        return rows
    function = ctypes.CFUNCTYPE(None, *[ctypes.c_double] * numbers, ctypes.POINTER(ctypes.c_double))(address)
    for point, row in zip(points.tolist(), rows, strict=True):
        function(*point[:numbers], row.ctypes.data_as(ctypes.POINTER(ctypes.c_double)))
    return rows
