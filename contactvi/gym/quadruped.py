"""The quadruped Solo 12 stands on the ground and takes pushes."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from contactvi.gym.environment import DT, FRAME, Array, SceneEnv, rotation
from contactvi.inputs import real
from contactvi.scene.scene import Scene

ROBOT = "example-robot-data://robots/solo_description"
STANCE = "straight_standing"  # a state of the SRDF
KP, KD, EFFORT = 6.0, 0.15, 2.7  # [N m/rad], [N m s/rad], [N m]: the torque of its motors
FOOT = 0.016  # radius [m]
REACH = 0.8  # of the targets [rad]
SPREAD = 0.05  # of the joints at the start [rad]
CLEARANCE = 1e-3  # of the lowest foot at the start [m]
PUSH_FRAMES = 5  # that a push lasts: 0.1 s
PAUSE = 0.5, 1.5  # between two pushes [s]
FALLEN, LOW = 0.5, 0.1  # cosine of the tilt, height of the base [m], at which an episode ends


@lru_cache(maxsize=1)
def _scene() -> tuple[Scene, Array, Array]:
    """Return the scene, the stance q (19,), and the numbers of the pairs with the ground."""
    robot = Scene()
    robot.add_urdf(f"{ROBOT}/robots/solo12.urdf", base="free", srdf=f"{ROBOT}/srdf/solo.srdf")
    shapes = pin.GeometryModel()
    for shape in robot.collision_model.geometryObjects:
        if shape.name.endswith("_FOOT_0"):  # the file's is a mesh of this ball, on whose facets the feet would rattle
            shape = pin.GeometryObject(
                shape.name, shape.parentJoint, shape.parentFrame, shape.placement, coal.Sphere(FOOT)
            )
        shapes.addGeometryObject(shape)
    scene = Scene.from_pinocchio(robot.model, shapes, robot.visual_model, name="solo12")
    scene.disable_pair("solo12", "solo12")
    for name in list(robot.model.names)[2:]:
        scene.set_servo(name, KP, KD, effort=EFFORT)
    scene.add_halfspace()
    scene.set_contact(restitution=0.0, friction=0.8)
    grounded = [k for k, pair in enumerate(scene.pair_names) if "ground" in pair]
    return scene, robot.configuration({}, STANCE), np.array(grounded, dtype=np.int64)


class QuadrupedStandEnv(SceneEnv):
    """Solo 12 (2.5 kg, 12 joints with servos) has to stay upright at its height while it is pushed.

    Every 0.5 to 1.5 s a horizontal force of random direction acts on the base for 0.1 s; its impulse is at most `push`.

    Action (12,): targets of the joints, by 0.8 rad from those of the stance.

    Observation (46,): height of the base [m], the upward direction in its axes (3), its velocity (6) there [m/s,
    rad/s], joints off the stance (12) and their rates (12), the last action (12).

    Reward: the mean of the cosine of the tilt and exp(-(dz / 5 cm)^2), dz the height off that of the stance, less 0.05
    times the mean square of the action. The episode ends at a tilt of 60 degrees or a height of 10 cm, and is truncated
    after `duration` seconds.

    Args:
        push: largest impulse of a push [N s].
    """

    def __init__(
        self, *, push: float = 3.5, duration: float = 5.0, record: bool = False, render_mode: str | None = None
    ) -> None:
        scene, self._stance, self._grounded = _scene()
        self._push = real("push", push, 0.0)
        self._next, self._force = 0, np.zeros(2)
        super().__init__(
            scene, self._stance[7:], np.full(12, REACH), 46, duration=duration, record=record, render_mode=render_mode
        )

    def start(self, options: dict[str, Any]) -> tuple[Array, Array]:
        """Bend the joints a little and put the feet just above the ground."""
        q = self._stance.copy()
        q[7:] += self.np_random.uniform(-SPREAD, SPREAD, 12)
        gaps = self.simulator.scene.core().gaps_along(q[None], self._grounded)
        q[2] += CLEARANCE - float(gaps.min())
        self._plan(0)
        return q, np.zeros(18)

    def _plan(self, now: int) -> None:
        """Draw the next push."""
        self._next = now + round(self.np_random.uniform(*PAUSE) / (DT * FRAME))
        angle, impulse = self.np_random.uniform(-np.pi, np.pi), self.np_random.uniform(0.0, self._push)
        self._force = impulse / (PUSH_FRAMES * FRAME * DT) * np.array([np.cos(angle), np.sin(angle)])

    def push(self) -> Array | None:
        """Return the force of the push that goes on, in the axes of the base."""
        if self.count >= self._next + PUSH_FRAMES:
            self._plan(self.count)
        if self.count < self._next:
            return None
        force = np.zeros(18)
        force[:3] = rotation(self.simulator.q[3:7]).T @ np.append(self._force, 0.0)
        return force

    def observe(self, q: Array, v: Array) -> Array:
        """See the class."""
        up = rotation(q[3:7])[2]
        return np.concatenate([q[2:3], up, v[:6], q[7:] - self._stance[7:], v[6:], self.action])

    def judge(self, q: Array, v: Array) -> tuple[float, bool]:
        """See the class."""
        upright, off = float(rotation(q[3:7])[2, 2]), float(q[2] - self._stance[2])
        reward = 0.5 * (upright + float(np.exp(-((off / 0.05) ** 2)))) - 0.05 * float(np.mean(self.action**2))
        return reward, bool(upright < FALLEN or q[2] < LOW)
