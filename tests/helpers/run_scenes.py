"""Small scenes for the tests of runs, files, pictures and the command line, made with the public Python API only."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

import contactvi as cvi

GRAVITY = 9.81
RADIUS = 0.1  # of the ball [m]
HEIGHT = 1.0  # of its lowest point at the start [m]
FIRST_IMPACT = math.sqrt(2 * HEIGHT / GRAVITY)  # [s]

BALL_TOML = """
[scene]
title = "ball"
[[sphere]]
name = "ball"
radius = 0.1
mass = 0.5
xyz = [0.0, 0.0, 1.1]
[[halfspace]]
[contact]
restitution = {restitution}
[run]
dt = 0.01
duration = {duration}
"""

HAND_URDF = "example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf"


def ball_scene(restitution: float = 1.0) -> cvi.Scene:
    """A ball one metre above the ground."""
    scene = cvi.Scene()
    scene.add_sphere("ball", radius=RADIUS, mass=0.5, placement=(0.0, 0.0, RADIUS + HEIGHT))
    scene.add_halfspace()
    scene.set_contact(restitution=restitution)
    return scene


def hand_scene() -> tuple[cvi.Scene, np.ndarray]:
    """The Allegro hand, palm up, half closed by springs, a ball above it; the scene and a start."""
    scene = cvi.Scene()
    scene.add_urdf(HAND_URDF, placement=((0.0, 0.0, 0.1), (0.0, -math.pi / 2, 0.0)))
    scene.add_sphere("ball", radius=0.03, mass=0.1, placement=(0.02, 0.0, 0.35))
    scene.add_halfspace()
    scene.set_contact(restitution=0.7)
    pose = {"joint_*": 0.6, "joint_0.0": 0.0, "joint_4.0": 0.0, "joint_8.0": 0.0, "joint_12.0": 1.0}
    for name, angle in pose.items():
        scene.set_joint(name, stiffness=1.0, rest=angle, damping=0.01)
    return scene, scene.configuration(pose)


def slider_scene(restitution: float = 0.5) -> cvi.Scene:
    """A mass on a vertical prismatic joint with limits 0.2 below and 1 above the start, no contact."""
    import pinocchio as pin

    model = pin.Model()
    inf = np.full(1, np.inf)
    low, high = np.array([-0.2]), np.array([1.0])
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slider", inf, inf, low, high)
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(2.0, 0.1), pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model)
    scene.set_joint("slider", limits=True, restitution=restitution)
    return scene


def ball_file(folder: Path, restitution: float = 1.0, duration: float = 1.0) -> Path:
    """Scene file of `ball_scene` in `folder`."""
    path = folder / "ball.toml"
    path.write_text(BALL_TOML.format(restitution=restitution, duration=duration))
    return path


def funnel() -> cvi.Scene:
    """Balls of unlike mass that fall into a funnel of three walls, nearly one above the other: impacts accumulate."""
    radius, lean = 0.04, 0.6
    scene = cvi.Scene()
    for k in range(3):
        angle = 2.0 * math.pi * k / 3.0 + 0.1
        normal = (-math.cos(lean) * math.cos(angle), -math.cos(lean) * math.sin(angle), math.sin(lean))
        scene.add_halfspace(normal, name=f"wall{k}")
    lowest = radius / math.sin(lean) * 1.2 + 0.01
    for k, mass in enumerate((1.0, 5.0, 0.2, 1.0, 5.0)):
        aside = 0.004 * math.cos(2.0 * k), 0.004 * math.sin(3.0 * k)
        place = (*aside, lowest + 2.05 * radius * k)
        scene.add_sphere(f"ball{k}", radius=radius, mass=mass, placement=place)
    scene.set_contact(restitution=0.3, friction=0.5)
    return scene


def heap_of_boxes() -> cvi.Trajectory:
    """Thirty boxes beside and behind each other: their names would cover each other."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(30):
        x, y = 0.06 * (k % 6), 0.06 * (k // 6)
        scene.add_box(f"box_number_{k}", (0.05, 0.05, 0.05), mass=1.0, placement=(x, y, 0.025))
    scene.set_contact(restitution=0.0, friction=0.5)
    return cvi.simulate(scene, duration=0.02, dt=1e-2)
