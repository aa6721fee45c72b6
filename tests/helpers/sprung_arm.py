"""An arm whose parameters are what derivatives are taken with respect to."""

from __future__ import annotations

from collections.abc import Callable

import coal
import numpy as np
import pinocchio as pin

import contactvi as cvi

SPRUNG_ARM = (1.2, 3.0, 0.05, 4.0, 0.2, -9.81, 0.01, 0.0)
ROD = 0.3  # [m], that joins a linked arm with its pendulum
# What of the sensitivity belongs to these numbers, and which of its columns.
NAMES = (
    "mass:turn", "stiffness:turn", "damping:turn", "kp:slide", "kd:slide", "gravity", "armature:turn", "inertia:turn",
)  # fmt: skip
COLUMNS = (0, 0, 0, 0, 0, 2, 0, 7)


def sprung_arm(restitution: float, friction: float = 0.3, linked: bool = False) -> Callable[[np.ndarray], cvi.Scene]:
    """Return the scene of given parameters: an arm on a hinge on a slide, whose round tip may touch the ground.

    linked: a rod joins it with a pendulum, the third joint.
    """

    def scene_of(x: np.ndarray) -> cvi.Scene:
        mass, stiffness, damping, kp, kd, gravity, armature, inertia = x
        model = pin.Model()
        slide = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slide")
        turn = model.addJoint(slide, pin.JointModelRY(), pin.SE3.Identity(), "turn")
        model.appendBodyToJoint(slide, pin.Inertia(0.7, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
        own = pin.Inertia(mass, np.array([0.1, 0.0, 0.05]), np.diag([0.02, 0.03 + inertia, 0.025]))
        model.appendBodyToJoint(turn, own, pin.SE3.Identity())
        model.addFrame(pin.Frame("arm", turn, 0, pin.SE3.Identity(), pin.FrameType.BODY))
        if linked:
            hinge = pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.35]))
            hang = model.addJoint(0, pin.JointModelRY(), hinge, "hang")
            weight = pin.Inertia(0.8, np.array([0.0, 0.0, -0.3]), 0.02 * np.eye(3))
            model.appendBodyToJoint(hang, weight, pin.SE3.Identity())
            model.addFrame(pin.Frame("pendulum", hang, 0, pin.SE3.Identity(), pin.FrameType.BODY))
        model.gravity.linear = np.array([0.0, 0.0, gravity])
        geometry = pin.GeometryModel()
        place = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0]))
        geometry.addGeometryObject(pin.GeometryObject("tip", turn, place, coal.Sphere(0.05)))
        scene = cvi.Scene.from_pinocchio(model, geometry, name="arm")
        scene.add_halfspace()
        if linked:
            scene.add_distance("arm", "pendulum", (0.2, 0.0, 0.05), (0.0, 0.0, -0.25), length=ROD)
        scene.set_contact(restitution=restitution, friction=friction)
        scene.set_joint("turn", stiffness=stiffness, rest=0.2, damping=damping, armature=armature)
        scene.set_servo("slide", kp=kp, kd=kd)
        return scene

    return scene_of
