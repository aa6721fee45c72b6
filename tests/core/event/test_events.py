"""Event location at its limits (nothing tunnels, nothing is invented) and sequences of impacts at one instant."""

from __future__ import annotations

import math

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.contact_models import geometry, halfspace, slider_blocks
from helpers.contact_models import scene as public_scene
from oracles import ctec_oracle
from oracles.del_step import System


def free_bodies(shapes: list, placed: dict | None = None) -> tuple[pin.Model, pin.GeometryModel]:
    """Unit masses on free-flyers without gravity, one per shape, and fixed shapes {name: (placement, shape)}."""
    model, entries = pin.Model(), {}
    model.gravity = pin.Motion.Zero()
    for i, shape in enumerate(shapes):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"body{i}")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
        entries[f"shape{i}"] = (joint, pin.SE3.Identity(), shape)
    for name, (placement, shape) in (placed or {}).items():
        entries[name] = (0, placement, shape)
    names = list(entries)
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :] if entries[a][0] or entries[b][0]]
    return model, geometry(entries, pairs)


# --- nothing tunnels ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("offset", [0.0, 0.5, 0.9, 0.99, 0.9999, 1 - 1e-6])
@pytest.mark.parametrize("start", [0.103, 0.25, 0.3777])
def test_two_balls_passing_in_one_step_are_caught(offset, start):
    """Two 5 mm balls closing at 40 m/s, h = 1e-2, with an impact parameter up to a hair below their contact distance.

    The gap is positive at both ends of the step and dips below zero for as little as a microsecond.
    """
    radius = 0.0025
    model, shapes = free_bodies([coal.Sphere(radius), coal.Sphere(radius)])
    reach, b = 2 * radius, 2 * radius * offset
    q, v = pin.neutral(model), np.zeros(12)
    q[7:10] = start, b, 0.0
    v[0], v[6] = 20.0, -20.0
    traj = cvi.simulate(public_scene(model, shapes), q, v, 0.02, 1e-2)
    chord = math.sqrt(reach**2 - b**2)
    assert len(traj.events) == 1
    event = traj.events[0]
    # a gap of 1e-12 m is a time of 1e-12 / |gamma|
    gamma = -40.0 * chord / reach
    assert abs(event.time - (start - chord) / 40.0) <= 2e-12 / abs(gamma)
    assert event.gamma_minus == pytest.approx(gamma, abs=1e-12 * 40.0**2 / reach / abs(gamma) * 10)


@pytest.mark.parametrize("offset", [1 + 1e-6, 1.001, 1.5])
def test_two_balls_passing_close_by_do_not_touch(offset):
    radius = 0.0025
    model, shapes = free_bodies([coal.Sphere(radius), coal.Sphere(radius)])
    q, v = pin.neutral(model), np.zeros(12)
    q[7:10] = 0.25, 2 * radius * offset, 0.0
    v[0], v[6] = 20.0, -20.0
    assert len(cvi.simulate(public_scene(model, shapes), q, v, 0.02, 1e-2).events) == 0


@pytest.mark.parametrize("angle", [0.2, 0.31, 0.57, 0.9, 1.4])
@pytest.mark.parametrize("turns", [50.0, 120.0])
def test_spinning_rod_does_not_sweep_through_a_pin(angle, turns):
    """A capsule about its centre at 50 and 120 rad/s (1.2 rad per step) and a pin in its path: pure rotation."""
    radius, pin_radius, distance = 0.01, 0.0025, 0.4
    model, shapes = free_bodies(
        [coal.Capsule(radius, 1.0)],
        {"pin": (pin.SE3(np.eye(3), np.array([0.0, 0.0, distance])), coal.Sphere(pin_radius))},
    )
    q, v = pin.neutral(model), np.zeros(6)
    q[3:7] = pin.Quaternion(pin.exp3(np.array([-angle, 0.0, 0.0]))).coeffs()
    v[3] = turns
    traj = cvi.simulate(public_scene(model, shapes), q, v, 0.04, 1e-2)
    contact = math.asin((radius + pin_radius) / distance)
    assert len(traj.events) >= 1
    assert abs(traj.events[0].time - (angle - contact) / turns) <= 1e-12
    assert traj.events[0].gamma_minus == pytest.approx(-turns * distance * math.cos(contact), rel=1e-11)


@pytest.mark.parametrize("depth", [1e-5, 1e-6, 1e-9, -1e-9, -1e-6])
@pytest.mark.parametrize("phase", [0.02, 0.05, 0.081])
@pytest.mark.parametrize("ground", ["halfspace", "box"])
def test_what_swings_through_its_lowest_place(depth, phase, ground):
    """A body turns over the ground by 0.1 rad in a step, a box over a halfspace or a capsule over a box: the gap of its
    lowest edge or end is positive at both ends of the step and dips to -depth between them."""
    speed, h = 2.0, 0.05
    if ground == "halfspace":
        body, arm, radius, lowest = coal.Box(0.2, 0.2, 0.2), 0.1 * math.sqrt(2), 0.0, 0.25 * math.pi
        placed = (pin.SE3.Identity(), halfspace(0.0, 0.0, 1.0, 0.0))
    else:
        body, arm, radius, lowest = coal.Capsule(0.02, 0.2), 0.1, 0.02, 0.0
        placed = (pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1])), coal.Box(1.0, 1.0, 0.2))
    model, shapes = free_bodies([body], {"ground": placed})
    q, v = pin.neutral(model), np.zeros(6)
    q[2] = arm + radius - depth
    q[3:7] = pin.Quaternion(pin.exp3(np.array([lowest - phase, 0.0, 0.0]))).coeffs()
    v[3] = speed
    traj = cvi.simulate(public_scene(model, shapes), q, v, h, h)
    if depth < 0.0:
        assert len(traj.events) == 0
        return
    # The height is q[2] - radius - arm cos(angle). It is located to 1e-12 m, and placed to as much again.
    angle = math.acos(1.0 - depth / arm)
    assert len(traj.events) >= 1
    assert abs(traj.events[0].time - (phase - angle) / speed) <= 2e-12 / (speed * arm * math.sin(angle))


@pytest.mark.slow
def test_an_event_is_found_wherever_it_lies_in_the_step():
    """A spinning ball with an offset centre of mass, one wall, one step of any length: all places of the root."""
    inertia = pin.Inertia(0.74, np.array([0.035, -0.077, -0.073]), np.diag([0.099, 0.076, 0.097]))
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(1, inertia, pin.SE3.Identity())
    ball, wall = (1, pin.SE3.Identity(), coal.Sphere(0.2)), (0, pin.SE3.Identity(), halfspace(1.0, 0.0, 0.0, -1.1))
    shapes = geometry({"ball": ball, "wall": wall}, [("ball", "wall")])
    scene, system = public_scene(model, shapes), System(model)
    gap = ctec_oracle.geometry_gap(model, shapes, 0)
    q = np.array([-0.898, 0.027, -0.579, 0.102, 0.068, 0.146, -0.981])
    q[3:] /= np.linalg.norm(q[3:])
    v = np.array([0.38, -0.34, 5.05, 12.18, -1.6, 3.95])
    for h in np.linspace(0.009, 0.03, 211):
        traj = cvi.simulate(scene, q, v, h, h, throw=False)
        assert traj.status.ok, (h, traj.status)
        assert len(traj.events) == 1, h
        event = traj.events[0]
        # the oracle's partial step ends at the wall too: 1e-12 m for the location, 1e-12 for the solver
        assert abs(gap(system.step(q, system.momentum(q, v), event.time)[0])) <= 4e-12


@pytest.mark.parametrize("seed", range(8))
def test_fast_balls_stay_in_a_thin_box(seed):
    """Two 5 mm balls at 20 m/s in a 10 cm box of 2 mm plates: two hits per step and none gets out."""
    rng, side, wall = np.random.default_rng(seed), 0.1, 0.002
    plates = {}
    for axis in range(3):
        for sign in (-1, 1):
            size, where = np.full(3, side + 2 * wall), np.zeros(3)
            size[axis], where[axis] = wall, sign * 0.5 * (side + wall)
            plates[f"plate{axis}{sign}"] = (pin.SE3(np.eye(3), where), coal.Box(*size))
    model, shapes = free_bodies([coal.Sphere(0.0025), coal.Sphere(0.0025)], plates)
    q, v = pin.neutral(model), np.zeros(12)
    q[:3], q[7:10] = rng.uniform(-0.04, -0.01, 3), rng.uniform(0.01, 0.04, 3)
    for k in (0, 6):
        v[k : k + 3] = rng.normal(size=3)
        v[k : k + 3] *= 20.0 / np.linalg.norm(v[k : k + 3])
    traj = cvi.simulate(public_scene(model, shapes), q, v, 0.5, 1e-2)
    # mean path between walls of a cube is 2/3 of the side, the balls' own hits come on top
    assert len(traj.events) >= 100
    positions = np.abs(np.hstack([traj.q[:, :3], traj.q[:, 7:10]]))
    assert positions.max() <= 0.5 * side - 0.0025 + 1e-10
    assert np.abs(traj.energy / traj.energy[0] - 1.0).max() <= 1e-11


def test_events_at_and_next_to_a_node():
    """Impacts at, and 1e-15 to 1e-7 s before and after, the end of a step: each exactly once."""
    for shift in (0.0, 1e-15, -1e-15, 1e-13, -1e-13, 1e-11, -1e-11, 1e-9, -1e-9, 1e-7, -1e-7):
        model, shapes = slider_blocks((1.0,), 0.125, "sphere")
        start = 0.125 + 0.5 + shift
        traj = cvi.simulate(public_scene(model, shapes), np.array([start]), np.array([-1.0]), 1.0, 0.0625)
        assert len(traj.events) == 1, shift
        assert abs(traj.events[0].time - (0.5 + shift)) <= 1e-12, shift
        assert abs(traj.q[-1, 0] - (0.125 + 0.5 - shift)) <= 1e-11, shift
        assert traj.v[-1, 0] == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("gap", [1e-10, 1e-12, 1e-14, 0.0])
@pytest.mark.parametrize("speed", [0.0, 1e-9, -1e-9])
def test_what_slides_away_from_a_wall_needs_no_shorter_steps(gap, speed):
    """The least gap is at the start, or nearly; a slip against the force ends at once, in steps of 1e-10 s and less."""
    scene = cvi.Scene(gravity=(4.0, 0.0, -9.81))
    scene.add_box("box", (0.1, 0.1, 0.1), placement=pin.SE3(np.eye(3), np.array([0.05 + gap, 0.0, 0.05])))
    scene.add_halfspace()
    scene.add_halfspace((1.0, 0.0, 0.0), 0.0, name="wall")
    scene.set_contact(restitution=0.0, friction=0.2)
    v = np.zeros(6)
    v[0] = speed
    traj = cvi.simulate(scene, scene.neutral(), v, duration=0.005, dt=1e-3, order=2)
    assert traj.stats.halved == 0
    # Against the force it slides for 5e-10 s, by 2.5e-19 m. Places of 0.05 m are rounded by 1e-17 m a step.
    slides = speed * 0.005 + 0.5 * (4.0 - 0.2 * 9.81) * 0.005**2
    assert traj.q[-1, 0] - traj.q[0, 0] == pytest.approx(slides, rel=0.0, abs=1e-15)


# --- sequences at one instant ---------------------------------------------------------------------------------------
def row(masses, speeds, gap=0.0, restitution=1.0):
    """Balls of radius 1/8 in a row on a line (numbers exact in binary), the first at x = 1; velocities at the end."""
    model, shapes = slider_blocks(masses, 0.125, "sphere")
    q = 1.0 + (0.25 + gap) * np.arange(len(masses))
    return cvi.simulate(public_scene(model, shapes, restitution), q, np.array(speeds, float), 0.25, 0.0625)


@pytest.mark.parametrize("n", [2, 3, 5, 10])
def test_touching_chain_hands_the_velocity_on(n):
    """Newton's cradle: n - 1 impacts, the last ball leaves with v."""
    traj = row((1.0,) * n, (1.0,) + (0.0,) * (n - 1))
    assert len(traj.events) == n - 1
    assert traj.v[-1] == pytest.approx([0.0] * (n - 1) + [1.0], abs=1e-14)
    assert np.abs(traj.events.array("time")).max() <= 1e-12


@pytest.mark.parametrize(
    ("before", "after"),
    [((1, 0, 0), (0, 0, 1)), ((1, 0, -1), (-1, 0, 1)), ((1, 0.3, -1), (-1, 0.3, 1))],
)
def test_three_equal_balls(before, after):
    """Two balls hit a third at once, equal masses: unique."""
    assert row((1.0, 1.0, 1.0), before).v[-1] == pytest.approx(after, abs=1e-14)


def test_three_unequal_balls_have_two_outcomes():
    """Two balls hit a third at once, masses (1, 3, 1): one of exactly two, never the simultaneous answer."""
    v = row((1.0, 3.0, 1.0), (1, 0, -1)).v[-1]
    outcomes = [np.array([-0.5, -0.25, 1.25]), np.array([-1.25, 0.25, 0.5])]
    assert min(np.abs(v - o).max() for o in outcomes) <= 1e-14


@pytest.mark.parametrize("n", [2, 3])
def test_particle_in_a_wedge(n):
    """Frictionless wedge of angle pi/n, e = 1, into the corner. n = 2: v -> -v; n = 3: the bisector part turns."""
    half = 0.5 * math.pi / n
    # inward normals of the two faces; the bisector is +x; the faces stand back by the ball's radius
    normals = [(math.sin(half), s * -math.cos(half), 0.0) for s in (1.0, -1.0)]
    radius = 0.1
    model, shapes = free_bodies(
        [coal.Sphere(radius)], {f"face{i}": (pin.SE3.Identity(), halfspace(*m, -radius)) for i, m in enumerate(normals)}
    )
    direction = np.array([-math.cos(0.2), math.sin(0.2), 0.0])
    v = np.concatenate([direction, np.zeros(3)])
    q = pin.neutral(model)
    q[:3] = -0.5 * direction
    # through the apex, up to rounding: whichever face comes first
    traj = cvi.simulate(public_scene(model, shapes), q, v, 1.0, 0.0625)
    expected = -direction if n == 2 else np.array([-direction[0], direction[1], 0.0])
    assert traj.v[-1, :3] == pytest.approx(expected, abs=1e-12)
    assert len(traj.events) in (n - 1, n)


def test_ball_in_a_corner_of_three_walls():
    """Three orthogonal walls hit at one point: v -> -v in three impacts."""
    walls = {f"wall{i}": (pin.SE3.Identity(), halfspace(*np.eye(3)[i], 0.0)) for i in range(3)}
    model, shapes = free_bodies([coal.Sphere(0.125)], walls)
    q, v = pin.neutral(model), np.zeros(6)
    q[:3], v[:3] = 0.625, -1.0
    traj = cvi.simulate(public_scene(model, shapes), q, v, 1.0, 0.0625)
    assert len(traj.events) == 3
    assert traj.v[-1, :3] == pytest.approx([1.0, 1.0, 1.0], abs=1e-13)
    assert traj.q[-1, :3] == pytest.approx([0.625] * 3, abs=1e-12)
