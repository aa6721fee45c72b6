"""Accumulating impacts: bouncing balls with closed forms, options, and that no run hangs."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers import persistent_runs
from helpers.persistent_runs import GRAVITY, changes, check_contacts, check_sums, same
from oracles import closed_forms


@pytest.mark.parametrize("impact", ["ctec", "mhc"])
@pytest.mark.parametrize(("restitution", "end"), [(0.9, 8.5789491787), (0.5, 1.354571), (0.3, None)])
@pytest.mark.parametrize("h", [0.02, 0.01, 1e-3])
def test_bouncing_ball_comes_to_rest(restitution, end, h, impact):
    """A ball dropped from 1 m: the extrapolated end of the bouncing is exact at any step, then the ball rests."""
    exact = closed_forms.BouncingBall(1.0, restitution)
    if end is not None:
        assert exact.zeno_time() == pytest.approx(end, abs=1e-6)
    duration = 10.0 if restitution == 0.9 else 3.0
    traj = cvi.simulate(*persistent_runs.ball(gap=1.0, restitution=restitution), duration, h, impact=impact)
    assert traj.status.ok
    (ended,) = changes(traj, "bouncing ended")
    # every located impact has an error of 1e-12 m over its speed; times add up over the impacts, a series 1 / (1 - e)
    assert ended.value == pytest.approx(exact.zeno_time(), abs=1e-9)
    after = traj.t > max(exact.zeno_time(), ended.time)
    assert np.abs(traj.q[after, 2] - 0.1).max() <= 1e-12
    assert np.abs(traj.v[after]).max() <= 1e-12
    times = traj.events.array("time")
    n = len(times) - 1  # the last one is the plastic one
    assert np.abs(times[:n] - exact.impact_times(n)).max() <= 1e-11 * n
    # e dt_n < .05 h: what was left of the bouncing when it was cut is less than .05 h / (1 - e)
    assert exact.zeno_time() - ended.time <= 0.05 * h / (1.0 - restitution) + 1e-9
    check_contacts(traj)
    check_sums(traj, [1.0], ["ball"])


def test_rest_begins_within_a_millisecond():
    """The bar of the case, with the default step of order 2."""
    traj = cvi.simulate(*persistent_runs.ball(gap=1.0, restitution=0.9), 10.0, 1e-3)
    (begun,) = changes(traj, "begin")
    assert begun.time == pytest.approx(8.5789491787, abs=1e-3)


def test_automatic_steps_come_to_rest():
    traj = cvi.simulate(*persistent_runs.ball(gap=1.0, restitution=0.9), 10.0, "auto")
    (begun,) = changes(traj, "begin")
    (ended,) = changes(traj, "bouncing ended")
    assert ended.value == pytest.approx(8.5789491787, abs=1e-8)
    assert begun.time == pytest.approx(8.5789491787, abs=1e-3)
    assert traj.q[-1, 2] == pytest.approx(0.1, abs=1e-12)


@pytest.mark.parametrize("h", [0.02, 0.01, 0.005])
def test_rolling_ball_of_the_case(h):
    """Closed forms: impact at .4283529369 s with 4.2021423108 m/s, end of bouncing at 1.2850588106 s, rest at y = R."""
    traj = cvi.simulate(*persistent_runs.ball(mu=0.2, gap=0.9, restitution=0.5), 2.0, h)
    first = traj.events[0]
    assert first.time == pytest.approx(0.4283529369, abs=6e-11)
    assert first.gamma_minus == pytest.approx(-4.2021423108, abs=6e-11)
    (ended,) = changes(traj, "bouncing ended")
    assert ended.value == pytest.approx(1.2850588106, abs=1e-9)
    assert traj.q[-1, :3] == pytest.approx([0.0, 0.0, 0.1], abs=1e-12)
    assert np.abs(traj.v[-1]).max() <= 1e-12


def test_bouncing_while_it_moves_on():
    """A ball thrown along the floor without friction keeps its speed through the bouncing and after it."""
    scene, q, v = persistent_runs.ball(gap=0.2, restitution=0.5)
    v[0] = 1.3
    traj = cvi.simulate(scene, q, v, 2.0, 0.01)
    assert np.abs(traj.q[:, 0] - 1.3 * traj.t).max() <= 1e-12
    assert traj.q[-1, 2] == pytest.approx(0.1, abs=1e-12)


def test_ball_rests_after_a_minute():
    traj = cvi.simulate(*persistent_runs.ball(gap=0.1, restitution=0.5), 60.0, 0.01)
    assert np.abs(traj.q[-1, :3] - [0.0, 0.0, 0.1]).max() <= 1e-14
    assert np.abs(traj.v[-1]).max() <= 1e-14
    assert len(changes(traj, "begin")) == 1


@pytest.mark.parametrize("h", [0.1, 0.03])
def test_many_bounces_within_one_step(h):
    """The whole bouncing is shorter than a step."""
    exact = closed_forms.BouncingBall(1e-4, 0.8)
    assert exact.zeno_time() < 0.5 * h + 0.05
    traj = cvi.simulate(*persistent_runs.ball(gap=1e-4, restitution=0.8), 3.0, h)
    assert traj.status.ok
    assert traj.q[-1, 2] == pytest.approx(0.1, abs=1e-12)
    assert len(traj.events) <= 40


def test_zeno_ends_the_run_where_asked():
    traj = cvi.simulate(*persistent_runs.ball(gap=1.0, restitution=0.5), 3.0, 0.01, zeno="end", throw=False)
    assert traj.status.code == cvi.StatusCode.ZENO
    stated = float(traj.status.message.split("t =")[1].split("s")[0])
    assert stated == pytest.approx(1.354571, abs=1e-6)


def test_dtec_says_why_it_does_not():
    scene, q, v = persistent_runs.ball(gap=1.0, restitution=0.0)
    with pytest.raises(cvi.ContactviError, match=r"(?i)dtec"):
        cvi.simulate(scene, q, v, 1.0, 0.01, impact="dtec")
    scene.set_contact(restitution=0.5)
    traj = cvi.simulate(scene, q, v, 3.0, 0.01, impact="dtec", throw=False)
    assert traj.status.code == cvi.StatusCode.ZENO


def test_two_balls_bounce_out_of_step():
    """Each pair has its own bouncing and its own end."""
    scene = cvi.Scene(gravity=(0.0, 0.0, -GRAVITY))
    scene.add_halfspace(name="ground")
    q = []
    for k, gap in enumerate((1.0, 0.37)):
        scene.add_sphere(f"ball{k}", radius=0.1)
        q.append(persistent_runs.pose([k, 0.0, 0.1 + gap]))
    scene.set_contact(restitution=0.6)
    traj = cvi.simulate(scene, np.concatenate(q), np.zeros(12), 4.0, 0.01)
    for k, gap in enumerate((1.0, 0.37)):
        (ended,) = changes(traj, "bouncing ended", f"ball{k}")
        assert ended.value == pytest.approx(closed_forms.BouncingBall(gap, 0.6).zeno_time(), abs=1e-9)
    assert traj.q[-1, [2, 9]] == pytest.approx([0.1, 0.1], abs=1e-12)
    check_contacts(traj)
    check_sums(traj, [1.0, 1.0], ["ball0", "ball1"])
    same(traj, cvi.simulate(scene, np.concatenate(q), np.zeros(12), 4.0, 0.01))


@pytest.mark.parametrize("seed", range(3))
def test_capsule_clatters_to_rest(seed):
    """Impacts of two ends in turn, e = .5 with friction: many bounces, then rest."""
    rng = np.random.default_rng([31, seed])
    scene = cvi.Scene(gravity=(0.0, 0.0, -GRAVITY))
    scene.add_halfspace(name="ground")
    scene.add_capsule("capsule", radius=0.05, length=0.3)
    scene.set_contact(restitution=0.5, friction=0.5)
    turn = pin.exp3(np.array([0.0, 0.5 * np.pi + rng.uniform(-0.5, 0.5), 0.0]))
    traj = cvi.simulate(scene, persistent_runs.pose([0.0, 0.0, 0.5], turn), np.zeros(6), 4.0, 0.01)
    assert traj.status.ok
    check_contacts(traj, 0.5)
    check_sums(traj, [1.0], ["capsule"])
    assert traj.q[-1, 2] == pytest.approx(0.05, abs=1e-9)
    # it may go on rolling, never jumping
    assert abs((pin.Quaternion(traj.q[-1, 3:7]).matrix() @ traj.v[-1, :3])[2]) <= 1e-9


def thrown_box(seed: int | None) -> tuple[cvi.Scene, np.ndarray]:
    """Return a box above a plane and its velocity: at random or, for None, one whose corners chatter by turns."""
    rng = np.random.default_rng(seed)
    turn = (0.2, 0.3, 0.1) if seed is None else tuple(rng.uniform(-0.4, 0.4, 3))
    scene = cvi.Scene()
    scene.add_halfspace()
    box = scene.add_box("box", size=(0.3, 0.2, 0.1), mass=1.0, placement=((0, 0, 0.3), turn))
    scene.set_contact(restitution=0.4, friction=0.3)
    motion = ((2.0, 0.5, 0), (1.0, 3.0, 5.0)) if seed is None else tuple(2.0 * rng.normal(size=(2, 3)))
    return scene, scene.velocity({box: motion})


@pytest.mark.parametrize("seed", [None, *range(8)])
def test_no_impact_is_made_plastic_that_is_faster_than_the_one_before(seed):
    # Corners of a box that comes down chatter by turns: short flights of one say nothing about the others.
    scene, v = thrown_box(seed)
    run = cvi.simulate(scene, v0=v, duration=0.6, dt=1e-3, order=8)
    speeds = np.maximum(0.0, -run.events.array("gamma_minus"))
    times = run.events.array("time")
    ends = [change.time for change in run.contact_changes if change.change == "bouncing ended"]
    assert ends or seed is not None
    for time in ends:
        at = int(np.flatnonzero(times == time)[0])
        assert speeds[at] <= speeds[at - 1] * (1.0 + 1e-9)  # rounding of the map of a single impact


def test_a_slam_among_short_flights_keeps_the_accuracy():
    scene, v = thrown_box(None)
    run = cvi.simulate(scene, v0=v, duration=0.503, tol=1e-6)
    exact = cvi.simulate(scene, v0=v, duration=0.503, dt=0.503 / 8000, order=8)
    assert run.error_estimate <= 1e-6
    assert np.linalg.norm(pin.difference(scene.model, run.q[-1], exact.q[-1])) <= 1e-6
