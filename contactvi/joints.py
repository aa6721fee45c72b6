"""What the scene knows about joints beyond the model: springs, damping, limits; and joint values as numbers in q.

Units: rad, m, N m/rad, N/m, N m s/rad, N s/m.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.errors import InputError
from contactvi.inputs import pose, real, unit_quaternion, vector
from contactvi.model_checks import ONE_DOF, has_limits, joint_kind

SPRUNG = (*ONE_DOF, "spherical", "translation")
_PARTS = {"free": (3, 3), "planar": (2, 1)}  # linear, angular dofs


@dataclass
class JointSettings:
    """Overrides for one joint; None leaves the model's value (limits: used where lower < upper are finite)."""

    stiffness: float | None = None
    rest: np.ndarray | None = None
    damping: np.ndarray | None = None
    limits: bool | tuple[float, float] | None = None
    restitution: float | None = None

    def update(self, other: JointSettings) -> None:
        """Take over what `other` says."""
        for name, value in vars(other).items():
            if value is not None:
                setattr(self, name, value)


@dataclass
class JointArrays:
    """Arrays for the engine: stiffness (njoints,), rest (nq,), limits (njoints,) bool, limit_restitution (njoints,)."""

    stiffness: np.ndarray
    rest: np.ndarray
    limits: np.ndarray
    limit_restitution: np.ndarray


def joint_settings(
    model: pin.Model,
    name: str,
    stiffness: Any = None,
    rest: Any = None,
    damping: Any = None,
    limits: Any = None,
    restitution: Any = None,
) -> JointSettings:
    """Return checked settings for joint `name` of the model.

    Raises
    ------
    InputError : a value of the wrong range or shape, or one that this type of joint cannot have.
    """
    index = model.getJointId(name)
    kind = str(joint_kind(model.joints[index]))
    result = JointSettings()
    if stiffness is not None:
        result.stiffness = real(f"stiffness of {name!r}", stiffness, 0.0)
    if rest is not None:
        result.rest = joint_value(model, name, rest, f"rest of {name!r}")
    if (stiffness is not None or rest is not None) and kind not in SPRUNG:
        raise InputError(
            f"Spring on joint {name!r}",
            name="stiffness",
            expected=f"a joint of type {', '.join(SPRUNG)}",
            got=kind,
            remedy="Build the joint from translation and spherical joints",
        )
    if damping is not None:
        result.damping = _damping(name, kind, model.joints[index].nv, damping)
    if limits is not None:
        result.limits = _limits(model, index, name, limits)
    if restitution is not None:
        result.restitution = real(f"restitution of the limits of {name!r}", restitution, 0.0, 1.0)
    return result


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
    model: pin.Model, start: np.ndarray, settings: Mapping[str, JointSettings], default_restitution: float
) -> JointArrays:
    """Write damping and limits into the model and return the other arrays.

    Limits that are not used become infinite in the model, so that it says what is simulated. `start`, the neutral
    configuration, is moved into the limits and is the rest of the springs where none is given.
    """
    stiffness = np.zeros(model.njoints)
    limits = np.zeros(model.njoints, dtype=bool)
    restitution = np.full(model.njoints, float(default_restitution))
    rest = start.copy()
    for i in range(1, model.njoints):
        joint, own = model.joints[i], settings.get(model.names[i], JointSettings())
        q, v = slice(joint.idx_q, joint.idx_q + joint.nq), slice(joint.idx_v, joint.idx_v + joint.nv)
        if own.damping is not None:
            model.damping[v] = own.damping
        if isinstance(own.limits, tuple):
            model.lowerPositionLimit[q], model.upperPositionLimit[q] = own.limits
        limits[i] = has_limits(model, i) and own.limits is not False
        if limits[i]:
            start[q] = np.clip(start[q], model.lowerPositionLimit[q], model.upperPositionLimit[q])
        else:
            model.lowerPositionLimit[q], model.upperPositionLimit[q] = -np.inf, np.inf
        rest[q] = start[q] if own.rest is None else own.rest
        stiffness[i] = own.stiffness or 0.0
        if own.restitution is not None:
            restitution[i] = own.restitution
    return JointArrays(stiffness, rest, limits, restitution)


def joint_value(model: pin.Model, name: str, value: Any, argument: str | None = None) -> np.ndarray:
    """Return the numbers in q of a joint's value.

    revolute, helical, continuous: angle [rad]; prismatic: [m]; planar: x, y, angle; translation: x, y, z;
    spherical: quaternion (x, y, z, w); free: any placement that `inputs.pose` takes.
    """
    joint = model.joints[model.getJointId(name)]
    kind, what = joint_kind(joint), argument or f"value of joint {name!r}"
    if kind == "free":
        return np.asarray(pin.SE3ToXYZQUAT(pose(what, value)))
    if kind == "spherical":
        return unit_quaternion(what, value)
    if kind == "translation":
        return vector(what, value, 3)
    if kind == "planar":
        x, y, angle = vector(what, value, 3)
        return np.array([x, y, np.cos(angle), np.sin(angle)])
    angle = real(what, value)
    return np.array([np.cos(angle), np.sin(angle)]) if joint.nq == 2 else np.array([angle])


def joint_velocity(model: pin.Model, name: str, value: Any, q: np.ndarray) -> np.ndarray:
    """Return the numbers in v of a joint's velocity at configuration q (nq,).

    1-dof: one number [rad/s or m/s]; spherical: angular velocity in body axes; translation: linear; planar: Pinocchio's
    (body axes); free: (linear, angular) of the body's origin in the parent's (the world's) axes, turned to body axes.
    """
    joint = model.joints[model.getJointId(name)]
    what = f"velocity of joint {name!r}"
    if joint.nv == 1:
        return np.array([real(what, value)])
    if joint_kind(joint) != "free":
        return vector(what, value, joint.nv)
    linear, angular = (value, np.zeros(3)) if np.shape(value) == (3,) else (None, None)
    if linear is None:
        if np.shape(value) != (2, 3):
            raise InputError(f"Shape of {what}", name="velocity", expected="(linear, angular)", got=repr(value))
        linear, angular = value
    rotation = pin.XYZQUATToSE3(q[joint.idx_q : joint.idx_q + 7]).rotation
    return np.concatenate([rotation.T @ vector(what, linear, 3), rotation.T @ vector(what, angular, 3)])
