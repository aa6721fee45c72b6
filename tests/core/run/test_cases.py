"""Cases with closed forms: bouncing ball, pendulum at a wall, blocks at a wall, rod, fast ball; general laws."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers import laws
from helpers.contact_models import GRAVITY, halfspace, pendulum_at_wall, rod, slider_blocks
from helpers.contact_models import scene as public_scene
from oracles import blocks, closed_forms

EPS = np.finfo(float).eps


def ball_scene(restitution: float, radius: float = 0.1) -> cvi.Scene:
    scene = cvi.Scene(gravity=(0.0, 0.0, -GRAVITY))
    scene.add_sphere("ball", radius=radius, mass=0.5)
    scene.add_halfspace((0.0, 0.0, 1.0), 0.0, name="floor")
    scene.set_contact(restitution=restitution)
    return scene


def drop(restitution: float, duration: float, h: float, **options) -> cvi.Trajectory:
    scene = ball_scene(restitution)
    q = scene.neutral()
    q[:3] = 0.0, 0.0, 1.1
    return cvi.simulate(scene, q, np.zeros(scene.nv), duration, h, **options)


# --- bouncing ball ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("h", [0.02, 0.01])
def test_elastic_ball_bounces_forever(h):
    exact = closed_forms.BouncingBall(1.0, 1.0)
    traj = drop(1.0, 10.0, h)
    n = len(traj.events)
    assert n == int((10.0 / exact.first + 1) / 2)
    # free flight is exact on parabolas; each location adds at most 1e-12 m / 4.4 m/s, and errors add up over n impacts
    assert np.abs(traj.events.array("time") - exact.impact_times(n)).max() <= n * 1e-12
    assert np.abs(traj.q[:, 2] - 0.1 - [exact.height(t) for t in traj.t]).max() <= 1e-10
    # a long elastic run: some hundred steps, each solved to a residual of 1e-12
    assert np.abs(traj.energy / traj.energy[0] - 1.0).max() <= 1e-11
    assert np.abs(traj.events.array("gap")).max() <= 1e-12


@pytest.mark.parametrize("restitution", [0.9, 0.5])
def test_inelastic_ball_ends_where_its_impacts_accumulate(restitution):
    exact = closed_forms.BouncingBall(1.0, restitution)
    traj = drop(restitution, 10.0, 0.01, throw=False, zeno="end")
    assert traj.status.code == cvi.StatusCode.ZENO
    n = len(traj.events)
    assert n >= 5
    assert np.abs(traj.events.array("time") - exact.impact_times(n)).max() <= n * 1e-12
    speeds = exact.approach_speeds(n)
    # a gap located to 1e-12 m is a speed error of g * 1e-12 / speed; earlier errors come on top, shrinking by e
    tolerance = 1e-12 * (1.0 + GRAVITY / np.abs(speeds)) / (1.0 - restitution)
    assert np.all(np.abs(traj.events.array("gamma_minus") - speeds) <= tolerance)
    # the message names the pair and the accumulation time
    assert "ball" in traj.status.message
    assert "floor" in traj.status.message
    stated = float(traj.status.message.split("t =")[1].split("s")[0])
    assert stated == pytest.approx(exact.zeno_time(), abs=1e-9)
    # the trajectory up to there is intact
    assert traj.status.time <= exact.zeno_time() + 1e-9
    assert traj.status.time >= exact.zeno_time() - 0.011
    assert np.abs(traj.q[:, 2] - 0.1 - [exact.height(t) for t in traj.t]).max() <= 1e-10
    with pytest.raises(cvi.SimulationError) as caught:
        drop(restitution, 10.0, 0.01, zeno="end")
    assert len(caught.value.trajectory.t) == len(traj.t)


def test_apexes_fall_with_the_square_of_restitution():
    restitution, exact = 0.9, closed_forms.BouncingBall(1.0, 0.9)
    traj = drop(restitution, 6.0, 0.01)
    for n, event in enumerate(traj.events, start=1):
        assert event.gamma_plus**2 / (2 * GRAVITY) == pytest.approx(exact.apex(n), rel=1e-11)


# --- pendulum at a wall -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("theta0", [0.5, 1.0, 1.5])
def test_pendulum_at_the_wall_keeps_its_elliptic_period(theta0):
    exact, errors = closed_forms.pendulum_wall_period(theta0), []
    for h in (0.02, 0.01, 0.005):
        traj = cvi.simulate(public_scene(*pendulum_at_wall()), np.array([theta0]), np.zeros(1), 6.0, h)
        times = traj.events.array("time")
        assert times.size == int(6.0 / exact - 0.5) + 1
        assert abs(times[0] - 0.5 * exact) <= h * h
        errors.append(abs(np.diff(times).mean() - exact))
        speed = math.sqrt(2 * GRAVITY * (1 - math.cos(theta0)))
        # elastic: the energy is equal at every impact up to the variation of H, h^2 times some g^2
        assert np.abs(traj.events.array("gamma_minus") + speed).max() <= h * h * GRAVITY**2 / speed
        assert traj.q.min() >= -1e-10
    assert np.abs(laws.orders(errors) - 2.0).max() <= 0.1, errors


# --- two blocks and a wall --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shape", ["sphere", "box"])
@pytest.mark.parametrize("k", [0, 1, 2])
def test_blocks_count_the_digits_of_pi(k, shape):
    exact, half = blocks.collisions(k), 0.1
    scene = public_scene(*slider_blocks((1.0, 100.0**k), half, shape))
    last = float(exact[-1].time)
    duration = 0.05 * math.ceil((last + 0.1) / 0.05)
    q0 = np.array([half + 1.0, 3 * half + 2.0])
    traj = cvi.simulate(scene, q0, np.array([0.0, -1.0]), duration, 0.05)
    assert len(traj.events) == len(exact) == (3, 31, 314)[k]
    kinetic = 0.5 * traj.p**2 @ (1 / np.array([1.0, 100.0**k]))
    assert np.abs(kinetic / kinetic[0] - 1.0).max() <= 1e-12
    scale = 10.0**k  # velocity of the light block at the turn
    for event, hit in zip(traj.events, exact, strict=True):
        assert ("wall" in event.pair) == (hit.kind == "wall")
        light, heavy = event.p_plus / [1.0, 100.0**k]
        # a box is rounded: its distances come from an iteration with an error of some 1e-10 m
        tol = 1e-11 if shape == "sphere" else 1e-8
        assert abs(event.time - float(hit.time)) <= tol * scale
        assert abs(light - float(hit.light)) <= 1e-11 * scale
        assert abs(heavy - float(hit.heavy)) <= 1e-11


# --- impact of a rod --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("free", [False, True], ids=["hinge", "free_flyer"])
@pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0, 60.0])
def test_rod_hits_the_ground_with_one_end(degrees, free):
    theta, radius = math.radians(degrees), 0.01
    model, geometry = rod(free, radius)
    scene = public_scene(model, geometry)
    height = 0.5 * math.sin(theta) + radius + 0.0537
    q0, v0 = pin.neutral(model), np.zeros(model.nv)
    q0[2] = height
    if free:
        q0[3:7] = pin.Quaternion(pin.exp3(np.array([0.0, -theta, 0.0]))).coeffs()
        v0[:3] = pin.exp3(np.array([0.0, theta, 0.0])) @ [0.0, 0.0, -1.0]
    else:
        q0[3], v0[2] = -theta, -1.0
    traj = cvi.simulate(scene, q0, v0, 0.1, 0.01)
    impulse, v_com, omega = closed_forms.rod_impact(theta)
    assert len(traj.events) == 1
    event = traj.events[0]
    assert event.time == pytest.approx(0.0537, abs=1e-12)
    assert event.impulse == pytest.approx(impulse, abs=1e-12)
    # world momentum of the unit mass is its velocity; the hinge's momentum about y is omega / 12
    linear = pin.exp3(np.array([0.0, -theta, 0.0])) @ event.p_plus[:3] if free else event.p_plus[:3]
    spin = event.p_plus[4 if free else 3] * 12.0
    assert linear == pytest.approx([0.0, 0.0, v_com], abs=1e-12)
    assert spin == pytest.approx(omega, abs=1e-11)


# --- no tunnelling --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("offset", [0.0, 0.013, 0.05, 0.1, 0.137])
@pytest.mark.parametrize("support", ["box", "second ball"])
def test_fast_ball_bounces_off_a_thin_plate(support, offset):
    """A 5 mm ball at 20 m/s and a 2 mm plate, h = 1e-2: 0.2 m per step, forty times the ball."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    scene.add_sphere("ball", radius=0.0025, mass=0.001)
    if support == "box":
        scene.add_box("plate", (0.2, 0.2, 0.002), free=False)
        top = 0.001
    else:
        scene.add_sphere("plate", radius=0.005, free=False, mass=1.0)
        top = 0.005
    scene.set_contact(restitution=1.0)
    gap = 0.25 + offset
    q = scene.neutral()
    q[:3] = 0.0, 0.0, top + 0.0025 + gap
    v = np.array([0.0, 0.0, -20.0, 0.0, 0.0, 0.0])
    traj = cvi.simulate(scene, q, v, 0.05, 1e-2)
    hit, height, speed = closed_forms.ball_at_plate(gap, 20.0, 0.05)
    assert len(traj.events) == 1
    # GJK of the rounded plate is good to 1e-10 m
    assert traj.events[0].time == pytest.approx(hit, abs=1e-11)
    assert traj.q[-1, 2] - top - 0.0025 == pytest.approx(height, abs=1e-9)
    assert traj.v[-1, 2] == pytest.approx(speed, abs=1e-9)


# --- the event loop -------------------------------------------------------------------------------------------------
def test_many_impacts_in_one_step():
    """A ball between two walls 1 cm apart at 5 m/s: five impacts per step, a triangle wave."""
    model, geometry = slider_blocks((1.0,), 0.1, "sphere")
    far = pin.GeometryObject("far", 0, pin.SE3.Identity(), halfspace(-1.0, 0.0, 0.0, -0.21))
    geometry.addCollisionPair(pin.CollisionPair(geometry.addGeometryObject(far), 1))
    traj = cvi.simulate(public_scene(model, geometry), np.array([0.105]), np.array([5.0]), 1.0, 0.01)
    assert len(traj.events) == 500
    phase = np.mod(0.005 + 5.0 * traj.t, 0.02)
    assert np.abs(traj.q[:, 0] - 0.1 - np.where(phase <= 0.01, phase, 0.02 - phase)).max() <= 500 * 1e-12
    assert np.abs(traj.events.array("time") - (0.001 + 0.002 * np.arange(500))).max() <= 500 * 1e-12
    assert traj.stats.impacts == 500


def test_start_in_penetration_names_pair_and_depth():
    scene = ball_scene(0.5)
    q = scene.neutral()
    q[2] = 0.1 - 0.0123
    with pytest.raises(cvi.PenetrationError) as caught:
        cvi.simulate(scene, q, np.zeros(scene.nv), 1.0, 0.01)
    assert set(caught.value.pair) == {"ball", "floor"}
    assert caught.value.depth == pytest.approx(0.0123, rel=1e-9)
    assert "ball" in str(caught.value)
    assert "0.0123" in str(caught.value)


@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_start_in_contact_leaves_or_hits_at_once(speed):
    """Touching exactly at the start: a ball that separates has no event; one that closes has an impact at t = 0."""
    scene = ball_scene(1.0)
    q, v = scene.neutral(), np.zeros(scene.nv)
    q[2], v[2] = 0.1, 1.0
    traj = cvi.simulate(scene, q, v, 0.1, 0.01)
    assert len(traj.events) == 0
    v[2] = -1.0
    traj = cvi.simulate(scene, q, v, 0.1, 0.01)
    assert len(traj.events) == 1
    assert traj.events[0].time == pytest.approx(0.0, abs=1e-12)
    exact = 0.1 + traj.t - 0.5 * GRAVITY * traj.t**2
    assert np.abs(traj.q[1:, 2] - exact[1:]).max() <= 1e-11


def test_joint_limits_reflect():
    """A pendulum between the limits +-0.2: a limit is a guard like any other."""
    model, _ = pendulum_at_wall()
    model.lowerPositionLimit, model.upperPositionLimit = np.array([-0.2]), np.array([0.3])
    scene = cvi.Scene.from_pinocchio(model)
    scene.set_contact(restitution=1.0)
    traj = cvi.simulate(scene, np.array([0.1]), np.array([2.0]), 2.0, 0.005)
    assert len(traj.events) >= 6
    sides = [e.pair[1] for e in traj.events]
    assert sides[:4] == ["upper limit", "lower limit"] * 2
    assert all(e.kind == "limit" and e.pair[0] == "hinge" for e in traj.events)
    assert all(abs(e.gap) <= 1e-12 for e in traj.events)
    assert traj.q.min() >= -0.2 - 1e-10
    assert traj.q.max() <= 0.3 + 1e-10
    for e in traj.events:
        assert abs(e.q[0] - (0.3 if e.pair[1] == "upper limit" else -0.2)) <= 1e-12
        assert e.p_plus == pytest.approx(-e.p_minus, rel=1e-13)
        # energy at the impact against that at the start, to the accuracy of the step
        speed = math.sqrt(4.0 - 2 * GRAVITY * (math.cos(0.1) - math.cos(e.q[0])))
        assert abs(e.p_minus[0]) == pytest.approx(speed, abs=1e-3)
