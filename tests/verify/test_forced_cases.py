"""The expected values of the forced and constrained cases of `contactvi verify`, found in another way."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from contactvi.verify import cases_forced, cases_loops, systems
from contactvi.verify.verify import CASES, measure
from oracles.slider_clearance import SliderClearance


def energy(model: pin.Model, lengths: tuple[float, float], w: float, phi: float) -> float:
    """Energy of the driven slider-crank, velocities by differences of the places [J]."""

    def place(x: float) -> np.ndarray:
        crank, rod = lengths
        tilt = math.asin(-crank / rod * math.sin(x))
        return np.array([x, tilt - x, crank * math.cos(x) + rod * math.cos(tilt)])

    data, step = model.createData(), 1e-5
    v = w * (place(phi + step) - place(phi - step)) / (2.0 * step)
    return float(
        pin.computeKineticEnergy(model, data, place(phi), v) + pin.computePotentialEnergy(model, data, place(phi))
    )


def test_torque_of_the_slider_crank_by_its_power():
    lengths, masses, w = (0.1, 0.3), (1.0, 2.0, 3.0), 10.0
    model = systems.slider_crank(lengths, masses, w).model
    phi, step = np.linspace(0.1, 6.0, 23), 1e-3
    at = [[energy(model, lengths, w, x + k * step) for x in phi] for k in (-2, -1, 1, 2)]
    slope = np.array([1.0, -8.0, 8.0, -1.0]) @ at / (12.0 * step)  # power over w
    assert cases_loops.crank_torque(phi, w, lengths, masses) == pytest.approx(slope, abs=1e-6)


def test_angles_of_the_four_bar_close_it():
    angles = np.cumsum(systems.four_bar_angles(np.linspace(0.0, 7.0, 50)), axis=1)
    lengths = np.array(systems.FOUR_BAR[:3])
    assert np.cos(angles) @ lengths == pytest.approx(np.full(50, systems.FOUR_BAR[3]), abs=1e-14)
    assert np.sin(angles) @ lengths == pytest.approx(np.zeros(50), abs=1e-14)
    pins = systems.FOUR_BAR[0] * np.sin(angles[:, 0]) + systems.FOUR_BAR[1] * np.sin(angles[:, 1])
    assert np.all(pins > 0.0)  # of coupler and rocker, above the ground


def test_thefirst_touch_is_the_oracles():
    oracle = SliderClearance()  # its own start is that of the case
    first = oracle.run(0.005).impacts[0]
    time, speed = cases_loops.first_touch()
    assert time == pytest.approx(first.time, abs=1e-11)
    assert speed == pytest.approx(-first.gamma_minus[first.corners[0]], rel=1e-8)


@pytest.mark.parametrize("name", ["damped", "screw", "string", "cart", "slider-crank"])
def test_another_gravity_is_found_out(monkeypatch, name):
    for module in (cases_forced, cases_loops):
        monkeypatch.setattr(module, "_G", 1.001 * module._G)
    (case,) = (case for case in CASES if case.name == name)
    result = measure(case)
    assert result.verdict == "FAILED"
    assert all(check.ok for check in result.checks if check.what.startswith(("runs", "phi")))
