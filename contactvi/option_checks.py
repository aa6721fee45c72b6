"""Checks of single settings of a run, each with what was expected, what was got and a remedy."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping, Sequence
from typing import Any

from contactvi.errors import InputError, did_you_mean

LEDGER_TOLERANCES = (
    *("energy", "modified_energy", "discrete_energy", "linear_momentum", "angular_momentum"),
    *("energy_jump", "modified_energy_jump", "discrete_energy_jump", "own_jump"),
    *("linear_momentum_jump", "angular_momentum_jump", "impulse", "complementarity", "gap"),
    *("energy_rise", "impulse_balance", "energy_balance"),
)
AUTO = "auto"
ORDERS = tuple(range(2, 17, 2))
AUTO_ORDER = 16
CONTACT_DT = 1e-3  # [s] longest step in contact where none is given and free steps are longer, of a higher order
_STEP_TOLERANCE = 1e-9  # decimal input such as 0.1 / 1e-3 is off by a few eps * steps, a wrong number by far more


def real(name: str, value: Any, expected: str) -> float:
    """Return a number > 0; `expected` says in words what it should be."""
    good = isinstance(value, numbers.Real) and not isinstance(value, bool)
    if not good or not math.isfinite(value) or value <= 0:
        raise InputError(f"{name} is not usable", name=name, expected=expected, got=repr(value))
    return float(value)


def count(name: str, value: Any) -> int:
    """Return a whole number >= 1."""
    if not isinstance(value, numbers.Integral) or isinstance(value, bool) or int(value) < 1:
        raise InputError(f"{name} is not usable", name=name, expected="a whole number >= 1", got=repr(value))
    return int(value)


def check_choice(name: str, value: Any, choices: Sequence[str], what: str) -> None:
    """Raise InputError, saying `what` is wrong, where the value is none of the choices."""
    if isinstance(value, str) and value in choices:
        return
    expected = " | ".join(repr(choice) for choice in choices)
    raise InputError(what, name=name, expected=expected, got=repr(value), remedy=did_you_mean(str(value), choices))


def tolerances(ledger: Any) -> dict[str, float] | None:
    """Return the checked tolerances of the ledger, None for none."""
    if not ledger and (ledger is None or isinstance(ledger, Mapping)):
        return None
    if not isinstance(ledger, Mapping):
        raise InputError(
            "The tolerances of the ledger are not usable",
            name="ledger",
            expected='names and bounds, for example {"own_jump": 1e-10}',
            got=repr(ledger),
        )
    for name, bound in ledger.items():
        if name not in LEDGER_TOLERANCES:
            raise InputError(
                f"The ledger has no tolerance {name!r}",
                name="ledger",
                expected=" | ".join(LEDGER_TOLERANCES),
                got=repr(name),
                remedy=did_you_mean(str(name), LEDGER_TOLERANCES),
            )
        if not isinstance(bound, numbers.Real) or isinstance(bound, bool) or not float(bound) >= 0:
            raise InputError(f"Tolerance {name!r}", name="ledger", expected="a number >= 0", got=repr(bound))
    return {str(name): float(bound) for name, bound in ledger.items()}


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
        got=repr(order),
        remedy=f"Use order={near}",
    )


def kept_dense(dense: Any, order: int, sample_dt: float | None) -> bool:
    """Return whether polynomials are kept, by default from order 4 on and for samples."""
    if dense is None:
        return order >= 4 or sample_dt is not None
    if not isinstance(dense, bool):
        raise InputError("dense is not usable", name="dense", expected="True or False", got=repr(dense))
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
    value = real("dt_contact", dt_contact, "the step in contact in seconds, > 0, for example 1e-3")
    if isinstance(dt, float) and value > dt * (1.0 + _STEP_TOLERANCE):
        raise InputError(
            "The step in contact is longer than the step",
            name="dt_contact",
            expected=f"at most dt = {dt:g} s",
            got=f"{value:g} s",
            remedy="Leave dt_contact out, or use a larger dt",
        )
    return value


def flag(name: str, value: Any) -> bool:
    """Return True or False."""
    if not isinstance(value, bool):
        raise InputError(f"{name} is not usable", name=name, expected="True or False", got=repr(value))
    return value


def check_whole(duration: float, dt: float) -> None:
    """Raise InputError where the duration is not a whole number of steps [s]."""
    ratio = duration / dt
    if not math.isfinite(ratio):
        raise InputError("duration / dt overflows", name="dt", expected="a finite number of steps", got=f"dt={dt!r}")
    steps = round(ratio)
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
