"""Scenes, runs, batches and snapshots as copies: pickle and deepcopy give equal bits afterwards."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest

import contactvi as cvi
from contactvi.trajectory.tables import TABLES
from helpers.commands import environment


def twin_of(way: str, item):
    return copy.deepcopy(item) if way == "deepcopy" else pickle.loads(pickle.dumps(item))


def scene_of_a_box() -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", size=(0.2, 0.2, 0.1), mass=2.0, placement=(0, 0, 0.1))
    scene.add_sphere("ball", radius=0.1, mass=0.5, placement=(0.5, 0, 0.2))
    scene.set_contact(restitution=0.2, friction=0.4)
    return scene


def run_of(scene: cvi.Scene, **options) -> cvi.Trajectory:
    return cvi.simulate(scene, v0=scene.velocity({"box": (1, 0, 0)}), dt=5e-3, duration=0.5, **options)


def assert_equal_runs(one: cvi.Trajectory, other: cvi.Trajectory) -> None:
    for name in TABLES:
        for column in one.table(name).columns:
            assert np.array_equal(
                one.table(name).column(column), other.table(name).column(column), equal_nan="f" in
                one.table(name).column(column).dtype.kind,
            ), (name, column)  # fmt: skip
    assert (one.status, one.stats, one.options) == (other.status, other.stats, other.options)
    assert np.array_equal(one.ledger.energy, other.ledger.energy)


@pytest.mark.parametrize("way", ["pickle", "deepcopy"])
def test_scenes(way):
    scene = scene_of_a_box()
    twin = twin_of(way, scene)
    assert_same_motion(run_of(scene), run_of(twin))
    twin.add_sphere("more", radius=0.1, mass=1.0, placement=(3, 0, 1))
    assert scene.nv == 12


def assert_same_motion(one: cvi.Trajectory, other: cvi.Trajectory) -> None:
    for name in ("t", "q", "p"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


@pytest.mark.parametrize("way", ["pickle", "deepcopy"])
@pytest.mark.parametrize("options", [{}, {"order": 6, "dense": True}, {"impact": "mhc"}], ids=str)
def test_runs(way, options):
    traj = run_of(scene_of_a_box(), **options)
    twin = twin_of(way, traj)
    assert_equal_runs(traj, twin)
    if options.get("dense"):
        assert np.array_equal(traj.at([0.1234, 0.3]).v, twin.at([0.1234, 0.3]).v)
    assert_same_motion(run_of(twin.scene, **options), traj)
    assert_equal_runs(twin_of(way, twin), traj)  # a copy of a copy


@pytest.mark.parametrize("way", ["pickle", "deepcopy"])
def test_runs_with_derivatives(way):
    """Of a ball that lands, slides and rolls: gradients need its steps in contact again."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", radius=0.1, mass=0.5, placement=(0, 0, 0.12))
    scene.set_contact(restitution=0.0, friction=0.4)
    traj = cvi.simulate(scene, v0=[1, 0, 0, 0, 0, 0], dt=5e-3, duration=0.3, record="gradient")
    assert np.any(traj.contacts.h > 0.0)
    twin = twin_of(way, traj)
    cost = np.arange(6.0), np.ones(6)
    expected, got = (run.gradient(cost, ("q0", "v0", "friction"))[1] for run in (traj, twin))
    assert np.any(expected["friction"] != 0.0)
    assert all(np.array_equal(expected[name], got[name]) for name in expected)


@pytest.mark.parametrize("way", ["pickle", "deepcopy"])
def test_logs_are_small_copies(way):
    """What follows from the arrays of a log, the impulses and forces, is not in its pickle."""
    log = run_of(scene_of_a_box()).contacts
    before = len(pickle.dumps(log))
    assert np.all(np.isfinite(log.force[log.h > 0.0]))
    assert len(pickle.dumps(log)) == before
    twin = twin_of(way, log)
    assert np.array_equal(twin.force, log.force, equal_nan=True)
    assert twin[0].pair == log[0].pair


@pytest.mark.parametrize("way", ["pickle", "deepcopy"])
@pytest.mark.parametrize("keep", ["ends", "nodes", "runs"])
def test_batches(way, keep):
    scene = scene_of_a_box()
    v0s = np.zeros((4, 12))
    v0s[:, 0] = np.arange(4)
    q0s = np.tile(scene.neutral(), (4, 1))
    q0s[2, 2] = -1.0  # a start that is refused
    batch = cvi.simulate_batch(scene, q0s, v0s, dt=5e-3, duration=0.5, keep=keep)
    for twin in (twin_of(way, batch), twin_of(way, batch)):
        for name in ("t", "q", "v", "nodes", "impacts", "ok"):
            assert np.array_equal(getattr(batch, name), getattr(twin, name), equal_nan=name in "tqv")
        assert list(twin.status) == list(batch.status)
        assert {k: str(error) for k, error in twin.errors.items()} == {k: str(e) for k, e in batch.errors.items()}
        if keep == "runs":
            assert_equal_runs(batch[1], twin[1])
            with pytest.raises(cvi.PenetrationError):
                twin[2]


def test_a_run_of_a_batch_is_made_once():
    """Whoever asks for it first: the batch, a slice of it, or pickle."""
    scene = scene_of_a_box()
    batch = cvi.simulate_batch(scene, v0s=np.zeros((3, 12)), dt=5e-3, duration=0.1, keep="runs")
    part = batch[1:]
    first = part[0]
    assert batch[1] is first
    assert len(pickle.loads(pickle.dumps(batch))[1]) == len(first)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy])
def test_snapshots_are_copied(copied):
    sim = cvi.Simulator(scene_of_a_box(), dt=5e-3)
    sim.reset()
    sim.run(30)
    saved = sim.save()
    twin = copied(saved)
    sim.run(40)
    expected = sim.trajectory()
    for start in (twin, saved, twin):
        sim.load(start)
        sim.run(40)
        assert_same_motion(sim.trajectory(), expected)


def test_another_process_reads_a_run(tmp_path):
    """Values are computed there, by an engine that is built there, and have the same bits."""
    traj = run_of(scene_of_a_box())
    (tmp_path / "run.pickle").write_bytes(pickle.dumps(traj))
    code = (
        "import pickle, sys; traj = pickle.load(open(sys.argv[1], 'rb')); "
        "print((traj.energy.tobytes() + traj.v.tobytes() + traj.gaps[2].tobytes()).hex())"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "run.pickle")]
    found = subprocess.run(command, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=True)
    assert found.stdout.strip() == (traj.energy.tobytes() + traj.v.tobytes() + traj.gaps[2].tobytes()).hex()
