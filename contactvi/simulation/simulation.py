"""Running a scene: `simulate` for a whole run; contactvi.simulation.simulator goes step by step, for control loops."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import (
    AccuracyWarning,
    ConstraintError,
    DenseStepWarning,
    InputError,
    PenetrationError,
    SimulationError,
)
from contactvi.inputs import callback, check_signature, flag
from contactvi.interrupts import CtrlC, held_back
from contactvi.keywords import with_keywords
from contactvi.options import Dt, FurtherOptions, ImpactMap, Options
from contactvi.records.codes import Change
from contactvi.simulation import adaptive
from contactvi.simulation.compatibility import check_elements, check_map
from contactvi.simulation.messages import remedy
from contactvi.simulation.run import PROGRESS_PERIOD, Run
from contactvi.simulation.settings import settings_of
from contactvi.simulation.simulator import Simulator
from contactvi.simulation.targets import by_steps
from contactvi.status import Status, StatusCode
from contactvi.trajectory.compiled import CompiledScene, compile_scene, filled_scene
from contactvi.trajectory.trajectory import Trajectory

# Of the largest free speed: what repaired answers in confined heaps leave is less.
MOST_RESIDUAL = 0.5

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from contactvi.scene.scene import Scene

Array = NDArray[np.float64]
Progress = Callable[[float, int], object]
Control = Callable[[float, Array, Array], ArrayLike]


@with_keywords(FurtherOptions)
def simulate(
    scene: Scene,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    duration: float | None = None,
    dt: Dt | None = None,
    *,
    impact: ImpactMap | None = None,
    order: int | None = None,
    tol: float | None = None,
    solver_tol: float | None = None,
    sample_dt: float | None = None,
    control: ArrayLike | Control | None = None,
    target: Any = None,
    throw: bool = True,
    progress: Progress | bool | None = None,
    ledger: Mapping[str, float] | None = None,
    **options: Unpack[FurtherOptions],
) -> Trajectory:
    """Run a scene from (q0, v0) and return its trajectory.

    Args:
        scene: the scene. What is not given below is taken from its file (scene.q0, scene.v0, scene.settings), then from
            the defaults: the neutral configuration, rest, and those of `Options`.
        q0: initial configuration, Pinocchio's numbers, shape (nq,).
        v0: initial velocity, shape (nv,).
        duration: simulated time [s]; a whole number of steps where dt is a number.
        dt: time step [s]; or "auto": the run finds the steps with which q is accurate to `tol`, and measures it
            (traj.error_estimate). By default "auto", and 1e-3 where a run cannot choose: with control, a target given
            by steps, "dtec", order 2, record_every, or tolerances on the discrete energy or on jumps of the modified
            one.
        order: 2, 4, ... 16; by default 2 for a number as dt, 16 for "auto".
        tol: the accuracy asked of q, for "auto" [m, rad]; by default 1e-6.
        solver_tol: for a number as dt what the equations of a step are solved to, relative; by default 1e-12.
        sample_dt: keep the states at every sample_dt [s] instead of those at the ends of the steps.
        impact: the impact map, see `Options`.
        **options: as of `Options`.
        control: generalized forces in Pinocchio's coordinates, constant over a step [N, N m]: an array of shape (steps,
            nv), one of shape (nv,) for all steps, or a function (t, q, v) -> (nv,) called at the start of each step.
        target: reference of the servos (Scene.set_servo): an array or a function of t, one number per servo joint, or
            a mapping joint -> motion (contactvi.simulation.targets); by default as given to set_servo. Constant over a
            step of a given length, while steps of "auto" follow it at their stages.
        throw: raise SimulationError (with .status and .trajectory) when the run ends before its time, and
            PenetrationError when it starts in penetration; False returns what was computed, with its status.
        ledger: tolerances on what should be conserved, name -> bound, for example {"own_jump": 1e-10}; where one is
            exceeded the run ends with the status LEDGER. The names: contactvi.trajectory.ledger.
        progress: called as progress(t, impacts) about ten times a second; True shows a progress bar.

    Raises:
        InputError: for arguments of the wrong shape or range.
        PenetrationError, SimulationError: see `throw`.
        ConstraintError: for a start that is not on the constraints, and where motions or lengths cannot be reached.
        UserFunctionError: for functions of the user that fail or return what cannot be used. What control or progress
            raises itself comes through as it is.
        DerivativeError: for wrong derivatives of theirs.

    Warns:
        AccuracyWarning: where "auto" did not reach tol; traj.error_estimate is what it reached. Where bodies overlap or
            the energy rises by more than the error of a step.
        DenseStepWarning: once, at the end, where a run with contact_mode="auto" took dense steps: their share of the
            time and their worst figures. Not with "steps", which asks for them, and not before a SimulationError, whose
            trajectory has them.
    """
    chosen: dict[str, Any] = {
        **options, "duration": duration, "dt": dt, "impact": impact, "order": order, "tol": tol,
        "solver_tol": solver_tol, "sample_dt": sample_dt, "ledger": ledger,
    }  # fmt: skip
    throw = flag("throw", throw)
    filled_scene(scene)
    settings = settings_of(scene, chosen, forced=control is not None or by_steps(target))
    if settings.last_steps is not None:
        raise InputError(
            "A run that returns its trajectory records it", name="record", expected="'states' or 'gradient'",
            got=repr(settings.record or False), remedy="Leave record out, or step with a Simulator",
        )  # fmt: skip
    span = settings.span
    compiled = compile_scene(scene)
    if settings.auto:
        check_no_steps(control, target)
    steps = 0 if settings.auto else settings.steps
    if callable(control):
        check_signature("control", control, ("t", "q", "v"))
    inputs = control if control is None or callable(control) else compiled.states.forces(control, steps)
    called = None if isinstance(progress, bool) else callback("progress", progress)
    with held_back() as ctrl_c:
        if progress is True:
            from contactvi.progress import RunProgress

            with RunProgress(span) as bar:
                traj = run_compiled(compiled, settings, q0, v0, inputs, target, bar, throw, ctrl_c)
        else:
            traj = run_compiled(compiled, settings, q0, v0, inputs, target, called, throw, ctrl_c)
        dense = settings.contact_mode == "auto" and traj.stats.dense_steps > 0
        broken = broken_promises(traj)
        if ctrl_c.settle() and traj.status.ok:  # between the end of the run and now
            traj.status = Status.interrupted(traj.status.time)
        if throw and not traj.status.ok:
            raise ended_early(settings, traj.status, traj)
        if dense or broken:
            _warn(traj, dense, broken)
        return traj


def _warn(traj: Trajectory, dense: bool, broken: list[str]) -> None:
    """Warn, at the line that called the caller, that a run took dense steps, and of what it did not keep."""
    if dense:
        warn_of_dense_steps(traj, stacklevel=4)
    for text in broken:
        warnings.warn(text, AccuracyWarning, stacklevel=3)


def ended_early(options: Options, status: Status, traj: Trajectory | None) -> SimulationError:
    """Return the error of a run that ended before its time; traj: what was computed, None where it was not kept."""
    broken = status.code == StatusCode.LEDGER
    fact = "exceeds a tolerance of its ledger" if broken else "ended before its time"
    return SimulationError(
        f"The run {fact} with the status {status.code.name}: {status.message}",
        expected=f"t = {options.span if options.auto else options.steps * options.fixed_dt:.9g} s",
        got=f"t = {status.time:.9g} s",
        remedy=remedy(status.code, options.contact_mode, options.zeno, options.impact),
        status=status,
        trajectory=traj,
    )


def warn_of_dense_steps(traj: Trajectory, stacklevel: int = 3) -> None:
    """Warn that a run took dense steps; by default the warning is that of the line that called the caller."""
    steps, span = traj.dense_steps, float(traj.status.time - traj.t[0])
    warnings.warn(
        f"Dense contact: {len(steps)} dense steps for {steps.span:.4g} s of {span:.4g} s, in which impacts have no"
        f" times; {steps.worst()}. contact_mode='events' refuses such steps, 'steps' asks for them",
        DenseStepWarning,
        stacklevel=stacklevel,
    )


def broken_promises(traj: Trajectory) -> list[str]:
    """Return in words where bodies overlap, the energy of dense steps rises, or they do not meet Coulomb's law."""
    told, changes, rises = [], traj.contact_changes, traj.dense_steps["energy_rise"]
    overlaps = np.flatnonzero(changes.array("change") == Change.OVERLAP)
    if len(overlaps):
        first, worst = changes[int(overlaps[0])], changes[int(overlaps[np.argmin(changes.array("value")[overlaps])])]
        told.append(
            f"Bodies overlap by more than is promised: {worst.pair[0]!r} and {worst.pair[1]!r} by {-worst.value:.2g} m"
            f" at t = {worst.time:.6g} s, first at t = {first.time:.6g} s (traj.contact_changes with 'overlap')."
            " Smaller steps (dt, dt_contact) keep gaps better"
        )
    if np.any(rises > 0.0):
        k, since = int(np.argmax(rises)), int(np.argmax(rises > 0.0))
        told.append(
            f"The energy rises by more than the error of a dense step: by {rises[k]:.2g} J at t ="
            f" {traj.dense_steps.t[k]:.6g} s, first at t = {traj.dense_steps.t[since]:.6g} s"
            " (traj.dense_steps['energy_rise'])"
        )
    residuals = traj.dense_steps["residual"]
    if np.any(residuals > MOST_RESIDUAL):
        k = int(np.argmax(residuals))
        told.append(
            f"Coulomb's law is not met in {int(np.sum(residuals > MOST_RESIDUAL))} of {len(residuals)} dense steps: by"
            f" up to {residuals[k]:.2g} of the largest free speed, at t = {traj.dense_steps.t[k]:.6g} s"
            " (traj.dense_steps['residual'])"
        )
    return told


def check_no_steps(control: Any, target: Any) -> None:
    """Raise InputError where inputs of a run that chooses its steps are given by steps."""
    inputs = "control" if control is not None else "a target for each step" if by_steps(target) else None
    if inputs is not None:
        raise InputError(
            "Inputs are constant over a step, so the run cannot choose it", name="dt",
            expected=f"a time in seconds with {inputs}", got="'auto'", remedy="Give dt=..., for example dt=1e-3",
        )  # fmt: skip


def run_compiled(
    compiled: CompiledScene,
    options: Options,
    q0: ArrayLike | None,
    v0: ArrayLike | None,
    control: Array | Control | None,
    target: Any,
    progress: Progress | None,
    throw: bool,
    ctrl_c: CtrlC,
) -> Trajectory:
    """Run a scene with inputs that are checked; the arguments as those of `simulate`, and so are the errors.

    Only a run that ends before its time without an error of its own is returned with its status whatever `throw` is.
    """
    compiled = compiled.at_start(q0)
    if options.auto:
        return adaptive.run(compiled, options, q0, v0, target, progress, throw, ctrl_c)
    check_map(compiled, options)
    check_elements(compiled, options)
    run = Run(compiled, options, q0, v0)
    if run.refused is not None:
        if throw or not isinstance(run.refused, PenetrationError):
            raise run.refused
        return run.trajectory()
    try:
        if callable(control):
            _follow(run, compiled, control, target, ctrl_c.watch(progress), ctrl_c)
        else:
            run.advance(options.steps, control, run.targets(target, options.steps), ctrl_c.watch(progress))
    except KeyboardInterrupt:
        run.interrupt()
    if throw and run.unreachable is not None:
        traj = run.trajectory()
        raise no_way_on(run.unreachable, traj.status, traj)
    traj = run.trajectory()
    if traj.status.ok:
        run.release()
    return traj


def no_way_on(found: ConstraintError, status: Status, traj: Trajectory | None) -> ConstraintError:
    """Return the error of a run that came to where its constraints cannot be met; traj as in `ended_early`."""
    names = ", ".join(repr(name) for name in found.constraints)
    return ConstraintError(
        f"The run came to where there is no way on for the constraints {names}, at t = {status.time:.9g} s",
        residuals=found.residuals,
        expected="loops that stay closed, lengths and motions that can be reached",
        got=found.got,
        remedy="Mend the prescribed motions and lengths; error.trajectory is what was computed",
        status=status,
        trajectory=traj,
    )


def _follow(
    run: Run, compiled: CompiledScene, control: Control, target: Any, progress: Progress, ctrl_c: CtrlC
) -> None:
    last, steps = time.perf_counter(), run.options.steps
    targets = run.targets(target, steps)
    for k in range(steps):
        t = run.t
        tau = compiled.states.controlled(control(t, run.q, run.v), t)
        if not run.advance(1, tau[None], None if targets is None else targets[k : k + 1]).ok:
            return
        ctrl_c.check()
        if time.perf_counter() - last > PROGRESS_PERIOD:
            last = time.perf_counter()
            progress(run.t, run.record.impacts)


__all__ = ["Simulator", "simulate"]
