"""Make parts of a scene from files and Pinocchio models: checked, with convex hulls, and with a report.

Pinocchio parses a URDF; what its reader drops or crashes on is caught before, in urdf.py and hulls.py. An MJCF is
compiled by MuJoCo (mjcf/).
"""

from __future__ import annotations

import fnmatch
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from contactvi.errors import ContactviError, InputError, SceneError, did_you_mean
from contactvi.files import checked_path
from contactvi.importing.checks import (
    ONE_DOF,
    check_joints,
    check_lengths,
    check_numbers,
    check_size,
    describe_model,
    has_limits,
    joint_kind,
)
from contactvi.importing.constraints import mimic_constraints
from contactvi.importing.hulls import describe
from contactvi.importing.mesh_hulls import MeshHulls, prepare_geometry
from contactvi.importing.meshes import collision_geometry, visual_geometry
from contactvi.importing.mjcf.compiler import Source, compile_file, import_mujoco
from contactvi.importing.mjcf.model import SOLREF, Choices, MjcfFile, part_of
from contactvi.importing.part import Part, plate_of
from contactvi.importing.paths import resolve_path
from contactvi.importing.report import GeometryRow, PartReport
from contactvi.importing.urdf import read_urdf
from contactvi.importing.xml import numbers, read_xml
from contactvi.inputs import flag, is_rigid, listed, real, short, words

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
    for entry in listed("package_dirs", package_dirs, "folders"):
        checked_path(entry, "package_dirs")
    file = resolve_path(path, folder, package_dirs)
    report, hulls = PartReport(f"{prefix}{file.stem}: URDF {file}, base {base}"), MeshHulls()
    with _reported(report, file):
        urdf = read_urdf(file, package_dirs, report, mimic)
        report.prefix_names(prefix)
        report.title = f"{prefix}{urdf.name}: URDF {file}, base {base}"
        if base == "free":
            model = _parse(file, lambda: pin.buildModelFromXML(urdf.xml, pin.JointModelFreeFlyer(), ROOT_JOINT))
        else:
            model = _parse(file, lambda: pin.buildModelFromXML(urdf.xml))
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
            load_visual=lambda: _visual(file, lambda: visual_geometry(model, urdf.xml), collision),
            prefix=prefix,
            placement=pin.SE3.Identity() if base == "free" else placement,
            disabled=found.pairs,
            mimics=urdf.mimics,
        )
        _finish(part, file.name, hulls)
        part.data.elements += mimic_constraints(part, urdf.mimics, mimic)
    if base == "free":
        part.start[:7] = pin.SE3ToXYZQUAT(placement)
    _configurations(part, found.states)
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
    with _reported(report, file):
        mujoco = import_mujoco()
        return MjcfFile(file, Source(mujoco, compile_file(mujoco, file, report), report))


def import_mjcf(
    opened: MjcfFile,
    *,
    placement: pin.SE3,
    gravity: np.ndarray,
    prefix: str = "",
    equality: Any = True,
    actuators: Any = True,
    restitution: Any = 0.0,
) -> Part:
    """Return the part of an MJCF; arguments as in Scene.add_mjcf, gravity [m/s^2] is the scene's.

    Raises like import_urdf.
    """
    if not (restitution is None or restitution == SOLREF):
        restitution = real("restitution", restitution, 0.0, 1.0)
    prefix = words("prefix", prefix)
    report = opened.source.report
    with _reported(report, opened.path):
        part = part_of(
            opened,
            Choices(prefix, placement, gravity, flag("equality", equality), flag("actuators", actuators), restitution),
        )
        report.prefix_names(prefix)
        report.title = f"{part.name}: MJCF {opened.path}"
        _finish(part, opened.path.name, MeshHulls())
    return part


def import_pinocchio(
    model: pin.Model,
    collision_model: pin.GeometryModel | None = None,
    visual_model: pin.GeometryModel | None = None,
    name: str | None = None,
) -> Part:
    """Return a part with copies of any pin.Model and its geometry. Raises like import_urdf."""
    for what, value, kind in (
        ("model", model, pin.Model),
        ("collision_model", collision_model, pin.GeometryModel),
        ("visual_model", visual_model, pin.GeometryModel),
    ):
        if not isinstance(value, kind) and not (value is None and what != "model"):
            raise InputError(
                f"Argument {what}",
                name=what,
                expected=f"pin.{kind.__name__}",
                got=type(value).__name__,
                remedy="Give an object of Pinocchio; add_urdf and add_mjcf read files",
            )
    model = model.copy()
    title = name or model.name or "model"
    collision = copy_geometry(collision_model)
    given = [(int(p.first), int(p.second)) for p in collision_model.collisionPairs] if collision_model else []
    visual = copy_geometry(visual_model) if visual_model is not None else collision
    report = PartReport(f"{title}: pin.Model, {model.njoints - 1} joints")
    with _reported(report):
        check_lengths(model, title)
        for i in range(1, model.njoints):
            if np.any(model.rotorInertia[model.idx_vs[i] : model.idx_vs[i] + model.nvs[i]]):
                text = "rotorInertia, rotorGearRatio: set_joint(rotor_inertia=, gear_ratio=) takes them"
                report.note("ignored", "joint", model.names[i], text)
        _name_bodies(model)
        _check_geometry_parents(model, collision, title)
        for geometry in (*collision.geometryObjects, *visual.geometryObjects):
            _check_geometry_place(geometry, title)
        part = Part(
            name=title,
            kind="pinocchio",
            model=model,
            collision=collision,
            start=neutral(model),
            report=report,
            load_visual=lambda: visual,
            given_pairs=given or None,
        )
        _finish(part, title, MeshHulls())
    return part


def copy_geometry(source: pin.GeometryModel | None) -> pin.GeometryModel:
    """Return a GeometryModel with copies of the objects (shapes shared) and without collision pairs."""
    # At once: a model that grows by one geometry after the other copies its table of pairs each time.
    result = pin.GeometryModel() if source is None else pin.GeometryModel(source)
    result.removeAllCollisionPairs()
    return result


@dataclass
class Srdf:
    """What an SRDF says about a model.

    Attributes:
        pairs: disabled pairs of links with their reasons.
        states: values of joints (each a list of numbers) by the name of a group state.
    """

    pairs: list[tuple[str, str, str]]
    states: dict[str, dict[str, list[float]]]


def read_srdf(file: Path, model: pin.Model, report: PartReport) -> Srdf:
    """Return what an SRDF says about the links and joints of a model; what it has not is noted.

    Raises:
        SceneError: broken XML, not an SRDF, or words in place of numbers.
    """
    root = read_xml(file, "robot", "an SRDF")
    known = {frame.name for frame in model.frames}
    found = Srdf([], {})
    for element in root.iter("disable_collisions"):
        first, second = element.get("link1", ""), element.get("link2", "")
        if first in known and second in known:
            found.pairs.append((first, second, element.get("reason", "")))
        else:
            missing = first if first not in known else second
            report.note("suspicious", "SRDF", missing, "disable_collisions of a link the model does not have")
    for state in root.iter("group_state"):
        values = found.states.setdefault(state.get("name", ""), {})
        for joint in state.iter("joint"):
            name = joint.get("name", "")
            if model.existJointName(name):
                values[name] = numbers(joint, "value", file, f"group_state {state.get('name')!r}") or []
            else:
                report.note("suspicious", "SRDF", name, "group_state of a joint the model does not have")
    return found


def _configurations(part: Part, states: Mapping[str, Mapping[str, list[float]]]) -> None:
    """Enter group states as configurations: joints that a state does not name are as in the start."""
    model = part.model
    for title, values in states.items():
        q = part.start.copy()
        for name, given in values.items():
            joint = model.joints[model.getJointId(name)]
            value = np.array(given)
            if joint.nq == 2 and len(value) == 1:
                value = np.array([np.cos(value[0]), np.sin(value[0])])
            if len(value) != joint.nq:
                text = f"group_state {title!r} gives {len(value)} numbers, the joint has {joint.nq}"
                part.report.note("suspicious", "SRDF", name, text)
                continue
            q[joint.idx_q : joint.idx_q + joint.nq] = value
        part.data.configurations[title] = pin.normalize(model, q), np.zeros(model.nv)


class _reported:
    """Attach file and report to an error that leaves the block, so that `contactvi check` can still print them."""

    def __init__(self, report: PartReport, file: Path | None = None) -> None:
        self.report = report
        self.file = file

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, SceneError):
            if not any(note.use == "refused" for note in self.report.notes):
                self.report.note("refused", "model", error.joint or error.body or "", str(error))
            error.report = self.report
            if error.path is None and self.file is not None:
                error.path = str(self.file)


def _parse(file: Path, build: Callable[[], Any]) -> Any:
    """Run a Pinocchio reader; its exceptions (of many kinds) become SceneErrors."""
    try:
        return build()
    except ContactviError:
        raise
    except Exception as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        reason = next((line for line in reversed(lines) if not line.startswith("Hint")), type(error).__name__)
        resource = next((line.rpartition("resource ")[2] for line in lines if "Could not load resource" in line), None)
        if resource is not None:
            raise SceneError(
                f"Cannot read the mesh {resource}",
                path=resource,
                got=reason,
                expected="a mesh file in a format that it reads: STL, OBJ, DAE or PLY",
                remedy="Export it again as STL or OBJ from a viewer of meshes, or replace it by a box or a sphere",
            ) from error
        raise SceneError(
            f"Pinocchio cannot read {file.name}",
            path=file,
            expected="a model it understands",
            got=reason,
            remedy="Correct what it names in the file; contactvi check prints what was understood until there",
        ) from error


def _finish(part: Part, source: str, hulls: MeshHulls) -> None:
    """Check the model, replace its meshes by hulls and fill the report."""
    model, report = part.model, part.report
    check_size(model, source)
    check_joints(model, report, source)
    check_numbers(model, source)
    describe_model(model, report, part.start, part.prefix, part.mimics)
    for geometry in part.collision.geometryObjects:
        frame = geometry.parentFrame
        body = part.prefix + model.frames[frame].name if frame else "universe"
        kind = describe(geometry.geometry)
        try:
            done = prepare_geometry(geometry, report, hulls)
        except SceneError as error:
            error.path = error.path or geometry.meshPath or None
            report.geometries.append(GeometryRow(part.prefix + geometry.name, body, kind, "refused"))
            raise
        shape = describe(geometry.geometry)
        report.geometries.append(GeometryRow(part.prefix + geometry.name, body, shape, done))
    for entry in model.referenceConfigurations:
        part.data.configurations[entry.key()] = np.array(entry.data()), np.zeros(model.nv)


def neutral(model: pin.Model) -> np.ndarray:
    """Return Pinocchio's neutral configuration moved into the joint limits, shape (nq,)."""
    q = np.asarray(pin.neutral(model))
    for i in range(1, model.njoints):
        if has_limits(model, i):
            k = model.idx_qs[i]
            q[k] = min(max(q[k], model.lowerPositionLimit[k]), model.upperPositionLimit[k])
    return q


def _name_bodies(model: pin.Model) -> None:
    """Give every joint without a body frame one of its name; models built in Python have no body frames."""
    named = {frame.parentJoint for frame in model.frames if frame.type == pin.FrameType.BODY}
    for i in range(1, model.njoints):
        if i not in named and not model.existFrame(model.names[i], pin.FrameType.BODY):
            inertia = pin.Inertia.Zero()
            model.addFrame(pin.Frame(model.names[i], i, 0, pin.SE3.Identity(), pin.FrameType.BODY, inertia), False)


def _check_geometry_parents(model: pin.Model, collision: pin.GeometryModel, source: str) -> None:
    counts = Counter(geometry.name for geometry in collision.geometryObjects)
    bodies: dict[int, int] = {}  # the first body frame of each joint
    joint_of = [int(frame.parentJoint) for frame in model.frames]
    for k, frame in enumerate(model.frames):
        if frame.type == pin.FrameType.BODY:
            bodies.setdefault(joint_of[k], k)
    for geometry in collision.geometryObjects:
        name = geometry.name
        if geometry.parentJoint >= model.njoints:
            raise SceneError(
                f"{source}: geometry {name!r}",
                body=name,
                expected=f"a parent joint below {model.njoints}",
                got=geometry.parentJoint,
                remedy="Set geometry.parentJoint to a joint of this model, or build both from the same file",
            )
        if counts[name] > 1:
            raise SceneError(
                f"{source}: two geometries are called {name!r}",
                body=name,
                expected="distinct names",
                got=name,
                remedy="Rename one of them: geometry.name",
            )
        at, joint = geometry.parentFrame, geometry.parentJoint
        if at >= len(joint_of) or joint_of[at] != joint:
            geometry.parentFrame = bodies.get(joint, 0) if joint else 0


def _check_geometry_place(geometry: pin.GeometryObject, source: str) -> None:
    matrix = np.array(geometry.placement.homogeneous)
    if not is_rigid(matrix):
        raise SceneError(
            f"{source}: placement of geometry {geometry.name!r}",
            body=geometry.name,
            expected="finite numbers and a rotation",
            got=str(matrix.tolist()),
            remedy="Set geometry.placement to a pin.SE3 whose rotation is orthogonal with determinant 1",
        )


def _visual(file: Path, build: Callable[[], pin.GeometryModel], collision: pin.GeometryModel) -> pin.GeometryModel:
    """Load pictures; for a model without any, copy its collision shapes."""
    visual = _parse(file, build)
    return visual if len(visual.geometryObjects) else copy_geometry(collision)


def pictures(part: Part) -> list[pin.GeometryObject]:
    """Return the part's pictures, halfspaces as plates."""
    return [
        plate_of(geometry) if isinstance(geometry.geometry, coal.Halfspace) else geometry.copy()
        for geometry in part.load_visual().geometryObjects
    ]


__all__ = [
    "MjcfFile",
    "copy_geometry",
    "import_mjcf",
    "import_pinocchio",
    "import_urdf",
    "neutral",
    "open_mjcf",
    "pictures",
    "read_srdf",
]
