"""run_auto and very long fixed steps, below the Python API: adaptive steps, redone ones, how runs end."""

from __future__ import annotations

import os
import signal
import threading

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers import map_runs
from helpers.chains import chain
from helpers.contact_models import problem_b
from helpers.contact_models import scene as public_scene
from helpers.run_scenes import HEIGHT, RADIUS, ball_scene, hand_scene
from oracles.closed_forms import BouncingBall

SUCCESS, ZENO, TOO_MANY, INTERRUPTED = (
    cvi.StatusCode.SUCCESS,
    cvi.StatusCode.ZENO,
    cvi.StatusCode.TOO_MANY_IMPACTS,
    cvi.StatusCode.INTERRUPTED,
)
MAPS = pytest.mark.parametrize("method", map_runs.METHODS)
ORDERS = pytest.mark.parametrize("order", [4, 8, 16])
LEVELS = {4: 1e-5, 8: 1e-7, 16: 1e-9}
START_B = (np.array([0.3, 0.2]), np.zeros(2))


def run_auto(simulator, *arguments) -> dict:
    """Return what the run has recorded, with the error of a callback."""
    run, error = simulator.run_auto(*arguments)
    return {**run.results(), "error": error}


def run_b(method: str, order: int, duration: float = 8.0, first: float = 0.01, restitution: float = 1.0) -> dict:
    """Problem B with automatic steps, the first guess of which is `first` [s]."""
    scene = public_scene(*problem_b(), restitution)
    simulator = map_runs.start(scene, *START_B, first, method, order=order, dense=True)
    return run_auto(simulator, duration, LEVELS[order])


# -- adaptive steps ----------------------------------------------------------------------------------------------------


@MAPS
@ORDERS
def test_arcs_end_after_their_impact(method, order):
    """Steps of one length end with an impact, with the run, or where they are too long and shorter ones follow."""
    result = run_b(method, order)
    assert result["code"] == SUCCESS
    t, arcs, impacts = result["t"], result["adaptive_steps"], result["events"]["time"]
    assert len(impacts) >= 4
    ends = [*arcs["t"][1:], t[-1]]
    following = [*arcs["dt"][1:], 0.0]
    for begin, end, dt, after in zip(arcs["t"], ends, arcs["dt"], following, strict=True):
        nodes = t[(t >= begin) & (t <= end)]
        assert np.diff(nodes) == pytest.approx(np.full(len(nodes) - 1, dt), rel=1e-9)
        inside = impacts[(impacts > begin) & (impacts <= end)]
        assert len(inside) == 1 or end == t[-1] or after < dt
        assert np.all(inside > end - dt * (1.0 + 1e-9))


@ORDERS
@pytest.mark.parametrize("duration", [1.0, 0.1 + 0.2, 1e-3, np.pi])
def test_the_end_is_exact(order, duration):
    scene = public_scene(*problem_b())
    simulator = map_runs.start(scene, *START_B, 0.01, "ctec", order=order)
    assert run_auto(simulator, duration, LEVELS[order])["t"][-1] == duration
    again = run_auto(simulator, duration, LEVELS[order])  # goes on from there
    assert (again["t"][0], again["t"][-1]) == (duration, 2.0 * duration)


def test_what_is_thrown_away_is_counted():
    """A first step that is too short costs probes only, one that is too long a repetition; the results agree."""
    runs = {first: run_b("ctec", 8, 3.0, first) for first in (1e-5, 0.02, 100.0)}
    for result in runs.values():
        stats = result["stats"]
        assert result["code"] == SUCCESS
        assert stats["steps"] == len(result["t"]) - 1
        assert stats["rejected"] > 0
        assert stats["rejected"] <= 3 * stats["steps"]
        assert len(result["segments"]["t"]) == stats["steps"] + stats["impacts"]  # none of a step thrown away
        assert stats["impacts"] == len(result["events"]["time"]) == 2
    ends = np.array([result["q"][-1] for result in runs.values()])
    assert np.ptp(ends, axis=0).max() <= 1e-5


@ORDERS
def test_no_step_that_stays_is_too_long(order):
    """The highest mode of the velocities of each whole step moves nothing by more than the level.

    Steps that are given up leave nothing behind, and those before them stay: there is one segment from node to node.
    """
    scene, rng = chain([pin.JointModelRY() for _ in range(5)])
    level, s = LEVELS[order], order // 2
    simulator = map_runs.start(scene, scene.neutral(), rng.uniform(-1, 1, 5), 0.02, "ctec", order=order, dense=True)
    result = run_auto(simulator, 3.0, level)
    assert result["code"] == SUCCESS
    steps, stats = result["segments"], result["stats"]
    nodes, weights = np.polynomial.legendre.leggauss(s)
    mode = (2 * s - 1) / 2 * weights * np.polynomial.legendre.Legendre.basis(s - 1)(nodes)
    rates = steps["rates"].reshape(-1, s, 5)
    left_out = steps["h"] * np.linalg.norm(np.einsum("j,njd->nd", mode, rates), axis=1)
    assert level * 0.1 < left_out.max() <= level
    np.testing.assert_allclose(steps["t"] + steps["h"], result["t"][1:], rtol=1e-12)
    lengths = result["adaptive_steps"]["dt"]
    assert len(lengths) > 1
    assert np.all(np.diff(lengths) < 0.0)
    assert stats["steps"] == len(steps["t"])
    assert 0 < stats["rejected"] <= 16 + 3 * len(lengths)  # probes, and a few steps for each length


def test_fixed_steps_after_a_step_that_was_too_long():
    """The run ends where the shorter steps would be too many; steps of dt go on from there."""
    scene, rng = chain([pin.JointModelRY() for _ in range(5)])
    simulator = map_runs.start(scene, scene.neutral(), rng.uniform(-1, 1, 5), 0.02, "ctec", order=4, dense=True)
    result = run_auto(simulator, 2e5, 1e-9)
    assert (result["code"], len(result["t"])) == (cvi.StatusCode.TOO_MANY_STEPS, 1)
    after = simulator.advance(3, None, 1, None)
    assert (after["code"], len(after["t"])) == (SUCCESS, 4)


@ORDERS
def test_bouncing_to_the_end_as_with_fixed_steps(order):
    """e = 0.5: every impact where it belongs, then ZENO with the instant of accumulation."""
    ball = BouncingBall(restitution=0.5)
    scene = ball_scene(0.5)
    start = (scene.neutral(), np.zeros(6))
    fixed = map_runs.run(scene, *start, 3.0, 0.01, "ctec", order=order, end_at_zeno=True)
    simulator = map_runs.start(scene, *start, 0.01, "ctec", order=order, end_at_zeno=True)
    auto = run_auto(simulator, 3.0, LEVELS[order])
    for result in (vars(fixed), auto):
        assert result["code"] == ZENO
        assert result["accumulation_time"] == pytest.approx(ball.zeno_time(), abs=1e-9)
    for times in (fixed.log["time"], auto["events"]["time"]):
        assert times == pytest.approx(ball.impact_times(len(times)), abs=1e-11)
    assert auto["t"][-1] == auto["time"] == auto["events"]["time"][-1]


def test_a_level_below_rounding_does_not_end_the_run():
    """More than can be had in 1e4 s: the run goes on, in tiny steps, until it is stopped; never SUCCESS too early."""
    scene = public_scene(*problem_b())
    simulator, calls = map_runs.start(scene, *START_B, 1e-3, "ctec", order=4), []

    def stop(t, impacts):
        calls.append(t)
        if len(calls) == 2:
            raise KeyboardInterrupt

    result = run_auto(simulator, 1e4, 1e-14, stop)
    assert result["code"] == INTERRUPTED
    assert 0.0 < result["t"][-1] == result["time"] < 1e4


def test_interruption_in_the_middle():
    """Ctrl-C: the run so far, with its end as a node; steps of 1e-6 s would go on for minutes."""
    scene = public_scene(*problem_b())
    simulator = map_runs.start(scene, *START_B, 1e-3, "ctec", order=4)
    # A shell starts background jobs with SIGINT ignored; Python then has no handler of its own.
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.4, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        result = run_auto(simulator, 1e3, 1e-14)
    finally:
        timer.join()
        signal.signal(signal.SIGINT, handler)
    assert result["code"] == INTERRUPTED
    assert isinstance(result["error"], KeyboardInterrupt)
    assert result["t"][-1] == result["time"] < 1e3
    assert result["stats"]["steps"] > 0


# -- long fixed steps -------------------------------------------------------------------------------------------------


@MAPS
@pytest.mark.parametrize("order", [2, 4, 8, 16])
@pytest.mark.parametrize("restitution", [1.0, 0.9])
def test_several_bounces_in_one_step(method, order, restitution):
    """dt = 2 s holds up to three flights: every impact at its instant, every height right.

    A parabola is exact at every order. MHC's scalar at order 2 and DTEC's depend on the parts of the step; DTEC may
    give a short part nearly no speed (no flights that end) and reports it.
    """
    ball = BouncingBall(HEIGHT, restitution)
    scene = ball_scene(restitution)
    result = map_runs.run(scene, scene.neutral(), np.zeros(6), 8.0, 2.0, method, order=order, max_impacts_per_step=500)
    assert result.code == SUCCESS or (method == "dtec" and result.code in (TOO_MANY, ZENO))
    assert len(result.t) == 5 or result.code != SUCCESS
    gaps = np.array([scene.core().gaps(q)[0][0] for q in result.q])
    assert gaps.min() >= -1e-12
    if method == "ctec" or (method == "mhc" and order > 2):
        times = result.log["time"]
        assert times == pytest.approx(ball.impact_times(len(times)), abs=1e-11)
        assert gaps == pytest.approx([ball.height(t) for t in result.t], abs=1e-10)
        assert result.q[:, 2] - RADIUS == pytest.approx(gaps, abs=1e-12)
    assert np.all(np.isfinite(result.p))


def test_a_step_of_many_bounces_can_be_stopped():
    """One step of a day: stopped inside of it, with its last node where it was stopped."""
    scene, duration = ball_scene(), 86400.0
    simulator = map_runs.start(
        scene, scene.neutral(), np.zeros(6), duration, "ctec", order=4, max_impacts_per_step=10**9
    )

    def stop(t, impacts):
        raise KeyboardInterrupt

    result = simulator.advance(1, None, 1, stop)
    assert result["code"] == INTERRUPTED
    assert 0.0 < result["t"][-1] == result["time"] < duration
    assert result["stats"]["impacts"] == len(result["events"]["time"]) > 10


@MAPS
@pytest.mark.parametrize("order", [4, 8, 16])
def test_a_hand_and_a_ball_in_long_steps(method, order):
    """dt = 0.1 s, several impacts per step: no penetration at any node, a reason at the end."""
    scene, q0 = hand_scene()
    result = map_runs.run(scene, q0, np.zeros(scene.nv), 0.6, 0.1, method, order=order)
    assert result.code in (SUCCESS, ZENO), result.message
    assert len(result.events) > 0
    assert np.all(np.isfinite(result.p))
    for q in result.q:
        assert np.min(scene.core().gaps(q)[0]) >= -1e-10


@pytest.mark.parametrize("order", [2, 4, 8, 16])
def test_a_tolerance_below_rounding_ends(order):
    """tol = 1e-15: the stage iterations stop at rounding, after a few more per step, with an equally good result."""
    runs = [
        map_runs.run(public_scene(*problem_b()), *START_B, 3.0, 0.01, "ctec", order=order, tol=tol)
        for tol in (1e-12, 1e-15)
    ]
    assert all(r.code == SUCCESS and r.stats["halved"] == 0 for r in runs)
    assert runs[1].stats["stage_iterations"] <= 3 * runs[0].stats["stage_iterations"]
    assert np.abs(runs[0].q - runs[1].q).max() <= 1e-9


@pytest.mark.thinned(2)
@pytest.mark.parametrize("method", ["ctec", "mhc"])
def test_energy_of_problem_b_over_ten_thousand_seconds(method, record_property):
    """Order 16, dt = 0.05 s: 7000 impacts, and H does not drift."""
    scene = public_scene(*problem_b())
    result = map_runs.run(scene, *START_B, 1e4, 0.05, method, every=20, order=16, tol=1e-14)
    assert result.code == SUCCESS, result.message
    energy = scene.core().energy(result.q, result.p).sum(axis=1)
    error = np.abs(energy - energy[0])
    record_property("largest_energy_error", float(error.max()))
    record_property("impacts", len(result.events))
    assert len(result.events) > 6000
    assert error.max() <= 1e-9
