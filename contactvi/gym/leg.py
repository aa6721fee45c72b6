"""A leg in a plane stands on its foot: the smallest task of balance, learnt in minutes."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from contactvi.gym.environment import DT, FRAME, Array, SceneEnv
from contactvi.inputs import real
from contactvi.scene.scene import Scene

LENGTHS = 0.4, 0.4, 0.5  # of shank, thigh and trunk [m]
MASSES = 3.0, 5.0, 12.0  # [kg]
FOOT, ANKLE, THICK = 1.2, 0.08, 0.05  # mass [kg], height of the ankle [m], radius of the links [m]
HEEL, TOE, SOLE = -0.07, 0.16, 0.02  # of the two balls of the sole in front of the ankle, and their radius [m]
KP, KD = np.array([90.0, 120.0, 120.0]), np.array([6.0, 8.0, 8.0])  # [N m/rad], [N m s/rad]: ankle, knee, hip
EFFORT = 120.0  # [N m]
STANCE = np.array([0.25, -0.5, 0.25])  # ankle, knee and hip [rad]: knees bent, trunk upright
REACH = 0.6  # of the targets [rad]
SPREAD = 0.03  # of the joints at the start [rad]
PUSH_FRAMES, PAUSE = 5, (0.5, 1.5)  # frames that a push lasts, time between two pushes [s]
LEAN, LOW = 0.8, 0.6  # angle of the trunk [rad], height of the hip over that of the stance, at which an episode ends
_JOINTS = "ankle", "knee", "hip"


def _leg_model() -> tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]:
    """Return model, shapes that touch and shapes that are seen of foot, shank, thigh and trunk in the x-z plane."""
    model, shapes, pictures, joint = pin.Model(), pin.GeometryModel(), pin.GeometryModel(), 0
    none = pin.SE3.Identity()
    for name, kind in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("pitch", pin.JointModelRY())):
        joint = model.addJoint(joint, kind, none, name)
    middle = np.array([0.5 * (HEEL + TOE), 0.0, SOLE - ANKLE])
    foot = pin.Inertia.FromBox(FOOT, TOE - HEEL, 0.1, 2.0 * SOLE)
    model.appendBodyToJoint(joint, foot, pin.SE3(np.eye(3), middle))
    for name, x in (("heel", HEEL), ("toe", TOE)):
        place = pin.SE3(np.eye(3), np.array([x, 0.0, SOLE - ANKLE]))
        shapes.addGeometryObject(pin.GeometryObject(name, joint, place, coal.Sphere(SOLE)))
    _draw(pictures, "sole", joint, np.array([HEEL, 0.0, SOLE - ANKLE]), np.array([TOE, 0.0, SOLE - ANKLE]), SOLE)
    _draw(pictures, "instep", joint, np.zeros(3), middle, SOLE)
    place = none
    for name, link, length, mass in zip(_JOINTS, ("shank", "thigh", "trunk"), LENGTHS, MASSES, strict=True):
        joint = model.addJoint(joint, pin.JointModelRY(), place, name)
        end = np.array([0.0, 0.0, length])
        body = pin.Inertia.FromCylinder(mass, THICK, length)
        model.appendBodyToJoint(joint, body, pin.SE3(np.eye(3), 0.5 * end))
        _draw(pictures, link, joint, np.zeros(3), end, THICK)
        place = pin.SE3(np.eye(3), end)
    return model, shapes, pictures


def _draw(pictures: pin.GeometryModel, name: str, joint: int, start: Array, end: Array, radius: float) -> None:
    """Draw a capsule between two points of a joint's frame."""
    way = end - start
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), way).matrix()
    shape = coal.Capsule(radius, float(np.linalg.norm(way)))
    pictures.addGeometryObject(pin.GeometryObject(name, joint, pin.SE3(turn, 0.5 * (start + end)), shape))


@lru_cache(maxsize=1)
def _scene() -> Scene:
    """Return the scene that all environments share."""
    scene = Scene.from_pinocchio(*_leg_model(), name="leg")
    scene.disable_pair("leg", "leg")
    for name, kp, kd in zip(_JOINTS, KP, KD, strict=True):
        scene.set_servo(name, kp, kd, effort=EFFORT)
    scene.add_halfspace()
    scene.set_contact(restitution=0.0, friction=0.8)
    return scene


class LegStandEnv(SceneEnv):
    """A leg of foot, shank, thigh and trunk (21 kg) in a plane has to stay on its foot while it is pushed.

    The servo of its ankle is softer than its weight at its height: with targets that stay it falls. Every
    0.5 to 1.5 s a horizontal force acts on the middle of the trunk for 0.1 s; its impulse is at most `push`, to either
    side.

    Action (3,): targets of ankle, knee and hip, by 0.6 rad from those of the stance.

    Observation (16,): height of the hip [m], angles of foot and trunk [rad], the centre of mass in front of the ankle
    and over it [m] (2) and its velocity [m/s] (2), joints off the stance (3) and their rates (3), rate of the foot's
    angle [rad/s], mean of heel and toe off the ground [m], velocity of the ankle along x [m/s].

    Reward: the mean of the cosine of the trunk's angle and exp(-(dz / 10 cm)^2), dz the height of the hip off that of
    the stance, less 0.05 times the mean square of the action. The episode ends where the trunk leans by 0.8 rad or the
    hip is below 0.6 of its height, and is truncated after `duration` seconds.

    Args:
        push: largest impulse of a push [N s].
    """

    def __init__(
        self, *, push: float = 4.0, duration: float = 4.0, record: bool = False, render_mode: str | None = None
    ) -> None:
        self._push = real("push", push, 0.0)
        self._next, self._force = 0, 0.0
        super().__init__(
            _scene(), STANCE, np.full(3, REACH), 16, duration=duration, record=record, render_mode=render_mode
        )
        self._height = float(_places(_standing())[2, 1])

    def start(self, options: dict[str, Any]) -> tuple[Array, Array]:
        """Bend the joints a little and put the foot flat just above the ground."""
        q = _standing()
        q[3:] += self.np_random.uniform(-SPREAD, SPREAD, 3)
        self._plan(0)
        return q, np.zeros(6)

    def _plan(self, now: int) -> None:
        """Draw the next push."""
        self._next = now + round(self.np_random.uniform(*PAUSE) / (DT * FRAME))
        self._force = self.np_random.uniform(-self._push, self._push) / (PUSH_FRAMES * FRAME * DT)

    def push(self) -> Array | None:
        """Return the force of the push that goes on: what a horizontal force at the middle of the trunk is in q."""
        if self.count >= self._next + PUSH_FRAMES:
            self._plan(self.count)
        if self.count < self._next:
            return None
        ankle, knee, hip, top = _places(self.simulator.q)[:, 1]
        height = 0.5 * (hip + top)
        return self._force * np.array([1.0, 0.0, height - ankle, height - ankle, height - knee, height - hip])

    def observe(self, q: Array, v: Array) -> Array:
        """See the class."""
        places, rates = _places(q), _velocities(q, v)
        center, speed = _mean(q, places), _mean_velocity(q, v, rates)
        trunk = float(q[2:].sum())
        sole = ANKLE * (1.0 - np.cos(q[2])) + q[1] - ANKLE - 0.5 * (HEEL + TOE) * np.sin(q[2])
        state = [places[2, 1], q[2], trunk, *(center - places[0]), *speed]
        return np.concatenate([state, q[3:] - STANCE, v[3:], [v[2], sole, v[0]]])

    def judge(self, q: Array, v: Array) -> tuple[float, bool]:
        """See the class."""
        lean, height = float(q[2:].sum()), float(_places(q)[2, 1])
        off = height - self._height
        reward = 0.5 * (np.cos(lean) + np.exp(-((off / 0.1) ** 2))) - 0.05 * float(np.mean(self.action**2))
        return float(reward), bool(abs(lean) > LEAN or height < LOW * self._height)


def _standing() -> Array:
    """Return the stance with the foot just above the ground, q (6,)."""
    return np.array([0.0, ANKLE + 1e-4, 0.0, *STANCE])


def _ways(q: Array) -> Array:
    """Return the unit vectors along shank, thigh and trunk in x and z, shape (3, 2)."""
    angles = np.cumsum(q[2:])[1:]
    return np.column_stack([np.sin(angles), np.cos(angles)])


def _places(q: Array) -> Array:
    """Return ankle, knee, hip and the upper end of the trunk in x and z [m], shape (4, 2)."""
    steps = np.array(LENGTHS)[:, None] * _ways(q)
    return np.asarray(q[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]))


def _velocities(q: Array, v: Array) -> Array:
    """Return the velocities of the four places [m/s], shape (4, 2)."""
    rates = np.cumsum(v[2:])[1:]
    steps = (np.array(LENGTHS) * rates)[:, None] * _ways(q) @ np.array([[0.0, -1.0], [1.0, 0.0]])
    return np.asarray(v[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]))


def _mean(q: Array, places: Array) -> Array:
    """Return the centre of mass in x and z [m]."""
    foot = places[0] + _sole_middle(q)
    links = 0.5 * (places[:-1] + places[1:])
    return np.asarray((FOOT * foot + np.array(MASSES) @ links) / (FOOT + sum(MASSES)))


def _mean_velocity(q: Array, v: Array, rates: Array) -> Array:
    """Return the velocity of the centre of mass [m/s]."""
    x, z = _sole_middle(q)
    foot = rates[0] + v[2] * np.array([z, -x])
    links = 0.5 * (rates[:-1] + rates[1:])
    return np.asarray((FOOT * foot + np.array(MASSES) @ links) / (FOOT + sum(MASSES)))


def _sole_middle(q: Array) -> Array:
    """Return the foot's centre of mass off the ankle, in x and z [m]."""
    x, z, c, s = 0.5 * (HEEL + TOE), SOLE - ANKLE, np.cos(q[2]), np.sin(q[2])
    return np.array([c * x + s * z, c * z - s * x])
