"""Islands of one run in several threads: the same bits, whatever their number."""

from __future__ import annotations

import gc
import multiprocessing as mp

import numpy as np
import pytest

import contactvi as cvi

THREADS = (1, 2, 5)


def crowd(seed: int, function: bool = False) -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
    """Return boxes and spheres thrown on a plane at random, some of which meet, with their starts."""
    rng = np.random.default_rng(seed)
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    q, v = [], []
    for k in range(24):
        if k % 3:
            scene.add_box(f"body{k}", (0.2, 0.16, 0.1))
        else:
            scene.add_sphere(f"body{k}", 0.08)
        turn = rng.normal(size=4)
        q += [0.4 * (k % 5), 0.4 * (k // 5), 0.25 + 0.1 * rng.random(), *turn / np.linalg.norm(turn)]
        v += [*rng.normal(size=6)]
    scene.set_contact(restitution=0.3, friction=0.5)
    if function:
        scene.set_contact("ground", "body0", friction=lambda speed: 0.3 + 0.1 / (1.0 + speed))
    return scene, np.array(q), np.array(v)


def same(a: cvi.Trajectory, b: cvi.Trajectory) -> None:
    for x, y in ((a.t, b.t), (a.q, b.q), (a.p, b.p), (a.work.joint_friction, b.work.joint_friction)):
        assert np.array_equal(x, y, equal_nan=True)
    assert [(e.time, e.pair, e.gamma_minus, e.gamma_plus) for e in a.events] == [
        (e.time, e.pair, e.gamma_minus, e.gamma_plus) for e in b.events
    ]
    assert list(a.contact_changes) == list(b.contact_changes)
    assert np.array_equal(a.contacts.impulse, b.contacts.impulse)


@pytest.mark.parametrize("function", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_runs_have_the_same_bits(seed, function):
    scene, q, v = crowd(seed, function)
    runs = [cvi.simulate(scene, q, v, duration=0.4, dt=2e-3, threads=number) for number in THREADS]
    assert len(runs[0].events) > 50
    for run in runs[1:]:
        same(runs[0], run)


def test_a_run_that_ends_early_ends_alike():
    scene, q, v = crowd(3)
    runs = [
        cvi.simulate(
            scene,
            q,
            v,
            duration=0.4,
            dt=2e-3,
            threads=number,
            max_impacts_per_step=2,
            contact_mode="events",
            throw=False,
        )
        for number in THREADS
    ]
    assert runs[0].status.code.name == "TOO_MANY_IMPACTS"
    for run in runs[1:]:
        assert run.status == runs[0].status
        same(runs[0], run)


def test_an_error_of_a_progress_function_ends_the_run():
    scene, q, v = crowd(4)

    def progress(*_: object) -> None:
        raise LookupError("enough")

    with pytest.raises(LookupError, match="enough"):
        cvi.simulate(scene, q, v, duration=100.0, dt=1e-3, threads=3, progress=progress)


def step_on(simulators: list[cvi.Simulator], steps: int, found: mp.SimpleQueue) -> None:
    """Steps on, and takes the simulator apart: its threads are in the other process."""
    simulator = simulators.pop()
    simulator.run(steps)
    end = simulator.q.copy()
    del simulator
    gc.collect()
    found.put(end)


def test_a_forked_process_goes_on_without_the_threads():
    scene, q, v = crowd(5)
    simulator = cvi.Simulator(scene, dt=2e-3, threads=3)
    simulator.reset(q, v)
    simulator.run(20)
    context = mp.get_context("fork")
    found = context.SimpleQueue()
    simulators = [simulator]
    process = context.Process(target=step_on, args=(simulators, 30, found))
    del simulator
    process.start()
    simulator = simulators.pop()
    there = found.get()
    process.join()
    simulator.run(30)
    assert process.exitcode == 0
    assert np.array_equal(there, simulator.q)


@pytest.mark.parametrize("threads", [0, -1, 1.5, 10**6, "two"])
def test_bad_numbers_are_refused(threads):
    with pytest.raises(cvi.InputError, match="threads"):
        cvi.Options(1e-3, threads=threads)
