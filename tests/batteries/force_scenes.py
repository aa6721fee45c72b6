"""Random scenes with forces, prescribed motions, constraints and contact, by family and seed.

Bodies of 0.1 to 0.3 m and 0.3 to 30 kg, arms with limits, ground and walls; on them any of the elements of
elements.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

import contactvi as cvi
from batteries import elements as e
from batteries.contact_scenes import GRAVITY, WORLD, radius_of, random_turn, run_of, solid
from batteries.elements import CLOSED, FORCES, JOINT_FORCES, Built
from batteries.models import JOINTS, Builder
from helpers.contact_models import geometry, halfspace

RESTITUTIONS, FRICTIONS, ORDERS = (0.0, 0.3, 0.7, 1.0), (0.0, 0.2, 0.8), (2, 4, 8)
MAPS = (("ctec", "local"), ("dtec", "local"), ("mhc", "local"))
STEPS = (0.001, 0.002, 0.004)  # [s]
DURATION = 0.4  # [s]
HINGES: dict[str, Callable[[], Any]] = {
    "rx": pin.JointModelRX,
    "ry": pin.JointModelRY,
    "rz": pin.JointModelRZ,
    "pz": pin.JointModelPZ,
    "skew": lambda: pin.JointModelRevoluteUnaligned(np.array([0.6, 0.0, 0.8])),
}


# --- families ---------------------------------------------------------------------------------------------------------
class Parts:
    """Bodies on joints, halfspaces, and the pairs of shapes that may touch."""

    def __init__(self, rng: np.random.Generator):
        self.rng, self.model = rng, pin.Model()
        self.model.gravity = pin.Motion(np.array([0.0, 0.0, -GRAVITY]), np.zeros(3))
        self.shapes: dict[str, tuple] = {"ground": (0, WORLD, halfspace(0.0, 0.0, 1.0, 0.0))}
        self.pairs: list[tuple[str, str]] = []
        self.start: list[np.ndarray] = []

    def add(self, kind: str, parent: int, placement: pin.SE3, name: str, start: Any, size: float = 0.08) -> int:
        """A body of a random shape on a new joint, which may touch the ground."""
        joint = {"free": pin.JointModelFreeFlyer, "px": pin.JointModelPX, **HINGES}[kind]()
        index = self.model.addJoint(parent, joint, placement, name)
        shape, inertia = solid(self.rng, str(self.rng.choice(["sphere", "box", "capsule"])), size)
        self.model.appendBodyToJoint(index, inertia, WORLD)
        self.shapes[f"shape of {name}"] = (index, WORLD, shape)
        self.pairs.append(("ground", f"shape of {name}"))
        self.start.append(np.atleast_1d(start))
        return index

    def wall(self, x: float) -> None:
        """At x [m], in front of everything."""
        self.shapes["wall"] = (0, WORLD, halfspace(-1.0, 0.0, 0.0, -x))
        self.pairs += [("wall", name) for name in self.shapes if name not in ("ground", "wall")]

    def lift(self, q: np.ndarray, roots: list[int], gap: float) -> np.ndarray:
        """Raise free roots, and the joints of fixed ones, by what it takes to be `gap` [m] over the ground."""
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, q)
        low = min(data.oMi[j].translation[2] - radius_of(s) for n, (j, _, s) in self.shapes.items() if j)
        for root in roots:
            if self.model.joints[root].nq == 7:
                q[self.model.joints[root].idx_q + 2] += gap - low
            else:
                self.model.jointPlacements[root].translation[2] += gap - low
        return q

    def built(self, roots: list[int], gap: float, speed: float) -> Built:
        """The scene with its start."""
        q = self.lift(np.concatenate(self.start), roots, gap)
        joints = [self.model.names[i] for i in range(1, self.model.njoints) if self.model.nqs[i] == 1]
        for i in range(1, self.model.njoints):
            k = self.model.joints[i].idx_q
            if self.model.nqs[i] == 1 and self.rng.integers(2):
                self.model.lowerPositionLimit[k] = q[k] - self.rng.uniform(0.0, 0.4)
                self.model.upperPositionLimit[k] = q[k] + self.rng.uniform(0.01, 0.4)
        scene = cvi.Scene.from_pinocchio(self.model, geometry(self.shapes, self.pairs))
        v = speed * self.rng.uniform(-1, 1, self.model.nv)
        return Built(self.rng, scene, q, v, list(self.model.names)[1:], joints, closed=not joints)


def chain(p: Parts, links: int, root: str) -> list[int]:
    """Links on hinges, one after the other; a free root or a fixed one."""
    rng, joint, found = p.rng, 0, []
    turn = random_turn(rng)
    for k in range(links):
        kind = root if k == 0 else str(rng.choice(list(HINGES)))
        place = pin.SE3(turn if k == 0 and root != "free" else np.eye(3), np.array([0.0, 0.0, -0.25 if k else 0.0]))
        start = np.append(np.zeros(3), pin.Quaternion(turn).coeffs()) if kind == "free" else rng.uniform(-0.5, 0.5)
        joint = p.add(kind, joint, place if kind != "free" else WORLD, f"link{k}", start, 0.06)
        found.append(joint)
    return found


def arm(rng: np.random.Generator, chosen: tuple = JOINT_FORCES, root: str = "") -> Built:
    """A chain on the ground's side with limits, and a ball."""
    p = Parts(rng)
    links = chain(p, int(rng.integers(2, 6)), root or str(rng.choice(["ry", "rx", "pz"])))
    b = p.built(links[:1], float(rng.uniform(0.01, 0.1)), float(rng.choice([0.0, 0.5, 2.0])))
    return put(b, chosen, 3)


def smooth(rng: np.random.Generator) -> Built:
    """Without constraints and joint friction, so that all orders and maps apply."""
    return arm(rng, tuple(force for force in JOINT_FORCES if force is not e.joint_friction))


def closed_arm(rng: np.random.Generator) -> Built:
    """A chain, its last link closed to the world or the first one, and forces."""
    b = arm(rng, (*JOINT_FORCES, e.prescribe, e.equality), str(rng.choice(["ry", "free"])))
    one, two = ("world" if b.bodies[0] in b.joints else b.bodies[0]), b.bodies[-1]
    xyz = b.place(two) * b.point(two)
    if rng.integers(2):
        b.scene.add_point(one, two, b.place(one).actInv(xyz), b.place(two).actInv(xyz), name="loop")
    else:
        end = b.point(one)
        length = float(np.linalg.norm(b.place(one) * end - xyz))
        b.scene.add_distance(one, two, end, b.place(two).actInv(xyz), length, name="loop")
    b.constrained = True
    return put(b, (e.twice,), 1) if rng.integers(2) else b


def group(rng: np.random.Generator, chosen: tuple = (*FORCES, *CLOSED), at_most: int = 3) -> Built:
    """One to four free bodies beside each other over the ground, before a wall."""
    p = Parts(rng)
    for k in range(int(rng.integers(1, 5))):
        xyz = np.array([0.35 * (k % 2), 0.35 * (k // 2), 0.0]) + rng.uniform(-0.02, 0.02, 3)
        p.add("free", 0, WORLD, f"body{k}", np.append(xyz, pin.Quaternion(random_turn(rng)).coeffs()))
    p.wall(0.6)
    b = p.built(list(range(1, p.model.njoints)), float(rng.uniform(0.001, 0.1)), float(rng.choice([0.0, 0.5, 2.0])))
    return put(b, chosen, at_most)


def joined(rng: np.random.Generator) -> Built:
    """Free bodies with constraints and pushes only, some constraint twice: their momentum is known."""
    return put(group(rng, (e.point, e.weld, e.screw, e.distance, e.push)), (e.twice,), 1)


def strings(rng: np.random.Generator) -> Built:
    """A body on two to five strings, some of them winches, some ropes."""
    p = Parts(rng)
    p.add("free", 0, WORLD, "puppet", np.append(np.zeros(3), pin.Quaternion(random_turn(rng)).coeffs()), 0.1)
    b = p.built([1], float(rng.uniform(0.005, 0.05)), 0.0)
    return put(b, (e.distance, e.winch, e.spring, e.winch), int(rng.integers(2, 6)))


def pushed(rng: np.random.Generator) -> Built:
    """A driven wall on a slide, links hanging from it, free bodies before it, forces."""
    p = Parts(rng)
    slide = p.add("px", 0, WORLD, "slide", 0.0)
    parent = slide
    for k in range(int(rng.integers(0, 3))):
        kind = str(rng.choice(list(HINGES)))
        parent = p.add(kind, parent, pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.25])), f"link{k}", 0.0, 0.06)
    p.lift(np.concatenate(p.start), [slide], 0.05)
    for k in range(int(rng.integers(1, 3))):
        xyz = np.array([0.4 + 0.35 * k, 0.0, 0.25])
        p.add("free", 0, WORLD, f"body{k}", np.append(xyz, pin.Quaternion(random_turn(rng)).coeffs()))
        p.pairs.append(("shape of slide", f"shape of body{k}"))
    b = p.built([], 0.0, 0.0)
    e.prescribe(b, "slide")
    b.joints.remove("slide")  # no other element acts on it
    return put(b, (e.damping, e.joint_friction, e.polynomial, e.servo), 2)


def kinds(rng: np.random.Generator) -> Built:
    """A tree of joints of any kind, a small ball on every one of them, over the ground."""
    made, joint = Builder(int(rng.integers(2**31))), 0
    for _ in range(int(rng.integers(2, 6))):
        joint = made.add(str(rng.choice(list(JOINTS))), joint if rng.integers(4) else 0)
    model = made.model
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1, 1, model.nv))
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    low = min(data.oMi[i].translation[2] for i in range(1, model.njoints))
    shapes = {f"ball{i}": (i, WORLD, coal.Sphere(0.05)) for i in range(1, model.njoints)}
    pairs = [("ground", name) for name in shapes]
    shapes["ground"] = (0, WORLD, halfspace(0.0, 0.0, 1.0, low - 0.05 - float(rng.uniform(0.001, 0.1))))
    scene = cvi.Scene.from_pinocchio(model, geometry(shapes, pairs))
    names = list(model.names)[1:]
    joints = [name for name in names if model.nqs[model.getJointId(name)] == 1]
    b = Built(rng, scene, q, rng.uniform(-1, 1, model.nv), names, joints, closed=False)
    return put(
        b,
        (e.spring, e.tape, e.push, e.shake, e.drag, e.distance, e.point, *((e.joint_friction, e.servo) * bool(joints))),
        3,
    )


def put(b: Built, chosen: tuple, at_most: int) -> Built:
    """Put up to `at_most` of the elements on the scene, at least one."""
    for _ in range(int(b.rng.integers(1, at_most + 1))):
        element = chosen[int(b.rng.integers(len(chosen)))]
        needs = {e.equality: 2, e.prescribe: 1, e.joint_friction: 1, e.polynomial: 1, e.servo: 1}.get(element, 0)
        if len(b.joints) >= needs and (element is not e.prescribe or not b.driven):
            element(b)
            b.elements.append(element.__name__)
    return b


# The place of a family is part of its seeds: new ones go to the end.
FAMILIES: dict[str, Callable] = {
    f.__name__: f for f in (arm, closed_arm, group, joined, pushed, smooth, strings, kinds)
}


@dataclass
class Drawn:
    """A scene, its start and the options of its run."""

    family: str
    seed: int
    built: Built
    q: np.ndarray
    v: np.ndarray
    options: dict[str, Any]

    def __str__(self) -> str:
        o, scene = self.options, self.built.scene
        return (
            f"{self.family} {self.seed} ({', '.join(self.built.elements)}): {o['impact']} order {o['order']}, "
            f"h = {o['dt']:g}, e = {scene.pair_restitution[0]:g}, mu = {scene.pair_friction[0]:g}"
        )


def draw(family: str, seed: int, duration: float = DURATION, **chosen: Any) -> Drawn:
    """The seed-th scene of a family, with its settings; `chosen`: some of `run_of`, in place of the drawn ones."""
    rng = np.random.default_rng([7, list(FAMILIES).index(family), seed])
    impact, reference = MAPS[int(rng.integers(len(MAPS)))]
    drawn = float(rng.choice(RESTITUTIONS)), float(rng.choice(FRICTIONS)), int(rng.choice(ORDERS))
    settings = {**run_of(impact, reference, *drawn, float(rng.choice(STEPS))), **chosen}
    b = FAMILIES[family](rng)
    if b.constrained:  # steps are of order 2 there, impacts CTEC's, whatever is asked for
        settings |= {"order": 2, "impact": "ctec"}
    if settings["impact"] == "dtec":
        settings["restitution"] = max(settings["restitution"], 0.3)  # DTEC refuses plastic impacts
    b.scene.set_contact(restitution=settings.pop("restitution"), friction=settings.pop("friction"))
    dt = settings["dt"]
    options = {**settings, "duration": max(1, round(duration / dt)) * dt, "max_impacts_per_step": 5000}
    if options["order"] > 2:
        options["dt_contact"] = dt
    try:
        v = b.scene.consistent_velocity(b.q, b.v)
    except cvi.ConstraintError:  # the constraints do not allow the prescribed motion
        for name in b.driven_elements:
            b.scene.remove(name)
        b.driven_elements.clear()
        v = b.scene.consistent_velocity(b.q, b.v)
    return Drawn(family, seed, b, b.q, v, options)
