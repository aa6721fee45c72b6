"""The Allegro hand, palm up, rolls a ball in its palm to a place that is wanted."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.gym.environment import Array, SceneEnv, rotation
from contactvi.inputs import vector
from contactvi.scene.scene import Scene

URDF = "example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf"
OPEN = 0.0, 0.3, 0.3, 0.3  # a finger: abduction and three flexions [rad]
THUMB = 0.5, 0.3, 0.3, 0.3
RATE, RATIO = 30.0 * np.pi, 0.7  # of the servos: 15 Hz, damping ratio
REACH = np.array([0.01, 0.15, 0.15] + [0.1] * 16)  # lift [m]; pitch, roll and fingers [rad]
RADIUS, WEIGHT, HEIGHT = 0.03, 0.981, 0.0411  # of the ball [m], [N]; its centre on the palm [m]
LOWEST, HIGHEST = np.array([-0.065, 0.0]), np.array([-0.035, 0.035])  # places in the palm, off thumb and fingers [m]
LOST = 0.02  # [m] that the ball may fall
NEAR = 0.015  # [m] off the wanted place at which the reward is 1 / e
_BALL, _BALL_SPEED = slice(19, 26), slice(19, 25)  # in q and in v


def hand_scene() -> tuple[Scene, Array, Array, Array]:
    """Return a new scene of hand and ball, its joints as they are held (19,), the load on them, and their stiffness.

    The load (19,) [N, N m] is that of the hand without the ball, the stiffness (19,) [N/m, N m/rad] that of the servos.
    """
    robot, wrist, joint = Scene(), pin.Model(), 0
    robot.add_urdf(URDF)
    for name, kind in (("lift", pin.JointModelPZ()), ("pitch", pin.JointModelRY()), ("roll", pin.JointModelRX())):
        joint = wrist.addJoint(joint, kind, pin.SE3.Identity(), name)
    frame = wrist.addFrame(pin.Frame("wrist", joint, pin.SE3.Identity(), pin.FrameType.BODY))
    up, none = pin.SE3(pin.rpy.rpyToMatrix(0.0, -np.pi / 2, np.pi), np.zeros(3)), pin.GeometryModel()
    model, shapes = pin.appendModel(wrist, robot.model, none, robot.collision_model, frame, up)
    pictures = pin.appendModel(wrist, robot.model, none, robot.visual_model, frame, up)[1]
    scene = Scene.from_pinocchio(model, shapes, pictures, name="hand")
    scene.disable_pair("hand", "hand")
    angles = {f"joint_{k}.0": angle for k, angle in enumerate(3 * OPEN + THUMB)}
    q = scene.configuration(angles)
    inertia = np.diag(pin.crba(model, model.createData(), q))
    stiffness = inertia * RATE**2
    for name, own in zip(model.names[1:], inertia, strict=True):
        scene.set_joint(name, damping=0.0, limits=name.startswith("joint"))
        scene.set_servo(name, own * RATE**2, 2.0 * RATIO * own * RATE, effort=float("inf"))
    scene.add_sphere("ball", radius=RADIUS, mass=WEIGHT / 9.81)
    scene.set_contact(restitution=0.0, friction=0.8)
    load = np.array(pin.computeGeneralizedGravity(model, model.createData(), q))
    return scene, q[:19], load, stiffness


def load_with_ball(load: Array, place: Sequence[float] | Array) -> Array:
    """Return the load (19,) [N, N m] of the hand with the ball at a place (2,) [m] in its palm."""
    return np.concatenate([load[:3] + WEIGHT * np.array([1.0, -place[0], place[1]]), load[3:]])


@lru_cache(maxsize=1)
def _scene() -> tuple[Scene, Array, Array, Array]:
    """Return the scene that all environments share."""
    return hand_scene()


class HandBallEnv(SceneEnv):
    """The Allegro hand on a wrist that lifts, pitches and rolls has a ball in its open palm, to be rolled to a place.

    Action (19,): targets of lift (by 1 cm), pitch, roll (by 0.15 rad) and the 16 finger joints (by 0.1 rad), from those
    that hold the hand and the weight of the ball where it starts.

    Observation (65,): joints (19) and their rates (19), the ball's centre [m] and velocity [m/s] in the world, what is
    missing to the wanted place in x and y [m], the last action (19).

    Reward: exp(-(d / 15 mm)^2), d the distance of the ball from the wanted place in the plane, less 0.05 times the mean
    square of the action. The episode ends when the ball has fallen by 2 cm, and is truncated after `duration` seconds.

    Options of reset: "place" and "wanted", (2,) [m] in the palm; drawn where they are not given.
    """

    def __init__(self, *, duration: float = 4.0, record: bool = False, render_mode: str | None = None) -> None:
        scene, held, self._load, self._stiffness = _scene()
        self._held, self.wanted = held, np.zeros(2)
        super().__init__(scene, held, REACH, 65, duration=duration, record=record, render_mode=render_mode)

    def start(self, options: dict[str, Any]) -> tuple[Array, Array]:
        """Put the ball to one place and want it at another."""
        drawn = self.np_random.uniform(LOWEST, HIGHEST, (2, 2))
        place = vector("place", options.get("place", drawn[0]), 2)
        self.wanted = vector("wanted", options.get("wanted", drawn[1]), 2)
        self.nominal = self._held + load_with_ball(self._load, place) / self._stiffness
        return np.concatenate([self._held, place, [HEIGHT, 0.0, 0.0, 0.0, 1.0]]), np.zeros(25)

    def observe(self, q: Array, v: Array) -> Array:
        """See the class."""
        ball, missing = q[_BALL], self.wanted - q[19:21]
        speed = rotation(ball[3:]) @ v[_BALL_SPEED][:3]
        return np.concatenate([q[:19], v[:19], ball[:3], speed, missing, self.action])

    def judge(self, q: Array, v: Array) -> tuple[float, bool]:
        """See the class."""
        x, y = q[19:21] - self.wanted
        cost = 0.05 * float(np.mean(self.action**2))
        return float(np.exp(-(x * x + y * y) / NEAR**2)) - cost, bool(q[21] < HEIGHT - LOST)
