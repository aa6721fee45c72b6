"""Runs that dt = "auto" keeps in the engine: what leads them, how far they are apart, what that says of the error."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from contactvi import _core
from contactvi.options import Options
from contactvi.simulation import adaptive, engine
from contactvi.simulation.auto_contact import LEAST, Judged
from contactvi.trajectory.compiled import compile_scene

MODELS = Path(__file__).resolve().parents[2] / "models"
BOX_V0 = [0.3, 0.0, 1.0, 3.0, -2.0, 5.0]


def flying_box():
    """A box that turns about all its axes while it flies, and a ball that bounces on the ground."""
    scene = cvi.Scene()
    scene.add_box("box", size=(0.1, 0.2, 0.3), placement=(0.0, 0.0, 5.0))
    scene.add_sphere("ball", 0.1, placement=(3.0, 0.0, 0.5))
    scene.add_halfspace()
    scene.set_contact(restitution=0.8)
    return compile_scene(scene)


def options(**changed):
    return Options(**{"dt": 0.02, "duration": 0.8, "order": 8, "tol": 1e-11, **changed})


def fixed_run(compiled, chosen, coarser=None):
    simulator = engine.make(compiled, chosen)
    start = engine.checked_start(compiled, None, [*BOX_V0, *np.zeros(6)] if compiled.states.nv == 12 else None)
    assert engine.accepts(simulator, *start)
    run, stopped = engine.run_fixed(simulator, chosen.steps, None, coarser)
    assert not stopped
    return run


@pytest.mark.parametrize("kind", ["pendulum", "box"])
def test_a_run_that_is_led_is_the_same_motion(kind):
    """Through impacts and turns: the start values change nothing that the tolerance of the equations resolves."""
    scene = MODELS / "double_pendulum_wall.toml"
    compiled = flying_box() if kind == "box" else compile_scene(cvi.load_scene(scene))
    chosen = options(order=16)
    coarser = fixed_run(compiled, options(order=16, dt=0.04))
    alone, led = fixed_run(compiled, chosen), fixed_run(compiled, chosen, coarser)
    if kind == "pendulum":  # the box turns evenly, and the polynomial of the step before is as good
        assert led.sweeps < 0.8 * alone.sweeps
    first, second = (engine.record_of(run, compiled, chosen) for run in (alone, led))
    assert first.impacts == second.impacts > 0
    np.testing.assert_allclose(first.nodes()[1], second.nodes()[1], atol=1e-9)


def test_a_run_that_leads_astray_costs_sweeps_and_nothing_else():
    """Here the run before it is one of another start."""
    compiled, chosen = flying_box(), options()
    simulator = engine.make(compiled, chosen)
    engine.accepts(simulator, compiled.q0, np.array([0, 0, 3.0, -9.0, 9.0, 2.0, 0, 0, 2.0, 0, 0, 0]), 0.0)
    other, _ = engine.run_fixed(simulator, chosen.steps, None, None)
    alone, led = fixed_run(compiled, chosen), fixed_run(compiled, chosen, other)
    first, second = (engine.record_of(run, compiled, chosen) for run in (alone, led))
    np.testing.assert_allclose(first.nodes()[1], second.nodes()[1], atol=1e-9)


def test_distances_are_those_of_the_states():
    """At nodes of the second run, against the partial steps of the first that a trajectory makes."""
    compiled = flying_box()
    coarse, fine = options(dt=0.08), options(dt=0.02)
    first, second = fixed_run(compiled, coarse), fixed_run(compiled, fine)
    apart = second.distances(first, 8)
    size, steps = second.size, second.nodes
    record, finer = engine.record_of(first, compiled, coarse), engine.record_of(second, compiled, fine)
    t, q, _ = finer.nodes()
    nodes = np.linspace(0, len(t) - 1, 9)[1:].round().astype(int)
    states, _ = record.segments_joined().states(compiled.core, t[nodes], exact=True)
    np.testing.assert_allclose(apart, compiled.states.distance(states, q[nodes]), rtol=1e-6, atol=1e-12)
    assert size == pytest.approx(compiled.states.distance(q[:1], q).max(), rel=1e-12)
    assert steps == len(t)


def test_a_run_that_ended_early_is_infinitely_far():
    compiled = flying_box()
    whole, half = fixed_run(compiled, options()), fixed_run(compiled, options(duration=0.4))
    assert whole.distances(half, 4).tolist() == [math.inf]
    assert np.isfinite(whole.distances(half, 4, ended=True)).all()


def test_the_first_step_is_held_against_two_halves(tmp_path):
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
    scene.set_joint("j", damping=1000.0)
    compiled = compile_scene(scene)
    chosen = options(dt=0.1, duration=0.4, order=4)
    simulator = engine.make(compiled, chosen)
    assert engine.accepts(simulator, np.zeros(1), np.ones(1), 0.0)
    run, _ = engine.run_fixed(simulator, chosen.steps, None, None)
    halves = engine.make(compiled, options(dt=0.05, duration=0.1, order=4))
    engine.accepts(halves, np.zeros(1), np.ones(1), 0.0)
    twice, _ = engine.run_fixed(halves, 2, None, None)
    found = run.first_step_error
    whole, half = (engine.record_of(r, compiled, chosen).nodes()[1] for r in (run, twice))
    assert found == pytest.approx(abs(whole[1, 0] - half[2, 0]), rel=1e-9)
    assert found > 1e-4


def test_what_cannot_be_compared_is_refused():
    compiled = flying_box()
    whole, bare = fixed_run(compiled, options()), fixed_run(compiled, options(dense=False))
    for compare in (lambda: whole.distances(bare, 4), lambda: bare.error_share(whole, 17, 1e-3), lambda: bare.size):
        with pytest.raises(cvi.ContactviError, match="polynomials"):
            compare()
    engine.record_of(whole, compiled, options())
    with pytest.raises(cvi.ContactviError, match="handed over"):
        whole.distances(whole, 4)


# -- the law -----------------------------------------------------------------------------------------------------------


def judged_pair(errors, shares, exponent):
    """Judge three runs whose errors fall by the law's shares to a power, less than the law says."""
    laws = [share / (1.0 - share) for share in shares]
    e0 = errors
    e1 = e0 * shares[0] ** exponent
    e2 = e1 * shares[1] ** exponent
    first = adaptive._by_law(np.array([e0 - e1]), None, laws[0], 0.0, 1e3)
    second = adaptive._by_law(np.array([e1 - e2]), first, laws[1], 0.0, 1e3)
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
    first = adaptive._by_law(np.array([1e-3]), None, 1e-9, 0.0, 1e3)
    assert first.estimate == 1e-3 / LEAST
    second = adaptive._by_law(np.array([1e-5]), first, 1e-30, 0.0, 1e3)
    assert second.estimate == pytest.approx(1e-5 / 101.0**2)


def test_runs_that_lost_each_other_are_as_wrong_as_they_are_apart():
    first = adaptive._by_law(np.array([1.0]), None, 1e-2, 0.0, 5.0)
    assert (first.lawful, first.estimate) == (False, 1.0)
    second = adaptive._by_law(np.array([0.01]), first, 1e-2, 0.0, 5.0)
    assert (second.lawful, second.confirmed, second.estimate) == (True, False, 0.01 / LEAST)
    strange = adaptive._by_law(np.array([1.0]), second, 1e-2, 0.0, 5.0)
    assert (strange.lawful, strange.estimate) == (False, 1.0)


def test_what_two_runs_share_is_a_floor():
    judged = adaptive._by_law(np.array([0.0]), None, 1e-2, 1e-9, 1.0)
    assert judged.estimate == 1e-9
    assert isinstance(judged, Judged)


def test_the_kept_run_belongs_to_the_engine():
    assert isinstance(fixed_run(flying_box(), options()), _core.KeptRun)
