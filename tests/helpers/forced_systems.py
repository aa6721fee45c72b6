"""Forced and constrained systems from models/, which are compared with the oracle."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import contactvi as cvi
from oracles import forced

MODELS = Path(__file__).resolve().parents[2] / "models"


@dataclass(frozen=True)
class System:
    """A scene, its start (guess and speed, made consistent), and forces of its joints for the oracle.

    duration [s]; dt: the coarse step [s], a fourth of which still divides duration / 4.
    """

    name: str
    scene: Callable[[], cvi.Scene]
    guess: dict = field(default_factory=dict)
    speed: dict = field(default_factory=dict)
    forces: tuple[forced.Force, ...] = ()
    duration: float = 1.0
    dt: float = 0.01
    fixed: tuple[str, ...] = ()

    def start(self) -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
        scene = self.scene()
        q = scene.assemble(scene.configuration(self.guess), fixed=self.fixed)
        return scene, q, scene.consistent_velocity(q, scene.velocity(self.speed))


def sine(amplitude: float, omega: float, offset: float = 0.0) -> Callable[[float], tuple[float, float, float]]:
    return lambda t: (
        offset + amplitude * math.sin(omega * t),
        amplitude * omega * math.cos(omega * t),
        -amplitude * omega**2 * math.sin(omega * t),
    )


def model(name: str, **options) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_urdf(MODELS / f"{name}.urdf", limits=False, **options)
    return scene


def cart() -> cvi.Scene:
    scene = model("cart_pendulum")
    scene.prescribe("slide", sine(0.2, 5.0), name="drive")
    return scene


def four_bar() -> cvi.Scene:
    scene = model("four_bar")
    scene.add_point("world", "rocker", (1, 0, 0), (0.7, 0, 0), name="loop")
    return scene


def hinged_four_bar() -> cvi.Scene:
    """Closed by a hinge, a screw without pitch: of its 5 rows a planar loop needs 2."""
    scene, across = model("four_bar"), (0.5 * math.pi, 0, 0)
    scene.add_screw("world", "rocker", 0.0, ((1, 0, 0), across), ((0.7, 0, 0), across), name="loop")
    return scene


FOUR_BAR = {"hinge_crank": 0.4, "hinge_coupler": 0.5, "hinge_rocker": -2.3}


def lift(stages: int = 3) -> cvi.Scene:
    scene = model("scissor_lift")
    scene.add_point("foot", "b1", (0, 0, 0), (0.5, 0, 0), name="foot")
    for k in range(1, stages):
        scene.add_point(f"a{k}", f"b{k + 1}", (1, 0, 0), (0.5, 0, 0), name=f"loop_{k}")
    scene.add_point(f"a{stages}", "top", (1, 0, 0), (0, 0, 0), name="top")
    return scene


def driven_lift() -> cvi.Scene:
    scene = lift()
    scene.prescribe("foot_slide", sine(0.2, 3.0, 0.7), name="motor")
    return scene


def pushed_lift() -> cvi.Scene:
    scene = lift()
    scene.add_wrench("foot", lambda t: (-250.0 - 60.0 * math.sin(7.0 * t), 0.0, 0.0), name="push")
    return scene


LIFT = {"hinge_a1": 0.8, "hinge_platform": 0.8, "foot_slide": 0.7, "top_slide": 0.7} | {
    f"hinge_{side}{k}": sign * 1.6 for k in (1, 2, 3) for side, sign in (("a", 1), ("b", -1)) if (side, k) != ("a", 1)
}


def nut_on_a_bar() -> cvi.Scene:
    """The screw is along a swinging bar."""
    scene = model("damped_pendulum")
    scene.add_cylinder("nut", radius=0.1, length=0.05, mass=0.7, placement=(0, 0, -0.4))
    frame = (0, 0, -0.4), (0, 0, 0.3)
    scene.add_screw("bar", "nut", 0.02, frame, ((0.0, 0.02, 0.0), (0, 0, 0.3)), name="thread")
    scene.add_wrench("nut", torque=lambda t: (0.0, 0.0, 0.2 * math.cos(4.0 * t)), axes="body", name="key")
    return scene


STRINGS = ("left_shoulder", "right_shoulder", "back", "left_hand", "left_knee", "right_hand", "right_knee")


def puppet() -> cvi.Scene:
    scene = model("puppet", base="free", placement=(0, 0, 1))
    for side, y in (("left", 0.1), ("right", -0.1)):
        scene.add_distance("world", "torso", (0.0, y, 1.9), (0.0, y, 0.17), 0.73, f"{side}_shoulder")
    scene.add_distance("world", "torso", (-0.35, 0, 1.9), (-0.05, 0, -0.15), 1.07, "back")
    for side, y, sign in (("left", 0.13, 1.0), ("right", -0.13, -1.0)):
        hand, knee = sine(sign * 0.08, 4.0, 0.8), sine(-sign * 0.06, 4.0, 1.1)
        scene.add_distance("world", f"{side}_forearm", (0.3, 1.5 * y, 1.9), (0, 0, -0.16), hand, f"{side}_hand")
        scene.add_distance("world", f"{side}_thigh", (0.25, y, 1.9), (0, 0, -0.2), knee, f"{side}_knee")
    return scene


PUPPET = {
    f"{side}_{joint}": angle
    for side in ("left", "right")
    for joint, angle in (("shoulder_swing", 0.5), ("elbow", 0.8), ("hip_swing", 0.5), ("knee", -0.5))
}


def net(n: int = 2, damping: float = 0.4) -> cvi.Scene:
    """Balls in a net of springs, one hung over a nail by a slack tape."""
    scene, pitch = cvi.Scene(), 0.1
    inner = range(1, n + 1)
    for i in inner:
        for j in inner:
            scene.add_sphere(f"knot_{i}{j}", radius=0.02, mass=0.1, placement=(i * pitch, j * pitch, 0.01 * i * j))

    def end(i: int, j: int):
        free = i in inner and j in inner
        return (f"knot_{i}{j}", (0, 0, 0.005)) if free else ("world", (i * pitch, j * pitch, 0))

    for i in inner:
        for j in range(n + 1):
            for a, b in ((end(i, j), end(i, j + 1)), (end(j, i), end(j + 1, i))):
                scene.add_spring(a[0], b[0], 40.0, rest_length=0.07, damping=damping, point_a=a[1], point_b=b[1])
    tape = [("knot_11", (0, 0, 0)), ("world", (0.15, 0.15, 0.3)), (f"knot_{n}{n}", (0, 0, 0))]
    scene.add_tape_spring(tape, 30.0, rest_length=0.4, damping=0.1)
    return scene


def welded_carts() -> cvi.Scene:
    """Two pendulums on carts that are one: of the 6 rows of the weld the two rails need 1."""
    scene = cvi.Scene()
    for prefix in ("left_", "right_"):
        scene.add_urdf(MODELS / "cart_pendulum.urdf", limits=False, prefix=prefix)
    scene.add_weld("left_cart", "right_cart", (0, 0, 0), name="weld")
    return scene


def geared() -> cvi.Scene:
    """Two joints of the four-bar's row, without its loop, coupled by a polynomial."""
    scene = model("four_bar")
    scene.add_joint_equality("hinge_rocker", "hinge_crank", (0.2, -1.0, 0.4), name="gear")
    return scene


SYSTEMS = [
    System("damped_pendulum", lambda: model("damped_pendulum"), {"hinge": 2.5}, {}, (forced.JointDamping([0.4]),)),
    System("cart_pendulum", cart, {"hinge": 0.5}),
    System("four_bar", four_bar, FOUR_BAR, {"hinge_crank": 3.0}, fixed=("hinge_crank",)),
    System("hinged_four_bar", hinged_four_bar, FOUR_BAR, {"hinge_crank": 3.0}, fixed=("hinge_crank",)),
    System("welded_carts", welded_carts, {"left_hinge": 1.0, "right_hinge": -0.4}, {"left_slide": 0.3}),
    System("driven_lift", driven_lift, LIFT),
    System("pushed_lift", pushed_lift, LIFT, duration=0.6),
    System("nut_on_a_bar", nut_on_a_bar, {"hinge": 1.0}, {}, (forced.JointDamping([0.4] + [0.0] * 6),)),
    System("puppet", puppet, PUPPET, {}, (forced.JointDamping([0.0] * 6 + [0.003] * 12),), 0.4, 0.005),
    System("net", net, {}, {"knot_11": (0.3, -0.2, 0.5)}, (), 0.4, 0.005),
    System("geared", geared, {"hinge_crank": 0.3, "hinge_coupler": 0.5}),
]
