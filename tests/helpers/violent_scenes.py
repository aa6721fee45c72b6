"""Violent scenes: stiff springs on light fingers, rings that fall, boxes on strings, driven walls.

Each is (scene, q0, v0, options of the run).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import coal
import numpy as np
import pinocchio as pin

import contactvi as cvi
from helpers.contact_models import geometry, halfspace, place
from helpers.run_scenes import HAND_URDF

Case = tuple[cvi.Scene, Any, Any, dict[str, Any]]


def stiff_hand(damped: bool, one: str, two: str, damper: float) -> Case:
    """A spring of 1e5 N/m between links of a few grams, which pulls joints into their limits."""
    scene = cvi.Scene()
    scene.add_urdf(HAND_URDF)
    if not damped:
        scene.set_joint("joint_*", damping=0.0)
    scene.add_spring(one, two, 1e5, rest_length=0.02, damping=damper)
    return scene, None, None, {"duration": 0.2, "dt": 1e-3}


def ring(restitution: float, friction: float, links: int = 10, twice: bool = False) -> tuple[cvi.Scene, np.ndarray]:
    """A chain of `links` on hinges, closed to a ring, half a metre above the ground."""
    length, model = 0.1, pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    rod = pin.Inertia(0.1, np.array([0.5 * length, 0.0, 0.0]), np.diag([1e-5, 1e-4, 1e-4]))
    shapes: dict[str, tuple] = {"ground": (0, place(), halfspace(0.0, 0.0, 1.0, 0.0))}
    joint = 0
    for k in range(links):
        kind = pin.JointModelRY() if k else pin.JointModelFreeFlyer()
        joint = model.addJoint(joint, kind, place(length if k else 0.0), f"link{k}")
        model.appendBodyToJoint(joint, rod, pin.SE3.Identity())
        shapes[f"ball{k}"] = (joint, place(0.5 * length), coal.Sphere(0.03))
    scene = cvi.Scene.from_pinocchio(model, geometry(shapes, [("ground", n) for n in shapes if n != "ground"]))
    scene.set_contact(restitution=restitution, friction=friction)
    for _ in range(1 + twice):
        scene.add_point("link0", f"link{links - 1}", (0.0, 0.0, 0.0), (length, 0.0, 0.0))
    q = pin.neutral(model)
    q[2], q[7:] = 0.5, 2.0 * np.pi / links
    return scene, scene.assemble(q)


def falling_ring(restitution: float, friction: float) -> Case:
    scene, q = ring(restitution, friction)
    return scene, q, None, {"duration": 0.5, "dt": 1e-3}


def wedged_rod(angle: float) -> Case:
    """A rod on a pin that falls onto the ground, `angle` off the vertical: inside the friction cone it can wedge."""
    scene, length, radius, tilt = cvi.Scene(), 0.4, 0.03, angle + 0.02
    scene.add_halfspace()
    scene.add_capsule("rod", radius=radius, length=length, mass=1.0)
    scene.set_contact(restitution=0.0, friction=0.8)
    height = length * math.cos(angle) + radius
    q = scene.neutral()
    q[:3] = 0.5 * length * math.sin(tilt), 0.0, height - 0.5 * length * math.cos(tilt)
    q[3:] = 0.0, -math.sin(0.5 * tilt), 0.0, math.cos(0.5 * tilt)
    scene.add_point("world", "rod", (0.0, 0.0, height), (0.0, 0.0, 0.5 * length), name="pin")
    return scene, q, None, {"duration": 0.6, "dt": 2e-3}


def hinged_rod(angle: float) -> Case:
    """A rod on a hinge, without a constraint, that falls onto the ground: the contact stops its one coordinate."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.0, 0.0, -0.2]), 0.01 * np.eye(3)), pin.SE3.Identity())
    ground = halfspace(0.0, 0.0, 1.0, -0.4 * math.cos(angle) - 0.03)
    shapes = {"ground": (0, place(), ground), "tip": (1, place(z=-0.4), coal.Sphere(0.03))}
    scene = cvi.Scene.from_pinocchio(model, geometry(shapes, [("ground", "tip")]))
    scene.set_contact(restitution=0.0, friction=0.8)
    return scene, [-angle - 0.05], None, {"duration": 0.6, "dt": 1e-3}


def box_on_strings(restitution: float, friction: float) -> Case:
    """A box that falls into ropes and onto the ground, and is pulled by five of them."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.2, 0.2, 0.1), mass=1.0, placement=((0.0, 0.0, 0.3), (0.1, 0.05, 0.0)))
    scene.set_contact(restitution=restitution, friction=friction)
    corners = itertools.product((0.1, -0.1), (0.1, -0.1))
    for x, y in [*corners, (0.0, 0.0)]:
        scene.add_spring(
            "world", "box", 1e4, damping=10.0, point_a=(3 * x, 3 * y, 1.0), point_b=(x, y, 0.05),
            rest_length=0.99, tension_only=True,
        )  # fmt: skip
    return scene, None, None, {"duration": 1.0, "dt": 1e-3}


def winches(restitution: float, friction: float) -> Case:
    """A box on three strings that let it down onto the ground and lift it again."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.2, 0.2, 0.1), mass=1.0, placement=(0.0, 0.0, 0.3))
    scene.set_contact(restitution=restitution, friction=friction)
    for k in range(3):
        x, y = 0.1 * math.cos(2.0 * k), 0.1 * math.sin(2.0 * k)
        scene.add_spring(
            "world", "box", 2e3, damping=20.0, point_a=(2 * x, 2 * y, 1.0), point_b=(x, y, 0.05), tension_only=True
        )
    length = 0.75
    scene.add_distance(
        "world", "box", (0.0, 0.0, 1.1), (0.0, 0.0, 0.05),
        lambda t: (length + 0.15 * math.sin(4 * t), 0.6 * math.cos(4 * t), -2.4 * math.sin(4 * t)),
    )  # fmt: skip
    return scene, None, scene.consistent_velocity(), {"duration": 0.3, "dt": 1e-3}


def driven_wall(restitution: float, friction: float) -> Case:
    """A swinging wall that pushes a ball and a box on the ground against each other and a far end."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    wall = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "wall")
    model.appendBodyToJoint(wall, pin.Inertia.FromBox(1.0, 0.1, 1.0, 1.0), pin.SE3.Identity())
    for name in ("ball", "box"):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(0.5, 0.1, 0.1, 0.1), pin.SE3.Identity())
    shapes = {
        "ground": (0, place(), halfspace(0.0, 0.0, 1.0, 0.0)), "end": (0, place(), halfspace(-1.0, 0.0, 0.0, -1.5)),
        "face": (1, place(), coal.Box(0.1, 2.0, 2.0)), "round": (2, place(), coal.Sphere(0.05)),
        "cube": (3, place(), coal.Box(0.1, 0.1, 0.1)),
    }  # fmt: skip
    pairs = [("ground", "round"), ("ground", "cube"), ("face", "round"), ("face", "cube"), ("round", "cube")]
    scene = cvi.Scene.from_pinocchio(model, geometry(shapes, [*pairs, ("end", "round"), ("end", "cube")]))
    scene.set_contact(restitution=restitution, friction=friction)
    scene.prescribe("wall", lambda t: (0.5 * math.sin(3 * t), 1.5 * math.cos(3 * t), -4.5 * math.sin(3 * t)))
    q = pin.neutral(model)
    q[1:4], q[8:11] = (0.3, 0.01, 0.05), (0.7, 0.0, 0.05)
    return scene, q, scene.consistent_velocity(q), {"duration": 2.0, "dt": 1e-3}


TIPS = {
    "tips": ("link_3.0_tip", "link_15.0_tip"),
    "fingers": ("link_3.0", "link_7.0"),
    "fixed": ("link_3.0_tip", "world"),
}
COEFFICIENTS = list(itertools.product((0.0, 0.3, 1.0), (0.0, 0.8)))
VIOLENT: dict[str, Callable[[], Case]] = {
    f"hand {name}{' damped' * damped} {damper:g}": lambda d=damped, e=ends, c=damper: stiff_hand(d, *e, c)
    for damped in (True, False)
    for name, ends in TIPS.items()
    for damper in (0.0, 10.0, 1e3)
} | {
    f"{make.__name__} e={e:g} mu={mu:g}": lambda make=make, e=e, mu=mu: make(e, mu)
    for make in (falling_ring, box_on_strings, winches, driven_wall)
    for e, mu in COEFFICIENTS
}
