"""The numbers of a scene by the names that derivatives of runs give them, read and set.

"gravity" (3,); of a joint, as kind:joint, "mass" (1,), "inertia" (10,), "stiffness" (1,) and "armature", "damping",
"rest", "kp", "kd" (dofs,); of contacts "restitution" and "friction" (1,), "restitution:a|b" of one pair and
"restitution:joint" of the limits of a joint. A plain "restitution" or "friction" is that of all contacts that have
some, and of all where none has; 0 takes it from them. The derivative with respect to a name is that with respect to the
value that is set here; of a plain one that of the contacts that have some.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, NoReturn

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import InputError, did_you_mean
from contactvi.importing.joint_kinds import joint_kind
from contactvi.inputs import LARGEST, array, mapping, real, real_numbers, short
from contactvi.keywords import meant
from contactvi.scene.build import Built
from contactvi.scene.contact_rules import ContactRules
from contactvi.scene.joints import PARTS_OF_FREEDOM, SPRUNG, JointSettings, JointTable, Servo
from contactvi.scene.parts import PartList

Array = NDArray[np.float64]

OF_JOINTS = ("mass", "inertia", "armature", "stiffness", "damping", "rest", "kp", "kd")
OF_CONTACTS = ("restitution", "friction")
NAMES = ("gravity", *(f"{kind}:joint" for kind in OF_JOINTS))
LIMITS = ("lower limit", "upper limit")  # what stands in the place of a pair's second shape
CONTACT_NAMES = ("restitution", "restitution:a|b", "restitution:joint", "friction", "friction:a|b")
_KNOWN = (*NAMES, *CONTACT_NAMES)
_NOT_NEGATIVE = ("stiffness", "damping", "armature", "kp", "kd", "friction", "restitution")
_ROUNDING = 64.0 * float(np.finfo(float).eps)  # of moments of inertia, in the sums over the axes


def is_parameter(name: str) -> bool:
    """Return whether this is a name of parameters: "gravity", or of a joint."""
    kind, _, joint = name.partition(":")
    return name == "gravity" or (kind in OF_JOINTS and bool(joint))


class ParameterValues:
    """The values of the parameters of a complete scene."""

    def __init__(self, built: Built) -> None:
        self._built = built
        self._joints = [str(name) for name in built.model.names]

    def of(self, name: str) -> Array:
        """Return the value of a parameter; InputError for a name that is none, or that has no one value."""
        kind, _, of = self.checked(name).partition(":")
        if kind in OF_CONTACTS:
            return np.array([self._common(name)])
        if kind == "gravity":
            return np.array(self._built.model.gravity.linear)
        return self._of_joint(kind, self.joint(kind, of))

    def checked(self, name: Any) -> str:
        """Return a name whose kind is known; InputError for anything else."""
        kind, colon, of = name.partition(":") if isinstance(name, str) else ("", "", "")
        if name == "gravity" or (kind in OF_JOINTS and of) or (kind in OF_CONTACTS and bool(of) == bool(colon)):
            return str(name)
        remedy = meant(kind, _KNOWN) if kind else "Give a name such as 'mass:ball'"
        raise InputError("Nothing of the scene has this name", name="name", expected=f"one of {', '.join(_KNOWN)}",
                         got=short(name), remedy=remedy)  # fmt: skip

    def joint(self, kind: str, name: str) -> int:
        """Return the index of a joint that has this parameter; InputError where it has not."""
        built = self._built
        if name not in self._joints[1:]:
            raise InputError(
                "No joint has this name", name=f"{kind}:{name}",
                expected=f"{kind}: and one of {', '.join(self._joints[1:])}", got=f"{kind}:{name}",
                remedy=did_you_mean(name, self._joints[1:]),
            )  # fmt: skip
        index = self._joints.index(name)
        shape = str(joint_kind(built.model.joints[index]))
        if kind in ("kp", "kd") and name not in built.servo_joints:
            _refuse(kind, name, "a joint with a servo", "none", f"Call scene.set_servo({name!r}, kp, kd) first")
        if kind in ("stiffness", "rest") and shape not in SPRUNG:
            _refuse(kind, name, f"a joint of type {', '.join(SPRUNG)}", shape, "Take this name out: it has no spring")
        if kind == "rest" and shape == "spherical":
            remedy = "Its rest is a turn: scene.set_joint(joint, rest=(x, y, z, w))"
            _refuse(kind, name, "a joint whose place is given by numbers that add", shape, remedy)
        if kind == "armature" and shape in PARTS_OF_FREEDOM:
            _refuse(kind, name, "a joint that is not free or planar", shape, "Take this name out: it has no armature")
        return index

    def body(self, joint: str) -> pin.Inertia:
        """Return the inertia of what a joint moves."""
        return self._built.model.inertias[self._joints.index(joint)]

    def is_circle(self, joint: str) -> bool:
        """Return whether the place of a joint is an angle whose cosine and sine are in q."""
        index = self._joints.index(joint)
        return (self._built.model.nqs[index], self._built.model.nvs[index]) == (2, 1)

    def contacts(self, name: str) -> list[tuple[tuple[str, str], float]]:
        """Return pairs of names, of shapes or of a joint and its limit, and the values of what a name stands for.

        Without a pair these are all pairs that have some, and all limits; where none has some, all pairs and limits.
        InputError where a name stands for nothing.
        """
        kind, _, pair = name.partition(":")
        built, model = self._built, self._built.model
        found = built.coefficients(kind)
        limits = [i for i in range(1, model.njoints) if built.arrays.limits[i] and kind == "restitution"]
        stops = [((self._joints[i], side), float(built.arrays.limit_restitution[i])) for i in limits for side in LIMITS]
        if not pair:
            some = [row for row in found if row[1] > 0.0]
            chosen = some + stops if any(value > 0.0 for _, value in some + stops) else found + stops
        elif "|" in pair:
            sides = tuple(part.strip() for part in pair.split("|"))
            chosen = [row for row in found if sides in (row[0], row[0][::-1])]
            if any(sides in (row[0], row[0][::-1]) for row in stops):
                joint = sides[0] if sides[1] in LIMITS else sides[1]
                _refuse(kind, pair, "both limits of a joint, which have one restitution", "one of them",
                        f"Name the joint: 'restitution:{joint}'")  # fmt: skip
        else:
            chosen = [row for row in stops if row[0][0] == pair]
        if not chosen:
            known = ["|".join(names) for names, _ in found] + sorted({names[0] for names, _ in stops})
            remedy = did_you_mean(pair, known) if pair else "Add what it may touch, or enable_pair"
            raise InputError(
                "No contact of the scene has this name" if pair else "The scene has no contacts", name=name,
                expected=f"{kind}: and one of {', '.join(known[:12])}" if known else "pairs of shapes that may touch",
                got=name, remedy=remedy,
            )  # fmt: skip
        return chosen

    def _common(self, name: str) -> float:
        """Return the one value of what a name of contacts stands for."""
        rows = self.contacts(name)
        values = sorted({value for _, value in rows})
        if len(values) > 1:
            kind = name.partition(":")[0]
            raise InputError(
                f"Contacts differ in {kind}: there is no one value to set", name=name,
                expected="pairs that have some, and limits, of one value", got=f"{values[0]:g} to {values[-1]:g}",
                remedy=f"Name a pair: '{kind}:{'|'.join(rows[0][0])}'",
            )  # fmt: skip
        return values[0]

    def _of_joint(self, kind: str, index: int) -> Array:
        model, arrays = self._built.model, self._built.arrays
        q = slice(model.idx_qs[index], model.idx_qs[index] + model.nqs[index])
        v = slice(model.idx_vs[index], model.idx_vs[index] + model.nvs[index])
        if kind == "mass":
            return np.array([model.inertias[index].mass])
        if kind == "inertia":
            return numbers_of(model.inertias[index])
        if kind == "stiffness":
            return np.array([arrays.stiffness[index]])
        if kind == "rest":
            rest = np.array(arrays.rest[q])
            return np.array([np.arctan2(rest[1], rest[0])]) if len(rest) == 2 else rest
        if kind in ("kp", "kd"):
            return np.array(arrays.servo[("kp", "kd").index(kind), v])
        return np.array(getattr(model, kind)[v])


class ParameterEditor:
    """Sets parameters in the owners of a scene's data, which are those of a copy of the scene of `values`."""

    def __init__(self, values: ParameterValues, parts: PartList, contact: ContactRules, joints: JointTable) -> None:
        self._values, self._parts, self._contact, self._joints = values, parts, contact, joints

    def set(self, given: Mapping[str, Any]) -> None:
        """Set all that is given, after all of it is checked.

        Raises:
            InputError: an unknown name, a value of the wrong shape or out of range, two names for one number.
        """
        found = {name: self._checked(name, value) for name, value in mapping("values", given, "name: value").items()}
        check_distinct(found)
        changes = [self._change(name, value) for name, value in found.items()]
        for change in changes:
            change()

    def _checked(self, name: Any, value: Any) -> Array:
        present = self._values.of(name)
        numbers = real_numbers(value)
        scalar = numbers is not None and numbers.ndim == 0 and len(present) == 1
        result = array(name, [value] if scalar else value, present.shape, "the value of this parameter")
        kind = name.partition(":")[0]
        if kind == "mass" or kind in _NOT_NEGATIVE:
            high = 1.0 if kind == "restitution" else np.inf
            for number in result:
                real(name, float(number), 0.0, high, open_low=kind == "mass")
        return result

    def _change(self, name: str, value: Array) -> Callable[[], None]:
        """Return the function that makes a change, whose value was checked."""
        kind, _, of = name.partition(":")
        if kind == "gravity":
            return lambda: self._parts.set_gravity(value)
        if kind in OF_CONTACTS:
            rows = self._values.contacts(name)
            return lambda: self._set_contacts(kind, [names for names, _ in rows], float(value[0]))
        if kind in ("mass", "inertia"):
            body = self._body(name, kind, of, value)
            return lambda: self._parts.set_inertia(of, body)
        return lambda: self._joints.update({of: self._settings(kind, of, value)})

    def _body(self, name: str, kind: str, joint: str, value: Array) -> pin.Inertia:
        if kind == "inertia":
            return inertia_of(name, value)
        present = self._values.body(joint)
        return pin.Inertia(float(value[0]), present.lever, present.inertia)

    def _settings(self, kind: str, joint: str, value: Array) -> JointSettings:
        if kind in ("kp", "kd"):
            servo = self._joints.of(joint).servo
            assert servo is not None
            gains = {"kp": servo.kp, "kd": servo.kd} | {kind: float(value[0])}
            return JointSettings(servo=Servo(gains["kp"], gains["kd"], servo.effort, servo.target))
        if kind == "stiffness":
            return JointSettings(stiffness=float(value[0]))
        if kind == "armature":  # what the rotor adds is in it
            return JointSettings(armature=value, rotor_inertia=0.0)
        if kind == "damping":
            return JointSettings(damping=value)
        circle = self._values.is_circle(joint)
        return JointSettings(rest=np.array([np.cos(value[0]), np.sin(value[0])]) if circle else value)

    def _set_contacts(self, kind: str, rows: list[tuple[str, str]], value: float) -> None:
        rule = self._contact.restitution if kind == "restitution" else self._contact.friction
        for first, second in rows:
            if second in LIMITS:
                self._joints.update({first: JointSettings(restitution=value)})
            else:
                rule.set_pair([first], [second], value)


def numbers_of(body: pin.Inertia) -> Array:
    """Return mass, first moment and rotational inertia about the joint's frame (xx xy xz yy yz zz), shape (10,)."""
    m, c = float(body.mass), np.asarray(body.lever)
    about = np.asarray(body.inertia) + m * (c @ c * np.eye(3) - np.outer(c, c))
    return np.concatenate([[m], m * c, about[np.triu_indices(3)]])


def about_centre(numbers: Array) -> Array:
    """Return the rotational inertia about the centre of mass, (..., 3, 3), of ten numbers (..., 10).

    It is computed number by number, so that many bodies at once have the bits of single ones.
    """
    xx, xy, xz, yy, yz, zz = np.moveaxis(numbers[..., 4:], -1, 0)
    about = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(*numbers.shape[:-1], 3, 3)
    m, moment = numbers[..., 0], numbers[..., 1:4]
    x, y, z = np.moveaxis(moment, -1, 0)
    square = np.asarray(x * x + y * y + z * z)[..., None, None]
    moved = square * np.eye(3) - moment[..., :, None] * moment[..., None, :]
    positive = (m > 0.0)[..., None, None]
    return np.asarray(about - np.where(positive, moved, 0.0) / np.where(positive, m[..., None, None], 1.0))


def is_body(numbers: Array) -> NDArray[np.bool_]:
    """Return whether ten numbers (..., 10) are those of a body: a mass, moments of inertia that are not negative."""
    least = np.linalg.eigvalsh(about_centre(numbers))[..., 0]
    return np.asarray((numbers[..., 0] > 0.0) & ~(least < -_ROUNDING * np.abs(numbers[..., 4:]).max(axis=-1)))


def body_numbers(kind: str, present: pin.Inertia, values: Array) -> Array:
    """Return mass, centre of mass (3) and inertia about it (xx xy xz yy yz zz) of bodies, (runs, 10).

    Args:
        kind: "mass" or "inertia". present: the body as it is.
        values: of this parameter, (runs, 1) or (runs, 10); NaN is returned for those of no body.
    """
    upper = np.triu_indices(3)
    if kind == "mass":
        own = np.concatenate([np.asarray(present.lever), np.asarray(present.inertia)[upper]])
        return np.concatenate([values, np.tile(own, (len(values), 1))], axis=1)
    mass, about = values[:, :1], about_centre(values)[:, upper[0], upper[1]]
    found = np.concatenate([mass, values[:, 1:4] / np.where(mass > 0.0, mass, 1.0), about], axis=1)
    return np.where(is_body(values)[:, None], found, np.nan)


def in_range(name: str, values: Array) -> NDArray[np.bool_]:
    """Return which values (runs, width) of a parameter a scene may have, with the servos that it has, (runs,)."""
    kind = name.partition(":")[0]
    found = np.abs(values) <= LARGEST
    if kind == "mass" or kind in ("kp", "kd"):
        found &= values > 0.0
    elif kind in _NOT_NEGATIVE:
        found &= values >= 0.0
    if kind == "restitution":
        found &= values <= 1.0
    return np.asarray(found.all(axis=1))


def inertia_of(name: str, numbers: Array) -> pin.Inertia:
    """Return the inertia of the ten numbers; InputError where they are those of no body."""
    about = about_centre(numbers)
    least = float(np.linalg.eigvalsh(about)[0])
    if not is_body(numbers):
        raise InputError(
            f"{name} is that of no body", name=name,
            expected="a mass > 0, and a rotational inertia about the centre of mass without negative eigenvalue",
            got=f"mass {numbers[0]:g}, least eigenvalue {least:g} kg m^2",
            remedy="Order: mass, mass * centre (3), then xx xy xz yy yz zz about the joint's frame; or bound it",
        )  # fmt: skip
    return pin.Inertia(float(numbers[0]), numbers[1:4] / numbers[0], about)


def check_distinct(found: Collection[str]) -> None:
    """Raise InputError where two names set one number."""
    for name in found:
        kind, _, of = name.partition(":")
        other = {"inertia": f"mass:{of}"}.get(kind) if kind not in OF_CONTACTS else kind if of else None
        if other in found:
            raise InputError(
                f"{name} and {other} set one number", name="values", expected="names of different numbers",
                got=f"{name}, {other}", remedy="Leave one of them out",
            )  # fmt: skip


def _refuse(kind: str, of: str, expected: str, got: str, remedy: str) -> NoReturn:
    raise InputError(f"There is no {kind} of {of!r}", name=f"{kind}:{of}", expected=expected, got=got, remedy=remedy)
