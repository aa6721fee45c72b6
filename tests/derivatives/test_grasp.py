"""The derivatives of a grasp: of the place of a ball, by the servos of the hand around it and by the start."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import FOURTH
from helpers.grasp_scene import closed, grasp

OPTIONS = {"dt": 1e-3, "order": 2, "contact_mode": "events", "solver_tol": 1e-14}
CLOSING = 0.077  # s


def test_the_place_of_the_ball_by_servos_and_start():
    scene, q, v = grasp(0.0, 0.8)
    nv = scene.nv
    traj = cvi.simulate(scene, q, v, duration=CLOSING, record="gradient", **OPTIONS)
    changes = {change.change for change in traj.contact_changes}
    assert len(traj.events) >= 30
    assert {"begin", "release", "slip", "stick"} <= changes
    weights = np.r_[np.zeros(nv - 6), 1.0, 2.0, 3.0, np.zeros(3)]  # of the ball's velocity, and as much of its place
    _, found = cvi.gradient(traj, (weights, 0.01 * weights), ["target", "q0", "v0", "friction"])
    S = traj.sensitivity(["q0", "v0", "friction"])
    for name in S.names:
        forward = np.r_[weights, 0.01 * weights] @ S.of(name)[-1]
        assert np.abs(forward - found[name]).max() <= 1e-10 * np.abs(forward).max()
    rng = np.random.default_rng(0)
    by_target, by_q, by_v = rng.standard_normal(nv - 6), rng.standard_normal(nv), rng.standard_normal(nv)

    def end(size: float) -> float:
        start = pin.integrate(scene.model, q, size * by_q), v + size * by_v
        run = cvi.simulate(
            scene, *start, duration=CLOSING, target=closed(scene) + size * by_target, record="gradient", **OPTIONS
        )
        assert [c.change for c in run.contact_changes] == [c.change for c in traj.contact_changes]
        moved = np.r_[pin.difference(scene.model, traj.q[-1], run.q[-1]), run.v[-1]]
        return float(np.r_[weights, 0.01 * weights] @ moved)

    exact = by_target @ found["target"].sum(axis=0) + by_q @ found["q0"] + by_v @ found["v0"]
    coarse, fine = (sum(weight / h * end(count * h) for count, weight in FOURTH) for h in (4e-7, 2e-7))
    assert abs(fine - coarse) <= 1e-5 * abs(fine)
    assert abs(exact - fine) <= 1e-7 * abs(fine) + abs(fine - coarse)


def test_the_derivatives_are_those_of_differences():
    scene, q, v = grasp(0.0, 0.8)
    check = cvi.check_gradient(scene, q, v, duration=0.06, columns=12, **OPTIONS)
    assert [column.believe for column in check.columns] == ["both"] * 12


def test_a_kink_in_the_way_is_told():
    """A finger lets go as another one comes to stick: the time of that is no zero of a force."""
    scene, q, v = grasp(0.0, 0.8)
    traj = cvi.simulate(scene, q, v, duration=0.1, record="gradient", **OPTIONS)
    for ask in (traj.sensitivity, lambda: cvi.gradient(traj, (np.ones(scene.nv), np.ones(scene.nv)), ["q0"])):
        with pytest.raises(cvi.NotDifferentiable) as found:
            ask()
        assert found.value.reason == "release"
        assert "ball" in found.value.pair
        assert CLOSING < found.value.time < 0.082
