"""Scene files: one readable TOML page with what is simulated, how it starts and how it is run.

    [scene]                 gravity = [0, 0, -9.81]                 title, description: for the reader
                            camera = "auto" | "front" | "side" | "top" | { eye = [x, y, z], target = [x, y, z] } |
                            { follow = "body" }
    [[urdf]]                path, base = "fixed" | "free", xyz, rpy, package_dirs, srdf, prefix, limits = true,
                            friction = false, mimic = true, armature = number | { joint = number },
                            self_collision = true
    [[mjcf]]                path, xyz, rpy, prefix, limits = true, friction = false, equality = true, actuators = true,
                            restitution = 0 | number | "solref", self_collision = true
    [[sphere]]              name, radius, mass, free = true, xyz, rpy, color
    [[box]]                 name, size, ...       [[capsule]], [[cylinder]]  name, radius, length, ...
    [[mesh]]                name, path, mass | density, scale, decompose = false | true | number, ...
    [[halfspace]]           normal, offset, name, color
    [contact]               restitution, friction (defaults), disable = [["a", "b"]], enable = [["a", "b"]]
    [[contact.body]]        name, restitution, friction             of one body, part or geometry
    [[contact.pair]]        a, b, restitution, friction
    [[joint]]               name (patterns such as "joint_*" allowed), stiffness, rest, damping, limits, restitution,
                            friction, spring = [k1, k2, ...], armature, gear_ratio, rotor_inertia
    [[point]], [[distance]] a, b, point_a, point_b, name; [[distance]] also length
    [[weld]], [[screw]]     a, b, name; [[weld]] xyz, rpy; [[screw]] pitch, frame_a, frame_b = { xyz, rpy }
    [[equality]]            joint, other, coefficients = [c0, c1, ...], name
    [[prescribe]]           joint (or a free body), motion, name
    [[spring]]              a, b, point_a, point_b, stiffness, rest_length, damping, tension_only, name
    [[tape_spring]]         points = [["body", [x, y, z]], ...], and the rest of [[spring]]
    [[wrench]]              body, force, torque, point, axes = "world" | "body", name
    [[servo]], [[actuator]] joint; [[servo]] kp, kd, effort, target; [[actuator]] effort, velocity = true | number
    [initial]               configuration = a name in the models' files (keyframe, group state), q = { joint = value },
                            v = { joint = value }, springs_at_rest = true | false,
                            assemble = true | false (the nearest start on the constraints)
    [[initial.body]]        name, xyz, rpy or quaternion, velocity, angular_velocity    of a free body
    [run]                   dt = number | "auto", duration, order, tol, impact, mhc_reference, sample_dt, record_every,
                            dense, dt_contact, zeno, support, ...   (options.Options)
    [run.ledger]            own_jump = 1e-10, ...                   tolerances (contactvi.trajectory.ledger)

SI units and radians; rpy is roll-pitch-yaw as in URDF, a quaternion is (x, y, z, w), velocities are in world axes.
Relative paths are relative to the file; `example-robot-data://robots/...` and `package://...` are understood. Parts are
added in the order of the list above, then file order. Without [initial] the scene starts at rest in its neutral pose;
springs_at_rest starts every joint that has a spring where the spring rests. Motions, lengths and targets are numbers or
{ times = [...], values = [...] }, of a body 7 numbers or { times, poses }; the elements are those of Scene.add_point
and its siblings. Where entries set one thing twice the later one counts. An unknown key is an error.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.errors import ContactviError, InputError, SceneError, did_you_mean
from contactvi.importing.part import Part
from contactvi.importing.paths import resolve_path, unreadable
from contactvi.importing.readers import import_mjcf, import_urdf, open_mjcf
from contactvi.inputs import flag, listed, mapping, pose, unit_quaternion, vector
from contactvi.options import Options
from contactvi.scene.scene import GRAVITY, Scene

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

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
    "servo": (("joint", "kp", "kd", "effort", "target"), ("joint", "kp", "kd")),
    "actuator": (("joint", "effort", "velocity"), ("joint",)),
}
_PLACE = ("xyz", "rpy")
_BODY = ("name", "mass", "free", "color", *_PLACE)
KEYS: dict[str, tuple[str, ...]] = {
    "scene": ("title", "description", "gravity", "camera"),
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
        *_PLACE,
    ),
    "mjcf": ("path", "prefix", "limits", "friction", "equality", "actuators", "restitution", "self_collision", *_PLACE),
    "sphere": ("radius", *_BODY),
    "box": ("size", *_BODY),
    "capsule": ("radius", "length", *_BODY),
    "cylinder": ("radius", "length", *_BODY),
    "mesh": ("path", "density", "scale", "decompose", *_BODY),
    "halfspace": ("normal", "offset", "name", "color"),
    "contact": ("restitution", "friction", "disable", "enable", "body", "pair"),
    "contact.body": ("name", "restitution", "friction"),
    "contact.pair": ("a", "b", "restitution", "friction"),
    "joint": (
        *("name", "stiffness", "rest", "damping", "limits", "restitution"),
        *("friction", "spring", "armature", "gear_ratio", "rotor_inertia"),
    ),
    **{section: keys for section, (keys, _) in ELEMENTS.items()},
    "initial": ("configuration", "q", "v", "springs_at_rest", "assemble", "body"),
    "initial.body": ("name", "quaternion", "velocity", "angular_velocity", *_PLACE),
    "run": tuple(f.name for f in fields(Options)),
}
LISTS = ("urdf", "mjcf", "sphere", "box", "capsule", "cylinder", "mesh", "halfspace", "joint", *ELEMENTS)
NEEDED = {
    "urdf": ("path",),
    "mjcf": ("path",),
    "sphere": ("name", "radius"),
    "box": ("name", "size"),
    "capsule": ("name", "radius", "length"),
    "cylinder": ("name", "radius", "length"),
    "mesh": ("name", "path"),
    "joint": ("name",),
    "contact.body": ("name",),
    "contact.pair": ("a", "b"),
    "initial.body": ("name",),
    **{section: needed for section, (_, needed) in ELEMENTS.items()},
}


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Return the scene of a TOML file, with its start in .q0 (nq,), .v0 (nv,) and its run settings in .settings.

    Raises:
        SceneError: no such file, not TOML, unknown or missing keys.
        ContactviError: whatever the scene itself refuses, with the place in the file.
    """
    file = resolve_path(path)
    data = _read(file)
    _check_keys(data, file)
    scene = Scene(data.get("scene", {}).get("gravity", GRAVITY))
    for section in LISTS[: LISTS.index("joint")]:
        for number, entry in enumerate(data.get(section, ())):
            with _at(file, section, number):
                _add(scene, section, dict(entry), file)
    _set_contact(scene, data.get("contact", {}), file)
    for number, entry in enumerate(data.get("joint", ())):
        with _at(file, "joint", number):
            values = dict(entry)
            scene.set_joint(values.pop("name"), **values)
    for section in ELEMENTS:
        for number, entry in enumerate(data.get(section, ())):
            with _at(file, section, number):
                _add_element(scene, section, entry)
    _set_start(scene, data, file)
    _set_camera(scene, data, file)
    scene.settings = dict(data.get("run", {}))
    if "dt" in scene.settings:
        with _at(file, "run"):
            Options.from_dict(scene.settings)
    return scene


def _read(file: Path) -> dict[str, Any]:
    try:
        text = file.read_text(encoding="utf-8")
        _refuse_model(file, text)
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        remedy = "Correct it there; strings stand in quotes, lists in square brackets"
        if isinstance(error, UnicodeDecodeError):
            remedy = "Name a scene file (.toml); contactvi play shows a stored run (.npz)"
        raise SceneError(
            f"{file.name} is not TOML", path=file, expected="a TOML file", got=str(error), remedy=remedy
        ) from None
    except RecursionError:
        raise SceneError(
            f"{file.name} is nested too deeply",
            path=file,
            expected="a scene file",
            got="values in values",
            remedy="Write it without lists in lists",
        ) from None
    except (OSError, ValueError) as error:
        raise unreadable(file, error) from None


def _refuse_model(file: Path, text: str) -> None:
    """Raise SceneError for a robot model in the place of a scene file; the remedy is the scene file that loads it."""
    if not text.lstrip("\ufeff \t\r\n").startswith("<") and file.suffix.lower() not in (".urdf", ".mjcf", ".xml"):
        return
    section, got = ("mjcf", "an MJCF") if "<mujoco" in text or file.suffix.lower() == ".mjcf" else ("urdf", "a URDF")
    names = (f"{file.stem}.toml", f"{file.stem}_scene.toml")
    name = next((name for name in names if not (file.parent / name).is_file()), "a scene file")
    lines = [f"[[{section}]]", f'path = "{file.name}"', "", "[run]", "dt = 1e-3", "duration = 1.0"]
    raise SceneError(
        f"{file.name} is a model, not a scene",
        path=file,
        expected="a scene file (.toml)",
        got=got,
        remedy=f"Write these lines to {name} beside it, and load that:\n\n" + "\n".join(lines),
    )


def _check_keys(data: Mapping[str, Any], file: Path) -> None:
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
                remedy=did_you_mean(key, known),
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


class _at:
    """Add file and section to the message of an error that leaves the block; its class and fields stay."""

    def __init__(self, file: Path, section: str, number: int | None = None) -> None:
        self.file = file
        self.where = f"{file.name}, [{section}]" if number is None else f"{file.name}, [[{section}]] {number + 1}"

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ContactviError):
            error.what = f"{self.where}: {error.what}"
            error.args = (f"{self.where}: {error}",)
            if isinstance(error, SceneError) and error.path is None:
                error.path = str(self.file)


def _add(scene: Scene, section: str, entry: dict[str, Any], file: Path) -> None:
    folder = file.parent
    placement = _placement(entry)
    if section == "urdf":
        dirs = [folder / d for d in _strings(entry.get("package_dirs", []), "package_dirs")]
        part = import_urdf(
            entry["path"],
            base=entry.get("base", "fixed"),
            placement=placement,
            package_dirs=dirs,
            srdf=entry.get("srdf"),
            prefix=entry.get("prefix", ""),
            folder=folder,
            mimic=entry.get("mimic", True),
            armature=entry.get("armature"),
        )
        _add_model(scene, part, entry)
    elif section == "mjcf":
        options = {key: entry[key] for key in ("prefix", "equality", "actuators", "restitution") if key in entry}
        opened = open_mjcf(entry["path"], folder)
        part = import_mjcf(opened, placement=placement, gravity=scene.gravity, **options)
        _add_model(scene, part, entry)
    elif section == "halfspace":
        scene.add_halfspace(**entry)
    else:
        entry.pop("xyz", None), entry.pop("rpy", None)
        if section == "mesh":
            entry["mesh"] = resolve_path(entry.pop("path"), folder)
        getattr(scene, f"add_{section}")(**entry, placement=placement)


def _add_model(scene: Scene, part: Part, entry: Mapping[str, Any]) -> None:
    scene.add_model(
        part, entry.get("limits", True), entry.get("friction", False), entry.get("self_collision", True)
    )  # fmt: skip


def _add_element(scene: Scene, section: str, entry: Mapping[str, Any]) -> None:
    """Add a constraint, spring, wrench, servo or actuator to the scene."""
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
        raise InputError(
            f"Value of {key}",
            name=key,
            expected="{ xyz = [...], rpy = [...] }",
            got=repr(value),
            remedy=f"Write {key} = {{ xyz = [0, 0, 0], rpy = [0, 0, 0] }}",
        )
    return pose(key, (value.get("xyz", [0.0, 0.0, 0.0]), value.get("rpy", [0.0, 0.0, 0.0])))


def _strings(value: Any, name: str) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
        raise InputError(
            f"Value of {name}",
            name=name,
            expected="a list of strings",
            got=repr(value),
            remedy=f'Write {name} = ["..."]',
        )
    return value


def _placement(entry: Mapping[str, Any]) -> pin.SE3:
    return pose("placement", (entry.get("xyz", (0.0, 0.0, 0.0)), entry.get("rpy", (0.0, 0.0, 0.0))))


def _set_contact(scene: Scene, contact: Mapping[str, Any], file: Path) -> None:
    values = {key: contact[key] for key in ("restitution", "friction") if key in contact}
    with _at(file, "contact"):
        scene.set_contact(**values)
        for key, switch in (("disable", scene.disable_pair), ("enable", scene.enable_pair)):
            for pair in listed(key, contact.get(key, []), "pairs of names"):
                switch(*_two(pair, key))
    for number, entry in enumerate(contact.get("body", ())):
        with _at(file, "contact.body", number):
            values = dict(entry)
            scene.set_contact(values.pop("name"), **values)
    for number, entry in enumerate(contact.get("pair", ())):
        with _at(file, "contact.pair", number):
            values = dict(entry)
            scene.set_contact(values.pop("a"), values.pop("b"), **values)


def _set_camera(scene: Scene, data: Mapping[str, Any], file: Path) -> None:
    if "camera" not in data.get("scene", {}):
        return
    with _at(file, "scene"):
        scene.camera = data["scene"]["camera"]


def _two(pair: Any, key: str) -> list[str]:
    if not isinstance(pair, list) or len(pair) != 2:
        raise InputError(
            f"Entry of {key}",
            name=key,
            expected='["a", "b"]',
            got=repr(pair),
            remedy=f'Write {key} = [["a", "b"]] with two names in each pair',
        )
    return _strings(pair, key)


def _set_start(scene: Scene, data: Mapping[str, Any], file: Path) -> None:
    initial = data.get("initial", {})
    with _at(file, "initial"):
        values = mapping("q", initial.get("q", {}), "joint: value")
        q, v = _base(scene, initial)
        q = scene.configuration(values, q)
        speeds = dict(mapping("v", initial.get("v", {}), "joint: velocity"))
    for number, entry in enumerate(initial.get("body", ())):
        with _at(file, "initial.body", number):
            name = entry["name"]
            if scene.nv == 0 or len(q[scene.q_index(name)]) != 7:
                remedy = "Set it in [initial] q, v"
                raise InputError(f"Body {name!r}", name="name", expected="a free body", got="a joint", remedy=remedy)
            place = _body_pose(entry, q[scene.q_index(name)])
            q = scene.configuration({name: place}, q)
            zero = [0.0, 0.0, 0.0]
            speeds[name] = tuple(vector(key, entry.get(key, zero), 3) for key in ("velocity", "angular_velocity"))
    with _at(file, "initial"):
        scene.q0, scene.v0 = q, scene.velocity(speeds, q, v)
        if flag("assemble", initial.get("assemble", False)):
            scene.q0 = scene.assemble(q)
            scene.v0 = scene.consistent_velocity(scene.q0, scene.v0)
        elif not speeds and not np.any(v) and scene.elements:
            scene.v0 = None  # A run then starts with the velocity that driven constraints give.


def _base(scene: Scene, initial: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return q (nq,) and v (nv,) of what [initial] begins with."""
    at_rest, named = flag("springs_at_rest", initial.get("springs_at_rest", False)), initial.get("configuration")
    if named is None:
        return scene.spring_rest() if at_rest else scene.neutral(), np.zeros(scene.nv)
    if at_rest or not isinstance(named, str):
        got = "configuration and springs_at_rest" if at_rest else repr(named)
        raise InputError(
            "Start of the run",
            name="configuration",
            expected="the name of one",
            got=got,
            remedy="Remove springs_at_rest: the configuration says where the joints are"
            if at_rest
            else 'Write configuration = "home", with a name of the models\' files',
        )
    return scene.configuration({}, named), scene.named_configurations[named][1]


def _body_pose(entry: Mapping[str, Any], now: np.ndarray) -> pin.SE3:
    """Return the pose an [[initial.body]] entry gives; what it leaves out stays as it is."""
    placement = pin.XYZQUATToSE3(now)
    if "rpy" in entry and "quaternion" in entry:
        raise InputError(
            "Orientation given twice",
            name="rpy",
            expected="rpy or quaternion",
            got="both",
            remedy="Remove one of the two",
        )
    if "xyz" in entry:
        placement.translation = vector("xyz", entry["xyz"], 3)
    if "rpy" in entry:
        placement.rotation = pose("rpy", ([0.0, 0.0, 0.0], entry["rpy"])).rotation
    if "quaternion" in entry:
        x, y, z, w = unit_quaternion("quaternion", entry["quaternion"])
        placement.rotation = pin.Quaternion(w, x, y, z).toRotationMatrix()
    return placement
