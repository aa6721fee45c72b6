"""Functions of the user, wrapped so that what they return has the right shape and finite numbers.

A wrapped function raises UserFunctionError with the name of the function, the time and the entry; what the user's own
code raised is its cause. KeyboardInterrupt passes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import UserFunctionError
from contactvi.inputs import real_numbers

Array = NDArray[np.float64]
Function = Callable[..., Any]


def called(function: Function, name: str, t: float | None, *arguments: Any) -> Any:
    """Return function(*arguments); every error of it becomes a UserFunctionError."""
    try:
        return function(*arguments)
    except UserFunctionError:
        raise
    except Exception as error:
        text = str(error).splitlines()
        raise UserFunctionError(
            f"{name} failed{at(t)}",
            function=name,
            time=t,
            expected="a function that returns numbers for every state of the run",
            got=f"{type(error).__name__}: {text[0]}" if text else type(error).__name__,
            remedy="Correct the function; the traceback above shows where it failed",
        ) from error


def checked(
    value: Any, name: str, t: float | None, shape: tuple[int, ...], meaning: str, dofs: Sequence[str] = ()
) -> Array:
    """Return `value` as a float array of this shape with finite numbers.

    Args:
        name: of the function.
        t: when it was called [s], None where that means nothing.
        meaning: of the numbers, for the message.
        dofs: names of the degrees of freedom along the axes, to name an entry.

    Raises:
        UserFunctionError: not numbers, another shape, nan or inf.
    """
    array = real_numbers(value)
    if array is None or array.shape != shape:
        got = "None" if value is None else type(value).__name__ if array is None else f"shape {array.shape}"
        raise UserFunctionError(
            f"{name} returned the wrong shape{at(t)}",
            function=name,
            time=t,
            expected=f"{meaning}, shape {shape}",
            got=got,
            remedy=f"Return np.array(...) of shape {shape} from the function"
            if shape
            else "Return one number from the function",
        )
    # The sum of the squares of nearly all is finite: then each number is.
    if not np.isfinite(np.vdot(array, array)) and not np.isfinite(array).all():
        bad = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        entry = entry_name(bad, dofs)
        raise UserFunctionError(
            f"{name} returned a number that is not finite{at(t)}",
            function=name,
            time=t,
            entry=entry,
            expected="finite numbers",
            got=f"{array[bad]} {entry}".strip(),
            remedy="Look in the function for a division by zero, or for a root or logarithm of a negative number",
        )
    return array


def at(t: float | None) -> str:
    """Return " at t = ... s", nothing for None."""
    return "" if t is None else f" at t = {t:.9g} s"


def entry_name(index: Sequence[int], dofs: Sequence[str] = ()) -> str:
    """Return "at entry 3 (elbow)" or "in row 1 (base), column 3 (elbow)"; nothing for a number alone."""
    words = [f"{i} ({dofs[i]})" if i < len(dofs) else str(i) for i in index]
    if len(words) == 2:
        return f"in row {words[0]}, column {words[1]}"
    return f"at entry {words[0]}" if words else ""


def checked_force(function: Function, name: str, dofs: Sequence[str]) -> Function:
    """Return f(t, q, v) -> (nv,) [N; N m] that checks what `function` returns."""
    shape = (len(dofs),)

    def force(t: float, q: Array, v: Array) -> Array:
        return checked(called(function, name, t, t, q, v), name, t, shape, "one generalized force", dofs)

    return force


def checked_force_derivatives(function: Function, name: str, dofs: Sequence[str]) -> Function:
    """Return d(t, q, v) -> (df_dq, df_dv), (nv, nv) each, that checks what `function` returns."""
    shape = (len(dofs), len(dofs))

    def derivatives(t: float, q: Array, v: Array) -> tuple[Array, Array]:
        value = called(function, name, t, t, q, v)
        if not isinstance(value, (tuple, list)) or len(value) != 2:
            got = f"{type(value).__name__}" + (f" of {len(value)}" if isinstance(value, (tuple, list)) else "")
            raise UserFunctionError(
                f"{name} returned the wrong thing{at(t)}",
                function=name,
                time=t,
                expected="the pair (df_dq, df_dv)",
                got=got,
                remedy="Return both matrices: return df_dq, df_dv",
            )
        first, second = (
            checked(matrix, f"{part} of {name}", t, shape, "derivatives in the tangent space", dofs)
            for matrix, part in zip(value, ("df_dq", "df_dv"), strict=True)
        )
        return first, second

    return derivatives


def checked_of_q(function: Function, name: str, dofs: Sequence[str], axes: int) -> Function:
    """Return f(q) -> a float (axes 0), an array (nv,) (1) or (nv, nv) (2) that checks what `function` returns."""
    meaning = ("an energy in joules", "a gradient in the tangent space", "a Hessian in the tangent space")[axes]

    def of_q(q: Array) -> Any:
        value = checked(called(function, name, None, q), name, None, (len(dofs),) * axes, meaning, dofs)
        return value if axes else float(value)

    return of_q


def checked_wrench(force: Any, torque: Any, name: str) -> Any:
    """Return a wrench (6,) [N, N m], force then torque: an array of constants, or t -> (6,) where one is a function."""
    parts = [np.zeros(3) if part is None else part for part in (force, torque)]
    if not any(callable(part) for part in parts):
        return np.concatenate([np.asarray(part, dtype=float) for part in parts])

    def wrench(t: float) -> Array:
        values = [
            checked(called(part, f"the {what} of {name}", t, t), f"the {what} of {name}", t, (3,), "x, y, z")
            if callable(part)
            else part
            for part, what in zip(parts, ("force", "torque"), strict=True)
        ]
        return np.concatenate(values)

    return wrench
