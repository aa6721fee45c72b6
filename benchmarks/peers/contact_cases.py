"""Scenes of lasting contact as plain data for all simulators, and their exact answers where there are some.

Needs pin, numpy, scipy and contactvi; the answers are those of tests/oracles. A job holds

- bodies: name, parent (a body or "world"), pose (xyz, rpy) of the joint's frame in the parent's, joint ("free", "slide"
  or "hinge" with its axis), mass, com, inertia (3 x 3, about the com), shapes (sphere, box or plane z <= 0, with xyz,
  rpy); a joint may have a stiffness (slides only), a servo (kp, kd, target; no limit of effort) or a motion (amplitude,
  rate: amplitude sin(rate t)). A simulator that cannot prescribe a motion is given a mass of 1000 t on a spring.
- pairs of bodies whose shapes may touch, friction for all of them; restitution 0. loops: points that two bodies share.
- start: q and v by joint; of a free joint xyz with a quaternion x y z w, and linear, then angular velocity in world
  axes.
- observe: points of bodies, whose places in the world, one after the other, are a row of the result.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import scenes
import tomllib

import contactvi as cvi
from contactvi.verify import systems

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))
from oracles import four_bar, held_contact, joint_friction  # noqa: E402

Job = dict[str, Any]
Exact = Callable[[np.ndarray], np.ndarray]
Case = tuple[Job, Exact | None]

GROUND = {"name": "ground", "parent": "world", "joint": "fixed", "shapes": [{"plane": True}]}


def body(name: str, mass: float, inertia: Any, shapes: list[dict[str, Any]], **given: Any) -> dict[str, Any]:
    moments = np.asarray(inertia, dtype=float)
    full = np.diag(moments) if moments.ndim == 1 else moments
    return {
        "name": name, "parent": "world", "joint": "free", "mass": mass, "com": [0.0, 0.0, 0.0],
        "inertia": full.tolist(), "shapes": shapes, **given,
    }  # fmt: skip


def job(name: str, bodies: list[Any], start: dict[str, Any], duration: float, **given: Any) -> Job:
    return {
        "name": f"contact {name}", "bodies": bodies, "start": start, "duration": duration, "sample": 0.05,
        "gravity": systems.GRAVITY, "friction": 0.0, "pairs": [], "loops": [], **given,
    }  # fmt: skip


def ball() -> Case:
    """A ball of 1 kg slides with a spin across its way, and rolls from .2 s on."""
    radius, spin, velocity = 0.1, (3.0, -2.0, 5.0), (1.0, 0.4)
    sliding = held_contact.SlidingBall(radius, 0.2, velocity, spin)
    solid = body("ball", 1.0, [0.4 * radius**2] * 3, [{"sphere": radius}])
    start = {"q": {"ball": [0, 0, radius, 0, 0, 0, 1]}, "v": {"ball": [*velocity, 0.0, *spin]}}

    def exact(times: np.ndarray) -> np.ndarray:
        return np.column_stack([sliding.states(times)[:, :2], np.full(len(times), radius)])

    return job("ball", [GROUND, solid], start, 1.0, friction=0.2, pairs=[["ground", "ball"]],
               observe=[["ball", [0, 0, 0]]]), exact  # fmt: skip


def box() -> Case:
    """A box of 2 kg slides along a diagonal for .34 s, and stays."""
    size, speed, friction = np.array([0.4, 0.3, 0.1]), 1.0, 0.3
    solid = body("box", 2.0, 2.0 / 12.0 * (size @ size - size**2), [{"box": size.tolist()}])
    along = np.array([0.8, 0.6, 0.0])
    start = {"q": {"box": [0, 0, 0.05, 0, 0, 0, 1]}, "v": {"box": [*(speed * along), 0, 0, 0]}}
    slide = joint_friction.block_on_slope(speed, friction, mass=2.0)

    def exact(times: np.ndarray) -> np.ndarray:
        return np.array([slide.state(t)[0] * along + [0.0, 0.0, 0.05] for t in times])

    return job("box", [GROUND, solid], start, 1.0, friction=friction, pairs=[["ground", "box"]],
               observe=[["box", [0, 0, 0]]]), exact  # fmt: skip


def rod() -> Case:
    """A rod of 1 m falls, its lower end slides, sticks from .03 s to .29 s, and slides again."""
    tip, theta, speed, friction = 0.02, 1.0, 0.3, 0.5
    light = {"mass": 0.0, "inertia": [[0.0] * 3] * 3, "shapes": [], "com": [0.0] * 3}
    bodies = [
        GROUND,
        {"name": "x", "parent": "world", "joint": "slide", "axis": [1, 0, 0], **light},
        {"name": "z", "parent": "x", "joint": "slide", "axis": [0, 0, 1], **light},
        body("rod", 1.0, [1e-3, 1.0 / 12.0, 1.0 / 12.0], [{"sphere": tip, "xyz": [-0.5, 0, 0]}], parent="z",
             joint="hinge", axis=[0, 1, 0]),
    ]  # fmt: skip
    height = 0.5 * math.sin(theta) + tip
    start = {"q": {"x": 0.0, "z": height, "rod": -theta}, "v": {"x": speed, "z": 0.0, "rod": 0.0}}
    falling = held_contact.RodOnTip(friction, tip)

    def exact(times: np.ndarray) -> np.ndarray:
        rows = falling.states(np.array([0.0, theta, speed, 0.0]), np.append(0.0, times))[0][1:]
        x, up, beside = rows[:, 0], 0.5 * np.sin(rows[:, 1]), 0.5 * np.cos(rows[:, 1])
        nought = np.zeros(len(times))
        return np.column_stack([x - beside, nought, nought + tip, x + beside, nought, 2.0 * up + tip])

    return job("rod", bodies, start, 0.36, friction=friction, pairs=[["ground", "rod"]], sample=0.02,
               observe=[["rod", [-0.5, 0, 0]], ["rod", [0.5, 0, 0]]]), exact  # fmt: skip


def belt() -> Case:
    """A block with a spring on a shaking belt: nine times it begins to stick and lets go again, in 4 s."""
    block = held_contact.BlockOnBelt(10.0, 0.3, 0.0, 0.1, 7.0)
    radius, speed = 0.1, block.belt(0.0)[1]
    motion, spring = {"amplitude": block.amplitude, "rate": block.rate}, {"stiffness": block.stiffness}
    light = {"mass": 0.0, "inertia": [[0.0] * 3] * 3, "shapes": [], "com": [0.0] * 3}
    bodies = [
        body("belt", 1.0, [1.0] * 3, [{"box": [4.0, 1.0, 0.2], "xyz": [0, 0, -0.1]}], joint="slide", axis=[1, 0, 0],
             motion=motion),
        {"name": "along", "parent": "world", "joint": "slide", "axis": [1, 0, 0], **spring, **light},
        body("block", 1.0, [1.0] * 3, [{"sphere": radius}], parent="along", joint="slide", axis=[0, 0, 1]),
    ]  # fmt: skip
    start = {"q": {"belt": 0.0, "along": 0.0, "block": radius}, "v": {"belt": speed, "along": speed, "block": 0.0}}

    def exact(times: np.ndarray) -> np.ndarray:
        x = block.states(0.0, speed, np.append(0.0, times))[1:, 0]
        return np.column_stack([x, np.zeros(len(times)), np.full(len(times), radius)])

    return job("belt", bodies, start, 4.0, friction=block.friction, pairs=[["belt", "block"]],
               observe=[["block", [0, 0, 0]]]), exact  # fmt: skip


def linkage() -> Case:
    """A four-bar linkage without contact: a loop, which most simulators treat as they treat contacts."""
    bars, crank, rate = systems.FOUR_BAR, 0.3, 2.0
    scene, angles = systems.four_bar(), systems.four_bar_angles(crank)
    speeds = scene.consistent_velocity(angles, [1.0, 0.0, 0.0])
    names, bodies, at = list(scene.model.names)[1:], [], 0.0
    for k, (name, length) in enumerate(zip(names, bars[:3], strict=True)):
        bodies.append(body(
            name, length, np.full(3, length**3 / 12.0), [], parent=names[k - 1] if k else "world", joint="hinge",
            axis=[0, -1, 0], pose={"xyz": [at, 0, 0], "rpy": [0, 0, 0]}, com=[0.5 * length, 0, 0],
        ))  # fmt: skip
        at = length
    start = {
        "q": dict(zip(names, angles.tolist(), strict=True)),
        "v": dict(zip(names, (rate / speeds[0] * speeds).tolist(), strict=True)),
    }

    def exact(times: np.ndarray) -> np.ndarray:
        phi = four_bar.motion(bars, crank, rate, np.append(0.0, times))[1:, 0]
        return np.column_stack([bars[0] * np.cos(phi), 0.0 * phi, bars[0] * np.sin(phi)])

    loops = [{"a": "world", "b": names[2], "point_a": [bars[3], 0, 0], "point_b": [bars[2], 0, 0]}]
    return job("four-bar", bodies, start, 2.0, loops=loops, observe=[[names[0], [bars[0], 0, 0]]]), exact


def _tree(model: pin.Model, geometry: pin.GeometryModel, keep: Callable[[str], bool]) -> list[dict[str, Any]]:
    """Return the bodies of a model whose joints are free ones and hinges, with the shapes that are kept."""
    names, found = ["world", *list(model.names)[1:]], []
    fixed: dict[str, Any] = {"name": "fixed", "parent": "world", "joint": "fixed", "shapes": []}
    for j in range(1, model.njoints):
        place, inertia, joint = model.jointPlacements[j], model.inertias[j], model.joints[j]
        given = {"joint": "free"} if joint.nv == 6 else {"joint": "hinge", "axis": scenes.axis(joint).tolist()}
        pose = {"xyz": place.translation.tolist(), "rpy": pin.rpy.matrixToRpy(place.rotation).tolist()}
        found.append(body(names[j], inertia.mass, inertia.inertia, [], parent=names[model.parents[j]], pose=pose,
                          com=inertia.lever.tolist(), **given))  # fmt: skip
    for item in geometry.geometryObjects:
        if keep(item.name):
            carrier = found[item.parentJoint - 1] if item.parentJoint else fixed
            carrier["shapes"].append(_shape(item))
    return [fixed, *found]


def _shape(item: pin.GeometryObject) -> dict[str, Any]:
    shape, place = item.geometry, item.placement
    box = hasattr(shape, "halfSide")  # coal holds the half edges of a box
    size = {"box": (2.0 * shape.halfSide).tolist()} if box else {"sphere": float(shape.radius)}
    return {**size, "xyz": place.translation.tolist(), "rpy": pin.rpy.matrixToRpy(place.rotation).tolist()}


def hand() -> Case:
    """A ball is dropped into a hand of springs: models/allegro_ball.toml without restitution and limits of joints.

    Its springs and dampers are given as servos, which is the same law. Parts of the hand do not touch each other.
    """
    path = ROOT / "models" / "allegro_ball.toml"
    scene, table = cvi.load_scene(path), tomllib.loads(path.read_text())
    bodies = _tree(scene.model, scene.collision_model, lambda _: True)
    start: dict[str, Any] = {"q": {}, "v": {}}
    for item in bodies[1:]:
        name, at = item["name"], scene.q_index(item["name"])
        start["q"][name] = scene.q0[at].tolist() if item["joint"] == "free" else float(scene.q0[at][0])
        start["v"][name] = [0.0] * 6 if item["joint"] == "free" else 0.0
        for law in table["joint"]:
            if fnmatch(name, law["name"]):
                item["servo"] = {"kp": law["stiffness"], "kd": law["damping"], "target": law["rest"]}
    pairs = [[item["name"], "ball"] for item in bodies if item["shapes"] and item["name"] != "ball"]
    return job("hand", bodies, start, 1.0, friction=table["contact"]["friction"], pairs=pairs,
               observe=[["ball", [0, 0, 0]]]), None  # fmt: skip


def quadruped() -> Case:
    """A quadruped, A1, stands on its servos and is pushed sideways at .3 m/s: it sways on four feet that stick."""
    scene = cvi.Scene()
    scene.add_urdf("example-robot-data://robots/a1_description/urdf/a1.urdf", base="free")
    model = scene.model
    base = str(model.names[1])
    bodies = [GROUND, *_tree(model, scene.collision_model, lambda name: "foot" in name)[1:]]
    pose = {"hip": 0.0, "thigh": 0.8, "calf": -1.6}
    q = pin.neutral(model)
    start: dict[str, Any] = {"q": {}, "v": {base: [0.0, 0.3, 0.0, 0.0, 0.0, 0.0]}}
    for item in bodies[2:]:
        name = item["name"]
        start["q"][name], start["v"][name] = pose[name.split("_")[1]], 0.0
        item["servo"] = {"kp": 100.0, "kd": 3.0, "target": start["q"][name]}
        q[model.joints[model.getJointId(name)].idx_q] = start["q"][name]
    geometry = scene.collision_model
    data, places = model.createData(), geometry.createData()
    pin.updateGeometryPlacements(model, data, geometry, places, q)
    heights = [
        places.oMg[k].translation[2] - item.geometry.radius
        for k, item in enumerate(geometry.geometryObjects) if "foot" in item.name
    ]  # fmt: skip
    start["q"][base] = [0.0, 0.0, -min(heights), 0.0, 0.0, 0.0, 1.0]
    pairs = [["ground", item["name"]] for item in bodies[1:] if item["shapes"]]
    return job("quadruped", bodies, start, 1.0, friction=0.8, pairs=pairs, observe=[[base, [0, 0, 0]]]), None


CASES: dict[str, Callable[[], Case]] = {
    "ball": ball, "box": box, "rod": rod, "belt": belt, "four-bar": linkage, "hand": hand, "quadruped": quadruped,
}  # fmt: skip
