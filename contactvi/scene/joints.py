"""What the scene knows about joints beyond the model: springs, damping, friction, drives, limits.

Units: rad, m, N m/rad, N/m, N m s/rad, N s/m, N m, N, kg m^2, kg.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from contactvi.elements.elements import EqualityConstraint, coefficients_of
from contactvi.elements.signals import Signal
from contactvi.errors import InputError
from contactvi.importing.checks import NO_LIMIT, ONE_DOF, has_limits, joint_kind
from contactvi.inputs import real, vector
from contactvi.scene.joint_values import joint_value

SPRUNG = (*ONE_DOF, "spherical", "translation")
_PARTS = {"free": (3, 3), "planar": (2, 1)}  # linear, angular dofs


class Servo(NamedTuple):
    """Joint PD in the engine: kp, kd, effort limit (None: the file's), where to (None: where the joint starts)."""

    kp: float
    kd: float
    effort: float | None = None
    target: Signal | None = None


@dataclass
class JointSettings:
    """Overrides for one joint; None leaves the model's value (limits: used where lower < upper are finite).

    friction, effort, velocity: True is the file's, False none, which is also the default.
    """

    stiffness: float | None = None
    rest: np.ndarray | None = None
    damping: np.ndarray | None = None
    limits: bool | tuple[float, float] | None = None
    restitution: float | None = None
    friction: bool | float | None = None
    spring: np.ndarray | None = None
    armature: float | None = None
    gear_ratio: float | None = None
    rotor_inertia: float | None = None
    servo: Servo | None = None
    effort: bool | float | None = None
    velocity: bool | float | None = None

    def update(self, other: JointSettings) -> None:
        """Take over what `other` says."""
        for name, value in vars(other).items():
            if value is not None:
                setattr(self, name, value)


@dataclass
class JointArrays:
    """Arrays for the engine.

    stiffness (njoints,), rest (nq,), limits (njoints,) bool, limit_restitution (njoints,), dry_friction (nv,),
    servo (3, nv): kp, kd, effort; actuator (2, nv): effort and velocity limits, inf for none. targets: of servos, by
    joint name. polynomials: (joint, rest, coefficients k1, k2, ... of the torque) of nonlinear springs.
    """

    stiffness: np.ndarray
    rest: np.ndarray
    limits: np.ndarray
    limit_restitution: np.ndarray
    dry_friction: np.ndarray
    servo: np.ndarray
    actuator: np.ndarray
    targets: dict[str, Signal]
    polynomials: list[tuple[int, float, np.ndarray]]


def joint_settings(model: pin.Model, name: str, **values: Any) -> JointSettings:
    """Return checked settings for joint `name` of the model; values: fields of JointSettings but servo.

    Raises:
        InputError: a value of the wrong range or shape, or one that this type of joint cannot have.
    """
    values = {key: value for key, value in values.items() if value is not None}
    index = model.getJointId(name)
    kind = str(joint_kind(model.joints[index]))
    result = JointSettings()
    if "stiffness" in values:
        result.stiffness = real(f"stiffness of {name!r}", values["stiffness"], 0.0)
    if "rest" in values:
        result.rest = joint_value(model, name, values["rest"], f"rest of {name!r}")
    if ("stiffness" in values or "rest" in values) and kind not in SPRUNG:
        raise InputError(
            f"Spring on joint {name!r}",
            name="stiffness",
            expected=f"a joint of type {', '.join(SPRUNG)}",
            got=kind,
            remedy="Build the joint from translation and spherical joints",
        )
    if "damping" in values:
        result.damping = _damping(name, kind, model.joints[index].nv, values["damping"])
    if "limits" in values:
        result.limits = _limits(model, index, name, values["limits"])
    if "restitution" in values:
        result.restitution = real(f"restitution of the limits of {name!r}", values["restitution"], 0.0, 1.0)
    if "spring" in values:
        one_number(model, name, "spring")
        result.spring = coefficients_of(f"spring of {name!r}", values["spring"])
    for key in ("friction", "effort", "velocity"):
        if key in values:
            setattr(result, key, _from_file_or_number(model, name, key, values[key]))
    for key in ("armature", "rotor_inertia", "gear_ratio"):
        if key in values:
            if kind in _PARTS:
                _refuse_kind(f"Argument {key}", name, key, "a joint that is not free or planar", kind)
            setattr(result, key, real(f"{key} of {name!r}", values[key], 0.0 if key != "gear_ratio" else -np.inf))
    return result


def servo_settings(model: pin.Model, name: str, kp: Any, kd: Any, effort: Any, target: Any) -> JointSettings:
    """Return checked settings of a servo on a joint with one degree of freedom. Raises InputError."""
    kind = joint_kind(model.joints[model.getJointId(name)])
    if kind not in ONE_DOF:
        _refuse_kind("A servo", name, "joint", "a joint with one degree of freedom", str(kind))
    values = [real(f"{what} of the servo of {name!r}", value, 0.0) for what, value in (("kp", kp), ("kd", kd))]
    limit = None if effort is None else _positive(f"effort of the servo of {name!r}", effort)
    goal = None if target is None else Signal(target, f"target of joint {name!r}")
    return JointSettings(servo=Servo(values[0], values[1], limit, goal))


def one_number(model: pin.Model, name: str, what: str) -> int:
    """Return the index of a joint with one number in q and in v; raise InputError for another one."""
    index = model.getJointId(name)
    joint = model.joints[index]
    if joint.nq != 1 or joint.nv != 1:
        expected = "a revolute, prismatic or helical joint (one number in q)"
        _refuse_kind(f"A {what}", name, "joint", expected, str(joint_kind(joint)))
    return int(index)


def _refuse_kind(what: str, name: str, argument: str, expected: str, kind: str) -> None:
    raise InputError(f"{what} on joint {name!r}", name=argument, expected=expected, got=f"a {kind} joint")


def _positive(name: str, value: Any) -> float:
    """Return a number > 0, or inf for none."""
    if isinstance(value, float) and value == np.inf:
        return value
    return real(name, value, 0.0, open_low=True)


def _from_file_or_number(model: pin.Model, name: str, key: str, value: Any) -> bool | float:
    """Return a checked friction, effort or velocity limit: True (the file's, if it has one), False or a number."""
    joint = model.joints[model.getJointId(name)]
    if joint.nv != 1 and value is not False:
        _refuse_kind(f"Argument {key}", name, key, "a joint with one degree of freedom", str(joint_kind(joint)))
    if not isinstance(value, (bool, np.bool_)):
        return (
            real(f"friction of {name!r}", value, 0.0) if key == "friction" else _positive(f"{key} of {name!r}", value)
        )
    given = key == "friction" or np.isfinite(file_limit(model, joint.idx_v, key))
    if value and not given:
        raise InputError(
            f"The {key} limit of joint {name!r}",
            name=key,
            expected="a limit > 0 in the model's file, or a number",
            got="none in the file",
            remedy=f"Give it: {key}=10.0",
        )
    return bool(value)


def file_limit(model: pin.Model, dof: int, key: str) -> float:
    """Return the effort or velocity limit that the file gives a degree of freedom; inf where it gives none."""
    limit = float((model.upperEffortLimit if key == "effort" else model.upperVelocityLimit)[dof])
    return limit if 0.0 < limit < NO_LIMIT else np.inf


def _damping(name: str, kind: str, nv: int, damping: Any) -> np.ndarray:
    """One number for all dofs, or (linear, angular) for free and planar joints."""
    if kind in _PARTS and np.shape(damping) == (2,):
        linear, angular = (real(f"damping of {name!r}", d, 0.0) for d in damping)
        return np.repeat([linear, angular], _PARTS[kind])
    return np.full(nv, real(f"damping of {name!r}", damping, 0.0))


def _limits(model: pin.Model, index: int, name: str, limits: Any) -> bool | tuple[float, float]:
    one_dof = joint_kind(model.joints[index]) in ONE_DOF and model.joints[index].nq == 1
    if isinstance(limits, (bool, np.bool_)):
        if limits and not has_limits(model, index):
            raise InputError(
                f"Limits of joint {name!r}",
                name="limits",
                expected="a joint with finite lower < upper",
                got="none in the model",
                remedy="Give them: limits=(lower, upper)",
            )
        return bool(limits)
    lower, upper = vector(f"limits of {name!r}", limits, 2).tolist()
    if not one_dof or lower >= upper:
        raise InputError(
            f"Limits of joint {name!r}",
            name="limits",
            expected="lower < upper on a revolute, prismatic or helical joint",
            got=f"({lower:g}, {upper:g}) on a {joint_kind(model.joints[index])} joint",
        )
    return lower, upper


def apply_settings(
    model: pin.Model,
    start: np.ndarray,
    settings: Mapping[str, JointSettings],
    default_restitution: float,
    equalities: Sequence[EqualityConstraint] = (),
) -> JointArrays:
    """Write damping, armature and limits into the model and return the other arrays.

    Limits that are not used become infinite in the model, so that it says what is simulated. `start`, the neutral
    configuration, is moved into the limits, then joints that follow others to where these say, and is the rest of the
    springs where none is given.
    """
    nj, nv = model.njoints, model.nv
    arrays = JointArrays(
        stiffness=np.zeros(nj), rest=start.copy(), limits=np.zeros(nj, dtype=bool),
        limit_restitution=np.full(nj, float(default_restitution)), dry_friction=np.zeros(nv),
        servo=np.zeros((3, nv)), actuator=np.full((2, nv), np.inf), targets={}, polynomials=[],
    )  # fmt: skip
    for i in range(1, nj):
        own = settings.get(model.names[i], JointSettings())
        _apply_limits(model, i, own, start, arrays.limits)
        _apply_inertia(model, i, own)
        if own.restitution is not None:
            arrays.limit_restitution[i] = own.restitution
    follow(model, start, equalities)
    for i in range(1, nj):
        own = settings.get(model.names[i], JointSettings())
        q = slice(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
        arrays.rest[q] = start[q] if own.rest is None else own.rest
        arrays.stiffness[i] = own.stiffness or 0.0
        if own.spring is not None and np.any(own.spring):
            arrays.polynomials.append((i, float(arrays.rest[q][0]), own.spring))
        _apply_drive(model, i, own, arrays)
    return arrays


def follow(model: pin.Model, q: np.ndarray, equalities: Sequence[EqualityConstraint]) -> None:
    """Move joints that follow others in q (nq,) to where these say; chains are followed, circles are left."""
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
    """Damping, and the armature with what the rotor adds through the gear."""
    v = slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])
    if own.damping is not None:
        model.damping[v] = own.damping
    if own.armature is not None:
        model.armature[v] = own.armature
    if own.rotor_inertia is not None:
        ratio = 1.0 if own.gear_ratio is None else own.gear_ratio
        model.armature[v] = np.asarray(model.armature[v]) + own.rotor_inertia * ratio**2


def _apply_drive(model: pin.Model, i: int, own: JointSettings, arrays: JointArrays) -> None:
    """Dry friction, servo, limits of the actuator."""
    if model.nvs[i] != 1:
        return
    v = model.idx_vs[i]
    if own.friction is not None and own.friction is not False:
        file = float(model.upperDryFrictionLimit[v])
        arrays.dry_friction[v] = file if own.friction is True else own.friction
    if own.servo is not None:
        limit = file_limit(model, v, "effort") if own.servo.effort is None else own.servo.effort
        arrays.servo[:, v] = own.servo.kp, own.servo.kd, limit
        if own.servo.target is not None:
            arrays.targets[model.names[i]] = own.servo.target
    for row, key in enumerate(("effort", "velocity")):
        value = getattr(own, key)
        if value is not None and value is not False:
            arrays.actuator[row, v] = file_limit(model, v, key) if value is True else value
