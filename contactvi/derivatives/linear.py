"""The linear systems that belong to a scene at a state: of one step, and of the equations of motion.

Columns and rows are Pinocchio's: tangent vectors at q (of a free body: linear and angular, body frame) and velocities.
The derivative of a step is that of the discrete map itself, exact to rounding, not the flow's
(docs/theory/step_derivatives.md); it converges to the continuous one with the order of the step.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi import inputs
from contactvi.derivatives.constrained_dynamics import constrained_accelerations
from contactvi.errors import NotDifferentiable, SimulationError
from contactvi.options import Options
from contactvi.scene.dynamics import bias_forces, inverse_mass_matrix
from contactvi.scene.scene import Scene
from contactvi.simulation.compatibility import check_unforced
from contactvi.simulation.run import Run
from contactvi.simulation.settings import settings_of
from contactvi.simulation.targets import Targets
from contactvi.text import fields_shown
from contactvi.trajectory.compiled import CompiledScene, compile_scene

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]
Numbers = tuple[Array, Array, Array, Array, Array]  # q, x, A, B, dt of StepDerivatives

STATES = ("velocity", "momentum")
SAME = 1e-9  # relative: ends of a step, solved once in a run and once to rounding, differ by less
TOUCHING = 1e-9  # [m; rad] gap up to which a contact may act: what persistent contacts keep to


@dataclass(frozen=True, eq=False)
class StepDerivatives:
    """One step and its derivatives, x being the velocity or the momentum.

    Attributes:
        q: configuration at the end, shape (nq,). x: velocity [m/s, rad/s] or momentum there, shape (nv,).
        A: d(q, x)/d(q0, x0), shape (2 nv, 2 nv). B: d(q, x)/d tau, shape (2 nv, nv).
        dt: d(q, x)/d dt, shape (2 nv,).
    """

    q: Array
    x: Array
    A: Array
    B: Array
    dt: Array

    __repr__ = fields_shown


@dataclass(frozen=True, eq=False)
class ForwardDynamics:
    """The acceleration a(q, v, tau) and its derivatives.

    Attributes:
        a: dv/dt, shape (nv,) [m/s^2, rad/s^2], Pinocchio's.
        a_q, a_v, a_tau: derivatives with respect to q (tangent), v and tau, shapes (nv, nv).
    """

    a: Array
    a_q: Array
    a_v: Array
    a_tau: Array

    __repr__ = fields_shown


def linearize(
    scene: Scene,
    q: ArrayLike,
    v: ArrayLike | None = None,
    tau: ArrayLike | None = None,
    dt: float = 1e-3,
    *,
    order: int = 2,
    target: Any = None,
    t: float = 0.0,
    state: str = "velocity",
) -> tuple[Array, Array]:
    """Return A (2 nv, 2 nv) and B (2 nv, nv) of one step: d(q1, v1) = A d(q0, v0) + B d tau.

    Arguments and errors as those of `step_derivatives`.
    """
    step = step_derivatives(scene, q, v, tau, dt, order=order, target=target, t=t, state=state)
    return step.A, step.B


def step_derivatives(
    scene: Scene,
    q: ArrayLike,
    v: ArrayLike | None = None,
    tau: ArrayLike | None = None,
    dt: float = 1e-3,
    *,
    order: int = 2,
    target: Any = None,
    t: float = 0.0,
    state: str = "velocity",
) -> StepDerivatives:
    """Make one step without contact and return it with its exact derivatives.

    With constraints A is the derivative of the step as it is computed, which ends on them. Changes of (q, v) that
    satisfy them to first order lead to such changes, and only these are derivatives of starts that a run accepts. Along
    others a column tells where the step brings them: back onto the constraints at its end, by an impulse in their
    gradients; where constraints depend on each other, to least squares.

    Joint friction acts as at the start of a run, where no joint sticks yet.

    Args:
        q, v: state at the start, shapes (nq,), (nv,); v = None: at rest.
        tau: generalized force over the step, shape (nv,) [N, N m]; None: zero.
        dt: step [s]. order: 2, 4, ... 16. t: time of its start [s], for what depends on it.
        target: where servos are to go, as in `simulate`; it stays as it is.
        state: what stands beside q: "velocity" or "momentum" (with it A is symplectic where nothing damps).

    Raises:
        InputError, PenetrationError: as `simulate`. DerivativeError: a function of the user has no derivatives.
        ConstraintError: the start does not satisfy the constraints.
        NotDifferentiable: there is an impact, a persistent contact or an actuator at its limit in the step, or a joint
            at the limit of its friction without motion; a step with constraints or joint friction is made in parts.
    """
    inputs.check_choice("state", state, STATES, "Unknown kind of state")
    t, dt = inputs.real("t", t), inputs.positive("dt", dt, "the step in seconds, > 0, for example 1e-3")
    compiled = compile_scene(scene).at_start(q)
    options = _step_options(compiled, scene, dt, order)
    compiled.check_differentiable()
    force = np.zeros(compiled.states.nv) if tau is None else compiled.states.force(tau)
    found = None
    if not compiled.built.constrained:
        found = _clear_step(compiled, options, q, v, force, target, t, state == "momentum")
    if found is None:
        found = _checked_step(compiled, options, q, v, force, target, t, state == "momentum")
    return StepDerivatives(*found)


def _step_options(compiled: CompiledScene, scene: Scene, dt: float, order: int) -> Options:
    """Return the options of one step; those of the last step are kept with the scene."""
    key = (type(dt), dt, type(order), order) if isinstance(dt, float) and isinstance(order, int) else None
    if key is None or compiled.step_options is None or compiled.step_options[0] != key:
        chosen = {"dt": dt, "duration": dt, "order": order, "contact_mode": "events", "ledger": None, "start": "given"}
        chosen["dense"] = compiled.built.constrained  # to see in how many parts the step is made
        compiled.step_options = (key, settings_of(scene, chosen))
    return compiled.step_options[1]


def _clear_step(
    compiled: CompiledScene, options: Options, q: ArrayLike, v: ArrayLike | None, force: Array, target: Any, t: float,
    momentum: bool,
) -> Numbers | None:  # fmt: skip
    """Linearise a step that is beyond doubt without contact; None: a run has to tell, with its checks of the start."""
    states, built = compiled.states, compiled.built
    if compiled.starts_unchecked or type(t) is not float or (target is not None and not built.servo_joints):
        return None
    at = states.configuration(q)
    given = compiled.v0 if v is None else v
    speed = np.zeros(states.nv) if given is None else states.velocity(given)
    if np.any(force):
        check_unforced(options)
    rows = Targets(compiled, at).rows(target, np.array([t])) if built.servo_joints else None
    core = compiled.core
    x = np.asarray(core.momentum(at[None], speed[None]))[0] if momentum else speed
    with _linearizer(compiled, options) as linearizer:
        return linearizer.step(at, x, momentum, options.fixed_dt, force, None if rows is None else rows[0], t)


@contextlib.contextmanager
def _linearizer(compiled: CompiledScene, options: Options) -> Iterator[_core.Linearizer]:
    """Lend an engine that linearises steps; it is kept with the scene, as making one takes longer than its use.

    One user at a time has it: functions of the user may let another thread run.
    """
    from contactvi import _core

    spare = compiled.linearizers.setdefault((options.order, options.stage_tol), [])
    engine = spare.pop() if spare else _core.Linearizer(compiled.core, options.order, options.stage_tol)
    try:
        yield engine
    finally:
        spare.append(engine)


def _checked_step(
    compiled: CompiledScene, options: Options, q: ArrayLike, v: ArrayLike | None, force: Array, target: Any, t: float,
    momentum: bool,
) -> Numbers:  # fmt: skip
    """Linearise a step after a run has made it, which tells what happens in it."""
    run = Run(compiled, options, q, v, t)
    if run.refused is not None:
        raise run.refused
    start, p = run.q, run.p
    rows = run.targets(target, 1)
    status = run.advance(1, force[None], rows)
    _check_smooth(run)
    if not status.ok:
        raise SimulationError(
            f"The step was not made: {status.message}", expected="one step without contact", got=status.code.name,
            remedy="Use a smaller dt", status=status,
        )  # fmt: skip
    segments = run.record.segments_joined()
    parts = 1 if segments is None else len(segments)
    if compiled.built.constrained and parts > 1:
        raise NotDifferentiable(
            "A run makes the step in parts, for a change of joint friction or a large step", reason="step", time=t,
            expected="a step that is made as a whole", got=f"{parts} parts", remedy="Use a smaller dt",
        )  # fmt: skip
    x = p if momentum else np.asarray(compiled.core.velocity(start[None], p[None]))[0]
    found = _linear_step(compiled, options, start, x, momentum, force, None if rows is None else rows[0], t)
    end = found[0]
    off = float(np.abs(end - run.q).max(initial=0.0))
    if off > SAME * (1.0 + float(np.abs(end).max(initial=0.0))):
        raise NotDifferentiable(
            "An actuator is at its limit in the step, or a rope goes slack or taut", reason="saturation", time=t,
            expected="one law of each force over the step", got=f"a step whose end is {off:.2g} off without them",
            remedy="Ask for less, or take the limits off: scene.set_actuator('*', effort=False, velocity=False)",
        )  # fmt: skip
    return found


def _linear_step(
    compiled: CompiledScene, options: Options, q: Array, x: Array, momentum: bool, force: Array, target: Array | None,
    t: float,
) -> Numbers:  # fmt: skip
    from contactvi import _core

    step = (compiled.core, q, x, momentum, options.fixed_dt, force, target, t, options.order, options.stage_tol)
    if not compiled.built.constrained:
        return _core.linear_step(*step)
    found = _core.linear_contact_step(*step)
    if isinstance(found, dict):
        raise NotDifferentiable(
            found["fact"], reason=found["reason"], time=found["time"], expected=found["expected"], got=found["got"],
            remedy=found["remedy"],
        )  # fmt: skip
    return found


def forward_dynamics_derivatives(
    scene: Scene,
    q: ArrayLike,
    v: ArrayLike | None = None,
    tau: ArrayLike | None = None,
    *,
    target: Any = None,
    t: float = 0.0,
) -> ForwardDynamics:
    """Return the acceleration where nothing touches and its derivatives.

    Springs, dampers, servos, wrenches and functions of the user act as in a run. Arguments as those of
    `step_derivatives`; no actuator has a limit here.

    Under constraints the acceleration is that which keeps their second derivatives in time at zero, also where the
    state does not satisfy them. Columns along changes that satisfy them to first order are those of the motion.

    Raises:
        InputError: for a bad state. DerivativeError: a function of the user has no derivatives.
        NotDifferentiable: a contact or limit touches, or there are screws or joint friction.
    """
    compiled, time = compile_scene(scene).at_start(q), inputs.real("t", t)
    _check_frictionless(compiled)
    states, core = compiled.states, compiled.core
    at = states.configuration(q, "q")
    w = states.velocity(v, "v")
    force = np.zeros(states.nv) if tau is None else states.force(tau)
    _check_apart(compiled, at)
    rows = Targets(compiled, at).rows(target, np.array([time]))
    from contactvi import _core

    own, f_q, f_v = _core.linear_forces(core, at, w, None if rows is None else rows[0], time)
    built = compiled.built
    inverse = inverse_mass_matrix(built, at)
    if built.elements.constraints:
        return ForwardDynamics(*constrained_accelerations(built, inverse, at, w, time, force + own, f_q, f_v))
    a = inverse @ (force + own - bias_forces(built, at, w))
    b_q, b_v = map(np.asarray, built.engine.model.motion(at, w, a).force_derivatives())
    return ForwardDynamics(a, inverse @ (f_q - b_q), inverse @ (f_v - b_v), inverse)


def _check_frictionless(compiled: CompiledScene) -> None:
    """Raise for scenes of whose accelerations no derivative is known."""
    compiled.check_differentiable()
    if np.any(compiled.built.arrays.joint_friction > 0.0):
        raise NotDifferentiable(
            "Accelerations under joint friction have no derivatives that are known", reason="constraint",
            expected="forces that are smooth in the state", got="joint friction",
            remedy="Linearise a step: contactvi.linearize(...)",
        )  # fmt: skip


def _check_smooth(run: Run) -> None:
    """Raise NotDifferentiable where something happened in the step that its smooth equations do not know."""
    record = run.record
    for event in record.log():
        raise NotDifferentiable(
            "There is an impact in the step", reason="impact", pair=event.pair, time=event.time,
            expected="a step without contact", got=f"{event.pair[0]} - {event.pair[1]} at t = {event.time:.9g} s",
            remedy="Linearise a step before or after it",
        )  # fmt: skip
    log = record.contact_log()
    if len(log):
        pair, time = log[0].pair, float(log.t[0])
        raise NotDifferentiable(
            "There is a persistent contact in the step", reason="contact", pair=pair, time=time,
            expected="a step without contact", got=f"{pair[0]} - {pair[1]}",
            remedy="Start where nothing touches, or take the pair out: scene.disable_pair(...)",
        )  # fmt: skip


def _check_apart(compiled: CompiledScene, q: Array) -> None:
    """Raise NotDifferentiable where a pair or a joint limit touches."""
    gaps = np.asarray(compiled.core.gaps(q)[0])
    found = [(float(gap), pair) for gap, pair in zip(gaps, compiled.pair_names, strict=True)]
    model, used = compiled.built.model, compiled.built.arrays.limits
    for k in map(int, np.flatnonzero(used)):
        at, name = model.idx_qs[k], str(model.names[k])
        found.append((float(q[at] - model.lowerPositionLimit[at]), (name, "lower limit")))
        found.append((float(model.upperPositionLimit[at] - q[at]), (name, "upper limit")))
    least, pair = min(found, default=(np.inf, ("", "")))
    if least > TOUCHING:
        return
    raise NotDifferentiable(
        "Something touches", reason="contact", pair=pair, expected=f"gaps above {TOUCHING:g}",
        got=f"{least:.3g} between {pair[0]} and {pair[1]}", remedy="Linearise where nothing touches",
    )  # fmt: skip
