"""Make a part of a pin.Model that the user has built or loaded."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pinocchio as pin

from contactvi.errors import InputError, SceneError
from contactvi.importing.checks import check_lengths
from contactvi.importing.mesh_choices import mesh_choice
from contactvi.importing.mesh_hulls import MeshHulls
from contactvi.importing.part import Part, copy_geometry
from contactvi.importing.pictures import pictures_of
from contactvi.importing.prepare import finish, neutral, reported
from contactvi.importing.report import PartReport
from contactvi.inputs import is_rigid


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
    with reported(report):
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
            load_pictures=lambda: pictures_of(visual),
            given_pairs=given or None,
        )
        part = finish(part, title, MeshHulls(), mesh_choice(None, None))
    return part


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
