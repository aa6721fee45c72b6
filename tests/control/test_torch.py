"""Runs as functions of PyTorch: gradients against its differences, batches, errors."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from contactvi.control.rollouts import Rollouts
from contactvi.torch import rollout
from helpers.extras import extra
from helpers.rollout_scenes import SETTINGS, STEPS, at_wall, servo_arm, starts, thrown_ball, thrown_box

torch = extra("torch")


def tensor(x: Any, grad: bool = True) -> Any:
    return torch.tensor(np.asarray(x), dtype=torch.float64, requires_grad=grad)


def end(states: Any) -> Any:
    """The last states alone, whose gradients take fewer passes."""
    return tuple(part[..., -1, :] for part in states)


def test_gradients_through_an_impact():
    scene, q, v = at_wall()
    control = tensor(np.zeros((STEPS, 2)), grad=False)
    inputs = (tensor(q), tensor(v))
    assert torch.autograd.gradcheck(
        lambda q, v: rollout(scene, q, v, control, **SETTINGS), inputs, eps=1e-5, atol=1e-7, rtol=1e-6
    )


def test_gradients_in_forces():
    scene, q, v = at_wall()
    control = tensor(np.zeros((35, 2)))
    assert torch.autograd.gradcheck(
        lambda u: end(rollout(scene, q, v, u, dt=0.02, order=4, solver_tol=1e-14)),
        (control,),
        eps=1e-5,
        atol=1e-7,
        rtol=1e-6,
    )


def test_gradients_of_a_ball_that_bounces():
    """With eps=2e-7 quaternions stay within the tolerance of their norm, 1e-6.

    Impacts are located to 1e-13 m, so that differences have errors of 1e-13 / 2e-7 = 5e-7, times what bounces make of
    them.
    """
    scene, q, v = thrown_ball()
    inputs = (tensor(q), tensor(v))
    assert torch.autograd.gradcheck(
        lambda q, v: end(rollout(scene, q, v, steps=40, **SETTINGS)), inputs, eps=2e-7, atol=2e-5, rtol=1e-5
    )


def test_gradients_in_targets():
    scene, q, v = servo_arm()
    target = tensor(np.tile([0.6, 0.1], (STEPS // 2, 1)))
    assert torch.autograd.gradcheck(
        lambda r: end(rollout(scene, q, v, target=r, dt=0.02, order=4, solver_tol=1e-14)),
        (target,),
        eps=1e-4,
        atol=1e-7,
    )


def test_gradients_in_parameters_of_a_box_with_friction():
    scene, q, v = thrown_box()
    names = ("mass:box", "restitution", "friction")

    def run(*values: Any) -> Any:
        return end(rollout(scene, q, v, steps=40, parameters=dict(zip(names, values, strict=True)), **SETTINGS))

    values = tuple(tensor(scene.parameter(name)) for name in names)
    assert torch.autograd.gradcheck(run, values, eps=1e-5, atol=1e-7, rtol=1e-6)
    per_run = (tensor([[1.2], [1.4]]), tensor(0.6), tensor(0.25))  # numbers, and one mass for each run
    assert torch.autograd.gradcheck(run, per_run, eps=1e-5, atol=1e-7, rtol=1e-6)


def test_a_batch_is_its_runs_to_the_bit():
    scene, q, v = at_wall()
    places = tensor(starts(q, 8))
    shared = tensor(v)
    Q, V = rollout(scene, places, shared, steps=STEPS, **SETTINGS)
    assert Q.shape == V.shape == (8, STEPS + 1, 2)
    (Q.square().sum() + V[:, -1].sum()).backward()
    total = torch.zeros(2, dtype=torch.float64)
    for k in range(8):
        place, speed = tensor(starts(q, 8)[k]), tensor(v)
        one, rate = rollout(scene, place, speed, steps=STEPS, workers=1, **SETTINGS)
        assert one.shape == (STEPS + 1, 2)
        assert torch.equal(one, Q[k])
        (one.square().sum() + rate[-1].sum()).backward()
        assert torch.equal(place.grad, places.grad[k])
        total += speed.grad
    assert shared.grad == pytest.approx(total, rel=1e-14)


def test_only_what_is_wanted_needs_a_derivative():
    """The energy that an implicit map conserves has none in the mass, which is constant here."""
    scene, q, v = at_wall()
    start, mass = tensor(q), tensor([1.0])
    name = f"mass:{scene.model.names[1]}"
    run = lambda m: rollout(scene, start, v, steps=STEPS, dt=0.01, impact="dtec", parameters={name: m})  # noqa: E731
    run(mass.detach())[0].sum().backward()
    assert torch.isfinite(start.grad).all()
    with pytest.raises(cvi.NotDifferentiable, match="impact='ctec'"):
        run(mass)[0].sum().backward()


def test_a_second_derivative_is_refused():
    scene, q, v = at_wall()
    start = tensor(q)
    (slope,) = torch.autograd.grad(rollout(scene, start, v, steps=5, dt=0.01)[0].sum(), start, create_graph=True)
    with pytest.raises(cvi.errors.ContactviError, match="hessian_vector"):
        slope.sum().backward()


def test_types_and_places():
    scene, q, v = at_wall()
    with pytest.raises(cvi.errors.InputError, match=r"double precision.*Give q0.double\(\)"):
        rollout(scene, torch.tensor([0.3, 0.2]), v, steps=5, dt=0.01)
    with pytest.raises(cvi.errors.InputError, match="on the CPU"):
        rollout(scene, torch.zeros(2, dtype=torch.float64, device="meta"), v, steps=5, dt=0.01)
    with pytest.raises(cvi.errors.InputError, match="v0 has the wrong shape"):
        rollout(scene, q, tensor(np.zeros(3)), steps=5, dt=0.01)
    Q, _ = rollout(scene, q, list(v), steps=5, dt=0.01)  # what becomes a tensor
    assert not Q.requires_grad
    assert (Q.numpy() == Rollouts(scene, q, v, steps=5, dt=0.01).q[0]).all()


def test_a_run_that_fails_is_named():
    scene, q, v = thrown_ball()
    several = np.tile(q, (3, 1))
    several[1, 2] = 0.0
    with pytest.raises(cvi.PenetrationError, match="Run 1 of the batch"):
        rollout(scene, tensor(several), v, steps=5, dt=0.01)


def test_a_tensor_that_is_left_at_the_end_says_nothing(tmp_path):
    """Its runs are let go of before the engine's module looks for what was lost."""
    code = """
import contactvi as cvi, torch
from contactvi.torch import rollout
scene = cvi.Scene()
scene.add_sphere("ball", 0.1)
q, v = rollout(scene, torch.tensor(scene.neutral(), requires_grad=True), [0.0] * 6, steps=5, dt=0.01)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
