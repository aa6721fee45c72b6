"""Random elements of a scene (forces, prescribed motions, constraints): one function per kind of element.

Constraints are made at the positions of the bodies at the start, so that every start satisfies them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

import contactvi as cvi
from batteries.contact_scenes import WORLD, random_turn


@dataclass
class Built:
    """A scene under construction: its start, its bodies, its joints with one coordinate, and its elements.

    driven_elements: names of the elements that prescribe a motion. inputs: something else does work. constrained: there
    are constraints or joint friction. python: there are functions of the user. closed: all bodies are free, and only
    contact, gravity and `pushes` [N] (constant forces) change the sum of their momenta.
    """

    rng: np.random.Generator
    scene: cvi.Scene
    q: np.ndarray
    v: np.ndarray
    bodies: list[str]
    joints: list[str]
    driven_elements: list[str] = field(default_factory=list)
    inputs: bool = False
    constrained: bool = False
    python: bool = False
    closed: bool = True
    pushes: np.ndarray = field(default_factory=lambda: np.zeros(3))
    elements: list[str] = field(default_factory=list)

    @property
    def driven(self) -> bool:
        """Whether a motion is prescribed."""
        return bool(self.driven_elements)

    def value(self, joint: str) -> float:
        """Coordinate of the joint at the start [rad or m]."""
        return float(self.q[self.scene.q_index(joint)][0])

    def place(self, body: str) -> pin.SE3:
        """Pose of a body at the start; bodies are named by their joints."""
        if body == "world":
            return WORLD
        model = self.scene.model
        data = model.createData()
        pin.forwardKinematics(model, data, self.q)
        return data.oMi[model.getJointId(body)]

    def two(self, world: float = 0.3) -> tuple[str, str]:
        """Two bodies, the first one the world with this probability, or where there is but one body."""
        a, b = self.rng.choice(self.bodies, 2, replace=len(self.bodies) == 1)
        if a == b or self.rng.random() < world:
            a = "world"
        self.closed &= a != "world"
        return str(a), str(b)

    def point(self, body: str, size: float = 0.08) -> np.ndarray:
        """A point of a body; of the world one above the start of the bodies."""
        if body == "world":
            return np.array([*self.rng.uniform(-0.5, 0.5, 2), self.rng.uniform(0.8, 1.6)])
        return self.rng.uniform(-size, size, 3)


# --- elements ---------------------------------------------------------------------------------------------------------
def damping(b: Built) -> None:
    b.scene.set_joint(str(b.rng.choice(b.joints or b.bodies[-1:])), damping=float(b.rng.choice([0.02, 0.3, 3.0])))
    b.closed &= bool(b.joints)


def joint_friction(b: Built) -> None:
    for joint in b.joints:
        if b.rng.integers(2):
            b.scene.set_joint(joint, friction=float(b.rng.choice([0.05, 1.0, 100.0])))
            b.constrained = True


def polynomial(b: Built) -> None:
    for joint in b.joints[:2]:
        k = b.rng.uniform([1.0, -3.0, 1.0], [30.0, 3.0, 30.0])
        b.scene.set_joint(joint, spring=list(k), rest=b.value(joint) + float(b.rng.uniform(-0.3, 0.3)))


def spring(b: Built) -> None:
    one, two = b.two()
    points = b.point(one), b.point(two)
    length = float(np.linalg.norm(b.place(one) * points[0] - b.place(two) * points[1]))
    b.scene.add_spring(
        one, two, float(b.rng.choice([20.0, 300.0, 3e3])), rest_length=length * float(b.rng.uniform(0.5, 1.1)),
        damping=float(b.rng.choice([0.0, 1.0, 30.0])), point_a=points[0], point_b=points[1],
        tension_only=bool(b.rng.integers(2)),
    )  # fmt: skip


def tape(b: Built) -> None:
    bodies = ["world", *b.rng.permutation(b.bodies)[:3]]
    b.closed = False
    along = [(str(body), b.point(str(body))) for body in bodies]
    places = [b.place(body) * xyz for body, xyz in along]
    length = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    b.scene.add_tape_spring(
        along, float(b.rng.choice([50.0, 500.0])), rest_length=0.9 * length, damping=float(b.rng.choice([0.0, 2.0])),
        tension_only=bool(b.rng.integers(2)),
    )  # fmt: skip


def push(b: Built) -> None:
    force, body = b.rng.uniform(-3, 3, 3), str(b.rng.choice(b.bodies))
    b.scene.add_wrench(body, force, b.rng.uniform(-0.2, 0.2, 3), point=b.point(body))
    b.pushes, b.inputs = b.pushes + force, True


def shake(b: Built) -> None:
    size, rate = b.rng.uniform(-4, 4, 3), float(b.rng.uniform(3, 12))
    b.scene.add_wrench(str(b.rng.choice(b.bodies)), lambda t: size * math.sin(rate * t), axes="body")
    b.inputs, b.python, b.closed = True, True, False


def drag(b: Built) -> None:
    c = float(b.rng.uniform(0.05, 0.5))
    b.scene.add_force(lambda t, q, v: -c * v, lambda t, q, v: (0.0 * np.eye(len(v)), -c * np.eye(len(v))))
    b.inputs, b.python, b.closed = True, True, False


def well(b: Built) -> None:
    """k/2 |x - x0|^2 of one joint, or of the position of one free body."""
    k = float(b.rng.choice([5.0, 100.0]))
    name = str(b.rng.choice(b.joints or b.bodies))
    index, dof, nv = b.scene.q_index(name).start, b.scene.v_index(name).start, b.scene.nv
    if b.joints:
        x0, hessian = b.value(name) + 0.1, np.zeros((nv, nv))
        hessian[dof, dof] = k
        b.scene.add_potential(
            lambda q: 0.5 * k * (q[index] - x0) ** 2,
            lambda q: np.eye(nv)[dof] * k * (q[index] - x0),
            lambda q: hessian,
        )
        b.python = True
        return
    place, b.closed, b.python = b.q[index : index + 3] + 0.1, False, True

    def gradient(q: np.ndarray) -> np.ndarray:
        turn = pin.Quaternion(q[index + 3 : index + 7]).matrix()
        force = np.zeros(nv)
        force[dof : dof + 3] = k * turn.T @ (q[index : index + 3] - place)
        return force

    b.scene.add_potential(lambda q: 0.5 * k * float(np.sum((q[index : index + 3] - place) ** 2)), gradient)


def servo(b: Built) -> None:
    for joint in b.joints:
        if b.rng.integers(2):
            target = b.value(joint) + float(b.rng.uniform(-0.5, 0.5))
            kp = float(b.rng.choice([5.0, 50.0, 1e3]))
            b.scene.set_servo(joint, kp, 0.05 * kp, effort=float(b.rng.choice([1.0, 10.0])), target=target)
            b.inputs = True


def prescribe(b: Built, joint: str = "") -> None:
    joint = joint or str(b.rng.choice(b.joints))
    a, w, x0 = float(b.rng.uniform(0.05, 0.3)), float(b.rng.uniform(3, 12)), b.value(joint)
    b.scene.set_joint(joint, friction=0.0, limits=False)
    b.scene.prescribe(
        joint, lambda t: (x0 + a * math.sin(w * t), a * w * math.cos(w * t), -a * w * w * math.sin(w * t)), name="drive"
    )
    b.driven_elements.append("drive")
    b.constrained = b.python = True


def distance(b: Built, winch: bool = False) -> None:
    one, two = b.two(0.5)
    points = b.point(one), b.point(two)
    length = float(np.linalg.norm(b.place(one) * points[0] - b.place(two) * points[1]))
    a, w = 0.1 * length, float(b.rng.uniform(2, 10))
    motion = (lambda t: (length + a * math.sin(w * t), a * w * math.cos(w * t), -a * w * w * math.sin(w * t)),)
    name = b.scene.add_distance(one, two, *points, motion[0] if winch else length)
    b.constrained = True
    b.python |= winch
    b.driven_elements += [name] * winch


def winch(b: Built) -> None:
    distance(b, True)


def point(b: Built) -> None:
    one, two = b.two()
    xyz = b.place(two) * b.point(two)
    b.scene.add_point(one, two, b.place(one).actInv(xyz), b.place(two).actInv(xyz))
    b.constrained = True


def weld(b: Built) -> None:
    one, two = b.two(0.15)
    b.scene.add_weld(one, two, b.place(one).actInv(b.place(two)))
    b.constrained = True


def screw(b: Built) -> None:
    one, two = b.two()
    frame = pin.SE3(random_turn(b.rng), b.rng.uniform(-0.05, 0.05, 3))
    frames = frame, b.place(two).actInv(b.place(one) * frame)
    b.scene.add_screw(one, two, float(b.rng.choice([0.0, 0.02, 0.2])), *frames)
    b.constrained = True


def equality(b: Built) -> None:
    one, two = (str(j) for j in b.rng.choice(b.joints, 2, replace=False))
    c1, c2 = float(b.rng.choice([-1.0, 0.5, 2.0])), float(b.rng.choice([0.0, 0.4]))
    x = b.value(two)
    b.scene.add_joint_equality(one, two, (b.value(one) - c1 * x - c2 * x**2, c1, c2))
    b.constrained = True


def twice(b: Built) -> None:
    """Some constraint again, under another name: a redundant one."""
    known = [e for e in b.scene.elements if e.kind in ("point", "weld", "distance", "screw", "equality")]
    if known:
        e = known[int(b.rng.integers(len(known)))]
        ends = (e.joint, e.other) if e.kind == "equality" else (e.a, e.b)
        rest = {
            "point": lambda: (e.point_a, e.point_b), "weld": lambda: (e.placement,),
            "distance": lambda: (e.point_a, e.point_b, e.length and e.length.source),
            "screw": lambda: (e.pitch, e.frame_a, e.frame_b), "equality": lambda: (e.coefficients,),
        }[e.kind]()  # fmt: skip
        add = {"equality": "add_joint_equality"}.get(e.kind, f"add_{e.kind}")
        getattr(b.scene, add)(*ends, *rest)


FORCES = (damping, spring, tape, push, shake, drag, well)
JOINT_FORCES = (*FORCES, joint_friction, polynomial, servo)
CLOSED = (distance, winch, point, weld, screw)
