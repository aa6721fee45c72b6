"""The engine's simulator: made from the options of a run, started and called, with its errors turned into ours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any, cast

from numpy.typing import ArrayLike

from contactvi import _core, inputs
from contactvi.errors import ContactviError, PenetrationError, SimulationError
from contactvi.interrupts import held_back
from contactvi.options import Options
from contactvi.scene.separation import Separation, separate
from contactvi.simulation.messages import remedy
from contactvi.simulation.recorder import BLOCK, Array, Record
from contactvi.simulation.results import EngineResult, EngineStatus
from contactvi.status import Status, StatusCode
from contactvi.trajectory.compiled import CompiledScene

Progress = Callable[[float, int], object]

_MOST_WAITING = 4  # engines of a scene with other settings that wait for a run
# What `make` takes of the options, or makes it of.
_OF_THE_ENGINE = (
    "dt", "tol", "solver_tol", "order", "impact", "mhc_reference", "max_iterations", "max_impacts_per_step", "dense",
    "dt_contact", "zeno", "support", "contact_points", "threads", "record_contacts", "record", "contact_mode",
    "record_every",
)  # fmt: skip
_FIRST_DT = 0.02  # [s] with "auto" the first guess of the engine, which it corrects before the first impact


def make(
    compiled: CompiledScene, options: Options, slack: float = 1.0, dt_contact: float | None = None
) -> _core.Simulator:
    """Return a new simulator of the engine, to be started by `start`; the arguments as those of `engine_options`."""
    engine = make_of(compiled.core, options, slack, dt_contact)
    if options.last_steps is not None:
        engine.limit_record(0 if options.last_steps == 0 else max(options.last_steps, BLOCK))
    elif options.record_every > 1:
        engine.limit_record(BLOCK)  # its record has the nodes of all steps
    return engine


def make_of(
    scene: _core.Scene, options: Options, slack: float = 1.0, dt_contact: float | None = None
) -> _core.Simulator:
    """Return a new simulator of a scene, or a part of one; the arguments as those of `engine_options`."""
    return _core.Simulator(scene, engine_options(options, slack, dt_contact))


def engine_options(options: Options, slack: float = 1.0, dt_contact: float | None = None) -> _core.SimulatorOptions:
    """Return the options of the engine's simulator.

    Args:
        slack: factor on the tolerance of the stage equations.
        dt_contact: longest step in contact [s], by default that of the options.
    """
    settings = _core.SimulatorOptions()
    settings.dt = _FIRST_DT if options.auto else options.fixed_dt
    settings.tol = options.stage_tol * slack
    settings.order = options.order
    settings.impact = _core.ImpactMap[options.impact.upper()]
    settings.mhc_reference = _core.MhcReference[options.mhc_reference.upper()]
    settings.max_iterations = options.max_iterations
    settings.max_impacts_per_step = options.max_impacts_per_step
    settings.dense = options.dense
    settings.dt_contact = options.contact_dt if dt_contact is None else dt_contact
    settings.end_at_zeno = options.zeno == "end"
    settings.stiff_support = options.support == "stiff"
    settings.contact_points = options.contact_points
    settings.threads = options.threads
    settings.record_contacts = options.record_contacts
    settings.gradient = options.record == "gradient"
    settings.contact_steps = _core.ContactSteps[options.contact_mode.upper()]
    return settings


def reuse(
    compiled: CompiledScene, options: Options, slack: float = 1.0, dt_contact: float | None = None
) -> _core.Simulator:
    """Return a simulator that a run with these options has released, or a new one; the arguments as those of `make`."""
    waiting = compiled.engines.get(_key(options, slack, dt_contact))
    try:
        return waiting.pop() if waiting else make(compiled, options, slack, dt_contact)
    except IndexError:  # another thread has taken it
        return make(compiled, options, slack, dt_contact)


def release(
    engine: _core.Simulator,
    compiled: CompiledScene,
    options: Options,
    slack: float = 1.0,
    dt_contact: float | None = None,
) -> None:
    """Give an engine of `reuse` to later runs of the scene; it starts them by a reset."""
    waiting = compiled.engines
    if len(waiting) >= _MOST_WAITING:
        waiting.clear()
    waiting[_key(options, slack, dt_contact)] = [engine]


_values = attrgetter(*_OF_THE_ENGINE)


def _key(options: Options, slack: float, dt_contact: float | None) -> tuple[Any, ...]:
    return (slack, dt_contact, *_values(options))


def restored(compiled: CompiledScene, state: bytes) -> _core.Snapshot:
    """Return the engine's snapshot of what its to_bytes() has given; ContactviError for that of another scene."""
    return _core.Snapshot(compiled.core, state)


def start(
    engine: _core.Simulator,
    compiled: CompiledScene,
    options: Options,
    q0: ArrayLike | None,
    v0: ArrayLike | None,
    t: float = 0.0,
) -> tuple[Record, ContactviError | None]:
    """Put the engine to (q0, v0), those of the scene where None, at t [s].

    Return the record of the run that starts there, and the error if the start is refused (the record reports it too).

    Raises:
        InputError: for a bad state.
    """
    begun, moved = checked_start(compiled, options, q0, v0, t, engine)
    record, refused = start_checked(engine, compiled, options, *begun)
    record.separation = moved
    return record, refused


def checked_start(
    compiled: CompiledScene,
    options: Options,
    q0: ArrayLike | None,
    v0: ArrayLike | None,
    t: float = 0.0,
    engine: _core.Simulator | None = None,
) -> tuple[tuple[Array, Array, float], Separation | None]:
    """Return q0, v0 and t as arrays and a number, and what was moved; the arguments and errors as those of `start`.

    Args:
        engine: one that waits between two runs, in which the mass matrix is looked at; None: one made for it.
    """
    states = compiled.states
    begin = t if type(t) is float and t == 0.0 else float(inputs.array("t", t, (), "the start time in seconds"))
    q, moved = moved_apart(compiled, options, states.configuration(compiled.q0 if q0 is None else q0), begin)
    given = compiled.v0 if v0 is None else v0
    v = compiled.start_velocity(q, begin) if given is None else states.velocity(given)
    compiled.check_start(q, v, begin, engine)
    return (q, v, begin), moved


def moved_apart(compiled: CompiledScene, options: Options, q: Array, t: float) -> tuple[Array, Separation | None]:
    """Return a start, (nq,), without overlaps where the options ask for it, and what was moved for it.

    Raises:
        SeparationError: the overlaps cannot be ended within the limits.
    """
    if options.start == "given":
        return q, None
    moved = separate(compiled.built, q, None, (), t)
    return moved.q.copy(), moved


def start_checked(
    engine: _core.Simulator, compiled: CompiledScene, options: Options, q: Array, v: Array, begin: float
) -> tuple[Record, ContactviError | None]:
    """Put the engine to a start that `checked_start` has returned; the result as that of `start`."""
    result = cast(EngineStatus, engine.reset(q, v, begin))
    record = Record(compiled, options, begin, q, engine.p)
    if result["code"] == _core.StatusCode.SUCCESS:
        return record, None
    status = record.end(result, begin)
    return record, refusal(status, record.names(result), result["depth"])


def accepts(engine: _core.Simulator, q: Array, v: Array, begin: float) -> bool:
    """Put the engine to a start that `checked_start` has returned; return whether it can step from there."""
    return bool(engine.reset(q, v, begin)["code"] == _core.StatusCode.SUCCESS)


def advance(
    engine: _core.Simulator,
    record: Record,
    steps: int,
    forces: Array | None,
    progress: Progress | None,
    targets: Array | None = None,
) -> Status:
    """Make steps with forces (steps, nv) or None and record them; targets (steps, 2 nv) of servos, None without.

    Errors of the progress callback and of functions of the user are raised.
    """
    every = record.options.record_every
    result = engine.advance(steps, forces, every, progress, targets)
    return _take(record, cast(EngineResult, result))


def step_together(
    engines: list[_core.Simulator], steps: int, forces: Array | None, targets: Array | None, threads: int
) -> list[int]:
    """Make steps that the engines keep for `take`, with a row of forces (n, nv) and of targets (n, 2 nv) for each.

    Return how many ordinary steps each has made; where these are fewer, a further one, after which `take` has something
    to look at.
    """
    return list(_core.step_together(engines, steps, forces, targets, threads))


def take(engine: _core.Simulator, record: Record) -> Status | None:
    """Record the single steps that the engine has kept since this was called last; return the status, None without any.

    Errors of functions of the user are raised. Ctrl-C waits until all is recorded.
    """
    with held_back() as ctrl_c:
        result = engine.take()
        status = None if result is None else _take(record, cast(EngineResult, result))
    if ctrl_c.pressed_alone():
        ctrl_c.check()
    return status


def run_auto(
    engine: _core.Simulator, duration: float, level: float, progress: Progress | None,
    coarser: _core.KeptRun | None = None, part: float = 1.0, sample: float = 0.0,
    after_impact: int = 1, target: Array | Callable[[float], Array] | None = None, ends: Sequence[float] = (),
) -> tuple[_core.KeptRun, bool]:  # fmt: skip
    """Run for a duration [s] with steps chosen for a level [m, rad]; errors as those of `advance`.

    Return the run and whether Ctrl-C has ended it.

    Args:
        coarser: another run of the same motion, of whose steps those of this run are this part.
        sample: smooth steps that are not much longer end at its multiples [s]; 0: at no such times.
        after_impact: steps, at least, from an impact to the end of the step that it is in.
        target: references of the servos, (1, 2 nv) or a function t -> (2 nv,); None without servos.
        ends: times at which steps end, too [s], ascending.
    """
    return _kept(*engine.run_auto(duration, level, progress, coarser, part, sample, after_impact, target, ends))


def _kept(run: _core.KeptRun, error: object) -> tuple[_core.KeptRun, bool]:
    """Return the run, and whether Ctrl-C has ended it; raise any other error of a callback."""
    if isinstance(error, BaseException) and not isinstance(error, KeyboardInterrupt):
        raise error
    return run, error is not None or run.code == _core.StatusCode.INTERRUPTED


def record_of(run: _core.KeptRun, compiled: CompiledScene, options: Options, seconds: float | None = None) -> Record:
    """Return the record of a run that the engine has kept; it is empty then.

    Args:
        seconds: wall time that the record is to have; by default that of the run.
    """
    result = cast(EngineResult, dict(run.results(), error=None))
    if seconds is not None:
        result["stats"]["seconds"] = seconds
    t, q, p = result["t"], result["q"], result["p"]
    record = Record(compiled, options, float(t[0]), q[0], p[0])
    record.collect(result)
    return record


def _take(record: Record, result: EngineResult) -> Status:
    """Record what the engine did; raise the error of a callback, except Ctrl-C, which ends the run."""
    status = record.collect(result)
    error = result["error"]
    if error is not None and not isinstance(error, KeyboardInterrupt):
        raise error
    if error is not None and status.code != StatusCode.INTERRUPTED:  # pressed while a function of the user ran
        status = record.status = Status.interrupted(status.time)
    return status


def refusal(status: Status, pair: tuple[str, str] | None, depth: float) -> ContactviError:
    """Return the error of a start that the engine refuses; depth of a penetration [m; rad]."""
    what = f"The start is refused: {status.message}"
    if status.code != StatusCode.PENETRATION:
        return SimulationError(
            what,
            status=status,
            expected="a start that the engine can step from",
            got=status.message,
            remedy=remedy(status.code, "auto"),
        )
    return PenetrationError(
        what,
        pair=pair,
        depth=depth,
        expected="gaps >= 0 and joints within their limits",
        got=f"{-depth:.6g}",
        remedy=remedy(status.code, "auto"),
    )
