"""Scenes with compliant pairs: a ball that drops, and a table on four balls."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin

import contactvi as cvi

MASS, RADIUS = 0.8, 0.05


def ball(height: float, gravity: float = 9.81, **law: Any) -> cvi.Scene:
    """A ball whose lowest point is at a height above a compliant ground."""
    scene = cvi.Scene(gravity=(0.0, 0.0, -gravity))
    scene.add_halfspace()
    scene.add_sphere("ball", RADIUS, MASS, placement=(0.0, 0.0, RADIUS + height))
    scene.set_compliance("ball", "ground", **law)
    return scene


def table(mass: float = 2.0, foot: float = 0.03, **law: Any) -> cvi.Scene:
    """A free body of 0.4 x 0.3 x 0.1 m with a ball under each corner, their lowest points at z = 0, on the ground."""
    model, shapes = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "table")
    model.addBodyFrame("table", joint, pin.SE3.Identity(), 0)
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(mass, 0.4, 0.3, 0.1), pin.SE3.Identity())
    for k, (x, y) in enumerate(((-0.2, -0.15), (0.2, -0.15), (0.2, 0.15), (-0.2, 0.15))):
        place = pin.SE3(np.eye(3), np.array([x, y, -0.05]))
        frame = model.getFrameId("table", pin.FrameType.BODY)
        shapes.addGeometryObject(pin.GeometryObject(f"foot{k}", joint, frame, place, coal.Sphere(foot)))
    scene = cvi.Scene.from_pinocchio(model, shapes)
    scene.add_halfspace()
    if law:
        scene.set_compliance("table", "ground", **law)
    q = scene.neutral()
    q[2] = 0.05 + foot
    scene.q0 = q
    return scene
