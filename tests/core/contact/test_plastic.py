"""Plastic impacts: gamma+ = 0 and Carnot's loss to 1e-12, for any number of contacts, with CTEC and MHC; rest."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from batteries.models import double_pendulum
from helpers import persistent_runs
from helpers.contact_models import geometry, halfspace, place, problem_b, slider_blocks
from helpers.contact_models import scene as public_scene
from helpers.persistent_runs import check_contacts
from oracles.ctec_oracle import gap_gradient, geometry_gap, mass_matrix
from oracles.persistent_scenes import carnot

MAPS = pytest.mark.parametrize("impact", ["ctec", "mhc"])


def check_event(scene, event, gradients, tolerance=1e-12) -> None:
    """All rows of W v vanish after; p+ and the loss are Carnot's."""
    mass = mass_matrix(scene.model, event.q)
    v_minus, v_plus = (np.linalg.solve(mass, p) for p in (event.p_minus, event.p_plus))
    scale = max(1.0, float(np.abs(gradients @ v_minus).max()))
    assert np.abs(gradients @ v_plus).max() <= tolerance * scale
    expected, loss = carnot(mass, gradients, v_minus)
    assert np.abs(v_plus - expected).max() <= 10 * tolerance * scale
    assert event.loss == pytest.approx(loss, abs=tolerance * max(1.0, loss))
    assert event.energy_change == pytest.approx(-loss, abs=tolerance * max(1.0, loss))


@MAPS
def test_double_pendulum_stays_at_its_wall(impact):
    """Problem B with e = 0: the tip stops at the wall and slides along it until the wall would have to pull."""
    model, listed = problem_b()
    scene = public_scene(model, listed, restitution=0.0)
    traj = cvi.simulate(scene, np.array([0.3, 0.2]), np.zeros(2), 2.0, 0.01, impact=impact)
    event = traj.events[0]
    assert event.time == pytest.approx(0.656671045, abs=1e-3)
    gradient = gap_gradient(model, event.q, geometry_gap(model, listed, 0))[None]
    # the gradient by differences is good to 1e-12
    check_event(scene, event, gradient, 1e-11)
    assert abs(event.gamma_plus) <= 1e-12
    check_contacts(traj)
    persistent = traj.contacts.h > 0.0
    assert persistent.sum() >= 1
    assert np.diff(traj.energy).max() <= 1e-3


@MAPS
def test_three_balls_move_on_together(impact):
    """Three blocks: plastic impacts end at (1/3, 1/3, 1/3), energy 1/6, not at Newton's (-1/3, 2/3, 2/3)."""
    scene = public_scene(*slider_blocks((1.0, 1.0, 1.0), 0.125, "sphere"), restitution=0.0)
    q = np.array([1.0, 1.25 + 0.2, 1.5 + 0.2])
    traj = cvi.simulate(scene, q, np.array([1.0, 0.0, 0.0]), 0.5, 0.01, impact=impact)
    assert traj.v[-1] == pytest.approx(np.full(3, 1 / 3), abs=1e-12)
    assert traj.kinetic_energy[-1] == pytest.approx(1 / 6, abs=1e-12)
    assert traj.events[0].time == pytest.approx(0.2, abs=1e-12)
    moved = traj.q[-1] - [1.2, 1.45, 1.7]
    assert moved == pytest.approx(np.full(3, 0.1), abs=1e-11)
    check_contacts(traj)


@MAPS
@pytest.mark.parametrize("mu", [0.0, 0.5])
def test_box_lands_flat(impact, mu):
    """Four points of one pair, forces not unique: gamma+ = 0 at all of them, all kinetic energy of the fall goes."""
    scene, q, v = persistent_runs.box(mu=mu, gap=0.1)
    traj = cvi.simulate(scene, q, v, 0.5, 0.01, impact=impact)
    (event,) = traj.events
    assert event.points == 4
    fall = 2.0 * persistent_runs.GRAVITY * 0.1
    assert event.loss == pytest.approx(fall, rel=1e-12)
    assert np.abs(event.p_plus).max() <= 1e-12
    corners = [np.array([x, y, -0.05]) for x in (-0.1, 0.1) for y in (-0.15, 0.15)]
    rows = np.array([[0.0, 0.0, 1.0, *np.cross(c, [0.0, 0.0, 1.0])] for c in corners])
    check_event(scene, event, rows)
    impacts = traj.contacts[:4]
    assert sum(abs(row.impulse[2]) for row in impacts) == pytest.approx(event.impulse, rel=1e-12)


@MAPS
def test_box_lands_on_an_edge_and_on_a_corner(impact):
    """Two points, one point: Carnot without friction."""
    for turn, count in ((persistent_runs.turned(0.4), 2), (pin.exp3(np.array([0.3, 0.5, 0.0])), 1)):
        scene, q, v = persistent_runs.box(gap=0.2)
        q[3:7] = pin.Quaternion(turn).coeffs()
        v[:3] = turn.T @ [0.2, -0.1, 0.0]  # no spin: an edge stays level
        traj = cvi.simulate(scene, q, v, 0.3, 0.01, impact=impact)
        event = traj.events[0]
        assert event.points == count
        r = pin.Quaternion(event.q[3:7]).matrix()
        size = 0.5 * np.array([0.2, 0.3, 0.1])
        corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
        heights = corners @ r[2] + event.q[2]
        low = corners[heights <= 1e-9]
        assert len(low) == count
        up = r.T @ [0.0, 0.0, 1.0]
        check_event(scene, event, np.array([[*up, *np.cross(c, up)] for c in low]))


@MAPS
def test_ball_falls_into_a_groove(impact):
    """Two pairs at one instant: one plastic block stops it in both, then it lies."""
    opening, radius = 0.7, 0.1
    scene, q, v = persistent_runs.groove(0.0, 0.0, opening)
    q[2] += 0.1
    v[0] = 0.3
    traj = cvi.simulate(scene, q, v, 0.5, 0.01, impact=impact)
    before, after = traj.events[0], traj.events[-1]
    assert before.time == pytest.approx(np.sqrt(0.2 / persistent_runs.GRAVITY), abs=1e-11)
    assert after.p_plus[:3] == pytest.approx([0.3, 0.0, 0.0], abs=1e-12)
    assert traj.events.array("loss").sum() == pytest.approx(persistent_runs.GRAVITY * 0.1, rel=1e-11)
    assert traj.q[:, 0] == pytest.approx(0.3 * traj.t, abs=1e-12)
    assert traj.q[-1, 2] == pytest.approx(radius / np.cos(opening), abs=1e-12)
    check_contacts(traj)


@MAPS
@pytest.mark.parametrize("seed", range(6))
def test_arm_with_many_tips(impact, seed):
    """A double pendulum with three balls on its lower rod over a floor: Carnot's loss, persistent contacts included."""
    rng = np.random.default_rng([5, seed])
    model = double_pendulum()
    shapes = {f"ball{k}": (2, place(x=float(rng.uniform(-0.1, 0.1)), z=-0.4 * k), coal.Sphere(0.05)) for k in (1, 2)}
    shapes["elbow"] = (1, place(z=-1.0), coal.Sphere(0.08))
    shapes["floor"] = (0, pin.SE3.Identity(), halfspace(0.0, 0.0, 1.0, -0.9))
    listed = geometry(shapes, [("floor", name) for name in list(shapes)[:-1]])
    scene = public_scene(model, listed, restitution=0.0)
    q = np.array([1.4, 0.4]) + rng.uniform(-0.1, 0.1, 2)
    traj = cvi.simulate(scene, q, np.zeros(2), 1.5, 0.005, impact=impact)
    assert len(traj.events) >= 2
    assert np.abs(traj.events.array("gamma_plus")).max() <= 1e-12
    check_contacts(traj)
    model = scene.model
    for event in traj.events:
        mass = mass_matrix(model, event.q)
        rows = np.array([gap_gradient(model, event.q, geometry_gap(model, listed, k)) for k in range(3)])
        gaps = np.array([geometry_gap(model, listed, k)(event.q) for k in range(3)])
        v_plus = np.linalg.solve(mass, event.p_plus)
        assert (rows[gaps < 1e-9] @ v_plus).min() >= -1e-11
        before, after = (p @ np.linalg.solve(mass, p) / 2 for p in (event.p_minus, event.p_plus))
        assert before - after == pytest.approx(event.loss, abs=1e-11)
        assert event.loss >= -1e-14
    # at rest, or what is left swings along the floor; never more energy than the midpoint step's own
    assert traj.energy[-1] <= traj.energy[0] + 1e-3
