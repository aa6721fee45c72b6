"""What lies still costs nothing and keeps its record: beside runs in which every step is solved."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers import engine

Array = np.ndarray


def at(*position: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(position))


def idle(count: int) -> tuple[cvi.Scene, Array]:
    """Return boxes on the ground, and a rod that tumbles far above them, with its velocity."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_capsule("rod", 0.05, 0.3, placement=at(-20.0, 0.0, 50.0))
    for k in range(count):
        scene.add_box(f"box{k}", (0.1, 0.1, 0.1), placement=at(0.3 * (k % 30), 0.3 * (k // 30), 0.05))
    scene.set_contact(restitution=0.0, friction=0.5)
    v = np.zeros(scene.nv)
    v[scene.v_index("rod")] = [0.3, 0.0, 10.0, 0.5, 2.0, 0.1]
    return scene, v


def test_a_step_costs_what_moves():
    """400 boxes that lie still below a rod that tumbles: the time of a step is less than thrice that without them."""
    times = []
    for count in (4, 400):
        scene, v = idle(count)
        simulator = cvi.Simulator(scene, dt=1e-3, record_every=10_000)
        simulator.reset(scene.neutral(), v)
        simulator.run(60)
        best = np.inf
        for _ in range(5):
            began = time.process_time()
            simulator.run(400)
            best = min(best, time.process_time() - began)
        times.append(best)
    assert times[1] < 3.0 * times[0]


@pytest.mark.parametrize("calls", [(200,), (70, 1, 129), (1,) * 60 + (140,)])
def test_the_record_of_what_lies_still_is_whole(calls):
    """One row per point and step, with its times, whatever the calls in which the run is made."""
    scene, v = idle(3)
    simulator = cvi.Simulator(scene, dt=1e-3)
    simulator.reset(scene.neutral(), v)
    for steps in calls:
        simulator.run(steps)
        assert len(simulator.contacts) == 12
    rows = simulator.trajectory().contacts
    dt, steps = 1e-3, sum(calls)
    assert len(rows) == 12 * steps
    assert np.all(np.diff(rows.t) >= 0.0)
    assert np.array_equal(rows.array("step"), np.repeat(np.arange(steps), 12))
    assert np.array_equal(rows.t, dt * rows.array("step"))
    points = {(row, point) for row, point in zip(rows.array("index"), rows.array("point"), strict=True)}
    assert len(points) == 12
    weight = sum(inertia.mass for inertia in scene.model.inertias[2:]) * 9.81
    total = np.bincount(rows.array("step"), weights=rows.impulse[:, 2])
    assert np.abs(total / dt - weight).max() <= 1e-9 * weight


def test_a_record_goes_on_from_a_saved_state():
    scene, v = idle(2)
    simulator = cvi.Simulator(scene, dt=1e-3)
    simulator.reset(scene.neutral(), v)
    simulator.run(100)
    kept = simulator.save()
    ends = []
    for _ in range(2):
        simulator.load(kept)
        simulator.run(30)
        ends.append(simulator.trajectory().contacts)
    assert len(ends[0]) == len(ends[1]) == 8 * 130
    for name in ("t", "start", "end", "position"):
        assert np.array_equal(ends[0].array(name), ends[1].array(name))


def beside_solved(scene: cvi.Scene, steps: int) -> list[dict[str, Any]]:
    """Return what the engine tells of a run from rest, and the same with all bodies advanced together."""
    found = []
    for islands in (True, False):
        simulator = engine.simulator(scene.core(), 1e-3, islands=islands)
        simulator.reset(scene.neutral(), np.zeros(scene.nv))
        found.append(simulator.advance(steps))
        assert found[-1]["code"] == 0
    return found


def test_a_heap_that_lies_still_is_hit():
    """Two boxes on each other fall asleep as one; a ball hits them after half a second."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(2):
        scene.add_box(f"box{k}", (0.2, 0.2, 0.1), placement=at(0.0, 0.0, 0.05 + 0.1 * k))
    for k in range(2):
        scene.add_box(f"other{k}", (0.1, 0.1, 0.1), placement=at(1.0 + 0.3 * k, 0.0, 0.05))
    scene.add_sphere("ball", 0.05, 0.2, placement=at(0.02, 0.01, 0.25 + 0.5 * 9.81 * 0.25))
    scene.set_contact(restitution=0.0, friction=0.5)
    sleeping, solved = beside_solved(scene, 700)
    hits = sleeping["events"]["time"], solved["events"]["time"]
    assert len(hits[0]) == len(hits[1]) > 0
    assert np.abs(np.subtract(*hits)).max() <= 1e-9
    assert np.abs(sleeping["q"] - solved["q"]).max() <= 1e-8
    assert sleeping["stats"]["contact_steps"] < 0.5 * 3 * 700


def test_one_of_many_is_pushed():
    """A force wakes its own body alone, also after a return to a state before it."""
    scene, v = idle(20)
    dofs = scene.v_index("box7")
    tau = np.zeros((100, scene.nv))
    tau[50:, dofs.start] = 1.5 * 0.5 * 9.81 * scene.model.inertias[scene.model.getJointId("box7")].mass
    ends = []
    simulator = cvi.Simulator(scene, dt=1e-3)
    simulator.reset(scene.neutral(), v)
    simulator.run(60, tau=np.zeros((60, scene.nv)))
    before = simulator.trajectory().stats.contact_steps
    kept = simulator.save()
    for _ in range(2):
        simulator.run(100, tau=tau)
        ends.append(simulator.q)
        simulator.load(kept)
        simulator.run(1, tau=tau[-1:])
        simulator.load(kept)
    moved = np.abs(ends[0] - scene.neutral()) > 1e-6
    assert set(np.flatnonzero(moved)) <= {
        *range(scene.nq)[scene.q_index("rod")],
        *range(scene.nq)[scene.q_index("box7")],
    }
    assert moved.sum() >= 2
    assert np.array_equal(ends[0], ends[1])
    assert before < 20 * 60


def test_constraints_of_what_lies_still_keep_their_forces():
    """A body hangs by a rod from a box that lies on the ground: the reaction stays what it was."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("low", (0.2, 0.2, 0.1), 2.0, placement=at(0.0, 0.0, 0.05))
    scene.add_box("high", (0.1, 0.1, 0.1), 1.0, placement=at(0.0, 0.0, 0.15))
    scene.add_weld("low", "high")
    for k in range(3):
        scene.add_box(f"other{k}", (0.1, 0.1, 0.1), placement=at(1.0 + 0.3 * k, 0.0, 0.05))
    scene.set_contact(restitution=0.0, friction=0.5)
    sleeping, solved = beside_solved(scene, 200)
    assert sleeping["stats"]["contact_steps"] < 100 * 4
    assert np.abs(solved["reactions"][-1]).max() > 1.0
    assert np.abs(sleeping["reactions"] - solved["reactions"]).max() <= 1e-6
