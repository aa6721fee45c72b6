"""The oracle of impacts with friction, and the references of persistent contact, against closed forms and energy."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from helpers.bodies_on_planes import corners, free_body
from oracles import block_impact, persistent_scenes
from oracles.block_impact import Pair
from oracles.contact_points import Points, VertexPlane
from oracles.del_step import System
from oracles.persistent_scenes import GRAVITY


# --- impacts ----------------------------------------------------------------------------------------------------------
def body_impact(model, q, v, listed, restitution):
    system = System(model)
    points = Points(system.split, listed)
    mass = system.mass_matrix(q)
    w = points.gradients(q, points.bases(q))
    outcome = block_impact.poisson(mass, mass @ (system.split.tangent_map(q) @ v), Pair(w, listed[0].mu, restitution))
    return outcome, np.linalg.solve(mass, outcome.p_plus), points.bases(q)


def test_spinning_ball_has_the_digits_of_the_case():
    """A falling ball with spin: the closed form has its known digits, and the impact oracle has the same."""
    ball = persistent_scenes.SpinningBall()
    digits = [*ball.after, ball.stick, ball.normal_impulse, ball.friction_impulse]
    assert digits == pytest.approx(
        [0.8404284622, 28.9892884461, 2.0585003825, 0.7281199942, 4.2021423108, 0.8404284622], abs=6e-11
    )
    assert ball.rolling == pytest.approx([10.0 / 7.0, 100.0 / 7.0], abs=1e-12)
    model = free_body(pin.Inertia.FromSphere(1.0, 0.1))
    q, v = pin.neutral(model), np.array([0.0, 0.0, -ball.normal_impulse, 0.0, 50.0, 0.0])
    q[2] = 0.1
    outcome, after, _ = body_impact(model, q, v, [VertexPlane(2, (0.0, 0.0, 0.0), 0.2, radius=0.1)], 0.0)
    # the ball spins about +y, so its lowest point moves to -x and friction pushes it to +x
    assert after == pytest.approx([ball.after[0], 0.0, 0.0, 0.0, ball.after[1], 0.0], abs=1e-13)
    assert outcome.loss > 0.0


@pytest.mark.parametrize("mu", [0.0, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("speed", [-1.0, 0.0, 0.7])
def test_rod_with_friction(mu, restitution, speed):
    model, theta = free_body(pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 1 / 12.0, 1 / 12.0])), 0.0), 0.9
    q, turn = pin.neutral(model), pin.exp3(np.array([0.0, -theta, 0.0]))
    q[2], q[3:7] = 0.5 * math.sin(theta), pin.Quaternion(turn).coeffs()
    v = np.append(turn.T @ [speed, 0.0, -1.0], np.zeros(3))
    outcome, after, bases = body_impact(model, q, v, [VertexPlane(2, (-0.5, 0.0, 0.0), mu)], restitution)
    normal, along = persistent_scenes.rod_impact_with_friction(theta, (speed, -1.0), mu, restitution)
    impulse = bases[0] @ outcome.lam[0]
    assert impulse == pytest.approx([along, 0.0, normal], abs=1e-12)
    assert after[:3] == pytest.approx([speed + along, 0.0, normal - 1.0], abs=1e-12)
    assert outcome.loss >= -1e-13
    if mu == 0.0:
        assert normal == pytest.approx((1 + restitution) / (1 + 3 * math.cos(theta) ** 2), rel=1e-13)


def test_box_dropped_flat_bounces_straight_up():
    size, e = (0.2, 0.3, 0.1), 0.5
    model = free_body(pin.Inertia.FromBox(2.0, *size))
    q, v = pin.neutral(model), np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    q[2] = 0.05
    outcome, after, _ = body_impact(model, q, v, corners(size, 0.5, {}), e)
    assert after == pytest.approx([0.0, 0.0, e, 0.0, 0.0, 0.0], abs=1e-14)
    assert outcome.lam[:, 0] == pytest.approx(np.full(4, 2.0 * (1 + e) / 4), rel=1e-10)


def test_rocking_block_keeps_housner_s_share():
    size = (0.2, 0.3, 0.6)
    model = free_body(pin.Inertia.FromBox(2.0, *size))
    assert persistent_scenes.housner(0.2, 0.6) == pytest.approx(0.85, rel=1e-14)
    q = pin.neutral(model)
    q[2] = 0.3
    # it turns about the edge at -x and falls flat
    v = np.array([0.3, 0.0, -0.1, 0.0, 1.0, 0.0])
    outcome, after, bases = body_impact(model, q, v, corners(size, 3.0, {}), 0.0)
    assert after[4] == pytest.approx(0.85, rel=1e-12)
    assert outcome.lam[:2, 0] == pytest.approx([0.0, 0.0], abs=1e-12)  # the old edge leaves by itself
    assert after[2] == pytest.approx(0.1 * 0.85, rel=1e-12)


def line(masses, restitutions, wall=None) -> tuple[np.ndarray, list[Pair]]:
    """Bodies on a line, numbered from the wall on if it has a restitution: mass matrix and pairs."""
    n, pairs = len(masses), []
    for i, e in enumerate(restitutions):
        w = np.zeros((1, 3, n))
        w[0, 0, i : i + 2] = -1.0, 1.0
        pairs.append(Pair(w, 0.0, e))
    if wall is not None:
        w = np.zeros((1, 3, n))
        w[0, 0, 0] = 1.0
        pairs.insert(0, Pair(w, 0.0, wall))
    return np.diag(np.asarray(masses, float)), pairs


@pytest.mark.parametrize(
    ("m1", "m2", "e", "expected"),
    [(1, 1, 1, (1, 0)), (1, 1, 0.5, (0.5, 0)), (1, 1, 0, (0, 0)), (1, 3, 1, (0.5, 0.5)), (1, 3, 0.5, (0.5, 0.25)),
     (1, 3, 0, (0.5, 0)), (3, 1, 1, (1, 0)), (3, 1, 0.5, (0.344, 0.047)), (3, 1, 0, (0, 0))],
)  # fmt: skip
def test_ball_on_a_block_on_the_ground(m1, m2, e, expected):
    """Known results, to three digits where they have three, else exact but for the cut at 1e-9."""
    mass, pairs = line([m2, m1], [1.0], wall=e)
    p, _ = block_impact.sequence(mass, mass @ [0.0, -1.0], pairs)
    block, ball = np.linalg.solve(mass, p)
    assert (ball, block) == pytest.approx(expected, abs=5e-4 if e == 0.5 and m1 == 3 else 1e-8)


def test_plastic_chain_moves_on_together():
    """(1/3, 1/3, 1/3), whatever the order; the energy is Carnot's."""
    mass, pairs = line([1.0] * 3, [0.0] * 2)
    p, hits = block_impact.sequence(mass, np.array([1.0, 0.0, 0.0]), pairs)
    assert p == pytest.approx(np.full(3, 1 / 3), abs=1e-15)
    assert hits == [-1]
    v, loss = persistent_scenes.carnot(mass, np.array([[-1.0, 1, 0], [0, -1, 1]]), np.array([1.0, 0.0, 0.0]))
    assert v == pytest.approx(p, abs=1e-15)
    assert loss == pytest.approx(0.5 - 1 / 6, rel=1e-14)


def test_impacts_never_gain_energy():
    rng = np.random.default_rng(11)
    for _ in range(40):
        m = int(rng.integers(1, 3))  # more rows than coordinates: forces that the cone cannot always share out
        a, w = rng.normal(size=(6, 6)), rng.normal(size=(m, 3, 6))
        mass, p = a @ a.T + 0.05 * np.eye(6), rng.normal(size=6)
        pair = Pair(w, float(rng.uniform(0, 1.5)), float(rng.uniform(0, 1)))
        if (w[:, 0] @ np.linalg.solve(mass, p)).min() >= 0.0:
            continue
        outcome = block_impact.poisson(mass, p, pair)
        assert outcome.restitution == pair.restitution
        assert outcome.loss >= -1e-12 * block_impact.kinetic(mass, p)
        assert (w[:, 0] @ np.linalg.solve(mass, outcome.p_plus)).min() >= -1e-10


# --- closed forms among themselves ------------------------------------------------------------------------------------
def test_painleve():
    assert persistent_scenes.painleve_mu(math.atan(2.0)) == pytest.approx(4.0 / 3.0, rel=1e-14)
    for theta in (0.4, 1.0, 1.3):
        assert persistent_scenes.painleve_number(theta, persistent_scenes.painleve_mu(theta)) == pytest.approx(
            0.0, abs=1e-14
        )
    # A of the same rod in the oracle's matrices: it slides towards -x, its lower end first
    model, theta, mu = free_body(pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 1 / 12.0, 1 / 12.0]))), 1.0, 0.9
    system, q = System(model), pin.neutral(model)
    q[3:7] = pin.Quaternion(pin.exp3(np.array([0.0, -theta, 0.0]))).coeffs()
    q[2] = 0.5 * math.sin(theta)
    points = Points(system.split, [VertexPlane(2, (-0.5, 0.0, 0.0), mu)])
    w = points.gradients(q, [np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])])[0]
    a = w[0] @ np.linalg.solve(system.mass_matrix(q), w[0] + mu * w[1])
    assert a == pytest.approx(persistent_scenes.painleve_number(theta, mu), rel=1e-13)


def test_pendulum_at_its_limit():
    """Small limits: flights of a body thrown up under g, so the end of the bouncing is t1 (1 + e)/(1 - e)."""
    first, speed, end = persistent_scenes.pendulum_at_limit(1e-4, 0.5)
    # the angle's cosine is 1 - 5e-9 there
    assert first == pytest.approx(math.sqrt(2e-4 / GRAVITY), rel=1e-8)
    assert speed == pytest.approx(math.sqrt(2e-4 * GRAVITY), rel=1e-8)
    assert end == pytest.approx(first * 1.5 / 0.5, rel=1e-7)
    # a large one: its first flights by DOP853
    first, speed, end = persistent_scenes.pendulum_at_limit(0.8, 0.5)
    y, flights = np.zeros(2), []
    for _ in range(5):
        run = solve_ivp(swing, (0.0, 9.0), y, "DOP853", rtol=1e-12, atol=1e-14, events=limit_hit)
        flights.append(run.t[-1])
        y = np.array([0.8, -0.5 * run.y[1, -1]])
    assert flights[0] == pytest.approx(first, abs=1e-11)
    assert -2.0 * y[1] == pytest.approx(speed * 0.5**4, rel=1e-10)
    rest = persistent_scenes.pendulum_at_limit(0.8, 0.5)[2] - sum(flights)
    # the rest of the flight starts with the speed -y[1]: between the flights of a plane field and ones a little longer
    plane = 2.0 * -y[1] / (GRAVITY * math.cos(0.8)) / 0.5
    assert 0.0 < (plane - rest) / plane < 0.1
    assert end > sum(flights)


def swing(_t, y):
    return [y[1], GRAVITY * math.cos(y[0])]


def limit_hit(_t, y):
    return y[0] - 0.8


limit_hit.terminal, limit_hit.direction = True, 1.0  # type: ignore[attr-defined]
