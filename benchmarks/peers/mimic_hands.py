"""Hands with mimic joints, of four kinds that are sold, and the reference of their motion; needs pin, numpy, scipy.

The shapes are made up here: bones are rods of round lengths and masses. What each hand has of its kind is how many
joints it has, how many of them are free, and which follow which, also across the palm and in chains.

- inspire_kind: 12 joints, 6 free. The last joint of a finger follows its first; of the thumb two follow, in a chain.
- ability_kind: 10 joints, 6 free. The last joint of a finger follows with a large offset; the thumb is free.
- svh_kind: 20 joints, 9 free. Tips follow in chains, the spread and the bend of the palm follow across branches.
- barrett_kind: 8 joints, 4 free. Two fingers are spread against each other, the last joints follow.

All start at 0.4 rad in the free joints with random speeds of 1 rad/s (a fixed seed) and move for 1 s without damping,
friction, limits and contact, as the Allegro hand S3 does; nothing was tuned for them.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
from oracles.coupled import Coupled

Followers = dict[str, tuple[str, float, float]]  # joint: (leader, ratio, offset [rad])
Bone = tuple[str, float, float]  # name of its joint, length [m], mass [kg]
RADIUS = 0.008  # of a bone [m]
BEND, SPREAD, TWIST = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)  # axes; fingers point along z


class Hand:
    """A hand in the making: fingers on a palm that stands still.

    Branches are finished one after the other: Pinocchio's crba is wrong where the joints of a subtree have no
    successive numbers.
    """

    def __init__(self) -> None:
        self.model, self.followers = pin.Model(), Followers()

    def bone(self, parent: int, at: Any, bone: Bone, axis: Any = BEND, follows: Any = None) -> int:
        """Add a rod on a hinge; `at` is the hinge's place in the parent [m]."""
        name, length, mass = bone
        across = mass * length**2 / 12.0 + 0.25 * mass * RADIUS**2
        inertia = pin.Inertia(
            mass, np.array([0.001, 0.0, 0.5 * length]), np.diag([across, across, 0.5 * mass * RADIUS**2])
        )
        hinge = pin.JointModelRevoluteUnaligned(np.array(axis) / np.linalg.norm(axis))
        joint = self.model.addJoint(parent, hinge, pin.SE3(np.eye(3), np.array(at, dtype=float)), name)
        self.model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        if follows is not None:
            self.followers[name] = follows
        return joint

    def finger(self, parent: int, at: Any, bones: list[Bone], follows: list[Any]) -> None:
        """Add a finger whose joints all bend the same way."""
        for bone, leader in zip(bones, follows, strict=True):
            parent = self.bone(parent, at, bone, follows=leader)
            at = (0.0, 0.0, bone[1])


def inspire_kind() -> Hand:
    hand = Hand()
    for k, name in enumerate(("index", "middle", "ring", "little")):
        bones = [(f"{name}_1", 0.034, 0.016), (f"{name}_2", 0.044 - 0.003 * k, 0.012)]
        hand.finger(0, (0.0, 0.03 - 0.02 * k, 0.09), bones, [None, (f"{name}_1", 1.1, 0.05)])
    thumb = hand.bone(0, (0.01, 0.035, 0.03), ("thumb_turn", 0.02, 0.012), (0.3, 0.0, 1.0))
    bones = [("thumb_1", 0.035, 0.014), ("thumb_2", 0.022, 0.007), ("thumb_3", 0.02, 0.005)]
    hand.finger(thumb, (0.0, 0.01, 0.015), bones, [None, ("thumb_1", 1.5, 0.0), ("thumb_2", 0.6, 0.05)])
    return hand


def ability_kind() -> Hand:
    hand = Hand()
    for k, name in enumerate(("index", "middle", "ring", "little")):
        bones = [(f"{name}_1", 0.04, 0.022), (f"{name}_2", 0.045, 0.016)]
        hand.finger(0, (0.0, 0.03 - 0.02 * k, 0.1 - 0.004 * k), bones, [None, (f"{name}_1", 1.06, 0.7)])
    thumb = hand.bone(0, (0.015, 0.03, 0.03), ("thumb_turn", 0.03, 0.03), (0.4, 0.0, 1.0))
    hand.finger(thumb, (0.01, 0.02, 0.02), [("thumb_1", 0.06, 0.03)], [None])
    return hand


def svh_kind() -> Hand:
    hand = Hand()
    thumb = hand.bone(0, (0.02, 0.03, 0.02), ("thumb_turn", 0.03, 0.05), TWIST)
    bones = [("thumb_1", 0.05, 0.03), ("thumb_2", 0.035, 0.016), ("thumb_3", 0.025, 0.01)]
    hand.finger(thumb, (0.0, 0.02, 0.02), bones, [None, ("thumb_1", 1.0, 0.0), ("thumb_2", 1.4, 0.0)])
    palm = hand.bone(0, (0.0, -0.01, 0.02), ("palm", 0.06, 0.08), (0.0, 0.3, 1.0), ("thumb_turn", 0.9, 0.0))
    fingers = (
        ("ring", palm, (0.0, -0.01, 0.08), ("index_spread", -0.5, 0.0)),
        ("little", palm, (0.0, -0.03, 0.07), ("ring_spread", 2.0, 0.0)),
        ("index", 0, (0.0, 0.025, 0.1), None),
        ("middle", 0, (0.0, 0.003, 0.11), None),
    )
    for name, parent, at, spread in fingers:
        if name != "middle":
            parent, at = hand.bone(parent, at, (f"{name}_spread", 0.01, 0.012), SPREAD, spread), (0.0, 0.0, 0.01)
        bones = [(f"{name}_1", 0.048, 0.03), (f"{name}_2", 0.03, 0.014), (f"{name}_3", 0.024, 0.009)]
        second = None if name in ("index", "middle") else (f"{name}_1", 1.35, 0.0)
        hand.finger(parent, at, bones, [None, second, (f"{name}_2", 1.05, 0.0)])
    return hand


def barrett_kind() -> Hand:
    hand = Hand()
    for k, name in enumerate(("one", "two", "three")):
        parent, at = 0, (0.05, 0.0, 0.08)
        if name != "three":
            leader = None if name == "one" else ("one_spread", -1.0, 0.0)
            parent = hand.bone(0, (-0.03, 0.025 - 0.05 * k, 0.08), (f"{name}_spread", 0.05, 0.14), TWIST, leader)
            at = (0.0, 0.0, 0.03)
        bones = [(f"{name}_1", 0.07, 0.06), (f"{name}_2", 0.058, 0.04)]
        hand.finger(parent, at, bones, [None, (f"{name}_1", 0.35, 0.7)])
    return hand


HANDS = {make.__name__: make for make in (inspire_kind, ability_kind, svh_kind, barrett_kind)}


def start(hand: Hand) -> tuple[np.ndarray, np.ndarray]:
    """Configuration and velocity of all joints, (nv,) each."""
    coupled = Coupled(hand.model, hand.followers)
    n = len(coupled.free)
    return coupled.q(np.full(n, 0.4)), coupled.S @ np.random.default_rng(3).standard_normal(n)


def motion(
    model: pin.Model, followers: Followers, q0: np.ndarray, v0: np.ndarray, times: np.ndarray, **options: Any
) -> np.ndarray:
    """q at the times, (times, nq), of the equations in the free joints (tests/oracles/coupled.py)."""
    coupled = Coupled(model, followers)
    n = len(coupled.free)

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[n:], coupled.acceleration(y[:n], y[n:])])

    begin = np.concatenate([q0[coupled.free], v0[coupled.free]])
    found = solve_ivp(rate, (0.0, times[-1]), begin, t_eval=times, **options)
    return np.array([coupled.q(y) for y in found.y[:n].T])
