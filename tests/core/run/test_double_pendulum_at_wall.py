"""Problem B, a double pendulum at a wall, with CTEC, against the DOP853 oracle in absolute angles."""

from __future__ import annotations

import functools
import pathlib

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers import laws
from helpers.contact_models import problem_b as mechanism
from helpers.contact_models import scene as public_scene
from oracles import ctec_oracle
from oracles import problem_b as oracle

STEPS = (0.04, 0.02, 0.01, 0.005, 0.0025)
ABSOLUTE = np.array([[1.0, 0.0], [1.0, 1.0]])  # absolute = ABSOLUTE @ relative angles
FILE = pathlib.Path(__file__).resolve().parents[3] / "models" / "double_pendulum_wall.toml"
both = pytest.mark.parametrize("source", ["pinocchio", "file"])


@functools.cache
def reference() -> oracle.Run:
    return oracle.run(3.0)


@functools.cache
def run(source: str, h: float) -> cvi.Trajectory:
    """Three seconds with e = 1, from a pin model or from the scene file of the repository."""
    if source == "pinocchio":
        scene, q0 = public_scene(*mechanism()), np.array([0.3, 0.2])
    else:
        scene = cvi.load_scene(FILE)
        q0 = scene.q0
    return cvi.simulate(scene, q0, np.zeros(2), 3.0, h)


@both
def test_the_model_is_problem_b(source):
    model = run(source, 0.04).scene.model
    q, w = np.array([0.4, -0.7]), np.array([0.3, 1.1])
    m = ABSOLUTE.T @ oracle.mass_matrix(ABSOLUTE @ q) @ ABSOLUTE
    # a file may have to give its point masses a small inertia
    assert np.abs(laws.mass_matrix(model, q) - m).max() <= 1e-12
    a = ABSOLUTE @ pin.aba(model, model.createData(), q, w, np.zeros(2))
    assert np.abs(a - oracle.acceleration(ABSOLUTE @ q, ABSOLUTE @ w)).max() <= 1e-11


@both
def test_impacts_converge_to_the_oracle_with_order_two(source):
    exact = np.array([o[:3] for o in reference().impacts])  # time, gamma_minus, impulse
    found = []
    for h in STEPS:
        log = run(source, h).events
        assert len(log) == len(exact) == 2
        found.append(np.column_stack([log.array(name) for name in ("time", "gamma_minus", "impulse")]))
    errors = np.array(found) - exact
    assert np.abs(laws.orders(np.abs(errors[-3:])) - 2.0).max() <= 0.05, errors
    # the h^2 term taken out, what is left is smaller by the change of its constant over the last halving (< 1e-2)
    assert np.abs((4.0 * errors[-1] - errors[-2]) / 3.0).max() <= 1e-2 * STEPS[-1] ** 2, errors


@both
def test_final_position_has_the_known_orders(source):
    errors = [np.linalg.norm(ABSOLUTE @ run(source, h).q[-1] - reference().q) for h in STEPS]
    # to two decimals
    assert np.abs(laws.orders(errors) - [1.96, 1.99, 2.00, 2.00]).max() <= 0.006, errors


@both
@pytest.mark.parametrize("h", STEPS)
def test_each_impact_keeps_energy_and_acts_along_the_gradient(source, h):
    traj = run(source, h)
    model = traj.scene.model
    for event in traj.events:
        minus, plus = (
            0.5 * p @ np.linalg.solve(laws.mass_matrix(model, event.q), p) for p in (event.p_minus, event.p_plus)
        )
        assert abs(plus - minus) <= 1e-12 * minus
        a = ABSOLUTE @ event.q
        gradient = oracle.gap_gradient(a) @ ABSOLUTE
        assert np.abs(event.p_plus - event.p_minus - event.impulse * gradient).max() <= 1e-13
        assert abs(oracle.tip_gap(a)) <= 1e-12
        assert abs(event.gap) <= 1e-12
        hit = ctec_oracle.impact(model, event.q, event.p_minus, gradient, 1.0)
        for name in ("gamma_minus", "gamma_plus", "impulse"):
            assert getattr(event, name) == pytest.approx(getattr(hit, name), rel=1e-12)
        assert event.G_c == pytest.approx(hit.inverse_inertia, rel=1e-12)


@both
def test_nothing_crosses_the_wall(source):
    for h in STEPS:
        gaps = [oracle.tip_gap(ABSOLUTE @ q) for q in run(source, h).q]
        assert min(gaps) >= -1e-10


@pytest.mark.parametrize("restitution", [0.5, 0.9])
def test_inelastic_impacts_follow_the_oracle(restitution):
    exact = oracle.run(1.4, restitution).impacts
    errors = []
    for h in (0.01, 0.005, 0.0025):
        traj = cvi.simulate(public_scene(*mechanism(), restitution), np.array([0.3, 0.2]), np.zeros(2), 1.4, h)
        assert len(traj.events) == len(exact) >= 1
        errors.append([abs(e.time - o[0]) + abs(e.impulse - o[2]) for e, o in zip(traj.events, exact, strict=True)])
        for event in traj.events:
            assert event.gamma_plus == pytest.approx(-restitution * event.gamma_minus, rel=1e-12)
            loss = (1 - restitution**2) * event.gamma_minus**2 / (2 * event.G_c)
            assert event.energy_change == pytest.approx(-loss, rel=1e-11)
    assert np.abs(laws.orders(errors) - 2.0).max() <= 0.1, errors


@pytest.mark.parametrize("wall", [1e-2, 1e-4, 1e-6, 1e-9])
def test_grazing_neither_misses_nor_repeats(wall):
    """Grazing: the wall is just before the tip's turning point, so that gamma- is small."""
    model, geometry = mechanism()
    free = cvi.simulate(cvi.Scene.from_pinocchio(model), np.array([0.3, 0.2]), np.zeros(2), 3.0, 0.01)
    turning = min(oracle.tip_gap(ABSOLUTE @ q) for q in free.q)
    geometry.geometryObjects[1].placement = pin.SE3(np.eye(3), np.array([turning + wall, 0.0, 0.0]))
    scene = public_scene(model, geometry)
    traj = cvi.simulate(scene, np.array([0.3, 0.2]), np.zeros(2), 3.0, 0.01)
    assert len(traj.events) >= 1
    assert all(abs(e.energy_change) <= 1e-8 for e in traj.events)
    gaps = [oracle.tip_gap(ABSOLUTE @ q) - turning - wall for q in traj.q]
    assert min(gaps) >= -1e-10
