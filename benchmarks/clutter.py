"""A gripper takes an object out of a bin of others: runs that end early, clamp or drop it, and their time over MuJoCo.

    python benchmarks/clutter.py [--seeds 0:20] [--objects 8] [--wrists pose,joints,servos] [--mode auto]
                                 [--json FILE]

Spheres, boxes, capsules and cylinders of 2 to 4 cm fall into a bin and come to rest for .6 s. Then a gripper with two
fingers, driven by servos within their efforts, goes down over the object that it reaches best, closes, and lifts it by
.2 m: 2 s in all. Its wrist is a free body whose pose is prescribed (pose), three prescribed joints (joints), or three
joints with servos (servos). Steps of 1 ms. MuJoCo's time is that of the wrist with servos, with steps of 2 ms.

A run is well if it ends with SUCCESS, its least gap (`scene.gaps` at 100 nodes) is above -1e-9 m, and the object is in
the gripper at its end. What a prescribed wrist makes impossible, an object between finger and floor, ends with
CONSTRAINT and its name; that is counted by itself.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import tempfile
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi.bench.mujoco_peer import MujocoPeer

SETTLE, DURATION, DT, PEER_DT = 0.6, 2.0, 1e-3, 2e-3
HIGH, LIFT = 0.35, 0.2  # [m] of the wrist at the start; by which it is raised at the end
FINGER, OPEN = 0.1, 0.045  # length of the fingers, and how far each is from the middle when open [m]
WRISTS = ("pose", "joints", "servos")

GRIPPER = """<robot name="gripper">
{gantry}
<link name="palm">
  <inertial><mass value="0.4"/><inertia ixx="4e-4" iyy="4e-4" izz="4e-4" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="0.14 0.04 0.02"/></geometry></collision>
</link>
<joint name="left" type="prismatic"><parent link="palm"/><child link="finger_l"/><origin xyz="-{open} 0 0"/>
  <axis xyz="1 0 0"/><limit lower="0" upper="{open}" effort="20" velocity="1"/></joint>
<joint name="right" type="prismatic"><parent link="palm"/><child link="finger_r"/><origin xyz="{open} 0 0"/>
  <axis xyz="-1 0 0"/><limit lower="0" upper="{open}" effort="20" velocity="1"/></joint>
{fingers}
</robot>"""
LINK = """<link name="finger_{side}">
  <inertial><origin xyz="0 0 -{middle}"/><mass value="0.05"/><inertia ixx="5e-5" iyy="5e-5" izz="1e-5" ixy="0" ixz="0"
   iyz="0"/></inertial>
  <collision><origin xyz="0 0 -{middle}"/><geometry><box size="0.008 0.02 {length}"/></geometry></collision>
</link>"""
SLIDE = """<link name="{parent}"><inertial><mass value="0.5"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0"
   iyz="0"/></inertial></link>
<joint name="wrist_{axis}" type="prismatic"><parent link="{parent}"/><child link="{child}"/>
  <axis xyz="{direction}"/><limit lower="-1" upper="1" effort="100" velocity="5"/></joint>"""


def urdf(gantry: bool) -> str:
    """The gripper, on three slides or alone."""
    slides = (
        ("base", "x", "slide_x", "1 0 0"),
        ("slide_x", "y", "slide_y", "0 1 0"),
        ("slide_y", "z", "palm", "0 0 1"),
    )
    parts = "".join(SLIDE.format(parent=p, axis=a, child=c, direction=d) for p, a, c, d in slides) if gantry else ""
    fingers = "".join(LINK.format(side=s, length=FINGER, middle=0.012 + FINGER / 2) for s in "lr")
    return GRIPPER.format(gantry=parts, open=OPEN, fingers=fingers)


@dataclass
class Plan:
    """Where the wrist goes: over the object, down to it, and up again with it."""

    x: float
    y: float
    low: float

    def place(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the wrist's place and velocity."""
        down, down_rate = _ramp(t, 0.1, 0.7)
        up, up_rate = _ramp(t, 1.2, 1.9)
        z = HIGH + (self.low - HIGH) * down + LIFT * up
        rate = (self.low - HIGH) * down_rate + LIFT * up_rate
        return np.array([self.x, self.y, z]), np.array([0.0, 0.0, rate])

    @staticmethod
    def finger(t: float) -> tuple[float, float]:
        """Return the reference of each finger, which goes beyond the object, and its rate."""
        s, rate = _ramp(t, 0.75, 1.05)
        return OPEN * s, OPEN * rate


def _ramp(t: float, start: float, end: float) -> tuple[float, float]:
    s = min(1.0, max(0.0, (t - start) / (end - start)))
    return s * s * (3.0 - 2.0 * s), 6.0 * s * (1.0 - s) / (end - start)


def bin_of(seed: int, count: int) -> tuple[cvi.Scene, dict[str, tuple[Any, Any]]]:
    """The bin and the objects over it, with a distance between them."""
    rng = np.random.default_rng([seed, count])
    scene = cvi.Scene()
    side = 0.2 if count <= 10 else 0.26
    scene.add_box("floor", size=(side + 0.04, side + 0.04, 0.02), free=False, placement=(0.0, 0.0, -0.01))
    for k, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
        size = (0.02, side + 0.04, 0.08) if x else (side, 0.02, 0.08)
        scene.add_box(f"wall{k}", size=size, free=False, placement=(x * (side / 2 + 0.01), y * (side / 2 + 0.01), 0.04))
    places = {}
    spots = [(i, j, k) for k in range(20) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    for n in range(count):
        i, j, k = spots[n]
        place = side / 3 * np.array([i, j, 0.0]) * 0.9 + np.array([0.0, 0.0, 0.04 + 0.055 * k])
        name, density = f"object{n}", 800.0
        r = rng.uniform(0.010, 0.018)
        kind = rng.integers(4)
        if kind == 0:
            scene.add_sphere(name, r, mass=density * 4 / 3 * math.pi * r**3)
        elif kind == 1:
            size = rng.uniform(0.02, 0.035, 3)
            scene.add_box(name, size=tuple(size), mass=density * float(np.prod(size)))
        elif kind == 2:
            scene.add_capsule(name, radius=0.7 * r, length=1.2 * r, mass=density * math.pi * r**3)
        else:
            scene.add_cylinder(name, radius=r, length=1.6 * r, mass=density * 1.6 * math.pi * r**3)
        places[name] = (tuple(place), tuple(rng.uniform(-1.0, 1.0, 3)))
    return scene, places


def gripper_scene(
    seed: int, count: int, wrist: str, plan: Plan, places: dict[str, Any], folder: Path
) -> tuple[cvi.Scene, np.ndarray]:
    """The bin with the gripper at its start."""
    scene, _ = bin_of(seed, count)
    path = folder / f"gripper_{wrist}.urdf"
    path.write_text(urdf(gantry=wrist != "pose"))
    start = plan.place(0.0)[0]
    scene.add_urdf(path, base="free" if wrist == "pose" else "fixed", self_collision=False)
    if wrist == "pose":

        def pose(t: float) -> Any:
            place, rate = plan.place(t)
            return pin.SE3(np.eye(3), place), (rate, np.zeros(3))

        scene.prescribe("palm", pose, name="wrist")
    for k, axis in enumerate("xyz"):
        if wrist == "pose":
            break
        motion = [lambda t, k=k: float(plan.place(t)[0][k]), lambda t, k=k: float(plan.place(t)[1][k]), lambda t: 0.0]
        if wrist == "joints":
            scene.prescribe(f"wrist_{axis}", lambda t, m=motion: tuple(f(t) for f in m), name=f"wrist_{axis}")
        else:
            scene.set_servo(f"wrist_{axis}", kp=2e4, kd=400.0, effort=200.0, target=motion[0])
    for side in ("left", "right"):
        scene.set_servo(side, kp=2e3, kd=40.0, effort=8.0, target=lambda t: Plan.finger(t)[0])
    scene.set_contact(restitution=0.0, friction=0.8)
    values = dict(places)
    values |= {"root_joint": (tuple(start), (0.0, 0.0, 0.0))} if wrist == "pose" else {
        f"wrist_{a}": float(start[k]) for k, a in enumerate("xyz")
    }  # fmt: skip
    return scene, scene.configuration(values)


def settled(seed: int, count: int) -> tuple[dict[str, Any], str, Plan]:
    """Return the places of the objects at rest, the highest of them, and the plan that takes it."""
    scene, places = bin_of(seed, count)
    scene.set_contact(restitution=0.0, friction=0.8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cvi.DenseStepWarning)
        traj = cvi.simulate(scene, scene.configuration(places), duration=SETTLE, dt=DT)
    q = traj.q[-1]
    rest = {name: pin.XYZQUATToSE3(q[scene.q_index(name)]) for name in places}
    # The one with the most room for the fingers beside it, among those that they reach.
    middles = np.array([pose.translation for pose in rest.values()])

    def room(name: str) -> float:
        at = rest[name].translation
        tips = [at + np.array([side * OPEN, 0.0, -0.01]) for side in (-1.0, 1.0)]
        near = min(float(np.sort(np.linalg.norm(middles - tip, axis=1))[0]) for tip in tips)
        return near + float(at[2]) if abs(at[0]) < 0.03 else -1.0

    highest = max(rest, key=room)
    x, y, z = rest[highest].translation
    return rest, highest, Plan(float(x), float(y), max(float(z) + FINGER - 0.008, FINGER + 0.016))


def peer_time(scene: cvi.Scene, q: np.ndarray, plan: Plan) -> float:
    """Return MuJoCo's time for the same run, with the wrist on servos [s]."""
    peer = MujocoPeer(scene, PEER_DT)
    data = peer.data(q, np.zeros(scene.nv))
    names = list(scene.model.names)[1:]
    spent = 0.0
    for k in range(round(DURATION / PEER_DT)):
        t = k * PEER_DT
        wanted = {f"wrist_{axis}": x for axis, x in zip("xyz", plan.place(t)[0], strict=True)}
        wanted |= dict.fromkeys(("left", "right"), Plan.finger(t)[0])
        for number, joint in peer.servos:
            data.ctrl[number] = wanted[names[joint]]
        before = time.process_time()
        peer.mujoco.mj_step(peer.model, data)
        spent += time.process_time() - before
    return spent


def run(seed: int, count: int, wrist: str, mode: str, folder: Path) -> dict[str, Any]:
    """One run and what it was like."""
    rest, wanted, plan = settled(seed, count)
    places = {name: pin.SE3ToXYZQUAT(pose) for name, pose in rest.items()}
    scene, q0 = gripper_scene(seed, count, wrist, plan, places, folder)
    peer = peer_time(scene, q0, plan) if wrist == "servos" else math.nan
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            traj = cvi.simulate(scene, q0, duration=DURATION, dt=DT, contact_mode=mode, start="separate")
        except cvi.SimulationError as error:
            traj = error.trajectory
    nodes = np.linspace(0, len(traj.t) - 1, 100).astype(int)
    gaps = [float(np.min(scene.gaps(q))) for q in traj.q[nodes]]
    at = traj.q[-1][scene.q_index(wanted)][:3]
    held = bool(np.linalg.norm(at - plan.place(DURATION)[0] + np.array([0, 0, FINGER])) < 0.04)
    return {
        "seed": seed, "objects": count, "wrist": wrist, "status": traj.status.code.name, "message": traj.status.message,
        "reached": float(traj.t[-1]), "seconds": float(traj.stats.seconds), "peer": peer, "gap": min(gaps),
        "held": held,
        "impacts": len(traj.events), "dense": len(traj.dense_steps), "halved": traj.stats.halved,
        "said": sorted({type(w.message).__name__ for w in said}),
        "residual": float(traj.dense_steps.array("residual").max()) if len(traj.dense_steps) else 0.0,
    }  # fmt: skip


def line(row: dict[str, Any]) -> str:
    """One run in words."""
    return (
        f"{row['seed']:4d} {row['wrist']:7s} {row['status']:12s} at {row['reached']:.3f} s  {row['seconds']:.3f} s "
        f"(MuJoCo {row['peer']:.3f})  gap {row['gap']:.1e}  held {row['held']}  impacts {row['impacts']} "
        f"dense {row['dense']} halved {row['halved']} residual {row['residual']:.1e}  {row['message'][:70]}"
    )


def main() -> None:
    """Run the scenes and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0:20")
    parser.add_argument("--objects", type=int, default=8)
    parser.add_argument("--wrists", default=",".join(WRISTS))
    parser.add_argument("--mode", default="auto")
    parser.add_argument("--json")
    args = parser.parse_args()
    first, _, last = args.seeds.partition(":")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(int(first), int(last or int(first) + 1)):
            for wrist in args.wrists.split(","):
                row = run(seed, args.objects, wrist, args.mode, Path(folder))
                rows.append(row)
                print(line(row), flush=True)
    if args.json:
        Path(args.json).write_text("".join(json.dumps(row) + "\n" for row in rows))
    for wrist in args.wrists.split(","):
        mine = [row for row in rows if row["wrist"] == wrist]
        print(
            f"{wrist}: {sum(r['status'] == 'SUCCESS' for r in mine)} SUCCESS, "
            f"{sum(r['status'] == 'CONSTRAINT' for r in mine)} CONSTRAINT of {len(mine)}; held "
            f"{sum(r['held'] for r in mine)}; seconds median {statistics.median(r['seconds'] for r in mine):.3f}, "
            f"worst {max(r['seconds'] for r in mine):.3f}"
        )


if __name__ == "__main__":
    main()
