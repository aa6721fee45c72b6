"""A dozen runs of every kind and their digests: of one process in any order, of threads, of other processes.

As a script it prints {name: digests} as JSON.
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import contactvi as cvi
from contactvi.bench import heaps
from helpers import forced_systems, run_scenes
from helpers.digests import of_trajectory

Digests = dict[str, dict[str, Any]]
ROOT = Path(__file__).resolve().parents[2]
ANT = """
<mujoco><option timestep="0.002"/><worldbody>
<geom name="floor" type="plane" size="5 5 1" friction="0.8"/>
<body name="torso" pos="0 0 0.5"><freejoint/><geom type="sphere" size="0.15" mass="1"/>
<body pos="0.15 0 0"><joint name="hip" type="hinge" axis="0 1 0" range="-60 60" damping="0.2"/>
<geom type="capsule" fromto="0 0 0 0.3 0 -0.1" size="0.04" mass="0.2"/>
<body pos="0.3 0 -0.1"><joint name="knee" type="hinge" axis="0 1 0" range="-40 80" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0.1 0 -0.25" size="0.03" mass="0.1"/></body></body>
<body pos="-0.15 0 0"><joint name="ball" type="ball" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 -0.3 0 -0.1" size="0.04" mass="0.2"/></body></body>
</worldbody><actuator><position joint="hip" kp="5"/><motor joint="knee"/></actuator></mujoco>
"""


def _pendulum() -> cvi.Trajectory:
    scene = cvi.load_scene(ROOT / "models" / "double_pendulum_wall.toml")
    return cvi.simulate(scene, duration=2.0, dt=0.01, order=16)


def _map(name: str, order: int) -> Callable[[], cvi.Trajectory]:
    def run() -> cvi.Trajectory:
        scene = cvi.load_scene(ROOT / "models" / "double_pendulum_wall.toml")
        return cvi.simulate(scene, duration=6.0, dt=0.01, order=order, impact=name, throw=False)

    return run


def _auto() -> cvi.Trajectory:
    scene, q = run_scenes.hand_scene()
    return cvi.simulate(scene, q, duration=0.3, tol=1e-5)


def _sliding_box() -> cvi.Trajectory:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", size=(0.2, 0.2, 0.1), mass=2.0, placement=((0, 0, 0.1), (0.1, 0.2, 0.0)))
    scene.set_contact(restitution=0.2, friction=0.4)
    return cvi.simulate(scene, v0=scene.velocity({"box": (2, 0.3, 0)}), duration=1.0, dt=1e-3)


def _heap() -> cvi.Trajectory:
    scene, q, v = heaps.to_scene(heaps.make("tower", 3, friction=0.5, count=6))
    return cvi.simulate(scene, q, v, duration=0.3, dt=2e-3, contact_mode="steps", throw=False)


def _loops() -> cvi.Trajectory:
    system = next(system for system in forced_systems.SYSTEMS if system.name == "puppet")
    return cvi.simulate(*system.start(), duration=0.4, dt=1e-3, throw=False)


def _linkage() -> cvi.Trajectory:
    scene = cvi.load_scene(ROOT / "models" / "four_bar_striker.toml")
    return cvi.simulate(scene, duration=0.5, throw=False)


def _driven() -> cvi.Trajectory:
    scene, q = run_scenes.hand_scene()
    scene.set_servo("joint_*", kp=2.0, kd=0.05)
    goal = np.linspace(0.3, 0.9, len(scene.servo_joints))
    return cvi.simulate(scene, q, duration=0.3, dt=1e-3, target=lambda t: goal * np.cos(3.0 * t), throw=False)


def _controlled() -> cvi.Trajectory:
    scene, q = run_scenes.hand_scene()
    return cvi.simulate(
        scene, q, duration=0.2, dt=1e-3, order=6, throw=False,
        control=lambda t, q, v: 0.01 * np.sin(20.0 * t) * np.ones(scene.nv) - 1e-3 * v,
    )  # fmt: skip


def _mjcf() -> cvi.Trajectory:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ant.xml"
        path.write_text(ANT)
        scene = cvi.Scene.from_mjcf(path)
    return cvi.simulate(scene, duration=1.0, dt=1e-3, throw=False)


def _urdf() -> cvi.Trajectory:
    scene = cvi.Scene()
    scene.add_urdf("example-robot-data://robots/solo_description/robots/solo12.urdf", base="free")
    scene.add_halfspace(offset=-0.4)
    scene.set_contact(friction=0.6, restitution=0.1)
    return cvi.simulate(scene, duration=0.5, dt=1e-3, throw=False)


RUNS: dict[str, Callable[[], cvi.Trajectory]] = {
    "smooth, order 16": _pendulum,
    "dt auto, hand and ball": _auto,
    "CTEC": _map("ctec", 4),
    "DTEC": _map("dtec", 2),
    "MHC": _map("mhc", 2),
    "persistent contact with friction": _sliding_box,
    "heap in dense steps": _heap,
    "driven strings": _loops,
    "loop, string, prescribed motion, impacts": _linkage,
    "servos": _driven,
    "control function, order 6": _controlled,
    "MJCF robot": _mjcf,
    "URDF robot dropped": _urdf,
}
if sys.version_info < (3, 11):  # mujoco-core, which reads the file, has no version for Python 3.10
    del RUNS["MJCF robot"]


def run(name: str) -> dict[str, Any]:
    """The digests of one run."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return of_trajectory(RUNS[name]())


def in_order(names: list[str]) -> Digests:
    """The digests of runs one after the other."""
    return {name: run(name) for name in names}


def shuffled(seed: int) -> list[str]:
    """The names of all runs in another order."""
    names = list(RUNS)
    random.Random(seed).shuffle(names)
    return names


def in_threads(count: int) -> list[Digests]:
    """All runs in each of several threads at the same time, each in an order of its own."""
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(in_order, [shuffled(seed) for seed in range(count)]))


def in_process(**environment: str) -> Digests:
    """All runs in a process of its own with these environment variables."""
    done = subprocess.run(
        [sys.executable, __file__], env={**os.environ, **environment}, stdout=subprocess.PIPE, text=True, check=True
    )
    return dict(json.loads(done.stdout))


def differing(expected: Digests, found: Digests) -> list[str]:
    """The runs whose digests differ, and in what."""
    return [
        f"{name}: {', '.join(key for key in expected[name] if expected[name][key] != found[name][key])}"
        for name in expected
        if found[name] != expected[name]
    ]


if __name__ == "__main__":
    print(json.dumps(in_order(list(RUNS))))
