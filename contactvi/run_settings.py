"""Checks of the settings of a run: each returns the clean value or raises an InputError that names the setting."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping
from typing import Any

from contactvi.errors import InputError
from contactvi.inputs import MOST_STEPS, as_float, check_choice, flag, positive, short

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
        check_choice("ledger", name, LEDGER_TOLERANCES, f"The ledger has no tolerance {short(name)}")
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
    number = as_float(value)
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
    kept = flag("dense", dense)
    if sample_dt is not None and not kept:
        raise InputError(
            "Samples are taken from the polynomials of the steps",
            name="dense",
            expected="True with sample_dt",
            got="False",
            remedy="Leave dense out, or sample_dt",
        )
    return kept


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


def kept_record(record: Any, watched: bool, dtec: bool) -> str | int:
    """Return what of a run is kept: "states", "gradient", or the number of last steps; False: none.

    Raises:
        InputError: for anything else, and where the record of a run is looked through as it grows: with a ledger
            (`watched`), and with "dtec", which looks for stalled bouncing.
    """
    if record is True:
        return "states"
    if isinstance(record, str) and record in ("states", "gradient"):
        return record
    whole = isinstance(record, numbers.Integral) and not isinstance(record, str)
    if not whole or not (record is False or 1 <= int(record) <= MOST_STEPS):
        raise InputError(
            "Unknown kind of record", name="record",
            expected="'states', 'gradient', False, or a number of last steps >= 1", got=short(record),
            remedy="Use record=False to keep nothing but the present state, record=1000 for the last 1000 steps",
        )  # fmt: skip
    if watched or dtec:
        raise InputError(
            "The record of this run is looked through as it grows", name="record",
            expected=f"'states' with {'a ledger' if watched else 'dtec'}", got=repr(record),
            remedy="Leave record out",
        )  # fmt: skip
    return False if record is False else int(record)
