"""The oracles of friction laws against closed forms, limits, and balances of energy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from oracles import friction_laws, rolling_spinning
from oracles.event_ode import flow

G = 9.81


def test_spin_and_slide():
    """Limits of spin alone and slide alone; quadrature, exponentials and a plain integration agree."""
    mu, drill, r = 0.3, 0.01, 0.05
    _, stop, _ = rolling_spinning.spin_down(30.0, mu, drill, r)
    assert rolling_spinning.SlidingSpin([0, 0], [0, 0, 30.0], mu, drill, r).stop_time() == pytest.approx(
        stop, rel=1e-14
    )
    ball = rolling_spinning.SlidingSpin([1.0, 0.3], [0.0, 4.0, 30.0], mu, drill, r)
    assert ball.stop_time() == pytest.approx(ball.direct_stop(), rel=1e-9)
    alone = rolling_spinning.SlidingSpin([1.0, 0.0], [0, 0, 0], mu, drill, r)
    assert alone.stop_time() == pytest.approx(1.0 / (mu * G * 3.5), rel=1e-14)
    assert alone.state(1.0)[1] == pytest.approx([5.0 / 7.0, 0.0], abs=1e-12)

    def rhs(t, y):  # v, omega, x: Newton's and Euler's laws as they stand
        s = y[:2] + r * np.array([-y[3], y[2]])
        p = math.hypot(*s, drill * y[4])
        f = -mu * G * s / p
        turn = np.array([r * f[1], -r * f[0], -mu * G * drill * drill * y[4] / p]) / (0.4 * r**2)
        return np.array([*f, *turn, *y[:2]])

    y = flow(rhs, 0.0, np.array([1.0, 0.3, 0.0, 4.0, 30.0, 0.0, 0.0]), 0.2, 1e-12)
    x, v, omega = ball.state(0.2)
    assert x == pytest.approx(y[5:], abs=1e-11)
    assert v == pytest.approx(y[:2], abs=1e-11)
    assert omega == pytest.approx(y[2:5], abs=1e-9)
    assert np.abs(ball.state(ball.stop_time() + 1.0)[2][2]) == 0.0


def test_rolling():
    """Rest on a slope below tan = rho / r, the acceleration above it, and the stop of a ball thrown sliding."""
    r, rho, mu = 0.05, 0.001, 0.3
    a, t, x = rolling_spinning.rolling_stop(1.0, rho, r)
    pieces = rolling_spinning.roll_line(1.0, 20.0, mu, rho, r)
    assert [pieces[-1].t, pieces[-1].x] == pytest.approx([t, x], rel=1e-13)
    assert [pieces[-1].v, pieces[-1].w, pieces[-1].dv, pieces[-1].dw] == [0.0, 0.0, 0.0, 0.0]
    for slope, moves in ((math.atan(0.0199), False), (math.atan(0.0201), True)):
        (piece,) = rolling_spinning.roll_line(0.0, 0.0, mu, rho, r, slope=slope)
        want = G * (math.sin(slope) - rho / r * math.cos(slope)) / 1.4 if moves else 0.0
        assert piece.dv == pytest.approx(want, abs=1e-15)
        assert piece.dw * r == pytest.approx(want, abs=1e-15)
    thrown = rolling_spinning.roll_line(1.0, 0.0, mu, rho, r)  # slides, rolls, rests
    assert len(thrown) == 3
    heat = mu * G * sum(abs(s * d) for s, d in [(0.5, thrown[1].t)])  # mean slip over the sliding time
    turned = rho * G * thrown[-1].angle
    assert heat + turned == pytest.approx(0.5, rel=1e-13)
    assert rolling_spinning.roll_line(-1.0, 50.0, mu, rho, r)[-1].v == 0.0  # back-spin


def test_stick_slip():
    """A constant sliding coefficient in closed form, the balance of energy, and a run that falls into the cycle."""
    constant = friction_laws.Oscillator(1.0, 100.0, 10.0, 0.1, 0.6, lambda v: 0.3)
    cycle = constant.cycle()
    want = friction_laws.constant_cycle(1.0, 100.0, 10.0, 0.1, 0.6, 0.3)
    assert [cycle["slip"], cycle["stick"]] == pytest.approx(want, rel=1e-12)
    curved = friction_laws.Oscillator(1.0, 100.0, 10.0, 0.1, 0.6, friction_laws.stribeck(0.6, 0.3, 0.2))
    cycle = curved.cycle()
    assert cycle["heat"] == pytest.approx(cycle["belt_work"], rel=1e-11)
    pieces = curved.run(0.0, 0.0, 0.0, 5.0)
    starts = [p[0] for p in pieces if p[3] == "slip"][1:]
    assert np.diff(starts) == pytest.approx(cycle["period"], rel=1e-11)


def test_ellipse():
    """A circle gives a straight line; quadrature, exponentials over tau and a plain integration agree."""
    circle = friction_laws.Ellipse([0.6, 0.8], 0.3, 0.3)
    assert circle.time() == pytest.approx(1.0 / (0.3 * G), rel=1e-13)
    assert circle.position() == pytest.approx(np.array([0.6, 0.8]) / (0.6 * G), rel=1e-13)
    slide = friction_laws.Ellipse([1.0, 1.0], 0.5, 0.2)

    def rhs(t, y):
        p = math.hypot(0.5 * y[2], 0.2 * y[3])
        return np.array([y[2], y[3], -G * 0.25 * y[2] / p, -G * 0.04 * y[3] / p])

    y = flow(rhs, 0.0, np.array([0.0, 0.0, 1.0, 1.0]), 0.3, 1e-12)
    x, v = slide.at(0.3)
    assert [*x, *v] == pytest.approx(y, abs=1e-11)
    x, v = slide.at(5.0)
    assert x == pytest.approx(slide.position(), abs=1e-12)
    assert not v.any()
    t, x, v = friction_laws.ellipse_incline([1.0, 1.0], [0.0, 0.0], 0.5, 0.2, G, 9.0)
    assert t == pytest.approx(slide.time(), rel=1e-12)
    assert x == pytest.approx(slide.position(), abs=1e-12)
    assert friction_laws.ellipse_holds([0.29 * G, 0.0], 0.3, 0.1, G)
    assert not friction_laws.ellipse_holds([0.0, 0.11 * G], 0.3, 0.1, G)


def test_conveyor():
    """Energy: the belt's work is heat and kinetic energy; a constant belt in closed form and as a function of time."""
    t, x, heat, work = friction_laws.conveyor([0.0, 0.3], [1.0, 0.0], 0.4)
    assert work == pytest.approx(heat + 0.5 * (1.0 - 0.09), rel=1e-14)
    t, x, heat, work = friction_laws.conveyor([0.0, 0.0], [1.0, 0.0], 0.4)
    y, log = friction_laws.conveyor_moving(lambda t: 1.0, lambda t: 0.0, 0.0, 0.4, 1.0)
    assert y == pytest.approx([x[0] + 1.0 - t, 1.0, heat, work], rel=1e-13)
    assert log[1][0] == pytest.approx(t, rel=1e-13)
    y, log = friction_laws.conveyor_moving(lambda t: math.sin(4 * t), lambda t: 4 * math.cos(4 * t), 0.0, 0.3, 3.0)
    assert y[3] == pytest.approx(y[2] + 0.5 * y[1] ** 2, abs=1e-12)
    assert len(log) > 4


def test_suction():
    t = friction_laws.suction_release(0.5, 20.0, 1.0, 4.0)
    assert 0.5 * G + 1.0 + 4.0 * t == pytest.approx(20.0, rel=1e-15)
    assert friction_laws.suction_fall(t, 0.5, 20.0, 1.0, 4.0) == (0.0, 0.0)
    h = 1e-4
    fall = [friction_laws.suction_fall(t + x, 0.5, 20.0, 1.0, 4.0)[0] for x in (1.0 - h, 1.0, 1.0 + h)]
    assert (fall[0] - 2 * fall[1] + fall[2]) / h**2 == pytest.approx(G + (1.0 + 4.0 * (t + 1.0)) / 0.5, rel=1e-6)
