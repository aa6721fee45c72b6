"""Runs whose derivatives are compared with differences: smooth ones of all joints and elements, and through impacts.

Every case is drawn from a seed of its own: random bodies, states and steps. Runs are short, so that changes grow little
and differences keep their digits.
"""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

import contactvi as cvi
from batteries.contact_scenes import SOLID, Bodies, lowest, radius_of, random_turn, solid
from helpers.chains import JOINTS, chain, state_of

ORDERS = (2, 4, 8, 16)
RESTITUTIONS = (1.0, 0.7, 0.3)
FRICTIONS = (0.0, 0.2, 0.8)
UP = np.array([0.0, 0.0, 1.0])
MIXED = [pin.JointModelFreeFlyer(), pin.JointModelRUBX(), pin.JointModelPZ(), pin.JointModelSpherical()]
FAMILIES = {
    "revolute": JOINTS["revolute"],
    "prismatic": [pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPrismaticUnaligned(np.array([0.6, 0.0, 0.8]))],
    "continuous": JOINTS["continuous"],
    "helical": [pin.JointModelHX(0.1), pin.JointModelRY(), pin.JointModelHZ(-0.2)],
    "planar": JOINTS["planar"],
    "spherical": JOINTS["spherical"],
    "free-flyer": JOINTS["free"],
    "translation": JOINTS["translation"],
    "mixed tree": MIXED,
}
Start = tuple[cvi.Scene, np.ndarray, np.ndarray]
Rng = np.random.Generator


@dataclass
class Case:
    """A run: `make` returns its scene and start."""

    family: str
    label: str
    make: Callable[[], Start]
    options: dict[str, Any]
    wrt: tuple[str, ...] = ("q0", "v0")
    columns: int = 6


@dataclass
class Draw:
    """The random numbers of one case, by its name: `rng` for its scene and start, others for its options.

    Whoever makes a scene takes a new Draw, so that it is the same one each time.
    """

    name: str
    rng: Rng = field(init=False)

    def __post_init__(self) -> None:
        self.rng = self._new(0)

    def _new(self, what: int) -> Rng:
        return np.random.default_rng([zlib.crc32(self.name.encode()), what])

    def options(self, duration: float, order: int, **more: Any) -> dict[str, Any]:
        """Return options with a random step of 10 or 20 ms."""
        dt = float(self._new(1).choice([0.01, 0.02]))
        return {"duration": duration, "dt": dt, "order": order, "solver_tol": 1e-14, **more}


# -- smooth runs ------------------------------------------------------------------------------------------------------


def smooth(seeds: int) -> Iterator[Case]:
    """Chains of all joints, and a tree, under gravity alone."""
    for joints, order, seed in itertools.product(FAMILIES, ORDERS, range(seeds)):
        draw = Draw(f"{joints} {order} {seed}")

        def make(joints: str = joints, name: str = draw.name) -> Start:
            number = int(Draw(name).rng.integers(1000))
            scene, rng = tree(number) if joints == "mixed tree" else chain(FAMILIES[joints], number)
            return scene, *state_of(scene, rng)[:2]

        yield Case(
            f"smooth: {joints}", draw.name, make, draw.options(0.3, order), ("q0", "v0", "control"), 9
        )  # fmt: skip


def tree(seed: int) -> tuple[cvi.Scene, Rng]:
    """Return a free body that carries branches of other joints."""
    rng, model = np.random.default_rng(seed), pin.Model()
    for k, kind in enumerate(MIXED):
        placement = pin.SE3(pin.exp3(rng.uniform(-1, 1, 3)), rng.uniform(-0.4, 0.4, 3))
        joint = model.addJoint(min(k, 1), kind, placement, f"j{k}")
        inertia = pin.Inertia(rng.uniform(0.5, 2.0), rng.uniform(-0.2, 0.2, 3), np.diag(rng.uniform(0.05, 0.1, 3)))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addFrame(pin.Frame(f"b{k}", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    return cvi.Scene.from_pinocchio(model, name="tree"), rng


def joint_springs(scene: cvi.Scene, rng: Rng) -> None:
    for k in range(1, scene.model.njoints):
        whole = scene.model.joints[k].shortname() in ("JointModelFreeFlyer", "JointModelPlanar")
        if not whole:
            scene.set_joint(str(scene.model.names[k]), stiffness=rng.uniform(5, 30))


def nonlinear_springs(scene: cvi.Scene, rng: Rng) -> None:
    for k in range(1, scene.model.njoints):
        if scene.model.joints[k].nq == 1:
            scene.set_joint(str(scene.model.names[k]), spring=rng.uniform(1, 10, 3))


def damping(scene: cvi.Scene, rng: Rng) -> None:
    scene.set_joint("*", damping=rng.uniform(0.1, 1.0))


def point_springs(scene: cvi.Scene, rng: Rng) -> None:
    ends = {"point_a": rng.uniform(-0.3, 0.3, 3), "point_b": rng.uniform(0.5, 1.0, 3)}
    scene.add_spring("b1", "world", 40.0, damping=1.5, rest_length=0.2, **ends)
    scene.add_spring("b0", "b1", 25.0, damping=0.5, rest_length=0.1, point_a=(0.3, 0.1, 0.2), point_b=(0.0, -0.4, 0.1))


def tapes(scene: cvi.Scene, rng: Rng) -> None:
    points = [("world", (1.0, 0.2, 0.3)), ("b0", rng.uniform(-0.3, 0.3, 3)), ("b1", rng.uniform(0.3, 0.6, 3))]
    scene.add_tape_spring(points, 30.0, rest_length=0.2, damping=0.8)


def wrenches(scene: cvi.Scene, rng: Rng) -> None:
    scene.add_wrench("b1", force=rng.uniform(-2, 2, 3), torque=rng.uniform(-1, 1, 3), point=(0.1, 0.0, 0.3))
    scene.add_wrench("b0", force=rng.uniform(-2, 2, 3), torque=rng.uniform(-1, 1, 3), axes="body")
    scene.add_wrench("b0", force=lambda t: (np.sin(3.0 * t), 0.5, t))


def servos(scene: cvi.Scene, rng: Rng) -> None:
    for k in range(1, scene.model.njoints):
        if scene.model.joints[k].nv == 1:
            scene.set_servo(str(scene.model.names[k]), kp=rng.uniform(50, 200), kd=rng.uniform(2, 10), target=0.3)


def user_forces(scene: cvi.Scene, rng: Rng) -> None:
    n = scene.nv
    D, w = rng.uniform(-0.1, 0.1, (n, n)) - 0.3 * np.eye(n), rng.uniform(-1, 1, n)

    def force(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return D @ v - 0.05 * w * (w @ v) ** 3

    def derivatives(t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((n, n)), D - 0.15 * (w @ v) ** 2 * np.outer(w, w)

    scene.add_force(force, derivatives)


def potentials(scene: cvi.Scene, rng: Rng) -> None:
    """A cosine of the first joint that has one number in q."""
    n, model = scene.nv, scene.model
    joint = next(k for k in range(1, model.njoints) if model.joints[k].nq == 1)
    i, iv = model.idx_qs[joint], model.idx_vs[joint]
    unit, strength = np.eye(n)[iv], rng.uniform(2.0, 6.0)
    scene.add_potential(
        lambda q: strength * np.cos(2.0 * q[i]),
        lambda q: -2.0 * strength * np.sin(2.0 * q[i]) * unit,
        lambda q: -4.0 * strength * np.cos(2.0 * q[i]) * np.outer(unit, unit),
    )


ELEMENTS: dict[str, Callable[[cvi.Scene, Rng], None]] = {
    "joint springs": joint_springs, "nonlinear springs": nonlinear_springs, "damping": damping,
    "point springs, dampers": point_springs, "tapes": tapes, "wrenches": wrenches, "servos": servos,
    "user forces": user_forces, "potentials": potentials,
}  # fmt: skip


def elements(seeds: int) -> Iterator[Case]:
    """Each element on chains of revolute joints, of a free body and of joints of several kinds."""
    bases = {"revolute": JOINTS["revolute"], "free": JOINTS["free"], "spherical": JOINTS["spherical"]}
    for kind, order, base, seed in itertools.product(ELEMENTS, ORDERS, bases, range(seeds)):
        draw = Draw(f"{kind} {order} {base} {seed}")

        def make(kind: str = kind, base: str = base, name: str = draw.name) -> Start:
            scene, rng = chain(bases[base], int(Draw(name).rng.integers(1000)))
            ELEMENTS[kind](scene, rng)
            return scene, *state_of(scene, rng)[:2]

        yield Case(f"smooth: {kind}", draw.name, make, draw.options(0.2, order), ("q0", "v0", "control"), 6)


# -- impacts ----------------------------------------------------------------------------------------------------------


def laws() -> Iterator[tuple[str, float, float]]:
    """All (impact map, restitution, friction); friction with ctec alone."""
    for e in RESTITUTIONS:
        yield from (("ctec", e, mu) for mu in FRICTIONS)
        yield from ((impact, e, 0.0) for impact in ("dtec", "mhc"))


def parameters(e: float, mu: float) -> tuple[str, ...]:
    """Return what to differentiate by."""
    return ("q0", "v0", "restitution", "friction") if mu > 0.0 else ("q0", "v0", "restitution")


def falling(draw: Draw, kind: str, e: float, mu: float) -> Start:
    """A turning body over the ground."""
    bodies, rng = Bodies(draw.rng), draw.rng
    shape, inertia = solid(rng, kind)
    R = random_turn(rng)
    bodies.wall(UP, 0.0)
    bodies.add(shape, inertia, R, lowest(shape, R, UP) * UP + [0.0, 0.0, rng.uniform(0.02, 0.05)])
    scene, q = bodies.scene()
    scene.set_contact(restitution=e, friction=mu)
    v = np.r_[rng.uniform(-1, 1, 2), -1.0 - rng.uniform(), rng.uniform(-3, 3, 3)]
    return scene, q, in_body(R, v)


def in_body(R: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return a velocity (6,) whose linear part is given in the world as that of a free joint."""
    return np.r_[R.T @ v[:3], v[3:]]


def drops(seeds: int) -> Iterator[Case]:
    """Bodies of all shapes that hit the ground, with all maps, restitutions and frictions."""
    kinds = (*SOLID, "ellipsoid")
    for kind, (impact, e, mu), order, seed in itertools.product(kinds, laws(), ORDERS, range(seeds)):
        draw = Draw(f"{kind} {impact} e {e} mu {mu} order {order} seed {seed}")

        def make(name: str = draw.name, kind: str = kind, e: float = e, mu: float = mu) -> Start:
            return falling(Draw(name), kind, e, mu)

        options = draw.options(0.12, order, impact=impact)
        yield Case(f"{kind} on the ground, {impact}", draw.name, make, options, parameters(e, mu))


def meeting(draw: Draw, kinds: tuple[str, str], e: float, mu: float) -> Start:
    """Two bodies that fly towards each other, no gravity."""
    rng = draw.rng
    bodies = Bodies(rng, gravity=0.0)
    side = random_turn(rng)[:, 0]
    turns = [random_turn(rng) for _ in kinds]
    made = [solid(rng, kind) for kind in kinds]
    apart = sum(radius_of(shape) for shape, _ in made) + 0.05
    for (shape, inertia), R, sign in zip(made, turns, (-0.5, 0.5), strict=True):
        bodies.add(shape, inertia, R, sign * apart * side + rng.uniform(-0.02, 0.02, 3))
    scene, q = bodies.scene()
    scene.set_contact(restitution=e, friction=mu)
    v = [in_body(R, np.r_[-sign * 3.0 * side, rng.uniform(-3, 3, 3)]) for R, sign in zip(turns, (-1, 1), strict=True)]
    return scene, q, np.concatenate(v)


def collisions(seeds: int) -> Iterator[Case]:
    """Two free bodies of all pairs of shapes."""
    kinds = (*SOLID, "ellipsoid")
    some = (("ctec", 0.7, 0.0), ("ctec", 0.7, 0.2), ("dtec", 0.3, 0.0), ("mhc", 1.0, 0.0))
    for pair in itertools.combinations_with_replacement(kinds, 2):
        for (impact, e, mu), seed in itertools.product(some, range(seeds)):
            draw = Draw(f"{pair} {impact} {e} {mu} {seed}")
            order = int(draw.rng.choice(ORDERS[1:] if impact == "mhc" else ORDERS))

            def make(name: str = draw.name, pair: tuple[str, str] = pair, e: float = e, mu: float = mu) -> Start:
                return meeting(Draw(name), pair, e, mu)

            options = draw.options(0.1, order, impact=impact)
            yield Case(f"{pair[0]} against {pair[1]}", f"{draw.name} order {order}", make, options, parameters(e, mu))


def stopped(draw: Draw, kinds: list[Any], e: float) -> Start:
    """A chain whose first joints swing to their limits, beside springs."""
    scene, rng = chain(kinds, int(draw.rng.integers(1000)))
    q, v, _ = state_of(scene, rng)
    for k in range(len(kinds)):
        scene.set_joint(f"j{k}", limits=(q[k] - rng.uniform(0.05, 0.2), q[k] + rng.uniform(0.05, 0.2)), restitution=e)
    return scene, q, v


def limits(seeds: int) -> Iterator[Case]:
    """Chains that hit the limits of their joints."""
    chains = {"revolute": JOINTS["revolute"][:2], "prismatic": FAMILIES["prismatic"][:2]}
    maps = ("ctec", "dtec", "mhc")
    for (name, kinds), impact, e, order, seed in itertools.product(
        chains.items(), maps, RESTITUTIONS, ORDERS, range(seeds)
    ):
        draw = Draw(f"{name} {impact} {e} {order} {seed}")

        def make(name: str = draw.name, kinds: list[Any] = kinds, e: float = e) -> Start:
            return stopped(Draw(name), kinds, e)

        wrt = ("q0", "v0", "restitution") + (("control",) if impact == "ctec" else ())
        yield Case(f"joint limits, {impact}", draw.name, make, draw.options(0.2, order, impact=impact), wrt)


def corridor(draw: Draw, kind: str) -> Start:
    """A body between ground and ceiling."""
    bodies, rng = Bodies(draw.rng, gravity=0.0), draw.rng
    shape, inertia = solid(rng, kind)
    R, half = random_turn(rng), 0.03
    bodies.wall(UP, -radius_of(shape) - half)
    bodies.wall(-UP, -radius_of(shape) - half)
    bodies.add(shape, inertia, R, np.zeros(3))
    scene, q = bodies.scene()
    scene.set_contact(restitution=0.9, friction=float(rng.choice(FRICTIONS)))
    return scene, q, in_body(R, np.r_[0.5, 0.3, 2.0, rng.uniform(-2, 2, 3)])


def row(draw: Draw, kind: str) -> Start:
    """Three bodies in a row, the first of which hits the second, and so on; no gravity."""
    rng = draw.rng
    bodies, at = Bodies(rng, gravity=0.0), 0.0
    turns = []
    for _ in range(3):
        shape, inertia = solid(rng, kind, 0.05)
        at += radius_of(shape)
        turns.append(random_turn(rng))
        bodies.add(shape, inertia, turns[-1], np.r_[at, rng.uniform(-0.01, 0.01, 2)])
        at += radius_of(shape) + 0.02
    scene, q = bodies.scene()
    scene.set_contact(restitution=0.8)
    v = [in_body(turns[0], np.r_[4.0, 0.0, 0.0, 0.0, 0.0, 0.0]), np.zeros(12)]
    return scene, q, np.concatenate(v)


def sequences(seeds: int) -> Iterator[Case]:
    """Several impacts in a row."""
    for kind, order, seed in itertools.product(SOLID, ORDERS, range(seeds)):
        for what, make in (("between two walls", corridor), ("three in a row", row)):
            draw = Draw(f"{what} {kind} {order} {seed}")
            options = draw.options(0.16, order)

            def start(make: Callable[[Draw, str], Start] = make, name: str = draw.name, kind: str = kind) -> Start:
                return make(Draw(name), kind)

            yield Case(f"several impacts: {what}", draw.name, start, options, ("q0", "v0", "restitution"))


def all_cases(seeds: int = 1) -> list[Case]:
    """Return all cases."""
    families = (smooth, elements, drops, collisions, limits, sequences)
    return [case for family in families for case in family(seeds)]
