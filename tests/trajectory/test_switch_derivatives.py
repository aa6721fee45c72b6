"""Derivatives of runs through actuators at their limits and ropes that go slack, against differences of runs."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi
from helpers.switching_scenes import at_speed, ball_on_ropes, pendulum
from oracles.switching import Rope

# Central differences with 1e-5 of runs of order 8: their third derivatives, some 1e2, times 1e-10, and rounding.
CLOSE = 1e-7
DELTA = 1e-5


def ends(traj: cvi.Trajectory) -> np.ndarray:
    return np.concatenate([traj.q[-1], traj.v[-1]])


@pytest.mark.parametrize("most", [12.0, 4.0])
def test_a_servo_at_its_limits(most, tmp_path):
    scene, duration, dt, order = pendulum(tmp_path), 1.5, 0.02, 8
    scene.set_servo("j", kp=60.0, kd=3.0, effort=most)
    steps = round(duration / dt)

    def run(q=-1.0, v=0.5, u=0.0, target=2.0, **options):
        return cvi.simulate(
            scene, [q], [v], duration, dt=dt, order=order, target=[target], control=np.full((steps, 1), u), **options
        )

    traj = run(record="gradient")
    assert traj.stats.switches >= 2
    found = traj.sensitivity(["q0", "v0", "control"]).matrix[-1]
    for column, name in enumerate(("q", "v", "u")):
        value = {"q": -1.0, "v": 0.5, "u": 0.0}[name]
        change = ends(run(**{name: value + DELTA})) - ends(run(**{name: value - DELTA}))
        assert np.abs(found[:, column] - change / (2 * DELTA)).max() <= CLOSE * (1.0 + np.abs(found).max())
    weight = np.zeros((len(traj.t), 1))
    weight[-1] = 1.0
    gradient = cvi.gradient(traj, (weight, np.zeros_like(weight)), ["q0", "v0", "control", "target"])[1]
    assert np.allclose(gradient["q0"], found[0, :1], rtol=0, atol=1e-10)
    assert abs(gradient["control"].sum() - found[0, 2]) <= 1e-10
    change = run(target=2.0 + DELTA).q[-1, 0] - run(target=2.0 - DELTA).q[-1, 0]
    assert abs(gradient["target"][:, 0].sum() - change / (2 * DELTA)) <= CLOSE


def test_what_exceeds_an_effort_limit_has_no_influence(tmp_path):
    """An input without a servo that is beyond its limit in half of the steps."""
    scene, steps, dt = pendulum(tmp_path, effort=2.0), 40, 0.02
    scene.set_actuator("j", effort=True)
    control = np.where(np.arange(steps) % 2 == 0, 3.0, 1.0)[:, None]

    def end(change):
        return ends(cvi.simulate(scene, [0.3], [0.0], steps * dt, dt=dt, order=8, control=control + change))

    traj = cvi.simulate(
        scene, [0.3], [0.0], steps * dt, dt=dt, order=8, control=control, record="gradient"
    )  # fmt: skip
    found = traj.sensitivity(["control"]).matrix[-1][:, 0]
    assert np.abs(found - (end(DELTA) - end(-DELTA)) / (2 * DELTA)).max() <= CLOSE
    weight = np.zeros((len(traj.t), 1))
    weight[-1] = 1.0
    gradient = cvi.gradient(traj, (weight, np.zeros_like(weight)), ["control"])[1]["control"]
    assert np.all(gradient[::2] == 0.0)
    assert np.all(gradient[1::2] != 0.0)


@pytest.mark.parametrize("damping", [0.0, 3.0])
def test_ropes(damping):
    """Where a damper sets in at once there is no derivative, and it is refused."""
    x, v = np.array([0.1, 0.0, -0.5]), np.array([0.3, 0.2, 0.0])
    scene = ball_on_ropes(x, [Rope(np.zeros(3), 200.0, 0.7, damping=damping)])

    def run(change=0.0, **options):
        return cvi.simulate(scene, None, at_speed(scene, v + change), 1.0, dt=0.02, order=8, **options)

    traj = run(record="gradient")
    assert traj.stats.switches >= 2
    if damping > 0.0:
        with pytest.raises(cvi.NotDifferentiable, match="rope with a damper") as caught:
            traj.sensitivity("v0")
        assert caught.value.reason == "saturation"
        return
    found = traj.sensitivity("v0").matrix[-1]
    for k in range(3):
        change = DELTA * np.eye(3)[k]
        difference = (run(change).q[-1] - run(-change).q[-1])[:3] / (2 * DELTA)
        assert np.abs(found[:3, k] - difference).max() <= CLOSE


def test_a_limit_of_speed_is_refused(tmp_path):
    scene = pendulum(tmp_path, speed=1.0)
    scene.set_actuator("j", velocity=True)
    traj = cvi.simulate(scene, [0.0], [0.0], 0.5, dt=1e-2, control=np.full((50, 1), 30.0), record="gradient")
    with pytest.raises(cvi.NotDifferentiable, match="at limits of speed"):
        traj.sensitivity()
