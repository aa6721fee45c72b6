"""Runs that dt = "auto" keeps in the engine: what leads them, how far they are apart, what that says of the error."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi import _core
from contactvi.options import Options
from contactvi.simulation import auto_search, engine
from contactvi.simulation.auto_contact import LEAST, Judged
from contactvi.trajectory.compiled import compile_scene
from helpers.chains import chain

MODELS = Path(__file__).resolve().parents[2] / "models"
BOX_V0 = [0.3, 0.0, 1.0, 3.0, -2.0, 5.0]
SPAN = 0.8


def flying_box(ball: bool = True):
    """A box that turns about all its axes while it flies, and a ball that bounces on the ground."""
    scene = cvi.Scene()
    scene.add_box("box", size=(0.1, 0.2, 0.3), placement=(0.0, 0.0, 5.0))
    if ball:
        scene.add_sphere("ball", 0.1, placement=(3.0, 0.0, 0.5))
        scene.add_halfspace()
        scene.set_contact(restitution=0.8)
    return compile_scene(scene)


def swinging_chain():
    scene, rng = chain([pin.JointModelRY() for _ in range(5)])
    scene.v0 = rng.uniform(-1, 1, scene.nv)
    return compile_scene(scene)


def wall():
    return compile_scene(cvi.load_scene(MODELS / "double_pendulum_wall.toml"))


def options(**changed):
    return Options(**{"dt": "auto", "duration": SPAN, "order": 8, "tol": 1e-6, "dense": True, **changed})


def made(compiled, chosen=None, level=1e-4, **how):
    """Return a run to the end at a level; how: coarser, part, sample, after_impact."""
    chosen = chosen or options()
    simulator = engine.make(compiled, chosen)
    v0 = [*BOX_V0, *np.zeros(compiled.states.nv - 6)] if compiled.states.nv in (6, 12) else None
    assert engine.accepts(simulator, *engine.checked_start(compiled, chosen, None, v0)[0])
    run, stopped = engine.run_auto(simulator, chosen.span, level, None, **how)
    assert not stopped
    return run


def record_of(run, compiled, chosen=None):
    return engine.record_of(run, compiled, chosen or options())


def test_a_run_that_is_led_takes_fewer_sweeps():
    """Than steps as short that start from the polynomials of those before, at the same tolerance."""
    compiled, chosen = swinging_chain(), options(order=16)
    coarser = made(compiled, chosen)
    led = made(compiled, chosen, coarser=coarser, part=0.8)
    steps = led.nodes - 1
    alone = cvi.simulate(compiled.scene(), duration=SPAN, dt=SPAN / steps, order=16, solver_tol=chosen.stage_tol)
    assert led.sweeps < 0.8 * alone.stats.sweeps
    t, q, _ = record_of(led, compiled, chosen).nodes()
    exact = cvi.simulate(compiled.scene(), duration=SPAN, dt=1e-3, order=16, solver_tol=1e-14).at(t).q
    np.testing.assert_allclose(q, exact, atol=1e-8)


def test_a_turning_base_is_led_as_closely_as_the_joints():
    """Its turns in a step depend on themselves; they are found before the first iteration, not by the first ones."""
    scene, rng = chain([pin.JointModelFreeFlyer(), *(pin.JointModelRY() for _ in range(4))])
    scene.v0 = rng.uniform(-2, 2, scene.nv)
    compiled, chosen = compile_scene(scene), options(order=16)
    coarser = made(compiled, chosen, level=1e-6)
    led = made(compiled, chosen, coarser=coarser, part=0.8)
    steps = led.nodes - 1
    alone = cvi.simulate(compiled.scene(), duration=SPAN, dt=SPAN / steps, order=16, solver_tol=chosen.stage_tol)
    assert led.sweeps < 0.6 * alone.stats.sweeps
    t, q, _ = record_of(led, compiled, chosen).nodes()
    exact = cvi.simulate(compiled.scene(), duration=SPAN, dt=1e-3, order=16, solver_tol=1e-14).at(t).q
    assert compiled.states.distance(q, exact).max() <= 1e-8


def lengths(run, compiled, chosen):
    return record_of(run, compiled, chosen).adaptive_steps["dt"]


def test_a_run_by_a_plan_takes_one_length_in_a_flight():
    """The shortest of the run that looked for it; and the longest of a run by a plan, which samples have cut."""
    compiled, chosen = swinging_chain(), options(order=16)
    coarser = made(compiled, chosen, level=1e-3)
    led = made(compiled, chosen, coarser=coarser, part=0.5)
    cut = made(compiled, chosen, coarser=coarser, part=0.5, sample=0.37 * SPAN)
    finer = made(compiled, chosen, coarser=cut, part=0.5)
    found, of_led, of_cut, of_finer = (lengths(run, compiled, chosen) for run in (coarser, led, cut, finer))
    assert np.all(np.diff(found) < 0.0)
    assert len(found) > 1
    steps = math.ceil(SPAN / (0.5 * found[-1]) - 1e-9)
    np.testing.assert_allclose(of_led, [SPAN / steps], rtol=1e-12)
    assert len(of_cut) > 1
    steps = math.ceil(SPAN / (0.5 * of_cut.max()) - 1e-9)
    np.testing.assert_allclose(of_finer, [SPAN / steps], rtol=1e-12)


def test_a_run_that_leads_astray_costs_sweeps_and_nothing_else():
    """Here the run before it is one of another start."""
    compiled, chosen = flying_box(), options(order=16)
    simulator = engine.make(compiled, chosen)
    engine.accepts(simulator, compiled.q0, np.array([0, 0, 3.0, -9.0, 9.0, 2.0, 0, 0, 2.0, 0, 0, 0]), 0.0)
    other, _ = engine.run_auto(simulator, SPAN, 1e-4, None)
    own = made(compiled, chosen)
    led, astray = (made(compiled, chosen, coarser=run, part=0.5) for run in (own, other))
    first, second = (record_of(run, compiled, chosen) for run in (led, astray))
    assert first.impacts == second.impacts > 0
    np.testing.assert_allclose(first.nodes()[1][-1], second.nodes()[1][-1], atol=1e-9)


@pytest.mark.parametrize("over_time", [False, True])
def test_distances_are_those_of_the_states(over_time):
    """At a node of the second run in each eighth of it, against the partial steps of the first of a trajectory."""
    compiled = flying_box()
    first = made(compiled)
    second = made(compiled, coarser=first, part=0.37)
    apart = second.distances(first, 8, over_time)
    size, steps = second.size, second.nodes
    record, finer = record_of(first, compiled), record_of(second, compiled)
    t, q, _ = finer.nodes()
    assert len(np.intersect1d(t, record.nodes()[0])) < 8
    states, _ = record.segments_joined().states(compiled.core, t, exact=True)
    at_nodes = compiled.states.distance(states, q)
    if over_time:
        own = at_nodes[np.searchsorted(t, SPAN / 8 * np.arange(1, 9) - 1e-12)]
    else:  # at the node of each part to which a step of the first run is shortest
        ends = np.linspace(0, len(t) - 1, 9).round().astype(int)
        begins = np.append(record.segments_joined().arrays["t"], t[-1])
        own = np.array([
            at_nodes[low + 1 + np.argmin(_fractions(t[low + 1 : high + 1], begins))]
            for low, high in zip(ends[:-1], ends[1:], strict=True)
        ])  # fmt: skip
        own[-1] = at_nodes[-1]
    np.testing.assert_allclose(apart, own, rtol=1e-6, atol=1e-12)
    assert apart.max() > 0.0
    assert size == pytest.approx(compiled.states.distance(q[:1], q).max(), rel=1e-12)
    assert steps == len(t)


def _fractions(times, begins):
    """Return which parts of the segments between some times lie before others; 0 at their ends."""
    at = np.clip(np.searchsorted(begins, times, side="right") - 1, 0, len(begins) - 2)
    part = (times - begins[at]) / (begins[at + 1] - begins[at])
    return np.where((part < 1e-9) | (part > 1.0 - 1e-9), 0.0, part)


def test_distances_at_the_nodes_of_both_runs():
    compiled = flying_box(ball=False)
    first = made(compiled, level=1e-9)
    second = made(compiled, coarser=first, part=0.5)
    apart = second.distances(first, 8)
    (t, q, _), (s, r, _) = (record_of(run, compiled).nodes() for run in (second, first))
    np.testing.assert_allclose(t[::2], s, rtol=1e-12)
    common = np.linspace(0, len(s) - 1, 9)[1:].round().astype(int)
    assert len(s) > 9
    np.testing.assert_allclose(apart, compiled.states.distance(q[2 * common], r[common]), rtol=1e-9)


def test_a_run_that_ended_early_is_infinitely_far():
    compiled = flying_box()
    whole, half = made(compiled), made(compiled, options(duration=0.5 * SPAN))
    assert whole.distances(half, 4).tolist() == [math.inf]
    assert np.isfinite(whole.distances(half, 4, ended=True)).all()


@pytest.mark.parametrize("damping", [1000.0, 0.0])
def test_the_first_step_is_held_against_two_halves(damping, tmp_path):
    """A spring that damping stops within a fraction of the step has an error there that the end does not show."""
    file = tmp_path / "slider.urdf"
    file.write_text(
        '<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="j" type="prismatic"><parent link="base"/><child link="arm"/><axis xyz="1 0 0"/>'
        '<limit lower="-9" upper="9" effort="9" velocity="9"/></joint></robot>'
    )
    scene = cvi.Scene()
    scene.add_urdf(file)
    scene.set_joint("j", damping=damping)
    scene.v0 = np.ones(1)
    compiled, chosen = compile_scene(scene), options(order=4)
    run = made(compiled, chosen, level=1.0)
    found = run.first_step_error
    t, q, _ = record_of(run, compiled, chosen).nodes()
    halves = cvi.simulate(scene, duration=t[1], dt=0.5 * t[1], order=4, solver_tol=chosen.stage_tol)
    assert found == pytest.approx(abs(q[1, 0] - halves.q[2, 0]), rel=1e-6, abs=1e-14)
    assert (found > 1e-4) == (damping > 0.0)


def test_what_cannot_be_compared_is_refused():
    compiled = flying_box()
    whole, bare = made(compiled), made(compiled, options(dense=False))
    for compare in (lambda: whole.distances(bare, 4), lambda: bare.error_share(whole, 17, 1e-3), lambda: bare.size):
        with pytest.raises(cvi.ContactviError, match="polynomials"):
            compare()
    record_of(whole, compiled)
    with pytest.raises(cvi.ContactviError, match="handed over"):
        whole.distances(whole, 4)


@pytest.mark.parametrize("least", [1, 2, 3])
def test_steps_from_an_impact_to_the_end_of_its_step(least):
    """As many as asked for; two runs that end the step at the same time show no error of a step that both have."""
    compiled, chosen = wall(), options(duration=3.0, order=16)
    coarser = made(compiled, chosen, level=1e-3)
    run = made(compiled, chosen, coarser=coarser, part=0.9, after_impact=least)
    result = run.results()
    impacts, begins = result["events"]["time"], result["segments"]["t"]
    assert len(impacts) == 2
    for impact in impacts:
        end = result["t"][result["t"].searchsorted(impact)]
        assert np.sum((begins >= impact - 1e-12) & (begins < end - 1e-9)) >= least


@pytest.mark.parametrize("sample", [0.2, 0.04])
def test_steps_end_at_samples_that_are_not_much_closer(sample):
    """Where they would be at most twice as long as samples are apart; where all are longer the samples lie inside."""
    compiled, chosen = wall(), options(duration=3.0, order=16)
    coarser = made(compiled, chosen, level=1e-3)
    asked = 0.8 * made(compiled, chosen, level=1e-3).results()["adaptive_steps"]["dt"]
    t = made(compiled, chosen, coarser=coarser, part=0.8, sample=sample).results()["t"]
    samples = sample * np.arange(1, round(3.0 / sample))
    on = np.abs(t[:, None] - samples).min(axis=0) < 1e-9
    assert (asked.max() <= 2.0 * sample) == (sample == 0.2)
    assert (asked.min() > 2.0 * sample) == (sample == 0.04)
    assert on.all() if sample == 0.2 else not on.any()


def test_samples_are_the_states_at_their_times():
    """Whether they are nodes or lie within steps."""
    scene = cvi.load_scene(MODELS / "double_pendulum_wall.toml")
    scene.settings = {}
    exact = cvi.simulate(scene, duration=3.0, dt=5e-3, order=16, solver_tol=1e-14)
    for sample in (0.25, 0.1, 0.01):
        traj = cvi.simulate(scene, duration=3.0, sample_dt=sample)
        np.testing.assert_allclose(traj.t, sample * np.arange(round(3.0 / sample) + 1), atol=1e-12)
        at = exact.at(traj.t)
        np.testing.assert_allclose(traj.q, at.q, atol=1e-6)
        np.testing.assert_allclose(traj.p, at.p, atol=1e-4)


# -- the law -----------------------------------------------------------------------------------------------------------


def judged_pair(errors, shares, exponent):
    """Judge three runs whose errors fall by the law's shares to a power, less than the law says."""
    laws = [share / (1.0 - share) for share in shares]
    e0 = errors
    e1 = e0 * shares[0] ** exponent
    e2 = e1 * shares[1] ** exponent
    first = auto_search._by_law(np.array([e0 - e1]), None, laws[0], 0.0, 1e3)
    second = auto_search._by_law(np.array([e1 - e2]), first, laws[1], 0.0, 1e3)
    return first, second, e1, e2


@pytest.mark.parametrize("exponent", [1.0, 0.9, 0.75])
@pytest.mark.parametrize("finer", [1e-1, 1e-2, 1e-3])
def test_an_estimate_is_within_its_bounds_where_errors_fall_less_than_the_law_says(exponent, finer):
    first, second, e1, e2 = judged_pair(1e-2, (1.0 / 30.0, finer), exponent)
    assert e1 / 3.0 <= first.estimate <= 10.0 * e1
    assert e2 / 3.0 <= second.estimate <= 10.0 * e2
    assert second.confirmed


def test_no_pair_of_runs_is_trusted_beyond_what_was_seen():
    """The first by a factor, whatever the law says; the second by the square of the fall that was seen."""
    first = auto_search._by_law(np.array([1e-3]), None, 1e-9, 0.0, 1e3)
    assert first.estimate == 1e-3 / LEAST
    second = auto_search._by_law(np.array([1e-5]), first, 1e-30, 0.0, 1e3)
    assert second.estimate == pytest.approx(1e-5 / 101.0**2)


def test_the_first_pair_with_contact_is_as_wrong_as_it_is_apart():
    first = auto_search._by_law(np.array([1e-3]), None, 1e-9, 0.0, 1e3, least=1.0)
    assert (first.lawful, first.estimate) == (True, 1e-3)
    assert auto_search._by_law(np.array([1e-5]), first, 1e-30, 0.0, 1e3, least=1.0).confirmed


def test_runs_that_lost_each_other_are_as_wrong_as_they_are_apart():
    first = auto_search._by_law(np.array([1.0]), None, 1e-2, 0.0, 5.0)
    assert (first.lawful, first.estimate) == (False, 1.0)
    second = auto_search._by_law(np.array([0.01]), first, 1e-2, 0.0, 5.0)
    assert (second.lawful, second.confirmed, second.estimate) == (True, False, 0.01 / LEAST)
    strange = auto_search._by_law(np.array([1.0]), second, 1e-2, 0.0, 5.0)
    assert (strange.lawful, strange.estimate) == (False, 1.0)


def test_what_two_runs_share_is_a_floor():
    judged = auto_search._by_law(np.array([0.0]), None, 1e-2, 1e-9, 1.0)
    assert judged.estimate == 1e-9
    assert isinstance(judged, Judged)


def test_what_is_left_of_the_stage_equations_is_multiplied_as_the_error_of_the_steps_is():
    found = SimpleNamespace(stage_tol=1e-12, run=SimpleNamespace(nodes=100))
    left = [auto_search._left_over(growth, found, 2.0) for growth in (1.0, 1e4)]
    assert left == pytest.approx([2e-11, 2e-7], rel=1e-3)


def test_the_kept_run_belongs_to_the_engine():
    assert isinstance(made(flying_box()), _core.KeptRun)


@pytest.mark.parametrize(("nearer", "estimate"), [(1e-8, 3e-8), (1e-11, 1e-8), (1e-4, 1e-5)])
def test_a_companion_that_went_another_way_is_left_out(monkeypatch, nearer, estimate):
    """A run that follows no law is judged by the run before its companion where that is nearer, and by the floor."""
    search = auto_search.Search(cast(Any, None), cvi.Options(dt="auto", duration=1.0, tol=1e-6), None)
    run = SimpleNamespace(size=1.0, nodes=100, first_step_error=0.0)
    found = cast(Any, SimpleNamespace(ok=True, level=1e-7, run=run))
    judged = Judged(1e-5, 1e-5, np.array([1e-5]), 0.3)
    monkeypatch.setattr(auto_search.auto_runs, "distances", lambda *runs, ended: np.array([nearer, 0.1 * nearer]))
    assert search._unlike_its_companion(found, found, judged).estimate == pytest.approx(estimate)
