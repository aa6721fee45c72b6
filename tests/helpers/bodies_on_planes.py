"""Free bodies over planes, for the oracles of contact: models, placements on slopes, corners of boxes."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from oracles.contact_points import VertexPlane
from oracles.persistent_scenes import GRAVITY


def free_body(inertia: pin.Inertia, gravity: float = GRAVITY) -> pin.Model:
    model = pin.Model()
    model.gravity = pin.Motion(np.array([0.0, 0.0, -gravity]), np.zeros(3))
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return model


def slope_frame(slope: float) -> tuple[np.ndarray, np.ndarray]:
    """(down, normal) of a slope about the y axis."""
    return np.array([math.cos(slope), 0.0, -math.sin(slope)]), np.array([math.sin(slope), 0.0, math.cos(slope)])


def on_slope(model: pin.Model, slope: float, height: float) -> np.ndarray:
    q = pin.neutral(model)
    q[:3] = slope_frame(slope)[1] * height
    q[3:7] = pin.Quaternion(pin.exp3(np.array([0.0, slope, 0.0]))).coeffs()
    return q


def corners(size, mu: float, plane: dict) -> list:
    """The four lower corners of a box (body 2 of a split free-flyer) over a plane of the world."""
    half = 0.5 * np.array(size)
    return [VertexPlane(2, (x * half[0], y * half[1], -half[2]), mu, **plane) for x in (-1, 1) for y in (-1, 1)]
