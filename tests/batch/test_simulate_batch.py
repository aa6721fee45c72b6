"""Batches of runs against single runs, to the bit; runs that fail; parameters and inputs of every run."""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from helpers.rollout_scenes import SETTINGS, STEPS, at_wall, servo_arm, starts, thrown_ball, thrown_box
from helpers.run_scenes import funnel

DURATION = 0.7


def assert_same(found: cvi.Trajectory, other: cvi.Trajectory) -> None:
    for name in ("t", "q", "p", "v"):
        assert getattr(found, name).tobytes() == getattr(other, name).tobytes(), name
    assert found.status == other.status
    assert found.forced == other.forced
    for log in ("events", "contacts", "contact_changes", "dense_steps"):
        own, single = getattr(found, log).arrays, getattr(other, log).arrays
        assert {name: a.tobytes() for name, a in own.items()} == {name: a.tobytes() for name, a in single.items()}
    assert (found.stats.stage_iterations, found.stats.steps) == (other.stats.stage_iterations, other.stats.steps)


@pytest.mark.parametrize("make", [at_wall, thrown_ball, thrown_box])
@pytest.mark.parametrize("workers", [1, 2, 3])
def test_a_batch_is_its_runs_to_the_bit(make, workers):
    scene, q, v = make()
    vs = v * (1.0 + 0.05 * np.arange(7)[:, None])
    settings = {"dt": 0.01, "duration": DURATION}
    runs = [cvi.simulate(scene, q, own, **settings) for own in vs]
    assert any(len(run.events) for run in runs)
    for keep in ("ends", "nodes", "runs"):
        result = cvi.simulate_batch(scene, q, vs, keep=keep, workers=workers, **settings)
        assert result.ok.all()
        assert not result.errors
        assert result.impacts.tolist() == [len(run.events) for run in runs]
        for k, run in enumerate(runs):
            own = slice(-1, None) if keep == "ends" else slice(None)
            for name in ("t", "q", "v"):
                assert getattr(result, name)[k].tobytes() == getattr(run, name)[own].tobytes()
            assert result.status[k] == run.status
            if keep == "runs":
                assert_same(result[k], run)


def test_shuffled_starts_give_shuffled_results():
    scene, q, v = thrown_box()
    vs = v * (1.0 + 0.02 * np.arange(12)[:, None])
    order = np.random.default_rng(0).permutation(12)
    first, second = (cvi.simulate_batch(scene, q, v0s, dt=0.01, duration=0.5, workers=2) for v0s in (vs, vs[order]))
    assert first.keep == "nodes"
    assert first.q[order].tobytes() == second.q.tobytes()


@pytest.mark.parametrize("options", [
    {"dt": "auto"}, {"dt": 0.01, "record_every": 7}, {"dt": 0.01, "sample_dt": 0.03}, {"dt": 0.01, "order": 4},
    {"dt": 0.01, "ledger": {"own_jump": 1e-6}}, {"dt": 0.01, "impact": "dtec"}, {"dt": 0.01, "contact_mode": "steps"},
])  # fmt: skip
def test_options_of_simulate(options):
    scene, q, v = at_wall()
    qs = starts(q, 5)
    result = cvi.simulate_batch(scene, qs, v, duration=DURATION, keep="runs", workers=2, **options)
    for k in range(5):
        run = cvi.simulate(scene, qs[k], v, duration=DURATION, throw=False, **options)
        assert_same(result[k], run)
        assert result.q[k, : result.nodes[k]].tobytes() == run.q.tobytes()
        assert np.isnan(result.q[k, result.nodes[k] :]).all()
        assert np.array_equal(result.error_estimate[k], run.error_estimate, equal_nan=True)


def test_controls_and_targets_of_every_run():
    scene, q, v = at_wall()
    control = 0.1 * np.random.default_rng(0).standard_normal((4, STEPS, 2))
    settings = {**SETTINGS, "duration": STEPS * SETTINGS["dt"]}
    for given in (control, control[0], lambda t, q, v: 0.1 * np.sin(t + q)):
        result = cvi.simulate_batch(scene, starts(q, 4), v, control=given, keep="runs", workers=2, **settings)
        for k in range(4):
            own = given[k] if isinstance(given, np.ndarray) and given.ndim == 3 else given
            assert_same(result[k], cvi.simulate(scene, starts(q, 4)[k], v, control=own, **settings))
    scene, q, v = servo_arm()
    target = 0.1 * np.random.default_rng(1).standard_normal((3, STEPS, 2))
    for given in (target, target[0], target[0, 0], None, lambda t: np.array([0.1, np.sin(t)])):
        qs = np.tile(q, (3, 1))
        result = cvi.simulate_batch(scene, qs, v, target=given, keep="runs", workers=2, **settings)
        for k in range(3):
            own = given[k] if isinstance(given, np.ndarray) and given.ndim == 3 else given
            assert_same(result[k], cvi.simulate(scene, q, v, target=own, **settings))


def test_parameters_of_every_run():
    scene, q, v = thrown_box()
    mass, friction = 1.0 + 0.1 * np.arange(6)[:, None], np.array([0.1, 0.2] * 3)[:, None]
    values = {"mass:box": mass, "friction": friction, "restitution": 0.3, "gravity": [0.0, 0.0, -9.0]}
    result = cvi.simulate_batch(scene, q, v, parameters=values, dt=0.01, duration=0.5, keep="runs", workers=2)
    for k in range(6):
        own = scene.with_parameters({**values, "mass:box": mass[k], "friction": friction[k]})
        assert_same(result[k], cvi.simulate(own, q, v, dt=0.01, duration=0.5))


def test_bad_runs_do_not_end_the_others():
    """NaN, a start in penetration, parameters that no scene has, runs that end early: each has the error of its own."""
    scene, q, v = thrown_ball()
    qs, vs = np.tile(q, (6, 1)), np.tile(v, (6, 1))
    qs[1, 0] = np.nan
    qs[2, 2] = -1.0
    mass = np.ones((6, 1))
    mass[3] = -1.0
    vs[4] = 1e200
    for keep in ("ends", "nodes", "runs"):
        result = cvi.simulate_batch(
            scene, qs, vs, parameters={"mass:ball": mass}, dt=0.01, duration=0.5, keep=keep, workers=2
        )
        assert sorted(result.errors) == [1, 2, 3, 4]
        assert result.ok.tolist() == [k not in result.errors for k in range(6)]
        good = cvi.simulate(scene.with_parameters({"mass:ball": 1.0}), q, v, dt=0.01, duration=0.5)
        last = result.q[0] if keep == "ends" else result.q[0, -1]
        assert last.tobytes() == good.q[-1].tobytes()
        for k in result.errors:
            with pytest.raises(cvi.ContactviError) as single:
                cvi.simulate(scene.with_parameters({"mass:ball": mass[k]}), qs[k], vs[k], dt=0.01, duration=0.5)
            assert type(result.errors[k]) is single.type
            assert str(result.errors[k]) == str(single.value)
        assert result.status[2].code == cvi.StatusCode.PENETRATION
        assert result.status[1].code == cvi.StatusCode.REFUSED
    with pytest.raises(cvi.InputError):
        result[1]
    assert len(result[[0, 5]]) == 2
    assert not result[[0, 5]].errors


def test_runs_that_end_early_are_as_simulate_returns_them():
    scene, q, v = at_wall()
    settings = {"dt": 0.01, "duration": DURATION, "max_impacts_per_step": 1, "zeno": "end"}
    scene.set_contact(restitution=0.1)
    result = cvi.simulate_batch(scene, starts(q, 6), 3.0 * v, keep="runs", **settings)
    for k in range(6):
        run = cvi.simulate(scene, starts(q, 6)[k], 3.0 * v, throw=False, **settings)
        assert_same(result[k], run)
        assert (k in result.errors) == (not run.status.ok)
        assert result.nodes[k] == len(run)


def test_one_warning_of_dense_steps(tmp_path):
    """At the line of the caller, in memory and into a file; not with contact_mode="steps", which asks for them."""
    scene = funnel()
    starts = np.tile(scene.neutral(), (2, 1))
    for path in (None, tmp_path / "a"):
        with pytest.warns(cvi.DenseStepWarning, match="2 of 2 runs") as found:
            cvi.simulate_batch(scene, starts, dt=1e-3, duration=0.5, path=path)
        assert [Path(warning.filename).name for warning in found] == [Path(__file__).name]
    scene, q, v = thrown_box()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = cvi.simulate_batch(scene, np.tile(q, (3, 1)), v, dt=0.01, duration=0.5, contact_mode="steps")
    assert (result.dense_steps > 0).all()
    assert not caught


def test_progress_counts_the_runs_and_may_end_them():
    scene, q, v = at_wall()
    seen: list[tuple[int, int]] = []
    cvi.simulate_batch(scene, starts(q, 5), v, dt=0.01, duration=0.5, progress=lambda *made: seen.append(made))
    assert seen[-1] == (5, 5)

    def stop(made: int, runs: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cvi.simulate_batch(scene, starts(q, 2), v, dt=1e-6, duration=100.0, record_every=1000, progress=stop)


def test_ctrl_c_ends_the_runs_under_way():
    scene, q, v = at_wall()
    # A shell starts background jobs with SIGINT ignored; Python then has no handler of its own.
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    begin = time.perf_counter()
    try:
        with pytest.raises(KeyboardInterrupt):
            cvi.simulate_batch(scene, starts(q, 4), v, dt=1e-6, duration=1000.0, record_every=100_000, workers=2)
    finally:
        timer.join()
        signal.signal(signal.SIGINT, handler)
    assert time.perf_counter() - begin < 60.0  # alone they would take many minutes


def test_all_runs_refused():
    scene, q, v = at_wall()
    result = cvi.simulate_batch(scene, np.full((3, 2), np.nan), v, dt=0.01, duration=0.1)
    assert sorted(result.errors) == [0, 1, 2]
    assert result.q.shape[0] == 3
    assert np.isnan(result.q).all()
    assert not result.ok.any()


BAD: list[tuple[dict[str, Any], str]] = [
    ({"q0s": np.zeros((3, 5))}, "q0"),
    ({"q0s": np.zeros((3, 2)), "v0s": np.zeros((2, 2))}, "different sizes"),
    ({"parameters": {"mass:nothing": [1.0]}}, "nothing"),
    ({"keep": "all"}, "keep"),
    ({"workers": 0}, "workers"),
    ({"order": 3}, "order"),
    ({"q0s": "no"}, "numbers"),
]


@pytest.mark.parametrize(("given", "text"), BAD)
def test_bad_arguments(given, text):
    scene, _, _ = at_wall()
    with pytest.raises(cvi.InputError, match=text):
        cvi.simulate_batch(scene, **{"dt": 0.01, "duration": 0.1, **given})


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e60])
@pytest.mark.parametrize("name", ["q0s", "v0s"])
def test_one_start_among_good_ones_that_is_no_number(name, bad):
    """Starts are looked at together where all can be used, and one by one where one cannot: the others are the same."""
    scene, q, v = at_wall()
    starts = {"q0s": np.tile(q, (5, 1)), "v0s": v * (1.0 + 0.05 * np.arange(5)[:, None])}
    settings = {"dt": 0.01, "duration": 0.2}
    good = cvi.simulate_batch(scene, **starts, **settings)
    starts[name][3, 1] = bad
    result = cvi.simulate_batch(scene, **starts, **settings)
    assert np.flatnonzero(~result.ok).tolist() == [3]
    with pytest.raises(cvi.InputError) as single:
        cvi.simulate(scene, starts["q0s"][3], starts["v0s"][3], **settings)
    assert str(result.errors[3]) == str(single.value)
    for k in (0, 1, 2, 4):
        for values in ("t", "q", "v"):
            assert getattr(result, values)[k].tobytes() == getattr(good, values)[k].tobytes()
