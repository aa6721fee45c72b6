"""The forced and constrained systems of `contactvi verify`, built through the public API: no file is needed.

Planar ones lie in the x-z plane, angles count from x (pendulums: from straight down) towards z, about -y.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.scene.scene import Scene
from contactvi.verify.model import GRAVITY, Shapes, built, halfspace, place, weightless

Array = NDArray[np.float64]

FOUR_BAR = (0.3, 0.9, 0.7, 1.0)  # crank, coupler, rocker, ground [m]
# Slider-crank with clearance (N22): lengths [m], masses [kg] and moments of inertia [kg m^2] of crank, rod and slider;
# half length and half height of the slider, clearance on either side [m].
LENGTHS, MASSES, INERTIAS = (0.153, 0.306), (0.038, 0.038, 0.076), (7.4e-5, 5.9e-4, 2.7e-6)
HALF_LENGTH, HALF_HEIGHT, CLEARANCE = 0.05, 0.025, 0.001


def down() -> pin.Model:
    """Return an empty model with gravity along -z."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    return model


def hinge() -> pin.JointModelRevoluteUnaligned:
    """Return a hinge about -y: its angle counts from x to z."""
    return pin.JointModelRevoluteUnaligned(np.array([0.0, -1.0, 0.0]))


def pendulum(damping: float) -> Scene:
    """A point mass of 1 kg on a rod of 1 m, angle from straight down, damping [N m s/rad]."""
    model = down()
    joint = model.addJoint(0, hinge(), place(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3))), place())
    scene = Scene.from_pinocchio(model)
    scene.set_joint("hinge", damping=damping)
    return scene


def rubbing_slider(mass: float, friction: float, stiffness: float = 0.0) -> Scene:
    """A mass [kg] on a prismatic joint with dry friction [N] and a spring to 0 [N/m], no gravity."""
    model = weightless()
    joint = model.addJoint(0, pin.JointModelPX(), place(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.eye(3)), place())
    scene = Scene.from_pinocchio(model)
    scene.set_joint("slide", friction=friction, stiffness=stiffness)
    return scene


def nut(mass: float, radius: float, pitch: float) -> Scene:
    """A free cylinder on a vertical screw of the ground, pitch [m/rad]."""
    scene = Scene((0.0, 0.0, -GRAVITY))
    scene.add_cylinder("nut", radius=radius, length=0.04, mass=mass)
    scene.add_screw("world", "nut", pitch, name="thread")
    return scene


def ball_on_string(angle: float) -> tuple[Scene, Array]:
    """A ball of 1 kg held 1 m from the origin by a distance constraint, `angle` [rad] from the bottom; scene and q."""
    scene = Scene((0.0, 0.0, -GRAVITY))
    scene.add_sphere("ball", radius=0.05, mass=1.0)
    scene.add_distance("world", "ball", length=1.0, name="string")
    q = scene.neutral()
    q[:3] = np.sin(angle), 0.0, -np.cos(angle)
    return scene, q


def cart(motion: Callable[[float], tuple[float, float, float]]) -> Scene:
    """A cart of 1 kg on a prescribed motion along x, with a point mass of 1 kg that hangs 1 m below it."""
    model = down()
    slide = model.addJoint(0, pin.JointModelPX(), place(), "slide")
    model.appendBodyToJoint(slide, pin.Inertia(1.0, np.zeros(3), np.eye(3)), place())
    swing = model.addJoint(slide, hinge(), place(), "swing")
    model.appendBodyToJoint(swing, pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3))), place())
    scene = Scene.from_pinocchio(model)
    scene.prescribe("slide", motion, name="drive")
    return scene


def bars(lengths: Sequence[float], masses: Sequence[float], inertias: Sequence[float]) -> tuple[pin.Model, int]:
    """Return a chain of bars on hinges from the origin, mass centres in their middles, and its last joint.

    Args:
        inertias: about the centres [kg m^2]. Bodies and joints: bar_1, bar_2, ..., each along the x axis of its frame.
    """
    model, joint, start = down(), 0, 0.0
    for k, (length, mass, inertia) in enumerate(zip(lengths, masses, inertias, strict=True)):
        joint = model.addJoint(joint, hinge(), place(start), f"bar_{k + 1}")
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.array([0.5 * length, 0, 0]), inertia * np.eye(3)), place())
        start = length
    return model, joint


def slider_crank(lengths: Sequence[float], masses: Sequence[float], speed: float) -> Scene:
    """Crank and rod, uniform bars, the rod's end on a slider on the x axis; the crank turns at `speed` [rad/s]."""
    model, _ = bars(lengths, masses[:2], [m * x * x / 12.0 for m, x in zip(masses, lengths, strict=False)])
    joint = model.addJoint(0, pin.JointModelPX(), place(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(masses[2], np.zeros(3), np.eye(3)), place())
    scene = Scene.from_pinocchio(model)
    scene.add_point("slide", "bar_2", point_b=(lengths[1], 0.0, 0.0), name="pin")
    scene.prescribe("bar_1", lambda t: (speed * t, speed, 0.0), name="drive")
    return scene


def four_bar(speed: float | None = None, stop: float | None = None) -> Scene:
    """Crank, coupler and rocker, 1 kg/m, whose end is held at (1, 0, 0).

    Args:
        speed: with which the crank turns [rad/s], from angle 0; None: it is free.
        stop: x [m] of a wall that the pin of coupler and rocker, a ball, hits from its right, elastic; None: there is
            none.
    """
    lengths = FOUR_BAR[:3]
    model, last = bars(lengths, lengths, [length**3 / 12.0 for length in lengths])
    shapes: Shapes = {}
    if stop is not None:
        shapes = {
            "wall": (0, place(), halfspace(1.0, 0.0, 0.0, stop)),
            "ball": (last, place(), coal.Sphere(1.0 / 32.0)),
        }
    scene = built(model, shapes, [("wall", "ball")] if shapes else [], 1.0)
    scene.add_point("world", "bar_3", (FOUR_BAR[3], 0.0, 0.0), (lengths[2], 0.0, 0.0), name="loop")
    if speed is not None:
        scene.prescribe("bar_1", lambda t: (speed * t, speed, 0.0), name="drive")
    return scene


def four_bar_angles(crank: Array | float) -> Array:
    """Return the joints' angles (..., 3) [rad] of the four-bar with its coupler above the ground, by two triangles."""
    a, b, c, d = FOUR_BAR
    phi = np.asarray(crank, dtype=float)
    x, z = d - a * np.cos(phi), -a * np.sin(phi)  # from the end of the crank to that of the rocker
    s = np.hypot(x, z)
    coupler = np.arctan2(z, x) + np.arccos((b * b + s * s - c * c) / (2.0 * b * s))
    rocker = np.arctan2(z, x) - np.arccos((c * c + s * s - b * b) / (2.0 * c * s))
    return np.stack([phi, coupler - phi, rocker - coupler], axis=-1)


def slider_with_clearance() -> Scene:
    """N22: crank, rod and a slider that is free to turn about the rod's end, in a channel along x; e = .4, mu = .01."""
    model, rod = bars(LENGTHS, MASSES[:2], INERTIAS[:2])
    slider = model.addJoint(rod, hinge(), place(LENGTHS[1]), "slider")
    model.appendBodyToJoint(slider, pin.Inertia(MASSES[2], np.zeros(3), INERTIAS[2] * np.eye(3)), place())
    wall = -(HALF_HEIGHT + CLEARANCE)
    shapes: Shapes = {
        "upper": (0, place(), halfspace(0.0, 0.0, -1.0, wall)),
        "lower": (0, place(), halfspace(0.0, 0.0, 1.0, wall)),
        "block": (slider, place(), coal.Box(2.0 * HALF_LENGTH, 0.02, 2.0 * HALF_HEIGHT)),
    }
    return built(model, shapes, [("upper", "block"), ("lower", "block")], 0.4, 0.01)
