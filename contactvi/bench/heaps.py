"""Seeded scenes of many contacts.

A heap is a list of free bodies of simple shapes and of fixed halfspaces. Nothing overlaps at the start; the walls,
towers and dominoes start with gaps from 0 to 1 mm, so that hundreds of contacts close within the first steps. SI units,
places and velocities in the world's frame. contactvi.bench.heap_gaps finds the gaps by coal alone,
contactvi.bench.mujoco_peer makes a MuJoCo model of the scene.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import InputError, did_you_mean
from contactvi.inputs import real
from contactvi.scene.scene import Scene

Array = NDArray[np.float64]

DENSITY = 1000.0  # [kg/m^3]
KINDS = {"box": 3, "sphere": 1, "capsule": 2, "cylinder": 2}  # shape -> number of its sizes
_IDENTITY = np.eye(3)


@dataclass
class Body:
    """A free body, solid and of one density.

    Attributes:
        kind: "box", "sphere", "capsule" or "cylinder"; the axis of the last two is z.
        size: edge lengths of a box; radius of a sphere; radius and length (of a capsule without the caps) [m].
        place: centre [m], shape (3,). rotation: of the body's axes, shape (3, 3).
        mass: [kg], that of DENSITY when not given.
        velocity, spin: [m/s], [rad/s], world axes, shapes (3,).
    """

    kind: str
    size: tuple[float, ...]
    place: Array
    rotation: Array = field(default_factory=lambda: np.eye(3))
    mass: float | None = None
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    spin: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        self.size = tuple(float(x) for x in self.size)
        self.place = np.asarray(self.place, dtype=float)
        self.mass = DENSITY * self.volume if self.mass is None else float(self.mass)

    @property
    def volume(self) -> float:
        """[m^3]."""
        if self.kind == "box":
            return math.prod(self.size)
        radius, length = self.size[0], self.size[-1]
        ball = 4.0 / 3.0 * math.pi * radius**3
        rod = math.pi * radius**2 * length
        return {"sphere": ball, "capsule": rod + ball, "cylinder": rod}[self.kind]

    @property
    def radius(self) -> float:
        """Of the smallest ball about the centre that holds the body [m]."""
        radius, length = self.size[0], self.size[-1]
        if self.kind == "box":
            return 0.5 * float(np.linalg.norm(self.size))
        return {"sphere": radius, "capsule": radius + 0.5 * length, "cylinder": math.hypot(radius, 0.5 * length)}[
            self.kind
        ]


@dataclass
class Heap:
    """Bodies and halfspaces.

    Attributes:
        family, seed: what it was made by; equal ones give equal heaps.
        restitution, friction: of all contacts.
        bodies: the free bodies.
        planes: (n, offset [m]) of halfspaces n . x <= offset, n a unit vector; by default the ground z <= 0.
        duration: after which it has come to rest, or the motion of interest is over [s].
    """

    family: str
    seed: int
    restitution: float = 0.0
    friction: float = 0.5
    bodies: list[Body] = field(default_factory=list)
    planes: list[tuple[tuple[float, float, float], float]] = field(default_factory=lambda: [((0.0, 0.0, 1.0), 0.0)])
    duration: float = 1.0

    def add(self, kind: str, size: Any, place: Any, rotation: Any = _IDENTITY, mass: float | None = None) -> Body:
        """Add a body at rest."""
        self.bodies.append(Body(kind, tuple(size), np.asarray(place), np.asarray(rotation, dtype=float), mass))
        return self.bodies[-1]

    def add_room(self, half: float) -> None:
        """Add four walls about the z axis, `half` [m] from it."""
        for normal in ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)):
            self.planes.append((normal, -half))


# --- rotations --------------------------------------------------------------------------------------------------------
def turn(axis: Any, angle: float) -> Array:
    """Return the rotation about an axis by an angle [rad], shape (3, 3)."""
    x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def turn_z(angle: float) -> Array:
    """Return the rotation about z by an angle [rad]."""
    return turn((0.0, 0.0, 1.0), angle)


def rotation_of(quaternion: Array) -> Array:
    """Return rotation matrices (..., 3, 3) of unit quaternions x y z w, shape (..., 4)."""
    x, y, z, w = np.moveaxis(np.asarray(quaternion, dtype=float), -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _random_rotation(rng: np.random.Generator) -> Array:
    numbers = rng.normal(size=4)
    return rotation_of(numbers / np.linalg.norm(numbers))


# --- families ---------------------------------------------------------------------------------------------------------
def tower(rng: np.random.Generator, heap: Heap, count: int | None = None, cylinders: bool = False) -> None:
    """Boxes of random sizes on each other, turned about z and a little aside; all gaps 0 or all 1 mm."""
    count = count or int(rng.integers(3, 9))
    gap, top = float(rng.choice([0.0, 1e-3])), 0.0
    for _ in range(count):
        size = rng.uniform(0.12, 0.25, 3)
        size[2] = rng.uniform(0.06, 0.15)
        place = [*rng.uniform(-0.015, 0.015, 2), top + gap + 0.5 * size[2]]
        if cylinders and rng.random() < 0.4:
            heap.add("cylinder", (0.5 * size[0], size[2]), place)
        else:
            heap.add("box", size, place, turn_z(rng.uniform(0.0, np.pi)))
        top += gap + size[2]


def mixed_tower(rng: np.random.Generator, heap: Heap, count: int | None = None) -> None:
    """A tower of boxes and cylinders."""
    tower(rng, heap, count, cylinders=True)


def full_bin(rng: np.random.Generator, heap: Heap, count: int = 10) -> None:
    """Boxes, cylinders, spheres and capsules fall one after the other into an open box of halfspaces."""
    half, height = 0.25, 0.15
    kinds = ("box", "cylinder", "sphere", "capsule")
    heap.add_room(half)
    for _ in range(count):
        kind, a = kinds[int(rng.integers(len(kinds)))], rng.uniform(0.03, 0.06, 3)
        sizes = {"box": 2.0 * a, "sphere": a[:1], "capsule": (0.6 * a[0], 2.0 * a[1]), "cylinder": (a[0], 2.0 * a[1])}
        body = heap.add(kind, sizes[kind], np.zeros(3), _random_rotation(rng))
        r = body.radius
        body.place = np.array([*rng.uniform(-(half - r) * 0.8, (half - r) * 0.8, 2), height + r])
        height += 2.0 * r + 0.005
    heap.duration = 1.5


def spheres(rng: np.random.Generator, heap: Heap, count: int = 50) -> None:
    """Spheres fall as a loose grid into a box of halfspaces."""
    radius, side = 0.03, max(2, math.ceil((count / 2) ** (1 / 3)))
    heap.add_room(1.15 * radius * side + 0.01)
    middle = (side - 1) / 2
    for k in range(count):
        i, j, layer = k % side, (k // side) % side, k // (side * side)
        own = radius * rng.uniform(0.85, 1.0)
        grid = [(i - middle) * 2.3 * radius, (j - middle) * 2.3 * radius, 0.05 + layer * 2.3 * radius + radius]
        heap.add("sphere", (own,), np.array(grid) + rng.uniform(-0.1 * radius, 0.1 * radius, 3))


def funnel(rng: np.random.Generator, heap: Heap, count: int = 10) -> None:
    """Balls of one size and masses of 0.2, 1 or 5 kg fall into a funnel of three walls."""
    lean, radius = float(rng.uniform(0.4, 0.9)), 0.04
    heap.planes = []
    for k in range(3):
        angle = 2.0 * np.pi * k / 3.0 + 0.1
        across = -np.cos(lean)
        heap.planes.append(((float(across * np.cos(angle)), float(across * np.sin(angle)), float(np.sin(lean))), 0.0))
    for k in range(count):
        height = radius / np.sin(lean) * 1.2 + 0.05 + 2.1 * radius * k
        place = [*rng.uniform(-0.01, 0.01, 2), height]
        heap.add("sphere", (radius,), place, mass=float(rng.choice([0.2, 1.0, 5.0])))
    heap.duration = 1.5


def wall(rng: np.random.Generator, heap: Heap, count: int = 12) -> None:
    """A brick wall in running bond, the bricks 0.1 mm beside each other; a ball hits it where the seed is odd."""
    length, width, height, gap = 0.2, 0.1, 0.06, 1e-4
    longest = 4 if count <= 14 else 5
    row = laid = 0
    while laid < count:
        bricks = longest if row % 2 == 0 else longest - 1
        for i in range(min(bricks, count - laid)):
            place = ((i - (bricks - 1) / 2) * (length + gap), 0.0, height / 2 + row * height)
            heap.add("box", (length, width, height), place, turn_z(float(rng.uniform(-1e-3, 1e-3))))
            laid += 1
        row += 1
    if heap.seed % 2:
        ball = heap.add("sphere", (0.05,), (rng.uniform(-0.1, 0.1), -0.3, 0.5 * row * height))
        ball.velocity = np.array([0.0, 2.0, 0.0])


def dominoes(rng: np.random.Generator, heap: Heap, count: int = 10) -> None:
    """A row of dominoes, the first one pushed."""
    for k in range(count):
        place = (k * 0.035, float(rng.uniform(-0.002, 0.002)), 0.05)
        heap.add("box", (0.01, 0.05, 0.1), place, turn_z(float(rng.uniform(-0.05, 0.05))))
    first = heap.bodies[0]
    first.spin, first.velocity = np.array([0.0, 2.5, 0.0]), np.array([0.125, 0.0, 0.0])
    heap.duration = 1.5


def incline(rng: np.random.Generator, heap: Heap, count: int = 5) -> None:
    """Boxes in a row down a slope with a stop at its foot, nearly touching each other."""
    slope = turn((0.0, 1.0, 0.0), float(rng.uniform(0.2, 0.6)))
    normal, down = slope @ [0.0, 0.0, 1.0], slope @ [1.0, 0.0, 0.0]
    heap.planes = [(_triple(normal), 0.0), (_triple(-down), -0.6)]
    along = 0.4
    for _ in range(count):
        size = rng.uniform(0.06, 0.12, 3)
        along -= 0.5 * size[0]
        place = slope @ [along, rng.uniform(-0.01, 0.01), 0.5 * size[2]]
        heap.add("box", size, place, slope @ turn_z(float(rng.choice([0.0, 0.05, 0.3])) * 0.2))
        along -= 0.5 * size[0] + float(rng.choice([2e-3, 0.02])) + 0.02


def cards(_: np.random.Generator, heap: Heap, count: int = 3) -> None:
    """Pairs of boards that lean against each other, edge on edge, and boards across neighbouring pairs."""
    thick, long, width, lean = 0.01, 0.2, 0.1, 0.35
    aside = 0.5 * long * np.sin(lean) + 0.5 * thick * np.cos(lean) + 1e-6
    height = 0.5 * long * np.cos(lean) + 0.5 * thick * np.sin(lean)
    for k in range(count):
        x = k * (4.0 * aside + 0.02)
        for side in (1.0, -1.0):
            place = (x - side * aside, 0.0, height)
            heap.add("box", (thick, width, long), place, turn((0.0, 1.0, 0.0), side * lean))
    top = 2.0 * height
    for k in range(count - 1):
        place = ((k + 0.5) * (4.0 * aside + 0.02), 0.0, top + thick / 2 + 1e-4 + (k % 2) * (thick + 1e-4))
        heap.add("box", (4.0 * aside + 0.02 + 0.12, width, thick), place)


def _triple(vector: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z


FAMILIES: dict[str, Callable[..., None]] = {
    "tower": tower,
    "mixed_tower": mixed_tower,
    "bin": full_bin,
    "spheres": spheres,
    "funnel": funnel,
    "wall": wall,
    "dominoes": dominoes,
    "incline": incline,
    "cards": cards,
}


def make(family: str, seed: int, *, restitution: float = 0.0, friction: float = 0.5, count: int | None = None) -> Heap:
    """Return the heap of a family and a seed.

    Args:
        family: one of FAMILIES.
        seed: of the random sizes and places, >= 0.
        restitution, friction: of all contacts; they do not change sizes and places.
        count: number of bodies (of "cards" pairs of boards), >= 1; by default what the family has.

    Raises:
        InputError: for an unknown family and numbers out of range.
    """
    if family not in FAMILIES:
        raise InputError(
            "Unknown family of heaps",
            name="family",
            got=repr(family),
            remedy=did_you_mean(family, FAMILIES),
            expected=" | ".join(FAMILIES),
        )
    if count is not None and count < 1:
        raise InputError(
            "A heap needs bodies",
            name="count",
            expected="a number >= 1",
            got=count,
            remedy="Give count=1 or more, or leave it out",
        )
    heap = Heap(family, seed, real("restitution", restitution, 0.0, 1.0), real("friction", friction, 0.0))
    rng = np.random.default_rng([sum(map(ord, family)), seed])
    FAMILIES[family](rng, heap, **({} if count is None else {"count": count}))
    return heap


# --- contactvi --------------------------------------------------------------------------------------------------------
def to_scene(heap: Heap, scene: Scene | None = None) -> tuple[Scene, Array, Array]:
    """Return the scene, its initial configuration (nq,) and velocity (nv,): per body 7 and 6 numbers, in their order.

    scene: an empty one to fill, for example without gravity.
    """
    scene = Scene() if scene is None else scene
    moving = {}
    for k, (normal, offset) in enumerate(heap.planes):
        scene.add_halfspace(normal, offset, name=f"plane{k}")
    for k, body in enumerate(heap.bodies):
        common: dict[str, Any] = {"mass": body.mass, "placement": pin.SE3(body.rotation, body.place)}
        if body.kind == "box":
            handle = scene.add_box(f"body{k}", body.size, **common)
        elif body.kind == "sphere":
            handle = scene.add_sphere(f"body{k}", body.size[0], **common)
        else:
            radius, length = body.size
            add = scene.add_capsule if body.kind == "capsule" else scene.add_cylinder
            handle = add(f"body{k}", radius, length, **common)
        if np.any(body.velocity) or np.any(body.spin):
            moving[handle] = (body.velocity, body.spin)
    scene.set_contact(restitution=heap.restitution, friction=heap.friction)
    return scene, scene.neutral(), scene.velocity(moving) if moving else np.zeros(scene.nv)
