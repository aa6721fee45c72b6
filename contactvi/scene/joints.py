"""What the user gives for joints: their values and velocities, and settings beyond the model.

Settings are springs, damping, friction, servos, actuator limits and position limits. `joint_arrays` makes arrays for
the engine of them. Units: rad, m, rad/s, m/s, N m/rad, N/m, N m s/rad, N s/m, N m, N, kg m^2, kg.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from contactvi.elements.constraints import coefficients_of
from contactvi.elements.signals import Signal
from contactvi.errors import InputError
from contactvi.importing.joint_kinds import NO_LIMIT, ONE_DOF, has_limits, joint_kind
from contactvi.importing.part import Part
from contactvi.inputs import pose, real, shape_of, short, unit_quaternion, vector

SPRUNG = (*ONE_DOF, "spherical", "translation")
PARTS_OF_FREEDOM = {"free": (3, 3), "planar": (2, 1)}  # linear and angular degrees of freedom


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
    armature: float | np.ndarray | None = None
    gear_ratio: float | None = None
    rotor_inertia: float | None = None
    servo: Servo | None = None
    effort: bool | float | None = None
    velocity: bool | float | None = None

    def update(self, other: JointSettings) -> None:
        """Take over the values that `other` gives."""
        for name, value in vars(other).items():
            if value is not None:
                setattr(self, name, value)


class JointTable:
    """The settings of the joints of a scene by name; a joint without an entry is as in its model."""

    def __init__(self, settings: Mapping[str, JointSettings] | None = None) -> None:
        self.settings = dict(settings or {})

    def of(self, name: str) -> JointSettings:
        """Return the settings of a joint, empty ones where it has none."""
        return self.settings.get(name, JointSettings())

    def update(self, new: Mapping[str, JointSettings]) -> None:
        """Take over the values given for some joints."""
        for name, settings in new.items():
            self.settings.setdefault(name, JointSettings()).update(settings)

    def add_part(self, part: Part, limits: bool, friction: bool) -> None:
        """Set the joints of a new part: whether the limits and the friction of its file are used."""
        model = part.model
        for i in range(1, model.njoints):
            own = JointSettings(limits=False if not limits and has_limits(model, i) else None)
            if friction and model.nvs[i] == 1 and model.upperDryFrictionLimit[model.idx_vs[i]] > 0.0:
                own.friction = True
            own.update(_file_settings(part, i))
            if own != JointSettings():
                self.settings[part.prefix + model.names[i]] = own

    def copy(self) -> JointTable:
        """Return a table that is edited apart from this one."""
        return JointTable({name: replace(own) for name, own in self.settings.items()})


def _file_settings(part: Part, i: int) -> JointSettings:
    """Return the spring, the servo and the restitution of the limits that a model's file gives joint i."""
    model, data, name = part.model, part.data, str(part.model.names[i])
    values: dict[str, Any] = {}
    if name in data.springs:
        values["stiffness"], values["rest"] = data.springs[name]
    if has_limits(model, i):
        values["restitution"] = data.limit_restitution
    found = joint_settings(model, name, **values)
    servos = [a for a in data.actuators if a.joint == part.prefix + name and a.kind != "motor"]
    if servos:
        effort = min(*(a.effort for a in servos), file_limit(model, model.idx_vs[i], "effort"))
        found.servo = Servo(sum(a.kp for a in servos), sum(a.kd for a in servos), effort)
    return found


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
    linear, angular = (value, np.zeros(3)) if shape_of(value) == (3,) else (None, None)
    if linear is None:
        if shape_of(value) != (2, 3):
            raise InputError(
                f"Shape of {what}",
                name="velocity",
                expected="(linear, angular)",
                got=short(value),
                remedy="Give ((vx, vy, vz), (wx, wy, wz)) in world axes, or (vx, vy, vz) alone",
            )
        linear, angular = value
    rotation = pin.XYZQUATToSE3(q[joint.idx_q : joint.idx_q + 7]).rotation
    return np.concatenate([rotation.T @ vector(what, linear, 3), rotation.T @ vector(what, angular, 3)])


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
            if kind in PARTS_OF_FREEDOM:
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


def is_revolute(model: pin.Model, name: str) -> bool:
    """Return whether a joint turns, and not without end."""
    return str(joint_kind(model.joints[model.getJointId(name)])) == "revolute"


def with_one_dof(model: pin.Model, names: list[str]) -> list[str]:
    """Return those of several joints that have one degree of freedom; all, for their error, where none has."""
    return [name for name in names if joint_kind(model.joints[model.getJointId(name)]) in ONE_DOF] or names


def with_armature(model: pin.Model, names: list[str]) -> list[str]:
    """Return those of several joints that may have an armature; all, for their error, where none may."""
    kinds = {name: str(joint_kind(model.joints[model.getJointId(name)])) for name in names}
    return [name for name in names if kinds[name] not in PARTS_OF_FREEDOM] or names


def one_dof(model: pin.Model, name: str, what: str, remedy: str) -> None:
    """Raise InputError where a joint has more than one degree of freedom."""
    count = model.nvs[model.getJointId(name)]
    if count != 1:
        raise InputError(
            f"{what} of joint {name!r}",
            name="joint",
            expected="a joint with one degree of freedom",
            got=f"{count} degrees of freedom",
            remedy=remedy,
        )


def dofs_of(model: pin.Model, name: str) -> range:
    """Return where a joint's numbers lie in v."""
    index = model.getJointId(name)
    return range(model.idx_vs[index], model.idx_vs[index] + model.nvs[index])


def one_number(model: pin.Model, name: str, what: str) -> int:
    """Return the index of a joint with one number in q and in v; raise InputError for another one."""
    index = model.getJointId(name)
    joint = model.joints[index]
    if joint.nq != 1 or joint.nv != 1:
        expected = "a revolute, prismatic or helical joint (one number in q)"
        _refuse_kind(f"A {what}", name, "joint", expected, str(joint_kind(joint)))
    return int(index)


def _refuse_kind(what: str, name: str, argument: str, expected: str, kind: str) -> None:
    raise InputError(
        f"{what} on joint {name!r}",
        name=argument,
        expected=expected,
        got=f"a {kind} joint",
        remedy="Name a joint of these kinds; scene.report lists the joints with theirs",
    )


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
    """Return the damping of each dof from one number, or (linear, angular) for free and planar joints."""
    if kind in PARTS_OF_FREEDOM and shape_of(damping) == (2,):
        linear, angular = (real(f"damping of {name!r}", d, 0.0) for d in damping)
        return np.repeat([linear, angular], PARTS_OF_FREEDOM[kind])
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
            remedy="Give the smaller number first: limits=(lower, upper)"
            if one_dof
            else "Take limits out: this joint has none",
        )
    return lower, upper
