"""Simulators and their snapshots as pickles: what follows has equal bits, in this process and in others."""

from __future__ import annotations

import hashlib
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from contactvi import _core
from contactvi.simulation import snapshot as snapshot_module
from helpers import constrained_scenes
from helpers.commands import environment
from helpers.loop_scenes import arm_scene

DT = 2e-3


def box_and_ball(**contact: float) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", size=(0.2, 0.2, 0.1), mass=2.0, placement=(0, 0, 0.1))
    scene.add_sphere("ball", radius=0.1, mass=0.5, placement=(0.5, 0, 0.2))
    scene.set_contact(**{"restitution": 0.2, "friction": 0.4, **contact})
    scene.v0 = scene.velocity({"box": (1, 0, 0), "ball": (-1, 0, 0)})
    return scene


def resting_boxes() -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(3):
        scene.add_box(f"box{k}", size=(0.2, 0.2, 0.2), mass=1.0, placement=(k, 0, 0.1))
    scene.set_contact(restitution=0.0, friction=0.5)
    return scene


def heaps() -> cvi.Scene:
    """Two heaps that fall apart from each other."""
    scene = cvi.Scene()
    scene.add_halfspace()
    speed = np.random.default_rng(4).standard_normal((8, 3))
    names = [f"box{k}" for k in range(8)]
    for k, name in enumerate(names):
        x, y, z = 2.0 * (k // 4), 0.05 * (k % 2), 0.08 + 0.12 * (k % 4)
        scene.add_box(name, size=(0.1, 0.12, 0.08), mass=1.0, placement=(x, y, z))
    scene.set_contact(restitution=0.3, friction=0.4)
    scene.v0 = scene.velocity(dict(zip(names, map(tuple, speed), strict=True)))
    return scene


def linkage() -> cvi.Scene:
    scene, q, v = constrained_scenes.linkage(joint_friction=0.02)
    scene.q0, scene.v0 = q, scene.consistent_velocity(q, v)
    return scene


def driven() -> cvi.Scene:
    """A joint that follows a function of Python."""
    scene, scene.q0, _ = constrained_scenes.driven_joint(joint_friction=0.02)
    return scene


def servo_arm() -> cvi.Scene:
    scene, times = arm_scene(2), np.linspace(0.0, 9.0, 40)
    scene.set_servo("j1", 20.0, 2.0, target=(times, np.sin(times)), effort=3.0)
    scene.set_servo("j2", 20.0, 2.0)
    scene.q0, scene.v0 = [0.3, -0.4], [1.0, 2.0]
    return scene


CASES: dict[str, tuple[Callable[[], cvi.Scene], dict]] = {
    "islands": (box_and_ball, {}),
    "islands of heaps": (heaps, {}),
    "islands at rest": (resting_boxes, {}),
    "dense steps": (heaps, {"contact_mode": "steps"}),
    "polynomials": (box_and_ball, {"dense": True, "order": 6}),
    "order 4": (box_and_ball, {"order": 4}),
    "MHC": (lambda: box_and_ball(restitution=1.0), {"impact": "mhc"}),
    "DTEC": (lambda: box_and_ball(restitution=0.9, friction=0.0), {"impact": "dtec"}),
    "ledger": (box_and_ball, {"ledger": {"gap": 1e-6}}),
    "some steps": (box_and_ball, {"record": 30}),
    "every seventh": (box_and_ball, {"record_every": 7}),
    "no record": (box_and_ball, {"record": False}),
    "constraints and joint friction": (linkage, {}),
    "a driven joint": (driven, {}),
    "servos": (servo_arm, {}),
}


def started(name: str, steps: int = 110) -> cvi.Simulator:
    make, options = CASES[name]
    sim = cvi.Simulator(make(), dt=DT, **options)
    sim.reset()
    sim.run(steps)
    return sim


def digest(sim: cvi.Simulator) -> str:
    """Of the present state and of all that was recorded."""
    parts = [np.array([sim.t]), sim.q, sim.v]
    if sim.options.last_steps != 0:
        traj = sim.trajectory()
        parts += [traj.t, traj.q, traj.p, traj.energy, *traj.events.arrays.values()]
        parts += [*traj.contacts.arrays.values(), *traj.contact_changes.arrays.values()]
        forces = traj.forces
        parts += [] if forces is None else [forces.values, forces.reactions]
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()


def gone_on(sim: cvi.Simulator, steps: int = 80) -> str:
    """Make steps, some of them one by one, some with a force, and return what came of it."""
    sim.run(steps)
    force = np.linspace(-1.0, 1.0, len(sim.v)) if sim.options.impact == "ctec" else None
    for _ in range(5):
        if sim.status.ok:
            sim.step(force)
    return digest(sim)


@pytest.mark.parametrize("name", CASES)
def test_a_pickled_simulator_goes_on_to_the_bit(name):
    sim = started(name)
    assert sim.status.ok
    twin, snapshot = pickle.loads(pickle.dumps((sim, sim.save())))
    other, again = cvi.Simulator.of(snapshot), pickle.loads(pickle.dumps(twin))
    expected = gone_on(sim)
    assert gone_on(twin) == expected
    assert gone_on(other) == expected
    assert gone_on(again) == expected


@pytest.mark.parametrize("name", CASES)
def test_bytes_hold_the_whole_state(name):
    """Read and written again they are the same."""
    sim = started(name)
    state = sim.save()
    data = state.engine.to_bytes()
    assert _core.Snapshot(state.scene.core, data).to_bytes() == data


@pytest.mark.thinned(3)
@pytest.mark.parametrize("instruction_set", ["", "base", "avx2"])
def test_another_process_goes_on(tmp_path, instruction_set):
    """Also one whose processor has other vectors: the bytes have none of the padding of the lanes."""
    names = ("islands of heaps", "islands at rest", "polynomials", "order 4", "constraints and joint friction")
    sims = [started(name) for name in names]
    (tmp_path / "sims.pickle").write_bytes(pickle.dumps(sims))
    code = (
        "import pickle, sys; sys.path.insert(0, sys.argv[2]); from simulation.test_pickled_simulators import gone_on\n"
        "for sim in pickle.load(open(sys.argv[1], 'rb')): print(gone_on(sim))"
    )
    given = {**environment(), **({"CONTACTVI_INSTRUCTION_SET": instruction_set} if instruction_set else {})}
    tests = str(Path(__file__).resolve().parents[1])
    command = [sys.executable, "-c", code, str(tmp_path / "sims.pickle"), tests]
    found = subprocess.run(command, cwd=tmp_path, env=given, capture_output=True, text=True, check=True)
    assert found.stdout.split() == [gone_on(sim) for sim in sims]


def test_gradients_of_a_run_that_was_pickled_on_its_way():
    """Steps in contact from before the pickle are in the derivative as those from after it are."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", radius=0.1, mass=0.5, placement=(0, 0, 0.12))
    scene.set_contact(restitution=0.0, friction=0.4)
    scene.v0 = [1, 0, 0, 0, 0, 0]
    sim = cvi.Simulator(scene, dt=5e-3, record="gradient")
    sim.reset()
    sim.run(40)
    assert len(sim.contacts) > 0
    twin = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(sim))))
    costs = []
    for one in (sim, twin, pickle.loads(pickle.dumps(twin))):
        one.run(20)
        costs.append(one.trajectory().gradient((np.arange(6.0), np.ones(6)), ("q0", "v0", "friction"))[1])
    assert np.any(costs[0]["friction"] != 0.0)
    for other in costs[1:]:
        assert all(np.array_equal(costs[0][name], other[name]) for name in costs[0])


def test_a_simulator_without_a_state():
    twin = pickle.loads(pickle.dumps(cvi.Simulator(box_and_ball(), dt=DT, order=4)))
    with pytest.raises(cvi.SimulationError, match="no state yet"):
        twin.step()
    twin.reset()
    twin.run(150)
    other = cvi.Simulator(box_and_ball(), dt=DT, order=4)
    other.reset()
    other.run(150)
    assert digest(twin) == digest(other)


def test_a_run_that_has_ended_stays_ended():
    sim = started("islands")
    sim.interrupt()
    twin = pickle.loads(pickle.dumps(sim))
    assert twin.status == sim.status
    assert not twin.status.ok
    with pytest.raises(cvi.SimulationError, match="has ended"):
        twin.step()


def test_bytes_of_another_scene_and_damaged_ones_are_refused():
    sim = started("islands at rest")
    core, data = sim.save().scene.core, sim.save().engine.to_bytes()
    other = started("order 4").save().scene.core
    for scene, given in ((other, data), (core, data[:-1]), (core, data[:200]), (core, data + b"\0"), (core, b"")):
        with pytest.raises(cvi.ContactviError, match="does not belong to its scene") as caught:
            _core.Snapshot(scene, given)
        assert caught.value.remedy


def test_snapshots_of_another_version_are_refused(monkeypatch):
    data = pickle.dumps(started("islands").save())
    monkeypatch.setattr(snapshot_module, "version", lambda: "0.0.1")
    with pytest.raises(cvi.ContactviError, match=r"another version.*0\.0\.1"):
        pickle.loads(data)


def test_a_pickled_snapshot_has_a_scene_of_its_own():
    sim = started("islands")
    with pytest.raises(cvi.InputError, match=r"Simulator\.of"):
        sim.load(pickle.loads(pickle.dumps(sim.save())))
    with pytest.raises(cvi.InputError, match="snapshot"):
        cvi.Simulator.of(sim)
