"""What the entries of a scene file make of a scene (contactvi.scene.toml)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pinocchio as pin

from contactvi.aliases import warn_deprecated
from contactvi.errors import InputError
from contactvi.importing.part import Part
from contactvi.importing.paths import resolve_path
from contactvi.importing.readers import import_mjcf, import_urdf, open_mjcf
from contactvi.inputs import listed, pose
from contactvi.options import Options, is_auto
from contactvi.scene.contact_laws import CONTACT_SETTINGS
from contactvi.scene.notes import part_order
from contactvi.scene.toml_start import set_start
from contactvi.scene.toml_tables import ELEMENTS, at

Scene = Any  # contactvi.Scene, which uses this module to look at what it has written


def fill(scene: Scene, data: Mapping[str, Any], file: Path) -> None:
    """Add what the checked data of a file name to an empty scene: parts, contacts, elements, start and settings.

    Raises:
        ContactviError: whatever the scene itself refuses, with the place in the file.
    """
    with at(file, "scene"):
        order = part_order(data)
    for place, section in enumerate(order):
        number = order[:place].count(section)
        with at(file, section, number):
            _add(scene, section, dict(data[section][number]), file)
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
    scene.settings = _run_settings(data.get("run", {}), file)
    if "dt" in scene.settings:
        with at(file, "run"):
            Options.from_dict(scene.settings)


def _run_settings(entries: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Return the settings of [run]; tol beside a number as dt is solver_tol, which it was called in older files."""
    settings = dict(entries)
    if "tol" in settings and "solver_tol" not in settings and not is_auto(settings):
        warn_deprecated(
            f"{file}, [run]: tol is the accuracy of q, which steps of a given length do not choose. Write solver_tol ="
            f" {settings['tol']}, the tolerance to which the equations of a step are solved, as which it is taken"
        )
        settings["solver_tol"] = settings.pop("tol")
    return settings


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
            shape=entry.get("shape"),
            spacing=entry.get("spacing"),
        )
        _add_model(scene, part, entry)
    elif section == "mjcf":
        keys = (
            "prefix",
            "equality",
            "actuators",
            "restitution",
            "allow",
            "turning_friction",
            "hfield",
            "shape",
            "spacing",
        )
        options = {key: entry[key] for key in keys if key in entry}
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
