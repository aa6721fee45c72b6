"""The oracle of the slider-crank with clearance against Pinocchio, differences and the laws of impact."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from oracles.slider_clearance import SPEEDS, SliderClearance

EPS = np.finfo(float).eps
RELATIVE = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])  # q_pin = RELATIVE q
TURNED = (0.0, 0.0, 0.005)  # [rad], a start from which single corners hit


def test_dynamics_are_those_of_the_pinocchio_model():
    slider, rng = SliderClearance(), np.random.default_rng(0)
    model = slider.model()
    data = model.createData()
    for _ in range(5):
        q, w = rng.uniform(-3.0, 3.0, 3), rng.uniform(-100.0, 100.0, 3)
        m = np.triu(pin.crba(model, data, RELATIVE @ q))
        m = RELATIVE.T @ (m + np.triu(m, 1).T) @ RELATIVE
        assert np.abs(m - slider.mass_matrix(q)).max() <= 16 * EPS * np.abs(m).max()
        a = pin.aba(model, data, RELATIVE @ q, RELATIVE @ w, np.zeros(3))
        # in relative angles the slider's inertia, 2.7e-6, is a difference of terms of 1e-2
        assert np.abs(a - RELATIVE @ slider.acceleration(q, w)).max() <= 1e4 * EPS * np.abs(a).max()
        energy = pin.computeMechanicalEnergy(model, data, RELATIVE @ q, RELATIVE @ w)
        assert energy == pytest.approx(slider.energy(q, w), rel=64 * EPS)
        pin.forwardKinematics(model, data, RELATIVE @ q)
        places = [data.oMi[3].act(np.array([x, y, 0.0]))[:2] for y in (0.025, -0.025) for x in (-0.05, 0.05)]
        assert np.abs(slider.corners(q) - places).max() <= 8 * EPS


def test_gaps_and_their_derivatives():
    slider, rng = SliderClearance(), np.random.default_rng(1)
    assert slider.gaps(np.zeros(3)) == pytest.approx(np.full(4, 0.001), abs=EPS)
    q, w, h = rng.uniform(-3.0, 3.0, 3), rng.uniform(-1.0, 1.0, 3), 1e-3
    a = slider.acceleration(q, w)

    def curve(s):
        return q + s * w + 0.5 * s * s * a

    stencil = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
    rate = sum(k * (slider.gaps(curve(n * h)) - slider.gaps(curve(-n * h))) for n, k in stencil) / h
    assert np.abs(rate - slider.gap_gradients(q) @ w).max() <= 1e-12
    along = sum(k * (slider.corners(curve(n * h)) - slider.corners(curve(-n * h)))[:, 0] for n, k in stencil) / h
    assert np.abs(along - slider.slip_gradients(q) @ w).max() <= 1e-12
    second = sum(
        k
        * (slider.gap_gradients(curve(n * h)) @ (w + n * h * a) - slider.gap_gradients(curve(-n * h)) @ (w - n * h * a))
        for n, k in stencil
    )
    assert np.abs(second / h - slider.gap_accelerations(q, w)).max() <= 1e-10


@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), TURNED], ids=["parallel", "turned"])
@pytest.mark.parametrize("mu", [0.0, 0.01, 0.3])
def test_impacts_obey_their_law(mu, start):
    slider = SliderClearance(mu=mu)
    run = slider.run(0.2, start, most=8)
    assert run.reason == "count"
    energy = slider.energy(np.array(start), np.array(SPEEDS))
    for hit in run.impacts:
        normal, slip = slider.gap_gradients(hit.q), slider.slip_gradients(hit.q)
        assert np.abs(slider.gaps(hit.q)[hit.corners]).max() <= 1e-15
        assert slider.gaps(hit.q).min() >= -1e-15
        assert np.abs(hit.gamma_minus - normal @ hit.w_minus).max() <= 1e-12
        # no corner's combination opens in these runs: Newton's law for each
        assert np.abs(normal @ hit.w_plus + 0.4 * hit.gamma_minus)[hit.corners].max() <= 1e-11
        balance = normal.T @ hit.impulses[:, 0] + slip.T @ hit.impulses[:, 1]
        change = slider.mass_matrix(hit.q) @ (hit.w_plus - hit.w_minus)
        assert np.abs(change - balance).max() <= 1e-13
        p, tangential, sliding = hit.impulses[hit.corners].T[0], hit.impulses[hit.corners].T[1], slip @ hit.w_plus
        assert p.min() >= 0.0
        assert np.abs(tangential + mu * p * np.sign(sliding[hit.corners])).max() <= 1e-15
        # flights keep the energy, impacts do not add to it
        assert slider.energy(hit.q, hit.w_minus) == pytest.approx(energy, rel=1e-12)
        assert slider.energy(hit.q, hit.w_plus) < slider.energy(hit.q, hit.w_minus)
        energy = slider.energy(hit.q, hit.w_plus)


def test_the_parallel_slider_stays_parallel():
    for mu in (0.0, 0.01):
        run = SliderClearance(mu=mu).run()
        assert run.reason == "accumulation"
        assert all(hit.corners == [0, 1] for hit in run.impacts)
        assert max(abs(hit.w_plus[2]) for hit in run.impacts) <= 1e-11  # of 150
        assert max(abs(hit.q[2]) for hit in run.impacts) <= 1e-14


def test_one_corner_without_friction_is_the_classical_formula():
    slider = SliderClearance(mu=0.0)
    hit = slider.run(0.2, TURNED, most=1).impacts[0]
    (k,) = hit.corners
    normal = slider.gap_gradients(hit.q)[k]
    inverse = normal @ np.linalg.solve(slider.mass_matrix(hit.q), normal)
    assert hit.impulses[k, 0] == pytest.approx(-1.4 * hit.gamma_minus[k] / inverse, rel=1e-12)
    loss = slider.energy(hit.q, hit.w_minus) - slider.energy(hit.q, hit.w_plus)
    assert loss == pytest.approx(0.5 * (1.0 - 0.16) * hit.gamma_minus[k] ** 2 / inverse, rel=1e-10)


@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), TURNED], ids=["parallel", "turned"])
def test_time_of_the_first_impact_by_pinocchio(start):
    """Another Runge-Kutta pair on pin.aba meets the wall at that time and speed, and not before."""
    slider = SliderClearance()
    model = slider.model()
    data, hit = model.createData(), slider.run(0.2, start, most=1).impacts[0]

    def rhs(_t, y):
        return np.concatenate([y[3:], pin.aba(model, data, y[:3], y[3:], np.zeros(3))])

    def flow(duration):
        y0 = np.concatenate([RELATIVE @ start, RELATIVE @ SPEEDS])
        y = solve_ivp(rhs, (0.0, duration), y0, method="RK45", rtol=1e-13, atol=1e-13).y[:, -1]
        back = np.linalg.inv(RELATIVE)
        return back @ y[:3], back @ y[3:]

    q, w = flow(hit.time)
    assert np.abs(slider.gaps(q)[hit.corners]).max() <= 1e-12  # at 1 m/s: a time to 1e-12 s
    assert np.abs(slider.gap_gradients(q) @ w - hit.gamma_minus).max() <= 1e-9
    q, _ = flow(hit.time * (1.0 - 1e-6))
    assert slider.gaps(q).min() > 0.0
