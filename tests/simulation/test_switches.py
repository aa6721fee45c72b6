"""Ropes and actuators whose law has a kink: where it lies a step ends, and the order holds through it."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import contactvi as cvi
from helpers.switching_scenes import INERTIA, LINK, MASS, RADIUS, at_speed, ball_on_ropes, pendulum
from oracles.switching import BallOnRopes, Rope, Servo, servo_pendulum

# Steps for each order: as many as show its errors above those of the oracle, some 1e-13 for each of its pieces.
STEPS = {2: (1500, 3000, 6000), 4: (400, 800, 1600), 8: (60, 120, 240), 16: (16, 20, 40)}
ORACLE = 2e-11

HERE = np.zeros(3)
ROPES = {
    "one": ([Rope(HERE, 200.0, 0.7)], (0.1, 0.0, -0.5), (0.3, 0.2, 0.0)),
    "two": (
        [Rope(np.array([-0.5, 0.0, 0.0]), 150.0, 0.8), Rope(np.array([0.5, 0.1, 0.0]), 300.0, 0.75)],
        (0.0, 0.0, -0.4), (0.4, 0.1, 0.0),
    ),
    "damped": ([Rope(HERE, 200.0, 0.7, damping=3.0)], (0.1, 0.0, -0.5), (0.3, 0.2, 0.0)),
}  # fmt: skip


def check_order(run, exact: float | np.ndarray, order: int, steps: tuple[int, ...]) -> None:
    """Errors of runs with these numbers of steps fall with the order, down to those of the oracle.

    Where in their steps the kinks lie changes with their number, and the error with it: that may take .3 of the order.
    """
    errors = [float(np.abs(run(n) - exact).max()) for n in steps]
    assert errors[-1] <= {2: 2e-5, 4: 2e-8}.get(order, ORACLE)
    for n, error in zip(steps[1:], errors[1:], strict=True):
        assert error <= max(ORACLE, errors[0] * (steps[0] / n) ** (order - 0.3))


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", ROPES)
@pytest.mark.parametrize("order", STEPS)
def test_the_order_holds_where_ropes_go_slack_and_taut(name, order):
    ropes, x, v = ROPES[name]
    duration = 3.0
    oracle = BallOnRopes(MASS, ropes)
    exact = oracle.motion(np.array(x), np.array(v), np.array([duration]))[0, :3]
    assert len(oracle.switches) >= 3
    scene = ball_on_ropes(np.array(x), ropes)

    def run(steps):
        traj = cvi.simulate(scene, None, at_speed(scene, v), duration, dt=duration / steps, order=order)
        assert traj.stats.switches == len(oracle.switches)
        assert traj.stats.held_branches == 0
        return traj.q[-1, :3]

    check_order(run, exact, order, STEPS[order])


@pytest.mark.parametrize("order", STEPS)
def test_the_order_holds_with_impacts_between_switches(order):
    """The ball falls from its rope on the ground and back into the rope."""
    ropes = [Rope(np.array([0.0, 0.0, 0.9]), 40.0, 0.5, damping=0.5)]
    oracle = BallOnRopes(MASS, ropes, radius=RADIUS, restitution=0.9)
    x, v, duration = np.array([0.05, 0.0, 0.5]), np.array([0.2, -0.1, -2.0]), 2.0
    exact = oracle.motion(x, v, np.array([duration]))[0, :3]
    scene = ball_on_ropes(x, ropes, restitution=0.9)

    def run(steps):
        traj = cvi.simulate(scene, None, at_speed(scene, v), duration, dt=duration / steps, order=order)
        assert len(traj.events) >= 2
        assert traj.stats.switches >= 4
        return traj.q[-1, :3]

    check_order(run, exact, order, STEPS[order])


@pytest.mark.thinned(3)
@pytest.mark.parametrize(
    ("kp", "kd", "target", "most"), [(60.0, 3.0, 2.0, 12.0), (400.0, 5.0, -1.5, 15.0), (30.0, 0.0, 1.0, 8.0)]
)
@pytest.mark.parametrize("order", STEPS)
def test_the_order_holds_where_a_servo_comes_to_its_limits(kp, kd, target, most, order, tmp_path):
    scene, duration = pendulum(tmp_path), 2.0
    scene.set_servo("j", kp=kp, kd=kd, effort=most)
    exact, switches = servo_pendulum(
        INERTIA, 9.81 * LINK, Servo(kp, kd, target, most), -1.0, 0.5, np.array([duration])
    )  # fmt: skip
    assert switches >= 3

    def run(steps):
        traj = cvi.simulate(scene, [-1.0], [0.5], duration, dt=duration / steps, order=order, target=[target])
        assert traj.stats.switches == switches
        return traj.q[-1]

    check_order(run, exact[0, :1], order, {**STEPS, 2: (2000, 4000, 8000)}[order])


@pytest.mark.slow
def test_adaptive_steps_meet_their_tolerance_with_ropes():
    """The estimate is not below a third of the error, in any of sixty motions, and no run warns."""
    rng, switches = np.random.default_rng(7), 0
    for _ in range(60):
        x = np.array([*rng.uniform(-0.3, 0.3, 2), -rng.uniform(0.3, 0.6)])
        v, count = rng.uniform(-1, 1, 3), rng.integers(1, 3)
        ropes = []
        for _ in range(count):
            anchor = np.array([rng.uniform(-0.6, 0.6), rng.uniform(-0.4, 0.4), 0.0]) if count > 1 else HERE
            stiffness, rest = 10 ** rng.uniform(1.5, 3.0), rng.uniform(0.4, 0.9)
            ropes.append(Rope(anchor, stiffness, rest, damping=rng.choice([0.0, 0.0, 2.0, 8.0])))
        scene = ball_on_ropes(x, ropes)
        for tol in (1e-6, 1e-9):
            with warnings.catch_warnings():
                warnings.simplefilter("error", cvi.AccuracyWarning)
                traj = cvi.simulate(scene, None, at_speed(scene, v), 1.5, tol=tol)
            exact = BallOnRopes(MASS, ropes).motion(x, v, traj.t[1:])[:, :3]
            error = np.linalg.norm(traj.q[1:, :3] - exact, axis=1).max()
            switches += traj.stats.switches
            assert error <= tol
            assert traj.error_estimate >= error / 3.0
    assert switches > 200


def test_a_rope_of_the_field_meets_the_tolerance():
    """The estimate was 9e-7 and the error 1.7e-3 m, without a warning."""
    x = np.array([0.0, 0.0, -0.5])
    scene = cvi.Scene()
    scene.add_sphere("bob", RADIUS, MASS, placement=tuple(x))
    scene.add_spring("world", "bob", 200.0, rest_length=0.7, tension_only=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        traj = cvi.simulate(scene, duration=3.0)
    exact = BallOnRopes(MASS, [Rope(HERE, 200.0, 0.7)]).motion(x, np.zeros(3), traj.t[1:])
    assert np.abs(traj.q[1:, 2] - exact[:, 2]).max() <= traj.error_estimate <= 1e-6


@pytest.mark.parametrize(("dt", "order"), [(0.1, 8), (0.3, 16), (0.02, 4)])
def test_ropes_that_are_taut_for_less_than_a_step_are_found(dt, order):
    """A ball is thrown up into its rope, which is taut for some hundredths of a second."""
    x, v = np.array([0.0, 0.0, 0.2]), np.array([0.0, 0.0, 3.0])
    rope = Rope(HERE, 100.0, 0.2 + 9.0 / (2 * 9.81) - 1e-3)
    oracle = BallOnRopes(MASS, [rope])
    exact = oracle.motion(x, v, np.array([0.6]))[0, :3]
    assert np.diff(oracle.switches) < 0.03
    scene = ball_on_ropes(x, [rope])
    traj = cvi.simulate(scene, None, at_speed(scene, v), 0.6, dt=dt, order=order)
    assert traj.stats.switches == 2
    assert np.abs(traj.q[-1, :3] - exact).max() <= (1e-6 if order == 4 else ORACLE)


@pytest.mark.parametrize("over", [-1e-9, 0.0, 1e-9])
@pytest.mark.parametrize("order", [2, 8])
def test_a_rope_that_is_grazed_changes_nothing(over, order):
    """A ball is thrown up to the end of its rope, which it does not stretch, or by nothing that shows."""
    start, speed, stiffness = 0.2, 3.0, 100.0
    apex = start + speed**2 / (2 * 9.81)
    scene = ball_on_ropes(np.array([0.0, 0.0, start]), [Rope(HERE, stiffness, apex + over)])
    traj = cvi.simulate(scene, None, at_speed(scene, (0, 0, speed)), 0.6, dt=0.02, order=order)
    assert traj.status.ok
    assert traj.stats.held_branches == 0
    # A rope that is 1e-9 m too short acts for 3e-5 s.
    assert abs(traj.q[-1, 2] - (start + 0.6 * speed - 0.5 * 9.81 * 0.36)) <= 1e-11


@pytest.mark.parametrize("speed", [-1.0, 0.0, 1.0])
@pytest.mark.parametrize("order", [2, 8])
def test_a_start_exactly_at_the_kink(speed, order):
    x, v, rope = np.array([0.0, 0.0, -0.7]), np.array([0.0, 0.0, speed]), Rope(HERE, 200.0, 0.7)
    scene = ball_on_ropes(x, [rope])
    exact = BallOnRopes(MASS, [rope]).motion(x, v - [0, 0, 1e-300], np.array([0.5]))[0, :3]
    traj = cvi.simulate(scene, None, at_speed(scene, v), 0.5, dt=1e-3 if order == 2 else 0.02, order=order)
    assert np.abs(traj.q[-1, :3] - exact).max() <= (1e-5 if order == 2 else 1e-10)


def test_ropes_that_become_taut_at_one_instant():
    """A ball falls into four ropes of one length, which stay alike."""
    anchors = [np.array([a, b, 0.0]) for a in (-0.3, 0.3) for b in (-0.3, 0.3)]
    ropes, x = [Rope(a, 100.0, 0.8) for a in anchors], np.array([0.0, 0.0, -0.5])
    scene = ball_on_ropes(x, ropes)
    exact = BallOnRopes(MASS, [Rope(a, 100.0, 0.8) for a in anchors]).motion(x, np.zeros(3), np.array([1.0]))[0, :3]
    traj = cvi.simulate(scene, duration=1.0, dt=0.02, order=8)
    assert np.abs(traj.q[-1, :3] - exact).max() <= 1e-10
    assert traj.stats.switches % 4 == 0


def test_a_joint_at_its_largest_speed_does_not_chatter_for_ever(tmp_path):
    """What drives it ends at the limit and the brake of gravity sets in: the branch is held for the rest of a step."""
    scene = pendulum(tmp_path, effort=100.0, speed=2.0)
    scene.set_actuator("j", effort=True, velocity=True)
    traj = cvi.simulate(scene, [0.0], [0.0], 1.0, dt=1e-3, order=4, control=np.full((1000, 1), 30.0))
    assert traj.status.ok
    assert traj.v.max() <= 2.0 + 1e-9
    assert traj.stats.held_branches > 0
    assert traj.stats.switches <= 2 * traj.stats.steps


@pytest.mark.parametrize("order", [2, 8])
def test_runs_in_batches_and_restored_ones_have_the_same_digits(order):
    ropes, x, v = ROPES["two"]
    scene = ball_on_ropes(np.array(x), ropes)
    dt, steps = (2e-3, 500) if order == 2 else (0.05, 20)
    alone = cvi.simulate(scene, None, at_speed(scene, v), dt * steps, dt=dt, order=order)
    assert alone.stats.switches > 2
    starts = np.repeat(alone.v[:1], 3, axis=0)
    batch = cvi.simulate_batch(scene, None, starts, duration=dt * steps, dt=dt, order=order)
    for end in batch.q:
        assert np.array_equal(end[-1], alone.q[-1])
    simulator = cvi.Simulator(scene, dt=dt, order=order)
    simulator.reset(None, at_speed(scene, v))
    simulator.run(steps=steps // 2)
    kept = simulator.save()
    simulator.run(steps=steps - steps // 2)
    assert np.array_equal(simulator.q, alone.q[-1])
    simulator.load(kept)
    simulator.run(steps=steps - steps // 2)
    assert np.array_equal(simulator.q, alone.q[-1])


def test_ropes_that_change_at_the_same_instants_are_all_counted():
    """Two balls on ropes beside a ground have the motions that they have alone."""
    scene = cvi.Scene()
    scene.add_halfspace((0, 0, 1), -5.0)
    rope = Rope(HERE, 200.0, 0.7)
    for k in range(2):
        scene.add_sphere(f"b{k}", RADIUS, MASS, placement=(2.0 * k, 0.1, -0.5))
        scene.add_spring(
            "world", f"b{k}", rope.stiffness, rest_length=rope.rest, point_a=(2.0 * k, 0, 0), tension_only=True
        )
    traj = cvi.simulate(scene, duration=2.0, dt=0.02, order=8)
    oracle = BallOnRopes(MASS, [rope])
    exact = oracle.motion(np.array([0.0, 0.1, -0.5]), np.zeros(3), np.array([2.0]))[0, :3]
    assert np.abs(traj.q[-1, :3] - exact).max() <= ORACLE
    assert np.abs(traj.q[-1, 7:10] - exact - [2.0, 0, 0]).max() <= ORACLE
    assert traj.stats.switches == 2 * len(oracle.switches)
