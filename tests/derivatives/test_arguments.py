"""Arguments of wrong kinds to the functions for derivatives are errors that name the argument."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import contactvi as cvi


@pytest.fixture(scope="module")
def scene() -> cvi.Scene:
    made = cvi.Scene()
    made.add_halfspace(name="ground")
    made.add_sphere("ball", 0.1, placement=(0, 0, 0.101))
    return made


@pytest.fixture(scope="module")
def traj(scene: cvi.Scene) -> cvi.Trajectory:
    return cvi.simulate(scene, duration=0.02, dt=1e-3, record="gradient")


def check(call: Callable[[], object], argument: str) -> None:
    with pytest.raises(cvi.InputError) as caught:
        call()
    error = caught.value
    assert error.name == argument
    assert error.expected
    assert error.got
    assert error.remedy


@pytest.mark.parametrize("wrong", [None, 3, "run.npz", np.zeros(3), [1.0]], ids=repr)
def test_what_has_no_gradient(wrong):
    check(lambda: cvi.gradient(wrong, (np.zeros(6), np.zeros(6))), "traj")


@pytest.mark.parametrize(
    ("cost", "argument"),
    [
        (3, "cost"),
        (None, "cost"),
        (lambda t: 0.0, "cost"),
        (lambda t, q, v: 0.0, "cost"),
        (lambda t, q, v: ("a", v, v), "J"),
        (lambda t, q, v: ([1, 2], v, v), "J"),
        (lambda t, q, v: (np.nan, v, v), "J"),
        (lambda t, q, v: (0.0, None, v), "dJ/dq"),
        (lambda t, q, v: (0.0, v, np.nan * v), "dJ/dv"),
        (lambda t, q, v: (0.0, v[1:], v), "dJ/dq"),
        (([[1], [2, 3]], np.zeros(6)), "dJ/dq"),
        ((np.zeros(6), "ab"), "dJ/dv"),
    ],
)
def test_costs(traj, cost, argument):
    check(lambda: cvi.gradient(traj, cost), argument)
    check(lambda: traj.gradient(cost), argument)


@pytest.mark.parametrize("wrt", [None, 3, [], [None], ["q0", 3], ["q0", "q0"], "q1", "mass:elbow", {"q0": 1}], ids=repr)
def test_with_respect_to_what(traj, wrt):
    check(lambda: traj.sensitivity(wrt), "wrt")
    check(lambda: cvi.gradient(traj, (np.zeros(6), np.zeros(6)), wrt), "wrt")


def test_the_names_of_contacts_are_listed(traj):
    """All names that can be meant, with those of one pair and of one joint's limits."""
    cost = (np.zeros(6), np.zeros(6))
    for call in (
        lambda: traj.sensitivity("restitutoin"),
        lambda: cvi.gradient(traj, cost, "restitutoin"),
        lambda: cvi.hessian_vector(traj, cost, {"restitutoin": [1.0]}, hessp=lambda *given: given),
    ):
        with pytest.raises(cvi.InputError, match="Nothing of the run has this name") as caught:
            call()
        for name in ("restitution", "restitution:a|b", "restitution:joint", "friction:a|b", "mass:joint"):
            assert name in caught.value.expected.removeprefix("one of ").removeprefix("some of ").split(", ")
        assert "'restitution'" in caught.value.remedy


@pytest.mark.parametrize("wrong", [None, [], ["q0"], np.zeros(2), "v0"], ids=repr)
def test_a_part_that_was_not_asked_for(traj, wrong):
    check(lambda: traj.sensitivity("q0").of(wrong), "name")


@pytest.mark.parametrize(
    "wrong", [None, "a", [[0.0], [0.0, 0.1]], 1j, np.nan, -1.0, [0.0, 9.0], np.zeros((2, 2))], ids=repr
)
def test_times(traj, wrong):
    check(lambda: traj.sensitivity("q0").at(wrong), "t")


def test_times_that_are_good(traj):
    found = traj.sensitivity("q0")
    assert found.at(0.01).shape == (12, 6)
    assert found.at(np.float64(0.01)).shape == (12, 6)
    assert found.at([0.01]).shape == (1, 12, 6)
    assert found.at([]).shape == (0, 12, 6)


def test_on_kink(scene, traj):
    for wrong in (None, True, "take", [1]):
        check(lambda wrong=wrong: traj.sensitivity(on_kink=wrong), "on_kink")
        check(lambda wrong=wrong: cvi.gradient(traj, (np.zeros(6), np.zeros(6)), on_kink=wrong), "on_kink")
        check(lambda wrong=wrong: cvi.check_gradient(scene, duration=0.01, dt=1e-3, on_kink=wrong), "on_kink")


@pytest.mark.parametrize("wrong", [None, "0", [0.0], np.inf, 10**400], ids=lambda value: repr(value)[:20])
def test_linear_systems(scene, wrong):
    q = scene.neutral()
    check(lambda: cvi.step_derivatives(scene, q, t=wrong), "t")
    check(lambda: cvi.linearize(scene, q, t=wrong), "t")
    check(lambda: cvi.forward_dynamics_derivatives(scene, q, t=wrong), "t")
    check(lambda: cvi.linearize(scene, q, dt=wrong), "dt")
    check(lambda: cvi.linearize(scene, q, state=wrong), "state")
    check(lambda: cvi.linearize(wrong, q), "scene")
    check(lambda: cvi.forward_dynamics_derivatives(wrong, q), "scene")
    if wrong is not None:
        for call in (cvi.linearize, cvi.step_derivatives, cvi.forward_dynamics_derivatives):
            check(lambda call=call: call(scene, wrong), "q0" if call is not cvi.forward_dynamics_derivatives else "q")
            check(lambda call=call: call(scene, q, tau=wrong), "tau")


@pytest.mark.parametrize("wrong", [None, -1, 1.5, "a", True, [1]], ids=repr)
def test_the_seed_of_a_comparison(scene, wrong):
    check(lambda: cvi.check_gradient(scene, duration=0.01, dt=1e-3, columns=1, seed=wrong), "seed")


def test_nothing_that_moves_has_no_derivatives():
    scene = cvi.Scene()
    scene.add_halfspace()
    traj = cvi.simulate(scene, duration=0.01, dt=1e-3, record="gradient")
    with pytest.raises(cvi.InputError, match="a scene in which something moves"):
        traj.sensitivity()
    with pytest.raises(cvi.InputError, match="a scene in which something moves"):
        cvi.check_gradient(scene, duration=0.01, dt=1e-3)
    A, B = cvi.linearize(scene, scene.neutral())
    assert A.shape == B.shape == (0, 0)


def test_a_run_without_what_derivatives_need(scene):
    traj = cvi.simulate(scene, duration=0.01, dt=1e-3)
    with pytest.raises(cvi.InputError, match="record='gradient'"):
        cvi.gradient(traj, (np.zeros(6), np.zeros(6)))
