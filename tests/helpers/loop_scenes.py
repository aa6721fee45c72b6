"""Scenes with loops, prescribed motions and servos, made in Python and small enough for closed-form answers."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import contactvi as cvi

BAR = 0.4  # [m] length of the bars


def arm(joints: int = 2, kind: type = pin.JointModelRY, **limits: float) -> pin.Model:
    """A chain of rods of length BAR along x with 1 kg each; joints j1, j2, ... and bodies of these names."""
    model, parent = pin.Model(), 0
    for k in range(joints):
        where = pin.SE3(np.eye(3), np.array([BAR if k else 0.0, 0.0, 0.0]))
        parent = model.addJoint(parent, kind(), where, f"j{k + 1}")
        rod = pin.Inertia(1.0, np.array([0.5 * BAR, 0.0, 0.0]), np.diag([1e-4, BAR**2 / 12.0, BAR**2 / 12.0]))
        model.appendBodyToJoint(parent, rod, pin.SE3.Identity())
    model.upperEffortLimit[:] = limits.get("effort", 0.0)
    model.lowerEffortLimit[:] = -limits.get("effort", 0.0)
    model.upperVelocityLimit[:] = limits.get("velocity", 0.0)
    model.upperDryFrictionLimit[:] = limits.get("friction", 0.0)
    return model


def arm_scene(joints: int = 2, gravity: bool = True, **limits: float) -> cvi.Scene:
    model = arm(joints, **limits)
    model.gravity.linear = np.array([0.0, 0.0, -9.81 if gravity else 0.0])
    return cvi.Scene.from_pinocchio(model, name="arm")


def wheel_scenes() -> tuple[cvi.Scene, cvi.Scene]:
    """A wheel of .04 kg m^2 on a continuous joint, q = (cos, sin), and the same on a revolute one."""
    scenes = []
    for kind in (pin.JointModelRUBZ(), pin.JointModelRZ()):
        model = pin.Model()
        wheel = model.addJoint(0, kind, pin.SE3.Identity(), "wheel")
        model.appendBodyToJoint(wheel, pin.Inertia.FromCylinder(2.0, 0.2, 0.05), pin.SE3.Identity())
        model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
        scenes.append(cvi.Scene.from_pinocchio(model))
    return scenes[0], scenes[1]


def four_bar(ground: float = 0.5, **options: float) -> cvi.Scene:
    """Three rods whose end is fixed to (ground, 0, 0): a four-bar linkage with one degree of freedom."""
    scene = arm_scene(3, **options)
    scene.add_point("world", "j3", (ground, 0.0, 0.0), (BAR, 0.0, 0.0), name="loop")
    return scene


def four_bar_start(scene: cvi.Scene) -> np.ndarray:
    """A configuration on the loop: the first rod at 60 degrees upwards."""
    q = scene.configuration({"j1": -np.pi / 3, "j2": 1.0, "j3": 1.0})
    return scene.assemble(q, fixed=["j1"])


URDF = """<robot name="arm"><link name="base"/>
{links}
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="4" velocity="1"/><dynamics friction="0.3" damping="0"/>{one}</joint>
<joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="4" velocity="1"/>{two}</joint></robot>"""
LINK = (
    '<link name="l{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    "</inertial></link>"
)


def urdf(one: str = "", two: str = "") -> str:
    return URDF.format(links=LINK.format(1) + LINK.format(2), one=one, two=two)
