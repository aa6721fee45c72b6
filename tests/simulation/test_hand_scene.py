"""The main job, models/allegro_ball.toml: a ball falls into the half closed hand and ends at rest in it."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.persistent_runs import check_contacts

MODELS = Path(__file__).resolve().parents[2] / "models"
GRAVITY, MASS, RADIUS, MU, RESTITUTION = 9.81, 0.1, 0.03, 0.8, 0.3
OMEGA = 2 * np.pi * 10.0  # of the springs with their links [1/s], as in the file
BALL = slice(16, 22)  # in v: the hand's 16 joints come first
SLOPE, PALM_TOP = 0.4, 0.0204  # the fingers are lowered by this angle [rad]; the palm's surface over its centre [m]
# The start as it is, and moved sideways [m]: a law of contact that holds by luck of one start is none.
STARTS = {"as it is": 0.0, "moved by 1e-6 m": 1e-6, "moved by 1e-4 m": 1e-4}
every_start = pytest.mark.parametrize("start", STARTS)


@functools.cache
def run(start: str = "as it is") -> cvi.Trajectory:
    """The whole run, 5 s; it takes half a second."""
    scene = cvi.load_scene(MODELS / "allegro_ball.toml")
    q0 = scene.q0.copy()
    q0[scene.q_index("ball")][1] += STARTS[start]
    return cvi.simulate(scene, q0, scene.v0)


def damping_work(traj: cvi.Trajectory) -> np.ndarray:
    """What the joints' damping took until each node [J], shape (N,): d (dq)^2/h between nodes and impacts.

    That is what the midpoint rule takes in a whole step, and within O(h^3) in parts of one.
    """
    model = traj.scene.model
    damped = [j for j in model.joints if j.nv == 1 and model.damping[j.idx_v] > 0.0]
    d = np.array([model.damping[j.idx_v] for j in damped])
    time = np.concatenate([traj.t, traj.events.array("time")])
    order = np.argsort(time, kind="stable")
    time = time[order]
    q = np.concatenate([traj.q, traj.events.array("q")])[order][:, [j.idx_q for j in damped]]
    h = np.diff(time)
    passed = h > 1e-12  # several impacts at one instant
    work = np.zeros(len(time))
    work[1:][passed] = (np.diff(q, axis=0)[passed] ** 2 @ d) / h[passed]
    return np.interp(traj.t, time, np.cumsum(work))


@every_start
def test_the_run_reaches_its_end(start):
    traj = run(start)
    assert traj.status.code is cvi.StatusCode.SUCCESS, traj.status
    assert traj.t[-1] == 5.0


@every_start
def test_every_impact_is_located(start):
    """A grasp is no heap: events do not accumulate enough for dense steps."""
    traj = run(start)
    assert len(traj.events) > 1000
    assert len(traj.dense_steps) == 0


def test_the_first_impact_is_that_of_free_fall():
    """Straight down onto the palm, a plane whose normal leans by the slope; the palm does not move."""
    traj = run()
    scene, first = traj.scene, traj.events[0]
    palm = next(g for g in scene.collision_model.geometryObjects if g.name == "palm_link_0")
    normal = np.array([np.sin(SLOPE), 0.0, np.cos(SLOPE)])
    over = normal @ (traj.q[0, scene.q_index("ball")][:3] - palm.placement.translation) - PALM_TOP - RADIUS
    fall = np.sqrt(2 * over / np.cos(SLOPE) / GRAVITY)  # the midpoint rule is exact in free fall
    assert set(first.pair) == {"palm_link_0", "ball"}
    assert first.time == pytest.approx(fall, abs=1e-11)
    assert first.gamma_minus == pytest.approx(-GRAVITY * fall * np.cos(SLOPE), rel=1e-10)
    assert first.gamma_plus == pytest.approx(-RESTITUTION * first.gamma_minus, rel=1e-12)
    # Sticking: a ball at rest that turns freely takes m v/(1 + m r^2/I) = 2/7 m v along the palm, if friction can.
    tangential = MASS * GRAVITY * fall * np.sin(SLOPE) * 2 / 7
    assert tangential < MU * first.impulse
    across = first.impulse_vector - first.impulse_vector @ first.normal * first.normal
    assert np.linalg.norm(across) == pytest.approx(tangential, rel=1e-9)


@every_start
def test_laws_of_contact(start):
    """Every row: gap, signs, complementarity, cone and sticking; every impact within the cone, losing energy."""
    traj = run(start)
    log = traj.contacts
    check_contacts(traj, MU)  # persistent: |gap| <= 1e-10, impulses >= 0, |gap impulse| <= 1e-12
    assert np.abs(log.array("gap")[log.h > 0.0]).max() <= 1e-10
    assert (log.normal_impulse >= 0.0).all()
    assert np.abs(log.array("gap") * log.normal_impulse).max() <= 1e-12
    # the solver's residual, 1e-12, is relative to the largest impulses of a problem
    largest = max(event.impulse for event in traj.events)
    for event in traj.events:
        normal = event.impulse_vector @ event.normal
        across = np.linalg.norm(event.impulse_vector - normal * event.normal)
        assert across <= MU * normal + 1e-12 * largest
        assert event.loss >= -1e-15


@every_start
def test_impulses_account_for_the_balls_motion(start):
    """From the start to the end, in the world's axes; rounding of as many sums as there are rows."""
    traj = run(start)
    turn = pin.Quaternion(traj.q[-1, traj.scene.q_index("ball")][3:]).matrix()
    change = turn @ traj.p[-1, BALL][:3] - traj.p[0, BALL][:3] + [0.0, 0.0, MASS * GRAVITY * traj.t[-1]]
    weight = MASS * GRAVITY * traj.t[-1]
    assert np.abs(traj.contacts.impulse_on("ball") - change).max() <= len(traj.contacts) * 2e-16 * weight


@every_start
def test_the_energy_is_accounted_for(start):
    """Energy + losses of impacts and friction + work of damping stay what the energy was.

    Impacts: to rounding. Steps of h: the midpoint rule errs by (omega h)^2/12 of what the springs' motion exchanges,
    of which damping takes all in the end; nothing may raise the energy by more.
    """
    traj = run(start)
    ledger, damped = traj.ledger, damping_work(traj)
    assert np.abs(ledger.energy_jump).max() <= 1e-13 * ledger.kinetic_energy.max()
    bound = (OMEGA * traj.options.dt) ** 2 / 12 * damped[-1]
    assert np.abs(ledger.energy + ledger.loss + damped - ledger.energy[0]).max() <= bound
    assert ledger.energy_rise.max() <= bound
    # most of the fall is lost in impacts, some in the springs of the fingers
    assert ledger.energy[0] - ledger.energy[-1] > 0.9 * MASS * GRAVITY * 0.14


@every_start
def test_the_ball_rests_in_the_hand(start):
    traj = run(start)
    assert np.abs(traj.v[-1]).max() < 1e-8  # m/s, rad/s; fingers and ball
    acting = traj.contacts.at(traj.t[-1])
    links = {name for contact in acting for name in contact.pair} - {"ball"}
    assert len(links) >= 2
    assert all("ball" in contact.pair for contact in acting)
    assert {contact.mode for contact in acting} == {"stick"}
    assert all(contact.normal_force > 0.0 for contact in acting)
    # what carries it is its weight, and turns it no more
    _, force = traj.contacts.on("ball")
    weight = MASS * GRAVITY
    assert force[-1] == pytest.approx([0.0, 0.0, weight], abs=1e-12 * weight)
    centre = traj.q[-1, traj.scene.q_index("ball")][:3]
    signs = [1.0 if contact.pair[1] == "ball" else -1.0 for contact in acting]
    moment = sum(s * np.cross(c.position - centre, c.force) for s, c in zip(signs, acting, strict=True))
    assert np.abs(moment).max() <= 1e-10 * weight * RADIUS
    # at the end the whole run stands still: nothing has moved since one second before
    assert np.abs(traj.q[-1] - traj.q[np.searchsorted(traj.t, 4.0)]).max() <= 1e-10
