"""Single steps with constraints or joint friction, linearised: against an oracle in sixty digits, and against runs."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import FOURTH
from helpers import constrained_scenes as scenes
from helpers.loop_scenes import arm_scene
from oracles import derivative_constrained, precise

CHAIN = {
    "q0": [0.3, 0.4, 0.5, 0.6], "tau": [0.3, -0.2, 0.1, 0.4], "h": 0.01, "t": 0.2, "masses": [1.0, 1.2, 0.8, 0.9],
    "lengths": [0.5, 0.4, 0.45, 0.3], "centres": [0.2, 0.2, 0.25, 0.1], "inertias": [0.01, 0.02, 0.01, 0.03],
    "gravity": 9.81, "damping": [0.1, 0.3, 0.2, 0.1], "motion": [0.2, 0.4, 0.5], "pin": [0.9, -0.4],
}  # fmt: skip
SCENES = {
    "loop": scenes.linkage,
    "loop with joint friction": lambda: fast_linkage(),
    "driven": scenes.driven_joint,
    "driven length": lambda: scenes.box_on_rod(driven=True),
    "screw": lambda: scenes.pair_of_bodies(lambda s: s.add_screw("a", "b", 0.05, scenes.TWISTED)),
}


def fast_linkage() -> scenes.Start:
    """So fast that no joint comes to rest."""
    scene, q, v = scenes.linkage(joint_friction=0.1)
    return scene, q, 10.0 * v


def pinned_chain(x: dict) -> cvi.Scene:
    """The chain of the oracle: pinned at its tip, its first joint driven."""
    model, parent, at = pin.Model(), 0, pin.SE3.Identity()
    for k, length in enumerate(x["lengths"]):
        parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(0, -1, 0), at, f"j{k}")
        centre = np.array([0, 0, -x["centres"][k]])
        own = pin.Inertia(x["masses"][k], centre, x["inertias"][k] * np.eye(3))
        model.appendBodyToJoint(parent, own, pin.SE3.Identity())
        at = pin.SE3(np.eye(3), np.array([0, 0, -length]))
    model.gravity.linear = np.array([0, 0, -x["gravity"]])
    scene = cvi.Scene.from_pinocchio(model, name="chain")
    for k, damping in enumerate(x["damping"]):
        scene.set_joint(f"j{k}", damping=damping)
    scene.add_point("world", "j3", (x["pin"][0], 0, x["pin"][1]), (0, 0, -x["lengths"][-1]))
    a, b, c = x["motion"]
    scene.prescribe("j0", lambda t: (a + b * t + c * t * t, b + 2 * c * t, 2 * c))
    return scene


@pytest.mark.slow
def test_a_pinned_and_driven_chain_in_sixty_digits():
    """All columns, those off the constraints too, of a step that is made with numbers and equations of its own."""
    scene = pinned_chain(CHAIN)
    q = scene.assemble(np.array(CHAIN["q0"]), t=CHAIN["t"])
    v = scene.consistent_velocity(q, np.array([0.1, -0.5, 0.7, 0.3]), t=CHAIN["t"])
    q, v = scenes.on_constraints(scene, q, v, CHAIN["t"])
    p = np.asarray(scene.core().momentum(q[None], v[None]))[0]
    x = {**CHAIN, "q0": list(q), "p0": list(p)}
    run = derivative_constrained.outcome(derivative_constrained.PINNED, derivative_constrained.pinned_and_driven)
    expected = precise.differences(run, x, ["q0", "p0", "tau", "h"])
    step = cvi.step_derivatives(scene, q, v, x["tau"], x["h"], t=x["t"], state="momentum")
    found = np.column_stack([step.A, step.B, step.dt])
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("name", SCENES)
def test_a_step_is_the_run_of_one_step(name):
    scene, q, v = SCENES[name]()
    q, v = scenes.on_constraints(scene, q, v)
    tau = 0.3 * np.random.default_rng(3).standard_normal(scene.nv)
    step = cvi.step_derivatives(scene, q, v, tau, 0.01)
    traj = cvi.simulate(scene, q, v, duration=0.01, dt=0.01, record="gradient", control=tau[None])
    S = traj.sensitivity(["q0", "v0", "control"]).matrix[-1]
    assert np.abs(np.hstack([step.A, step.B]) - S).max() <= 1e-11 * np.abs(S).max()
    numbers, width = np.zeros(2 * scene.nv), 1e-4
    for count, weight in FOURTH:
        dt = 0.01 + count * width
        run = cvi.simulate(scene, q, v, duration=dt, dt=dt, control=tau[None])
        moved = pin.difference(scene.model, traj.q[-1], run.q[-1])
        numbers += weight / width * np.concatenate([moved, run.v[-1]])
    assert np.abs(step.dt - numbers).max() <= 1e-9 * np.abs(numbers).max()
    A, B = cvi.linearize(scene, q, v, tau, 0.01)
    assert np.array_equal(A, step.A)
    assert np.array_equal(B, step.B)


def test_changes_that_satisfy_the_constraints_stay_with_them():
    """A maps the tangent space of the constraint surface at the start to that at the end; dim 2 (nv - rows)."""
    scene, q, v = scenes.linkage()
    q, v = scenes.on_constraints(scene, q, v)
    A, B = cvi.linearize(scene, q, v, dt=0.01)
    end = cvi.step_derivatives(scene, q, v, dt=0.01)
    J = np.asarray(scene.core().constraint_jacobian(end.q, 0.0))
    assert np.abs(J @ A[:3]).max() <= 1e-13 * np.abs(A).max()
    assert np.abs(J @ B[:3]).max() <= 1e-13 * np.abs(A).max()
    assert np.linalg.matrix_rank(A, tol=1e-8) == 2


def test_a_joint_that_sticks_stays():
    scene = arm_scene(1, gravity=False)
    scene.set_joint("j1", friction=2.0)
    A, B = cvi.linearize(scene, [0.3], [0.0], [0.5], 0.01)
    assert np.abs(A - [[1.0, 0.0], [0.0, 0.0]]).max() <= 1e-12
    assert not B.any()
    A, B = cvi.linearize(scene, [0.3], [1.0], [0.5], 0.01)  # it slides
    assert np.abs(A - [[1.0, 0.01], [0.0, 1.0]]).max() <= 1e-12


def test_steps_without_a_derivative_are_refused():
    scene = arm_scene(1, gravity=False)
    scene.set_joint("j1", friction=2.0)
    with pytest.raises(cvi.NotDifferentiable) as found:
        cvi.linearize(scene, [0.3], [0.0], [2.0], 0.01)
    assert found.value.reason == "friction"
    slows, q, v = scenes.linkage(joint_friction=1.0)
    with pytest.raises(cvi.NotDifferentiable, match="in parts"):  # the joint comes to rest in the step
        cvi.linearize(slows, *scenes.on_constraints(slows, q, v), [0.61, -0.77, 0.13], 0.01)
    scene, q, v = scenes.linkage()
    q, v = scenes.on_constraints(scene, q, v)
    with pytest.raises(cvi.ConstraintError):
        cvi.linearize(scene, q + [0.1, 0.0, 0.0], v)
    moving = pinned_chain(CHAIN)
    q = moving.assemble(np.array(CHAIN["q0"]), t=0.2)
    v = moving.consistent_velocity(q, t=0.2)
    with pytest.raises(cvi.NotDifferentiable, match="in parts") as found:
        cvi.linearize(moving, q, v, dt=0.1, t=0.2)
    assert found.value.reason == "step"
