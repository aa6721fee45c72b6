"""Runs whose steps share the lanes of the kernel: the bits of each run alone, on every instruction set."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from batteries.models import CASES, case
from helpers.engine import core_scene, simulator
from helpers.gauss_laws import extra_of

STEPS, RUNS = 40, 11  # more than two groups of 4, and one of 8 with some left


@pytest.fixture(params=["base", "avx2", "avx512"])
def instruction_set(request):
    from contactvi import _core

    before = _core.instruction_set()
    if request.param not in _core.instruction_sets():
        pytest.skip(f"this machine has {_core.instruction_sets()} only")
    _core.instruction_set(request.param)
    yield request.param
    _core.instruction_set(before)


def alone(scene, options: dict[str, Any], q, v, tau) -> dict[str, Any]:
    run = simulator(scene, **options)
    assert run.reset(q, v, 0.0)["code"] == 0
    return run.advance(STEPS, tau, 1, None)


def side_by_side(scene, options: dict[str, Any], starts, taus, threads: int, every: int = 1):
    """The batch of these runs and what it kept of each."""
    from contactvi import _core

    settings = _core.SimulatorOptions()
    for name, value in options.items():
        setattr(settings, name, value)
    batch = _core.Batch(settings, STEPS, every, _core.BatchKeep.RUNS, 1e-3)
    for (q, v), tau in zip(starts, taus, strict=True):
        batch.add(scene, q, v, None if tau is None else _core.BatchInputs(tau), None, None)
    batch.run(threads, None)
    return batch, [batch.result(k)[3] for k in range(len(starts))]


def assert_same_bits(scene, options: dict[str, Any], starts, taus, threads: int = 1) -> float:
    """Returns which part of the stage iterations the runs have made together."""
    batch, found = side_by_side(scene, options, starts, taus, threads)
    iterations = 0
    for (q, v), tau, own in zip(starts, taus, found, strict=True):
        single = alone(scene, options, q, v, tau)
        assert single["code"] == own["code"] == 0, own["message"]
        for name in ("t", "q", "p"):
            assert single[name].tobytes() == own[name].tobytes(), name
        assert single["stats"]["stage_iterations"] == own["stats"]["stage_iterations"]
        assert single["stats"]["factorizations"] == own["stats"]["factorizations"]
        iterations += own["stats"]["stage_iterations"]
    return batch.shared_iterations / iterations


@pytest.mark.parametrize("springs", [False, True])
@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_runs_have_the_bits_of_runs_alone(instruction_set, case, springs):
    """Every type of joint, with springs, damping and inputs; starts as different as the battery draws them."""
    model = case.model()
    scene = core_scene(model, **extra_of(case.name, model, springs, springs))
    random = np.random.default_rng(3)
    taus = [0.1 * random.uniform(-1.0, 1.0, (STEPS, model.nv)) if springs else None for _ in range(RUNS)]
    starts = [case.state(model, seed) for seed in range(RUNS)]
    together = assert_same_bits(scene, {"dt": case.h, "order": 2}, starts, taus)
    assert together == 0.0 if instruction_set == "base" else together > 0.5


@pytest.mark.parametrize("name", ["double_pendulum", "free_body", "allegro"])
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_threads_and_order_of_the_runs_change_nothing(instruction_set, name, threads):
    c = case(name)
    model = c.model()
    scene = core_scene(model)
    starts = [c.state(model, seed) for seed in range(RUNS)]
    taus = [None] * RUNS
    assert_same_bits(scene, {"dt": c.h, "order": 2}, starts[::-1], taus, threads)
    assert_same_bits(scene, {"dt": c.h, "order": 2}, starts[:3], taus[:3], threads)


@pytest.mark.parametrize("name", ["double_pendulum", "free_body", "joint_spherical", "allegro"])
@pytest.mark.parametrize("longer", [4.0, 16.0])
def test_steps_that_are_solved_badly(instruction_set, name, longer):
    """Long steps: new factors, the Newton matrix, acceleration, halved steps, and steps that are not solved at all."""
    c = case(name)
    model = c.model()
    scene = core_scene(model, **extra_of(name, model, True, True))
    starts = [c.state(model, seed) for seed in range(RUNS)]
    starts[1] = (starts[1][0], 40.0 * starts[1][1])
    options = {"dt": longer * c.h, "order": 2}
    _, found = side_by_side(scene, options, starts, [None] * RUNS, 1)
    for (q, v), own in zip(starts, found, strict=True):
        single = alone(scene, options, q, v, None)
        assert (single["code"], single["message"]) == (own["code"], own["message"])
        for key in ("t", "q", "p"):
            assert single[key].tobytes() == own[key].tobytes(), key
        assert single["stats"]["stage_iterations"] == own["stats"]["stage_iterations"]


def test_higher_orders_are_made_alone(instruction_set):
    c = case("double_pendulum")
    scene, starts = core_scene(c.model()), [c.state(c.model(), seed) for seed in range(RUNS)]
    assert assert_same_bits(scene, {"dt": c.h, "order": 4}, starts, [None] * RUNS) == 0.0


FLYING = ["double_pendulum", "joint_prismatic_y", "joint_revolute_x", "joint_helical_z", "joint_spherical", "free_body"]


@pytest.mark.parametrize("name", FLYING)
@pytest.mark.parametrize("damped", [False, True])
def test_long_runs_whose_steps_are_solved_in_advance(instruction_set, name, damped):
    """Many times as many steps as are solved in advance; one run of them turns so far that its angle is wound back."""
    c = case(name)
    model = c.model()
    extra = {"damping": np.linspace(0.05, 0.1, model.nv)} if damped else {}
    scene = core_scene(model, **extra)
    starts = [c.state(model, seed) for seed in range(RUNS)]
    q = starts[2][0].copy()
    q[0] = 1e4 - 0.1  # revolute joints lose whole revolutions beyond 1e4 rad
    starts[2] = (q, np.full(model.nv, 3.0))
    assert_same_bits(scene, {"dt": 0.2 * c.h, "order": 2}, starts, [None] * RUNS)
    assert_same_bits(scene, {"dt": 0.2 * c.h, "order": 2}, starts[:2], [None] * 2)


@pytest.mark.parametrize("name", ["double_pendulum", "joint_spherical", "free_body"])
def test_a_run_leaves_what_was_solved_in_advance(instruction_set, name):
    """Steps in advance of one run among quiet ones stop where that asks for more than the first factor of a step."""
    c = case(name)
    model = c.model()
    scene = core_scene(model)
    starts = [c.state(model, seed) for seed in range(RUNS)]
    starts[0] = (starts[0][0], 12.0 * starts[0][1])
    assert_same_bits(scene, {"dt": 2.0 * c.h, "order": 2}, starts, [None] * RUNS)


@pytest.mark.parametrize("name", FLYING)
@pytest.mark.parametrize("every", [1, 7, 1000])
def test_nodes_and_works_of_steps_that_are_made_at_once(instruction_set, name, every):
    c = case(name)
    model = c.model()
    scene = core_scene(model, damping=np.linspace(0.05, 0.1, model.nv))
    starts = [c.state(model, seed) for seed in range(RUNS)]
    options = {"dt": 0.2 * c.h, "order": 2}
    _, found = side_by_side(scene, options, starts, [None] * RUNS, 1, every)
    for (q, v), own in zip(starts, found, strict=True):
        run = simulator(scene, **options)
        assert run.reset(q, v, 0.0)["code"] == 0
        single = run.advance(STEPS, None, every, None)
        assert len(single["t"]) == 2 + (STEPS - 1) // every
        for key in ("t", "q", "p", "work"):
            assert single[key].tobytes() == own[key].tobytes(), key
        assert single["work"][-1].any()
