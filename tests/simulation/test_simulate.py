"""`simulate` and `Simulator`: what they return, how they end, what they refuse."""

from __future__ import annotations

import dataclasses
import math
import os
import signal
import threading
import warnings

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.simulation.settings import settings_of
from helpers.run_scenes import FIRST_IMPACT, GRAVITY, HEIGHT, RADIUS, ball_file, ball_scene, hand_scene, slider_scene

EPS = np.finfo(float).eps
FLIGHT_TOLERANCE = 1e-12  # the midpoint rule is exact on a parabola; gaps are located to 1e-12 m


def test_elastic_ball():
    traj = cvi.simulate(ball_scene(), duration=3.0, dt=1e-2)
    assert traj.status.ok
    assert traj.status.time == pytest.approx(3.0, abs=EPS * 300)
    assert traj.t == pytest.approx(np.arange(301) * 1e-2, abs=EPS * 300)
    assert [event.pair for event in traj.events] == [("ball", "ground")] * 3
    times = FIRST_IMPACT * np.array([1, 3, 5])
    assert traj.events.array("time") == pytest.approx(times, abs=10 * FLIGHT_TOLERANCE)
    # Every step is solved to solver_tol, relative; the errors of a parabola do not add up beyond a few of them.
    assert np.ptp(traj.energy) <= 10 * traj.options.solver_tol * traj.energy[0]
    assert traj.stats.steps == 300
    assert traj.stats.impacts == 3


def test_accumulating_impacts_end_the_run():
    with pytest.raises(cvi.SimulationError, match="'ball' and 'ground' accumulate") as caught:
        cvi.simulate(ball_scene(restitution=0.5), duration=3.0, dt=1e-2, zeno="end")
    traj = caught.value.trajectory
    zeno = FIRST_IMPACT * (1 + 0.5) / (1 - 0.5)
    assert caught.value.status == traj.status
    assert traj.status.code == cvi.StatusCode.ZENO
    assert float(traj.status.message.split("t = ")[1].split()[0]) == pytest.approx(zeno, rel=1e-9)
    assert traj.t[-1] == traj.status.time == traj.events[-1].time
    assert traj.q[-1, 2] == pytest.approx(RADIUS, abs=1e-12)
    assert np.all(traj.q[:, 2] >= RADIUS - 1e-12)
    assert np.all(np.diff(traj.t) > 0)


def test_no_throw_returns_the_same():
    ending = {"duration": 3.0, "dt": 1e-2, "zeno": "end"}
    thrown = pytest.raises(cvi.SimulationError, cvi.simulate, ball_scene(0.5), **ending)
    kept = cvi.simulate(ball_scene(0.5), **ending, throw=False)
    assert kept.status == thrown.value.status
    np.testing.assert_array_equal(kept.q, thrown.value.trajectory.q)


def test_limit_events():
    traj = cvi.simulate(slider_scene(), duration=0.4, dt=1e-3)
    event = traj.events[0]
    assert (event.kind, event.pair) == ("limit", ("slider", "lower limit"))
    assert event.time == pytest.approx(math.sqrt(2 * 0.2 / GRAVITY), abs=FLIGHT_TOLERANCE)
    assert event.gamma_plus == pytest.approx(-0.5 * event.gamma_minus, rel=8 * EPS)
    assert event.impulse == pytest.approx(2.0 * (event.gamma_plus - event.gamma_minus), rel=8 * EPS)


def test_start_in_penetration():
    scene = ball_scene()
    q0 = scene.configuration({"ball": (0.0, 0.0, RADIUS - 0.03)})
    with pytest.raises(cvi.PenetrationError, match="'ball' and 'ground' overlap by 0.03 m") as caught:
        cvi.simulate(scene, q0, duration=1.0, dt=1e-2)
    assert caught.value.pair == ("ball", "ground")
    assert caught.value.depth == pytest.approx(0.03, abs=1e-12)
    traj = cvi.simulate(scene, q0, duration=1.0, dt=1e-2, throw=False)
    assert traj.status.code == cvi.StatusCode.PENETRATION
    assert len(traj) == 1


def test_start_beyond_a_limit():
    with pytest.raises(cvi.PenetrationError, match="'slider' is 0.1 .* beyond its lower limit"):
        cvi.simulate(slider_scene(), [-0.3], duration=1.0, dt=1e-2)


def test_record_every_keeps_the_last_state():
    fine = cvi.simulate(ball_scene(), duration=1.0, dt=1e-2)
    coarse = cvi.simulate(ball_scene(), duration=1.0, dt=1e-2, record_every=7)
    kept = [*range(0, 100, 7), 100]
    np.testing.assert_array_equal(coarse.t, fine.t[kept])
    np.testing.assert_array_equal(coarse.q, fine.q[kept])
    np.testing.assert_array_equal(coarse.p, fine.p[kept])
    assert len(coarse.events) == len(fine.events)


# -- control ----------------------------------------------------------------------------------------------------------


def test_constant_force():
    """A free body under a constant force in its own axes, which do not turn: the midpoint rule is exact."""
    tau = np.tile([1.0, 0.0, 0.5 * GRAVITY, 0.0, 0.0, 0.0], (40, 1))
    traj = cvi.simulate(ball_scene(), duration=0.4, dt=1e-2, control=tau)
    assert traj.q[:, 0] == pytest.approx(0.5 * 2.0 * traj.t**2, abs=1e-13)
    assert traj.q[:, 2] == pytest.approx(np.full(41, RADIUS + HEIGHT), abs=1e-13)


def test_control_array_function_and_simulator_agree():
    scene, q0 = hand_scene()
    steps = 30
    tau = 0.02 * np.sin(np.arange(steps)[:, None] + np.arange(scene.nv))
    by_array = cvi.simulate(scene, q0, duration=steps * 1e-3, dt=1e-3, control=tau)
    calls = []

    def control(t, q, v):
        calls.append((t, q, v))
        return tau[len(calls) - 1]

    by_function = cvi.simulate(scene, q0, duration=steps * 1e-3, dt=1e-3, control=control)
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset(q0)
    for k in range(steps):
        assert sim.step(tau[k]).ok
    for other in (by_function, sim.trajectory()):
        np.testing.assert_array_equal(other.t, by_array.t)
        np.testing.assert_array_equal(other.q, by_array.q)
        np.testing.assert_array_equal(other.p, by_array.p)
    assert [call[0] for call in calls] == pytest.approx(by_array.t[:-1], abs=EPS)
    np.testing.assert_array_equal([call[1] for call in calls], by_array.q[:-1])
    assert np.array([call[2] for call in calls]) == pytest.approx(by_array.v[:-1], abs=1e-12)


def test_errors_of_the_control_reach_the_caller():
    def broken(t, q, v):
        raise RuntimeError("mine")

    with pytest.raises(RuntimeError, match="mine"):
        cvi.simulate(ball_scene(), duration=0.1, dt=1e-2, control=broken)
    with pytest.raises(cvi.InputError, match="tau has the wrong shape"):
        cvi.simulate(ball_scene(), duration=0.1, dt=1e-2, control=lambda t, q, v: np.zeros(3))


# -- progress and interruption ----------------------------------------------------------------------------------------

LONG = {"duration": 1e5, "dt": 1e-2, "record_every": 1_000_000}  # minutes, if nobody stops it


def test_progress():
    seen = []

    def stop(t, impacts):
        seen.append((t, impacts))
        if len(seen) == 3:
            raise KeyboardInterrupt

    with pytest.raises(cvi.SimulationError) as caught:
        cvi.simulate(ball_scene(), progress=stop, **LONG)
    assert caught.value.status.code == cvi.StatusCode.INTERRUPTED
    assert caught.value.status.time == caught.value.trajectory.t[-1] == seen[-1][0]
    assert np.all(np.diff(seen, axis=0) > 0)
    assert len(caught.value.trajectory.events) == seen[-1][1]


def test_error_in_progress_reaches_the_caller():
    def broken(t, impacts):
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        cvi.simulate(ball_scene(), progress=broken, **LONG)


@pytest.mark.parametrize("control", [None, lambda t, q, v: np.zeros(6)])
def test_ctrl_c_leaves_the_partial_trajectory(control):
    # A shell starts background jobs with SIGINT ignored; Python then has no handler of its own.
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        traj = cvi.simulate(ball_scene(), control=control, throw=False, **LONG)
    finally:
        timer.cancel()
        signal.signal(signal.SIGINT, handler)
    assert traj.status.code == cvi.StatusCode.INTERRUPTED
    assert 0 < traj.t[-1] < LONG["duration"]
    assert traj.t[-1] == traj.status.time


# -- Simulator --------------------------------------------------------------------------------------------------------


def test_simulator_runs_like_simulate():
    whole = cvi.simulate(ball_scene(0.8), duration=2.0, dt=1e-2)
    sim = cvi.Simulator(ball_scene(0.8), dt=1e-2)
    assert sim.status is None
    sim.reset()
    assert sim.run(150).ok
    assert sim.run(50).ok
    assert sim.t == pytest.approx(2.0, abs=EPS * 200)
    np.testing.assert_array_equal(sim.q, whole.q[-1])
    np.testing.assert_array_equal(sim.p, whole.p[-1])
    assert sim.v == pytest.approx(whole.v[-1], rel=1e-13, abs=1e-13)
    assert sim.impacts == len(sim.events) == len(whole.events)
    np.testing.assert_array_equal(sim.trajectory().q, whole.q)
    assert sim.trajectory().stats.steps == 200
    sim.reset()
    assert (sim.t, sim.impacts, len(sim.trajectory())) == (0.0, 0, 1)
    assert sim.run(10).ok
    assert sim.trajectory().stats.steps == 10


def test_simulator_says_when_it_cannot_step():
    sim = cvi.Simulator(ball_scene(0.5), dt=1e-2, zeno="end")
    with pytest.raises(cvi.SimulationError, match="reset"):
        sim.step()
    sim.reset(t=5.0)
    assert sim.run(300).code == cvi.StatusCode.ZENO
    assert sim.trajectory().t[0] == 5.0
    with pytest.raises(cvi.SimulationError, match="has ended: ZENO"):
        sim.step()


def test_editing_a_scene_does_not_reach_a_run():
    scene = ball_scene(restitution=0.8)
    sim = cvi.Simulator(scene, dt=1e-2)
    sim.reset()
    scene.set_contact(restitution=0.0)
    scene.add_sphere("other", 0.1, 1.0, placement=(3.0, 0.0, 1.0))
    assert sim.run(60).ok
    traj = sim.trajectory()
    assert traj.events[0].restitution == 0.8
    assert traj.v.shape == (61, 6)
    assert {visual.name for visual in traj.visuals} == {"ball", "ground"}


# -- settings ---------------------------------------------------------------------------------------------------------


def test_settings_of_a_scene_file(tmp_path):
    scene = cvi.load_scene(ball_file(tmp_path, duration=0.5))
    traj = cvi.simulate(scene)
    assert (traj.options.dt, traj.options.duration, traj.options.steps) == (0.01, 0.5, 50)
    assert cvi.simulate(scene, duration=0.2).options == dataclasses.replace(traj.options, duration=0.2)


@pytest.mark.parametrize(
    ("arguments", "name", "text"),
    [
        ({"dt": -1e-3}, "dt", "-0.001"),
        ({"dt": 0}, "dt", "got 0"),
        ({"dt": math.nan}, "dt", "nan"),
        ({"dt": math.inf}, "dt", "inf"),
        ({"dt": "fast"}, "dt", "'fast'"),
        ({"dt": True}, "dt", "True"),
        ({"duration": 0.0}, "duration", "0.0"),
        ({"duration": -1.0}, "duration", "-1.0"),
        ({"duration": 1.005}, "duration", "Use duration=1, or dt="),
        ({"duration": 1e50, "dt": 1e-300}, "dt", "overflows"),
        ({"duration": 1e300, "dt": 1e-3}, "duration", "at most 1e+50"),
        ({"solver_tol": 0.0}, "solver_tol", "0.0"),
        ({"solver_tol": 2.0}, "solver_tol", "below 1"),
        ({"record_every": 0}, "record_every", ">= 1"),
        ({"record_every": 1.5}, "record_every", "1.5"),
        ({"max_iterations": -3}, "max_iterations", "-3"),
        ({"impact": ["mhc"]}, "impact", "'ctec' | 'dtec' | 'mhc'"),
        ({"mhc_reference": "globl"}, "mhc_reference", "Did you mean 'global'"),
        ({"impact": "ctce"}, "impact", "Did you mean 'ctec'"),
        ({"order": 3}, "order", "expected an even number from 2 to 16, got 3. Use order=4"),
        ({"order": 18}, "order", "Use order=16"),
        ({"order": 0}, "order", "Use order=2"),
        ({"sample_dt": 0.0}, "sample_dt", "> 0"),
        ({"sample_dt": "often"}, "sample_dt", "'often'"),
        ({"sample_dt": 0.1, "record_every": 2}, "record_every", "1 with dt='auto' and with sample_dt"),
        ({"sample_dt": 0.1, "dense": False}, "dense", "True with sample_dt"),
        ({"dense": 1}, "dense", "True or False"),
        ({"dt": "auto", "order": 2}, "order", "Use order=16"),
        ({"dt": "auto", "impact": "dtec"}, "impact", "'ctec' or 'mhc'"),
        ({"dt": "auto", "record_every": 5}, "record_every", "1 with dt='auto'"),
        ({"dt": "auto", "ledger": {"discrete_energy": 1e-9}}, "ledger", "discrete_energy"),
        ({"dt": "auto", "control": np.zeros((100, 6))}, "dt", "Give dt=..."),
        ({"dt": "auto", "tol": 1.0}, "tol", "below 1"),
        ({"order": "2"}, "order", "'2'"),
        ({"toll": 1e-9}, "toll", "Did you mean 'tol'"),
        ({"recordevery": 2}, "recordevery", "Did you mean 'record_every'"),
    ],
)
def test_bad_settings(arguments, name, text):
    given = {"duration": 1.0, "dt": 1e-2, **arguments}
    with pytest.raises(cvi.InputError) as caught:
        cvi.simulate(ball_scene(), **given)
    assert caught.value.name == name
    assert text in str(caught.value)
    assert caught.value.expected is not None
    assert caught.value.got is not None


def test_missing_settings():
    with pytest.raises(cvi.InputError, match=r"Give duration=\.\.\."):
        cvi.simulate(ball_scene(), dt=1e-2)
    with pytest.raises(cvi.InputError, match=r"Give dt=\.\.\."):
        cvi.Simulator(ball_scene())
    with pytest.raises(cvi.InputError, match=r"Give dt=\.\.\."):
        cvi.Simulator(ball_scene(), dt="auto")


def resolved(file, forced=False, **chosen):
    """What a run with these settings of a file and of a call is run with."""
    scene = ball_scene()
    scene.settings = dict(file)
    return settings_of(scene, {"duration": 1.0, **chosen}, forced)


def test_defaults_depend_on_the_kind_of_step():
    fixed, auto = resolved({"dt": 0.01}), resolved({})
    assert (fixed.order, fixed.tol, fixed.solver_tol, fixed.stage_tol) == (2, None, 1e-12, 1e-12)
    assert (fixed.dense, fixed.auto) == (False, False)
    assert auto.solver_tol is None
    assert (auto.dt, auto.order, auto.tol, auto.stage_tol, auto.dense) == ("auto", 16, 1e-6, pytest.approx(1e-11), True)
    assert resolved({}, tol=1e-9).stage_tol == pytest.approx(1e-14)
    assert resolved({}, tol=1e-13).stage_tol == 1e-15
    assert resolved({"dt": 0.01}, order=6).dense
    assert resolved({"dt": 0.01}, sample_dt=0.1).dense
    for options in (fixed, auto):
        assert cvi.Options.from_dict(options.to_dict()) == options


@pytest.mark.parametrize(
    "chosen",
    [{"forced": True}, {"impact": "dtec"}, {"order": 2}, {"record_every": 5}, {"ledger": {"discrete_energy_jump": 1}}],
)
def test_runs_that_cannot_choose_their_step_have_a_default(chosen):
    assert resolved({}, **chosen).dt == 1e-3


def test_settings_of_another_kind_of_step_do_not_count():
    file = {"dt": 0.01, "solver_tol": 1e-9, "record_every": 5, "impact": "mhc"}
    auto = resolved(file, dt="auto")
    assert (auto.tol, auto.record_every, auto.impact) == (1e-6, 1, "mhc")
    assert resolved(file, dt="auto", tol=1e-4).tol == 1e-4
    assert resolved(file, dt=0.02).solver_tol == 1e-9
    assert resolved({"tol": 1e-8}, dt=0.02).solver_tol == 1e-12
    assert resolved({"tol": 1e-8}, forced=True).solver_tol == 1e-12
    assert resolved({"dt": "auto", "tol": 1e-8}).tol == 1e-8


@pytest.mark.parametrize(
    ("file", "chosen"),
    [
        ({}, {"dt": 0.01, "tol": 1e-9}),
        ({"dt": 0.01}, {"tol": 1e-9}),
        ({"dt": 0.01, "tol": 1e-9}, {}),
        ({}, {"order": 2, "tol": 1e-9}),
        ({}, {"forced": True, "tol": 1e-9}),
    ],
)
def test_tol_beside_a_fixed_step_is_taken_as_solver_tol_with_a_warning(file, chosen):
    """Each time: the options of a call are kept, the warning must not be lost with them."""
    for _ in range(2):
        with pytest.warns(cvi.DeprecatedWarning, match=r"accuracy of q.*solver_tol=1e-09") as told:
            found = resolved(file, **chosen)
        assert (found.solver_tol, found.tol) == (1e-9, None)
    assert {warning.filename for warning in told} == {__file__}


def test_the_warning_of_tol_is_that_of_the_line_of_the_call():
    with pytest.warns(cvi.DeprecatedWarning) as told:
        traj = cvi.simulate(ball_scene(), duration=0.1, dt=0.01, tol=1e-11)
    assert [warning.filename for warning in told] == [__file__]
    assert traj.options.solver_tol == 1e-11
    assert np.isnan(traj.error_estimate)


@pytest.mark.parametrize("chosen", [{"dt": 0.01, "tol": 1e-9, "solver_tol": 1e-9}, {"dt": "auto", "solver_tol": 1e-9}])
def test_each_kind_of_step_has_its_own_tolerance(chosen):
    with pytest.raises(cvi.InputError, match="tol"):
        resolved({}, **chosen)


def test_tol_alone_makes_the_step_automatic_and_is_met():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        traj = cvi.simulate(ball_scene(), duration=1.0, tol=1e-7)
    assert traj.options.auto
    assert traj.error_estimate <= 1e-7


def test_options_of_older_files_call_the_tolerance_of_the_solver_tol():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        old = cvi.Options.from_stored({"dt": 0.01, "tol": 1e-9})
        auto = cvi.Options.from_stored({"dt": "auto", "tol": 1e-9})
    assert (old.solver_tol, old.tol) == (1e-9, None)
    assert (auto.solver_tol, auto.tol) == (None, 1e-9)


@pytest.mark.parametrize(("duration", "dt", "steps"), [(1.0, 0.1, 10), (0.3, 0.1, 3), (2.0, 1 / 60, 120), (3, 1, 3)])
def test_whole_numbers_of_steps(duration, dt, steps):
    assert cvi.Options(dt=dt, duration=duration).steps == steps


# -- states -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("q0", "text"),
    [
        (np.zeros(6), r"shape \(7,\), got shape \(6,\)"),
        (np.zeros((1, 7)), r"shape \(7,\), got shape \(1, 7\)"),
        ("up", "not an array of numbers"),
        ([[1, 2], [3]], "not an array of numbers"),
        ([0, 0, 1, 0, 0, 0, math.nan], "nan at index 6"),
        ([0, 0, math.inf, 0, 0, 0, 1], "inf at index 2"),
        ([0, 0, 1, 0, 0, 0, 0], "joint 'ball' .* norm 0"),
        ([0, 0, 1, 0, 0, 0, 1.1], "joint 'ball' .* norm 1.1"),
    ],
)
def test_bad_start(q0, text):
    with pytest.raises(cvi.InputError, match=text) as caught:
        cvi.simulate(ball_scene(), q0, duration=1.0, dt=1e-2)
    assert caught.value.name == "q0"


def test_rounded_quaternion_is_normalised():
    q0 = [0, 0, 1.1, 0, 0, 0.7071068, 0.7071068]
    traj = cvi.simulate(ball_scene(), q0, duration=0.1, dt=1e-2)
    assert np.linalg.norm(traj.q[:, 3:], axis=1) == pytest.approx(1.0, abs=16 * EPS)


@pytest.mark.parametrize("v0", [np.zeros(7), [0, 0, 0, 0, 0, math.nan], 3.0, {}])
def test_bad_velocity(v0):
    with pytest.raises(cvi.InputError) as caught:
        cvi.simulate(ball_scene(), None, v0, duration=1.0, dt=1e-2)
    assert caught.value.name == "v0"


@pytest.mark.parametrize("control", [np.zeros((99, 6)), np.zeros(5), np.full((100, 6), math.nan), "push"])
def test_bad_control(control):
    with pytest.raises(cvi.InputError) as caught:
        cvi.simulate(ball_scene(), duration=1.0, dt=1e-2, control=control)
    assert caught.value.name == "control"


def test_unit_complex_numbers_are_checked():
    """Continuous and planar joints keep (cos, sin), spherical ones a quaternion."""
    for joint, bad in ((pin.JointModelRUBZ(), [1.0, 0.5]), (pin.JointModelPlanar(), [0.0, 0.0, 0.5, 0.5])):
        model = pin.Model()
        index = model.addJoint(0, joint, pin.SE3.Identity(), "wheel")
        model.appendBodyToJoint(index, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        with pytest.raises(cvi.InputError, match=r"pair \(cos, sin\) of joint 'wheel'"):
            cvi.simulate(cvi.Scene.from_pinocchio(model), bad, duration=1.0, dt=1e-2)


def test_one_force_is_that_of_all_steps():
    scene, tau = ball_scene(), np.array([0.1, 0.0, 20.0, 0.0, 0.01, 0.0])
    expected = cvi.simulate(scene, duration=0.1, dt=1e-2, control=np.tile(tau, (10, 1)))
    np.testing.assert_array_equal(cvi.simulate(scene, duration=0.1, dt=1e-2, control=tau).q, expected.q)
    sim = cvi.Simulator(scene, dt=1e-2)
    sim.reset()
    sim.run(10, tau)
    np.testing.assert_array_equal(sim.q, expected.q[-1])
    with pytest.raises(cvi.InputError, match=r"control has the wrong shape: .*shape \(6,\), or one per step"):
        cvi.simulate(scene, duration=0.1, dt=1e-2, control=tau[:3])


@pytest.mark.parametrize("bounces", [False, True])
def test_kept_polynomials_change_a_run_by_less_than_the_error_of_its_steps(bounces):
    """They cut the steps of a pendulum where a ball bounces beside it, which is an error of order 2 and more."""
    scene = cvi.Scene()
    scene.add_urdf("models/double_pendulum.urdf", placement=(5.0, 0.0, 3.0))
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, placement=(0.0, 0.0, 0.5 if bounces else 30.0))
    scene.set_contact(restitution=0.8)
    q0 = scene.configuration({"joint_1": 1.0, "joint_2": 0.5})
    apart = []
    for dt in (1e-2, 2.5e-3):
        run, finer = (cvi.simulate(scene, q0, duration=2.0, dt=step, order=2) for step in (dt, 0.5 * dt))
        kept = [cvi.simulate(scene, q0, duration=2.0, dt=dt, order=2, **how).q[-1] for how in (
            {"dense": True}, {"sample_dt": 0.1}, {"record": "gradient"})]  # fmt: skip
        assert np.array_equal(kept[0], kept[1])
        assert np.array_equal(kept[0], kept[2])
        apart.append(np.abs(kept[0] - run.q[-1]).max())
        assert apart[-1] < (np.abs(finer.q[-1] - run.q[-1]).max() if bounces else 1e-10)  # tol times the growth
    assert not bounces or apart[1] < apart[0] / 12.0  # 16 for second order


def test_the_first_impact_of_every_pair():
    scene = ball_scene(restitution=0.5)
    scene.add_sphere("other", 0.1, placement=(3.0, 0.0, 0.4))
    traj = cvi.simulate(scene, duration=1.0, dt=1e-2)
    first = traj.events.first_by_pair()
    assert len(first) == 2
    times = [event.time for event in first.values()]
    assert times == sorted(times)
    for pair, event in first.items():
        assert event.time == min(other.time for other in traj.events if other.pair == pair)
    flight = cvi.simulate(ball_scene(), duration=0.01, dt=1e-2)
    assert flight.events.first_by_pair() == {}


def test_an_engine_that_waits_is_for_its_own_tolerance():
    """Engines of a scene are used again by runs with the same settings alone."""
    scene, q = hand_scene()
    v = np.linspace(-1.0, 1.0, scene.nv)
    runs = [cvi.simulate(scene, q, v, duration=0.1, dt=0.01, solver_tol=tol) for tol in (1e-12, 1e-3, 1e-12)]
    assert not np.array_equal(runs[0].q[-1], runs[1].q[-1])
    np.testing.assert_array_equal(runs[0].q, runs[2].q)
