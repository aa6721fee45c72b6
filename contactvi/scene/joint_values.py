"""Values and velocities of joints as numbers in q and v.

Units: rad, m, rad/s, m/s.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.errors import InputError
from contactvi.importing.checks import joint_kind
from contactvi.inputs import pose, real, unit_quaternion, vector


def joint_value(model: pin.Model, name: str, value: Any, argument: str | None = None) -> np.ndarray:
    """Return the numbers in q of a joint's value.

    revolute, helical, continuous: angle [rad]; prismatic: [m]; planar: x, y, angle; translation: x, y, z;
    spherical: quaternion (x, y, z, w); free: any placement that `inputs.pose` takes.
    """
    joint = model.joints[model.getJointId(name)]
    kind, what = joint_kind(joint), argument or f"value of joint {name!r}"
    if kind == "free":
        return np.asarray(pin.SE3ToXYZQUAT(pose(what, value)))
    if kind == "spherical":
        return unit_quaternion(what, value)
    if kind == "translation":
        return vector(what, value, 3)
    if kind == "planar":
        x, y, angle = vector(what, value, 3)
        return np.array([x, y, np.cos(angle), np.sin(angle)])
    angle = real(what, value)
    return np.array([np.cos(angle), np.sin(angle)]) if joint.nq == 2 else np.array([angle])


def joint_velocity(model: pin.Model, name: str, value: Any, q: np.ndarray) -> np.ndarray:
    """Return the numbers in v of a joint's velocity at configuration q (nq,).

    1-dof: one number [rad/s or m/s]; spherical: angular velocity in body axes; translation: linear; planar: Pinocchio's
    (body axes); free: (linear, angular) of the body's origin in the parent's (the world's) axes, turned to body axes.
    """
    joint = model.joints[model.getJointId(name)]
    what = f"velocity of joint {name!r}"
    if joint.nv == 1:
        return np.array([real(what, value)])
    if joint_kind(joint) != "free":
        return vector(what, value, joint.nv)
    linear, angular = (value, np.zeros(3)) if np.shape(value) == (3,) else (None, None)
    if linear is None:
        if np.shape(value) != (2, 3):
            raise InputError(f"Shape of {what}", name="velocity", expected="(linear, angular)", got=repr(value))
        linear, angular = value
    rotation = pin.XYZQUATToSE3(q[joint.idx_q : joint.idx_q + 7]).rotation
    return np.concatenate([rotation.T @ vector(what, linear, 3), rotation.T @ vector(what, angular, 3)])
