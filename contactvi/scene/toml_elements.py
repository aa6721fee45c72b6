"""The sections of a scene file about constraints, springs, wrenches, servos and actuators: keys, and what they call."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from contactvi.errors import InputError
from contactvi.inputs import pose
from contactvi.scene.scene import Scene

_ENDS = ("a", "b")
_POINTS = ("point_a", "point_b")
_SPRING = ("stiffness", "rest_length", "damping", "tension_only", "name")

# section -> keys, keys that have to be there
SECTIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "point": ((*_ENDS, *_POINTS, "name"), _ENDS),
    "distance": ((*_ENDS, *_POINTS, "length", "name"), _ENDS),
    "weld": ((*_ENDS, "xyz", "rpy", "name"), _ENDS),
    "screw": ((*_ENDS, "pitch", "frame_a", "frame_b", "name"), (*_ENDS, "pitch")),
    "equality": (("joint", "other", "coefficients", "name"), ("joint",)),
    "prescribe": (("joint", "motion", "name"), ("joint", "motion")),
    "spring": ((*_ENDS, *_POINTS, *_SPRING), (*_ENDS, "stiffness")),
    "tape_spring": (("points", *_SPRING), ("points", "stiffness")),
    "wrench": (("body", "force", "torque", "point", "axes", "name"), ("body",)),
    "servo": (("joint", "kp", "kd", "effort", "target"), ("joint", "kp", "kd")),
    "actuator": (("joint", "effort", "velocity"), ("joint",)),
}


def add_element(scene: Scene, section: str, entry: Mapping[str, Any]) -> None:
    """Add what an entry of `section` says; its keys are known. Raises InputError for values that cannot be used."""
    values = dict(entry)
    if section == "weld":
        placed = [values.pop(key, None) for key in ("xyz", "rpy")]
        if placed != [None, None]:
            values["placement"] = pose("placement", tuple(part or [0.0, 0.0, 0.0] for part in placed))
    for key in ("frame_a", "frame_b"):
        if key in values:
            values[key] = _frame(key, values[key])
    if section == "equality":
        scene.add_joint_equality(values.pop("joint"), values.pop("other", None), **values)
    elif section == "prescribe":
        scene.prescribe(**values)
    elif section in ("servo", "actuator"):
        getattr(scene, f"set_{section}")(**values)
    else:
        getattr(scene, f"add_{section}")(**values)


def _frame(key: str, value: Any) -> Any:
    if not isinstance(value, Mapping) or not set(value) <= {"xyz", "rpy"}:
        raise InputError(f"Value of {key}", name=key, expected="{ xyz = [...], rpy = [...] }", got=repr(value))
    return pose(key, (value.get("xyz", [0.0, 0.0, 0.0]), value.get("rpy", [0.0, 0.0, 0.0])))
