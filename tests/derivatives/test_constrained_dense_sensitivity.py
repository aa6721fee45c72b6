"""The derivatives of dense steps with constraints against fourth-order differences of the runs themselves.

As in test_dense_sensitivity.py the runs are made with solver_tol=1e-15, and starts are brought back to the constraints.
"""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import FOURTH, compare_parameters, constrained_differences, transpose_error
from derivatives.test_constrained_steps import CHAIN, pinned_chain
from derivatives.test_constrained_steps import SCENES as STEPS
from derivatives.test_constraint_sensitivity import DROPS, SMOOTH, TOUCHING
from helpers import constrained_scenes as scenes
from helpers.sprung_arm import COLUMNS, NAMES, SPRUNG_ARM, sprung_arm
from helpers.thinning import every

BAR = 1e-7
DENSE = {"contact_mode": "steps", "solver_tol": 1e-15}
HELD = "gaps that are left for the sake of the energy"
MASSES = "parameters of inertias and joints in masses that change within the step"

# name -> start, duration, dt
LANDINGS = {
    "a leg with a loop slides": (lambda: scenes.five_bar_leg(0.0, 0.05), 0.2, 5e-3),
    "a leg with a loop slips": (lambda: scenes.five_bar_leg(0.0, 0.3), 0.2, 5e-3),
    "a leg with a loop sticks": (lambda: scenes.five_bar_leg(0.0, 0.8), 0.2, 5e-3),
    "a leg with a loop bounces": (lambda: scenes.five_bar_leg(0.5, 0.3), 0.2, 5e-3),
    "a leg with a loop and joint friction": (lambda: scenes.five_bar_leg(0.0, 0.8, 0.1), 0.2, 5e-3),
    "a driven finger presses a ball": (lambda: scenes.gripper(0.0), 0.3, 5e-3),
    "a driven finger presses a ball, which slips": (lambda: scenes.gripper(0.3), 0.3, 5e-3),
    "a driven finger presses a ball, which sticks": (lambda: scenes.gripper(0.8), 0.3, 5e-3),
    "welded boxes slide": (lambda: scenes.welded_boxes(0.0, 0.0), 0.15, 5e-3),
    "welded boxes slip": (lambda: scenes.welded_boxes(0.0, 0.3), 0.15, 5e-3),
    "welded boxes tumble": (lambda: scenes.welded_boxes(0.5, 0.3), 0.15, 5e-3),
    "a finger whose joint follows another slides": (lambda: scenes.following_finger(0.0, 0.0), 0.4, 0.01),
    "a finger whose joint follows another slips": (lambda: scenes.following_finger(0.0, 0.1), 0.4, 0.01),
    "a finger whose joint follows another sticks": (lambda: scenes.following_finger(0.0, 1.5), 0.4, 0.01),
    "a finger whose joint follows another bounces": (lambda: scenes.following_finger(0.5, 0.1), 0.4, 0.01),
    "a finger with joint friction": (lambda: scenes.following_finger(0.0, 0.1, 1.0), 0.25, 0.01),
    "balls on a lift": (lambda: scenes.balls_on_a_lift(0.5, 0.1), 0.1, 0.02),
    "a linkage strikes a ball and stays with it": (lambda: scenes.striker(0.0, 0.0), 0.42, 0.01),
    "balls on a rod drop": (lambda: scenes.joined_balls(0.1, "distance"), 0.3, 0.01),
    **{name: (start, min(duration, 0.5), 0.01) for name, (start, duration, _, _) in TOUCHING.items()},
}


def recorded(start: scenes.Start, duration: float, dt: float, **options) -> tuple[cvi.Trajectory, tuple]:
    scene, q, v = start
    q, v = scenes.on_constraints(scene, q, v)
    traj = cvi.simulate(scene, q, v, record="gradient", duration=duration, dt=dt, **{**DENSE, **options})
    return traj, (scene, q, v)


def compare(traj: cvi.Trajectory, start: tuple, steps: tuple[float, float], **options) -> None:
    """Compare with differences of two steps; the second tells how good they are."""
    S = traj.sensitivity(["q0", "v0"])
    runs = [constrained_differences(*start, step, **{**DENSE, **options}) for step in steps]
    size, own = np.abs(runs[1][1]).max(), np.abs(runs[1][1] - runs[0][1]).max()
    assert own <= 10 * BAR * size
    assert np.abs(S.matrix[-1] @ runs[1][0] - runs[1][1]).max() <= BAR * size + own


def wrt_of(scene: cvi.Scene) -> list[str]:
    names = ["q0", "v0", "control", "gravity", f"inertia:{scene.model.names[-1]}", f"armature:{scene.model.names[-1]}"]
    names += ["friction"] if scene.pair_friction.max(initial=0.0) > 0.0 else []
    return names + (["restitution"] if scene.pair_restitution.max(initial=0.0) > 0.0 else [])


@pytest.mark.thinned(2)
@pytest.mark.filterwarnings("ignore::contactvi.AccuracyWarning")
@pytest.mark.parametrize("name", every(2, SMOOTH))
def test_constraints_alone(name):
    options = {"duration": 0.05 if "joint friction" in name else 0.1, "dt": 0.01}
    traj, start = recorded(SMOOTH[name](), **options)
    assert len(traj.dense_steps) > 0
    assert not traj.sensitivity().report.approximate
    compare(traj, start, (2e-4, 1e-4), **options)
    assert transpose_error(traj, wrt_of(start[0])) <= 2e-12


@pytest.mark.thinned(3)
@pytest.mark.filterwarnings("ignore::contactvi.AccuracyWarning", "ignore::contactvi.ApproximateDerivativeWarning")
@pytest.mark.parametrize("name", every(3, LANDINGS))
def test_runs_with_contacts(name):
    start, duration, dt = LANDINGS[name]
    traj, start = recorded(start(), duration, dt)
    assert len(traj.dense_steps) > 0
    reasons = {step.reason for step in traj.sensitivity().report.dense_steps if step.reason}
    assert reasons <= ({HELD} if "with joint friction" in name else set())
    # In the leg with joint friction another contact is held open within a change of 1e-5.
    step = 1e-6 if "leg with a loop and joint friction" in name else 1e-5
    compare(traj, start, (step, 0.5 * step), duration=duration, dt=dt)
    assert transpose_error(traj, wrt_of(start[0])) <= 2e-12


@pytest.mark.parametrize("name", STEPS)
def test_a_step_without_contacts_is_that_of_located_events(name):
    """The same map, off the constraints too: its derivative is checked in sixty digits by test_constrained_steps.py."""
    scene, q, v = STEPS[name]()
    q, v = scenes.on_constraints(scene, q, v)
    tau = 0.3 * np.random.default_rng(3).standard_normal(scene.nv)
    step = cvi.step_derivatives(scene, q, v, tau, 0.01)
    traj, _ = recorded((scene, q, v), 0.01, 0.01, control=tau[None])
    assert len(traj.dense_steps) == 1
    S = traj.sensitivity(["q0", "v0", "control"]).matrix[-1]
    assert np.abs(np.hstack([step.A, step.B]) - S).max() <= 1e-10 * np.abs(S).max()


def test_a_pinned_and_driven_chain_is_that_of_located_events():
    """With a motion whose speed changes."""
    scene = pinned_chain(CHAIN)
    q = scene.assemble(np.array(CHAIN["q0"]))
    q, v = scenes.on_constraints(scene, q, scene.consistent_velocity(q, np.array([0.1, -0.5, 0.7, 0.3])))
    runs = [
        cvi.simulate(scene, q, v, duration=0.02, dt=5e-3, record="gradient", contact_mode=mode)
        for mode in ("events", "steps")
    ]
    events, steps = (run.sensitivity(["q0", "v0", "control"]).matrix[-1] for run in runs)
    assert len(runs[1].dense_steps) == 4
    assert np.abs(steps - events).max() <= 1e-10 * np.abs(events).max()


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", ["a leg with a loop slips", "welded boxes tumble", "a driven finger presses a ball"])
def test_inputs_friction_and_restitution_are_parameters(name):
    make, duration, dt = LANDINGS[name]
    scene, q, v = make()
    nv, steps = scene.nv, round(duration / dt)
    e, mu = float(scene.pair_restitution.max()), float(scene.pair_friction.max())
    force = np.linspace(0.02, 0.1, nv)
    traj, (_, q, v) = recorded((scene, q, v), duration, dt, control=np.tile(force, (steps, 1)))
    S = traj.sensitivity(["control", "friction", "restitution"])
    assert not S.report.approximate
    free = nv + (mu > 0.0) + (e > 0.0)

    def end(change: np.ndarray) -> np.ndarray:
        scene.set_contact(restitution=e + change[nv + 1], friction=mu + change[nv])
        control = np.tile(force + change[:nv], (steps, 1))
        run = cvi.simulate(scene, q, v, control=control, duration=duration, dt=dt, **DENSE)
        return np.concatenate([pin.difference(scene.model, traj.q[-1], run.q[-1]), run.v[-1]])

    found = [np.zeros((2 * nv, free)) for _ in range(2)]
    for D, step in zip(found, (1e-4, 5e-5), strict=True):
        for k in range(free):
            D[:, k] = sum(weight / step * end(count * step * np.eye(nv + 2)[k]) for count, weight in FOURTH)
    exact = S.matrix[-1]
    exact = np.column_stack([exact[:, :nv], *(exact[:, k : k + 1] for k in range(nv, free))])
    scale, own = np.abs(found[1]).max(), np.abs(found[1] - found[0]).max()
    assert own <= 1e-6 * scale
    assert np.abs(exact - found[1]).max() <= BAR * scale + own


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("e", "mu", "duration"), DROPS)
def test_parameters_of_the_scene(e, mu, duration):
    """A linked arm drops on the ground: the impulses depend on inertias through the constraint too.

    With friction the derivatives in inertias, which change the masses of the law, are good to 1e-6, and said to be so.
    """
    scene_of = sprung_arm(restitution=e, friction=mu, linked=True)
    x = np.array(SPRUNG_ARM)
    scene = scene_of(x)
    q = scene.assemble(np.array([0.25, 0.4, 0.3]), fixed=["slide", "turn"])
    q, v = scenes.on_constraints(scene, q, np.array([-2.0, 0.5, 0.2]))
    options = {"duration": duration, "dt": 0.005, "target": [0.3], **DENSE}
    traj = cvi.simulate(scene, q, v, record="gradient", **options)
    assert len(traj.contacts) > 0
    reasons = {step.reason for step in traj.sensitivity(NAMES).report.dense_steps if step.reason}
    assert reasons == ({MASSES} if mu > 0.0 else set())
    bar = 1e-6 if mu > 0.0 else BAR
    compare_parameters(traj, lambda x: cvi.simulate(scene_of(x), q, v, **options), x, NAMES, COLUMNS, bar)
    with pytest.warns(cvi.ApproximateDerivativeWarning, match=MASSES) if mu > 0.0 else nullcontext():
        assert transpose_error(traj, [*NAMES, "q0", "v0"]) <= 2e-12


@pytest.mark.thinned(3)
@pytest.mark.filterwarnings("ignore::contactvi.DenseStepWarning")
@pytest.mark.parametrize(("e", "mu"), [(0.0, 0.0), (0.0, 0.1), (0.0, 0.9)])
def test_steps_whose_start_moves(e, mu):
    """The second impact within a step is one too many: dense steps begin at its time, while a motion goes on."""
    options = {"contact_mode": "auto", "max_impacts_per_step": 1, "duration": 0.1, "dt": 0.02}
    traj, start = recorded(scenes.balls_on_a_lift(e, mu), **options)
    assert 0.001 < traj.dense_steps.t[0] % 0.02 < 0.019
    compare(traj, start, (1e-4, 5e-5), **options)
    assert transpose_error(traj, ["q0", "v0", "control"]) <= 2e-12


@pytest.mark.filterwarnings("ignore::contactvi.DenseStepWarning")
def test_a_joint_that_moves_in_dense_steps_sticks_where_it_has_come_to():
    """A slide with friction is pushed once while balls that land bring dense steps on, between located events.

    With dense=True all bodies are one island, as with record="gradient".
    """
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3(np.eye(3), np.array([5.0, 0.0, 0.0])), "slide")
    model.appendBodyToJoint(slide, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    scene = cvi.Scene.from_pinocchio(model, name="slide")
    scene.set_joint("slide", friction=20.0)
    scene.add_halfspace()
    for k in range(3):
        scene.add_sphere(f"ball_{k}", 0.05, mass=0.3)
    scene.set_contact(restitution=0.0, friction=0.1)
    q = pin.neutral(scene.model)
    q[1:4], q[8:11], q[15:18] = [0, 0, 0.055], [0.3, 0.1, 0.0555], [-0.3, 0.1, 0.06088]
    push = np.zeros((20, scene.nv))
    push[4, 0] = 25.0  # of it (25 N - 20 N) / 1 kg for 0.01 s are left, and 20 N against the slide after that
    options = {"contact_mode": "auto", "max_impacts_per_step": 1, "control": push}
    traj, (_, _, v) = recorded((scene, q, np.zeros(scene.nv)), 0.2, 0.01, **options)
    assert list(traj.phases["kind"]) == ["persistent", "dense", "persistent"]
    np.testing.assert_allclose(traj.v[5, 0], 0.05, atol=1e-9)
    last = int(traj.phases["t"][2] / 0.01 + 0.5)
    assert last >= 7
    np.testing.assert_allclose(traj.q[7:, 0], traj.q[7, 0], atol=1e-15)
    assert traj.q[7, 0] > 2e-4
    S = traj.sensitivity(["control"]).matrix[-1]
    ends = []
    for sign in (1, -1):
        pushed = push + sign * 1e-3 * np.eye(scene.nv)[0] * (np.arange(20)[:, None] == 4)
        run = cvi.simulate(scene, q, v, duration=0.2, dt=0.01, dense=True, **{**DENSE, **options, "control": pushed})
        ends.append(run.q[-1, 0])
    _, gradient = cvi.gradient(traj, (np.eye(scene.nv)[0] * (np.arange(21)[:, None] == 20), 0.0 * traj.v), ["control"])
    assert gradient["control"][4, 0] == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=1e-7)
    assert S[0, 0] == pytest.approx(gradient["control"][:, 0].sum(), rel=1e-11)


def test_columns_off_the_constraints_are_those_of_the_run():
    """A run accepts starts that are 1e-8 off, and its steps bring them back: along these, too, S is its derivative."""
    traj, (scene, q, v) = recorded(scenes.driven_arm_at_wall(0.0, 0.1), 0.35, 0.01)
    S, nv, step = traj.sensitivity(["q0", "v0"]), scene.nv, 2e-9
    for k in range(2 * nv):
        d = step * np.eye(2 * nv)[k]
        ends = []
        for sign in (1, -1):
            p = pin.integrate(scene.model, q, sign * d[:nv])
            run = cvi.simulate(scene, p, v + sign * d[nv:], duration=0.35, dt=0.01, **DENSE)
            ends.append(np.concatenate([run.q[-1], run.v[-1]]))
        numbers = (ends[0] - ends[1]) / (2.0 * step)
        assert np.abs(S.matrix[-1][:, k] - numbers).max() <= 1e-5 * np.abs(S.matrix[-1]).max()


def test_the_end_of_a_run_stays_on_the_constraints_along_all_columns():
    traj, (scene, _, _) = recorded(scenes.five_bar_leg(0.0, 0.3), 0.2, 5e-3)
    S, nv = traj.sensitivity(["q0", "v0", "control"]), scene.nv
    J = np.asarray(scene.core().constraint_jacobian(traj.q[-1], float(traj.t[-1])))
    assert np.abs(J @ S.matrix[-1][:nv]).max() <= 1e-12 * np.abs(S.matrix[-1]).max()


def test_a_ball_that_rests_on_a_lift_goes_with_it():
    """Its height is that of the lift, whatever pushes it; along the plate it is free."""
    scene, q, v = scenes.balls_on_a_lift(0.0, 0.0)
    q[[3, 10]] = 0.06
    v[1:] = 0.0
    v[[3, 9]] = 0.27
    traj, _ = recorded((scene, q, v), 0.1, 0.01)
    S = traj.sensitivity(["q0", "v0"]).matrix[-1]
    nv, x, z = scene.nv, [1, 7], [3, 9]  # in q and, of bodies that do not turn, in v
    assert np.abs(traj.q[:, [3, 10]] - 0.06 - 0.03 * np.sin(9 * traj.t)[:, None]).max() <= 1e-12
    assert np.abs(S[[*z, *(k + nv for k in z)]]).max() <= 1e-11
    assert np.abs(S[x][:, x] - np.eye(2)).max() <= 1e-11
    assert np.abs(S[x][:, [k + nv for k in x]] - 0.1 * np.eye(2)).max() <= 1e-11


def test_a_file_keeps_what_the_derivatives_need(tmp_path):
    traj, _ = recorded(scenes.five_bar_leg(0.5, 0.3), 0.1, 5e-3)
    again = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    assert np.array_equal(again.sensitivity().matrix, traj.sensitivity().matrix)


@pytest.mark.parametrize("name", ["a leg with a loop bounces", "a driven finger presses a ball, which slips"])
def test_what_is_kept_changes_no_number(name):
    start, duration, dt = LANDINGS[name]
    traj, (scene, q, v) = recorded(start(), duration, dt)
    plain = cvi.simulate(scene, q, v, duration=duration, dt=dt, dense=True, **DENSE)
    assert np.array_equal(plain.q, traj.q)
    assert np.array_equal(plain.v, traj.v)


def test_check_gradient_brings_starts_back():
    scene, q, v = scenes.following_finger(0.5, 0.1)
    start = scenes.on_constraints(scene, q, v)
    found = cvi.check_gradient(scene, *start, 0.3, 0.01, contact_mode="steps", columns=8)
    assert found.ok, [c for c in found.columns if c.believe == "neither"]
    assert sum(column.believe == "both" for column in found.columns) >= 4


@pytest.mark.parametrize("mu", [0.3, 1.0])
def test_restitution_of_a_friction_that_constraints_make_indefinite_is_refused(mu):
    """A linkage of one degree of freedom at a stop: how its impulse splits into pressure and friction is open."""
    scene, q, v = scenes.linkage_at_stop(0.5)
    scene.set_contact(restitution=0.5, friction=mu)
    traj, _ = recorded((scene, q, v), 0.55, 0.01)
    nv = scene.nv
    for ask in (traj.sensitivity, lambda: cvi.gradient(traj, (np.ones(nv), np.ones(nv)))):
        with pytest.raises(cvi.NotDifferentiable, match="Restitution depends") as found:
            ask()
        assert found.value.reason == "redundant"
    assert traj.sensitivity(on_kink="taken").report.approximate


def test_a_linkage_that_rests_at_a_stop_has_no_derivative_but_zero():
    """Without restitution that split has no effect: whatever the start, it comes to rest there."""
    scene, q, v = scenes.linkage_at_stop(0.0)
    scene.set_contact(restitution=0.0, friction=0.3)
    traj, _ = recorded((scene, q, v), 0.6, 0.01)
    S = traj.sensitivity(["q0", "v0"])
    assert not S.report.approximate
    assert np.abs(S.matrix[-1]).max() <= 1e-7
