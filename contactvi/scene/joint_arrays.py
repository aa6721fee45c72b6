"""Joint settings as arrays for the engine, and as changes of the model that is simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from contactvi.elements.constraints import EqualityConstraint
from contactvi.elements.signals import Signal
from contactvi.importing.joint_kinds import has_limits
from contactvi.scene.joints import JointSettings, JointTable, file_limit


@dataclass
class JointArrays:
    """Joint settings as arrays for the engine.

    Attributes:
        stiffness, rest: Of linear springs, shapes (njoints,) [N m/rad or N/m], (nq,).
        limits: Whether the limits of a joint are used, shape (njoints,), bool.
        limit_restitution: Of impacts at the limits, shape (njoints,).
        joint_friction: Largest friction force, shape (nv,) [N m or N].
        servo: kp, kd and effort limit, shape (3, nv).
        actuator: Effort and velocity limits, inf for none, shape (2, nv).
        targets: Motions of servos by joint name.
        polynomials: Joint, rest and coefficients k1, k2, ... of the torque of nonlinear springs.
    """

    stiffness: np.ndarray
    rest: np.ndarray
    limits: np.ndarray
    limit_restitution: np.ndarray
    joint_friction: np.ndarray
    servo: np.ndarray
    actuator: np.ndarray
    targets: dict[str, Signal]
    polynomials: list[tuple[int, float, np.ndarray]]


def apply_settings(
    model: pin.Model,
    start: np.ndarray,
    table: JointTable,
    default_restitution: float,
    equalities: Sequence[EqualityConstraint] = (),
) -> JointArrays:
    """Write damping, armature and limits into the model and return the other arrays.

    Limits that are not used become infinite in the model, so that it is what is simulated. `start`, the neutral
    configuration (nq,), is moved into the limits, then joints that follow others to the values these give. It is the
    rest of springs for which none is given.
    """
    nj, nv = model.njoints, model.nv
    arrays = JointArrays(
        stiffness=np.zeros(nj), rest=start.copy(), limits=np.zeros(nj, dtype=bool),
        limit_restitution=np.full(nj, float(default_restitution)), joint_friction=np.zeros(nv),
        servo=np.zeros((3, nv)), actuator=np.full((2, nv), np.inf), targets={}, polynomials=[],
    )  # fmt: skip
    for i in range(1, nj):
        own = table.of(model.names[i])
        _apply_limits(model, i, own, start, arrays.limits)
        _apply_inertia(model, i, own)
        if own.restitution is not None:
            arrays.limit_restitution[i] = own.restitution
    follow(model, start, equalities)
    for i in range(1, nj):
        own = table.of(model.names[i])
        q = slice(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
        arrays.rest[q] = start[q] if own.rest is None else own.rest
        arrays.stiffness[i] = own.stiffness or 0.0
        if own.spring is not None and np.any(own.spring):
            arrays.polynomials.append((i, float(arrays.rest[q][0]), own.spring))
        _apply_actuation(model, i, own, arrays)
    return arrays


def follow(model: pin.Model, q: np.ndarray, equalities: Sequence[EqualityConstraint]) -> None:
    """Move joints that follow others in q (nq,) to the values these give, along chains too; circles stay unsolved."""
    for _ in equalities:
        before = q.copy()
        for constraint in equalities:
            target = model.idx_qs[model.getJointId(constraint.joint)]
            other = 0.0 if constraint.other is None else q[model.idx_qs[model.getJointId(constraint.other)]]
            q[target] = constraint.value(float(other))
        if np.array_equal(q, before):
            return


def _apply_limits(model: pin.Model, i: int, own: JointSettings, start: np.ndarray, limits: np.ndarray) -> None:
    q = slice(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
    if isinstance(own.limits, tuple):
        model.lowerPositionLimit[q], model.upperPositionLimit[q] = own.limits
    limits[i] = has_limits(model, i) and own.limits is not False
    if limits[i]:
        start[q] = np.clip(start[q], model.lowerPositionLimit[q], model.upperPositionLimit[q])
    else:
        model.lowerPositionLimit[q], model.upperPositionLimit[q] = -np.inf, np.inf


def _apply_inertia(model: pin.Model, i: int, own: JointSettings) -> None:
    """Set damping, and the armature with what the rotor adds through the gear."""
    v = slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])
    if own.damping is not None:
        model.damping[v] = own.damping
    if own.armature is not None:
        model.armature[v] = own.armature
    if own.rotor_inertia is not None:
        ratio = 1.0 if own.gear_ratio is None else own.gear_ratio
        model.armature[v] = np.asarray(model.armature[v]) + own.rotor_inertia * ratio**2


def _apply_actuation(model: pin.Model, i: int, own: JointSettings, arrays: JointArrays) -> None:
    """Set joint friction, servo and limits of the actuator in the arrays."""
    if model.nvs[i] != 1:
        return
    v = model.idx_vs[i]
    if own.friction is not None and own.friction is not False:
        file = float(model.upperDryFrictionLimit[v])
        arrays.joint_friction[v] = file if own.friction is True else own.friction
    if own.servo is not None:
        limit = file_limit(model, v, "effort") if own.servo.effort is None else own.servo.effort
        arrays.servo[:, v] = own.servo.kp, own.servo.kd, limit
        if own.servo.target is not None:
            arrays.targets[model.names[i]] = own.servo.target
    for row, key in enumerate(("effort", "velocity")):
        value = getattr(own, key)
        if value is not None and value is not False:
            arrays.actuator[row, v] = file_limit(model, v, key) if value is True else value
