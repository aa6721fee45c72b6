"""Checks of numbers given by the user: each returns the clean value or raises an InputError naming the argument."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.errors import InputError

QUATERNION_TOLERANCE = 1e-6  # a quaternion typed with 7 digits is accepted, then normalised


def real(name: str, value: Any, low: float = -math.inf, high: float = math.inf, *, open_low: bool = False) -> float:
    """Return `value` as a finite float in [low, high], or (low, high] with `open_low`."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    inside = low < number <= high if open_low else low <= number <= high
    if isinstance(value, (bool, str)) or not math.isfinite(number) or not inside:
        raise InputError(f"Value of {name}", name=name, expected=_interval(low, high, open_low), got=short(value))
    return number


def _interval(low: float, high: float, open_low: bool) -> str:
    if low == -math.inf and high == math.inf:
        return "a finite number"
    if high == math.inf:
        return f"a finite number {'>' if open_low else '>='} {low:g}"
    return f"a number in {'(' if open_low else '['}{low:g}, {high:g}]"


def short(value: Any) -> str:
    """Return repr(value), its end cut off where it is long."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def flag(name: str, value: Any) -> bool:
    """Return True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"Argument {name}", name=name, expected="True or False", got=repr(value))
    return bool(value)


def vector(name: str, value: Any, size: int) -> np.ndarray:
    """Return `value` as a finite float array of shape (size,)."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"Value of {name}", name=name, expected=f"{size} numbers", got=short(value)) from None
    if array.shape != (size,):
        raise InputError(f"Shape of {name}", name=name, expected=f"({size},)", got=str(array.shape))
    if not np.all(np.isfinite(array)):
        raise InputError(f"Values of {name}", name=name, expected="finite numbers", got=str(array))
    return array.copy()


def unit_vector(name: str, value: Any) -> np.ndarray:
    """Return the direction of a nonzero 3-vector, shape (3,)."""
    array = vector(name, value, 3)
    length = float(np.linalg.norm(array))
    if length < 1e-12:
        raise InputError(f"Direction {name}", name=name, expected="a nonzero vector", got=str(array))
    return array / length


def unit_quaternion(name: str, value: Any) -> np.ndarray:
    """Return a quaternion (x, y, z, w), which must have unit length to 1e-6, normalised."""
    array = vector(name, value, 4)
    length = float(np.linalg.norm(array))
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise InputError(
            f"Quaternion {name}",
            name=name,
            expected="(x, y, z, w) of length 1",
            got=f"{array} of length {length:.9g}",
            remedy="Divide it by its length, and mind the order: w comes last",
        )
    return array / length


def pose(name: str, value: Any) -> pin.SE3:
    """Return a placement from None, pin.SE3, xyz, (xyz, rpy), 7 numbers (xyz, quaternion xyzw) or a 4x4 matrix.

    Lengths in m, roll-pitch-yaw in rad as in URDF (R = Rz(yaw) Ry(pitch) Rx(roll)).
    """
    if value is None:
        return pin.SE3.Identity()
    if isinstance(value, pin.SE3):
        check_finite_pose(name, value)
        return value.copy()
    if isinstance(value, Sequence) and len(value) == 2 and not isinstance(value, str):
        xyz, rpy = vector(f"{name} xyz", value[0], 3), vector(f"{name} rpy", value[1], 3)
        return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)
    shape = np.shape(value) if not isinstance(value, (str, dict)) else ()
    if shape == (3,):
        return pin.SE3(np.eye(3), vector(name, value, 3))
    if shape == (7,):
        array = np.asarray(value, dtype=float)
        return pin.XYZQUATToSE3(np.concatenate([vector(name, array[:3], 3), unit_quaternion(name, array[3:])]))
    if shape == (4, 4):
        matrix = np.asarray(value, dtype=float)
        placement = pin.SE3(matrix[:3, :3], matrix[:3, 3])
        check_finite_pose(name, placement)
        return placement
    raise InputError(
        f"Placement {name}",
        name=name,
        expected="None, xyz, (xyz, rpy), xyz + quaternion xyzw, a 4x4 matrix or pin.SE3",
        got=repr(value),
    )


def check_finite_pose(name: str, placement: pin.SE3) -> None:
    """Raise an InputError unless the numbers are finite and the rotation is one (to 1e-6)."""
    matrix = placement.homogeneous
    rotation = matrix[:3, :3]
    good = np.all(np.isfinite(matrix)) and np.allclose(rotation @ rotation.T, np.eye(3), atol=QUATERNION_TOLERANCE)
    if not good or np.linalg.det(rotation) < 0.0:
        raise InputError(f"Placement {name}", name=name, expected="a finite rigid placement", got=str(matrix.tolist()))
