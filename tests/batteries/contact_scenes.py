"""Random scenes with contact, by family and seed: bodies of all shapes on the ground, in rooms, on each other, trees.

Every draw is a reasonable scene: shapes apart or touching at the start, sizes of 0.1 to 0.5 m, densities within ten.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import coal
import numpy as np
import pinocchio as pin

import contactvi as cvi
from batteries.models import Builder
from contactvi.importing.hulls import hull_of_points
from helpers.contact_models import geometry, halfspace
from helpers.run_scenes import HAND_URDF

GRAVITY = 9.81
RESTITUTIONS, FRICTIONS = (0.0, 0.3, 0.5, 0.8, 1.0), (0.0, 0.2, 0.6, 1.5)
# impact map, reference of MHC
MAPS = (("ctec", "local"), ("dtec", "local"), ("mhc", "local"), ("mhc", "global"))
ORDERS = (2, 2, 4, 8)
STEPS = ((0.001, 0.005, 0.01, 0.02), (0.001, 0.002))  # [s]; the second of the hand
SOLID, WORLD = ("sphere", "box", "capsule", "cylinder", "hull"), pin.SE3.Identity()
Body = tuple[Any, float, np.ndarray]  # shape, volume [m^3], half of its largest extents (3,)


@dataclass
class Drawn:
    """A scene, its start and the options of its run."""

    family: str
    seed: int
    scene: cvi.Scene
    q: np.ndarray
    v: np.ndarray
    options: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        o = self.options
        return (
            f"{self.family} {self.seed}: {o['impact']}/{o['mhc_reference']} order {o['order']}, h = {o['dt']:g}, "
            f"e = {self.scene.pair_restitution[0]:g}, mu = {self.scene.pair_friction[0]:g}"
        )


# --- bodies -----------------------------------------------------------------------------------------------------------
def solid(rng: np.random.Generator, kind: str, size: float = 0.1) -> tuple[Any, pin.Inertia]:
    """A shape of about `size` [m] and its inertia, of a density of about 1000 kg / m^3."""
    a = size * rng.uniform(0.6, 1.4, 3)
    density = float(np.exp(rng.uniform(np.log(300.0), np.log(3000.0))))
    if kind == "sphere":
        return coal.Sphere(a[0]), pin.Inertia.FromSphere(density * 4.0 / 3.0 * np.pi * a[0] ** 3, a[0])
    if kind == "box":
        return coal.Box(*(2.0 * a)), pin.Inertia.FromBox(density * 8.0 * a.prod(), *(2.0 * a))
    if kind in ("capsule", "cylinder"):
        shape = coal.Capsule(0.6 * a[0], 2.0 * a[1]) if kind == "capsule" else coal.Cylinder(a[0], 1.5 * a[1])
        mass = density * np.pi * shape.radius**2 * 2.0 * shape.halfLength
        return shape, pin.Inertia.FromCylinder(mass, shape.radius, 2.0 * shape.halfLength)
    if kind == "ellipsoid":
        mass = density * 4.0 / 3.0 * np.pi * a.prod()
        return coal.Ellipsoid(*a), pin.Inertia.FromEllipsoid(mass, *a)
    points = rng.normal(size=(int(rng.integers(6, 20)), 3))
    points *= a / np.linalg.norm(points, axis=1)[:, None]
    hull = hull_of_points(points, "hull")
    mass = density * 2.0 * a.prod()
    centre = points.mean(axis=0)
    return hull, pin.Inertia(mass, centre, np.diag(0.2 * mass * (np.sum(a**2) - a**2)))


def radius_of(shape: Any) -> float:
    """Radius of a ball about the origin of a shape that contains it [m]."""
    shape.computeLocalAABB()
    box = shape.aabb_local
    return float(np.linalg.norm(np.maximum(np.abs(box.min_), np.abs(box.max_))))


def random_turn(rng: np.random.Generator) -> np.ndarray:
    return pin.Quaternion(rng.normal(size=4)).normalized().matrix()


class Bodies:
    """Free bodies and halfspaces; every two bodies are a pair, and each of them with each halfspace."""

    def __init__(self, rng: np.random.Generator, gravity: float = GRAVITY):
        self.rng, self.model = rng, pin.Model()
        self.model.gravity = pin.Motion(np.array([0.0, 0.0, -gravity]), np.zeros(3))
        self.shapes: dict[str, tuple] = {}
        self.walls: dict[str, tuple] = {}
        self.start: list[np.ndarray] = []

    def add(self, shape: Any, inertia: pin.Inertia, rotation: np.ndarray, xyz: np.ndarray) -> None:
        joint = self.model.addJoint(0, pin.JointModelFreeFlyer(), WORLD, f"body{len(self.shapes)}")
        self.model.appendBodyToJoint(joint, inertia, WORLD)
        self.shapes[f"body{joint - 1}"] = (joint, WORLD, shape)
        self.start.append(pin.SE3ToXYZQUAT(pin.SE3(rotation, np.asarray(xyz, float))))

    def wall(self, normal: np.ndarray, offset: float) -> None:
        n = np.asarray(normal, float) / np.linalg.norm(normal)
        self.walls[f"wall{len(self.walls)}"] = (0, WORLD, halfspace(*n, offset))

    def scene(self) -> tuple[cvi.Scene, np.ndarray]:
        bodies = list(self.shapes)
        pairs = [(w, b) for w in self.walls for b in bodies]
        pairs += [(a, b) for i, a in enumerate(bodies) for b in bodies[i + 1 :]]
        shapes = geometry({**self.walls, **self.shapes}, pairs)
        return cvi.Scene.from_pinocchio(self.model, shapes), np.concatenate(self.start)


def lowest(shape: Any, rotation: np.ndarray, normal: np.ndarray) -> float:
    """Largest extent of a turned shape against `normal`, from its origin [m]."""
    request, result, height = coal.DistanceRequest(), coal.DistanceResult(), 100.0
    there = coal.Transform3s(rotation, height * normal)
    plane = halfspace(*normal, 0.0)
    return height - float(coal.distance(plane, coal.Transform3s(), shape, there, request, result))


def velocity(rng: np.random.Generator, nv: int) -> np.ndarray:
    return float(rng.choice([0.0, 0.3, 2.0])) * rng.uniform(-1, 1, nv)


# --- families ---------------------------------------------------------------------------------------------------------
def drop(rng: np.random.Generator):
    """One body over the ground or a slope, any way up, not high."""
    bodies = Bodies(rng)
    slope = float(rng.choice([0.0, 0.0, 0.15, 0.4]))
    normal = np.array([np.sin(slope), 0.0, np.cos(slope)])
    shape, inertia = solid(rng, str(rng.choice(SOLID)))
    turn = random_turn(rng)
    bodies.wall(normal, 0.0)
    height = lowest(shape, turn, normal) + float(rng.choice([1e-3, 0.05, 0.3]))
    bodies.add(shape, inertia, turn, height * normal)
    scene, q = bodies.scene()
    return scene, q, velocity(rng, 6)


def rest(rng: np.random.Generator):
    """One body that touches the ground exactly: flat, on an edge, a corner, a rim; at rest or moving along."""
    bodies = Bodies(rng)
    kind = str(rng.choice(["sphere", "box", "capsule", "cylinder"]))
    shape, inertia = solid(rng, kind)
    slope = float(rng.choice([0.0, 0.0, 0.1, 0.3]))
    base = pin.exp3(np.array([0.0, slope, 0.0]))
    way = int(rng.integers(3))
    turn = base @ pin.exp3(0.5 * np.pi * np.eye(3)[int(rng.integers(3))] * int(rng.integers(2)))
    if way == 1:
        turn = base @ pin.exp3(np.array([float(rng.uniform(0.1, 1.0)), 0.0, 0.0]))
    elif way == 2:
        turn = base @ random_turn(rng)
    normal = base @ [0.0, 0.0, 1.0]
    bodies.wall(normal, 0.0)
    bodies.add(shape, inertia, turn, lowest(shape, turn, normal) * normal)
    scene, q = bodies.scene()
    along = base @ np.append(rng.uniform(-1, 1, 2), 0.0)
    return scene, q, float(rng.choice([0.0, 1.0])) * np.append(turn.T @ along, np.zeros(3))


def _settled(rng: np.random.Generator, bodies: Bodies, count: int, half: float) -> None:
    """`count` bodies at random places apart, within half [m] of the axis."""
    placed: list[tuple[np.ndarray, float]] = []
    height = 0.0
    for _ in range(count):
        shape, inertia = solid(rng, str(rng.choice(SOLID)))
        size = radius_of(shape)
        for _ in range(100):
            room = max(half - size, 0.0)
            xyz = np.array([*rng.uniform(-room, room, 2), rng.uniform(size, size + 0.2 + height)])
            if all(np.linalg.norm(xyz - x) > r + size for x, r in placed):
                break
            height += 0.02
        placed.append((xyz, size))
        bodies.add(shape, inertia, random_turn(rng), xyz)


def room(rng: np.random.Generator):
    """Two to five bodies that fall into a room of halfspaces, walls upright or as a funnel."""
    bodies = Bodies(rng)
    half, lean = float(rng.uniform(0.3, 0.5)), float(rng.choice([0.0, 0.0, 0.3]))
    bodies.wall(np.array([0.0, 0.0, 1.0]), 0.0)
    for k in range(4):
        out = np.array([np.cos(0.5 * np.pi * k), np.sin(0.5 * np.pi * k), 0.0])
        bodies.wall(-np.cos(lean) * out + [0.0, 0.0, np.sin(lean)], -half * np.cos(lean))
    _settled(rng, bodies, int(rng.integers(2, 6)), half)
    scene, q = bodies.scene()
    return scene, q, velocity(rng, 6 * len(bodies.start))


def pile(rng: np.random.Generator):
    """Bodies over each other above the ground, each a little aside and any way up."""
    bodies = Bodies(rng)
    bodies.wall(np.array([0.0, 0.0, 1.0]), 0.0)
    top = 0.0
    for _ in range(int(rng.integers(2, 5))):
        shape, inertia = solid(rng, str(rng.choice(SOLID)))
        size = radius_of(shape)
        bodies.add(shape, inertia, random_turn(rng), np.array([*rng.uniform(-0.03, 0.03, 2), top + size + 0.02]))
        top += 2.0 * size + 0.02
    scene, q = bodies.scene()
    return scene, q, 0.2 * velocity(rng, 6 * len(bodies.start))


def stack(rng: np.random.Generator):
    """Boxes and standing cylinders exactly or nearly on each other, offset and turned; at rest or pushed."""
    bodies = Bodies(rng)
    bodies.wall(np.array([0.0, 0.0, 1.0]), 0.0)
    top, gap = 0.0, float(rng.choice([0.0, 0.0, 1e-3, 0.05]))
    for _ in range(int(rng.integers(2, 5))):
        kind = str(rng.choice(["box", "box", "cylinder"]))
        shape, inertia = solid(rng, kind)
        half = shape.halfSide[2] if kind == "box" else shape.halfLength
        turn = pin.exp3(np.array([0.0, 0.0, float(rng.choice([0.0, 0.3, 0.8]))]))
        bodies.add(shape, inertia, turn, np.array([*rng.uniform(-0.03, 0.03, 2), top + gap + half]))
        top += 2.0 * half + gap
    scene, q = bodies.scene()
    v = np.zeros(6 * len(bodies.start))
    if rng.integers(2):
        v[-6:-4] = rng.uniform(-0.5, 0.5, 2)
    return scene, q, v


def balls(rng: np.random.Generator):
    """Three to eight balls of one size in a narrow funnel."""
    bodies = Bodies(rng)
    lean, radius = float(rng.uniform(0.3, 0.9)), 0.08
    for k in range(3):
        out = np.array([np.cos(2.0 * np.pi * k / 3.0 + 0.1), np.sin(2.0 * np.pi * k / 3.0 + 0.1), 0.0])
        bodies.wall(-np.cos(lean) * out + [0.0, 0.0, np.sin(lean)], 0.0)
    for k in range(int(rng.integers(3, 9))):
        mass = float(rng.choice([0.2, 1.0, 5.0]))
        xyz = np.array([*rng.uniform(-0.04, 0.04, 2), radius / np.sin(lean) * 1.3 + 0.1 + 2.3 * radius * k])
        bodies.add(coal.Sphere(radius), pin.Inertia.FromSphere(mass, radius), np.eye(3), xyz)
    scene, q = bodies.scene()
    return scene, q, velocity(rng, 6 * len(bodies.start))


def chain(rng: np.random.Generator):
    """One or two chains of hinges and slides with limits hanging over the ground, shapes on every link; a free ball."""
    b = Builder(int(rng.integers(2**31)))
    b.model.gravity = pin.Motion(np.array([0.0, 0.0, -GRAVITY]), np.zeros(3))
    kinds = ["revolute_x", "revolute_y", "revolute_unaligned", "prismatic_z", "revolute_z", "spherical"]
    tree_of = [-1]
    for tree in range(int(rng.integers(1, 3))):
        parent = 0
        for k in range(int(rng.integers(2, 6))):
            low = np.array([0.9 * tree, 0.0, 1.0]) if k == 0 else np.array([*rng.uniform(-0.05, 0.05, 2), -0.3])
            parent = b.add(str(rng.choice(kinds)), parent, pin.SE3(random_turn(rng) if k == 0 else np.eye(3), low))
            tree_of.append(tree)
    b.add("free_flyer", placement=WORLD)
    tree_of.append(9)
    model = b.model
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.4, 0.4, model.nv))
    q[-7:] = [0.45, 0.0, 2.5, 0.0, 0.0, 0.0, 1.0]
    lower, upper = np.full(model.nq, -np.inf), np.full(model.nq, np.inf)
    for i in range(1, model.njoints):
        j = model.joints[i]
        if j.nq == 1:
            lower[j.idx_q], upper[j.idx_q] = q[j.idx_q] - rng.uniform(0.05, 0.8, 2) * [1.0, -1.0]
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper
    kinds = ["sphere", "capsule", "box"]
    shapes = {f"link{i}": (i, WORLD, solid(rng, str(rng.choice(kinds)), 0.06)[0]) for i in range(1, model.njoints)}
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    centre = {name: data.oMi[i].translation for name, (i, *_) in shapes.items()}
    size = {name: radius_of(shape) for name, (*_, shape) in shapes.items()}
    floor = min(centre[n][2] - size[n] for n in shapes) - float(rng.uniform(0.01, 0.2))
    pairs = [("floor", n) for n in shapes]
    pairs += [
        (a, c)
        for a in shapes
        for c in shapes
        if tree_of[shapes[a][0]] < tree_of[shapes[c][0]] and np.linalg.norm(centre[a] - centre[c]) > size[a] + size[c]
    ]
    shapes["floor"] = (0, WORLD, halfspace(0.0, 0.0, 1.0, floor))
    scene = cvi.Scene.from_pinocchio(model, geometry(shapes, pairs))
    if rng.integers(2):
        for i in range(1, model.njoints - 1):
            scene.set_joint(model.names[i], damping=float(rng.uniform(0.01, 0.3)))
    return scene, q, velocity(rng, model.nv)


def hand(rng: np.random.Generator):
    """The Allegro hand, palm up, half closed by springs, and a ball or a box that falls on it."""
    scene = cvi.Scene()
    scene.add_urdf(HAND_URDF, placement=((0.0, 0.0, 0.1), (0.0, -np.pi / 2, 0.0)))
    if rng.integers(2):
        scene.add_sphere("ball", radius=float(rng.uniform(0.02, 0.035)), mass=0.1)
    else:
        scene.add_box("ball", rng.uniform(0.03, 0.06, 3), mass=0.1)
    pose = {"joint_*": 0.6, "joint_0.0": 0.0, "joint_4.0": 0.0, "joint_8.0": 0.0, "joint_12.0": 1.0}
    for name, angle in pose.items():
        scene.set_joint(name, stiffness=float(rng.uniform(0.5, 2.0)), rest=angle, damping=0.02)
    q = scene.configuration(pose)
    place = pin.SE3(random_turn(rng), np.array([*rng.uniform([0.0, -0.03], [0.06, 0.03]), 0.25]))
    q[scene.q_index("ball")] = pin.SE3ToXYZQUAT(place)
    return scene, q, np.zeros(scene.nv)


FAMILIES: dict[str, Callable] = {f.__name__: f for f in (drop, rest, room, pile, stack, balls, chain, hand)}


def run_of(impact: str, reference: str, restitution: float, friction: float, order: int, dt: float) -> dict[str, Any]:
    """All settings of a run: impact map, reference of MHC, restitution, friction, order and dt."""
    return {
        "impact": impact,
        "mhc_reference": reference,
        "restitution": restitution,
        "friction": friction,
        "order": order,
        "dt": dt,
    }


def settings_of(rng: np.random.Generator, family: str) -> dict[str, Any]:
    """Random settings of a run."""
    impact, reference = MAPS[int(rng.integers(len(MAPS)))]
    restitution, friction = float(rng.choice(RESTITUTIONS)), float(rng.choice(FRICTIONS))
    order = int(rng.choice(ORDERS))
    return run_of(impact, reference, restitution, friction, order, float(rng.choice(STEPS[family == "hand"])))


def draw(family: str, seed: int, duration: float = 1.0, **chosen: Any) -> Drawn:
    """The seed-th scene of a family, with its settings; `chosen`: some of `run_of`, in place of the drawn ones."""
    rng = np.random.default_rng([sorted(FAMILIES).index(family), seed])
    settings = {**settings_of(rng, family), **chosen}
    if settings["impact"] == "dtec":
        settings["restitution"] = max(settings["restitution"], 0.3)  # DTEC refuses plastic impacts
    scene, q, v = FAMILIES[family](rng)
    if np.any(scene.model.damping > 0.0):
        settings["mhc_reference"] = "local"  # the global reference needs a conservative scene
    scene.set_contact(restitution=settings.pop("restitution"), friction=settings.pop("friction"))
    dt = settings["dt"]
    options = {**settings, "duration": max(1, round(duration / dt)) * dt, "max_impacts_per_step": 5000}
    if options["order"] > 2:
        options["dt_contact"] = min(dt, 0.005)
    return Drawn(family, seed, scene, q, v, options)
