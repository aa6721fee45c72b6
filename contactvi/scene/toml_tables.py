"""The tables and keys of a scene file (contactvi.scene.toml): what may stand where, and where an error came from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from contactvi.errors import ContactviError, SceneError
from contactvi.keywords import meant, synonym
from contactvi.options import Options
from contactvi.scene.contact_laws import CONTACT_SETTINGS
from contactvi.words import in_lines

_ENDS = ("a", "b")
_POINTS = ("point_a", "point_b")
_SPRING = ("stiffness", "rest_length", "damping", "tension_only", "name")

# Sections of constraints, springs, wrenches, servos and actuators: all keys, and the required ones.
ELEMENTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "point": ((*_ENDS, *_POINTS, "name"), _ENDS),
    "distance": ((*_ENDS, *_POINTS, "length", "name"), _ENDS),
    "weld": ((*_ENDS, "xyz", "rpy", "name"), _ENDS),
    "screw": ((*_ENDS, "pitch", "frame_a", "frame_b", "name"), (*_ENDS, "pitch")),
    "equality": (("joint", "other", "coefficients", "name"), ("joint",)),
    "prescribe": (("joint", "motion", "name"), ("joint", "motion")),
    "spring": ((*_ENDS, *_POINTS, *_SPRING), (*_ENDS, "stiffness")),
    "tape_spring": (("points", *_SPRING), ("points", "stiffness")),
    "wrench": (("body", "force", "torque", "point", "axes", "name"), ("body",)),
    "compliance": ((*_ENDS, "stiffness", "exponent", "damping", "friction", "slip_speed"), ("a", "stiffness")),
    "surface_velocity": (("a", "linear", "angular", "profile"), ("a",)),
    "servo": (("joint", "kp", "kd", "effort", "target"), ("joint", "kp", "kd")),
    "actuator": (("joint", "effort", "velocity"), ("joint",)),
}
_PLACE = ("xyz", "rpy")
_BODY = ("name", "mass", "free", "color", *_PLACE)
KEYS: dict[str, tuple[str, ...]] = {
    "scene": ("title", "description", "gravity", "camera", "order"),
    "urdf": (
        "path",
        "base",
        "package_dirs",
        "srdf",
        "prefix",
        "limits",
        "friction",
        "mimic",
        "armature",
        "self_collision",
        "contact_friction",
        "shape",
        "spacing",
        *_PLACE,
    ),
    "mjcf": (
        "path",
        "prefix",
        "limits",
        "friction",
        "equality",
        "actuators",
        "restitution",
        "self_collision",
        "allow",
        "turning_friction",
        "hfield",
        "shape",
        "spacing",
        *_PLACE,
    ),
    "sphere": ("radius", *_BODY),
    "box": ("size", *_BODY),
    "capsule": ("radius", "length", *_BODY),
    "cylinder": ("radius", "length", *_BODY),
    "ellipsoid": ("radii", *_BODY),
    "mesh": ("path", "density", "scale", "decompose", "spacing", *_BODY),
    "halfspace": ("normal", "offset", "name", "color"),
    "heightfield": ("name", "heights", "path", "size", "height", "smooth", "color", *_PLACE),
    "contact": (*CONTACT_SETTINGS, "disable", "enable", "body", "pair"),
    "contact.body": ("name", *CONTACT_SETTINGS),
    "contact.pair": ("a", "b", *CONTACT_SETTINGS),
    "joint": (
        *("name", "stiffness", "rest", "damping", "limits", "restitution"),
        *("friction", "spring", "armature", "gear_ratio", "rotor_inertia"),
    ),
    **{section: keys for section, (keys, _) in ELEMENTS.items()},
    "initial": ("configuration", "q", "v", "springs_at_rest", "assemble", "body"),
    "initial.body": ("name", "quaternion", "velocity", "angular_velocity", *_PLACE),
    "run": tuple(f.name for f in fields(Options)),
}
LISTS = (
    "urdf",
    "mjcf",
    "sphere",
    "box",
    "capsule",
    "cylinder",
    "ellipsoid",
    "mesh",
    "halfspace",
    "heightfield",
    "joint",
    *ELEMENTS,
)
NEEDED = {
    "urdf": ("path",),
    "mjcf": ("path",),
    "sphere": ("name", "radius"),
    "box": ("name", "size"),
    "capsule": ("name", "radius", "length"),
    "cylinder": ("name", "radius", "length"),
    "ellipsoid": ("name", "radii"),
    "mesh": ("name", "path"),
    "heightfield": ("name", "size"),
    "joint": ("name",),
    "contact.body": ("name",),
    "contact.pair": ("a", "b"),
    "initial.body": ("name",),
    **{section: needed for section, (_, needed) in ELEMENTS.items()},
}


def check_keys(data: Mapping[str, Any], file: Path) -> None:
    """Check names and kinds of all tables and keys, so that a misspelt one cannot be overlooked."""
    top = [name for name in KEYS if "." not in name]
    _check_table(data, "", top, file)
    for section in top:
        if section not in data:
            continue
        for table in _tables(data[section], section, section in LISTS, file):
            _check_table(table, section, KEYS[section], file)
            for key in table:
                inner = f"{section}.{key}"
                for entry in _tables(table[key], inner, True, file) if inner in KEYS else ():
                    _check_table(entry, inner, KEYS[inner], file)


def _tables(value: Any, section: str, listed: bool, file: Path) -> Iterable[Mapping[str, Any]]:
    """Return the tables of a section: one, or a list of them."""
    good = isinstance(value, list) and all(isinstance(v, dict) for v in value) if listed else isinstance(value, dict)
    if not good:
        wanted, other = (f"[[{section}]]", f"[{section}]") if listed else (f"[{section}]", f"[[{section}]]")
        raise SceneError(
            f"{file.name}: section {section}",
            path=file,
            expected=wanted,
            got=f"{other} or a value",
            remedy=f"Write {wanted} on a line of its own, and its keys below",
        )
    return value if listed else [value]


def _check_table(table: Mapping[str, Any], section: str, known: Iterable[str], file: Path) -> None:
    known = list(known)
    for key in table:
        if key not in known:
            where = f"in [{section}]" if section else "at the top"
            raise SceneError(
                f"{file.name}: unknown key {key!r} {where}",
                path=file,
                expected=" | ".join(known),
                got=repr(key),
                remedy=_meant(key, known),
            )
    for key in NEEDED.get(section, ()):
        if key not in table:
            raise SceneError(
                f"{file.name}: an entry of [[{section}]] lacks {key!r}",
                path=file,
                expected=" and ".join(NEEDED[section]),
                got=", ".join(table) or "nothing",
                remedy=f"Add {key} = ... to the entry",
            )


def _meant(key: str, known: list[str]) -> str:
    """Return the remedy for an unknown key: what others call a known one, its own table, or the nearest one."""
    word = synonym(key)
    if word not in known:
        for section, keys in KEYS.items():
            if word in keys and section in ("run", "contact", "scene", "initial"):
                return f"Write it as {word} = ... under [{section}]"
    return meant(key, known)


class at:
    """Add file and section to the message of an error that leaves the block; its class and fields stay."""

    def __init__(self, file: Path, section: str, number: int | None = None) -> None:
        self.file = file
        self.where = f"{file.name}, [{section}]" if number is None else f"{file.name}, [[{section}]] {number + 1}"

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ContactviError):
            error.expected, error.remedy = in_lines(str(error.expected)), in_lines(error.remedy)
            error.put_in(self.where)
            if isinstance(error, SceneError) and error.path is None:
                error.path = str(self.file)
