"""Scenes with loops, driven joints and lengths, and their starts: what derivatives are tested on."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

import contactvi as cvi
from helpers.loop_scenes import BAR, arm_scene, four_bar, four_bar_start

MODELS = Path(__file__).resolve().parents[2] / "models"
BALL = [0.6, -0.02, 1.245]  # such that the pin of the linkage meets it after 0.4 s
TWISTED = pin.SE3(pin.exp3(np.array([0.3, 0.5, -0.4])), np.array([0.3, 0.1, 0.2]))

Start = tuple[cvi.Scene, np.ndarray, np.ndarray]


def speeds(scene: cvi.Scene, size: float = 1.0) -> np.ndarray:
    return size * np.random.default_rng(1).standard_normal(scene.nv)


def crank(t: float) -> tuple[float, float, float]:
    return 0.3 * math.sin(2 * t), 0.6 * math.cos(2 * t), -1.2 * math.sin(2 * t)


def linkage(redundant: bool = False, joint_friction: float = 0.0) -> Start:
    scene = four_bar()
    if redundant:
        scene.add_point("world", "j3", (0.5, 0.0, 0.0), (BAR, 0.0, 0.0), name="again")
    if joint_friction:
        scene.set_joint("j2", friction=joint_friction)
    return scene, four_bar_start(scene), speeds(scene, 2.0)


def driven_joint(joint_friction: float = 0.0) -> Start:
    scene = arm_scene(3)
    if joint_friction:
        scene.set_joint("j1", friction=joint_friction)
    scene.prescribe("j1", crank)
    scene.set_joint("j2", damping=0.3)
    return scene, np.array([0.0, 0.3, 0.4]), speeds(scene)


def mixed_joints() -> Start:
    """A continuous joint that is driven, a ball joint and a screw, whose end hangs on a rod."""
    model = pin.Model()
    parent, place = 0, pin.SE3.Identity()
    helical = pin.JointModelHelicalUnaligned(np.array([0.0, 0.0, 1.0]), 0.05)
    for k, joint in enumerate((pin.JointModelRUBY(), pin.JointModelSpherical(), helical)):
        parent = model.addJoint(parent, joint, place, f"j{k + 1}")
        own = pin.Inertia(1.0, np.array([0.2, 0.02, 0.0]), np.diag([1e-3, 0.0133, 0.0133]))
        model.appendBodyToJoint(parent, own, pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0]))
    model.addFrame(pin.Frame("end", parent, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    scene = cvi.Scene.from_pinocchio(model, name="chain")
    scene.prescribe("j1", lambda t: (3.0 + 4.0 * t + t * t, 4.0 + 2.0 * t, 2.0))
    scene.add_distance("world", "end", (0.5, 0.1, 0.2), (0.4, 0.0, 0.1), length=0.9)
    return scene, scene.assemble(), speeds(scene)


def followers() -> Start:
    """A joint that follows another one along a parabola."""
    scene = arm_scene(3)
    scene.add_joint_equality("j3", "j1", (0.1, 0.5, 0.7))
    return scene, np.array([0.2, 0.3, 0.4]), speeds(scene)


def box_on_rod(driven: bool) -> Start:
    """A box on a massless rod, whose length may be driven."""
    scene = cvi.Scene()
    scene.add_box("bob", (0.1, 0.2, 0.3), mass=1.0)
    length = (lambda t: (1.0 + crank(t)[0], *crank(t)[1:])) if driven else 1.0
    scene.add_distance("world", "bob", point_b=(0.05, 0.02, 0.1), length=length)
    q = pin.neutral(scene.model)
    q[0] = 1.0
    return scene, q, speeds(scene)


def pair_of_bodies(join: Callable[[cvi.Scene], object]) -> Start:
    scene = cvi.Scene()
    scene.add_box("a", (0.1, 0.2, 0.3), mass=1.0)
    scene.add_cylinder("b", radius=0.1, length=0.1, mass=2.0)
    scene.disable_pair("a", "b")
    join(scene)
    return scene, scene.assemble(), speeds(scene, 2.0)


def chain_of_boxes() -> Start:
    """Three free boxes on ball joints between two fixed points."""
    scene = cvi.Scene()
    for name, mass in (("a", 1.0), ("b", 2.0), ("c", 2.0)):
        scene.add_box(name, (0.2, 0.1, 0.3), mass=mass)
    for one, other in (("a", "b"), ("b", "c"), ("a", "c")):
        scene.disable_pair(one, other)
    scene.add_point("world", "a", (0, 0, 1), (0.05, 0.1, 0.15))
    scene.add_point("a", "b", (-0.05, 0.1, -0.15), (0.1, 0, 0.15))
    scene.add_point("b", "c", (-0.1, 0, -0.15), (0.1, 0, 0.15))
    scene.add_point("c", "world", (-0.1, 0, -0.15), (0.7, 0.2, 1))
    q = pin.neutral(scene.model)
    for k, place in enumerate(([0, 0, 0.8], [0.2, 0, 0.6], [0.5, 0.1, 0.8])):
        q[7 * k : 7 * k + 3] = place
    return scene, scene.assemble(q), speeds(scene)


def parallelogram() -> Start:
    """A bar on three parallel cranks, one more than it needs: off the constraints these contradict each other."""
    model = pin.Model()
    rod = pin.Inertia(1.0, np.array([0.2, 0, 0]), np.diag([1e-4, 0.0133, 0.0133]))
    bar = pin.Inertia(1.5, np.array([0.4, 0, 0]), np.diag([1e-4, 0.08, 0.08]))
    first = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "c1")
    second = model.addJoint(first, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.4, 0, 0])), "bar")
    parts = {first: rod, second: bar}
    for k, name in ((1, "c2"), (2, "c3")):
        place = pin.SE3(np.eye(3), np.array([0.4 * k, 0, 0]))
        parts[model.addJoint(0, pin.JointModelRY(), place, name)] = rod
    for joint, inertia in parts.items():
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.gravity.linear = np.array([0, 0, -9.81])
    scene = cvi.Scene.from_pinocchio(model, name="parallelogram")
    scene.add_point("bar", "c2", (0.4, 0, 0), (0.4, 0, 0))
    scene.add_point("bar", "c3", (0.8, 0, 0), (0.4, 0, 0))
    return scene, np.array([1.1, -1.1, 1.1, 1.1]), np.array([1.0, -1.0, 1.0, 1.0])


def linkage_scene() -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_urdf(MODELS / "four_bar.urdf", limits=False)
    scene.add_point("world", "rocker", (1, 0, 0), (0.7, 0, 0), name="loop")
    return scene


def linkage_start(scene: cvi.Scene) -> tuple[np.ndarray, np.ndarray]:
    guess = {"hinge_crank": 0.4, "hinge_coupler": 0.5, "hinge_rocker": -2.3}
    q = scene.assemble(scene.configuration(guess), fixed=["hinge_crank"])
    return q, scene.consistent_velocity(q, scene.velocity({"hinge_crank": 5.0, "hinge_coupler": -5.0}))


def linkage_at_stop(restitution: float) -> Start:
    """The linkage of examples/four_bar_stop.py."""
    scene = linkage_scene()
    scene.add_halfspace(normal=(1, 0, 0), offset=0.55, name="stop")
    scene.set_contact(restitution=restitution, friction=0.0)
    return scene, *linkage_start(scene)


def striker(restitution: float, friction: float) -> Start:
    """That linkage strikes a ball that falls past it."""
    scene = linkage_scene()
    scene.add_sphere("ball", 0.05, mass=0.3)
    scene.set_contact(restitution=restitution, friction=friction)
    q, v = linkage_start(scene)
    q[3:6] = BALL
    v[3:] = [0.3, 0.1, 0.5, 1.0, 2.0, 0.5]
    return scene, q, v


def joined_balls(friction: float, joined: str = "point") -> Start:
    """Two balls with a ball joint between them that drop on the ground, one after the other."""
    scene = cvi.Scene()
    scene.add_sphere("a", 0.1)
    scene.add_sphere("b", 0.12)
    if joined == "point":
        scene.add_point("a", "b", (0.2, 0, 0.05), (-0.2, 0, 0.03))
    else:
        scene.add_distance("a", "b", (0.02, 0, 0.05), (-0.03, 0, 0.03), length=0.4)
    scene.add_halfspace()
    scene.set_contact(restitution=0.0, friction=friction)
    q = pin.neutral(scene.model)
    q[2], q[7:10] = 0.105, [0.4, 0, 0.13]
    return scene, q, np.array([1.0, 0.3, -0.1, 0.1, 0.2, 0.3, 1.0, 0.3, -0.1, 0.1, 0.2, 0.3])


def ball_with_pendulum(friction: float, push: float) -> Start:
    """A ball on the ground that carries a swinging box on a ball joint: it rolls or slides."""
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.3, mass=2.0)
    scene.add_box("bob", (0.1, 0.05, 0.2), mass=0.5)
    scene.add_point("ball", "bob", (0.0, 0.4, 0.0), (0.0, 0.0, 0.2))
    scene.add_halfspace(name="ground")
    scene.disable_pair("ball", "bob")
    scene.disable_pair("bob", "ground")
    scene.set_contact(restitution=0.0, friction=friction)
    q = pin.neutral(scene.model)
    q[2], q[7:10] = 0.302, [0.0, 0.4, 0.102]
    return scene, q, np.array([push, 0.1, -0.05, 0.2, 0.3, 0.1, push, 0.1, -0.05, 0.3, 0.5, 0.0])


def pair_on_ball(friction: float) -> Start:
    """A ball that drops on a fixed one, rolls or slides down with a box on a ball joint, and leaves it."""
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    scene.add_box("bob", (0.1, 0.05, 0.1), mass=0.3)
    scene.add_sphere("big", 0.5, free=False)
    scene.add_point("ball", "bob", (0.0, 0.15, 0.0), (0.0, -0.05, 0.0))
    for one, other in (("ball", "bob"), ("bob", "big")):
        scene.disable_pair(one, other)
    scene.set_contact(restitution=0.0, friction=friction)
    q = pin.neutral(scene.model)
    q[:3], q[7:10] = [0.3, 0.05, 0.615], [0.3, 0.25, 0.615]
    return scene, q, np.array([0.3, 0.0, -0.3, 0.2, 0.1, 0.3, 0.3, 0.0, -0.3, 0.1, 0.3, 0.2])


def towed_ball(motion: object, friction: float = 0.1) -> Start:
    """A ball that slides off a fixed one, on a rod of driven length to a free box."""
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    scene.add_box("box", (0.1, 0.1, 0.1), mass=0.2)
    scene.add_sphere("big", 0.5, free=False)
    scene.add_distance("ball", "box", (0.0, -0.1, 0.0), (0.0, 0.02, 0.03), length=motion)
    for other in ("ball", "big"):
        scene.disable_pair("box", other)
    scene.set_contact(restitution=0.0, friction=friction)
    q = pin.neutral(scene.model)
    q[:3], q[7:10] = [0.3, 0.05, 0.615], [0.3, -0.4, 0.615]
    return scene, q, np.array([0.3, 0.0, -0.3, 0.2, 0.1, 0.3, 0.3, 0.0, -0.3, 0.0, 0.1, 0.0])


def winch(t: float) -> tuple[float, float, float]:
    return 0.35 + 0.05 * math.sin(9 * t), 0.45 * math.cos(9 * t), -4.05 * math.sin(9 * t)


def arm_over_floor(restitution: float, friction: float) -> cvi.Scene:
    """An arm of three joints, whose tip is round."""
    model = pin.Model()
    parent, place = 0, pin.SE3.Identity()
    for k in range(3):
        parent = model.addJoint(parent, pin.JointModelRY(), place, f"j{k + 1}")
        rod = pin.Inertia(1.0, np.array([0.2, 0.0, 0.0]), np.diag([1e-4, 0.0133, 0.0133]))
        model.appendBodyToJoint(parent, rod, pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, 0, place, pin.FrameType.BODY))
    geometry = pin.GeometryModel()
    geometry.addGeometryObject(pin.GeometryObject("tip", parent, place, coal.Sphere(0.05)))
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    scene = cvi.Scene.from_pinocchio(model, geometry, name="arm")
    scene.add_halfspace([0.0, 0.0, 1.0], -0.5, name="floor")
    scene.set_contact(restitution=restitution, friction=friction)
    return scene


def driven_arm_at_wall(restitution: float, friction: float) -> Start:
    """An arm of three joints, whose first one is driven, swings its tip on a wall."""
    scene = arm_over_floor(restitution, friction)
    scene.prescribe("j1", lambda t: (0.1 + crank(t)[0], *crank(t)[1:]))
    return scene, np.array([0.1, 0.2, -0.3]), np.array([0.6, 0.2, 0.4])


def following_finger(restitution: float, friction: float, joint_friction: float = 0.0) -> Start:
    """An arm of three joints, whose last one follows the one before, that drops its tip on the floor."""
    scene = arm_over_floor(restitution, friction)
    scene.add_joint_equality("j3", "j2", (-0.4, 0.5, 0.3))
    scene.set_joint("j1", friction=joint_friction)
    return scene, scene.assemble(np.array([0.1, 0.2, -0.3])), np.array([0.6, 0.2, 0.1])


def five_bar_leg(restitution: float, friction: float, joint_friction: float = 0.0) -> Start:
    """A free body on a leg of four rods that close a loop at the foot, a ball, which drops on the ground."""
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia(2.0, np.zeros(3), np.diag([0.02, 0.03, 0.025])), pin.SE3.Identity())
    rod = pin.Inertia(0.5, np.array([0.1, 0.0, 0.0]), np.diag([1e-3, 4e-3, 4e-3]))
    for side, x in (("left", -0.05), ("right", 0.05)):
        parent, place = base, pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        for part in ("thigh", "shank"):
            parent = model.addJoint(parent, pin.JointModelRY(), place, f"{side} {part}")
            model.appendBodyToJoint(parent, rod, pin.SE3.Identity())
            model.addFrame(pin.Frame(f"{side}_{part}", parent, 0, pin.SE3.Identity(), pin.FrameType.BODY))
            place = pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.0]))
    geometry = pin.GeometryModel()
    geometry.addGeometryObject(pin.GeometryObject("foot", parent, place, coal.Sphere(0.03)))
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    scene = cvi.Scene.from_pinocchio(model, geometry, name="leg")
    scene.add_halfspace(name="ground")
    scene.add_point("left_shank", "right_shank", (0.2, 0.0, 0.0), (0.2, 0.0, 0.0), name="foot")
    scene.set_contact(restitution=restitution, friction=friction)
    for name in ("left thigh", "right thigh"):
        scene.set_joint(name, stiffness=20.0, damping=0.1, friction=joint_friction)
    q = scene.assemble(
        scene.configuration({"left thigh": 2.2, "left shank": -1.1, "right thigh": 0.9, "right shank": 1.1})
    )
    q[2] = 0.38
    return scene, q, np.array([0.4, 0.1, -0.3, 0.2, -0.3, 0.4, 0.5, -0.4, 0.3, 0.6])


def gripper(friction: float, joint_friction: float = 0.0) -> Start:
    """A ball between a finger that is driven and one on a spring, which close on it and shake it."""
    model = pin.Model()
    geometry = pin.GeometryModel()
    for name, x in (("driven", -0.08), ("sprung", 0.07)):
        joint = model.addJoint(0, pin.JointModelPX(), pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), name)
        model.appendBodyToJoint(joint, pin.Inertia(0.4, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
        shape = pin.GeometryObject(f"{name} finger", joint, pin.SE3.Identity(), coal.Box(0.02, 0.3, 0.3))
        geometry.addGeometryObject(shape)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    scene = cvi.Scene.from_pinocchio(model, geometry, name="gripper")
    scene.add_sphere("ball", 0.05, mass=0.2)
    scene.disable_pair("driven finger", "sprung finger")
    scene.set_contact(restitution=0.0, friction=friction)
    scene.set_joint("sprung", stiffness=400.0, rest=-0.03, damping=2.0, friction=joint_friction)
    scene.prescribe("driven", lambda t: (0.03 * math.sin(12 * t), 0.36 * math.cos(12 * t), -4.32 * math.sin(12 * t)))
    q = scene.assemble()
    q[2:5] = [0.0, 0.01, 0.02]
    return scene, q, np.array([0.36, -0.1, 0.1, 0.2, 0.3, 1.0, -2.0, 0.5])


def welded_boxes(restitution: float, friction: float) -> Start:
    """Two boxes with a weld between them that drop on a corner."""
    scene = cvi.Scene()
    base = pin.SE3(pin.exp3(np.array([0.4, 0.6, 0.1])), np.array([0.0, 0.0, 0.18]))
    scene.add_box("a", (0.1, 0.1, 0.1), mass=1.0, placement=base)
    scene.add_box("b", (0.1, 0.08, 0.06), mass=0.5, placement=base * pin.SE3(np.eye(3), np.array([0.15, 0.0, 0.02])))
    scene.disable_pair("a", "b")
    scene.add_weld("a", "b", name="weld")
    scene.add_halfspace(name="ground")
    scene.set_contact(restitution=restitution, friction=friction)
    return scene, scene.assemble(), np.r_[0.5, 0.2, -1.0, 0.5, -1.0, 0.7, 0.5, 0.2, -1.0, 0.5, -1.0, 0.7]


def balls_on_a_lift(restitution: float, friction: float) -> Start:
    """Two balls that fall on a plate which goes up and down, one shortly after the other."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "lift")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    geometry = pin.GeometryModel()
    geometry.addGeometryObject(pin.GeometryObject("plate", joint, pin.SE3.Identity(), coal.Box(2.0, 2.0, 0.02)))
    scene = cvi.Scene.from_pinocchio(model, geometry, name="lift")
    for k in range(2):
        scene.add_sphere(f"ball_{k}", 0.05, mass=0.3)
    scene.set_contact(restitution=restitution, friction=friction)
    scene.prescribe("lift", lambda t: (0.03 * math.sin(9 * t), 0.27 * math.cos(9 * t), -2.43 * math.sin(9 * t)))
    q, v = pin.neutral(scene.model), np.r_[0.27, [0.3, 0.1, -0.3, 1.0, 2.0, 0.5] * 2]
    q[1:4], q[8:11] = [0.0, 0.0, 0.065], [0.3, 0.1, 0.067]
    return scene, q, v


def swing(t: float) -> tuple[pin.SE3, tuple[np.ndarray, np.ndarray]]:
    """The pose and the velocity of a frame that turns about changing axes while it moves."""
    angles = np.array([0.3 * math.sin(2 * t), 0.5 * t, 0.2 * t * t])
    rates = np.array([0.6 * math.cos(2 * t), 0.5, 0.4 * t])
    place = np.array([0.1 * math.sin(2 * t), 0.2 * t, 0.05 * math.cos(3 * t)])
    speed = np.array([0.2 * math.cos(2 * t), 0.2, -0.15 * math.sin(3 * t)])
    R = pin.exp3(angles)
    return pin.SE3(R, place), (speed, R @ pin.Jexp3(angles) @ rates)


def moved_pendulum() -> Start:
    """A box that hangs on a body with a prescribed pose, on a ball joint beside its origin."""
    scene = cvi.Scene()
    scene.add_box("wrist", (0.1, 0.2, 0.3), mass=1.0)
    scene.add_box("bob", (0.1, 0.05, 0.2), mass=0.5)
    scene.disable_pair("wrist", "bob")
    scene.prescribe("wrist", swing, name="motion")
    scene.add_point("wrist", "bob", (0.1, 0.05, -0.2), (0.0, 0.02, 0.2))
    q, _ = on_constraints(scene, pin.neutral(scene.model), np.zeros(scene.nv))
    return scene, q, speeds(scene, 0.5)


def ball_on_moved_plate(restitution: float, friction: float, shake: float = 0.0) -> Start:
    """A ball falls on a plate that turns, moves and, with a shake [m], is torn down from under it."""

    def motion(t: float) -> tuple[pin.SE3, tuple[np.ndarray, np.ndarray]]:
        place, (speed, turn) = swing(t)
        place.translation[2] += shake * math.sin(15 * t)
        return place, (speed + [0.0, 0.0, 15 * shake * math.cos(15 * t)], turn)

    scene = cvi.Scene()
    scene.add_box("plate", (1.5, 1.5, 0.02), mass=1.0)
    scene.add_sphere("ball", 0.1, mass=0.5)
    scene.prescribe("plate", motion, name="motion")
    scene.set_contact(restitution=restitution, friction=friction)
    q, v = on_constraints(scene, pin.neutral(scene.model), np.zeros(scene.nv))
    q[7:10] = [0.05, 0.03, q[2] + 0.115]
    v[6:] = [0.3, 0.4, -0.2, 1.0, -0.5, 0.3]
    return scene, q, v


def on_constraints(scene: cvi.Scene, q: np.ndarray, v: np.ndarray, t: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The state near (q, v) that satisfies the constraints to rounding, by Newton steps of least length."""
    core = scene.core()
    for _ in range(20):
        back = np.linalg.pinv(np.asarray(core.constraint_jacobian(q, t)), rcond=1e-7)
        step = back @ np.asarray(core.constraint_residual(q, t))
        q = pin.integrate(scene.model, q, -step)
        if np.abs(step).max() < 1e-15:
            break
    J = np.asarray(core.constraint_jacobian(q, t))
    for _ in range(2):
        v = v - np.linalg.pinv(J, rcond=1e-7) @ (J @ v + np.asarray(core.constraint_rate(q, t)))
    return q, v
