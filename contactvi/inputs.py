"""Checks of arguments: each returns the clean value or raises an InputError that names the argument.

First numbers and choices, then arrays and placements. States of one model are in contactvi.states, settings of a run in
contactvi.run_settings.
"""

from __future__ import annotations

import inspect
import math
import numbers
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.aliases import callers
from contactvi.errors import AngleUnitWarning, InputError, did_you_mean

Array = NDArray[np.float64]
UNIT_TOLERANCE = 1e-6  # of a norm; a quaternion with seven digits passes, one that is not normalised does not

# --- numbers and choices ----------------------------------------------------------------------------------------------


MOST = 2**31 - 1  # of the engine's whole numbers
LARGEST = 1e50  # of numbers that enter a product: energies have up to five factors, and doubles end at 1e308
MOST_STEPS = 2**53  # above, doubles do not tell one number of steps from the next


def real(
    name: str,
    value: Any,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    open_low: bool = False,
    expected: str | None = None,
) -> float:
    """Return a real number (no truth value, no str) as a finite float in [low, high], or (low, high] with `open_low`.

    Numbers beyond 1e50 are refused, because products of them overflow. An array without dimensions, as array libraries
    return numbers, counts as its number. `expected` says in words what the value should be, where the interval alone
    does not.
    """
    number = math.nan
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if isinstance(value, numbers.Real) and not isinstance(value, bool):
        number = as_float(value)
    inside = low < number <= high if open_low else low <= number <= high
    if not abs(number) <= LARGEST or not inside:
        wanted = expected or _interval(low, high, open_low)
        if inside and math.isfinite(number):
            wanted = f"a number of at most {LARGEST:g}"
        raise InputError(
            f"{name} is not usable",
            name=name,
            expected=wanted,
            got=short(value),
            remedy=_number_remedy(value, number, low, high, open_low),
        )
    return number


def as_float(value: Any) -> float:
    """Return a real number as a float; what is too large for one is infinite."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def positive(name: str, value: Any, expected: str) -> float:
    """Return `value` as a finite float > 0; `expected` says in words what it should be."""
    return real(name, value, 0.0, open_low=True, expected=expected)


def _interval(low: float, high: float, open_low: bool) -> str:
    if low == -math.inf and high == math.inf:
        return "a finite number"
    if high == math.inf:
        return f"a finite number {'>' if open_low else '>='} {low:g}"
    return f"a number in {'(' if open_low else '['}{low:g}, {high:g}]"


def _number_remedy(value: Any, number: float, low: float, high: float, open_low: bool) -> str:
    """Return how to make a real number in an interval of what was given; `number` is nan where it is none."""
    if isinstance(value, str):
        return "Write the number without quotes" if value[:1].isdigit() else "Give a number in SI units, without quotes"
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        return "Give one number, such as 0.5" if low < 0.5 < high else "Give one number"
    if not math.isfinite(number):
        return "Give a finite number"
    if abs(number) > LARGEST:
        return "Products of such numbers overflow; use other units"
    if number > high:
        return f"Use {high:g} or less"
    return f"Use a number above {low:g}" if open_low else f"Use {low:g} or more"


def count(name: str, value: Any, most: int = MOST) -> int:
    """Return a whole number from 1 to `most`, by default what the engine can hold."""
    whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not whole or not 1 <= int(value) <= most:
        expected = f"a whole number <= {most}" if whole and int(value) > most else "a whole number >= 1"
        raise InputError(
            f"{name} is not usable", name=name, expected=expected, got=short(value), remedy=_count_remedy(value, most)
        )
    return int(value)


def _count_remedy(value: Any, most: int) -> str:
    """Return how to make a whole number >= 1 of what was given."""
    number = as_float(value) if isinstance(value, numbers.Real) and not isinstance(value, bool) else math.nan
    if math.isfinite(number):
        return f"Use {min(max(round(number), 1), most)}, without a decimal point"
    return "Give a whole number such as 100, without quotes"


def flag(name: str, value: Any) -> bool:
    """Return True or False, NumPy's truth values included."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(
            f"{name} is not usable", name=name, expected="True or False", got=short(value), remedy=_flag_remedy(value)
        )
    return bool(value)


def _flag_remedy(value: Any) -> str:
    """Return which truth value may be meant."""
    if isinstance(value, str):
        return "Write it without quotes"
    if isinstance(value, numbers.Real) and value in (0, 1):
        return f"Write {bool(value)}"
    return "Write True or False; in a scene file true or false"


def callback(name: str, value: Any) -> Any:
    """Return a function or None; raise InputError for anything else."""
    if value is not None and not callable(value):
        raise InputError(
            f"{name} is not usable",
            name=name,
            expected="a function or None",
            got=short(value),
            remedy="Give the function itself, without calling it",
        )
    return value


def check_signature(name: str, function: Any, arguments: tuple[str, ...]) -> None:
    """Raise InputError for a function of the user that cannot be called with these arguments."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # of functions that are not written in Python it is not known
        return
    try:
        signature.bind(*arguments)
    except TypeError:
        raise InputError(
            f"{name} cannot be called",
            name=name,
            expected=f"a function of ({', '.join(arguments)})",
            got=f"one of {signature}",
            remedy=f"Define it as def {name}({', '.join(arguments)}): ...",
        ) from None


def is_text(value: Any) -> bool:
    """Return whether a value is a str that is not empty and can be written in UTF-8 (without lone surrogates)."""
    return isinstance(value, str) and value != "" and value.encode("utf-8", "replace").decode("utf-8") == value


def words(name: str, value: Any) -> str:
    """Return a str, perhaps empty, that can be written in UTF-8; raise InputError for anything else."""
    if not isinstance(value, str) or not (value == "" or is_text(value)):
        raise InputError(
            f"{name} is not usable", name=name, expected="a str in UTF-8", got=short(value), remedy="Write it in quotes"
        )
    return str(value)


def mapping(name: str, value: Any, meaning: str) -> Mapping[Any, Any]:
    """Return a mapping; raise InputError for anything else. meaning: of its keys and values."""
    if not isinstance(value, Mapping):
        raise InputError(
            f"{name} is not usable",
            name=name,
            expected=f"{{{meaning}}}",
            got=short(value),
            remedy="Give a dict; in a scene file a table: { name = value }",
        )
    return value


def listed(name: str, value: Any, meaning: str) -> Sequence[Any]:
    """Return a list or tuple; raise InputError for anything else. meaning: of its entries."""
    if not isinstance(value, (list, tuple)):
        raise InputError(
            f"{name} is not usable",
            name=name,
            expected=f"a list of {meaning}",
            got=short(value),
            remedy="Put it into square brackets, a single one too",
        )
    return value


def check_choice(
    name: str, value: Any, choices: Sequence[str], what: str, remedies: Mapping[str, str] | None = None
) -> None:
    """Raise InputError, saying `what` is wrong, where the value is none of the choices.

    Args:
        remedies: what to do instead of values that users are known to give.
    """
    if isinstance(value, str) and value in choices:
        return
    expected = " | ".join(repr(choice) for choice in choices)
    remedy = (remedies or {}).get(_word(value)) or did_you_mean(_word(value), choices)
    raise InputError(what, name=name, expected=expected, got=short(value), remedy=remedy)


def short(value: Any) -> str:
    """Return repr(value), its end cut off where it is long."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no whole number of more than 4300 digits, inside of lists neither
        text = f"<{type(value).__name__} too long to write>"
    return text if len(text) <= 60 else text[:57] + "..."


def _word(value: Any) -> str:
    """Return the word that was given, or what stands in its place."""
    return value if isinstance(value, str) else short(value)


def entries(value: Any) -> tuple[Any, ...] | None:
    """Return the entries of a collection; None where the value is none.

    That a value has __iter__ does not say so: an array without dimensions has it too.
    """
    try:
        iterator = iter(value)
    except TypeError:
        return None
    return tuple(iterator)


# --- arrays and placements --------------------------------------------------------------------------------------------


def real_numbers(value: Any) -> Array | None:
    """Return a C-contiguous float array of what is given; None where it is not one of real numbers."""
    try:
        if type(value) is np.ndarray and value.dtype == float:
            return np.array(value, order="C")
        return None if np.iscomplexobj(value) else np.array(value, dtype=float, order="C")
    except (TypeError, ValueError, OverflowError):
        return None


def usable(rows: Array) -> Array | None:
    """Return a C-contiguous copy of a float array whose numbers `array` takes; None where some may be none of them."""
    result = np.array(rows, order="C")
    return result if np.vdot(result, result) <= LARGEST * LARGEST else None


def shape_of(value: Any) -> tuple[int, ...]:
    """Return the shape of an array of real numbers; () for what is none, such as rows of different lengths."""
    result = real_numbers(value)
    return () if result is None else result.shape


def array(name: str, value: Any, shape: tuple[int, ...], meaning: str, remedy: str | None = None) -> Array:
    """Return `value` as a C-contiguous float array of this shape with numbers up to 1e50, or raise InputError."""
    result = real_numbers(value)
    if result is None:
        raise InputError(
            f"{name} is not an array of numbers",
            name=name,
            expected=f"{meaning}, shape {shape}",
            got=short(value),
            remedy="Give plain numbers in a list or a NumPy array, in rows of one length",
        )
    if result.shape != shape:
        if remedy is None:
            remedy = f"Give {shape[0]} numbers in one list" if len(shape) == 1 else f"Give an array of shape {shape}"
        raise InputError(
            f"{name} has the wrong shape",
            name=name,
            expected=f"{meaning}, shape {shape}",
            got=f"shape {result.shape}",
            remedy=remedy,
        )
    if np.vdot(result, result) <= LARGEST * LARGEST:  # of nearly all arrays: then each number is usable
        return result
    if not np.isfinite(result).all():
        bad = np.argwhere(~np.isfinite(result))
        at = ", ".join(str(i) for i in bad[0])
        raise InputError(
            f"{name} is not finite",
            name=name,
            expected="finite numbers",
            got=f"{result[tuple(bad[0])]} at index {at}" + (f" and {len(bad) - 1} more" if len(bad) > 1 else ""),
            remedy=f"Replace the {result[tuple(bad[0])]} at index {at} by a number",
        )
    if result.size and np.abs(result).max() > LARGEST:
        largest = float(np.abs(result).max())
        raise InputError(
            f"{name} is too large",
            name=name,
            expected=f"numbers of at most {LARGEST:g}",
            got=f"{largest:g}",
            remedy="Products of such numbers overflow; use other units",
        )
    return result


def vector(name: str, value: Any, size: int) -> Array:
    """Return `value` as an array of finite numbers, shape (size,)."""
    return array(name, value, (size,), f"{size} numbers")


def unit_vector(name: str, value: Any) -> Array:
    """Return the direction of a nonzero 3-vector, shape (3,)."""
    array = vector(name, value, 3)
    length = math.hypot(*array)  # which squares nothing: a huge vector has a direction too
    if not 1e-12 <= length < math.inf:
        raise InputError(
            f"Direction {name}",
            name=name,
            expected="a nonzero vector of finite length",
            got=str(array),
            remedy="Give a direction such as (0, 0, 1); its length does not matter",
        )
    return array / length


def unit_quaternion(name: str, value: Any) -> Array:
    """Return a quaternion (x, y, z, w), which must have unit length to 1e-6, normalised."""
    array = vector(name, value, 4)
    length = math.hypot(*array)
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise InputError(
            f"Quaternion {name}",
            name=name,
            expected="(x, y, z, w) of length 1",
            got=f"{array} of length {length:.9g}",
            remedy="Divide it by its length, and mind the order: w comes last",
        )
    return array / length


def pose(name: str, value: Any, told: bool = False) -> pin.SE3:
    """Return a placement from None, pin.SE3, xyz, (xyz, rpy), (xyz, quaternion xyzw), these 7 numbers or a 4x4 matrix.

    Lengths in m, roll-pitch-yaw in rad as in URDF (R = Rz(yaw) Ry(pitch) Rx(roll)); of angles that may be degrees it
    warns, unless that was told before.
    """
    if value is None:
        return pin.SE3.Identity()
    if isinstance(value, pin.SE3):
        _check_pose(name, value)
        return value.copy()
    shape = shape_of(value)
    if isinstance(value, Sequence) and len(value) == 2 and not isinstance(value, str) and shape != (2,):
        xyz = vector(f"{name} xyz", value[0], 3)
        if shape_of(value[1]) == (4,):
            return pin.XYZQUATToSE3(np.concatenate([xyz, unit_quaternion(name, np.asarray(value[1], dtype=float))]))
        rpy = vector(f"{name} rpy", value[1], 3)
        if not told:
            warn_of_degrees(f"{name} rpy", rpy)
        return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)
    if shape == (3,):
        return pin.SE3(np.eye(3), vector(name, value, 3))
    if shape == (7,):
        array = np.asarray(value, dtype=float)
        return pin.XYZQUATToSE3(np.concatenate([vector(name, array[:3], 3), unit_quaternion(name, array[3:])]))
    if shape == (4, 4):
        matrix = np.asarray(value, dtype=float)
        placement = pin.SE3(matrix[:3, :3], matrix[:3, 3])
        _check_pose(name, placement)
        return placement
    raise InputError(
        f"Placement {name}",
        name=name,
        expected="None, xyz, (xyz, rpy), xyz + quaternion xyzw, a 4x4 matrix or pin.SE3",
        got=short(value),
        remedy="Give a position (x, y, z), or ((x, y, z), (roll, pitch, yaw)) with a turn",
    )


def warn_of_degrees(name: str, angles: Any) -> None:
    """Warn (AngleUnitWarning) of angles [rad] of more than a turn: they may be degrees."""
    largest = float(np.abs(angles).max(initial=0.0))
    if largest > 2.0 * math.pi:
        warnings.warn(
            f"{name}: {largest:g} rad is more than a turn. Angles are in rad: np.deg2rad({largest:g}) ="
            f" {math.radians(largest):.4g}, if these are degrees",
            AngleUnitWarning, stacklevel=callers(),
        )  # fmt: skip


def is_rigid(matrix: Array) -> bool:
    """Return whether a homogeneous matrix (4, 4) has finite numbers and a rotation (to 1e-6)."""
    turn = matrix[:3, :3]
    if not np.all(np.isfinite(matrix)) or np.any(np.abs(turn) > 1.0 + UNIT_TOLERANCE):  # products may overflow
        return False
    near = np.allclose(turn @ turn.T, np.eye(3), atol=UNIT_TOLERANCE) and np.linalg.det(turn) > 0.0
    return bool(near and matrix[3].tolist() == [0.0, 0.0, 0.0, 1.0])


def _check_pose(name: str, placement: pin.SE3) -> None:
    """Raise an InputError unless the numbers are finite and the rotation is one (to 1e-6)."""
    matrix = placement.homogeneous
    if not is_rigid(matrix):
        raise InputError(
            f"Placement {name}",
            name=name,
            expected="a finite rigid placement",
            got=str(matrix.tolist()),
            remedy="Make the 3x3 part a rotation (orthogonal, determinant 1), for example pin.rpy.rpyToMatrix(r, p, y)",
        )
