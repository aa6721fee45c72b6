"""The derivatives of steps above order 2 that keep constraints: against differences of runs of the same order."""

from __future__ import annotations

import copy

import numpy as np
import pytest

import contactvi as cvi
from derivatives.differences import FOURTH, compare_parameters, constrained_differences, transpose_error
from derivatives.test_constrained_steps import SCENES
from derivatives.test_constraint_sensitivity import BAR, SMOOTH, TOUCHING, adjoint_error, compare
from helpers import constrained_scenes as scenes
from helpers.sprung_arm import COLUMNS, NAMES, SPRUNG_ARM, sprung_arm

WITHOUT_FRICTION = [name for name in SMOOTH if "friction" not in name]
IMPACTS = [name for name in TOUCHING if "bounces" in name or "strikes" in name]


def recorded(start: scenes.Start, **options) -> tuple[cvi.Trajectory, np.ndarray, np.ndarray]:
    """A run for derivatives, which has the steps of one without, all of its order."""
    scene, q, v = start
    q, v = scenes.on_constraints(scene, q, v)
    traj = cvi.simulate(scene, q, v, record="gradient", **options)
    plain = cvi.simulate(scene, q, v, **options)
    assert traj.status.ok
    assert np.array_equal(traj.q, plain.q)
    assert np.array_equal(traj.v, plain.v)
    assert traj.stats.contact_steps == 0
    assert "order 2" not in traj.stepping
    return traj, q, v


@pytest.mark.parametrize("order", [4, 8, 16])
@pytest.mark.parametrize("name", WITHOUT_FRICTION)
def test_smooth_runs(name, order):
    options = {"duration": 0.12, "dt": 0.02, "order": order}
    traj, q, v = recorded(SMOOTH[name](), **options)
    compare(traj, *(constrained_differences(traj.scene, q, v, step, **options) for step in (1e-3, 5e-4)))
    assert adjoint_error(traj) <= 2e-11


@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize("name", IMPACTS)
def test_impacts(name, order):
    start, duration, _, impacts = TOUCHING[name]
    options = {"duration": duration, "dt": 0.02, "order": order}
    traj, q, v = recorded(start(), **options)
    assert len(traj.events) == impacts
    compare(traj, *(constrained_differences(traj.scene, q, v, step, **options) for step in (1e-4, 5e-5)))
    assert adjoint_error(traj, "restitution") <= 2e-11


@pytest.mark.parametrize("name", ["a driven arm slides", "a ball with a box rolls off another"])
def test_contact_steps_follow_where_contacts_persist(name):
    """They are of order 2, and the run says for how long; the adjoint goes through both kinds of steps."""
    start, duration, _, _ = TOUCHING[name]
    scene, q, v = start()
    q, v = scenes.on_constraints(scene, q, v)
    traj = cvi.simulate(scene, q, v, record="gradient", duration=duration, dt=0.01, order=4)
    assert traj.stats.contact_steps > 0
    assert "persistent contact for" in traj.stepping
    assert "with order 2" in traj.stepping
    assert adjoint_error(traj) <= 2e-11


@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize("name", [name for name in SCENES if "friction" not in name])
def test_single_steps(name, order):
    scene, q, v = SCENES[name]()
    q, v = scenes.on_constraints(scene, q, v)
    tau = 0.3 * np.random.default_rng(3).standard_normal(scene.nv)
    step = cvi.step_derivatives(scene, q, v, tau, 0.02, order=order)
    traj = cvi.simulate(scene, q, v, duration=0.02, dt=0.02, order=order, record="gradient", control=tau[None])
    S = traj.sensitivity(["q0", "v0", "control"]).matrix[-1]
    assert np.abs(np.hstack([step.A, step.B]) - S).max() <= 1e-11 * np.abs(S).max()
    numbers, width = np.zeros(scene.nv), 1e-4
    for count, weight in FOURTH:
        dt = 0.02 + count * width
        numbers += weight / width * cvi.simulate(scene, q, v, duration=dt, dt=dt, order=order, control=tau[None]).v[-1]
    assert np.abs(step.dt[scene.nv :] - numbers).max() <= 1e-8 * np.abs(numbers).max()


def test_single_steps_with_joint_friction_are_refused():
    scene, q, v = SCENES["loop with joint friction"]()
    with pytest.raises(cvi.NotDifferentiable, match="joint friction"):
        cvi.linearize(scene, *scenes.on_constraints(scene, q, v), dt=0.01, order=4)


def test_times_inside_of_steps():
    """There the derivative is that of the part of the step, which is what a run of shorter steps comes to."""
    options = {"duration": 0.06, "dt": 0.03, "order": 16}
    traj, q, v = recorded(SMOOTH["a four-bar linkage"](), **options)
    inside = traj.sensitivity(["q0", "v0"]).at(0.05)
    short, _, _ = recorded((traj.scene, q, v), duration=0.05, dt=0.025, order=16)
    starts, _, _ = constrained_differences(traj.scene, q, v, 1e-3, duration=0.05, dt=0.025, order=16)
    ends = short.sensitivity(["q0", "v0"]).matrix[-1] @ starts
    assert np.abs(inside @ starts - ends).max() <= BAR * np.abs(ends).max()


@pytest.mark.parametrize("order", [4, 8])
def test_parameters_of_the_scene(order):
    """A linked arm bounces on the ground."""
    scene_of, x = sprung_arm(restitution=0.6, friction=0.3, linked=True), np.array(SPRUNG_ARM)
    scene = scene_of(x)
    q = scene.assemble(np.array([0.25, 0.4, 0.3]), fixed=["slide", "turn"])
    options = {"duration": 0.25, "dt": 0.01, "target": [0.3], "order": order}
    traj, q, v = recorded((scene, q, np.array([-2.0, 0.5, 0.2])), **options)
    assert len(traj.events) >= 1
    compare_parameters(traj, lambda x: cvi.simulate(scene_of(x), q, v, **options), x, NAMES, COLUMNS)
    assert transpose_error(traj, [*NAMES, "q0", "v0"]) <= 2e-11


def test_steps_are_kept_in_files_and_copies(tmp_path):
    traj, _, _ = recorded(TOUCHING["a linkage strikes a ball"][0](), duration=0.5, dt=0.02, order=4)
    for again in (cvi.Trajectory.load(traj.save(tmp_path / "run.npz")), copy.deepcopy(traj)):
        assert np.array_equal(again.sensitivity().matrix, traj.sensitivity().matrix)


def test_second_derivatives_are_refused():
    traj, _, _ = recorded(SMOOTH["a four-bar linkage"](), duration=0.06, dt=0.02, order=4)
    nv = traj.scene.nv
    cost, w = (np.ones(nv), np.ones(nv)), {"v0": np.ones(nv)}
    with pytest.raises(cvi.NotDifferentiable) as found:
        cvi.hessian_vector(traj, cost, w, hessp="linear")
    assert found.value.reason == "second"
    assert cvi.hessian_vector(traj, cost, w, hessp="linear", method="auto").approximate
