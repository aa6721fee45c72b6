"""Scene files: one readable TOML page with what is simulated, how it starts and how it is run.

    [scene]                 gravity = [0, 0, -9.81]                 title, description: for the reader
                            camera = "auto" | "front" | "side" | "top" | { eye = [x, y, z], target = [x, y, z] } |
                            { follow = "body" }
    [[urdf]]                path, base = "fixed" | "free", xyz, rpy, package_dirs, srdf, prefix, limits = true,
                            friction = false, mimic = true, armature = number | { joint = number },
                            self_collision = true, contact_friction = false
    [[mjcf]]                path, xyz, rpy, prefix, limits = true, friction = false, equality = true, actuators = true,
                            restitution = 0 | number | "solref", self_collision = true, allow = [] | ["flex"],
                            turning_friction = false, hfield = "prisms" | "smooth"
    [[sphere]]              name, radius, mass, free = true, xyz, rpy, color
    [[box]]                 name, size, ...       [[capsule]], [[cylinder]]  name, radius, length, ...
    [[ellipsoid]]           name, radii, ...
    [[mesh]]                name, path, mass | density, scale, decompose = false | true | number,
                            spacing, ...
    [[halfspace]]           normal, offset, name, color
    [[heightfield]]         name, heights = [[...], ...] | path, size = [x, y], height, smooth = true, xyz, rpy, color
    [contact]               restitution, friction (defaults), disable = [["a", "b"]], enable = [["a", "b"]]
    [[contact.body]]        name, restitution, friction             of one body, part or geometry
    [[contact.pair]]        a, b, restitution, friction
    [[joint]]               name (patterns such as "joint_*" allowed), stiffness, rest, damping, limits, restitution,
                            friction, spring = [k1, k2, ...], armature, gear_ratio, rotor_inertia
    [[point]], [[distance]] a, b, point_a, point_b, name; [[distance]] also length
    [[weld]], [[screw]]     a, b, name; [[weld]] xyz, rpy; [[screw]] pitch, frame_a, frame_b = { xyz, rpy }
    [[equality]]            joint, other, coefficients = [c0, c1, ...], name
    [[prescribe]]           joint (or a free body), motion, name
    [[compliance]]          a, b, stiffness, exponent, damping, friction, slip_speed     as Scene.set_compliance
    [[surface_velocity]]    a, linear, angular, profile             as Scene.set_surface_velocity
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
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pinocchio as pin

from contactvi.errors import InputError, SceneError
from contactvi.importing.part import Part
from contactvi.importing.paths import resolve_path, unreadable
from contactvi.importing.readers import import_mjcf, import_urdf, open_mjcf
from contactvi.inputs import listed, pose
from contactvi.options import Options
from contactvi.scene.contact_laws import CONTACT_SETTINGS
from contactvi.scene.scene import GRAVITY, Scene
from contactvi.scene.toml_start import set_start
from contactvi.scene.toml_tables import ELEMENTS, LISTS, at, check_keys

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Return the scene of a TOML file, with its start in .q0 (nq,), .v0 (nv,) and its run settings in .settings.

    Raises:
        SceneError: no such file, not TOML, unknown or missing keys.
        ContactviError: whatever the scene itself refuses, with the place in the file.
    """
    file = resolve_path(path)
    data = _read(file)
    check_keys(data, file)
    scene = Scene(data.get("scene", {}).get("gravity", GRAVITY))
    for section in LISTS[: LISTS.index("joint")]:
        for number, entry in enumerate(data.get(section, ())):
            with at(file, section, number):
                _add(scene, section, dict(entry), file)
    _set_contact(scene, data.get("contact", {}), file)
    for number, entry in enumerate(data.get("joint", ())):
        with at(file, "joint", number):
            values = dict(entry)
            scene.set_joint(values.pop("name"), **values)
    for section in ELEMENTS:
        for number, entry in enumerate(data.get(section, ())):
            with at(file, section, number):
                _add_element(scene, section, entry)
    set_start(scene, data, file)
    _set_camera(scene, data, file)
    scene.settings = dict(data.get("run", {}))
    if "dt" in scene.settings:
        with at(file, "run"):
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
            contact_friction=entry.get("contact_friction", False),
        )
        _add_model(scene, part, entry)
    elif section == "mjcf":
        options = {
            key: entry[key]
            for key in ("prefix", "equality", "actuators", "restitution", "allow", "turning_friction", "hfield")
            if key in entry
        }
        opened = open_mjcf(entry["path"], folder)
        part = import_mjcf(opened, placement=placement, gravity=scene.gravity, **options)
        _add_model(scene, part, entry)
    elif section == "halfspace":
        scene.add_halfspace(**entry)
    else:
        entry.pop("xyz", None), entry.pop("rpy", None)
        if section == "heightfield":
            _take_heights(entry, folder)
        if section == "mesh":
            entry["mesh"] = resolve_path(entry.pop("path"), folder)
        getattr(scene, f"add_{section}")(**entry, placement=placement)


def _take_heights(entry: dict[str, Any], folder: Path) -> None:
    """Put the heights of a field, or the path of their file, in their place. Raises InputError for both or none."""
    if ("heights" in entry) == ("path" in entry):
        raise InputError(
            "The heights of a field", name="heights", expected="heights or path",
            got="both" if "path" in entry else "none", remedy='Write path = "hills.npy"',
        )  # fmt: skip
    if "path" in entry:
        entry["heights"] = resolve_path(entry.pop("path"), folder)


def _add_model(scene: Scene, part: Part, entry: Mapping[str, Any]) -> None:
    scene.add_model(
        part, entry.get("limits", True), entry.get("friction", False), entry.get("self_collision", True)
    )  # fmt: skip


def _add_element(scene: Scene, section: str, entry: Mapping[str, Any]) -> None:
    """Add a constraint, spring, wrench, compliant pair, servo or actuator to the scene."""
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
    elif section in ("compliance", "surface_velocity", "servo", "actuator"):
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
    values = {key: contact[key] for key in CONTACT_SETTINGS if key in contact}
    with at(file, "contact"):
        scene.set_contact(**values)
        for key, switch in (("disable", scene.disable_pair), ("enable", scene.enable_pair)):
            for pair in listed(key, contact.get(key, []), "pairs of names"):
                switch(*_two(pair, key))
    for number, entry in enumerate(contact.get("body", ())):
        with at(file, "contact.body", number):
            values = dict(entry)
            scene.set_contact(values.pop("name"), **values)
    for number, entry in enumerate(contact.get("pair", ())):
        with at(file, "contact.pair", number):
            values = dict(entry)
            scene.set_contact(values.pop("a"), values.pop("b"), **values)


def _set_camera(scene: Scene, data: Mapping[str, Any], file: Path) -> None:
    if "camera" not in data.get("scene", {}):
        return
    with at(file, "scene"):
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
