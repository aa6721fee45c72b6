"""Checks of arguments: each returns the clean value or raises an InputError that names the argument.

First numbers and choices, then arrays and placements, states and forces of one model, and settings of a run.
"""

from __future__ import annotations

import inspect
import math
import numbers
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import InputError, UserFunctionError, did_you_mean

Array = NDArray[np.float64]
UNIT_TOLERANCE = 1e-6  # of a norm; a quaternion with seven digits passes, one that is not normalised does not

AUTO = "auto"
ORDERS = tuple(range(2, 17, 2))
AUTO_ORDER = 16
CONTACT_DT = 1e-3  # [s] default of the longest step in contact, where free steps are longer and of an order above 2
LEDGER_TOLERANCES = (
    *("energy", "modified_energy", "discrete_energy", "linear_momentum", "angular_momentum"),
    *("energy_jump", "modified_energy_jump", "discrete_energy_jump", "own_jump"),
    *("linear_momentum_jump", "angular_momentum_jump", "impulse", "complementarity", "gap"),
    *("energy_rise", "impulse_balance", "energy_balance"),
    *("dense_residual", "dense_gap", "dense_energy_rise"),
)
_STEP_TOLERANCE = 1e-9  # relative; decimal input such as 0.1 / 1e-3 is off by a few eps * steps

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
        number = _float(value)
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


def _float(value: Any) -> float:
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


def count(name: str, value: Any) -> int:
    """Return a whole number >= 1 that the engine can hold."""
    whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not whole or not 1 <= int(value) <= MOST:
        expected = f"a whole number <= {MOST}" if whole and int(value) > MOST else "a whole number >= 1"
        raise InputError(
            f"{name} is not usable", name=name, expected=expected, got=short(value), remedy=_count_remedy(value)
        )
    return int(value)


def _count_remedy(value: Any) -> str:
    """Return how to make a whole number >= 1 of what was given."""
    number = _float(value) if isinstance(value, numbers.Real) and not isinstance(value, bool) else math.nan
    if math.isfinite(number):
        return f"Use {min(max(round(number), 1), MOST)}, without a decimal point"
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


def check_choice(name: str, value: Any, choices: Sequence[str], what: str) -> None:
    """Raise InputError, saying `what` is wrong, where the value is none of the choices."""
    if isinstance(value, str) and value in choices:
        return
    expected = " | ".join(repr(choice) for choice in choices)
    raise InputError(what, name=name, expected=expected, got=short(value), remedy=did_you_mean(_word(value), choices))


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
        return None if np.iscomplexobj(value) else np.array(value, dtype=float, order="C")
    except (TypeError, ValueError, OverflowError):
        return None


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


def pose(name: str, value: Any) -> pin.SE3:
    """Return a placement from None, pin.SE3, xyz, (xyz, rpy), 7 numbers (xyz, quaternion xyzw) or a 4x4 matrix.

    Lengths in m, roll-pitch-yaw in rad as in URDF (R = Rz(yaw) Ry(pitch) Rx(roll)).
    """
    if value is None:
        return pin.SE3.Identity()
    if isinstance(value, pin.SE3):
        _check_pose(name, value)
        return value.copy()
    if isinstance(value, Sequence) and len(value) == 2 and not isinstance(value, str):
        xyz, rpy = vector(f"{name} xyz", value[0], 3), vector(f"{name} rpy", value[1], 3)
        return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)
    shape = shape_of(value)
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


# --- states and forces ------------------------------------------------------------------------------------------------


class States:
    """Checks of the states and forces of one model."""

    def __init__(self, model: pin.Model) -> None:
        self.nq, self.nv = int(model.nq), int(model.nv)
        self._units: list[tuple[slice, str]] = []  # entries of q that are a rotation, name of the joint
        for index in range(1, model.njoints):
            part = _unit_part(model, index)
            if part.stop > part.start:
                self._units.append((part, str(model.names[index])))

    def configuration(self, q: Any, name: str = "q0") -> Array:
        """Return q as an array of shape (nq,), unit complex numbers and quaternions normalised.

        Raises:
            InputError: for a wrong shape, numbers that are not finite, and a norm further than 1e-6 from one.
        """
        remedy = (
            "Start from scene.neutral() and set joints with scene.configuration({...}); a free body takes 7 numbers"
        )
        result = array(name, q, (self.nq,), "one configuration", remedy)
        for part, joint in self._units:
            values = result[part]
            norm = math.hypot(*values)
            if abs(norm - 1.0) > UNIT_TOLERANCE:
                what = "quaternion (x, y, z, w)" if part.stop - part.start == 4 else "pair (cos, sin)"
                raise InputError(
                    f"{name} has a {what} of joint {joint!r} that is not a rotation",
                    name=name,
                    expected="norm 1",
                    got=f"{np.array2string(values, precision=6)} with norm {norm:.6g}",
                    remedy=f"Normalise {name}[{part.start}:{part.stop}], or start from scene.neutral()",
                )
            values /= norm
        return result

    def distance(self, a: Array, b: Array) -> Array:
        """Return the norm of the tangent difference of configurations (N, nq) or (1, nq), shape (N,) [m, rad].

        Angles follow from the chords of unit quaternions and (cos, sin), which lose no digits where they are small.
        Free and planar bodies as R^3 x SO(3) and R^2 x SO(2).
        """
        apart = b - a
        square = np.einsum("ij,ij->i", apart, apart)
        for part, _ in self._units:
            near = np.einsum("ij,ij->i", apart[:, part], apart[:, part])
            if part.stop - part.start == 4:  # q and -q are one rotation, and the chord belongs to half its angle.
                angle = 4.0 * np.arcsin(np.minimum(1.0, 0.5 * np.sqrt(np.minimum(near, 4.0 - near))))
            else:
                angle = 2.0 * np.arcsin(np.minimum(1.0, 0.5 * np.sqrt(near)))
            square += angle**2 - near
        return np.asarray(np.sqrt(np.maximum(square, 0.0)))

    def velocity(self, v: Any, name: str = "v0") -> Array:
        """Return v as an array of shape (nv,); None is rest."""
        if v is None:
            return np.zeros(self.nv)
        meaning = "one velocity (a free body takes 6 numbers: linear, angular, body frame)"
        return array(name, v, (self.nv,), meaning, "Set joints by name with scene.velocity({...}), or leave it out")

    def force(self, tau: Any, name: str = "tau") -> Array:
        """Return one generalized force as an array of shape (nv,)."""
        remedy = f"Start from np.zeros({self.nv}), and set the entries of the joints that are driven"
        return array(name, tau, (self.nv,), "one generalized force", remedy)

    def controlled(self, tau: Any, t: float) -> Array:
        """Return what a control function returned at t [s] as one generalized force, shape (nv,).

        Raises UserFunctionError with the time.
        """
        try:
            return self.force(tau)
        except InputError as error:
            raise UserFunctionError(
                f"The control returned what cannot be used at t = {t:.9g} s, {error.what}",
                function="control",
                time=t,
                expected=error.expected,
                got=error.got,
                remedy=f"Correct what the control returns. {error.remedy}",
            ) from None

    def forces(self, tau: Any, steps: int, name: str = "control") -> Array:
        """Return the generalized forces of all steps as an array of shape (steps, nv)."""
        return array(name, tau, (steps, self.nv), "one generalized force per step")


def _unit_part(model: pin.Model, index: int) -> slice:
    """Return the entries of q that are the unit quaternion or (cos, sin) of a joint; empty for other joints."""
    joint = model.joints[index]
    start, offset = joint.idx_q, 0
    count = {(7, 6): 4, (4, 3): 4, (2, 1): 2}.get((joint.nq, joint.nv), 0)
    if joint.nq == 7:
        offset = 3
    if joint.shortname() == "JointModelPlanar":
        offset, count = 2, 2
    return slice(start + offset, start + offset + count)


# --- settings of a run ------------------------------------------------------------------------------------------------


def tolerances(ledger: Any) -> dict[str, float] | None:
    """Return the checked tolerances of the ledger, None for none."""
    if ledger is None or (isinstance(ledger, Mapping) and not ledger):
        return None
    if not isinstance(ledger, Mapping):
        raise InputError(
            "The tolerances of the ledger are not usable",
            name="ledger",
            expected='names and bounds, for example {"own_jump": 1e-10}',
            got=short(ledger),
            remedy="Write the bounds as a dict; in a scene file under [run.ledger]",
        )
    for name, bound in ledger.items():
        if name not in LEDGER_TOLERANCES:
            raise InputError(
                f"The ledger has no tolerance {short(name)}",
                name="ledger",
                expected=" | ".join(LEDGER_TOLERANCES),
                got=short(name),
                remedy=did_you_mean(_word(name), LEDGER_TOLERANCES),
            )
        if not isinstance(bound, numbers.Real) or isinstance(bound, bool) or not _is_bound(bound):
            raise InputError(
                f"Tolerance {name!r}",
                name="ledger",
                expected="a number >= 0 that fits in a float",
                got=short(bound),
                remedy="Give the largest deviation that you accept, for example 1e-10",
            )
    return {str(name): float(bound) for name, bound in ledger.items()}


def _is_bound(value: Any) -> bool:
    """Return whether a real number is >= 0 and a float can hold it."""
    number = _float(value)
    return number >= 0.0 and (math.isfinite(number) or bool(value == math.inf))


def integrator_order(order: Any, auto: bool) -> int:
    """Return the order, by default 2 for steps of one length and AUTO_ORDER for "auto"."""
    if order is None:
        return AUTO_ORDER if auto else 2
    whole = isinstance(order, numbers.Integral) and not isinstance(order, bool)
    if whole and order in ORDERS:
        return int(order)
    near = 2 if not whole else min(max(int(order) + int(order) % 2, 2), 16)
    raise InputError(
        "The order of the integrator is not usable",
        name="order",
        expected="an even number from 2 to 16",
        got=short(order),
        remedy=f"Use order={near}",
    )


def kept_dense(dense: Any, order: int, sample_dt: float | None) -> bool:
    """Return whether polynomials are kept, by default from order 4 on and for samples."""
    if dense is None:
        return order >= 4 or sample_dt is not None
    if not isinstance(dense, bool):
        raise InputError(
            "dense is not usable", name="dense", expected="True or False", got=short(dense), remedy=_flag_remedy(dense)
        )
    if sample_dt is not None and not dense:
        raise InputError(
            "Samples are taken from the polynomials of the steps",
            name="dense",
            expected="True with sample_dt",
            got="False",
            remedy="Leave dense out, or sample_dt",
        )
    return dense


def contact_step(dt_contact: Any, dt: float | str) -> float | str | None:
    """Return the checked step in contact; dt: the free step [s] or "auto"."""
    if dt_contact is None or (isinstance(dt_contact, str) and dt_contact == AUTO and dt == AUTO):
        return dt_contact if dt_contact is None else AUTO
    if isinstance(dt_contact, str) and dt_contact == AUTO:
        raise InputError(
            "The step in contact cannot be found by a run with steps of one length",
            name="dt_contact",
            expected="a time in seconds, or dt='auto' too",
            got="'auto'",
            remedy="Give dt_contact=..., for example dt_contact=1e-3, or leave it out",
        )
    value = positive("dt_contact", dt_contact, "the step in contact in seconds, > 0, for example 1e-3")
    if isinstance(dt, float) and value > dt * (1.0 + _STEP_TOLERANCE):
        raise InputError(
            "The step in contact is longer than the step",
            name="dt_contact",
            expected=f"at most dt = {dt:g} s",
            got=f"{value:g} s",
            remedy="Leave dt_contact out, or use a larger dt",
        )
    if isinstance(dt, float):
        check_contact_steps(value, dt, "dt")
    return value


def check_contact_steps(dt_contact: float, span: float, what: str) -> None:
    """Raise InputError where a step in contact [s] is lost in the rounding of the time within a span [s] of this name.

    Such a step does not bring the time forward, so a run would not end.
    """
    if span / MOST_STEPS <= dt_contact:
        return
    raise InputError(
        "The step in contact is too short",
        name="dt_contact",
        expected=f"at most {MOST_STEPS:g} of them in {what} = {span:g} s",
        got=f"{dt_contact:g} s",
        remedy="Use a larger dt_contact, for example dt_contact=1e-3, or leave it out",
    )


def check_whole(duration: float, dt: float) -> None:
    """Raise InputError where the duration is not a whole number of steps [s]."""
    ratio = duration / dt
    if not math.isfinite(ratio):
        raise InputError(
            "duration / dt overflows",
            name="dt",
            expected="a finite number of steps",
            got=f"dt={dt!r}",
            remedy="Use a larger dt",
        )
    steps = round(ratio)
    if steps > MOST_STEPS:
        raise InputError(
            "duration has too many steps", name="duration", expected=f"at most {MOST_STEPS:g} of them",
            got=f"{duration!r} / {dt!r} = {ratio:.12g}", remedy="Use a larger dt, or a shorter duration",
        )  # fmt: skip
    if steps >= 1 and abs(ratio - steps) <= _STEP_TOLERANCE * max(1.0, ratio):
        return
    near = max(1, steps)
    raise InputError(
        "duration is not a whole number of steps",
        name="duration",
        expected="duration / dt a whole number (to 1e-9)",
        got=f"{duration!r} / {dt!r} = {ratio:.12g}",
        remedy=f"Use duration={near * dt:.12g}, or dt={duration / near:.12g}",
    )
