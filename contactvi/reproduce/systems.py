"""The systems that the reproduction of the paper runs, built through the public API: no file is needed.

Problem B is the paper's double pendulum at a wall: two point masses of 1 kg on massless rods of 1 m, g = 9.81 m/s^2,
from rest at the absolute angles (0.3, 0.5) from the downward vertical; the tip may not cross the plane x = 0,
elastically.
"""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.options import ImpactMap
from contactvi.scene.scene import Scene
from contactvi.simulation.simulation import Simulator, simulate
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]

MAPS: tuple[ImpactMap, ...] = ("ctec", "dtec", "mhc")  # those that the paper compares
STEPS = (0.04, 0.02, 0.01, 0.005, 0.0025)  # [s]
GRAVITY = 9.81
START = np.array([0.3, 0.5])  # absolute angles [rad]
DURATION = 3.0  # [s]: two impacts
ABSOLUTE = np.array([[1.0, 0.0], [1.0, 1.0]])  # absolute = ABSOLUTE @ relative angles; the model's are relative
_RADIUS = 1.0 / 32.0  # of the ball at the tip [m], exact in binary; the wall is set back by it: the gap of a point


def problem_b(offset: float = 0.0, radius: float = _RADIUS) -> Scene:
    """Return problem B; its configuration is (angle 1, angle 2 relative to rod 1) [rad].

    Args:
        offset: x [m] of the wall that the point at the tip may not cross.
        radius: of the ball at the tip [m].
    """
    model = pin.Model()
    for k in range(2):
        placement = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0 if k else 0.0]))
        axis = np.array([0.0, -1.0, 0.0])
        joint = model.addJoint(k, pin.JointModelRevoluteUnaligned(axis), placement, f"joint_{k + 1}")
        mass = pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3)))
        model.appendBodyToJoint(joint, mass, pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    geometry = pin.GeometryModel()
    end = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0]))
    tip = geometry.addGeometryObject(pin.GeometryObject("tip", 2, end, coal.Sphere(radius)))
    halfspace = coal.Halfspace(np.array([1.0, 0.0, 0.0]), offset - radius)
    wall = geometry.addGeometryObject(pin.GeometryObject("wall", 0, pin.SE3.Identity(), halfspace))
    geometry.addCollisionPair(pin.CollisionPair(wall, tip))
    scene = Scene.from_pinocchio(model, geometry, name="double_pendulum")
    scene.set_contact(restitution=1.0)
    return scene


def run_b(
    impact: ImpactMap, dt: float, duration: float = DURATION, start: Array = START, record_every: int = 1
) -> Trajectory:
    """Run problem B from rest at the absolute angles `start`, shape (2,) [rad], with one impact map."""
    q0 = np.linalg.solve(ABSOLUTE, start)
    return simulate(
        problem_b(),
        q0,
        np.zeros(2),
        duration=duration,
        dt=dt,
        impact=impact,
        solver_tol=1e-13,
        record_every=record_every,
    )


def ball(height: float) -> Scene:
    """Return a ball of 1 kg at `height` [m] (its gap) over the ground; it bounces elastically."""
    scene = Scene((0.0, 0.0, -GRAVITY))
    scene.add_sphere("ball", radius=0.1, mass=1.0, placement=(0.0, 0.0, 0.1 + height))
    scene.add_halfspace(name="ground")
    scene.set_contact(restitution=1.0)
    return scene


def sliding_ball() -> Scene:
    """Return a ball of 2 kg on a vertical slide over the ground; its gap is the configuration [m]. It is elastic."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    geometry = pin.GeometryModel()
    ground = coal.Halfspace(np.array([0.0, 0.0, 1.0]), -_RADIUS)
    first = geometry.addGeometryObject(pin.GeometryObject("ground", 0, pin.SE3.Identity(), ground))
    second = geometry.addGeometryObject(pin.GeometryObject("ball", joint, pin.SE3.Identity(), coal.Sphere(_RADIUS)))
    geometry.addCollisionPair(pin.CollisionPair(first, second))
    scene = Scene.from_pinocchio(model, geometry, name="ball")
    scene.set_contact(restitution=1.0)
    return scene


def two_bodies() -> tuple[Scene, Array]:
    """Return two free bodies without gravity and velocities (12,) with which they collide off-centre, both spinning."""
    scene = Scene((0.0, 0.0, 0.0))
    scene.add_capsule("capsule", radius=0.1, length=0.5, mass=1.0, placement=(0.0, 0.0, 0.0))
    scene.add_sphere("ball", radius=0.15, mass=2.0, placement=(1.0, 0.05, 0.2))
    scene.set_contact(restitution=1.0)
    return scene, np.array([1.0, 0.0, 0.1, 0.3, 0.5, -0.2, -0.8, 0.1, 0.0, 0.4, -0.7, 0.2])


def body_at_wall() -> tuple[Scene, Array]:
    """Return a capsule thrown askew at a wall without gravity, and its velocity (6,)."""
    scene = Scene((0.0, 0.0, 0.0))
    scene.add_capsule("capsule", radius=0.1, length=0.5, mass=1.0, placement=(1.0, 0.0, 0.0))
    scene.add_halfspace(normal=(1.0, 0.0, 0.0), name="wall")
    scene.set_contact(restitution=1.0)
    return scene, np.array([-1.0, 0.7, 0.4, 0.3, 0.9, -0.2])


def stepper(scene: Scene, impact: ImpactMap, dt: float) -> Simulator:
    """Return a simulator with the tolerance of `run_b`."""
    return Simulator(scene, dt=dt, impact=impact, solver_tol=1e-13)
