"""The oracles of the toys: balances, other equations of the same body, and Moreau's steps coming to the same motion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from oracles import tippe_top, woodpecker
from oracles.event_ode import flow


def test_woodpecker_cycle():
    """Period, drop and stability; energy falls at every event but the weight's work is all there is to fall."""
    period, drop, slope, motion = woodpecker.limit_cycle()
    assert period == pytest.approx(0.145976065144, abs=1e-11)
    assert drop == pytest.approx(19.4453792849e-3, abs=1e-12)
    assert abs(slope) < 1.0
    energies = [woodpecker.energy(q, u) for _, q, u, _ in motion.log]
    assert np.diff(energies).max() <= 1e-15
    weight = woodpecker.GRAVITY * (woodpecker.MASS_M + woodpecker.MASS_S)
    assert energies[0] - energies[-1] == pytest.approx(weight * drop, rel=1e-9)
    for _, q, _, _ in motion.log:
        assert woodpecker.gaps(q).min() >= -1e-13


def test_woodpecker_with_poissons_law():
    """Where the beak slips one way in compression and expansion, Poisson's restitution is Newton's."""
    want = woodpecker.run(0.3).log
    found = woodpecker.run(0.3, law="two_phase").log
    assert len(found) == len(want)
    for a, b in zip(found, want, strict=True):
        assert [a[0], *a[1], *a[2]] == pytest.approx([b[0], *b[1], *b[2]], abs=1e-9)


def test_woodpecker_in_steps():
    """Moreau's steps come to the located events as the step falls: the first strike of the beak."""
    log = woodpecker.run(0.1).log
    t, q, _, _ = next(x for x in log if x[3] == "0 closes")
    errors = []
    for dt in (4e-5, 1e-5):
        rows = woodpecker.moreau(0.09, dt)
        at = np.nonzero(np.diff(rows[:, 6]) < -10.0)[0][0]
        errors.append([abs(rows[at, 0] - t), abs(rows[at, 1] - q[0])])
    assert errors[1][0] <= 5e-5
    assert errors[1][1] <= 2e-5


def euler_angles(top: tippe_top.Top, y: np.ndarray) -> np.ndarray:
    """Rates of (x, y, theta, phi, psi, their rates), touching with the large sphere: Lagrange's equations of Leine."""
    theta, phi = y[2], y[3]
    u = y[5:]
    s, c, sp, cp = math.sin(theta), math.cos(theta), math.sin(phi), math.cos(phi)
    a, r, i1, i3, m = top.a[0], top.r[0], top.i1, top.i3, top.mass
    mass = np.diag([m, m, m, i1, i1 * s * s + i3 * c * c, i3])
    mass[4, 5] = mass[5, 4] = i3 * c
    dt, dp, ds = u[2], u[3], u[4]
    h = np.array(
        [
            0.0,
            0.0,
            -m * tippe_top.GRAVITY,
            ((i1 - i3) * dp * c - i3 * ds) * dp * s,
            -(2.0 * (i1 - i3) * dp * c - i3 * ds) * dt * s,
            i3 * dp * dt * s,
        ]
    )
    k = a * c - r
    w = np.array(
        [
            [0.0, 0.0, 1.0, -a * s, 0.0, 0.0],
            [1.0, 0.0, 0.0, k * sp, a * s * cp, r * s * cp],
            [0.0, 1.0, 0.0, -k * cp, a * s * sp, r * s * sp],
            [0.0, 0.0, 0.0, 0.0, top.drill, top.drill * c],
        ]
    )
    full = np.array([u[0], u[1], a * s * dt, dt, dp, ds])
    slip = w[1:] @ full
    push = w[0] - top.mu * w[1:].T @ (slip / np.linalg.norm(slip))
    inverse = np.linalg.inv(mass)
    n = -(w[0] @ inverse @ h - a * c * dt * dt) / (w[0] @ inverse @ push)
    du = inverse @ (h + push * n)
    return np.concatenate([u, du[[0, 1, 3, 4, 5]]])


def test_tippe_top_in_euler_angles():
    """The same motion from Lagrange's equations in the angles, which are near their singularity at 0.1 s."""
    top = tippe_top.Top()
    y = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 180.0])
    y = flow(lambda t, y: euler_angles(top, y), 0.0, y, 0.5, 1e-12, 1e-14)
    motion = tippe_top.run(0.5)
    assert abs(y[2]) == pytest.approx(motion.theta(0.5), abs=2e-8)
    assert motion.log[-1][1][:2] == pytest.approx(y[:2], abs=1e-9)


def test_tippe_top():
    """The inclinations, the touch of the stem, and energy that falls."""
    motion = tippe_top.run(1.6)
    assert [text for _, _, text in motion.log] == ["start", "1 closes", "in touch: (1,)", "end"]
    assert motion.log[1][0] == pytest.approx(1.3710432514, abs=1e-8)
    want = {0.25: 0.1355735119, 0.5: 0.5180101458, 0.75: 1.0569193636, 1.0: 1.5725914174, 1.5: 3.0725365}
    for t, theta in want.items():
        assert motion.theta(t) == pytest.approx(theta, abs=2e-8 if t <= 1.0 else 1e-6)
    top = tippe_top.Top()
    energies = [top.energy(motion.state(t)) for t in np.linspace(0.0, 1.6, 161)]
    assert energies[0] == pytest.approx(0.0120472022, abs=1e-10)
    assert np.diff(energies).max() < 0.0


def test_tippe_top_in_steps():
    """Moreau's steps come to the same inclination with the first order of the step."""
    motion, errors = tippe_top.run(0.25), []
    for dt in (2e-4, 1e-4):
        _, states = tippe_top.moreau(0.25, dt)
        e = states[-1][6:9]
        errors.append(math.atan2(math.hypot(e[0], e[1]), e[2]) - motion.theta(0.25))
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.2)
    assert abs(errors[1]) < 3e-3
