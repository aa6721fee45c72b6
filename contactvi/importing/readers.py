"""Make parts of a scene from files: checked, with convex hulls, and with a report.

Pinocchio parses a URDF; what its reader drops or crashes on is caught before, in urdf.py and hulls.py. An MJCF is
compiled by MuJoCo (mjcf/).
"""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.errors import ContactviError, InputError, SceneError, did_you_mean
from contactvi.files import checked_path
from contactvi.importing.constraints import mimic_constraints
from contactvi.importing.joint_kinds import ONE_DOF, joint_kind
from contactvi.importing.mesh_choices import mesh_choice
from contactvi.importing.mesh_hulls import MeshHulls
from contactvi.importing.meshes import collision_geometry, pictures_of_urdf, without_shapes
from contactvi.importing.mjcf.compiler import open_source
from contactvi.importing.mjcf.model import ALLOWED, SOLREF, Choices, MjcfFile, part_of
from contactvi.importing.mjcf.shapes import HFIELDS
from contactvi.importing.part import Part
from contactvi.importing.paths import mesh_error, reason_of, resolve_path
from contactvi.importing.pictures import Picture, pictures_of
from contactvi.importing.prepare import finish, neutral, reported
from contactvi.importing.report import PartReport
from contactvi.importing.srdf import Srdf, add_group_states, read_srdf
from contactvi.importing.urdf import read_urdf
from contactvi.inputs import check_choice, flag, listed, real, short, words

ROOT_JOINT = "root_joint"  # Pinocchio's name for the free-flyer of a free base


def import_urdf(
    path: str | os.PathLike[str],
    *,
    base: str = "fixed",
    placement: pin.SE3,
    package_dirs: Sequence[object] = (),
    srdf: str | os.PathLike[str] | None = None,
    prefix: str = "",
    folder: Path | None = None,
    mimic: Any = True,
    armature: Any = None,
    contact_friction: Any = False,
    shape: Any = None,
    spacing: Any = None,
) -> Part:
    """Return the part described by a URDF; arguments as in Scene.add_urdf, a relative path is relative to `folder`.

    Raises:
        SceneError: the model cannot be used; its attribute `report` is the PartReport up to there.
    """
    if not isinstance(base, str) or base not in ("fixed", "free"):
        raise InputError(
            "Argument base",
            name="base",
            expected="'fixed' or 'free'",
            got=short(base),
            remedy="Use base='free' for a robot that can move away, base='fixed' for one that is bolted down",
        )
    mimic, prefix = flag("mimic", mimic), words("prefix", prefix)
    contact_friction, choice = flag("contact_friction", contact_friction), mesh_choice(shape, spacing)
    for entry in listed("package_dirs", package_dirs, "folders"):
        checked_path(entry, "package_dirs")
    file = resolve_path(path, folder, package_dirs)
    report, hulls = PartReport(f"{prefix}{file.stem}: URDF {file}, base {base}"), MeshHulls()
    with reported(report, file):
        urdf = read_urdf(file, package_dirs, report, mimic, contact_friction)
        report.prefix_names(prefix)
        report.title = f"{prefix}{urdf.name}: URDF {file}, base {base}"
        tree = without_shapes(urdf.xml)
        if base == "free":
            model = _parse(file, lambda: pin.buildModelFromXML(tree, pin.JointModelFreeFlyer(), ROOT_JOINT))
        else:
            model = _parse(file, lambda: pin.buildModelFromXML(tree))
        collision = _parse(file, lambda: collision_geometry(model, urdf.xml, hulls))
        _add_armature(model, armature, report, prefix)
        found = Srdf([], {}) if srdf is None else read_srdf(resolve_path(srdf, folder, package_dirs), model, report)
        part = Part(
            name=prefix + urdf.name,
            kind="urdf",
            model=model,
            collision=collision,
            start=neutral(model),
            report=report,
            load_pictures=cache(lambda: _pictures(file, lambda: pictures_of_urdf(model, urdf.xml), collision)),
            prefix=prefix,
            placement=pin.SE3.Identity() if base == "free" else placement,
            disabled=[*urdf.filtered, *found.pairs],
            mimics=urdf.mimics,
        )
        part.data.elements += mimic_constraints(part, urdf.mimics, mimic)
        part.data.contact.update({(name,): (value, None) for name, value in urdf.friction.items()})
        part = finish(part, file.name, hulls, choice)
    if base == "free":
        part.start[:7] = pin.SE3ToXYZQUAT(placement)
    add_group_states(part, found.states)
    return part


def _add_armature(model: pin.Model, armature: Any, report: PartReport, prefix: str) -> None:
    """Give joints an armature [kg m^2 or kg]: one number for all with one degree of freedom, or numbers by pattern."""
    if armature is None:
        return
    given = armature if isinstance(armature, Mapping) else {"*": armature}
    values = np.array(model.armature)
    for pattern, value in given.items():
        number = real(f"armature of {pattern!r}", value, 0.0)
        chosen = [
            i
            for i in range(1, model.njoints)
            if fnmatch.fnmatchcase(model.names[i], str(pattern)) and joint_kind(model.joints[i]) in ONE_DOF
        ]
        if not chosen:
            raise InputError(
                "Armature of a joint",
                name="armature",
                expected="names or patterns of joints with one degree of freedom",
                got=repr(pattern),
                remedy=did_you_mean(str(pattern), list(model.names)[1:]),
            )
        for i in chosen:
            values[model.idx_vs[i]] = number
            report.note("changed", "joint", prefix + model.names[i], f"armature {number:g} kg m^2 or kg")
    model.armature = values


def open_mjcf(path: str | os.PathLike[str], folder: Path | None = None) -> MjcfFile:
    """Return a compiled MJCF, of which `import_mjcf` makes a part. Raises like import_urdf."""
    file = resolve_path(path, folder)
    report = PartReport(f"{file.stem}: MJCF {file}")
    with reported(report, file):
        return MjcfFile(file, open_source(file, report))


def import_mjcf(
    opened: MjcfFile,
    *,
    placement: pin.SE3,
    gravity: np.ndarray,
    prefix: str = "",
    equality: Any = True,
    actuators: Any = True,
    restitution: Any = 0.0,
    allow: Any = (),
    turning_friction: Any = False,
    hfield: Any = "prisms",
    shape: Any = None,
    spacing: Any = None,
) -> Part:
    """Return the part of an MJCF; arguments as in Scene.add_mjcf, gravity [m/s^2] is the scene's.

    Raises like import_urdf.
    """
    if not (restitution is None or restitution == SOLREF):
        restitution = real("restitution", restitution, 0.0, 1.0)
    prefix, kinds, choice = words("prefix", prefix), _allowed(allow), mesh_choice(shape, spacing)
    check_choice("hfield", hfield, HFIELDS, "way to take height fields")
    report, hulls = opened.source.report, MeshHulls()
    with reported(report, opened.path):
        part = part_of(
            opened,
            Choices(
                prefix,
                placement,
                gravity,
                flag("equality", equality),
                flag("actuators", actuators),
                restitution,
                kinds,
                flag("turning_friction", turning_friction),
                hfield,
            ),  # fmt: skip
            hulls,
        )
        report.prefix_names(prefix)
        report.title = f"{part.name}: MJCF {opened.path}"
        part = finish(part, opened.path.name, hulls, choice)
    return part


def _allowed(allow: Any) -> tuple[str, ...]:
    """Return the argument allow as a tuple."""
    found = tuple(listed("allow", [allow] if isinstance(allow, str) else allow, "kinds of elements"))
    for kind in found:
        if kind not in ALLOWED:
            raise InputError(
                "Argument allow",
                name="allow",
                expected=" | ".join(map(repr, ALLOWED)),
                got=short(kind),
                remedy="allow=('flex',) loads a file with deformable bodies, without their elasticity",
            )
    return found


def _parse(file: Path, build: Callable[[], Any]) -> Any:
    """Run a Pinocchio reader; its exceptions (of many kinds) become SceneErrors."""
    try:
        return build()
    except ContactviError:
        raise
    except Exception as error:
        lines = [line.strip() for line in str(error).splitlines()]
        resource = next((line.rpartition("resource ")[2] for line in lines if "Could not load resource" in line), None)
        if resource is not None:
            raise mesh_error(resource, error, "") from error
        raise SceneError(
            f"Pinocchio cannot read {file.name}",
            path=file,
            expected="a model it understands",
            got=reason_of(error),
            remedy="Correct what it names in the file; contactvi check prints what was understood until there",
        ) from error


def _pictures(file: Path, load: Callable[[], list[Picture]], collision: pin.GeometryModel) -> list[Picture]:
    """Load pictures; a model without any is drawn by its collision shapes."""
    found: list[Picture] = _parse(file, load)
    return found or pictures_of(collision)
