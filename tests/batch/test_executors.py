"""Batches by executors: equal bits, chunks that are lost, scenes that are pickled."""

from __future__ import annotations

import copy
import multiprocessing
import os
import pickle
import sys
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from helpers.extras import extra
from helpers.rollout_scenes import MODELS, at_wall, servo_arm, starts, thrown_box
from helpers.workers import RayExecutor, Watched, await_two_workers

SETTINGS: dict[str, Any] = {"dt": 0.01, "duration": 0.7}


def swing(t: float) -> float:
    return 0.2 * np.sin(3.0 * t)


def lift(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    return -0.1 * v


def driven() -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
    """A scene with what its data do not hold: a motion of a servo and a force, functions of this module."""
    scene, q, v = at_wall()
    joints = [str(name) for name in scene.model.names][1:]
    scene.set_servo(joints[0], kp=20.0, kd=2.0, target=swing)
    scene.add_force(lift)
    return scene, q, v


@pytest.mark.parametrize("make", [at_wall, servo_arm, thrown_box, driven])
def test_a_scene_that_was_pickled_makes_the_same_run(make):
    scene, q, v = make()
    run = cvi.simulate(scene, q, v, **SETTINGS)
    for twin in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene)):
        other = cvi.simulate(twin, q, v, **SETTINGS)
        assert other.q.tobytes() == run.q.tobytes()
        assert other.p.tobytes() == run.p.tobytes()


def test_the_hand_is_pickled():
    scene = cvi.load_scene(MODELS / "allegro_ball.toml")
    twin = pickle.loads(pickle.dumps(scene))
    one, other = (cvi.simulate(s, duration=0.3, dt=1e-3) for s in (scene, twin))
    assert len(one.events)
    assert one.q.tobytes() == other.q.tobytes()


@pytest.mark.parametrize("kind", ["spawn", "threads"])
def test_an_executor_gives_the_same_bits(kind, tmp_path):
    scene, q, v = thrown_box()
    vs = v * (1.0 + 0.02 * np.arange(30)[:, None])
    vs[3, 0] = np.nan
    mass = 1.0 + 0.01 * np.arange(30)[:, None]
    given = {"parameters": {"mass:box": mass, "friction": 0.2}, **SETTINGS}
    whole = cvi.simulate_batch(scene, q, vs, **given)
    pool = ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) if kind == "spawn" else ThreadPoolExecutor(3)
    with pool:
        found = cvi.simulate_batch(scene, q, vs, executor=pool, **given)
        stored = cvi.simulate_batch(scene, q, vs, executor=pool, path=tmp_path / "a", **given)
    for result in (found, stored[0:30]):
        assert result.q.tobytes() == whole.q.tobytes()
        assert result.v.tobytes() == whole.v.tobytes()
        assert {k: str(e) for k, e in result.errors.items()} == {k: str(e) for k, e in whole.errors.items()}
        assert list(result.status) == list(whole.status)


class Losing(Executor):
    """Loses the first calls, each in another way."""

    def __init__(self, losses: int) -> None:
        self.losses, self.calls = losses, 0

    def submit(self, call: Any, /, *args: Any, **named: Any) -> Future[Any]:
        self.calls += 1
        future: Future[Any] = Future()
        if self.calls <= self.losses and self.calls % 2:
            raise BrokenExecutor("lost")
        if self.calls <= self.losses:
            future.set_exception(ConnectionError("lost on the way"))
        else:
            future.set_result(call(*args, **named))
        return future


def test_a_lost_chunk_is_made_again():
    scene, q, v = at_wall()
    whole = cvi.simulate_batch(scene, starts(q, 9), v, **SETTINGS)
    found = cvi.simulate_batch(scene, starts(q, 9), v, executor=Losing(3), workers=2, **SETTINGS)
    assert found.q.tobytes() == whole.q.tobytes()
    broken = Losing(10**6)
    with pytest.raises(cvi.ContactviError, match="has lost the runs 0 to 3 4 times"):
        cvi.simulate_batch(scene, starts(q, 9), v, executor=broken, workers=2, **SETTINGS)
    assert broken.calls <= 6


def test_what_cannot_be_sent_is_refused():
    scene, q, v = at_wall()
    with pytest.raises(cvi.InputError, match="cannot be sent"):
        cvi.simulate_batch(scene, q, v, control=lambda t, q, v: 0.0 * v, executor=Losing(0), **SETTINGS)
    with pytest.raises(cvi.InputError, match="cannot make calls"):
        cvi.simulate_batch(scene, q, v, executor=3, **SETTINGS)
    with pytest.raises(cvi.InputError, match="Whole runs"):
        cvi.simulate_batch(scene, q, v, keep="runs", executor=Losing(0), **SETTINGS)


@pytest.mark.slow
def test_dask_goes_on_when_a_worker_is_killed():
    distributed = pytest.importorskip("distributed")
    scene, q, v = at_wall()
    qs = starts(q, 400) % 0.3
    settings = {"dt": 1e-3, "duration": 2.0}
    whole = cvi.simulate_batch(scene, qs, v, **settings)
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        victims = list(client.run(os.getpid).values())

        def kill(made: int, runs: int) -> None:
            if victims:
                os.kill(victims.pop(), 9)
                victims.clear()

        found = cvi.simulate_batch(scene, qs, v, executor=client.get_executor(), progress=kill, **settings)
    assert not victims
    assert found.q.tobytes() == whole.q.tobytes()


# -- other people's executors, each with two workers that are processes of their own -----------------------------------


def check_two_workers(executor: Any, tmp_path: Any) -> None:
    """Both workers make chunks, with the bits of this process, into a file as into memory."""
    await_two_workers(executor)
    scene, q, v = at_wall()
    qs = starts(q, 200) % 0.3
    settings = {"dt": 1e-3, "duration": 1.0}
    whole = cvi.simulate_batch(scene, qs, v, **settings)
    watched = Watched(executor)
    found = cvi.simulate_batch(scene, qs, v, executor=watched, workers=4, **settings)
    file = {"path": tmp_path / "runs", "resume": True}
    stored = cvi.simulate_batch(scene, qs, v, executor=watched, workers=4, **file, **settings)
    assert len(watched.processes) == 2
    assert os.getpid() not in watched.processes
    for result in (found, stored):
        assert result.ok.all()
        assert result.q[:, -1].tobytes() == whole.q[:, -1].tobytes()


@pytest.fixture
def as_here(tmp_path, monkeypatch):
    """Workers find what this process finds, and not the package in its folder, which may not be built there."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_ray_makes_runs_on_two_workers(tmp_path, as_here):
    ray = extra("ray")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        check_two_workers(RayExecutor(ray), tmp_path)
    finally:
        ray.shutdown()


@pytest.mark.slow
def test_dask_makes_runs_on_two_workers(tmp_path, as_here):
    distributed = extra("distributed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        check_two_workers(client.get_executor(), tmp_path)
