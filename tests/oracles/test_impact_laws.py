"""The oracles of impact laws against each other: the planar closed forms, energy, limits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from oracles import impact_laws, planar_impacts, super_ball

LAWS = ("poisson", "newton", "energetic")


def random_delassus(rng, couple: float = 0.5) -> np.ndarray:
    """A positive definite matrix (3, 3) whose normal row couples moderately with the tangential ones."""
    a = rng.normal(size=(3, 6))
    g = a @ a.T / 6.0
    g[0, 1:] *= couple
    g[1:, 0] *= couple
    return g


@pytest.mark.parametrize("law", LAWS)
def test_incremental_law_equals_the_planar_closed_form(law):
    """The integration of the impulse process with a slip along one axis, against Routh's lines; all kinds of it."""
    rng, seen = np.random.default_rng(1), set()
    for _ in range(25):
        theta, mu, e = rng.uniform(0.2, 1.4), rng.uniform(0.05, 0.9), rng.uniform(0.0, 1.0)
        g2 = planar_impacts.rod_delassus(theta)
        velocity = np.array([-1.0, rng.uniform(-1.5, 1.5)])
        try:
            want = planar_impacts.incremental(g2, velocity, mu, e, law)
        except ArithmeticError:
            continue  # Newton's end may never come, and a rod may jam
        g = np.zeros((3, 3))
        g[:2, :2], g[2, 2] = g2, 1.3
        found = impact_laws.incremental(g, [*velocity, 0.0], mu, e, law)
        assert found.impulse == pytest.approx([*want.impulse, 0.0], abs=2e-12 * abs(want.impulse[0]))
        assert found.gamma == pytest.approx([*want.velocity, 0.0], abs=5e-12 * max(1.0, abs(want.impulse[0])))
        assert found.compression == pytest.approx(want.compression, rel=2e-12)
        seen |= set(want.phases)
    assert seen == {"slip", "stick", "slip again"}


@pytest.mark.parametrize("e", [0.0, 0.4, 1.0])
def test_complementarity_laws_equal_the_planar_ones(e):
    rng = np.random.default_rng(2)
    for _ in range(30):
        g2 = planar_impacts.rod_delassus(rng.uniform(0.2, 1.4))
        velocity, mu = np.array([-1.0, rng.uniform(-1.5, 1.5)]), rng.uniform(0.05, 0.9)
        g = np.zeros((3, 3))
        g[:2, :2], g[2, 2] = g2, 1.3
        for name, solver in (("complementarity", impact_laws.newton), ("two_phase", impact_laws.poisson)):
            want = planar_impacts.solve(g2, velocity, mu, e, name)
            found = solver(g, [*velocity, 0.0], mu, e)
            assert found.impulse == pytest.approx([*want.impulse, 0.0], abs=1e-12 * (1.0 + want.impulse[0]))


def test_laws_agree_where_nothing_couples():
    """Without coupling of the rows, and slip to the end or to a stick, all five laws give the same impulse."""
    g = np.diag([1.0, 3.5, 3.5])
    for gamma in ([-1.0, 6.0, 2.0], [-1.0, 0.3, -0.1]):
        want = impact_laws.newton(g, gamma, 0.4, 0.6).impulse
        assert impact_laws.poisson(g, gamma, 0.4, 0.6).impulse == pytest.approx(want, abs=1e-13)
        for law in LAWS:
            assert impact_laws.incremental(g, gamma, 0.4, 0.6, law).impulse == pytest.approx(want, abs=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_incremental_law_in_space(seed):
    """The ends hold, the energetic law never gains energy, and crude steps of the impulse come to the same impulse."""
    rng = np.random.default_rng(seed)
    g, mu, e = random_delassus(rng), rng.uniform(0.1, 0.8), rng.uniform(0.1, 1.0)
    gamma = np.array([-1.0, *rng.normal(size=2)])
    found = {law: impact_laws.incremental(g, gamma, mu, e, law) for law in LAWS}
    assert found["poisson"].impulse[0] == pytest.approx((1.0 + e) * found["poisson"].compression, rel=1e-12)
    assert found["newton"].gamma[0] == pytest.approx(e, rel=1e-12)
    assert impact_laws.kinetic_change(g, gamma, found["energetic"].impulse) <= 1e-13
    for impact in found.values():
        assert impact.gamma == pytest.approx(gamma + g @ impact.impulse, abs=1e-13)
        assert np.linalg.norm(impact.impulse[1:]) <= mu * impact.impulse[0] * (1.0 + 1e-12)
    end, n = found["poisson"].impulse[0], 4_000
    lam, step = np.zeros(3), end / n
    for _ in range(n):  # implicit in the friction: Coulomb at the end of each small impulse
        now = gamma + g @ lam
        push = impact_laws.friction_impulse(g[1:, 1:], now[1:] + g[1:, 0] * step, mu * step)
        lam += [step, *push]
    assert lam == pytest.approx(found["poisson"].impulse, abs=3e-3)


def test_energy_of_newtons_law_may_grow():
    """The double pendulum at the ground: Newton's laws gain energy for some friction, the energetic one never."""
    gains = [planar_impacts.pendulum_impact("newton", e=0.5, mu=mu)[2] for mu in np.linspace(0.0, 1.0, 41)]
    safe = [planar_impacts.pendulum_impact("energetic", e=0.5, mu=mu)[2] for mu in np.linspace(0.0, 1.0, 41)]
    assert max(safe) < 0.0
    assert max(gains) > 0.01


def test_slip_where_friction_is_too_weak_to_hold():
    """In space a slip then turns past zero into the one direction where it can grow; from rest it starts there."""
    g, mu = np.array([[1.0, 0.7, 0.3], [0.7, 2.0, 0.4], [0.3, 0.4, 1.5]]), 0.2
    angle = impact_laws.slip_direction(g, mu)
    still = impact_laws.incremental(g, [-1.0, 0.0, 0.0], mu, 0.8)
    assert [name for name, _, _ in still.phases] == ["slip again", "slip again"]
    assert math.remainder(math.atan2(*still.gamma[:0:-1]) - angle, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)
    for gamma in ([-1.0, -0.2, 0.05], [-1.0, -0.2, 1e-3]):
        impact = impact_laws.incremental(g, gamma, mu, 0.8)
        assert [name for name, _, _ in impact.phases] == ["slip", "slip"]
        assert np.linalg.norm(impact.impulse[1:]) < 0.95 * mu * impact.impulse[0]
        assert impact_laws.kinetic_change(g, np.array(gamma), impact.impulse) < 0.0
    # as the limit of small slip
    small = impact_laws.incremental(g, [-1.0, -1e-9, 2e-9], mu, 0.8)
    assert small.impulse == pytest.approx(still.impulse, abs=1e-7)


def test_rod_without_friction():
    """The closed form of a rod that falls: v_com = -1 + P, omega = 6 P cos(theta), P = (1 + e) / (1 + 3 cos^2)."""
    theta, e = 0.7, 0.8
    for law in ("complementarity", "two_phase", *LAWS):
        after, _ = planar_impacts.rod_impact(theta, np.array([0.3, -1.0, 0.0]), 0.0, e, law)
        p = (1.0 + e) / (1.0 + 3.0 * math.cos(theta) ** 2)
        assert after == pytest.approx([0.3, -1.0 + p, -6.0 * p * math.cos(theta)], abs=1e-14)


def test_super_ball():
    """Energy of a grip, Garwin's ball that comes back to its state after two bounces, and the limit e_t = 0, e."""
    v, omega, radius = np.array([1.0, -0.4, -2.0]), np.array([3.0, 20.0, 5.0]), 0.03
    for e, tangential in ((1.0, 1.0), (0.8, 0.5), (0.3, -1.0)):
        after = super_ball.bounce(v, omega, e, tangential, 1e3, radius)
        s = super_ball.slip(v, omega, radius)
        loss = super_ball.energy(v, omega, radius) - super_ball.energy(after.v, after.omega, radius)
        want = 0.5 * (1.0 - e**2) * v[2] ** 2 + 0.5 * (1.0 - tangential**2) * 0.4 / 1.4 * (s @ s)
        assert loss == pytest.approx(want, abs=1e-13)
        assert super_ball.slip(after.v, after.omega, radius) == pytest.approx(-tangential * s, abs=1e-13)
    runs = super_ball.hops([0.0, 0.0, 0.5], [1.0, 0.2, 0.0], [3.0, 1.0, 2.0], 5, 1.0, 1.0, 1e3, radius)
    assert runs[3][2].v == pytest.approx(runs[1][2].v, abs=1e-13)
    assert runs[3][2].omega == pytest.approx(runs[1][2].omega, abs=1e-12)
    # no tangential restitution: all the laws of one point on this Delassus matrix
    g, gamma = np.diag([1.0, 3.5, 3.5]), np.array([v[2], *super_ball.slip(v, omega, radius)])
    for mu in (0.02, 5.0):
        want = impact_laws.newton(g, gamma, mu, 0.7).impulse
        assert super_ball.bounce(v, omega, 0.7, 0.0, mu, radius).impulse == pytest.approx([want[1], want[2], want[0]])
