"""What shapes that are not convex cost and how right they are: fields and convex pieces, beside those of MuJoCo.

A ring hangs on a ring, a ball lies in a mug, a cow of a mesh falls on the ground. Each scene has one pair of bodies and
comes to rest where it is known to; every way takes the same steps of 2 ms. Time is that of the processor, for a step
with contact, in the last part of a run, without loading; the error is the distance of the height at rest from the known
one, of the cow how far the lowest vertex of its mesh is from the ground. MuJoCo has its default parameters of contact.
Pieces are those of CoACD for both.

    python benchmarks/shapes.py
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

import contactvi as cvi

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers import closed_meshes

STEP, TIMED = 2e-3, 20  # [s], and how many of them are timed
RING, TUBE, BALL = 0.1, 0.02, 0.015
Mesh = tuple[np.ndarray, np.ndarray]


def torus_mesh(around: int = 96, across: int = 32) -> Mesh:
    """About z."""
    u, w = np.meshgrid(
        2.0 * np.pi * np.arange(around) / around, 2.0 * np.pi * np.arange(across) / across, indexing="ij"
    )
    out = RING + TUBE * np.cos(w)
    vertices = np.stack([out * np.cos(u), out * np.sin(u), TUBE * np.sin(w)], axis=-1).reshape(-1, 3)
    faces = []
    for i in range(around):
        for j in range(across):
            a, b = i * across + j, (i + 1) % around * across + j
            c, d = i * across + (j + 1) % across, (i + 1) % around * across + (j + 1) % across
            faces += [(a, b, d), (a, d, c)]
    return vertices, np.array(faces)


@dataclass(frozen=True)
class Body:
    """One of a mesh: of which, sampled how finely [m], where at first (7,); fixed to the world or not."""

    mesh: Mesh
    spacing: float
    place: np.ndarray
    free: bool


@dataclass(frozen=True)
class Task:
    """Bodies of meshes, a ball or a ground, how long the run is [s], and how far its end is from the known one [m]."""

    name: str
    bodies: list[Body]
    ball: float | None
    ground: bool
    duration: float
    error: Callable[[np.ndarray], float]


def tasks() -> list[Task]:
    """Return the scenes."""
    torus, mug, cow = torus_mesh(), closed_meshes.mug(0.003), closed_meshes.cow()
    upright = pin.rpy.rpyToMatrix(0.5 * np.pi, 0.0, 0.0)
    first, second = (
        pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, turn) @ upright).coeffs() for turn in (0.0, 0.5 * np.pi)
    )
    hung, low = -2.0 * (RING - TUBE), closed_meshes.MUG_FLOOR + BALL
    drop = np.array([0.01, 0.0, 0.13, *pin.Quaternion(pin.rpy.rpyToMatrix(0.5, 0.3, 0.2)).coeffs()])

    def over_ground(q: np.ndarray) -> float:
        R = pin.Quaternion(q[3:]).toRotationMatrix()
        return float(abs((cow[0] @ R.T)[:, 2].min() + q[2]))

    still = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    return [
        Task(
            "ring on ring",
            [
                Body(torus, 0.006, np.array([0.0, 0.0, 0.0, *first]), False),
                Body(torus, 0.006, np.array([0.0, 0.0, hung - 1e-5, *second]), True),
            ],
            None, False, 0.5, lambda q: abs(float(q[2]) - hung),
        ),
        Task("ball in mug", [Body(mug, 0.002, still, False)], BALL, False, 0.5, lambda q: abs(float(q[2]) - low)),
        Task("cow on ground", [Body(cow, 0.004, drop, True)], None, True, 3.0, over_ground),
    ]  # fmt: skip


def scene_of(task: Task, way: str) -> tuple[cvi.Scene, np.ndarray]:
    """Return that of contactvi, and the start."""
    scene, start = cvi.Scene(), []
    for k, body in enumerate(task.bodies):
        name = f"body_{k}"
        placement = pin.XYZQUATToSE3(body.place)
        if way == "exact":
            scene.add_torus(name, RING, TUBE, mass=1.0, free=body.free, placement=placement)
        else:
            options: dict[str, Any] = {"spacing": body.spacing} if way == "field" else {"decompose": True}
            scene.add_mesh(name, body.mesh, mass=1.0, free=body.free, placement=placement, **options)
        if body.free:
            start.append(body.place)
    if task.ball is not None:
        scene.add_sphere("ball", task.ball)
        start.append(np.array([0.002, 0.001, 0.03, 0.0, 0.0, 0.0, 1.0]))
    if task.ground:
        scene.add_halfspace()
    scene.set_contact(restitution=0.0, friction=0.6)
    return scene, np.concatenate(start)


def run_contactvi(task: Task, way: str) -> tuple[float, float, int]:
    """Return the error [m], the time of a step with contact [s], and how many points there are at the end."""
    scene, start = scene_of(task, way)
    simulator = cvi.Simulator(scene, STEP, start="separate")
    simulator.reset(start)
    assert simulator.run(round(task.duration / STEP)).ok
    error, points = task.error(simulator.q), len(simulator.contacts)
    begin = time.process_time()
    simulator.run(TIMED)
    return error, (time.process_time() - begin) / TIMED, points


def mjcf_of(task: Task, way: str, folder: Path) -> str:
    """Return the scene of MuJoCo."""
    assets, bodies = [], []
    extension, scene = "", scene_of(task, "pieces")[0] if way == "pieces" else None
    for k, body in enumerate(task.bodies):
        shapes = []
        if way == "plugin":
            extension = (
                '<extension><plugin plugin="mujoco.sdf.torus"><instance name="t">'
                f'<config key="radius1" value="{RING}"/><config key="radius2" value="{TUBE}"/>'
                "</instance></plugin></extension>"
            )
            assets.append(f'<mesh name="m{k}"><plugin instance="t"/></mesh>')
            shapes.append(f'<geom type="sdf" mesh="m{k}" mass="1"><plugin instance="t"/></geom>')
        elif way == "field":
            write_obj(folder / f"m{k}.obj", *body.mesh)
            assets.append(f'<mesh name="m{k}" file="{folder / f"m{k}.obj"}"/>')
            shapes.append(f'<geom type="sdf" mesh="m{k}" mass="1"/>')
        else:
            assert scene is not None
            geometries = [g for g in scene.collision_model.geometryObjects if g.name.startswith(f"body_{k}_")]
            for i, g in enumerate(geometries):
                points = " ".join(f"{x:.9g}" for x in np.array(g.geometry.points()).ravel())
                assets.append(f'<mesh name="m{k}_{i}" vertex="{points}"/>')
                shapes.append(f'<geom type="mesh" mesh="m{k}_{i}" mass="{1.0 / len(geometries)}"/>')
        x, turn = body.place[:3], body.place[[6, 3, 4, 5]]
        where = f'pos="{" ".join(map(repr, map(float, x)))}" quat="{" ".join(map(repr, map(float, turn)))}"'
        bodies.append(f"<body {where}>{'<freejoint/>' if body.free else ''}{''.join(shapes)}</body>")
    if task.ball is not None:
        bodies.append(f'<body pos=".002 .001 .03"><freejoint/><geom size="{task.ball}" mass="1"/></body>')
    if task.ground:
        bodies.append('<geom type="plane" size="1 1 1"/>')
    return (
        f'<mujoco>{extension}<option timestep="{STEP}"/><default><geom friction=".6"/></default>'
        f"<asset>{''.join(assets)}</asset><worldbody>{''.join(bodies)}</worldbody></mujoco>"
    )


def write_obj(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write a mesh."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.write_text("\n".join(lines))


def run_mujoco(task: Task, way: str, folder: Path) -> tuple[float, float, int]:
    """As run_contactvi."""
    model = mujoco.MjModel.from_xml_string(mjcf_of(task, way, folder))
    data = mujoco.MjData(model)
    for _ in range(round(task.duration / STEP)):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    body = model.nbody - 1
    # The frame of a mesh, which MuJoCo has put in its centre of mass, may be another one; that of the body is not.
    place, turn = data.xpos[body], data.xquat[body]
    error, points = task.error(np.array([*place, *turn[1:], turn[0]])), int(data.ncon)
    begin = time.process_time()
    for _ in range(TIMED):
        mujoco.mj_step(model, data)
    return error, (time.process_time() - begin) / TIMED, points


def fall_of_a_field() -> None:
    """Print what keeps a height field on a free body over a plane and another height field: nothing does."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><asset><hfield name="h" nrow="4" ncol="4" size="1 1 1 .1"/></asset><worldbody>'
        '<geom type="plane" size="1 1 1"/><geom type="hfield" hfield="h" pos="0 0 .1"/><body pos="0 0 1"><freejoint/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom type="hfield" hfield="h"/></body></worldbody>'
        "</mujoco>"
    )
    model.hfield_data[:] = np.random.default_rng(0).random(len(model.hfield_data))
    data, most = mujoco.MjData(model), 0
    for _ in range(1000):
        mujoco.mj_step(model, data)
        most = max(most, int(data.ncon))
    print(f"A height field over a plane and a height field, MuJoCo {mujoco.__version__}: {most} contacts in", end=" ")
    print(f"{data.time:.3g} s, {data.qpos[2]:.3g} m high after it")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="part of the name of a scene")
    parser.add_argument("--fields", action="store_true", help="what MuJoCo does with a height field on a body")
    options = parser.parse_args()
    only = options.only
    if options.fields:
        fall_of_a_field()
        return
    print(f"{'scene':15} {'engine':10} {'shape':7} {'error [m]':>10} {'step [ms]':>10} {'points':>7}")
    for task in tasks():
        if only not in task.name:
            continue
        rings = task.name == "ring on ring"
        for way in (["exact"] if rings else []) + ["field", "pieces"]:
            report(task.name, "contactvi", way, lambda task=task, way=way: run_contactvi(task, way))
        with tempfile.TemporaryDirectory() as folder:
            for way in (["plugin"] if rings else []) + ["field", "pieces"]:
                report(
                    task.name, "MuJoCo", way,
                    lambda task=task, way=way, folder=folder: run_mujoco(task, way, Path(folder)),
                )  # fmt: skip


def report(scene: str, engine: str, way: str, run: Callable[[], tuple[float, float, int]]) -> None:
    """Print a line; a scene that cannot be made or run says why."""
    try:
        error, spent, points = run()
    except (ValueError, cvi.ContactviError) as failed:
        print(f"{scene:15} {engine:10} {way:7} {str(failed).splitlines()[0]}", flush=True)
        return
    print(f"{scene:15} {engine:10} {way:7} {error:10.1e} {1e3 * spent:10.3f} {points:7}", flush=True)


if __name__ == "__main__":
    main()
