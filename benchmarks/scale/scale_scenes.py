"""The scenes of contact_scale.py, each as contactvi's scene, its start, and how its gaps are looked at.

- heap: a family and a seed of contactvi.bench.heaps.
- resting: equal boxes or spheres on the ground beside each other, at rest from the start.
- idle: an Allegro hand that swings limply, and spheres that lie on the ground two metres from it and further.
- flight: boxes that tumble upwards, at least 20 cm apart, above a ground that they do not reach.
- gas: elastic spheres without gravity in a room of which they fill a tenth.
- robot: a robot of example-robot-data in its stance, 15 cm above the ground; servos hold its joints there, or it is
  limp.
- arm: a limp arm that falls from its neutral configuration, against its limits.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi.bench import heaps
from contactvi.bench.heap_gaps import GapCheck
from contactvi.importing.paths import example_robot_data_share, resolve_path

Gap = Callable[[np.ndarray], float]
DATA = "example-robot-data://robots/"
ALLEGRO = DATA + "allegro_hand_description/urdf/allegro_right_hand.urdf"
DROP, FRICTION = 0.15, 0.7  # [m] of the robots
NEAR = 1e-3  # [m] up to which gaps of heaps are looked at

# name -> URDF, SRDF with the stance. The g1 stands upright in its neutral configuration and has no SRDF.
ROBOTS = {
    "anymal_c": ("anymal_c_simple_description/urdf/anymal.urdf", "anymal_c_simple_description/srdf/anymal.srdf"),
    "hyq": ("hyq_description/robots/hyq_no_sensors.urdf", "hyq_description/srdf/hyq.srdf"),
    "solo12": ("solo_description/robots/solo12.urdf", "solo_description/srdf/solo.srdf"),
    "a1": ("a1_description/urdf/a1.urdf", "a1_description/srdf/a1.srdf"),
    "go1": ("go1_description/urdf/go1.urdf", "go1_description/srdf/go1.srdf"),
    "bolt": ("bolt_description/robots/bolt.urdf", "bolt_description/srdf/bolt.srdf"),
    "g1": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", None),
    "talos": ("talos_data/robots/talos_reduced.urdf", "talos_data/srdf/talos.srdf"),
    "icub": ("icub_description/robots/icub.urdf", "icub_description/srdf/icub.srdf"),
}
STANCES = ("standing", "half_sitting")
# The file's stance has the centre of mass above the edge of the heels: the base leans about y by an angle [rad], which
# the ankles take back.
LEANS = {"icub": (-0.02, {"l_ankle_pitch": 1.0, "r_ankle_pitch": 1.0})}
ARMS = {
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "panda": "panda_description/urdf/panda.urdf",
    "kinova": "kinova_description/robots/kinova.urdf",
    "xarm7": "xarm_description/urdf/xarm7.urdf",
    "so100": "so_arm_description/urdf/so100.urdf",
}
# Servos: kp = M_jj RATE^2, on the legs also STIFFNESS times weight x height of the base, so that they carry it; kd / kp
# is the critical damping of an arm's joint.
RATE, DAMPING, STIFFNESS = 20.0, 0.1, 3.0  # [1/s], [s], [1/rad]
SOLE = 0.03  # [m] a leg ends at most this far above the lowest point of the robot


@dataclass
class Setup:
    """A scene and its start.

    Attributes:
        q0, v0: shapes (nq,), (nv,).
        gap: the worst gap at a configuration [m]; None where it is not looked at.
        free: whether nothing but gravity, contacts and damping acts, so that the energy may not rise.
        notes: what was changed in the model.
    """

    scene: cvi.Scene
    q0: np.ndarray
    v0: np.ndarray
    gap: Gap | None = None
    free: bool = True
    notes: list[str] = field(default_factory=list)


def make(kind: str, **chosen: Any) -> Setup:
    """Return a scene by its kind."""
    return {
        "heap": heap, "resting": resting, "idle": idle, "flight": flight, "gas": gas, "robot": robot, "arm": arm,
    }[kind](**chosen)  # fmt: skip


# --- bodies -----------------------------------------------------------------------------------------------------------
def heap(**chosen: Any) -> Setup:
    return of_heap(heaps.make(**chosen))


def of_heap(made: heaps.Heap) -> Setup:
    check = GapCheck(made)
    return Setup(*heaps.to_scene(made), gap=lambda q: check.worst(q, NEAR)[0])


def grid(count: int, spacing: float) -> np.ndarray:
    """Return places of a square grid in the plane z = 0, shape (count, 3)."""
    side = math.ceil(math.sqrt(count))
    k = np.arange(count)
    return spacing * np.column_stack([k % side - (side - 1) / 2, k // side - (side - 1) / 2, np.zeros(count)])


def resting(shape: str, count: int) -> Setup:
    made = heaps.Heap("resting", 0, restitution=0.0, friction=0.5)
    for place in grid(count, 0.3):
        size = (0.2, 0.16, 0.1) if shape == "box" else (0.05,)
        made.add(shape, size, place + [0.0, 0.0, 0.05])
    return replace(of_heap(made), free=False)  # A share of no kinetic energy says nothing.


def idle(count: int) -> Setup:
    scene = cvi.Scene()
    hand = scene.add_urdf(ALLEGRO, placement=(0.0, 0.0, 1.0))
    scene.disable_pair(hand, hand)
    for joint in [name for name in scene.model.names if name.startswith("joint_")]:
        scene.set_joint(joint, damping=0.0, limits=False)
    # Given pairs: the choice of the hand's own makes a pin.Data, whose memory grows with the cube of nv.
    scene.enable_pair(hand, scene.add_halfspace())
    places = grid(4 * count + 400, 0.15)
    far = places[np.abs(places).max(axis=1) > 2.0][:count]
    for k, place in enumerate(far):
        scene.add_sphere(f"ball{k}", 0.05, 0.5, placement=(float(place[0]), float(place[1]), 0.05))
    scene.set_contact(restitution=0.0, friction=0.5)
    v0 = np.zeros(scene.nv)
    v0[:16] = np.random.default_rng(3).standard_normal(16)
    return Setup(scene, scene.neutral(), v0)


def flight(count: int) -> Setup:
    rng, made = np.random.default_rng(5), heaps.Heap("flight", 0, restitution=0.5, friction=0.5)
    for place in grid(count, 0.5):
        body = made.add("box", rng.uniform(0.1, 0.2, 3), place + [0.0, 0.0, 3.0])
        body.velocity, body.spin = np.array([0.0, 0.0, 5.0]), rng.normal(size=3)
    return of_heap(made)


def gas(count: int) -> Setup:
    rng, radius = np.random.default_rng(7), 0.05
    half = 0.5 * (count * 4.0 / 3.0 * math.pi * radius**3 / 0.1) ** (1.0 / 3.0)
    made = heaps.Heap("gas", 0, restitution=1.0, friction=0.0, planes=[])
    made.add_room(half)
    made.planes += [((0.0, 0.0, 1.0), -half), ((0.0, 0.0, -1.0), -half)]
    side = math.ceil(count ** (1.0 / 3.0))
    spacing = 2.0 * (half - 0.01 * radius) / side
    for k in range(count):
        cell = np.array([k % side, (k // side) % side, k // side**2])
        place = (cell - (side - 1) / 2) * spacing + rng.uniform(-0.1, 0.1, 3) * radius * 0.1
        body = made.add("sphere", (radius,), place, mass=1.0)
        body.velocity = rng.normal(size=3) / math.sqrt(3.0)
    setup = of_heap(made)
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    bare, q0, v0 = heaps.to_scene(made, scene)
    return Setup(bare, q0, v0, gap=setup.gap)


# --- robots -----------------------------------------------------------------------------------------------------------
def robot(name: str, held: bool = True) -> Setup:
    urdf, srdf = ROBOTS[name]
    notes: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        path = resolve_path(DATA + urdf)
        if name == "icub":
            path = mended(path, Path(folder), notes)
        scene = cvi.Scene()
        scene.add_urdf(path, base="free", srdf=DATA + srdf if srdf else None, mimic=False, package_dirs=packages())
        scene.add_halfspace(name="ground")
        scene.set_contact(restitution=0.0, friction=FRICTION)
        q0 = stance(scene, DATA + srdf if srdf else None)
        if name in LEANS:
            angle, joints = LEANS[name]
            q0[3:7] = [0.0, np.sin(0.5 * angle), 0.0, np.cos(0.5 * angle)]
            for joint, sign in joints.items():
                q0[scene.q_index(joint)] += sign * angle
            notes.append(f"leans by {angle} rad")
        disable_overlapping(scene, q0, notes)
        q0[2] = DROP - ground_gaps(scene, q0).min()
        if held:
            set_servos(scene, q0)
        scene.core()  # Meshes are read now, while the file is there.
    return Setup(scene, q0, np.zeros(scene.nv), gap=engine_gap(scene), free=False, notes=notes)


def packages() -> list[str]:
    return [str(example_robot_data_share())]


def stance(scene: cvi.Scene, srdf: str | None) -> np.ndarray:
    """Return the stance of the SRDF with the base at the origin, upright; else the neutral configuration."""
    q, model = scene.neutral(), scene.model
    if srdf is None:
        return q
    plain = model.copy()
    pin.loadReferenceConfigurations(plain, str(resolve_path(srdf)), False)
    known = {item.key(): item.data() for item in plain.referenceConfigurations}
    found = next((np.array(known[key]) for key in STANCES if key in known), None)
    if found is not None:
        q[7:] = np.clip(found[7:], model.lowerPositionLimit[7:], model.upperPositionLimit[7:])
    return q


def self_pairs(scene: cvi.Scene) -> np.ndarray:
    return np.array(["ground" not in pair for pair in scene.pair_names], dtype=bool)


def ground_gaps(scene: cvi.Scene, q: np.ndarray) -> np.ndarray:
    """Gaps to the ground [m]; infinite in the places of other pairs."""
    return np.where(self_pairs(scene), np.inf, scene.core().gaps(q)[0])


def disable_overlapping(scene: cvi.Scene, q: np.ndarray, notes: list[str]) -> None:
    """Take out the pairs of the robot itself that overlap in its stance."""
    gaps, own = scene.core().gaps(q)[0], self_pairs(scene)
    for k in np.flatnonzero(own & (gaps < 0.0)):
        a, b = scene.pair_names[k]
        notes.append(f"{a}, {b} overlap by {-1e3 * gaps[k]:.1f} mm in the stance: not tested")
    for a, b in [scene.pair_names[k] for k in np.flatnonzero(own & (gaps < 0.0))]:
        scene.disable_pair(a, b)


def set_servos(scene: cvi.Scene, q: np.ndarray) -> None:
    model, gaps = scene.model, ground_gaps(scene, q)
    data = model.createData()
    mass = np.diag(pin.crba(model, data, q))
    weight = 9.81 * sum(inertia.mass for inertia in model.inertias)
    height = float(q[2] - gaps.min())
    owners = {item.name: item.parentJoint for item in scene.collision_model.geometryObjects}
    legs: set[int] = set()
    for k in np.flatnonzero(gaps <= gaps.min() + SOLE):
        joint = next(owners[name] for name in scene.pair_names[k] if name != "ground")
        while joint > 1:
            legs.add(joint)
            joint = model.parents[joint]
    gains = {}
    for i in range(2, model.njoints):
        kp = mass[model.idx_vs[i]] * RATE**2 + (STIFFNESS * weight * height if i in legs else 0.0)
        gains[model.names[i]] = float(kp)
    for name, kp in gains.items():
        scene.set_servo(name, kp=kp, kd=DAMPING * kp)


def mended(path: Path, folder: Path, notes: list[str]) -> Path:
    """Write the URDF with the inertia of a ball of 1000 kg/m^3 for each link whose inertia is that of a point."""
    tree = ElementTree.parse(path)
    names = []
    for link in tree.getroot().iter("link"):
        tag, mass = link.find("inertial/inertia"), link.find("inertial/mass")
        if tag is None or mass is None:
            continue
        m = float(mass.get("value", "0"))
        radius = (3.0 * m / (4.0 * math.pi * 1000.0)) ** (1.0 / 3.0)
        ball = 0.4 * m * radius**2
        if m > 0.0 and float(tag.get("ixx", "0")) < 1e-3 * ball:
            for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
                tag.set(key, repr(ball) if key[1] == key[2] else "0")
            names.append(str(link.get("name")))
    notes.append(f"{len(names)} links without inertia are balls: {', '.join(names)}")
    file = folder / path.name
    tree.write(file)
    return file


def engine_gap(scene: cvi.Scene) -> Gap:
    """The distances of all pairs by coal: hulls are rounded in the engine only."""
    core = scene.core()
    return lambda q: float(core.gaps(q)[0].min())


def arm(name: str) -> Setup:
    notes: list[str] = []
    scene = cvi.Scene()
    scene.add_urdf(DATA + ARMS[name], mimic=False)
    scene.set_contact(restitution=0.0, friction=0.0)
    q0 = scene.neutral()
    if len(scene.pair_names):
        gaps = scene.core().gaps(q0)[0]
        for a, b in [scene.pair_names[k] for k in np.flatnonzero(gaps < 0.0)]:
            notes.append(f"{a}, {b} overlap at the start: not tested")
            scene.disable_pair(a, b)
    return Setup(scene, q0, np.zeros(scene.nv), gap=engine_gap(scene) if scene.pair_names else None, notes=notes)
