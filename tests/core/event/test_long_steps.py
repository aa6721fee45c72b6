"""Events on the paths of long steps, at every order: found, the first one, located, and no other made up.

The laws are closed forms (parabolas, oscillators, straight lines) and the dense output of the run itself.
"""

from __future__ import annotations

import math

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.contact_models import GRAVITY, geometry, place, problem_b, room, room_start
from helpers.contact_models import scene as public_scene
from helpers.map_runs import run

ORDERS = (2, 4, 6, 8, 12, 16)
orders = pytest.mark.parametrize("order", ORDERS)
START = ([0.3, 0.2], [0.0, 0.0])  # of problem B


def ball(restitution: float = 1.0) -> cvi.Scene:
    """A ball of 0.1 m above the ground."""
    scene = cvi.Scene(gravity=(0.0, 0.0, -GRAVITY))
    scene.add_sphere("ball", radius=0.1, mass=0.5)
    scene.add_halfspace()
    scene.set_contact(restitution=restitution)
    return scene


def ball_state(height: float, speed: float = 0.0, spin: float = 0.0) -> tuple[list, list]:
    return [0.0, 0.0, 0.1 + height, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, speed, spin, -spin, spin]


@orders
@pytest.mark.parametrize("h", [0.05, 0.3, 2.0])
@pytest.mark.parametrize("spin", [0.0, 0.5])
def test_parabolas(order, h, spin):
    """Free flights are parabolas at every order: each impact at its time, several in one step, h = 2 s: all of them."""
    height, duration = 0.31, 6.0
    result = run(ball(), *ball_state(height, spin=spin), duration, h, "ctec", order=order)
    assert result.code == 0, result.message
    flight = 2.0 * math.sqrt(2.0 * height / GRAVITY)
    expected = flight * (0.5 + np.arange(round(duration / flight + 0.5)))
    assert result.log["time"] == pytest.approx(expected[expected <= duration], abs=1e-13 * len(expected))
    assert np.abs(result.log["gap"]).max() <= 1e-12


@orders
@pytest.mark.parametrize("speed", [1.0, 1e-2, 1.1e-3])
def test_flights_from_the_ground(order, speed):
    """It starts on the ground, upwards, one step is longer than 1, 100, 900 flights: it comes back after each."""
    flight, steps = 2.0 * speed / GRAVITY, 2
    result = run(ball(), *ball_state(0.0, speed), 0.4, 0.4 / steps, "ctec", order=order)
    assert result.code == 0, result.message
    count = int(0.4 / flight)
    assert len(result.events) in (count, count + 1)
    # every location is good to 1e-12 m, a time of 1e-12 / speed, and errors of the speed add up
    assert result.log["time"] == pytest.approx(flight * (1 + np.arange(len(result.events))), abs=1e-12 / speed * count)


@orders
def test_resting_on_the_ground_is_no_flight(order):
    """Touching, no speed, gravity: never separates, and the run reports it at its start."""
    result = run(ball(), *ball_state(0.0), 1.0, 0.5, "ctec", order=order, end_at_zeno=True)
    assert result.code == cvi.StatusCode.ZENO
    assert result.t[-1] == 0.0


@orders
@pytest.mark.parametrize("offset", [0.0, 0.9, 1 - 1e-6, 1 + 1e-6, 1.5])
@pytest.mark.parametrize("start", [5.0, 7.5, 10.3])
def test_balls_that_pass_somewhere_in_a_long_step(order, offset, start):
    """Two 5 mm balls closing at 40 m/s in one step of 0.3 s, 2400 diameters: the gap dips for some 1e-4 s, or not."""
    radius, model, shapes = 0.0025, pin.Model(), {}
    model.gravity = pin.Motion.Zero()
    for i in range(2):
        model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"body{i}")
        model.appendBodyToJoint(i + 1, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
        shapes[f"ball{i}"] = (i + 1, pin.SE3.Identity(), coal.Sphere(radius))
    q, v = pin.neutral(model), np.zeros(12)
    q[7:10], v[0], v[6] = (start, 2 * radius * offset, 0.0), 20.0, -20.0
    scene = public_scene(model, geometry(shapes, [("ball0", "ball1")]))
    result = run(scene, q, v, 0.3, 0.3, "ctec", order=order)
    assert result.code == 0, result.message
    assert len(result.events) == (1 if offset < 1.0 else 0)
    if offset < 1.0:
        chord = 2 * radius * math.sqrt(1.0 - offset**2)
        # a gap of 1e-12 m at the closing speed 40 chord / (2 radius)
        assert abs(result.events[0].time - (start - chord) / 40.0) <= 4e-12 * 2 * radius / (40.0 * chord)


@pytest.mark.parametrize(("order", "h"), [(4, 0.02), (8, 0.1), (12, 0.2), (16, 0.25)])
@pytest.mark.parametrize("depth", [1e-2, 1e-5, 1e-8, -1e-8, -1e-5])
def test_grazing(order, h, depth):
    """Grazing on long steps: an event where the tip would dip below the wall, none where it turns just before."""
    free = public_scene(problem_b()[0], pin.GeometryModel())
    result = run(free, *START, 2.0, h, "ctec", order=order)
    core = free.core()

    def tip(time: float) -> float:
        k = min(int(time / h), len(result.q) - 1)
        q = core.step(result.q[k], result.p[k], time - k * h, order=order)[0] if time > k * h else result.q[k]
        return math.sin(q[0]) + math.sin(q[0] + q[1])

    low, high, ratio = 1.3, 1.37, (math.sqrt(5.0) - 1.0) / 2.0
    for _ in range(60):  # golden section for the turning point
        a, b = high - ratio * (high - low), low + ratio * (high - low)
        low, high = (low, b) if tip(a) < tip(b) else (a, high)
    model, shapes = problem_b()
    shapes.geometryObjects[1].placement = place(tip(low) + depth)
    hit = run(public_scene(model, shapes), *START, 2.0, h, "ctec", order=order)
    assert hit.code == 0, hit.message
    assert len(hit.events) == (1 if depth > 0.0 else 0)
    assert np.abs(hit.log["gap"]).max(initial=0.0) <= 1e-12
    assert hit.stats["stage_iterations"] <= 3 * result.stats["stage_iterations"] + 200  # bounded work


@pytest.mark.parametrize(("order", "h", "error"), [(8, 0.1, 1e-7), (12, 0.25, 1e-7), (16, 0.4, 1e-8)])
def test_joint_limits(order, h, error):
    """Mass on a spring between two limits: half turns of cos, cut at the limit; times to the accuracy of the step."""
    model, omega, bound = pin.Model(), 3.0, 0.6
    model.gravity = pin.Motion.Zero()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slider")
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model, pin.GeometryModel())
    scene.set_joint("slider", stiffness=2.0 * omega**2, limits=(-bound, bound), restitution=1.0)
    speed = 3.0  # at x = 0: amplitude 1
    result = run(scene, [0.0], [speed], 8.0, h, "ctec", order=order)
    assert result.code == 0, result.message
    quarter = math.asin(bound * omega / speed) / omega
    expected = quarter * (1 + 2 * np.arange(int(4.0 / quarter + 0.5)))
    assert result.log["time"] == pytest.approx(expected[expected <= 8.0], abs=error)


@pytest.mark.parametrize(("order", "h"), [(4, 0.02), (8, 0.05), (16, 0.05)])
@pytest.mark.parametrize("seed", [200, 204])
def test_nothing_is_below_zero_between_the_nodes(order, h, seed):
    """An arm and four free bodies between six walls, some two impacts per step: no gap of the dense output dips."""
    model, shapes = room(True)
    q, v = room_start(model, 3.0, seed)
    traj = cvi.simulate(public_scene(model, shapes), q, v, 1.0, h, order=order)
    assert len(traj.events) >= 15
    core = traj.scene.core()
    # the dense output is good to O(h^(s+2)) of motions of some metres
    worst = min(float(np.min(core.gaps(state)[0])) for state in traj.at(np.linspace(0.0, 1.0, 2001)).q)
    assert worst >= -1e-6
