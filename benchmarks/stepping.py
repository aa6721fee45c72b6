"""What Python costs around a step, beside the bars, and a loop like that of an environment of Gym beside MuJoCo.

    python benchmarks/stepping.py [--repeats 9]

All in one run, in microseconds, minimum of the repeats: other programs only make them longer. A pendulum (one uniform
rod) and the Allegro hand of example-robot-data with its own collision pairs, dt 1e-3, both from rest.

- step: `Simulator.step` less the engine's own time, that of the same steps in one call of `run`, for each record.
- reset, and `simulate` of one step, each from another start.
- loop: 4 steps with a torque, q and v read, a reset every 100 times; MuJoCo does the same with the same model and dt.
  Share: MuJoCo's time over ours, at least 0.5 is wanted.
"""

from __future__ import annotations

import argparse
import itertools
import timeit
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi.importing.paths import resolve_path
from models import ROBOTS, chain

DT, STEPS, SUBSTEPS, EPISODE = 1e-3, 500, 4, 100
HAND = "allegro_hand_description/urdf/allegro_right_hand.urdf"
PENDULUM = """<mujoco><worldbody><body><joint type="hinge" axis="0 1 0"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="0.08333333 0.08333333 0.08333333"/></body></worldbody></mujoco>"""
BARS = {"step": 3.0, "reset": 20.0, "simulate": {"pendulum": 40.0, "Allegro hand": 100.0}, "share": 0.5}


def scenes() -> dict[str, cvi.Scene]:
    hand = cvi.Scene()
    hand.add_urdf(ROBOTS + HAND, base="fixed", mimic=False)
    return {"pendulum": cvi.Scene.from_pinocchio(chain(1), pin.GeometryModel()), "Allegro hand": hand}


def fastest(function: Callable[[], object], calls: int, repeats: int) -> float:
    """Time of a call [us]."""
    return 1e6 * min(timeit.repeat(function, number=calls, repeat=repeats)) / calls


def step_times(scene: cvi.Scene, repeats: int, **record: Any) -> tuple[float, float]:
    """Time of the engine and of all of a step from Python [us]."""
    sim = cvi.Simulator(scene, dt=DT, **record)

    def by_the_engine() -> None:
        sim.reset()
        sim.run(STEPS)

    def by_the_caller() -> None:
        sim.reset()
        for _ in range(STEPS):
            sim.step()

    reset = fastest(sim.reset, 20, repeats)
    engine, whole = (fastest(f, 1, repeats) - reset for f in (by_the_engine, by_the_caller))
    return engine / STEPS, whole / STEPS


def our_loop(scene: cvi.Scene, repeats: int) -> float:
    """Time of one pass of the loop [us]."""
    sim = cvi.Simulator(scene, dt=DT, record=False)
    tau = np.full(scene.model.nv, 1e-3)

    def loop() -> None:
        sim.reset()
        for _ in range(EPISODE):
            for _ in range(SUBSTEPS):
                sim.step(tau)
            _ = sim.q, sim.v

    return fastest(loop, 1, repeats) / EPISODE


def mujoco_model(name: str) -> Any:
    import mujoco

    if name == "pendulum":
        model = mujoco.MjModel.from_xml_string(PENDULUM)
    else:
        file = resolve_path(ROBOTS + HAND)
        root = ET.parse(file).getroot()
        for mesh in root.iter("mesh"):  # "package://example-robot-data/robots/..."
            mesh.set("filename", str(resolve_path(mesh.get("filename", ""), file.parent)))
        options = ET.SubElement(ET.SubElement(root, "mujoco"), "compiler")
        options.set("strippath", "false")
        options.set("balanceinertia", "true")  # the file's inertia of link_3.0 breaks the triangle inequality
        model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    model.opt.timestep = DT
    return model


def mujoco_loop(name: str, repeats: int) -> float:
    """Time of the same loop in MuJoCo [us]."""
    import mujoco

    model = mujoco_model(name)
    data = mujoco.MjData(model)
    tau = np.full(model.nv, 1e-3)

    def loop() -> None:
        mujoco.mj_resetData(model, data)
        for _ in range(EPISODE):
            for _ in range(SUBSTEPS):
                data.qfrc_applied[:] = tau
                mujoco.mj_step(model, data)
            _ = data.qpos.copy(), data.qvel.copy()

    return fastest(loop, 1, repeats) / EPISODE


def step_overhead(scene: cvi.Scene, repeats: int, **record: Any) -> tuple[float, float]:
    """Time of the engine, and what Python adds to it, of a step [us]."""
    engine, whole = step_times(scene, repeats, **record)
    return engine, whole - engine


def other_starts(scene: cvi.Scene) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Starts (q, v) that differ from one to the next."""
    rng = np.random.default_rng(0)
    q = scene.neutral() + 1e-3 * np.arange(50)[:, None]
    return itertools.cycle(zip(q, 1e-3 * rng.standard_normal((50, scene.nv)), strict=True))


def reset_time(scene: cvi.Scene, repeats: int) -> float:
    """Time of a reset, each to another start [us]."""
    sim, starts = cvi.Simulator(scene, dt=DT, record=False), other_starts(scene)
    return fastest(lambda: sim.reset(*next(starts)), 10, 10 * repeats)


def simulate_time(scene: cvi.Scene, repeats: int) -> float:
    """Time of `simulate` of one step, each from another start [us]."""
    starts = other_starts(scene)

    def once() -> None:
        q, v = next(starts)
        cvi.simulate(scene, q, v, duration=DT, dt=DT)

    return fastest(once, 5, 10 * repeats)


def loop_times(name: str, scene: cvi.Scene, repeats: int) -> tuple[float, float]:
    """Time of one pass of the loop, ours and MuJoCo's [us]."""
    return our_loop(scene, repeats), mujoco_loop(name, repeats)


def line(what: str, value: float, bar: float | None = None, least: bool = False) -> None:
    if bar is None:
        print(f"  {what:<42}{value:9.2f}")
        return
    kept = value >= bar if least else value <= bar
    print(f"  {what:<42}{value:9.2f}   {'>=' if least else '<='} {bar:g}  {'met' if kept else 'MISSED'}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=9)
    repeats = parser.parse_args().repeats
    for name, scene in scenes().items():
        print(f"{name} [us]")
        for record in ({}, {"record": 100}, {"record": False}):
            engine, python = step_overhead(scene, repeats, **record)
            line(f"step beside the engine's {engine:.2f}, {record or 'all recorded'}", python, BARS["step"])
        line("reset", reset_time(scene, repeats), BARS["reset"])
        line("simulate of one step", simulate_time(scene, repeats), BARS["simulate"][name])
        ours, theirs = loop_times(name, scene, repeats)
        line("loop", ours)
        line("loop, MuJoCo", theirs)
        line("share", theirs / ours, BARS["share"], least=True)


if __name__ == "__main__":
    main()
