"""The settings of a run, checked once, before any work is done."""

from __future__ import annotations

import numbers
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, TypedDict, get_args

from contactvi.aliases import warn_deprecated
from contactvi.errors import InputError
from contactvi.inputs import check_choice, count, flag, mapping, positive, short
from contactvi.keywords import meant
from contactvi.run_settings import (
    AUTO,
    CONTACT_DT,
    check_contact_steps,
    check_whole,
    contact_step,
    integrator_order,
    kept_dense,
    kept_record,
    tolerances,
)

Dt = float | Literal["auto"]
ImpactMap = Literal["ctec", "dtec", "mhc"]
MhcReference = Literal["local", "global"]
Zeno = Literal["hold", "end"]
Support = Literal["sequence", "stiff"]
ContactSteps = Literal["auto", "events", "steps"]
Start = Literal["given", "separate"]
Kept = Literal["states", "gradient"] | int
IMPACT_MAPS: tuple[ImpactMap, ...] = get_args(ImpactMap)
MHC_REFERENCES: tuple[MhcReference, ...] = get_args(MhcReference)
ZENO: tuple[Zeno, ...] = get_args(Zeno)
SUPPORTS: tuple[Support, ...] = get_args(Support)
STARTS: tuple[Start, ...] = get_args(Start)
CONTACT_MODES: tuple[ContactSteps, ...] = get_args(ContactSteps)
DEFAULT_DT = 1e-3  # [s], where no dt is given and "auto" is not possible
STEP_TOL, AUTO_TOL = 1e-12, 1e-6
MOST_THREADS = 1024  # more are a slip of the pen
STAGE_TOLS = (1e-15, 3e-11)  # with "auto": the first is what rounding allows
_FIXED_ONLY = ("discrete_energy", "discrete_energy_jump", "modified_energy_jump")  # they need steps of one length
_OF_THE_KIND = ("tol", "solver_tol", "record_every")  # options that only one kind of dt has
_UNSET: Any = None  # the default depends on other options; resolved in __post_init__


class FurtherOptions(TypedDict, total=False):
    """The options that `simulate` and `Simulator` both take beside those they name; `Options` describes them."""

    mhc_reference: MhcReference | None
    record_every: int | None
    max_impacts_per_step: int | None
    max_iterations: int | None
    dense: bool | None
    dt_contact: Dt | None
    zeno: Zeno | None
    support: Support | None
    contact_points: int | None
    threads: int | None
    record_contacts: bool | None
    contact_mode: ContactSteps | None
    record: Kept | None
    start: Start | None


class SteppingOptions(FurtherOptions, total=False):
    """The options of a `Simulator`."""

    duration: float | None
    impact: ImpactMap | None
    order: int | None
    tol: float | None
    solver_tol: float | None
    ledger: Mapping[str, float] | None
    sample_dt: float | None


@dataclass(frozen=True)
class Options:
    """Settings of a run.

    Args:
        dt: time step [s], > 0: all steps have this length. Or "auto": the step is chosen so that q is accurate to
            `tol`; it is constant between impacts (contactvi.simulation.auto_search). Not with "dtec", inputs or
            order 2.
        duration: simulated time [s]. With a number as dt a whole number of steps: `steps = round(duration / dt)`, and
            an error when duration / dt is further than 1e-9 (relative) from a whole number, because the modified
            Hamiltonian that the integrator conserves belongs to one step length. None where the caller decides step by
            step (Simulator).
        impact: impact map (Murphey, Pekarek, Seghete), what the impact conserves besides the momentum along the
            surface: "ctec" the energy, "dtec" the discrete energy of the step, "mhc" the modified Hamiltonian of the
            integrator.
        mhc_reference: value that "mhc" conserves: "local" that of the start of the step, "global" that of the start of
            the run less the losses of all impacts since (no drift; without damping and inputs only).
        order: order 2s of the variational integrator with s Gauss stages, an even number from 2 (midpoint rule) to 16;
            by default 2 for a number as dt and 16 for "auto".
        tol: the accuracy asked of q, with dt="auto": the largest norm of the tangent difference to the true motion over
            the run [m, rad], by default 1e-6. With a number as dt nothing is asked of q, and tol is None: its error
            follows from dt and the order. There tol is taken as solver_tol for this release, with a DeprecatedWarning.
        solver_tol: how well the equations of a step are solved with a number as dt: relative, in the energy norm, by
            default 1e-12. With "auto" it follows from tol (`stage_tol`) and is not given.
        record_every: every how many steps the state is kept; the first and the last one always are. 1 with "auto".
        max_impacts_per_step: a run with more impacts in one step ends with the status TOO_MANY_IMPACTS.
        ledger: tolerances on the ledger of the run, name -> bound >= 0 (see contactvi.trajectory.ledger for what is
            bounded, relative to what); the run ends with the status LEDGER where one is exceeded.
        max_iterations: stage iterations per attempt at a step before it is tried from other start values, or shorter.
        sample_dt: keep the states at every sample_dt [s] from the start, and the last one, instead of those at the ends
            of steps: the samples are taken from the polynomials of the steps, see dense.
        dense: keep the polynomial of every step, which Trajectory.at evaluates; by default from order 4 on, with
            sample_dt and with record="gradient". With a fixed step all bodies are then advanced together: an impact
            cuts the steps of all. Without, and with dt="auto", bodies that cannot meet are advanced apart; results
            differ within the error of the steps.
        dt_contact: length of contact steps and dense steps [s], at most dt: both are of order 2 whatever the order. By
            default dt at order 2 and min(dt, 1e-3) above. With dt="auto" the run finds it ("auto", the default), and a
            number is the longest one allowed. Above order 2 smooth steps of length dt hold persistent contacts and
            joint friction, and contact steps are taken only where they cannot, for contacts that slide with
            friction and for joint friction with record="gradient", and for joint friction with "dtec" and "mhc".
            Trajectory.phases tells which step was taken where.
        zeno: where impacts accumulate: "hold" makes one of them plastic, which begins a persistent contact, "end" ends
            the run with the status ZENO. Runs with "dtec", which has no answer there, end in both cases.
        support: an impact on a body with persistent contacts: "sequence" of single impacts, each contact with its own
            restitution; "stiff": the persistent contacts stay closed during it, as if their supports were infinitely
            stiff.
        contact_points: points that a pair of shapes has at most, >= 1, by default 4; fewer only where no faces touch.
            While a face tips, impacts at one instant may have more: the unused points of the face, so that none
            penetrates.
        threads: of this run, >= 1: bodies that cannot meet are advanced side by side in so many, with the same bits. It
            pays with some hundred moving bodies. One where all bodies are advanced together (see dense) and in scenes
            with functions of Python; runs of a batch have threads of their own (simulate_batch(workers=)).
        record_contacts: keep the impulses of all contacts (Trajectory.contacts).
        contact_mode: which steps are taken where bodies touch. "auto": events are located; where they accumulate or
            would end the run, and where many points persist, steps are dense: impacts lie inside of them, without times
            (contactvi.records.dense_steps says how exactly their law holds). "events": never a dense step; where
            events accumulate the run is slow or ends with a status. "steps": dense steps alone, which makes the run a
            time-stepping simulation to compare with. With "dtec" and zeno="end" no dense step is
            taken; there and with dt="auto" "steps" is refused.
        record: "states", or "gradient": also what the derivatives of the run need (Trajectory.sensitivity), the
            polynomials of the steps and the inputs. Steps of one length only; with "dtec" and "mhc" those with
            constraints have order 2 then. What has no derivative is refused before the run where it is known then. Of a
            Simulator also False: nothing but the present state and its last step, and a number n >= 1: the last n
            steps; not with a ledger and "dtec".
        start: of a start with overlaps: "given" refuses it, "separate" moves it apart as Scene.separate does, with the
            limits that this has by default; Trajectory.separation tells what was moved. Derivatives by q0 are those by
            the start that was found.

    Raises:
        InputError: for a value that is not of the type or in the range given above.
    """

    dt: Dt
    duration: float | None = None
    impact: ImpactMap = "ctec"
    mhc_reference: MhcReference = "local"
    order: int = _UNSET
    tol: float = _UNSET
    solver_tol: float = _UNSET
    record_every: int = 1
    max_impacts_per_step: int = 100_000
    max_iterations: int = 50
    ledger: Mapping[str, float] | None = field(default=None, hash=False)
    sample_dt: float | None = None
    dense: bool = _UNSET
    dt_contact: Dt | None = None
    zeno: Zeno = "hold"
    support: Support = "sequence"
    contact_points: int = 4
    threads: int = 1
    record_contacts: bool = True
    contact_mode: ContactSteps = "auto"
    record: Kept = "states"
    start: Start = "given"

    def __post_init__(self) -> None:
        if not self.auto:
            _set(self, "dt", positive("dt", self.dt, "the time step in seconds, > 0, for example 1e-3, or 'auto'"))
        _set_tolerances(self)
        _set(self, "dt_contact", contact_step(self.dt_contact, self.dt))
        _set(self, "record_contacts", flag("record_contacts", self.record_contacts))
        for name in ("record_every", "max_impacts_per_step", "max_iterations", "contact_points"):
            _set(self, name, count(name, getattr(self, name)))
        _set(self, "threads", count("threads", self.threads, MOST_THREADS))
        check_choice("impact", self.impact, IMPACT_MAPS, "Unknown impact map")
        check_choice("mhc_reference", self.mhc_reference, MHC_REFERENCES, "Unknown reference of MHC")
        check_choice("zeno", self.zeno, ZENO, "Unknown answer to accumulating impacts")
        check_choice("support", self.support, SUPPORTS, "Unknown reading of a support")
        check_choice("contact_mode", self.contact_mode, CONTACT_MODES, "Unknown kind of steps in contact")
        check_choice("start", self.start, STARTS, "Unknown answer to a start with overlaps")
        _set(self, "record", kept_record(self.record, self.ledger is not None, self.impact == "dtec"))
        _set(self, "order", integrator_order(self.order, self.auto))
        _set(self, "ledger", tolerances(self.ledger))
        if self.duration is not None:
            _set(self, "duration", positive("duration", self.duration, "the simulated time in seconds, > 0"))
            if isinstance(self.dt_contact, float):
                check_contact_steps(self.dt_contact, self.duration, "duration")
        if self.sample_dt is not None:
            _set(self, "sample_dt", positive("sample_dt", self.sample_dt, "the time between samples in seconds, > 0"))
            _check_samples(self.duration, self.sample_dt)
        if self.record == "gradient":
            _check_gradient(self)
        _set(self, "dense", kept_dense(self.dense, self.order, self.sample_dt))
        _check_nodes(self)
        if self.auto:
            _check_auto(self)
        elif self.duration is not None:
            check_whole(self.duration, self.fixed_dt)
        if self.contact_mode == "steps" and (self.auto or self.impact == "dtec" or self.zeno == "end"):
            raise InputError(
                "Dense steps need a fixed step and contacts that may persist",
                name="contact_mode",
                expected="'auto' or 'events' with dt='auto', impact='dtec' or zeno='end'",
                got="'steps'",
                remedy="Give dt=1e-3, impact='ctec' or 'mhc', and zeno='hold'",
            )

    @property
    def auto(self) -> bool:
        """Whether the step is chosen by the run."""
        return isinstance(self.dt, str) and self.dt == AUTO

    @property
    def last_steps(self) -> int | None:
        """Of how many steps the record is kept; None: all, 0: nothing but the last one."""
        return None if isinstance(self.record, str) else int(self.record)

    @property
    def fixed_dt(self) -> float:
        """The time step [s] of a run with steps of one length; raises InputError for "auto"."""
        return self.require_fixed()

    def require_fixed(self) -> float:
        """Return `fixed_dt` or raise its error."""
        if isinstance(self.dt, str):
            raise InputError(
                "This needs steps of one length", name="dt", expected="a time in seconds", got=repr(self.dt),
                remedy="Give dt=..., for example dt=1e-3",
            )  # fmt: skip
        return self.dt

    @property
    def contact_dt(self) -> float:
        """The longest step with persistent contacts [s]."""
        if isinstance(self.dt_contact, float):
            return self.dt_contact
        if isinstance(self.dt, str):
            return CONTACT_DT
        return self.dt if self.order == 2 else min(self.dt, CONTACT_DT)

    @property
    def span(self) -> float:
        """The simulated time [s]; raises InputError where there is none."""
        if self.duration is None:
            raise InputError(
                "The run has no duration", name="duration", expected="a time in seconds", got="none",
                remedy="Give duration=..., or set it in the scene file",
            )  # fmt: skip
        return self.duration

    @property
    def steps(self) -> int:
        """Number of steps of a run with steps of one length."""
        return round(self.span / self.fixed_dt)

    @property
    def stage_tol(self) -> float:
        """Tolerance to which the equations of a step are solved, relative, in the energy norm."""
        return min(max(1e-5 * self.tol, STAGE_TOLS[0]), STAGE_TOLS[1]) if self.auto else self.solver_tol

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as a plain dictionary; `from_dict` reads it back."""
        values = {name: getattr(self, name) for name in option_names()}
        return values | {"ledger": None if self.ledger is None else dict(self.ledger)}

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> Options:
        """Return the options with these values.

        Raises:
            InputError: for a missing `dt` and for a key that is not an option, naming the nearest one.
        """
        check_names(mapping("settings", settings, "option: value"))
        if settings.get("dt") is None:
            raise InputError(
                "The run has no time step",
                name="dt",
                expected="a time in seconds, or 'auto' for a whole run",
                got="none",
                remedy="Give dt=..., for example dt=1e-3, or set it in the scene file",
            )
        return cls(**settings)

    @classmethod
    def from_stored(cls, settings: Mapping[str, Any]) -> Options:
        """Return the options of a file: with a number as dt, older ones call solver_tol tol."""
        settings = dict(mapping("settings", settings, "option: value"))
        if "solver_tol" not in settings and not _is(settings.get("dt"), AUTO):
            settings["solver_tol"] = settings.pop("tol", None)
        return cls.from_dict(settings)


MOST_SAMPLES = 1e8  # states of a run that are kept: of a body they take 20 GB


def _check_samples(duration: float | None, sample_dt: float) -> None:
    """Raise InputError where more states are to be kept than fit in memory."""
    if duration is None or duration / sample_dt <= MOST_SAMPLES:
        return
    raise InputError(
        "sample_dt is too short",
        name="sample_dt",
        expected=f"at most {MOST_SAMPLES:g} samples in the duration",
        got=sample_dt,
        remedy=f"Use sample_dt={duration / MOST_SAMPLES:.1g} or more",
    )


_NAMES = tuple(entry.name for entry in fields(Options))
FurtherOptions.described = SteppingOptions.described = Options  # type: ignore[attr-defined]


def option_names() -> tuple[str, ...]:
    """Return the names of all options."""
    return _NAMES


def check_names(settings: Mapping[str, Any]) -> None:
    """Raise InputError for the first key that is not an option."""
    for name in settings:
        if name not in _NAMES:
            raise InputError(
                f"Unknown option {name!r}",
                name=str(name),
                expected="an option of the run",
                got=repr(name),
                remedy=meant(str(name), _NAMES),
            )


def merged(file: Mapping[str, Any], chosen: Mapping[str, Any], forced: bool = False) -> dict[str, Any]:
    """Return the settings of a run: those chosen (not None), else those of the scene's file.

    Where neither has a dt it is "auto" if the run allows it (not with `forced`, inputs), else DEFAULT_DT. Where the
    run has a number as dt and the file has not, or the reverse, the file's tol, solver_tol and record_every do not
    count: they were given for another kind of step.
    """
    check_names(chosen)
    given = {name: value for name, value in chosen.items() if value is not None}
    auto = _is(_with_dt({**file, **given}, forced)["dt"], AUTO)
    if file and (forced or "dt" in given) and auto != is_auto(file):
        file = {name: value for name, value in file.items() if name not in _OF_THE_KIND}
    return _with_dt({**file, **given}, forced)


def is_auto(settings: Mapping[str, Any]) -> bool:
    """Return whether a run with these settings alone chooses its steps."""
    return _is(_with_dt(settings)["dt"], AUTO)


def _with_dt(settings: Mapping[str, Any], forced: bool = False) -> dict[str, Any]:
    if settings.get("dt") is not None:
        return dict(settings)
    watched = settings.get("ledger")
    fixed = forced or _is(settings.get("order"), 2) or _is(settings.get("impact"), "dtec")
    fixed = fixed or not _is(settings.get("record_every", 1), 1) or _is(settings.get("record"), "gradient")
    fixed = fixed or (isinstance(watched, Mapping) and any(name in watched for name in _FIXED_ONLY))
    return {**settings, "dt": DEFAULT_DT if fixed else AUTO}


def _is(value: Any, wanted: int | str) -> bool:
    """Return whether a setting that is not checked yet has this value; arrays, which compare by entries, have none."""
    return isinstance(value, (str, numbers.Real)) and bool(value == wanted)


def _set(options: Options, name: str, value: Any) -> None:
    object.__setattr__(options, name, value)


def _set_tolerances(options: Options) -> None:
    """Set the accuracy of q and the tolerance of the solver: the one with "auto", the other with a number as dt."""
    if options.auto and options.solver_tol is not None:
        raise InputError(
            "With dt='auto' the equations of a step are solved as tol needs it", name="solver_tol",
            expected="none with dt='auto'", got=short(options.solver_tol),
            remedy="Leave solver_tol out and give tol=..., the accuracy of q, or give dt=..., for example dt=1e-3",
        )  # fmt: skip
    if not options.auto and options.tol is not None:
        _take_as_solver_tol(options)
    if options.auto:
        _set(options, "tol", _tolerance("tol", AUTO_TOL if options.tol is None else options.tol, 1e-6))
    else:
        chosen = STEP_TOL if options.solver_tol is None else options.solver_tol
        _set(options, "solver_tol", _tolerance("solver_tol", chosen, 1e-12))


def _take_as_solver_tol(options: Options) -> None:
    """Take a tol that stands beside a number as dt as solver_tol, which it was called, and warn."""
    if options.solver_tol is not None:
        raise InputError(
            "tol is the accuracy of q, which steps of a given length do not choose", name="tol",
            expected="solver_tol alone with a number as dt", got=f"tol={short(options.tol)} too",
            remedy="Leave tol out, or give dt='auto' without solver_tol",
        )  # fmt: skip
    warn_deprecated(
        f"tol is the accuracy of q, which steps of a given length (dt={options.dt:g}) do not choose. Here it is taken"
        f" as what it was called so far: give solver_tol={short(options.tol)}, the tolerance to which the equations of"
        " a step are solved; or dt='auto' with tol=..., for an accuracy of q"
    )
    _set(options, "solver_tol", options.tol)
    _set(options, "tol", None)


def _tolerance(name: str, value: Any, example: float) -> float:
    """Return a tolerance in (0, 1)."""
    tol = positive(name, value, f"a number between 0 and 1, for example {example:g}")
    if tol < 1.0:
        return tol
    raise InputError(
        f"{name} is too large", name=name, expected="a number below 1", got=tol,
        remedy=f"Use {name}={example:g}, or leave it out",
    )  # fmt: skip


def _check_gradient(options: Options) -> None:
    """Raise InputError where a run cannot keep what its derivatives need; keep the polynomials."""
    if options.auto:
        raise InputError(
            "The steps of dt='auto' depend on the state, so the run has no derivative", name="record",
            expected="'states' with dt='auto'", got="'gradient'", remedy="Give dt=..., for example dt=1e-3",
        )  # fmt: skip
    if options.dense is False:
        raise InputError(
            "Derivatives need the polynomials of the steps", name="dense",
            expected="True with record='gradient'", got="False", remedy="Leave dense out",
        )  # fmt: skip
    if options.sample_dt is not None:
        raise InputError(
            "Derivatives are those of the states at the ends of steps", name="sample_dt",
            expected="none with record='gradient'", got=options.sample_dt,
            remedy="Leave sample_dt out; Sensitivity.at gives derivatives at other times",
        )  # fmt: skip
    _set(options, "dense", True)


def _check_nodes(options: Options) -> None:
    """Raise InputError where record_every is given for steps of several lengths, or for samples."""
    if options.record_every == 1 or not (options.auto or options.sample_dt is not None):
        return
    raise InputError(
        "record_every counts steps of one length",
        name="record_every",
        expected="1 with dt='auto' and with sample_dt",
        got=options.record_every,
        remedy="Use sample_dt=... alone: the time between the states that are kept",
    )


def _check_auto(options: Options) -> None:
    """Raise InputError where a run cannot choose its step."""
    what, remedy = "The step cannot be chosen by the run", "Give dt as a number, for example dt=1e-3"
    if options.order < 4:
        expected = "order >= 4: the step is chosen by what its stages leave out"
        raise InputError(what, name="order", expected=expected, got=options.order, remedy="Use order=16")
    if options.impact == "dtec":
        raise InputError(
            what,
            name="impact",
            expected="'ctec' or 'mhc': DTEC's error depends on where in a step an impact lies, not on its length alone",
            got="'dtec'",
            remedy=remedy,
        )
    unknown = [name for name in options.ledger or () if name in _FIXED_ONLY]
    if unknown:
        expected = "tolerances of quantities that need no step of a fixed length"
        raise InputError(what, name="ledger", expected=expected, got=", ".join(unknown), remedy=remedy)
