"""Runs as functions of JAX: gradients against differences, its transformations, errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from contactvi.control import folded
from contactvi.control.rollouts import Rollouts
from contactvi.jax import rollout
from helpers.extras import extra
from helpers.rollout_scenes import SETTINGS, STEPS, at_wall, servo_arm, starts, thrown_ball, thrown_box

jax, test_util, jnp = extra("jax"), extra("jax.test_util"), extra("jax.numpy")


@pytest.fixture(autouse=True)
def _double_precision():
    """Of all threads: jax.enable_x64 is that of one, and JAX calls back for large arrays from others."""
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def check(function: Any, inputs: tuple[Any, ...], eps: float, tolerance: float) -> None:
    test_util.check_grads(function, inputs, order=1, modes=["rev"], eps=eps, atol=tolerance, rtol=tolerance)


def cost(scene: cvi.Scene, **options: Any) -> Any:
    """A function of start, velocity and forces."""

    def of(q: Any, v: Any, control: Any) -> Any:
        places, rates = rollout(scene, q, v, control, **SETTINGS, **options)
        return (places**2).sum() + (rates[..., -1, :] ** 2).sum()

    return of


def test_gradients_through_an_impact():
    scene, q, v = at_wall()
    check(lambda q, v, u: rollout(scene, q, v, u, **SETTINGS), (q, v, np.zeros((STEPS, 2))), 1e-5, 1e-6)


def test_gradients_of_a_ball_that_bounces():
    """As in test_torch: an eps that leaves quaternions within the tolerance of their norm."""
    scene, q, v = thrown_ball()
    check(lambda q, v: rollout(scene, q, v, steps=40, **SETTINGS), (q, v), 2e-7, 2e-5)


def test_gradients_in_targets_and_parameters():
    scene, q, v = servo_arm()
    target = np.tile([0.6, 0.1], (STEPS, 1))
    check(lambda r: rollout(scene, q, v, target=r, **SETTINGS), (target,), 1e-5, 1e-6)
    scene, q, v = thrown_box()
    values = {name: scene.parameter(name) for name in ("mass:box", "restitution", "friction")}
    check(lambda p: rollout(scene, q, v, steps=40, parameters=p, **SETTINGS), (values,), 1e-5, 1e-6)


def test_a_batch_is_its_runs_to_the_bit():
    """Of arrays with a leading dimension, under vmap, under jit."""
    scene, q, v = at_wall()
    control, places = jnp.zeros((STEPS, 2)), jnp.array(starts(q, 8))
    each = jax.vmap(jax.value_and_grad(cost(scene)), (0, None, None))
    values, slopes = each(places, v, control)
    compiled = jax.jit(each)(places, v, control)
    assert (compiled[1] == slopes).all()
    batch, _ = rollout(scene, places, v, control, **SETTINGS)
    assert batch.shape == (8, STEPS + 1, 2)
    for k in range(8):
        value, slope = jax.value_and_grad(cost(scene, workers=1))(places[k], v, control)
        np.testing.assert_allclose(value, values[k], rtol=1e-14)  # sums in JAX
        alone = Rollouts(scene, places[k], v, control, **SETTINGS)
        assert (batch[k] == alone.q[0]).all()
        np.testing.assert_allclose(slope, slopes[k], rtol=1e-13)


def test_vmap_is_one_call(monkeypatch):
    """Of all runs, on the way back too; what is the same in all of them stays one."""
    calls = []
    made = folded.rollouts_of

    def counted(scene: Any, inputs: Any, *rest: Any) -> Rollouts:
        found = made(scene, inputs, *rest)
        calls.append((len(found.runs), {name: np.shape(value) for name, value in inputs.items()}))
        return found

    monkeypatch.setattr(folded, "rollouts_of", counted)
    scene, q, v = thrown_box()

    def of(v: Any, mass: Any) -> Any:
        return rollout(scene, q, v, steps=10, dt=0.01, parameters={"mass:box": mass})[0].sum()

    speeds, mass = jnp.array(v + 0.1 * np.arange(6)[:, None]), jnp.array([1.3])
    jax.vmap(jax.grad(of, (0, 1)), (0, None))(speeds, mass)
    assert [count for count, _ in calls] == [6, 6]
    assert all(shapes["mass:box"] == (1,) for _, shapes in calls)
    calls.clear()
    jax.jacrev(lambda v: rollout(scene, q, v, steps=10, dt=0.01)[1][-1])(speeds[0])
    assert [count for count, _ in calls] == [1, 1]  # all six rows of one run


def test_vmap_over_all_kinds_of_inputs():
    """Of batches, with parameters of each run, shared by a batch, and shared by all; against a loop."""
    scene, q, v = thrown_box()
    rng = np.random.default_rng(0)
    speeds = jnp.array(v + 0.1 * rng.standard_normal((3, 2, 6)))
    masses, restitutions = jnp.array(rng.uniform(1.0, 2.0, (3, 2, 1))), jnp.array(rng.uniform(0.3, 0.9, (3, 1)))

    def of(v: Any, mass: Any, restitution: Any, friction: Any) -> Any:
        values = {"mass:box": mass, "restitution": restitution, "friction": friction}
        return (rollout(scene, q, v, steps=40, parameters=values, **SETTINGS)[0] ** 2).sum()

    gradients = jax.grad(of, (0, 1, 2, 3))
    found = jax.vmap(gradients, (0, 0, 0, None))(speeds, masses, restitutions, 0.25)
    for k in range(3):
        alone = gradients(speeds[k], masses[k], restitutions[k], 0.25)
        for of_all, of_one in zip(found, alone, strict=True):
            np.testing.assert_allclose(of_all[k], of_one, rtol=1e-12, atol=1e-12)


def test_jacobians_of_rows():
    scene, q, v = at_wall()
    end = lambda q: rollout(scene, q, v, steps=STEPS, **SETTINGS)[0][-1]  # noqa: E731
    rows = jax.jacrev(end)(jnp.array(q))
    assert rows.shape == (2, 2)
    for k in range(2):
        np.testing.assert_allclose(rows[k], jax.grad(lambda q, k=k: end(q)[k])(jnp.array(q)), rtol=1e-14)


def test_the_scene_is_that_of_the_trace():
    scene, q, v = at_wall()
    run = jax.jit(lambda q: rollout(scene, q, v, steps=STEPS, **SETTINGS)[1])
    before = run(q)
    scene.set_contact(restitution=0.2)
    assert (run(q) == before).all()
    assert not (rollout(scene, q, v, steps=STEPS, **SETTINGS)[1] == before).all()


def test_only_what_is_wanted_needs_a_derivative():
    """The energy that an implicit map conserves has none in the mass, which is constant here."""
    scene, q, v = at_wall()
    name = f"mass:{scene.model.names[1]}"

    def of(q: Any, mass: Any) -> Any:
        return rollout(scene, q, v, steps=STEPS, dt=0.01, impact="dtec", parameters={name: mass})[0].sum()

    inputs = jnp.array(q), jnp.array([1.0])
    assert jnp.isfinite(jax.jit(jax.grad(of))(*inputs)).all()
    with pytest.raises(jax.errors.JaxRuntimeError, match="impact='ctec'"):
        jax.grad(of, 1)(*inputs)


def test_large_arrays():
    """JAX copies them in threads of its own, of which there are few: a call that waits for one would never end."""
    scene, q, v = at_wall()
    control = jnp.zeros((32, 2000, 2))
    slopes = jax.jit(jax.grad(lambda u: (rollout(scene, q, v, u, dt=1e-4)[0] ** 2).sum()))(control)
    assert slopes.shape == control.shape
    assert jnp.isfinite(slopes).all()


def test_types_and_shapes():
    scene, q, v = at_wall()
    with pytest.raises(cvi.errors.InputError, match="q0.astype"):
        rollout(scene, jnp.array(q, dtype=jnp.float32), v, steps=5, dt=0.01)
    with pytest.raises(cvi.errors.InputError, match="control has the wrong shape"):
        jax.jit(lambda u: rollout(scene, q, v, u, dt=0.01))(np.zeros((5, 3)))
    with jax.enable_x64(False), pytest.raises(cvi.errors.InputError, match="jax_enable_x64"):
        rollout(scene, q, v, steps=5, dt=0.01)


def test_a_run_that_fails_is_named():
    scene, q, v = thrown_ball()
    several = np.tile(q, (3, 1))
    several[1, 2] = 0.0
    with pytest.raises(jax.errors.JaxRuntimeError, match="PenetrationError: Run 1 of the batch"):
        rollout(scene, several, v, steps=5, dt=0.01)
