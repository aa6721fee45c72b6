"""The settings of a run, checked once, before any work is done."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from contactvi.errors import InputError, did_you_mean

IMPACT_MAPS = ("ctec", "dtec", "mhc")  # in the engine's order
MHC_REFERENCES = ("local", "global")
LEDGER_TOLERANCES = (
    *("energy", "modified_energy", "discrete_energy", "linear_momentum", "angular_momentum"),
    *("energy_jump", "modified_energy_jump", "discrete_energy_jump", "own_jump"),
    *("linear_momentum_jump", "angular_momentum_jump", "impulse", "complementarity", "gap"),
)
_STEP_TOLERANCE = 1e-9  # decimal input such as 0.1 / 1e-3 is off by a few eps * steps, a wrong number by far more


@dataclass(frozen=True)
class Options:
    """Settings of a run.

    Parameters
    ----------
    dt : time step [s], > 0.
    duration : simulated time [s], a whole number of steps: `steps = round(duration / dt)`, and an error when
        duration / dt is further than 1e-9 (relative) from a whole number. All steps have the same length, because the
        modified Hamiltonian that the integrator conserves belongs to one step length. None where the caller
        decides step by step (Simulator).
    impact : impact map (Murphey, Pekarek, Seghete), what the impact conserves besides the momentum along the surface:
        "ctec" the energy, "dtec" the discrete energy of the step, "mhc" the modified Hamiltonian of the integrator.
    mhc_reference : value that "mhc" conserves: "local" that of the start of the step, "global" that of the start of the
        run less the losses of all impacts since (no drift; without damping and inputs only).
    order : order of the variational integrator; 2 (midpoint rule).
    tol : the Newton iteration of a step stops at residual <= tol * scale.
    record_every : every how many steps the state is kept; the first and the last one always are.
    max_impacts_per_step : a run with more impacts in one step ends with the status TOO_MANY_IMPACTS.
    ledger : tolerances on the ledger of the run, name -> bound >= 0 (contactvi.ledger says what is bounded, relative to
        what); the run ends with the status LEDGER where one is exceeded.
    max_iterations : Newton iterations per step before the run ends with the status NEWTON_FAILED.

    Raises
    ------
    InputError : for a value that is not of the type or in the range given above.
    """

    dt: float
    duration: float | None = None
    impact: str = "ctec"
    mhc_reference: str = "local"
    order: int = 2
    tol: float = 1e-12
    record_every: int = 1
    max_impacts_per_step: int = 100_000
    max_iterations: int = 30
    ledger: Mapping[str, float] | None = field(default=None, hash=False)

    def __post_init__(self) -> None:
        _set(self, "dt", _real("dt", self.dt, "the time step in seconds, > 0, for example 1e-3"))
        _set(self, "tol", _real("tol", self.tol, "a number between 0 and 1, for example 1e-12"))
        if self.tol >= 1.0:
            raise InputError("tol is too large", name="tol", expected="a number below 1", got=self.tol)
        for name in ("record_every", "max_impacts_per_step", "max_iterations"):
            _set(self, name, _count(name, getattr(self, name)))
        _check_choice("impact", self.impact, IMPACT_MAPS, "Unknown impact map")
        _check_choice("mhc_reference", self.mhc_reference, MHC_REFERENCES, "Unknown reference of MHC")
        _check_order(self.order)
        _set(self, "ledger", _tolerances(self.ledger))
        if self.duration is not None:
            _set(self, "duration", _real("duration", self.duration, "the simulated time in seconds, > 0"))
            _check_whole(self.duration, self.dt)

    @property
    def steps(self) -> int:
        """Number of steps of the run."""
        if self.duration is None:
            raise InputError(
                "The run has no duration",
                name="duration",
                expected="a time in seconds",
                got="none",
                remedy="Give duration=..., or set it in the scene file",
            )
        return round(self.duration / self.dt)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as a plain dictionary; `from_dict` reads it back."""
        return asdict(self)

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> Options:
        """Return the options with these values.

        Raises InputError for a missing `dt` and for a key that is not an option, naming the nearest one.
        """
        check_names(settings)
        if settings.get("dt") is None:
            raise InputError(
                "The run has no time step",
                name="dt",
                expected="a time in seconds",
                got="none",
                remedy="Give dt=..., for example dt=1e-3, or set it in the scene file",
            )
        return cls(**settings)


def option_names() -> list[str]:
    """Return the names of all options."""
    return [entry.name for entry in fields(Options)]


def check_names(settings: Mapping[str, Any]) -> None:
    """Raise InputError for the first key that is not an option."""
    for name in settings:
        if name not in option_names():
            raise InputError(
                f"Unknown option {name!r}",
                name=str(name),
                expected="an option of the run",
                got=repr(name),
                remedy=did_you_mean(str(name), option_names()),
            )


def _set(options: Options, name: str, value: Any) -> None:
    object.__setattr__(options, name, value)


def _real(name: str, value: Any, expected: str) -> float:
    good = isinstance(value, numbers.Real) and not isinstance(value, bool)
    if not good or not math.isfinite(value) or value <= 0:
        raise InputError(f"{name} is not usable", name=name, expected=expected, got=repr(value))
    return float(value)


def _count(name: str, value: Any) -> int:
    if not isinstance(value, numbers.Integral) or isinstance(value, bool) or int(value) < 1:
        raise InputError(f"{name} is not usable", name=name, expected="a whole number >= 1", got=repr(value))
    return int(value)


def _check_choice(name: str, value: Any, choices: Sequence[str], what: str) -> None:
    if isinstance(value, str) and value in choices:
        return
    expected = " | ".join(repr(choice) for choice in choices)
    raise InputError(what, name=name, expected=expected, got=repr(value), remedy=did_you_mean(str(value), choices))


def _tolerances(ledger: Any) -> dict[str, float] | None:
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


def _check_order(order: Any) -> None:
    whole = isinstance(order, numbers.Integral) and not isinstance(order, bool)
    if whole and order == 2:
        return
    if whole and order > 2 and order % 2 == 0:
        what, remedy = f"Order {order} is not available yet", "Use order=2 with a smaller dt"
    else:
        what, remedy = "The order of the integrator is not usable", "Use order=2"
    raise InputError(what, name="order", expected="2", got=repr(order), remedy=remedy)


def _check_whole(duration: float, dt: float) -> None:
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
