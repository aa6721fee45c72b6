"""The systems of `contactvi verify`, built through the public API: no file is needed."""

from __future__ import annotations

import math
from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.scene.scene import Scene

Array = NDArray[np.float64]
Shapes = dict[str, tuple[int, pin.SE3, coal.CollisionGeometry]]

GRAVITY = 9.81
RADIUS = 0.125  # of balls in rows [m], exact in binary, as are the places of touching ones


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


def weightless() -> pin.Model:
    """Return an empty model without gravity."""
    model = pin.Model()
    model.gravity = pin.Motion.Zero()
    return model


def ball(e: float, mu: float = 0.0, mass: float = 1.0) -> Scene:
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


def row(
    masses: Sequence[float] | np.ndarray, e: float = 1.0, wall: bool = True, axis: str = "x", gravity: float = 0.0
) -> Scene:
    """Balls on prismatic joints in a row along an axis, from a wall at 0; pairs of neighbours, the wall's first."""
    model = weightless()
    slide = {"x": pin.JointModelPX, "z": pin.JointModelPZ}[axis]
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    shapes: Shapes = {}
    if wall:
        shapes["wall"] = (0, place(), halfspace(1.0, 0.0, 0.0) if axis == "x" else halfspace(0.0, 0.0, 1.0))
    for k, mass in enumerate(masses):
        joint = model.addJoint(0, slide(), place(), f"slide_{k + 1}")
        model.appendBodyToJoint(joint, pin.Inertia(float(mass), np.zeros(3), np.eye(3)), place())
        shapes[f"ball_{k + 1}"] = (joint, place(), coal.Sphere(RADIUS))
    names = list(shapes)
    return built(model, shapes, list(zip(names, names[1:], strict=False)), e)


def touching(count: int, first: float = RADIUS) -> Array:
    """Return the configuration (count,) of balls of a row that touch, the first at `first` [m]."""
    return np.asarray(first + 2.0 * RADIUS * np.arange(count), dtype=float)


def wedge(n: int) -> tuple[Scene, Array]:
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
    """N08: a point mass on a rod of 1 m, angle from the downward vertical, elastic wall at angle 0."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    joint = model.addJoint(0, pin.JointModelRevoluteUnaligned(np.array([0.0, -1.0, 0.0])), place(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3))), place())
    shapes = {
        "bob": (joint, place(z=-1.0), coal.Sphere(RADIUS)),
        "wall": (0, place(), halfspace(1.0, 0.0, 0.0, -RADIUS)),
    }
    return built(model, shapes, [("wall", "bob")], 1.0)


def cradle() -> Scene:
    """Five point masses on pendulums of 1 m, each with a ball about it; they touch at rest, elastic."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    shapes: Shapes = {}
    for k in range(5):
        axis = np.array([0.0, -1.0, 0.0])
        joint = model.addJoint(0, pin.JointModelRevoluteUnaligned(axis), place(2.0 * RADIUS * k), f"swing_{k + 1}")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3))), place())
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
    model = weightless()
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
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


def ladder(theta: float) -> tuple[Scene, Array]:
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
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    inf = np.full(1, np.inf)
    joint = model.addJoint(0, pin.JointModelPZ(), place(), "slide", inf, inf, np.zeros(1), np.full(1, 10.0))
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), place())
    scene = Scene.from_pinocchio(model)
    scene.set_joint("slide", limits=True, restitution=e)
    return scene


def box(size: Sequence[float] | np.ndarray, e: float, mu: float, slope: float = 0.0) -> tuple[Scene, Array]:
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


def stack(count: int, edge: float) -> Scene:
    """Cubes of 1 kg on each other on the ground."""
    scene = Scene((0.0, 0.0, -GRAVITY))
    for k in range(count):
        scene.add_box(f"box_{k + 1}", (edge, edge, edge), mass=1.0, placement=(0.0, 0.0, (k + 0.5) * edge))
    scene.add_halfspace(name="ground")
    scene.set_contact(restitution=0.0, friction=0.5)
    return scene


def cylinder(mu: float, slope: float = 0.0) -> tuple[Scene, Array]:
    """A cylinder of radius 0.1 m that lies on the ground with its axis along y; gravity leans by slope [rad] to +x."""
    scene = Scene((GRAVITY * math.sin(slope), 0.0, -GRAVITY * math.cos(slope)))
    scene.add_cylinder("cylinder", radius=0.1, length=0.3, mass=1.0)
    scene.add_halfspace(name="ground")
    scene.set_contact(restitution=0.0, friction=mu)
    q = at_height(scene, 0.1)
    q[3:7] = pin.Quaternion(pin.exp3(np.array([0.5 * math.pi, 0.0, 0.0]))).coeffs()
    return scene, q


def pendulum_b(offset: float) -> Scene:
    """Problem B with its wall at x = offset [m], elastic."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    joint = 0
    for k in range(2):
        axis = pin.JointModelRevoluteUnaligned(np.array([0.0, -1.0, 0.0]))
        joint = model.addJoint(joint, axis, place(z=-1.0 if k else 0.0), f"joint_{k + 1}")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3))), place())
    shapes = {
        "tip": (joint, place(z=-1.0), coal.Sphere(RADIUS)),
        "wall": (0, place(), halfspace(1.0, 0.0, 0.0, offset - RADIUS)),
    }
    return built(model, shapes, [("wall", "tip")], 1.0)
