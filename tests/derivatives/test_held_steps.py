"""The derivatives of steps above order 2 that keep constraints and contacts: against differences of such runs."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import (
    FOURTH,
    compare_parameters,
    constrained_differences,
    transpose_error,
)
from derivatives.test_constrained_steps import SCENES
from derivatives.test_constraint_sensitivity import BAR, SMOOTH, TOUCHING, adjoint_error, compare
from derivatives.test_persistent_sensitivity import MODELS, RUNS, Start, arm, body, check
from derivatives.test_persistent_sensitivity import compare as compare_columns
from helpers import constrained_scenes as scenes
from helpers.sprung_arm import COLUMNS, NAMES, SPRUNG_ARM, sprung_arm
from helpers.thinning import every

# Contacts without friction, and those that slide, stick or roll, with what happens to them above order 2; and beside
# constraints.
HELD = {name: run[3] for name, run in RUNS.items() if "bounc" not in name and "wall is hit" not in name}
HELD["a corner slips, and comes to rest"] = ["begin"]  # it does so later
HELD["a rim rolls"] = ["begin", "slip"]  # shortly before the end
HELD_BESIDE_CONSTRAINTS = [
    name for name, run in TOUCHING.items() if run[2] and name != "joined balls drop one after the other"
]
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


@pytest.mark.thinned(3)
@pytest.mark.parametrize("order", [4, 8, 16])
@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_runs(name, order):
    check_beside_constraints(SMOOTH[name], (1e-3, 5e-4), duration=0.12, dt=0.02, order=order)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize("name", IMPACTS)
def test_impacts(name, order):
    start, duration, _, impacts = TOUCHING[name]
    options = {"duration": duration, "dt": 0.02, "order": order}
    traj, q, v = recorded(start(), **options)
    assert len(traj.events) == impacts
    compare(traj, *(constrained_differences(traj.scene, q, v, step, **options) for step in (1e-4, 5e-5)))
    assert adjoint_error(traj, "restitution") <= 2e-12


@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize("name", SCENES)
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


@pytest.mark.thinned(3)
@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize("name", HELD)
def test_held_contacts(name, order):
    make, duration, _, _ = RUNS[name]
    options = {"duration": duration, "dt": 0.01, "order": order}
    traj, q, v = recorded(make(), **options)
    assert [c.change for c in traj.contact_changes] == HELD[name]
    nv = traj.scene.nv
    size = 0.5 if "trough" in name else 1.0
    traj = check((traj.scene, q, v), list(range(2 * nv)), (1e-4 * size, 5e-5 * size), **options)
    friction = ["friction"] if traj.scene.pair_friction.max(initial=0.0) > 0.0 else []
    assert transpose_error(traj, ["q0", "v0", "control", *friction]) <= 2e-12


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("name", "order"), every(3, itertools.product(HELD_BESIDE_CONSTRAINTS, (4, 8))))
def test_held_contacts_beside_constraints(name, order):
    start, duration, _, _ = TOUCHING[name]
    check_beside_constraints(start, (1e-4, 5e-5), duration=duration, dt=0.01, order=order)


@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize(
    "name", ["a ball slips and rolls", "a corner slips, and turns", "a ball rolls, slips, leaves a ball"]
)
def test_inputs_and_friction_are_parameters(name, order):
    make, duration, _, _ = RUNS[name]
    scene, q, v = make()
    nv, steps = scene.nv, round(duration / 0.01)
    mu = float(scene.pair_friction.max())
    options = {"duration": duration, "dt": 0.01, "order": order}
    base = cvi.simulate(scene, q, v, record="gradient", **options)
    S = base.sensitivity(["control", "friction"])

    def end(change: np.ndarray) -> np.ndarray:
        scene.set_contact(restitution=0.0, friction=mu + change[nv])
        traj = cvi.simulate(scene, q, v, control=np.tile(change[:nv], (steps, 1)), **options)
        return np.concatenate([pin.difference(scene.model, base.q[-1], traj.q[-1]), traj.v[-1]])

    compare_columns(S, end, list(range(nv + 1)), (1e-4, 5e-5))


def servo_arm(mu: float, joint_friction: float = 0.0) -> Start:
    """An arm whose servos press its tip on a wall, where it slides."""
    scene, q, v = arm(mu, joint_friction)
    scene.set_servo("joint_1", 30.0, 1.0, effort=float("inf"))
    scene.set_servo("joint_2", 20.0, 0.5, effort=float("inf"))
    return scene, q, v


@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize(("joint_friction", "duration"), [(0.0, 0.5), (0.0, 0.8), (0.2, 0.5)])
def test_servos_press_a_tip_that_slides(joint_friction, duration, order):
    """And lift it off in the longer run."""
    options = {"duration": duration, "dt": 0.01, "order": order, "target": [0.1, 0.9]}
    traj, q, v = recorded(servo_arm(0.3, joint_friction), **options)
    assert [c.change for c in traj.contact_changes] == (["begin"] if duration < 0.7 else ["begin", "release"])
    check((traj.scene, q, v), [0, 1, 2, 3], (1e-4, 5e-5), **options)
    assert transpose_error(traj, ["q0", "v0", "control", "friction"]) <= 2e-12


@pytest.mark.parametrize("order", [8, 16])
def test_servos_at_their_limits_press_a_tip(order):
    """They leave their limits, and come to them again, while the tip slides. That the times of it move is left out: the
    derivative is that of the run to its order."""
    scene, q, v = servo_arm(0.3)
    scene.set_servo("joint_1", 30.0, 1.0, effort=8.0)
    scene.set_servo("joint_2", 20.0, 0.5, effort=4.0)
    options = {"dt": 0.01, "order": order, "target": [0.1, 0.9]}
    traj, q, v = recorded((scene, q, v), duration=0.9, **options)
    first = traj.contact_changes[0]
    assert [c.change for c in traj.contact_changes] == ["begin", "slip"]
    before = cvi.simulate(scene, q, v, duration=round(first.time, 2), **options)
    assert traj.stats.switches >= before.stats.switches + 2
    check((scene, q, v), [0, 1, 2, 3], (1e-4, 5e-5), duration=0.9, **options)
    assert transpose_error(traj, ["q0", "v0", "control", "friction"]) <= 2e-12


@pytest.mark.parametrize("order", [8, 16])
def test_a_servo_at_its_limit_drives_a_linkage(order):
    scene, q, v = scenes.linkage()
    scene.set_servo("j1", 60.0, 2.0, effort=3.0)
    traj, *_ = recorded((scene, q, v), duration=0.4, dt=0.01, order=order, target=[1.0])
    assert traj.stats.switches >= 1
    check_beside_constraints(lambda: (scene, q, v), (4e-4, 2e-4), duration=0.4, dt=0.01, order=order, target=[1.0])


def pendulum(friction: float) -> Start:
    scene = cvi.Scene()
    scene.add_urdf(MODELS / "double_pendulum.urdf", limits=False)
    scene.set_joint("*", friction=friction)
    return scene, np.array([0.5, 0.3]), np.array([1.0, 2.0])


@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize(("friction", "duration"), [(0.1, 0.2), (0.1, 1.0), (3.0, 0.5)])
def test_joint_friction(friction, duration, order):
    """Joints slide; they turn back; one sticks all the time, and another one comes to rest and turns back."""
    options = {"duration": duration, "dt": 0.01, "order": order}
    traj, q, v = recorded(pendulum(friction), **options)
    turned = (traj.v.max(axis=0) > 0.1) & (traj.v.min(axis=0) < -0.1)
    assert turned.any() == (duration > 0.2)
    assert (abs(traj.v[-1, 1]) < 1e-12) == (friction == 3.0)
    check((traj.scene, q, v), [0, 1, 2, 3], (1e-4, 5e-5), **options)
    assert transpose_error(traj, ["q0", "v0", "control"]) <= 2e-12


def test_joint_friction_beside_servos():
    """One joint sticks, breaks loose and comes to rest again."""
    scene, q, v = pendulum(0.3)
    scene.set_servo("joint_1", 30.0, 1.0)
    scene.set_servo("joint_2", 20.0, 0.5)
    options = {"duration": 0.6, "dt": 0.01, "order": 8, "target": [0.7, -0.2]}
    traj, q, v = recorded((scene, q, np.array([0.5, -1.0])), **options)
    check((scene, q, v), [0, 1, 2, 3], (1e-4, 5e-5), **options)
    assert transpose_error(traj, ["q0", "v0", "control"]) <= 2e-12


@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize(("mu", "v"), [(0.2, [1.0, 0.3]), (0.5, [0.8, 0.3])], ids=["slides", "comes to rest"])
def test_a_face_that_slides(mu, v, order):
    """Four corners share the load, and come to rest together."""
    options = {"duration": 0.25, "dt": 0.01, "order": order}
    start = body("box", 0.125, [*v, 0.0, 0.0, 0.0, 0.0], mu, turn=0.0)
    traj = check(start, [0, 1, 5, 6, 7], (2e-4, 1e-4), **options)
    assert traj.stats.contact_steps <= 2
    assert [c.change for c in traj.contact_changes] == ["begin"] * 4 + ["stick"] * (4 if mu == 0.5 else 0)


def ball_on_a_slope() -> Start:
    """It lies there, and begins to slip at once."""
    scene = cvi.Scene(gravity=(5.0, 1.0, -9.0))
    scene.add_sphere("ball", 0.1)
    scene.add_halfspace()
    scene.set_contact(restitution=0.0, friction=0.05)
    return scene, np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]), np.zeros(6)


def test_what_begins_to_slide_from_rest():
    """A change of the velocity there is a kink; one that leaves the contact at rest is none."""
    options = {"duration": 0.1, "dt": 0.01, "order": 4}
    traj, q, v = recorded(ball_on_a_slope(), **options)
    with pytest.raises(cvi.NotDifferentiable) as found:
        traj.sensitivity(["v0"])
    assert found.value.reason == "friction"
    assert np.isfinite(traj.sensitivity(["v0"], on_kink="taken").matrix).all()
    S = traj.sensitivity(["control"])

    def end(change: np.ndarray) -> np.ndarray:
        run = cvi.simulate(traj.scene, q, v, control=np.tile(change, (10, 1)), **options)
        return np.concatenate([pin.difference(traj.scene.model, traj.q[-1], run.q[-1]), run.v[-1]])

    compare_columns(S, end, list(range(6)), (1e-3, 5e-4))
    assert transpose_error(traj, ["control"]) <= 2e-12


def test_slips_that_come_to_rest_at_one_instant_by_chance():
    scene = cvi.Scene()
    for name in ("a", "b"):
        scene.add_sphere(name, 0.1)
    scene.add_halfspace()
    scene.set_contact(restitution=0.0, friction=0.1)
    q, v = pin.neutral(scene.model), np.zeros(12)
    q[[2, 9]], q[7], v[[0, 6]] = 0.1, 1.0, 0.5
    traj = cvi.simulate(scene, q, v, record="gradient", duration=0.4, dt=0.01, order=4)
    with pytest.raises(cvi.NotDifferentiable) as found:
        traj.sensitivity()
    assert found.value.reason == "stick"


def test_a_face_that_rests():
    """Four corners share the load, and stick."""
    scene, q, v = body("box", 0.125, [0.0] * 6, 0.5, turn=0.0)
    options = {"duration": 0.1, "dt": 0.02, "order": 4}
    traj, q, v = recorded((scene, q, v), **options)
    check((scene, q, v), [0, 1, 5], (2e-4, 1e-4), **options)


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
@pytest.mark.parametrize(
    ("e", "mu", "linked"), [(0.6, 0.3, True), (0.0, 0.0, True), (0.0, 0.0, False), (0.0, 0.1, True), (0.0, 0.3, False)]
)
def test_parameters_of_the_scene(e, mu, linked, order):
    """An arm bounces on the ground, or slides there without friction or with it."""
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
    for start in (RUNS["a corner sticks"][0](), RUNS["a corner slips, and turns"][0](), servo_arm(0.3, 0.2)):
        kept, _, _ = recorded(start, duration=0.4 if start[0].nv == 2 else 0.12, dt=0.01, order=4, target=None)
        again = cvi.Trajectory.load(kept.save(tmp_path / "kept.npz", overwrite=True))
        assert np.array_equal(again.sensitivity().matrix, kept.sensitivity().matrix)
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
