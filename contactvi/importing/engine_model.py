"""The numbers of a pin.Model as the engine takes them; in Pinocchio's coordinates it finds forces and motions of them.

A pin.Data would hold tensors of the size nv^3: 1.7 GB for a chain of 300 links, 14 GB for 200 free bodies. The engine's
passes over the joints take time and memory of their number, of its square for matrices (core/model/joint_walk.hpp).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import pinocchio as pin

from contactvi.importing.joint_kinds import KINDS, ONE_DOF, motion_axis

if TYPE_CHECKING:
    from contactvi import _core

EngineModel: TypeAlias = "_core.Model"


def engine_model(model: pin.Model) -> EngineModel:
    """Return the engine's copy of a model, whose joints are all of supported types (see joint_kinds)."""
    from contactvi import _core  # here: saved runs are read and shown without the engine

    result = _core.Model(model.gravity.linear, model.armature, model.lowerPositionLimit, model.upperPositionLimit)
    rows = zip(model.joints, model.parents, model.jointPlacements, model.inertias, model.names, strict=True)
    for number, (joint, parent, place, body, name) in enumerate(rows):
        if number == 0:  # the world
            continue
        kind = KINDS[joint.shortname()]
        subspace = motion_axis(joint) if kind in ONE_DOF else np.zeros(6)
        result.add_joint(
            _core.JointType[kind.upper()], int(parent), subspace, place.rotation, place.translation,
            body.mass, body.lever, body.inertia, str(name),
        )  # fmt: skip
    return result
