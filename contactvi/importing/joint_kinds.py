"""The types of joints that are supported, by their public names: which joint has which, its axis and its limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

_AXES = ("X", "Y", "Z")
REVOLUTE = {*(f"JointModelR{a}" for a in _AXES), "JointModelRevoluteUnaligned"}
CONTINUOUS = {*(f"JointModelRUB{a}" for a in _AXES), "JointModelRevoluteUnboundedUnaligned"}
PRISMATIC = {*(f"JointModelP{a}" for a in _AXES), "JointModelPrismaticUnaligned"}
HELICAL = {*(f"JointModelH{a}" for a in _AXES), "JointModelHelicalUnaligned"}
KINDS = {
    **dict.fromkeys(REVOLUTE, "revolute"),
    **dict.fromkeys(CONTINUOUS, "continuous"),
    **dict.fromkeys(PRISMATIC, "prismatic"),
    **dict.fromkeys(HELICAL, "helical"),
    "JointModelPlanar": "planar",
    "JointModelTranslation": "translation",
    "JointModelSpherical": "spherical",
    "JointModelFreeFlyer": "free",
}
_ALIGNED = {"revolute": "R", "continuous": "RUB", "prismatic": "P", "helical": "H"}
MANY_DOFS = {"planar": "Planar", "translation": "Translation", "spherical": "Spherical", "free": "FreeFlyer"}
ONE_DOF = ("revolute", "continuous", "prismatic", "helical")
PLACING = ("free", "planar", "translation", "prismatic")  # root joints whose start values place a whole tree
NO_LIMIT = 1e300  # Pinocchio writes both inf and the largest double for "no limit".


def joint_kind(joint: pin.JointModel) -> str | None:
    """Return the public name of a joint's type, None when the engine does not support it."""
    return KINDS.get(joint.shortname())


def has_limits(model: pin.Model, index: int) -> bool:
    """Return whether a joint has one degree of freedom and finite limits lower < upper; others are not used."""
    joint = model.joints[index]
    if joint_kind(joint) not in ONE_DOF or joint.nq != 1:
        return False
    lower, upper = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
    return bool(-NO_LIMIT < lower < upper < NO_LIMIT)


def joint_model(kind: str, axis: np.ndarray | None = None, pitch: float = 0.0) -> Any:
    """Return the pin.JointModel of a public name, with a unit axis (3,) and a pitch [m/rad] where it has them."""
    if kind in MANY_DOFS:
        return getattr(pin, f"JointModel{MANY_DOFS[kind]}")()
    assert axis is not None
    pitches = [pitch] if kind == "helical" else []
    for letter, unit in zip(_AXES, np.eye(3), strict=True):
        if np.array_equal(axis, unit):
            return getattr(pin, f"JointModel{_ALIGNED[kind]}{letter}")(*pitches)
    if kind == "continuous":
        return _continuous(axis)
    return getattr(pin, f"JointModel{kind.capitalize()}Unaligned")(axis, *pitches)


def _continuous(axis: np.ndarray) -> Any:
    """Return an unbounded revolute joint about any axis; in pin 4.1 Python can make one only from a URDF."""
    x, y, z = (repr(float(a)) for a in axis)
    model = pin.buildModelFromXML(
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>'
        f'<child link="b"/><axis xyz="{x} {y} {z}"/></joint></robot>'
    )
    return model.joints[1]


def motion_axis(joint: pin.JointModel) -> np.ndarray:
    """Return the constant motion subspace of a 1-dof joint, shape (6,): linear, angular, in the joint frame."""
    data = joint.createData()
    joint.calc(data, np.array([1.0, 0.0]) if joint.nq == 2 else np.zeros(1))
    return np.asarray(data.S, dtype=float).reshape(6)
