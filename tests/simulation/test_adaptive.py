"""dt = "auto": q is as accurate as asked, the estimate is honest, and what cannot be met is reported."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import contactvi as cvi
from contactvi.simulation.auto_contact import BUDGET, ContactSearch, Judged
from contactvi.simulation.auto_runs import AutoRun
from contactvi.states import States
from helpers.chains import JOINTS, chain
from helpers.run_scenes import FIRST_IMPACT, ball_file, ball_scene, slider_scene

EPS = np.finfo(float).eps
FILE = Path(__file__).resolve().parents[2] / "models" / "double_pendulum_wall.toml"


def wall() -> cvi.Scene:
    """Problem B: two impacts in three seconds; with a step of its own in the file, which is taken out."""
    scene = cvi.load_scene(FILE)
    scene.settings = {}
    return scene


def swinging() -> cvi.Scene:
    """The double pendulum away from its wall, from nearly horizontal."""
    model = pin.Model()
    parent = 0
    for k in range(2):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -float(k)]))
        parent = model.addJoint(parent, pin.JointModelRY(), place, f"j{k}")
        model.appendBodyToJoint(
            parent, pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), 1e-3 * np.eye(3)), pin.SE3.Identity()
        )
    scene = cvi.Scene.from_pinocchio(model)
    scene.set_joint("j*", limits=False)
    scene.q0 = np.array([1.4, 0.1])
    return scene


def tumbling() -> cvi.Scene:
    """A box that turns about all axes and flies."""
    scene = cvi.Scene()
    scene.add_box("box", size=(0.4, 0.3, 0.1), mass=2.0)
    scene.v0 = scene.velocity({"box": ((1.0, -0.5, 3.0), (0.3, 5.0, -0.2))})
    return scene


def damped() -> cvi.Scene:
    scene = swinging()
    scene.set_joint("j*", damping=0.3)
    return scene


SCENES = {"wall": (wall, 3.0), "swinging": (swinging, 4.0), "tumbling": (tumbling, 3.0), "damped": (damped, 4.0)}


def error(traj: cvi.Trajectory, exact: cvi.Trajectory) -> float:
    """Largest error of q over the nodes, tangent difference."""
    model = traj.scene.model

    return float(States(model).distance(traj.q, exact.at(traj.t).q).max())


@pytest.fixture(scope="module")
def exact() -> dict[str, cvi.Trajectory]:
    """Steps of 5 ms at order 16: polynomials exact to rounding, gathered over the run."""
    return {
        name: cvi.simulate(make(), duration=span, dt=0.005, order=16, solver_tol=1e-14)
        for name, (make, span) in SCENES.items()
    }


# -- what it promises -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tol", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("name", SCENES)
def test_the_accuracy_asked_for_is_met(name, tol, exact):
    make, span = SCENES[name]
    traj = cvi.simulate(make(), duration=span, dt="auto", tol=tol)
    assert traj.status.ok
    assert traj.options.order == 16
    assert error(traj, exact[name]) <= tol
    assert traj.error_estimate <= tol
    # An estimate, from two runs: it may miss, but not by far. (At 1e-3 the engine's level is capped, steps are as long
    # as their stage iterations converge, and the law of the error is not yet seen: only the promise counts.)
    if tol < 1e-3:
        assert traj.error_estimate >= error(traj, exact[name]) / 3.0 - 1e-12


@pytest.mark.parametrize("order", [4, 8, 12])
def test_other_orders(order, exact):
    traj = cvi.simulate(wall(), duration=3.0, dt="auto", order=order, tol=1e-6)
    assert traj.options.order == order
    assert error(traj, exact["wall"]) <= 1e-6


def test_more_accuracy_takes_shorter_steps(exact):
    runs = [cvi.simulate(wall(), duration=3.0, dt="auto", tol=tol) for tol in (1e-3, 1e-6, 1e-9)]
    steps = [traj.stats.steps for traj in runs]
    assert steps[0] < steps[1] < steps[2]


@pytest.mark.parametrize("name", SCENES)
def test_steps_are_constant_between_impacts(name):
    """Between two changes all steps have one length, but for the last one, which ends at an impact or with the run."""
    make, span = SCENES[name]
    traj = cvi.simulate(make(), duration=span)
    assert traj.options.dt == "auto"
    assert traj.t[0] == 0.0
    assert traj.t[-1] == pytest.approx(span, abs=EPS * span)
    assert np.all(np.diff(traj.t) > 0)
    assert traj.stats.steps >= len(traj.adaptive_steps["t"])
    assert traj.adaptive_steps["t"][0] == 0.0
    assert np.all(np.diff(traj.adaptive_steps["t"]) > 0)
    ends = np.append(traj.adaptive_steps["t"][1:], traj.t[-1])
    for begin, end, dt in zip(traj.adaptive_steps["t"], ends, traj.adaptive_steps["dt"], strict=True):
        nodes = traj.t[(traj.t > begin) & (traj.t < end - 1e-9)]
        assert np.diff(nodes) == pytest.approx(np.full(max(0, len(nodes) - 1), dt), rel=1e-9)


def test_impacts_are_where_they_belong():
    traj = cvi.simulate(ball_scene(), duration=3.0)
    assert traj.events.array("time") == pytest.approx(FIRST_IMPACT * np.array([1, 3, 5]), abs=1e-10)
    assert np.ptp(traj.energy) <= 1e-9 * traj.energy[0]


def test_mhc_and_limits():
    # an error of q is one of H times the forces, some 30 N m here
    traj = cvi.simulate(wall(), duration=20.0, impact="mhc", tol=1e-6)
    assert np.ptp(traj.energy) <= 30.0 * 1e-6
    assert np.ptp(traj.modified_energy - traj.energy) == 0.0
    slider = cvi.simulate(slider_scene(0.9), duration=0.6)
    assert {event.kind for event in slider.events} == {"limit"}


@pytest.mark.parametrize("tol", [1e-5, 1e-6, 1e-7])
def test_motion_that_multiplies_errors(tol):
    """Ten seconds of a double pendulum multiply what is left of the stage equations, too, by about 1e4."""
    scene = swinging()
    scene.q0 = np.array([1.5, 1.0])
    close = cvi.simulate(scene, duration=10.0, dt=0.005, order=16, solver_tol=1e-14)
    traj = cvi.simulate(scene, duration=10.0, tol=tol)
    assert error(traj, close) / 3.0 <= traj.error_estimate <= tol


@pytest.mark.parametrize("tol", [1e-4, 1e-5, 1e-6, 1e-7])
@pytest.mark.parametrize("sample", [None, 0.1])
@pytest.mark.parametrize(
    ("kinds", "seed"),
    [("swinging", 1), ("swinging", 2), ("double", 2), ("spherical", 2), ("free", 0)],
)
def test_estimates_of_random_chains(kinds, seed, sample, tol):
    """Motion from smooth to wild; some multiply errors by 1e4, some begin with steps that turn out too long."""
    joints, span = {
        "swinging": ([pin.JointModelRY() for _ in range(5)], 1.5),
        "double": ([pin.JointModelRY() for _ in range(2)], 5.0),
        "spherical": (JOINTS["spherical"], 1.5),
        "free": ([pin.JointModelFreeFlyer(), *(pin.JointModelRX() for _ in range(4))], 1.0),
    }[kinds]
    scene, rng = chain(joints, seed)
    v0 = rng.uniform(-2.0, 2.0, scene.nv)
    close = cvi.simulate(scene, None, v0, span, dt=0.0025, order=16, solver_tol=1e-15)
    options = {} if sample is None else {"sample_dt": sample}
    traj = cvi.simulate(scene, None, v0, span, dt="auto", tol=tol, **options)
    assert error(traj, close) / 3.0 <= traj.error_estimate <= tol


def test_an_error_far_below_what_was_asked_is_a_hundredth_of_that():
    """A parabola is exact; smaller errors are not told apart."""
    assert cvi.simulate(ball_scene(), duration=1.0, tol=1e-6).error_estimate == pytest.approx(1e-8)


def test_what_cannot_be_met_is_said():
    """Chaotic motion multiplies rounding: after a minute no step is short enough for 1e-9."""
    scene = swinging()
    scene.q0 = np.array([2.5, 1.0])
    with pytest.warns(cvi.AccuracyWarning, match="was not reached: tol = 1e-09"):
        traj = cvi.simulate(scene, duration=60.0, tol=1e-9)
    assert traj.status.ok
    assert traj.error_estimate > 1e-9


def test_a_limit_of_speed_is_told_as_the_reason():
    """One damped hinge that a servo drives at its largest speed: nothing is chaotic, the limit is held step by step."""
    scene = cvi.Scene()
    scene.add_urdf("models/damped_pendulum.urdf")
    scene.set_servo("hinge", kp=50.0, kd=5.0, target=0.5)
    scene.set_actuator("hinge", velocity=1.0)
    with pytest.warns(cvi.AccuracyWarning, match=r"traj\.stats\.held_branches.* order 1") as told:
        traj = cvi.simulate(scene, duration=0.3, tol=1e-5)
    assert traj.stats.held_branches > 0
    assert "Chaotic" not in str(told[0].message)


def test_nothing_is_said_where_it_is_met():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cvi.simulate(wall(), duration=1.0)


# -- with other options -----------------------------------------------------------------------------------------------


def test_runs_that_end_early():
    with pytest.raises(cvi.SimulationError, match="'ball' and 'ground' accumulate") as caught:
        cvi.simulate(ball_scene(restitution=0.5), duration=3.0, zeno="end")
    traj = caught.value.trajectory
    assert traj.status.code == cvi.StatusCode.ZENO
    assert traj.t[-1] == traj.status.time
    low = ball_scene()
    q0 = low.configuration({"ball": (0.0, 0.0, 0.05)})
    with pytest.raises(cvi.PenetrationError):
        cvi.simulate(low, q0, duration=1.0)
    refused = cvi.simulate(low, q0, duration=1.0, throw=False)
    assert refused.status.code == cvi.StatusCode.PENETRATION
    assert len(refused) == 1


def test_tolerances_of_the_ledger():
    bounds = {"own_jump": 1e-8, "complementarity": 1e-12}
    assert cvi.simulate(wall(), duration=3.0, ledger=bounds).status.ok
    free = cvi.simulate(wall(), duration=3.0)
    traj = cvi.simulate(wall(), duration=3.0, ledger={"linear_momentum_jump": 1.0}, throw=False)
    assert traj.status.code == cvi.StatusCode.LEDGER
    assert traj.status.time == free.events[0].time
    assert len(traj.events) == 1
    assert traj.t[-1] >= traj.status.time


def test_samples():
    traj = cvi.simulate(wall(), duration=3.0, sample_dt=0.01)
    free = cvi.simulate(wall(), duration=3.0)
    assert traj.t == pytest.approx(0.01 * np.arange(301), abs=1e-12)
    assert traj.q == pytest.approx(free.at(traj.t).q, abs=1e-13)
    np.testing.assert_array_equal(traj.adaptive_steps["dt"], free.adaptive_steps["dt"])


def test_without_polynomials():
    traj = cvi.simulate(wall(), duration=1.0, dense=False)
    assert traj.segments is None
    assert traj.error_estimate <= 1e-6


def test_progress_and_interruption():
    seen = []

    def stop(t, impacts):
        seen.append(t)
        raise KeyboardInterrupt

    traj = cvi.simulate(swinging(), duration=1e5, progress=stop, throw=False)
    assert traj.status.code == cvi.StatusCode.INTERRUPTED
    assert np.isnan(traj.error_estimate)

    def broken(t, impacts):
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        cvi.simulate(swinging(), duration=1e5, progress=broken)


def falling_ball(restitution: float, height: float) -> tuple[cvi.Scene, np.ndarray]:
    """A ball of 0.1 m whose lowest point is so high above the ground, and its start."""
    scene = cvi.Scene()
    scene.add_sphere("ball", radius=0.1, mass=1.0)
    scene.add_halfspace(name="ground")
    scene.set_contact(restitution=restitution)
    return scene, np.array([0.0, 0.0, 0.1 + height, 0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize("impact", ["ctec", "mhc"])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_a_start_at_rest_on_the_ground_is_said(restitution, impact):
    scene, q0 = falling_ball(restitution, 0.0)
    traj = cvi.simulate(scene, q0, duration=1.0, impact=impact, throw=False, zeno="end")
    assert traj.status.code == cvi.StatusCode.ZENO
    assert traj.status.time == 0.0
    assert math.isnan(traj.error_estimate)


@pytest.mark.parametrize("height", [0.05, 0.1, 0.3, 1.0])
@pytest.mark.parametrize("order", [4, 8, 16])
def test_a_plastic_impact_is_one_impact(order, height):
    """What rounding leaves of gap and speed is no second fall."""
    scene, q0 = falling_ball(0.0, height)
    for dt in ("auto", 0.5):
        traj = cvi.simulate(scene, q0, duration=1.0, dt=dt, order=order, throw=False, zeno="end")
        assert (traj.status.code, len(traj.events)) == (cvi.StatusCode.ZENO, 1), dt
        assert traj.events[0].time == pytest.approx(math.sqrt(2.0 * height / 9.81), abs=1e-12)


def test_what_no_step_can_reach_ends_soon():
    """Below rounding shorter steps help nothing."""
    with pytest.warns(cvi.AccuracyWarning):
        traj = cvi.simulate(wall(), duration=1.0, dt="auto", order=4, tol=1e-15)
    assert traj.stats.steps < 20_000


def test_the_end_of_a_run_is_its_last_node():
    """Impacts that accumulate end a run after an impact: `at` gives the state after it there too."""
    scene, q0 = falling_ball(0.5, 0.5)
    traj = cvi.simulate(scene, q0, duration=3.0, throw=False, zeno="end")
    assert traj.status.code == cvi.StatusCode.ZENO
    assert traj.error_estimate <= traj.options.tol
    assert traj.at(traj.t[-1]).v == pytest.approx(traj.v[-1], abs=1e-15)


def test_a_global_reference_with_damping_is_refused():
    scene = wall()
    scene.set_joint("joint_1", damping=0.1)
    with pytest.raises(cvi.InputError, match="conservative"):
        cvi.simulate(scene, duration=1.0, dt="auto", impact="mhc", mhc_reference="global")


@pytest.mark.slow
def test_progress_comes_with_many_impacts_too():
    """A ball that bounces for four hours: few steps between impacts, and long enough for reports."""
    scene, q0 = falling_ball(1.0, 0.5)
    calls: list[tuple[float, int]] = []
    traj = cvi.simulate(scene, q0, duration=15_000.0, dt="auto", progress=lambda t, n: calls.append((t, n)))
    assert traj.status.ok
    assert len(traj.events) > 10_000
    assert calls


def test_the_same_again():
    one, two = (cvi.simulate(wall(), duration=3.0) for _ in range(2))
    np.testing.assert_array_equal(one.q, two.q)
    assert one.error_estimate == two.error_estimate


# -- files and words --------------------------------------------------------------------------------------------------


def test_round_trip(tmp_path):
    traj = cvi.simulate(wall(), duration=3.0)
    loaded = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    assert loaded.options == traj.options
    assert loaded.error_estimate == traj.error_estimate
    for name in ("t", "dt"):
        np.testing.assert_array_equal(loaded.adaptive_steps[name], traj.adaptive_steps[name])
    assert loaded.stepping == traj.stepping
    assert "order 16, dt = " in traj.stepping
    assert "(auto), error of q about " in traj.stepping


def test_command(command, tmp_path):
    scene = ball_file(tmp_path)
    result = command("run", scene, "-o", "out", "--dt", "auto", "--tol", 1e-8)
    assert result.exit_code == 0
    assert "order 16, dt = " in result.stdout
    assert "error of q about" in result.stdout
    traj = cvi.Trajectory.load("out/trajectory.npz")
    assert (traj.options.dt, traj.options.tol) == ("auto", 1e-8)
    assert "(auto)" in Path("out/playback.html").read_text()
    result = command("run", scene, "-o", "out", "--order", 6, "--sample-dt", 0.005, "--no-html", "--no-plot")
    assert result.exit_code == 0
    assert "order 6, dt = 0.01 s" in result.stdout
    assert len(cvi.Trajectory.load("out/trajectory.npz")) == 201
    result = command("run", scene, "--dt", "fast")
    assert result.exit_code == 2
    assert "'fast'" in result.stderr


def test_command_says_what_cannot_be_met(command, tmp_path):
    """Less than rounding was asked for."""
    result = command("run", ball_file(tmp_path), "-o", "out", "--dt", "auto", "--tol", 1e-17, "--no-html", "--no-plot")
    assert result.exit_code == 0
    assert "accuracy asked for was not reached" in result.stderr


def test_scene_file(tmp_path):
    path = ball_file(tmp_path)
    path.write_text(path.read_text().replace("dt = 0.01", 'dt = "auto"\norder = 8\ntol = 1e-7\nsample_dt = 0.1'))
    traj = cvi.simulate(cvi.load_scene(path))
    assert (traj.options.dt, traj.options.order, traj.options.tol, len(traj)) == ("auto", 8, 1e-7, 11)


# -- with persistent contact ------------------------------------------------------------------------------------------


def tipping(duration: float = 0.08) -> tuple[cvi.Scene, np.ndarray, float]:
    """A box that turns about its lower edge, which friction holds; its start velocity and a duration."""
    scene = cvi.Scene()
    scene.add_halfspace()
    half = np.array([0.1, 0.08, 0.15])
    turned = pin.rpy.rpyToMatrix(0.0, 0.5, 0.0)
    corners = turned @ np.array([[x, 0.0, z] for x in (-half[0], half[0]) for z in (-half[2], half[2])]).T
    scene.add_box("box", tuple(2.0 * half), placement=pin.SE3(turned, np.array([0.0, 0.0, -corners[2].min()])))
    scene.set_contact(restitution=0.0, friction=0.8)
    v = np.zeros(6)
    v[4] = 1.5
    v[:3] = -np.cross(v[3:], [half[0], 0.0, -half[2]])
    return scene, v, duration


def tipping_error(traj: cvi.Trajectory) -> float:
    """Largest error of q over the nodes. The box is a pendulum about its edge: its angle by DOP853."""
    half, start = np.array([0.1, 0.0, 0.15]), np.asarray(traj.q[0])
    arm = np.array([-half[0], 0.0, half[2]])  # from the edge to the centre, in the box
    turned = [pin.Quaternion(start[3:]).matrix(), None]
    edge = start[:3] - turned[0] @ arm

    def rate(_: float, y: np.ndarray) -> list[float]:
        lever = half[0] * math.cos(y[0]) - half[2] * math.sin(y[0])
        return [y[1], -0.75 * 9.81 * lever / float(half @ half)]

    span = (0.0, float(traj.t[-1]))
    angles = solve_ivp(rate, span, [0.5, 1.5], "DOP853", t_eval=traj.t, rtol=3e-14, atol=1e-15).y[0]
    rotations = [pin.rpy.rpyToMatrix(0.0, angle, 0.0) for angle in angles]
    exact = np.array([np.append(edge + turn @ arm, pin.Quaternion(turn).coeffs()) for turn in rotations])
    return float(States(traj.scene.model).distance(traj.q, exact).max())


@pytest.mark.parametrize("order", [4, 16])
@pytest.mark.parametrize("tol", [1e-4, 1e-6, 1e-9, 1e-11])
def test_persistent_contact_meets_the_accuracy_asked_for(tol, order):
    """Smooth steps of the order hold the contacts: a digit more costs little, and nothing is to be said."""
    scene, v, duration = tipping()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        traj = cvi.simulate(scene, None, v, duration, dt="auto", tol=tol, order=order)
    assert traj.phases["kind"].tolist() == ["persistent"]
    assert traj.stats.contact_steps == 0
    found = tipping_error(traj)
    assert found / 3.0 - 1e-12 <= traj.error_estimate <= tol
    assert found <= tol
    assert traj.stats.steps <= {4: tol**-0.25, 16: 4}[order]


def test_shorter_contact_steps_do_not_change_smooth_steps():
    """dt_contact is for contact steps, of which there are none here."""
    scene, v, duration = tipping()
    runs = [cvi.simulate(scene, None, v, duration, dt="auto", tol=1e-9, dt_contact=dt) for dt in (None, 2e-4, 1e-6)]
    for traj in runs[1:]:
        np.testing.assert_array_equal(traj.q, runs[0].q)
    close = cvi.simulate(scene, None, v, duration, dt=1e-3, dt_contact=1e-5, contact_mode="events", solver_tol=1e-14)
    assert tipping_error(close) < 1e-6  # order 2


def run_of_contact_steps(step: float) -> AutoRun:
    """A second of contact steps of this length, two contact iterations each."""
    run = SimpleNamespace(contact_time=1.0, contact_iterations=round(2.0 / step), code=0, dense_steps=0, segments=1)
    return AutoRun(1e-4, step, 1e-12, cast(Any, run), False, cast(Any, None))


@pytest.mark.parametrize(("dt_contact", "part"), [(None, 1.0), (1e-4, 1.0), (1e-5, math.sqrt(3e-6))])
def test_contact_steps_stop_at_the_budget(dt_contact, part):
    """Contact steps, where a run falls back to them: shorter ones within the budget, or what they would cost.

    The budget is six times the iterations of steps of 1 ms, or of the dt_contact asked for.
    """
    search = ContactSearch(cvi.Options(dt="auto", tol=1e-11, dt_contact=dt_contact))
    search.spent = 2000
    judged = Judged(1e-6, 1e-6, np.zeros(24), 0.1, lawful=True, confirmed=True)
    found, reason = search.next_part(run_of_contact_steps(1e-3), judged)
    assert found == pytest.approx(part)
    iterations = 2.0 / (min(1e-3, dt_contact or 1.0)), 2000.0 / math.sqrt(3e-6)
    if part < 1.0:
        assert reason == ""
        assert search.spent + iterations[1] <= BUDGET * iterations[0]
    else:
        assert search.spent + iterations[1] > BUDGET * iterations[0]
        assert "contact steps of 2e-06 s would reach it" in reason
        assert f"at {iterations[1] / iterations[0]:.0f} times the cost of steps of {dt_contact or 1e-3:.1g} s" in reason
        assert "ask for them by dt_contact" in reason


def rubbing() -> cvi.Scene:
    """A double pendulum with joint friction, which the map MHC leaves to contact steps."""
    scene = swinging()
    scene.set_joint("j*", friction=0.3)
    return scene


def test_contact_steps_within_the_budget():
    """A tol that would take far more steps: the best run within the budget, an honest estimate, and what to do."""
    plain = cvi.simulate(rubbing(), duration=1.0, dt=1e-3, order=16, impact="mhc")
    exact = cvi.simulate(rubbing(), duration=1.0, dt="auto", tol=1e-11)
    assert exact.stats.contact_steps == 0
    with pytest.warns(cvi.AccuracyWarning, match=r"contact steps of .* s would reach it.*ask for them by dt_contact"):
        traj = cvi.simulate(rubbing(), duration=1.0, dt="auto", tol=1e-11, impact="mhc")
    assert 0 < traj.stats.contact_iterations <= BUDGET * plain.stats.contact_iterations
    found = error(traj, exact)
    assert found / 3.0 <= traj.error_estimate <= 30.0 * found


def test_shorter_contact_steps_where_they_are_asked_for():
    with pytest.warns(cvi.AccuracyWarning):
        coarse = cvi.simulate(rubbing(), duration=1.0, dt="auto", tol=1e-9, impact="mhc")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cvi.AccuracyWarning)
        fine = cvi.simulate(rubbing(), duration=1.0, dt="auto", tol=1e-9, impact="mhc", dt_contact=1e-4)
    assert fine.error_estimate <= 0.1 * coarse.error_estimate
    exact = cvi.simulate(rubbing(), duration=1.0, dt="auto", tol=1e-11)
    assert error(fine, exact) / 3.0 <= fine.error_estimate


def test_events_do_not_shorten_the_steps_after_them():
    """Twenty impacts in a second: a flight takes steps as long as before, not a part of them after each."""
    scene, q0 = falling_ball(0.9, 0.01)
    traj = cvi.simulate(scene, q0, duration=1.0, dt="auto", zeno="hold")
    assert len(traj.events) >= 10
    assert traj.stats.steps - traj.stats.contact_steps <= 3 * len(traj.events)
