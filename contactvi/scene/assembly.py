"""Join the parts of a scene into one pin.Model and one collision GeometryModel.

Joint by joint and not with pin.appendModel, which in pin 4.1 loses the armature. Parts come in the order they were
added, each depth-first, so the whole model is depth-first, which Pinocchio's sparse algorithms need.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from contactvi.importing.joint_kinds import PLACING, joint_kind
from contactvi.importing.part import Part, pictures
from contactvi.importing.pictures import Picture

_PER_Q = ("lowerPositionLimit", "upperPositionLimit", "positionLimitMargin")
_PER_V = (
    "lowerEffortLimit",
    "upperEffortLimit",
    "lowerVelocityLimit",
    "upperVelocityLimit",
    "lowerDryFrictionLimit",
    "upperDryFrictionLimit",
    "damping",
    "armature",
    "rotorInertia",
    "rotorGearRatio",
)


@dataclass
class Assembly:
    """The assembled scene.

    Attributes:
        start: neutral configuration, shape (nq,).
        part_of_joint, part_of_geometry: index of the part, shapes (njoints,) (universe: -1), (ngeoms,).
        root_of_joint: first joint on the way from the world, shape (njoints,).
        placed: whether the start places the tree of a joint (free, planar, translation or prismatic root), shape
            (njoints,).
    """

    model: pin.Model
    collision: pin.GeometryModel
    start: np.ndarray
    part_of_joint: np.ndarray
    part_of_geometry: np.ndarray
    root_of_joint: np.ndarray
    placed: np.ndarray


def assemble(parts: Sequence[Part], gravity: np.ndarray) -> Assembly:
    """Return the one model of all parts; collision pairs are chosen later (pairs.py)."""
    model = pin.Model()
    model.name = "scene"
    model.gravity.linear = gravity
    collision = pin.GeometryModel()
    part_of_joint, part_of_geometry = [-1], []
    for index, part in enumerate(parts):
        joints = _add_joints(model, part)
        frames = _add_frames(model, part, joints)
        part_of_joint += [index] * (len(joints) - 1)
        for geometry in part.collision.geometryObjects:
            collision.addGeometryObject(_moved(geometry, part, joints, frames))
            part_of_geometry.append(index)
    roots = np.zeros(model.njoints, dtype=int)
    placed = np.zeros(model.njoints, dtype=bool)
    for i in range(1, model.njoints):
        roots[i] = roots[model.parents[i]] or i
        placed[i] = joint_kind(model.joints[int(roots[i])]) in PLACING
    start = np.concatenate([part.start for part in parts]) if parts else np.zeros(0)
    return Assembly(
        model, collision, start, np.array(part_of_joint), np.array(part_of_geometry, dtype=int), roots, placed
    )


def assemble_pictures(parts: Sequence[Part], model: pin.Model) -> list[Picture]:
    """Return the pictures of all parts, attached to the joints of the assembled model."""
    found: dict[str, Picture] = {}
    for part in parts:
        joints = [0] + [model.getJointId(name) for name in part.joint_names()]
        for picture in pictures(part):
            geometry = _moved(picture.geometry, part, joints, None)
            geometry.name = _unused(found, geometry.name, part.prefix)
            found[geometry.name] = Picture(geometry, picture.surface)
    return list(found.values())


def _add_joints(model: pin.Model, part: Part) -> list[int]:
    """Add the part's joints with all they carry; return the assembled index of each of its joints."""
    source = part.model
    joints = [0]
    for i in range(1, source.njoints):
        parent = joints[source.parents[i]]
        placement = source.jointPlacements[i]
        if source.parents[i] == 0:
            placement = part.placement * placement
        joint = model.addJoint(parent, source.joints[i], placement, part.prefix + source.names[i])
        joints.append(joint)
        model.inertias[joint] = source.inertias[i]
        _copy_slices(source, model, i, joint)
    model.inertias[0] = model.inertias[0] + part.placement.act(source.inertias[0])
    return joints


def _copy_slices(source: pin.Model, model: pin.Model, i: int, joint: int) -> None:
    for names, starts, sizes in ((_PER_Q, "idx_qs", "nqs"), (_PER_V, "idx_vs", "nvs")):
        first, size = getattr(source, starts)[i], getattr(source, sizes)[i]
        target = getattr(model, starts)[joint]
        for name in names:
            getattr(model, name)[target : target + size] = getattr(source, name)[first : first + size]


def _add_frames(model: pin.Model, part: Part, joints: list[int]) -> list[int]:
    """Add the part's frames; return the assembled index of each."""
    source = list(part.model.frames)
    frames = [0] * len(source)
    parents = [_parent_frame(part.model, i) for i in range(len(source))]
    for i in _parents_first(parents):
        frame = source[i]
        placement = frame.placement
        if frame.parentJoint == 0:
            placement = part.placement * placement
        copy = pin.Frame(
            part.prefix + frame.name,
            joints[frame.parentJoint],
            frames[parents[i]],
            placement,
            frame.type,
            frame.inertia,
        )
        # The inertia of the frame is part of the joint's already.
        frames[i] = model.addFrame(copy, False)
    return frames


def _parent_frame(model: pin.Model, i: int) -> int:
    """Return the parent of frame i; buildReducedModel makes frames of locked joints that are their own parents."""
    frame = model.frames[i]
    if frame.parentFrame != i or i == 0:
        return int(frame.parentFrame)
    own = model.names[frame.parentJoint]
    return int(model.getFrameId(own, pin.FrameType.JOINT)) if model.existFrame(own, pin.FrameType.JOINT) else 0


def _parents_first(parents: list[int]) -> list[int]:
    """Return the indices from 1 on, each after its parent; frames without a way to frame 0 come last."""
    order, waiting = [0], list(range(1, len(parents)))
    while waiting:
        ready = [i for i in waiting if parents[i] in order] or waiting
        order += ready
        waiting = [i for i in waiting if i not in ready]
    return order[1:]


def _moved(geometry: pin.GeometryObject, part: Part, joints: list[int], frames: list[int] | None) -> pin.GeometryObject:
    copy = geometry.copy()
    copy.parentJoint = joints[geometry.parentJoint]
    copy.parentFrame = frames[geometry.parentFrame] if frames is not None else 0
    if frames is not None:
        copy.name = part.prefix + geometry.name
    if copy.parentJoint == 0:
        copy.placement = part.placement * geometry.placement
    return copy


def _unused(taken: Container[str], name: str, prefix: str) -> str:
    """Return a name that no picture has yet; two parts may have links of one name."""
    candidate, count = prefix + name, 1
    while candidate in taken:
        count += 1
        candidate = f"{prefix}{name}_{count}"
    return candidate
