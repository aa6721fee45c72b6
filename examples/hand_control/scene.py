"""The Allegro hand, palm up on a wrist that lifts, pitches and rolls, with servos in all 19 joints, and a ball."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import contactvi as cvi

URDF = "example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf"
OPEN = 0.0, 0.3, 0.3, 0.3  # a finger: abduction and three flexions [rad]
WEIGHT = 0.981  # of the ball [N]


def hand(place: tuple[float, float]) -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
    """Return the scene, its start with the ball in the palm at `place` [m], and the targets (19,) that hold it."""
    robot, wrist, joint = cvi.Scene(), pin.Model(), 0
    robot.add_urdf(URDF)
    for name, kind in (("lift", pin.JointModelPZ()), ("pitch", pin.JointModelRY()), ("roll", pin.JointModelRX())):
        joint = wrist.addJoint(joint, kind, pin.SE3.Identity(), name)
    frame = wrist.addFrame(pin.Frame("wrist", joint, pin.SE3.Identity(), pin.FrameType.BODY))
    up, none = pin.SE3(pin.rpy.rpyToMatrix(0.0, -np.pi / 2, np.pi), np.zeros(3)), pin.GeometryModel()
    model, shapes = pin.appendModel(wrist, robot.model, none, robot.collision_model, frame, up)
    pictures = pin.appendModel(wrist, robot.model, none, robot.visual_model, frame, up)[1]
    scene = cvi.Scene.from_pinocchio(model, shapes, pictures, name="hand")
    scene.disable_pair("hand", "hand")  # the ball's contacts alone
    q = scene.configuration({f"joint_{k}.0": x for k, x in enumerate(3 * OPEN + (0.5, 0.3, 0.3, 0.3))})
    inertia, rate = np.diag(pin.crba(model, model.createData(), q)), 30.0 * np.pi  # 15 Hz, damping ratio 0.7
    for name, own in zip(model.names[1:], inertia, strict=True):
        scene.set_joint(name, damping=0.0, limits=name.startswith("joint"))
        scene.set_servo(name, own * rate**2, 1.4 * own * rate, effort=float("inf"))
    scene.add_sphere("ball", radius=0.03, mass=WEIGHT / 9.81)
    scene.set_contact(restitution=0.0, friction=0.8)
    load = pin.computeGeneralizedGravity(model, model.createData(), q)
    load[:3] += WEIGHT * np.array([1.0, -place[0], place[1]])
    return scene, np.r_[q[:19], place, 0.0411, 0.0, 0.0, 0.0, 1.0], q[:19] + load / (inertia * rate**2)
