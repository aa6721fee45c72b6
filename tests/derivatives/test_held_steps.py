"""The derivatives of steps above order 2 that keep constraints and contacts: against differences of such runs."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import pytest

import contactvi as cvi
from derivatives.differences import (
    FOURTH,
    compare_parameters,
    constrained_differences,
    run_differences,
    transpose_error,
)
from derivatives.test_constrained_steps import SCENES
from derivatives.test_constraint_sensitivity import BAR, SMOOTH, TOUCHING, adjoint_error, compare
from derivatives.test_persistent_sensitivity import RUNS, ball_on_ball, body, check
from helpers import constrained_scenes as scenes
from helpers.sprung_arm import COLUMNS, NAMES, SPRUNG_ARM, sprung_arm

WITHOUT_FRICTION = [name for name in SMOOTH if "friction" not in name]
# Contacts without friction, and those that stick or roll, in steps without and with constraints.
HELD = [
    "a ball slides", "a ball slides down a plane", "a corner slides", "a corner sticks",
    "a box falls on a corner, an edge and its face", "a ball slides in a trough against a wall",
    "a joint stays at its limit", "an arm slides", "a ball rolls at once",
]  # fmt: skip
HELD_BESIDE_CONSTRAINTS = ["a driven arm slides", "a ball with a pendulum slides", "a ball with a pendulum rolls"]
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


def check_beside_constraints(make: Callable[[], scenes.Start], steps: tuple[float, float], **options) -> None:
    """Compare the derivatives of a run with its differences of these widths, and the adjoint with the tangent."""
    traj, q, v = recorded(make(), **options)
    compare(traj, *(constrained_differences(traj.scene, q, v, step, **options) for step in steps))
    assert adjoint_error(traj) <= 2e-12


@pytest.mark.parametrize("order", [4, 8, 16])
@pytest.mark.parametrize("name", WITHOUT_FRICTION)
def test_smooth_runs(name, order):
    check_beside_constraints(SMOOTH[name], (1e-3, 5e-4), duration=0.12, dt=0.02, order=order)


@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize("name", IMPACTS)
def test_impacts(name, order):
    start, duration, _, impacts = TOUCHING[name]
    options = {"duration": duration, "dt": 0.02, "order": order}
    traj, q, v = recorded(start(), **options)
    assert len(traj.events) == impacts
    compare(traj, *(constrained_differences(traj.scene, q, v, step, **options) for step in (1e-4, 5e-5)))
    assert adjoint_error(traj, "restitution") <= 2e-12


@pytest.mark.parametrize("name", ["a driven arm slips", "a ball with a box rolls off another"])
def test_contact_steps_follow_where_contacts_slip(name):
    """They are of order 2, and the run says for how long; the adjoint goes through both kinds of steps."""
    start, duration, _, _ = TOUCHING[name]
    scene, q, v = start()
    q, v = scenes.on_constraints(scene, q, v)
    traj = cvi.simulate(scene, q, v, record="gradient", duration=duration, dt=0.01, order=4)
    assert traj.stats.contact_steps > 0
    assert "persistent contact for" in traj.stepping
    assert "with order 2" in traj.stepping
    assert adjoint_error(traj) <= 2e-12


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


@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize("name", HELD)
def test_held_contacts(name, order):
    make, duration, _, changes = RUNS[name]
    options = {"duration": duration, "dt": 0.01, "order": order}
    traj, q, v = recorded(make(), **options)
    assert [c.change for c in traj.contact_changes] == changes
    nv = traj.scene.nv
    traj = check((traj.scene, q, v), list(range(2 * nv)), (1e-4, 5e-5), **options)
    assert transpose_error(traj, ["q0", "v0", "control"]) <= 2e-12


@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize("name", HELD_BESIDE_CONSTRAINTS)
def test_held_contacts_beside_constraints(name, order):
    start, duration, _, _ = TOUCHING[name]
    check_beside_constraints(start, (1e-4, 5e-5), duration=duration, dt=0.01, order=order)


@pytest.mark.parametrize(("order", "bar"), [(4, 1e-7), (8, 1e-9)])
def test_a_release_ends_steps(order, bar):
    """The force is continuous there: its time counts as given, which leaves the error of the step in a time like it."""
    options = {"duration": 0.6, "dt": 0.01, "order": order}
    traj, q, v = recorded(ball_on_ball(0.0), **options)
    assert [c.change for c in traj.contact_changes] == ["begin", "release"]
    ends, _, own = run_differences(traj.scene, q, v, 1e-4, **options)
    S = traj.sensitivity(["q0", "v0"]).matrix[-1]
    assert np.abs(S - ends).max() <= max(bar, own) * np.abs(ends).max()
    assert transpose_error(traj, ["q0", "v0", "control"]) <= 2e-12


def test_a_face_that_rests():
    """Four corners share the load, and stick."""
    scene, q, v = body("box", 0.125, [0.0] * 6, 0.5, turn=0.0)
    options = {"duration": 0.1, "dt": 0.02, "order": 4}
    traj, q, v = recorded((scene, q, v), **options)
    check((scene, q, v), [0, 1, 5], (2e-4, 1e-4), **options)


@pytest.mark.parametrize("name", ["a ball slips and rolls", "an arm comes to rest", "a rim rolls"])
def test_smooth_steps_follow_where_a_slip_has_ended(name):
    make, duration, _, _ = RUNS[name]
    start = make()
    options = {"duration": duration, "dt": 0.01, "order": 4, "dt_contact": 0.01}
    traj = check(start, list(range(2 * start[0].nv)), (1e-4, 5e-5), **options)
    assert 0 < traj.stats.contact_steps < 15
    assert transpose_error(traj, ["q0", "v0", "control", "friction"]) <= 2e-12


@pytest.mark.parametrize("order", [4, 8])
def test_contact_steps_take_the_beginning_of_a_slip(order):
    """Where a held contact begins to slip in a step, contact steps are taken from the start of that step on."""
    make, duration, _, changes = RUNS["a box sticks on a corner and an edge"]
    options = {"duration": duration, "dt": 0.01, "order": order, "dt_contact": 0.01}
    traj = check(make(), list(range(12)), (1e-4, 5e-5), **options)
    assert [c.change for c in traj.contact_changes] == changes
    assert 0 < traj.stats.contact_steps < 15


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
@pytest.mark.parametrize(("e", "mu", "linked"), [(0.6, 0.3, True), (0.0, 0.0, True), (0.0, 0.0, False)])
def test_parameters_of_the_scene(e, mu, linked, order):
    """An arm bounces on the ground, or slides there."""
    scene_of, x = sprung_arm(restitution=e, friction=mu, linked=linked), np.array(SPRUNG_ARM)
    scene = scene_of(x)
    q = np.array([0.25, 0.4, 0.3])
    q = scene.assemble(q, fixed=["slide", "turn"]) if linked else q[: scene.nq]
    options = {"duration": 0.25, "dt": 0.01, "target": [0.3], "order": order}
    traj, q, v = recorded((scene, q, np.array([-2.0, 0.5, 0.2])[: scene.nv]), **options)
    assert len(traj.events) >= 1
    compare_parameters(traj, lambda x: cvi.simulate(scene_of(x), q, v, **options), x, NAMES, COLUMNS)
    assert transpose_error(traj, [*NAMES, "q0", "v0"]) <= 2e-12


def test_steps_are_kept_in_files_and_copies(tmp_path):
    traj, _, _ = recorded(TOUCHING["a linkage strikes a ball"][0](), duration=0.5, dt=0.02, order=4)
    corner, _, _ = recorded(RUNS["a corner sticks"][0](), duration=0.12, dt=0.01, order=4)
    again = cvi.Trajectory.load(corner.save(tmp_path / "corner.npz"))
    assert np.array_equal(again.sensitivity().matrix, corner.sensitivity().matrix)
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
