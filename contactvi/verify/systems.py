"""The mechanical systems of `contactvi verify`, built through the public API: no file is needed.

Planar linkages lie in the x-z plane; their angles count from x towards z, about -y, and those of pendulums from
straight down.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.importing.given_surfaces import GivenSurface, with_surface
from contactvi.importing.pinocchio_models import import_pinocchio
from contactvi.reproduce.systems import problem_b
from contactvi.scene.scene import Scene

Array = NDArray[np.float64]
Shapes = dict[str, tuple[int, pin.SE3, coal.CollisionGeometry]]

GRAVITY = 9.81
RADIUS = 0.125  # of the balls in rows [m]; exact in binary, so that the positions of touching balls are exact too
FOUR_BAR = (0.3, 0.9, 0.7, 1.0)  # crank, coupler, rocker, ground [m]
# Slider-crank with clearance (Flores, Leine, Glocker 2010): lengths [m], masses [kg] and moments of inertia [kg m^2]
# of crank, rod and slider; half length and half height of the slider, clearance on either side [m].
LENGTHS, MASSES, INERTIAS = (0.153, 0.306), (0.038, 0.038, 0.076), (7.4e-5, 5.9e-4, 2.7e-6)
HALF_LENGTH, HALF_HEIGHT, CLEARANCE = 0.05, 0.025, 0.001


def place(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> pin.SE3:
    """Return a pure translation [m]."""
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def halfspace(x: float, y: float, z: float, offset: float = 0.0) -> coal.Halfspace:
    """Return the solid side n.x <= offset."""
    return coal.Halfspace(np.array([x, y, z]), offset)


def built(model: pin.Model, shapes: Shapes, pairs: Sequence[tuple[str, str]], e: float, mu: float = 0.0) -> Scene:
    """Return the scene of a model with exactly these collision pairs."""
    geometry = pin.GeometryModel()
    index = {
        name: geometry.addGeometryObject(pin.GeometryObject(name, joint, where, shape))
        for name, (joint, where, shape) in shapes.items()
    }
    for a, b in pairs:
        geometry.addCollisionPair(pin.CollisionPair(index[a], index[b]))
    scene = Scene.from_pinocchio(model, geometry)
    scene.set_contact(restitution=e, friction=mu)
    return scene


def of_solids(model: pin.Model, solids: Mapping[str, tuple[int, pin.SE3, GivenSurface]]) -> Scene:
    """Return the scene of a model whose joints carry solids by name."""
    shapes = pin.GeometryModel()
    for name, (joint, where, _) in solids.items():
        shapes.addGeometryObject(pin.GeometryObject(name, joint, where, halfspace(0.0, 0.0, 1.0)))
    part = import_pinocchio(model, shapes)
    for name, (_, _, solid) in solids.items():
        part = with_surface(part, name, solid)
    scene = Scene(model.gravity.linear)
    scene.add_model(part, False)
    return scene


def empty_model(gravity: float = 0.0) -> pin.Model:
    """Return a model without joints, with gravity [m/s^2] along -z."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    return model


def hinge() -> pin.JointModelRevoluteUnaligned:
    """Return a hinge about -y: its angle counts from x to z."""
    return pin.JointModelRevoluteUnaligned(np.array([0.0, -1.0, 0.0]))


def append_point_mass(model: pin.Model, joint: int) -> None:
    """Give a joint a point mass of 1 kg that hangs 1 m below it on a massless rod."""
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3))), place())


def ball_over_ground(e: float, mu: float = 0.0, mass: float = 1.0) -> Scene:
    """A solid ball of radius 0.1 m over the ground z = 0; its gap is z - 0.1."""
    scene = Scene((0.0, 0.0, -GRAVITY))
    scene.add_sphere("ball", radius=0.1, mass=mass)
    scene.add_halfspace(name="ground")
    scene.set_contact(restitution=e, friction=mu)
    return scene


def at_height(scene: Scene, z: float) -> Array:
    """Return the configuration (nq,) of the one free body of a scene, upright at height z [m]."""
    q = scene.neutral()
    q[:3] = 0.0, 0.0, z
    return q


def ball_row(
    masses: Sequence[float] | np.ndarray, e: float = 1.0, wall: bool = True, axis: str = "x", gravity: float = 0.0
) -> Scene:
    """Balls on prismatic joints in a row along an axis, from a wall at 0; pairs of neighbours, the wall's first."""
    model = empty_model(gravity)
    slide = {"x": pin.JointModelPX, "z": pin.JointModelPZ}[axis]
    shapes: Shapes = {}
    if wall:
        shapes["wall"] = (0, place(), halfspace(1.0, 0.0, 0.0) if axis == "x" else halfspace(0.0, 0.0, 1.0))
    for k, mass in enumerate(masses):
        joint = model.addJoint(0, slide(), place(), f"slide_{k + 1}")
        model.appendBodyToJoint(joint, pin.Inertia(float(mass), np.zeros(3), np.eye(3)), place())
        shapes[f"ball_{k + 1}"] = (joint, place(), coal.Sphere(RADIUS))
    names = list(shapes)
    return built(model, shapes, list(zip(names, names[1:], strict=False)), e)


def touching_balls(count: int, first: float = RADIUS) -> Array:
    """Return the configuration (count,) of balls of a row that touch, the first at `first` [m]."""
    return np.asarray(first + 2.0 * RADIUS * np.arange(count), dtype=float)


def ball_in_wedge(n: int) -> tuple[Scene, Array]:
    """A free ball that touches both walls of an elastic wedge of angle pi/n about +x, no gravity; scene and q."""
    half = 0.5 * math.pi / n
    scene = Scene((0.0, 0.0, 0.0))
    scene.add_sphere("ball", radius=0.1)
    for side, name in ((1.0, "upper"), (-1.0, "lower")):
        scene.add_halfspace((math.sin(half), -side * math.cos(half), 0.0), 0.0, name=name)
    scene.set_contact(restitution=1.0)
    q = scene.neutral()
    q[0] = 0.1 / math.sin(half)
    return scene, q


def pendulum_at_wall() -> Scene:
    """A point mass on a rod of 1 m, angle from the downward vertical, elastic wall at angle 0."""
    model = empty_model(GRAVITY)
    joint = model.addJoint(0, hinge(), place(), "hinge")
    append_point_mass(model, joint)
    shapes = {
        "bob": (joint, place(z=-1.0), coal.Sphere(RADIUS)),
        "wall": (0, place(), halfspace(1.0, 0.0, 0.0, -RADIUS)),
    }
    return built(model, shapes, [("wall", "bob")], 1.0)


def newtons_cradle() -> Scene:
    """Five point masses on pendulums of 1 m, each with a ball about it; they touch at rest, elastic."""
    model = empty_model(GRAVITY)
    shapes: Shapes = {}
    for k in range(5):
        joint = model.addJoint(0, hinge(), place(2.0 * RADIUS * k), f"swing_{k + 1}")
        append_point_mass(model, joint)
        shapes[f"ball_{k + 1}"] = (joint, place(z=-1.0), coal.Sphere(RADIUS))
    names = list(shapes)
    return built(model, shapes, list(zip(names, names[1:], strict=False)), 1.0)


def rod(
    ends: dict[str, float], obstacles: dict[str, coal.Halfspace], pairs: Sequence[tuple[str, str]], radius: float,
    e: float, mu: float = 0.0, gravity: float = 0.0,
) -> Scene:  # fmt: skip
    """A uniform rod m = l = 1 in the plane: x, z of its centre and a turn about y; its direction is the body's x.

    Args:
        ends: balls of this radius on it, name -> place along it [m].
        obstacles: fixed halfspaces.
    """
    model = empty_model(gravity)
    joint = model.addJoint(0, pin.JointModelPX(), place(), "x")
    joint = model.addJoint(joint, pin.JointModelPZ(), place(), "z")
    joint = model.addJoint(joint, pin.JointModelRY(), place(), "turn")
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 1.0 / 12.0, 1.0 / 12.0]))
    model.appendBodyToJoint(joint, inertia, place())
    shapes: Shapes = {name: (joint, place(x=at), coal.Sphere(radius)) for name, at in ends.items()}
    shapes |= {name: (0, place(), shape) for name, shape in obstacles.items()}
    return built(model, shapes, pairs, e, mu)


def rod_on_ground(theta: float, radius: float, e: float, mu: float = 0.0, gravity: float = 0.0) -> tuple[Scene, Array]:
    """The rod with its end -x down, at the angle theta [rad] above the horizontal and touching z = 0; scene and q."""
    ground = {"ground": halfspace(0.0, 0.0, 1.0)}
    scene = rod({"end": -0.5}, ground, [("ground", "end")], radius, e, mu, gravity)
    return scene, np.array([0.0, 0.5 * math.sin(theta) + radius, -theta])


def ladder_in_corner(theta: float) -> tuple[Scene, Array]:
    """The rod leaning in the corner of a floor z = 0 and a wall x = 0, no friction; scene and q.

    Args:
        theta: angle from the horizontal [rad]. The walls touch balls at the ends, so the corner of the rod's end points
            is that of the walls moved by their radius.
    """
    r = 0.0625
    walls = {"floor": halfspace(0.0, 0.0, 1.0), "wall": halfspace(1.0, 0.0, 0.0)}
    pairs = [("floor", "foot"), ("wall", "top")]
    scene = rod({"foot": -0.5, "top": 0.5}, walls, pairs, r, 0.0, gravity=GRAVITY)
    q = np.array([r + 0.5 * math.cos(theta), r + 0.5 * math.sin(theta), math.pi + theta])
    return scene, q


def slider_with_limit(e: float) -> Scene:
    """A mass of 1 kg on a vertical prismatic joint whose lower limit is 0."""
    model = empty_model(GRAVITY)
    inf = np.full(1, np.inf)
    joint = model.addJoint(0, pin.JointModelPZ(), place(), "slide", inf, inf, np.zeros(1), np.full(1, 10.0))
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), place())
    scene = Scene.from_pinocchio(model)
    scene.set_joint("slide", limits=True, restitution=e)
    return scene


def box_on_ground(size: Sequence[float] | np.ndarray, e: float, mu: float, slope: float = 0.0) -> tuple[Scene, Array]:
    """A box of 1 kg that lies on the ground, which falls towards +x by the angle slope [rad]; scene and q."""
    normal = np.array([math.sin(slope), 0.0, math.cos(slope)])
    scene = Scene((0.0, 0.0, -GRAVITY))
    scene.add_box("box", list(size), mass=1.0)
    scene.add_halfspace(normal.tolist(), 0.0, name="ground")
    scene.set_contact(restitution=e, friction=mu)
    q = scene.neutral()
    q[:3] = 0.5 * size[2] * normal
    q[3:7] = pin.Quaternion(pin.exp3(np.array([0.0, slope, 0.0]))).coeffs()
    return scene, q


def box_stack(count: int, edge: float) -> Scene:
    """Cubes of 1 kg on each other on the ground."""
    scene = Scene((0.0, 0.0, -GRAVITY))
    for k in range(count):
        scene.add_box(f"box_{k + 1}", (edge, edge, edge), mass=1.0, placement=(0.0, 0.0, (k + 0.5) * edge))
    scene.add_halfspace(name="ground")
    scene.set_contact(restitution=0.0, friction=0.5)
    return scene


def cylinder_on_ground(mu: float, slope: float = 0.0) -> tuple[Scene, Array]:
    """A cylinder of radius 0.1 m that lies on the ground with its axis along y; gravity leans by slope [rad] to +x."""
    scene = Scene((GRAVITY * math.sin(slope), 0.0, -GRAVITY * math.cos(slope)))
    scene.add_cylinder("cylinder", radius=0.1, length=0.3, mass=1.0)
    scene.add_halfspace(name="ground")
    scene.set_contact(restitution=0.0, friction=mu)
    q = at_height(scene, 0.1)
    q[3:7] = pin.Quaternion(pin.exp3(np.array([0.5 * math.pi, 0.0, 0.0]))).coeffs()
    return scene, q


def double_pendulum_at_wall(offset: float) -> Scene:
    """Problem B (contactvi/reproduce/systems.py) with its wall at x = offset [m]."""
    return problem_b(offset, RADIUS)


def damped_pendulum(damping: float) -> Scene:
    """A point mass of 1 kg on a rod of 1 m, angle from straight down, damping [N m s/rad]."""
    model = empty_model(GRAVITY)
    joint = model.addJoint(0, hinge(), place(), "hinge")
    append_point_mass(model, joint)
    scene = Scene.from_pinocchio(model)
    scene.set_joint("hinge", damping=damping)
    return scene


def slider_with_friction(mass: float, friction: float, stiffness: float = 0.0) -> Scene:
    """A mass [kg] on a prismatic joint with joint friction [N] and a spring to 0 [N/m], no gravity."""
    model = empty_model()
    joint = model.addJoint(0, pin.JointModelPX(), place(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.eye(3)), place())
    scene = Scene.from_pinocchio(model)
    scene.set_joint("slide", friction=friction, stiffness=stiffness)
    return scene


def nut_on_screw(mass: float, radius: float, pitch: float) -> Scene:
    """A free cylinder on a vertical screw of the ground, pitch [m/rad]."""
    scene = Scene((0.0, 0.0, -GRAVITY))
    scene.add_cylinder("nut", radius=radius, length=0.04, mass=mass)
    scene.add_screw("world", "nut", pitch, name="thread")
    return scene


def ball_on_turntable() -> tuple[Scene, Array, Array, Callable[[float], Array]]:
    """A rolling ball of 0.1 m: scene, q, v, and its place (2,) by the time.

    It goes round a circle with 2/7 of the rate of the table (Weltner 1979).
    """
    radius, rate, place_0, v = 0.1, 3.0, np.array([0.5, 0.1, 0.1]), np.array([0.1, 0.2, 0.0])
    scene = Scene()
    scene.add_halfspace(name="table")
    scene.add_sphere("ball", radius)
    scene.set_contact(friction=0.5, restitution=0.0)
    scene.set_surface_velocity("table", angular=(0.0, 0.0, rate))
    slip = np.cross([0.0, 0.0, rate], place_0) - v
    spin = [slip[1] / radius, -slip[0] / radius, 0.4]

    def place_at(t: float) -> Array:
        around = 2.0 / 7.0 * rate
        c, s = math.cos(around * t), math.sin(around * t)
        return np.asarray(place_0[:2] + np.array([[s, c - 1.0], [1.0 - c, s]]) @ v[:2] / around)

    return scene, np.array([*place_0, 0.0, 0.0, 0.0, 1.0]), np.array([*v, *spin]), place_at


def ball_on_string(angle: float) -> tuple[Scene, Array]:
    """A ball of 1 kg on a string of 1 m from the origin, `angle` [rad] from the bottom; scene and q."""
    scene = Scene((0.0, 0.0, -GRAVITY))
    scene.add_sphere("ball", radius=0.05, mass=1.0)
    scene.add_distance("world", "ball", length=1.0, name="string")
    q = scene.neutral()
    q[:3] = np.sin(angle), 0.0, -np.cos(angle)
    return scene, q


def pendulum_on_cart(motion: Callable[[float], tuple[float, float, float]]) -> Scene:
    """A cart of 1 kg on a prescribed motion along x, with a point mass of 1 kg that hangs 1 m below it."""
    model = empty_model(GRAVITY)
    slide = model.addJoint(0, pin.JointModelPX(), place(), "slide")
    model.appendBodyToJoint(slide, pin.Inertia(1.0, np.zeros(3), np.eye(3)), place())
    swing = model.addJoint(slide, hinge(), place(), "swing")
    append_point_mass(model, swing)
    scene = Scene.from_pinocchio(model)
    scene.prescribe("slide", motion, name="motion")
    return scene


def hinged_bars(lengths: Sequence[float], masses: Sequence[float], inertias: Sequence[float]) -> tuple[pin.Model, int]:
    """Return a chain of bars on hinges from the origin, mass centres in their middles, and its last joint.

    Args:
        inertias: about the centres [kg m^2]. Bodies and joints: bar_1, bar_2, ..., each along the x axis of its frame.
    """
    model, joint, start = empty_model(GRAVITY), 0, 0.0
    for k, (length, mass, inertia) in enumerate(zip(lengths, masses, inertias, strict=True)):
        joint = model.addJoint(joint, hinge(), place(start), f"bar_{k + 1}")
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.array([0.5 * length, 0, 0]), inertia * np.eye(3)), place())
        start = length
    return model, joint


def slider_crank(lengths: Sequence[float], masses: Sequence[float], speed: float) -> Scene:
    """The slider-crank whose crank turns at `speed` [rad/s]."""
    scene = free_slider_crank(lengths, masses)
    scene.prescribe("bar_1", lambda t: (speed * t, speed, 0.0), name="motion")
    return scene


def free_slider_crank(lengths: Sequence[float], masses: Sequence[float]) -> Scene:
    """Crank and rod, uniform bars, the rod's end on a slider on the x axis."""
    model, _ = hinged_bars(lengths, masses[:2], [m * x * x / 12.0 for m, x in zip(masses, lengths, strict=False)])
    joint = model.addJoint(0, pin.JointModelPX(), place(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(masses[2], np.zeros(3), np.eye(3)), place())
    scene = Scene.from_pinocchio(model)
    scene.add_point("slide", "bar_2", point_b=(lengths[1], 0.0, 0.0), name="pin")
    return scene


def four_bar(speed: float | None = None, stop: float | None = None) -> Scene:
    """Crank, coupler and rocker, 1 kg/m; the end of the rocker is pinned at (1, 0, 0).

    Args:
        speed: with which the crank turns [rad/s], from angle 0; None: it is free.
        stop: x [m] of a wall that the pin of coupler and rocker, a ball, hits from its right, elastic; None: there is
            none.
    """
    lengths = FOUR_BAR[:3]
    model, last = hinged_bars(lengths, lengths, [length**3 / 12.0 for length in lengths])
    shapes: Shapes = {}
    if stop is not None:
        shapes = {
            "wall": (0, place(), halfspace(1.0, 0.0, 0.0, stop)),
            "ball": (last, place(), coal.Sphere(1.0 / 32.0)),
        }
    scene = built(model, shapes, [("wall", "ball")] if shapes else [], 1.0)
    scene.add_point("world", "bar_3", (FOUR_BAR[3], 0.0, 0.0), (lengths[2], 0.0, 0.0), name="loop")
    if speed is not None:
        scene.prescribe("bar_1", lambda t: (speed * t, speed, 0.0), name="motion")
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
    """Crank, rod and a slider that is free to turn about the rod's end, in a channel along x; e = .4, mu = .01."""
    model, rod = hinged_bars(LENGTHS, MASSES[:2], INERTIAS[:2])
    slider = model.addJoint(rod, hinge(), place(LENGTHS[1]), "slider")
    model.appendBodyToJoint(slider, pin.Inertia(MASSES[2], np.zeros(3), INERTIAS[2] * np.eye(3)), place())
    wall = -(HALF_HEIGHT + CLEARANCE)
    shapes: Shapes = {
        "upper": (0, place(), halfspace(0.0, 0.0, -1.0, wall)),
        "lower": (0, place(), halfspace(0.0, 0.0, 1.0, wall)),
        "block": (slider, place(), coal.Box(2.0 * HALF_LENGTH, 0.02, 2.0 * HALF_HEIGHT)),
    }
    return built(model, shapes, [("upper", "block"), ("lower", "block")], 0.4, 0.01)
