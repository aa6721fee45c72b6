"""The oracle of compliant contact: quadratures against integrations, closed forms, and the stiff limit."""

from __future__ import annotations

import math

import pytest

from oracles import compliant_contact as compliant

G = 9.81


@pytest.mark.parametrize("n", [1.0, 1.5])
@pytest.mark.parametrize("k", [1e3, 1e8])
def test_quadrature_and_integration(n, k):
    for gravity in (0.0, G):
        found = compliant.contact(0.1, k, n, 1.3, 0.0, gravity)
        assert found.time == pytest.approx(compliant.contact_time(0.1, k, n, 1.3, gravity), rel=1e-11)
        assert found.deepest == pytest.approx(compliant.penetration(0.1, k, n, 1.3, gravity), rel=1e-12)
        assert found.speed == pytest.approx(1.3, rel=1e-12)


def test_linear_spring_in_closed_form():
    """Half a period without gravity; with it pi + 2 atan(g / (omega v)) over omega."""
    m, k, v = 0.1, 1e4, 0.5
    omega = math.sqrt(k / m)
    assert compliant.contact_time(m, k, 1.0, v) == pytest.approx(math.pi / omega, rel=1e-14)
    want = (math.pi + 2.0 * math.atan2(G, omega * v)) / omega
    assert compliant.contact_time(m, k, 1.0, v, G) == pytest.approx(want, rel=1e-13)
    depth = (G + math.hypot(G, omega * v)) / omega**2
    assert compliant.penetration(m, k, 1.0, v, G) == pytest.approx(depth, rel=1e-14)


@pytest.mark.parametrize("n", [1.0, 1.5])
def test_damped_without_gravity(n):
    """The restitution and the depth in closed form; e = 1 - 2 c v / 3 for small damping."""
    for c in (0.1, 0.5, 3.0):
        found = compliant.contact(0.1, 1e6, n, 1.2, c, 0.0)
        assert found.speed / 1.2 == pytest.approx(compliant.restitution(1.2, c), rel=1e-11)
        assert found.deepest == pytest.approx(compliant.damped_penetration(0.1, 1e6, n, 1.2, c), rel=1e-11)
    assert compliant.restitution(1.0, 1e-4) == pytest.approx(1.0 - 2e-4 / 3.0, abs=1e-8)


def test_drops_and_the_stiff_limit():
    """As k grows the touches go to those of a rigid ball with the restitution of each speed."""
    for k, close in ((1e6, 3e-3), (1e8, 4e-4)):
        found = compliant.drops(0.5, 0.1, k, 1.0, 0.1, 3)
        t, v = math.sqrt(1.0 / G), math.sqrt(G)
        for touch, _, _, speed in found:
            assert touch == pytest.approx(t, abs=close)
            v *= compliant.restitution(v, 0.1)
            assert speed == pytest.approx(v, abs=close)
            t += 2.0 * v / G
    touch, release, deepest, speed = compliant.drops(0.5, 0.1, 1e6, 1.5, 0.1, 2)[1]
    gap, v = compliant.position(release, 0.5, 0.1, 1e6, 1.5, 0.1)
    assert gap == pytest.approx(0.0, abs=1e-11)
    assert v == pytest.approx(speed, rel=1e-10)
    assert compliant.position(touch, 0.5, 0.1, 1e6, 1.5, 0.1)[0] == pytest.approx(0.0, abs=1e-13)
    assert deepest > 0.0
