"""The oracles of lasting contact against each other and against laws that they do not use."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from oracles import held_contact as oracle
from oracles.joint_friction import pendulum_turns

TIMES = np.linspace(0.0, 1.0, 11)
CLOSE = 1e-11  # the integrators' 1e-13 a step, some hundred steps


def test_sliding_ball_begins_to_roll():
    ball = oracle.SlidingBall(0.1, 0.2, (1.0, 0.4), (3.0, -2.0, 5.0))
    x, y, vx, vy, wx, wy, wz = ball.states(np.array([ball.rolls_from()]))[0]
    assert (vx - 0.1 * wy, vy + 0.1 * wx) == pytest.approx((0.0, 0.0), abs=1e-14)
    assert wz == 5.0
    # about the point of contact nothing changes: v x + 2/5 r w
    assert vx + 0.04 * wy == pytest.approx(1.0 - 0.4 * 0.2, abs=1e-14)
    assert vy - 0.04 * wx == pytest.approx(0.4 - 0.04 * 3.0, abs=1e-14)


@pytest.mark.parametrize("k", [1.3, 1.7, 2.0, 3.0])
def test_turning_slip_solves_its_equation(k):
    ball = oracle.TurningSlip(0.1, 0.3, k, (1.0, 0.5), (0.6, 0.9))
    pull, friction = oracle.GRAVITY * np.array([math.sin(0.3), 0.0]), ball.friction * oracle.GRAVITY * math.cos(0.3)

    def rate(_t, y):
        along = y[4:] / np.linalg.norm(y[4:])
        return np.concatenate([y[2:4], pull - friction * along, pull - 3.5 * friction * along])

    end = 0.9 * ball.rolls_from()
    found = solve_ivp(rate, (0.0, end), [0, 0, *ball.velocity, *ball.slip], "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    row = ball.states(np.array([end]))[0]
    assert row[:4] == pytest.approx(found[:4], abs=CLOSE)
    assert [row[2] - 0.1 * row[5], row[3] + 0.1 * row[4]] == pytest.approx(found[4:], abs=CLOSE)


def test_point_without_friction_leaves_at_two_thirds():
    point, start = oracle.PointOnSphere(1.0, 0.0), np.array([math.sin(0.3), 0.0, math.cos(0.3), 0.0, 0.0, 0.0])
    _, changes = point.states(start, np.array([0.0, 1.0]))
    rows, _ = point.states(start, np.array([0.0, changes[0].t]))
    assert rows[-1, 2] == pytest.approx(2.0 / 3.0 * math.cos(0.3), abs=CLOSE)


def test_point_with_friction_stays_on_the_sphere():
    point, start = oracle.PointOnSphere(1.0, 0.2), np.array([math.sin(0.3), 0.0, math.cos(0.3), 0.0, 1.2, 0.0])
    rows, changes = point.states(start, np.linspace(0.0, 0.48, 9))
    assert not changes
    assert np.linalg.norm(rows[:, :3], axis=1) == pytest.approx(1.0, abs=CLOSE)
    assert np.einsum("ni,ni->n", rows[:, :3], rows[:, 3:]) == pytest.approx(0.0, abs=CLOSE)


@pytest.mark.thinned(3)
@pytest.mark.parametrize(("friction", "speed"), [(0.3, 1.5), (0.3, 0.4), (0.5, 0.3)])
def test_rod_loses_what_friction_takes(friction, speed):
    """The energy falls by the work of the friction, which is not part of the equations."""
    rod = oracle.RodOnTip(friction, 0.02)
    times = np.linspace(0.0, 0.36, 3601)
    rows, changes = rod.states(np.array([0.0, 1.0, speed, 0.0]), times)
    height, rise = 0.5 * np.sin(rows[:, 1]), 0.5 * np.cos(rows[:, 1]) * rows[:, 3]
    energy = 0.5 * (rows[:, 2] ** 2 + rise**2 + rod.inertia * rows[:, 3] ** 2) + oracle.GRAVITY * height
    slips = np.array([rod.slip(row) for row in rows])
    power = []
    for t, row, slip in zip(times, rows, slips, strict=True):
        mode = ([c.mode for c in changes if c.t <= t] or ["forward"])[-1]
        power.append(rod.forces(mode, row)[1] * slip)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (np.array(power)[1:] + np.array(power)[:-1]) * np.diff(times))])
    # of the trapezoidal rule, 1e-4 s, with kinks in some of its intervals
    assert energy - energy[0] == pytest.approx(work, abs=1e-6)
    assert np.diff(energy).max() < 1e-13


def test_block_on_a_belt_swings_about_the_place_where_it_was_let_go():
    """Where static and sliding friction are one it slips but once."""
    block = oracle.BlockOnBelt(40.0, 0.4, 0.5)
    pieces = block.pieces(0.0, 0.0, 4.0)
    assert [sign for _, sign, _, _ in pieces] == [1, 0, 1]
    start, _, x, v = pieces[-1]
    assert (x, v) == pytest.approx((0.4 * oracle.GRAVITY / 40.0, 0.5), abs=1e-14)
    period = 2.0 * math.pi / math.sqrt(40.0)
    assert block.states(0.0, 0.0, np.array([start + period]))[0] == pytest.approx((x, v), abs=1e-13)


def test_box_slips_where_the_plane_is_steep_enough():
    """On a plane that turns slowly: at the angle of friction."""
    box = oracle.BoxOnTiltingPlane(0.4, 0.01, 0.05)
    _, changes = box.states(0.2, np.array([0.0, 40.0]))
    assert 0.01 * changes[0].t == pytest.approx(math.atan(0.4), abs=1e-5)


@pytest.mark.parametrize(("tilt", "precession"), [(0.9, 4.0), (0.5, 8.0), (1.2, 3.0)])
def test_steady_coin_goes_round(tilt, precession):
    coin = oracle.RollingCoin(0.1, 0.02)
    axis, spin = coin.steady(tilt, precession)
    closed = oracle.circling(coin, tilt, precession, TIMES)
    assert coin.states(axis, spin, TIMES) == pytest.approx(closed, abs=CLOSE)
    assert closed[:, 2] == pytest.approx(0.1 * math.sin(tilt) + 0.01 * math.cos(tilt))


def test_wobbling_coin_keeps_its_energy():
    coin = oracle.RollingCoin(0.1, 0.02)
    axis, spin = coin.steady(0.9, 4.0)
    rows = coin.states(axis, spin + [0.0, 1.0, 0.0], TIMES)
    about, across = coin.inertias
    energy = []
    for row in rows:
        a, w = row[3:6], row[6:9]
        v = -np.cross(w, coin.arm(a))
        energy.append(
            0.5 * v @ v + 0.5 * across * w @ w + 0.5 * (about - across) * (a @ w) ** 2 + oracle.GRAVITY * row[2]
        )
    assert np.ptp(energy) < CLOSE


def test_pendulum_turns_where_the_energy_says():
    """The angles at which it turns, against those of the energy's balance."""
    pendulum = oracle.RubbingPendulum(1.0, 9.81, 0.8)
    _, changes = pendulum.states(1.2, np.array([0.0, 8.0]))
    turns, _ = pendulum.states(1.2, np.array([0.0, *(change.t for change in changes)]))
    assert changes[-1].mode == "rests"
    assert turns[:, 0] == pytest.approx(pendulum_turns(1.2, 9.81, 0.8), abs=CLOSE)
