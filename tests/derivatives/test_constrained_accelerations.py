"""Accelerations under constraints and their derivatives: against runs, differences and steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import FOURTH
from helpers import constrained_scenes as scenes

SCENES: dict[str, Callable[[], scenes.Start]] = {
    "loop": scenes.linkage,
    "redundant loop": lambda: scenes.linkage(redundant=True),
    "driven joint": scenes.driven_joint,
    "mixed joints": scenes.mixed_joints,
    "equalities": scenes.followers,
    "rod": lambda: scenes.box_on_rod(driven=False),
    "driven rod": lambda: scenes.box_on_rod(driven=True),
    "prescribed pose": scenes.moved_pendulum,
    "point": lambda: scenes.pair_of_bodies(lambda s: s.add_point("a", "b", (0.1, 0.2, 0.05))),
    "weld": lambda: scenes.pair_of_bodies(lambda s: s.add_weld("a", "b")),
    "hinge": lambda: scenes.pair_of_bodies(lambda s: s.add_screw("a", "b", 0.0, scenes.TWISTED)),
}


@pytest.fixture(params=SCENES, scope="module")
def start(request) -> tuple[cvi.Scene, np.ndarray, np.ndarray, np.ndarray]:
    scene, q, v = SCENES[request.param]()
    q, v = scenes.on_constraints(scene, q, v)
    return scene, q, v, np.random.default_rng(3).uniform(-0.3, 0.3, scene.nv)


def test_the_acceleration_is_that_of_a_run(start):
    scene, q, v, tau = start
    found = cvi.forward_dynamics_derivatives(scene, q, v, tau)
    rates = []
    for dt in (2e-4, 1e-4):
        run = cvi.simulate(scene, q, v, duration=dt, dt=dt, control=lambda t, q, v: tau, ledger=None)
        rates.append((run.v[-1] - v) / dt)
    assert np.abs(found.a).max() > 0.1
    size = 1.0 + np.abs(found.a).max()
    # First order in the step, extrapolated.
    assert np.abs(2.0 * rates[1] - rates[0] - found.a).max() <= 1e-6 * size * (1.0 + np.abs(v).max()) ** 3


def test_the_derivatives_are_those_of_differences(start):
    scene, q, v, tau = start
    found, size, nv = cvi.forward_dynamics_derivatives(scene, q, v, tau), 1e-3, scene.nv

    def difference(change: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        return np.column_stack([
            sum(weight / size * change(count * size * np.eye(nv)[k]) for count, weight in FOURTH) for k in range(nv)
        ])  # fmt: skip

    def acceleration(q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return cvi.forward_dynamics_derivatives(scene, q, v, tau).a

    for exact, wanted in (
        (found.a_q, difference(lambda d: acceleration(pin.integrate(scene.model, q, d), v, tau))),
        (found.a_v, difference(lambda d: acceleration(q, v + d, tau))),
        (found.a_tau, difference(lambda d: acceleration(q, v, tau + d))),
    ):
        assert np.abs(exact - wanted).max() <= 1e-7 * (1.0 + np.abs(wanted).max())


def test_steps_converge_to_them(start):
    """Along changes that satisfy the constraints: those to which the step before has led."""
    scene, q, v, tau = start
    nv, before = scene.nv, 1e-3
    first = cvi.step_derivatives(scene, q, v, tau, before)
    q, v = first.q, first.x
    changes = first.A @ np.random.default_rng(5).standard_normal((2 * nv, 4))
    found = cvi.forward_dynamics_derivatives(scene, q, v, tau, t=before)
    # Tangent vectors of balls and free bodies turn with these.
    turns = [pin.dIntegrate(scene.model, q, size * v)[0] for size in (1e-5, -1e-5)]
    turn = (turns[0] - turns[1]) / 2e-5
    by_velocity = changes[nv:] + turn @ changes[:nv]
    wanted = np.vstack([by_velocity, found.a_q @ changes[:nv] + found.a_v @ changes[nv:]])
    rates = []
    for dt in (2e-4, 1e-4):
        A = cvi.linearize(scene, q, v, tau, dt, t=before)[0]
        rates.append((A @ changes - changes) / dt)
    assert np.abs(2.0 * rates[1] - rates[0] - wanted).max() <= 1e-5 * np.abs(wanted).max()


def test_screws_and_joint_friction_are_refused():
    scene, q, v = scenes.pair_of_bodies(lambda s: s.add_screw("a", "b", 0.05, scenes.TWISTED))
    with pytest.raises(cvi.NotDifferentiable, match="screw") as found:
        cvi.forward_dynamics_derivatives(scene, q, v)
    assert found.value.reason == "constraint"
    scene, q, v = scenes.linkage(joint_friction=0.1)
    with pytest.raises(cvi.NotDifferentiable, match="joint friction"):
        cvi.forward_dynamics_derivatives(scene, q, v)
