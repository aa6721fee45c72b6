"""Random scenes with contact for estimates.py: a family and a seed are the name of a motion.

A family draws a scene, a start and a duration from a generator. Motions of which tests/oracles know an answer are those
of tests/helpers/held_contact_scenes.py, with numbers that are drawn.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import contactvi as cvi
from contactvi.reproduce.systems import problem_b
from contactvi.verify import systems
from helpers import coupled_hands
from helpers import held_contact_scenes as held_scenes
from helpers.held_contact_scenes import Held
from oracles import held_contact as oracle

ROOT = Path(__file__).resolve().parents[1]
A1 = "example-robot-data://robots/a1_description/urdf/a1.urdf"
Rng = np.random.Generator


@dataclass
class Motion:
    """A scene, its start and how long it runs [s].

    known: the same motion with its exact answer. steady: the same scene for steps of one length, where the references
    of its servos move, which such steps hold constant.
    """

    scene: cvi.Scene
    q: np.ndarray
    v: np.ndarray
    duration: float
    known: Held | None = None
    steady: cvi.Scene | None = None


def of_held(held: Held) -> Motion:
    return Motion(held.scene, held.q, held.v, held.duration, held)


def turn(rng: Rng) -> np.ndarray:
    """A random rotation as a quaternion x y z w."""
    numbers = rng.normal(size=4)
    return np.asarray(numbers / np.linalg.norm(numbers))


def on_ground(rng: Rng, restitution: float, friction: tuple[float, float] = (0.1, 0.9)) -> cvi.Scene:
    """A ground that is level or falls by up to .4 rad."""
    scene, slope = cvi.Scene(), rng.choice([0.0, rng.uniform(0.0, 0.4)])
    scene.add_halfspace((math.sin(slope), 0.0, math.cos(slope)), 0.0, name="ground")
    scene.set_contact(restitution=restitution, friction=rng.uniform(*friction))
    return scene


def thrown(
    scene: cvi.Scene, rng: Rng, name: str, gap: float, speed: float, spin: float
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return q and v of one body that is turned at random, this far above the ground, with random velocities."""
    q = np.concatenate([[0.0, 0.0, 2.0], turn(rng)])
    normal = np.asarray(scene.collision_model.geometryObjects[0].geometry.n)
    q[:3] -= (scene.gaps(q).min() - gap) * normal
    return q, np.concatenate([rng.uniform(-speed, speed, 3), rng.uniform(-spin, spin, 3)])


# --- exact answers ----------------------------------------------------------------------------------------------------
def turning_slip(rng: Rng) -> Motion:
    return of_held(held_scenes.turning_slip(rng.uniform(1.2, 3.0), rng.uniform(0.5, 1.6)))


def box_slides(rng: Rng) -> Motion:
    return of_held(
        held_scenes.box_slides(
            rng.uniform(0.0, 0.5), rng.uniform(0.1, 0.8), rng.uniform(0.3, 2.0), rng.uniform(0.5, 1.5)
        )
    )


def point_on_sphere(rng: Rng) -> Motion:
    return of_held(held_scenes.point_on_sphere(rng.choice([0.0, rng.uniform(0.05, 0.3)]), rng.uniform(0.0, 1.5), 0.8))


def rod_on_tip(rng: Rng) -> Motion:
    return of_held(held_scenes.rod_on_tip(rng.uniform(0.2, 0.6), rng.uniform(0.2, 1.5), 0.3))


def block_on_belt(rng: Rng) -> Motion:
    block = oracle.BlockOnBelt(
        rng.uniform(8.0, 60.0), rng.uniform(0.15, 0.6), rng.choice([0.0, rng.uniform(0.1, 0.6)]),
        rng.uniform(0.03, 0.1), rng.uniform(3.0, 8.0),
    )  # fmt: skip
    return of_held(held_scenes.block_on_belt(block, block.belt(0.0)[1], rng.uniform(1.0, 3.0)))


def rolling_coin(rng: Rng) -> Motion:
    return of_held(held_scenes.rolling_coin(rng.uniform(0.0, 1.5)))


# --- free bodies ------------------------------------------------------------------------------------------------------
def ball_thrown(rng: Rng) -> Motion:
    """Bounces, slides and rolls."""
    scene = on_ground(rng, rng.choice([0.0, rng.uniform(0.2, 0.8)]))
    scene.add_sphere("ball", radius=0.1)
    q, v = thrown(scene, rng, "ball", rng.choice([0.0, rng.uniform(0.0, 0.2)]), 1.0, 10.0)
    return Motion(scene, q, v, rng.uniform(0.5, 1.5))


def box_tumbles(rng: Rng) -> Motion:
    scene = on_ground(rng, rng.choice([0.0, rng.uniform(0.1, 0.6)]))
    scene.add_box("box", rng.uniform(0.1, 0.4, 3), mass=2.0)
    q, v = thrown(scene, rng, "box", rng.uniform(0.0, 0.1), 0.7, 3.0)
    return Motion(scene, q, v, rng.uniform(0.2, 0.8))


def capsule_rolls(rng: Rng) -> Motion:
    """A capsule or a cylinder, thrown to the ground."""
    scene = on_ground(rng, rng.choice([0.0, rng.uniform(0.1, 0.6)]))
    add = scene.add_capsule if rng.random() < 0.6 else scene.add_cylinder
    add("rod", radius=rng.uniform(0.04, 0.1), length=rng.uniform(0.1, 0.4))
    q, v = thrown(scene, rng, "rod", rng.uniform(0.0, 0.05), 0.7, 4.0)
    return Motion(scene, q, v, rng.uniform(0.2, 0.8))


def ball_on_box(rng: Rng) -> Motion:
    """A ball rolls on a box that slides."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.8, 0.6, 0.1), mass=rng.uniform(0.5, 3.0), placement=(0.0, 0.0, 0.05))
    scene.add_sphere("ball", radius=0.08, mass=rng.uniform(0.2, 1.0), placement=(*rng.uniform(-0.1, 0.1, 2), 0.18))
    scene.set_contact(restitution=0.0, friction=rng.uniform(0.1, 0.5))
    v = np.zeros(12)
    v[0], v[6:8], v[9:11] = rng.uniform(-1.5, 1.5), rng.uniform(-0.5, 0.5, 2), rng.uniform(-5.0, 5.0, 2)
    return Motion(scene, scene.neutral(), v, rng.uniform(0.2, 0.5))


def balls_collide(rng: Rng) -> Motion:
    """Three balls on a ground, which meet one another."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(3):
        scene.add_sphere(f"ball_{k}", radius=0.1, placement=(0.3 * k, rng.uniform(-0.05, 0.05), 0.1))
    scene.set_contact(restitution=rng.uniform(0.0, 0.9), friction=rng.uniform(0.0, 0.5))
    v = np.zeros(18)
    v[0], v[12], v[3:6] = rng.uniform(0.5, 2.0), -rng.uniform(0.0, 1.0), rng.uniform(-5.0, 5.0, 3)
    return Motion(scene, scene.neutral(), v, 0.8)


# --- mechanisms -------------------------------------------------------------------------------------------------------
def arm(rng: Rng, links: int, tip: bool) -> cvi.Scene:
    """A chain of rods of .4 m in a plane, its first joint .5 m above a ground that its last ball may touch."""
    model, parent = systems.empty_model(systems.GRAVITY), 0
    for k in range(links):
        parent = model.addJoint(
            parent, pin.JointModelRY(), systems.place(*((0.4, 0, 0) if k else (0, 0, 0.5))), f"j{k}"
        )
        inertia = pin.Inertia(rng.uniform(0.3, 1.0), np.array([0.2, 0.0, 0.0]), np.diag([1e-3, 0.013, 0.013]))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    shapes: systems.Shapes = {}
    if tip:
        shapes["tip"] = (parent, systems.place(x=0.4), coal.Sphere(0.03))
        shapes["ground"] = (0, systems.place(), systems.halfspace(0.0, 0.0, 1.0))
    return systems.built(
        model, shapes, [("ground", "tip")] if tip else [], rng.choice([0.0, 0.5]), rng.uniform(0.1, 0.8)
    )


def joint_friction(rng: Rng) -> Motion:
    scene = arm(rng, 2, False)
    for k in range(2):
        scene.set_joint(f"j{k}", friction=rng.uniform(0.05, 1.0))
    return Motion(scene, rng.uniform(-0.5, 1.5, 2), rng.uniform(-3.0, 3.0, 2), rng.uniform(0.5, 2.0))


def servos_press(rng: Rng) -> Motion:
    """An arm on servos whose targets are below the ground."""
    scene = arm(rng, 3, True)
    targets, start = rng.uniform([0.6, 0.2, 0.1], [1.2, 0.8, 0.6]), np.array([0.1, 0.2, 0.2])
    for k in range(3):
        scene.set_servo(f"j{k}", kp=rng.uniform(30.0, 100.0), kd=rng.uniform(1.0, 5.0), target=float(targets[k]))
    return Motion(scene, start, np.zeros(3), rng.uniform(0.3, 0.8))


def limp_arm(rng: Rng) -> Motion:
    """Falls on its tip or on a limit of a joint."""
    scene = arm(rng, 2, True)
    scene.set_joint("j1", limits=(-rng.uniform(0.3, 1.0), rng.uniform(0.3, 1.0)), restitution=rng.choice([0.0, 0.4]))
    return Motion(scene, np.array([rng.uniform(-0.5, 0.3), rng.uniform(-0.2, 0.2)]), np.zeros(2), rng.uniform(0.3, 0.8))


def four_bar(rng: Rng) -> Motion:
    """A linkage whose pin hits a wall, or whose joints rub."""
    stop = rng.random() < 0.5
    scene = systems.four_bar(stop=0.55 if stop else None)
    if not stop:
        scene.set_joint("bar_1", friction=rng.uniform(0.1, 2.0))
    q = systems.four_bar_angles(0.4 if stop else rng.uniform(0.0, 6.0))
    v = scene.consistent_velocity(q, [1.0, 0.0, 0.0])
    return Motion(scene, q, v * (rng.uniform(2.0, 5.0) / v[0]), rng.uniform(0.5, 1.5))


def mimic_hand(rng: Rng) -> Motion:
    """Coupled fingers that fall on the limits of their leaders."""
    text = coupled_hands.hand(fingers=2, links=3)
    text = coupled_hands.limited(text, "f0j0", -0.2, round(rng.uniform(0.2, 0.8), 3))
    with tempfile.TemporaryDirectory() as folder:
        scene = coupled_hands.scene_of(text, Path(folder))
    scene.set_joint("f0j0", limits=True, restitution=rng.choice([0.0, 0.5]))
    scene.set_joint("f1j0", friction=rng.uniform(1e-4, 5e-3))
    q, v = scene.neutral(), np.zeros(scene.nv)
    for finger, rate in enumerate(rng.uniform(-3.0, 3.0, 2)):
        v[scene.v_index(f"f{finger}j0")] = rate
    return Motion(scene, q, scene.consistent_velocity(q, v), rng.uniform(0.3, 1.0))


def pendulum_at_wall(rng: Rng) -> Motion:
    """A double pendulum whose tip hits a wall."""
    scene = problem_b(rng.uniform(-0.5, 0.2))
    scene.set_contact(restitution=rng.uniform(0.0, 1.0), friction=rng.choice([0.0, 0.3]))
    return Motion(scene, rng.uniform(0.4, 1.2, 2), rng.uniform(-0.5, 0.5, 2), rng.uniform(0.5, 1.5))


def robot_stands(rng: Rng) -> Motion:
    """A quadruped, A1, on its servos: pushed, or dropped by a centimetre."""
    scene = cvi.Scene()
    scene.add_urdf(A1, base="free")
    scene.add_halfspace(name="ground")
    scene.set_contact(restitution=0.0, friction=0.8)
    pose = {"hip": 0.0, "thigh": 0.8, "calf": -1.6}
    q, v = scene.neutral(), np.zeros(scene.nv)
    for name in list(scene.model.names)[2:]:
        q[scene.q_index(name)] = pose[name.split("_")[1]]
        scene.set_servo(name, kp=100.0, kd=3.0, target=pose[name.split("_")[1]])
    q[2] += 1.0
    ground = [k for k, pair in enumerate(scene.pair_names) if "ground" in pair]
    q[2] -= scene.gaps(q)[ground].min() - rng.choice([0.0, 0.01])
    v[:3] = rng.uniform(-0.3, 0.3, 3) * [1.0, 1.0, 0.0]
    return Motion(scene, q, v, 0.2)


def robot_falls(rng: Rng) -> Motion:
    """The same robot without servos, its joints damped as in its file, from its stance."""
    motion = robot_stands(rng)
    for name in list(motion.scene.model.names)[2:]:
        motion.scene.set_servo(name, kp=0.0, kd=0.0)
    motion.duration = 0.15
    return motion


def ball_into_hand(rng: Rng) -> Motion:
    """models/allegro_ball.toml, the ball somewhere above the hand, until some time after it has touched it."""
    scene = cvi.load_scene(ROOT / "models" / "allegro_ball.toml")
    scene.settings = {}
    q, v = scene.q0.copy(), np.zeros(scene.nv)
    q[scene.q_index("ball")][:2] += rng.uniform(-0.005, 0.005, 2)
    return Motion(scene, q, v, rng.uniform(0.4, 0.6))


# --- what changes in time ---------------------------------------------------------------------------------------------
def wave(rng: Rng, size: float, rate: tuple[float, float] = (3.0, 12.0)) -> Callable[[float], tuple[float, float]]:
    """A sine of about this size, and its rate."""
    a, w, phase = size * rng.uniform(0.5, 1.0), rng.uniform(*rate), rng.uniform(0.0, 2.0 * math.pi)
    return lambda t: (a * math.sin(w * t + phase), a * w * math.cos(w * t + phase))


def follow(scene: cvi.Scene, goals: dict[str, Callable[[float], tuple[float, float]]], kp: float, kd: float) -> None:
    """Give joints servos whose references move."""
    for name, goal in goals.items():
        scene.set_servo(name, kp=kp, kd=kd, target=lambda t, goal=goal: (*goal(t), 0.0))


def pull(scene: cvi.Scene, goals: dict[str, Callable[[float], tuple[float, float]]], kp: float, kd: float) -> None:
    """Let the forces of such servos act as forces given in Python."""
    at_q, at_v = ([index(name).start for name in goals] for index in (scene.q_index, scene.v_index))
    gains = np.zeros((scene.nv, scene.nv))
    gains[at_v, at_v] = 1.0

    def force(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        wanted = np.array([goal(t) for goal in goals.values()])
        found = np.zeros(scene.nv)
        found[at_v] = kp * (wanted[:, 0] - q[at_q]) + kd * (wanted[:, 1] - v[at_v])
        return found

    scene.add_force(force, lambda t, q, v: (-kp * gains, -kd * gains))


def wrench_in_time(rng: Rng) -> Motion:
    """A box or a ball that a force pushes to and fro, and now and then lifts."""
    scene = on_ground(rng, 0.0, (0.2, 0.6))
    if rng.random() < 0.6:
        scene.add_box("body", (0.5, 0.4, 0.1), mass=1.0)
    else:
        scene.add_sphere("body", radius=0.1, mass=1.0)
    along, across, up = wave(rng, 8.0), wave(rng, rng.choice([0.0, 3.0])), wave(rng, rng.choice([0.0, 6.0, 15.0]))
    scene.add_wrench("body", lambda t: (along(t)[0], across(t)[0], up(t)[0]))
    q = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0])
    normal = np.asarray(scene.collision_model.geometryObjects[0].geometry.n)
    q[3:] = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), normal).coeffs()
    q[:3] -= scene.gaps(q).min() * normal
    return Motion(scene, q, np.zeros(6), rng.uniform(0.5, 1.5))


def shaken_table(rng: Rng) -> Motion:
    """A servo shakes a plate, on which a box or a ball lies."""
    size, mass, mu = rng.uniform(0.02, 0.1), rng.uniform(0.5, 2.0), rng.uniform(0.1, 0.6)
    box, goals = rng.random() < 0.6, {"slide": wave(rng, size, (5.0, 12.0))}
    scenes = []
    for act in (follow, pull):
        model = systems.empty_model(systems.GRAVITY)
        slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
        model.appendBodyToJoint(slide, pin.Inertia(3.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
        free = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
        inertia = pin.Inertia.FromBox(mass, 0.2, 0.2, 0.1) if box else pin.Inertia.FromSphere(mass, 0.1)
        model.appendBodyToJoint(free, inertia, pin.SE3.Identity())
        shapes: systems.Shapes = {
            "plate": (slide, systems.place(), coal.Box(4.0, 4.0, 0.2)),
            "body": (free, systems.place(), coal.Box(0.2, 0.2, 0.1) if box else coal.Sphere(0.1)),
        }
        scene = systems.built(model, shapes, [("plate", "body")], 0.0, mu)
        act(scene, goals, 400.0, 10.0)
        scenes.append(scene)
    q = scenes[0].neutral()
    q[3] = 0.15 if box else 0.2
    return Motion(scenes[0], q, np.zeros(7), rng.uniform(0.5, 1.2), steady=scenes[1])


def servos_move(rng: Rng) -> Motion:
    """An arm whose servos follow references that move, through the ground and back."""
    seed, goals = int(rng.integers(2**31)), {}
    middle, start = rng.uniform([0.5, 0.2, 0.1], [1.0, 0.7, 0.5]), np.array([0.1, 0.2, 0.2])
    for k in range(3):
        moves, at = wave(rng, 0.3), float(middle[k])
        goals[f"j{k}"] = lambda t, moves=moves, at=at: (at + moves(t)[0], moves(t)[1])
    kp, kd = rng.uniform(30.0, 100.0), rng.uniform(1.0, 5.0)
    scenes = [arm(np.random.default_rng(seed), 3, True) for _ in range(2)]
    follow(scenes[0], goals, kp, kd)
    pull(scenes[1], goals, kp, kd)
    return Motion(scenes[0], start, np.zeros(3), rng.uniform(0.3, 0.8), steady=scenes[1])


def robot_walks(rng: Rng) -> Motion:
    """The quadruped on servos that move its legs to and fro."""
    motions = [robot_stands(np.random.default_rng(5)) for _ in range(2)]
    goals = {}
    for name in list(motions[0].scene.model.names)[2:]:
        at, moves = float(motions[0].q[motions[0].scene.q_index(name)][0]), wave(rng, 0.15, (6.0, 20.0))
        goals[name] = lambda t, moves=moves, at=at: (at + moves(t)[0], moves(t)[1])
        motions[1].scene.set_servo(name, kp=0.0, kd=0.0)
    follow(motions[0].scene, goals, 100.0, 3.0)
    pull(motions[1].scene, goals, 100.0, 3.0)
    return Motion(motions[0].scene, motions[0].q, motions[0].v, 0.2, steady=motions[1].scene)


def bodies_apart(rng: Rng) -> Motion:
    """Balls and boxes on a ground, some of which meet."""
    scene, count = cvi.Scene(), int(rng.integers(3, 6))
    scene.add_halfspace()
    scene.set_contact(restitution=rng.uniform(0.0, 0.8), friction=rng.uniform(0.1, 0.6))
    v = np.zeros(6 * count)
    for k in range(count):
        x, y = 0.7 * (k % 2) + rng.uniform(-0.1, 0.1), 0.7 * (k // 2) + rng.uniform(-0.1, 0.1)
        if rng.random() < 0.7:
            scene.add_sphere(f"body_{k}", radius=0.1, placement=(x, y, 0.1 + rng.choice([0.0, rng.uniform(0.0, 0.4)])))
            v[6 * k + 3 : 6 * k + 6] = rng.uniform(-5.0, 5.0, 3)
        else:
            scene.add_box(f"body_{k}", (0.2, 0.15, 0.1), placement=(x, y, 0.05))
        v[6 * k : 6 * k + 2] = rng.uniform(-1.0, 1.0, 2)
    return Motion(scene, scene.neutral(), v, rng.uniform(0.3, 0.8))


FAMILIES: dict[str, Callable[[Rng], Motion]] = {
    "turning slip": turning_slip, "box slides": box_slides, "point on a sphere": point_on_sphere,
    "rod on its tip": rod_on_tip, "block on a belt": block_on_belt, "coin rolls": rolling_coin,
    "ball thrown": ball_thrown, "box tumbles": box_tumbles, "capsule, cylinder": capsule_rolls,
    "ball on a box": ball_on_box, "balls collide": balls_collide, "joint friction": joint_friction,
    "servos press": servos_press, "limp arm": limp_arm, "four-bar": four_bar, "mimic hand": mimic_hand,
    "pendulum at a wall": pendulum_at_wall, "robot stands": robot_stands, "robot falls": robot_falls,
    "ball into a hand": ball_into_hand, "force in time": wrench_in_time, "shaken table": shaken_table,
    "servos move": servos_move, "robot walks": robot_walks, "bodies apart": bodies_apart,
}  # fmt: skip


def make(family: str, seed: int) -> tuple[Motion, float]:
    """Return a motion and the accuracy that is asked of it, from 1e-3 to 1e-8."""
    rng = np.random.default_rng([list(FAMILIES).index(family), seed])
    tol = float(10.0 ** rng.uniform(-8.0, -3.0))
    return FAMILIES[family](rng), tol
