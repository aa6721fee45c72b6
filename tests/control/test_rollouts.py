"""Batches of runs and their gradients, against single runs, cvi.gradient and differences."""

from __future__ import annotations

import importlib
import sys
import threading
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.batch.scenes import SceneCache
from contactvi.control.rollouts import Rollouts
from contactvi.control.tangents import in_numbers, in_tangents
from contactvi.threads import Workers
from derivatives.test_dense_sensitivity import DENSE, dropped
from helpers.rollout_scenes import SETTINGS, STEPS, Start, at_wall, servo_arm, starts, thrown_ball, thrown_box


def weights(batch: Rollouts) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    return rng.standard_normal(batch.q.shape), rng.standard_normal(batch.v.shape)


def cost(batch: Rollouts) -> float:
    gq, gv = weights(batch)
    return float((gq * batch.q).sum() + (gv * batch.v).sum())


def difference(of: Any, x: np.ndarray, direction: np.ndarray, step: float) -> Any:
    """Central difference of fourth order."""
    near, far = (of(x + k * step * direction) - of(x - k * step * direction) for k in (1.0, 2.0))
    return (8.0 * near - far) / (12.0 * step)


def test_a_batch_is_its_runs_to_the_bit():
    scene, q, v = at_wall()
    control = 0.1 * np.random.default_rng(0).standard_normal((8, STEPS, 2))
    batch = Rollouts(scene, starts(q, 8), v, control, **SETTINGS)
    gq, gv = weights(batch)
    found = batch.gradients(gq, gv)
    assert batch.q.shape == (8, STEPS + 1, 2)
    assert all(len(run.events) == 1 for run in batch.runs)
    for k in range(8):
        run = cvi.simulate(scene, starts(q, 8)[k], v, control=control[k], duration=0.7, record="gradient", **SETTINGS)
        assert (run.q == batch.q[k]).all()
        assert (run.v == batch.v[k]).all()
        alone = cvi.gradient(run, (gq[k], gv[k]), ["q0", "v0", "control"])[1]
        assert all((alone[name] == found[name][k]).all() for name in alone)


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_the_number_of_threads_changes_no_bit(workers):
    scene, q, v = thrown_box()
    mass = 1.0 + 0.1 * np.arange(6)[:, None]
    results = []
    for number in (None, workers):
        batch = Rollouts(
            scene, q, v, steps=40, parameters={"mass:box": mass, "friction": 0.3}, workers=number, **SETTINGS
        )
        results.append([batch.q, batch.v, *batch.gradients(*weights(batch)).values()])
    assert all((a == b).all() for a, b in zip(*results, strict=True))


@pytest.mark.parametrize("make", [at_wall, thrown_ball, thrown_box])
def test_gradients_in_starts_against_differences(make):
    """In the numbers of q0: a change by 1e-7 leaves quaternions within the tolerance of their norm, 1e-6."""
    scene, q, v = make()
    batch = Rollouts(scene, q, v, steps=STEPS, **SETTINGS)
    assert len(batch.runs[0].events) >= 1
    found = batch.gradients(*weights(batch))
    rng = np.random.default_rng(1)
    for name, x in (("q0", q), ("v0", v)):
        direction = rng.standard_normal(len(x))
        of = {"q0": lambda x: cost(Rollouts(scene, x, v, steps=STEPS, **SETTINGS)),
              "v0": lambda x: cost(Rollouts(scene, q, x, steps=STEPS, **SETTINGS))}[name]  # fmt: skip
        numbers = difference(of, x, direction, 1e-7 if name == "q0" else 1e-5)
        # impacts are located to 1e-13 m, so that a difference over 1e-7 has an error of 1e-6
        assert found[name][0] @ direction == pytest.approx(numbers, rel=1e-5 if name == "q0" else 1e-7)


def test_a_change_of_the_norm_of_a_quaternion_changes_nothing():
    scene, q, v = thrown_ball()
    batch = Rollouts(scene, q, v, steps=STEPS, **SETTINGS)
    gradient = batch.gradients(*weights(batch))["q0"][0]
    assert abs(gradient[3:] @ q[3:]) <= 1e-14 * np.linalg.norm(gradient)


def test_gradients_in_targets_and_their_velocities():
    scene, q, v = servo_arm()
    rng = np.random.default_rng(2)
    target = np.tile([0.6, 0.1, 0.0, 0.0], (STEPS, 1)) + 0.05 * rng.standard_normal((STEPS, 4))
    batch = Rollouts(scene, q, v, None, target, **SETTINGS)
    direction = rng.standard_normal(target.shape)
    numbers = difference(lambda x: cost(Rollouts(scene, q, v, None, x, **SETTINGS)), target, direction, 1e-4)
    assert (batch.gradients(*weights(batch))["target"][0] * direction).sum() == pytest.approx(numbers, rel=1e-8)
    places = Rollouts(scene, q, v, None, target[:, :2], **SETTINGS)
    assert places.gradients(*weights(places))["target"].shape == (1, STEPS, 2)


@pytest.mark.parametrize("name", ["mass:box", "restitution", "friction", "friction:ground|box", "gravity"])
def test_gradients_in_parameters(name):
    scene, q, v = thrown_box()
    value = scene.parameter(name)
    run = lambda x: Rollouts(scene, q, v, steps=40, parameters={name: x}, **SETTINGS)  # noqa: E731
    batch = run(value)
    assert len(batch.runs[0].events) >= 1
    direction = np.random.default_rng(4).standard_normal(len(value))
    numbers = difference(lambda x: cost(run(x)), value, direction, 1e-5)
    assert batch.gradients(*weights(batch))[name][0] @ direction == pytest.approx(numbers, rel=1e-7)


def test_several_gradients_of_one_run():
    scene, q, v = at_wall()
    batch = Rollouts(scene, starts(q, 2), v, steps=STEPS, **SETTINGS)
    gq, gv = weights(batch)
    both, order = batch.gradients(gq, gv), [1, 0, 1]
    found = batch.gradients(gq[order], gv[order], ["v0"], of=order)
    assert list(found) == ["v0"]
    assert (found["v0"] == both["v0"][order]).all()


def random_configuration(model: pin.Model) -> np.ndarray:
    return pin.integrate(model, pin.neutral(model), np.random.default_rng(5).standard_normal(model.nv))


def test_numbers_and_tangents_of_all_kinds_of_joints():
    """Against differences along tangent vectors, and back: in_numbers is the gradient of the nearest configuration."""
    model = pin.Model()
    kinds = [pin.JointModelFreeFlyer(), pin.JointModelRUBX(), pin.JointModelPZ(), pin.JointModelSpherical(),
             pin.JointModelPlanar()]  # fmt: skip
    for k, kind in enumerate(kinds):
        model.addJoint(k, kind, pin.SE3.Identity(), f"j{k}")
    q, rng = random_configuration(model), np.random.default_rng(6)
    gradient, w = rng.standard_normal(model.nq), rng.standard_normal(model.nv)
    tangent = in_tangents(model, q[None], gradient[None])[0]
    along = difference(lambda s: pin.integrate(model, q, s * w), np.float64(0.0), np.float64(1.0), 1e-3)
    assert tangent @ w == pytest.approx(gradient @ along, rel=1e-10)
    back = in_numbers(model, q, tangent)
    assert back @ along == pytest.approx(gradient @ along, rel=1e-10)
    norms = np.zeros((4, model.nq))  # changes of the norms of quaternions and of pairs (cos, sin)
    for row, part in zip(norms, (slice(3, 7), slice(7, 9), slice(10, 14), slice(16, 18)), strict=True):
        row[part] = q[part]
    assert np.abs(norms @ back).max() <= 1e-13
    assert in_tangents(model, q[None], back[None])[0] == pytest.approx(tangent, rel=1e-12)


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "q0": ({"q0": np.zeros(3)}, "q0 has the wrong shape"),
    "text": ({"q0": "start"}, "q0 is not an array"),
    "nan": ({"v0": [0.0, np.nan]}, "v0 is not finite"),
    "batches": ({"q0": np.zeros((3, 2)), "v0": np.zeros((2, 2))}, "batches of different sizes"),
    "steps": ({"control": np.zeros((5, 2)), "steps": 6}, "different numbers of steps"),
    "no steps": ({"control": None}, "number of steps is not known"),
    "target": ({"target": np.zeros((5, 2))}, "nothing that follows a target"),
    "parameter": ({"parameters": {"mas:upper": 1.0}}, "no|Nothing"),
    "option": ({"record_every": 2}, "no option 'record_every'"),
    "dt": ({"dt": "auto"}, "dt is not usable"),
    "kink": ({"on_kink": "left"}, "answer to a kink"),
    "workers": ({"workers": 0}, "workers"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_inputs(case):
    scene, q, v = at_wall()
    changed, message = BAD[case]
    arguments = {"q0": q, "v0": v, "control": np.zeros((5, 2)), "dt": 0.01} | changed
    with pytest.raises(cvi.errors.InputError, match=message):
        Rollouts(scene, **arguments)


def test_servos_need_a_target():
    scene, q, v = servo_arm()
    with pytest.raises(cvi.errors.InputError, match="no target"):
        Rollouts(scene, q, v, steps=5, dt=0.01)


@pytest.mark.parametrize("name", ["torch", "jax"])
def test_a_library_that_is_missing_is_named(name, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    scene, q, v = at_wall()
    with pytest.raises(cvi.ContactviError, match=rf'pip install "contactvi\[{name}\]"'):
        importlib.import_module(f"contactvi.{name}").rollout(scene, q, v, steps=5, dt=0.01)


def failing() -> Start:
    """Balls that start at heights of 0.5 m, but for two of five, which start in the ground."""
    scene, q, v = thrown_ball()
    several = np.tile(q, (5, 1))
    several[[2, 4], 2] = 0.0
    return scene, several, v


@pytest.mark.parametrize("workers", [1, 3])
def test_the_first_run_that_fails_is_named(workers):
    scene, q, v = failing()
    with pytest.raises(cvi.PenetrationError, match="Run 2 of the batch: The start is refused") as caught:
        Rollouts(scene, q, v, steps=5, dt=0.01, workers=workers)
    assert caught.value.depth == pytest.approx(0.1)
    with pytest.raises(cvi.PenetrationError, match="^The start is refused"):
        Rollouts(scene, q[2], v, steps=5, dt=0.01)


def test_values_that_no_scene_has_name_their_run():
    scene, q, v = thrown_ball()
    with pytest.raises(cvi.errors.InputError, match="Run 1 of the batch: mass:ball"):
        Rollouts(scene, q, v, steps=5, dt=0.01, parameters={"mass:ball": [[1.0], [-1.0]]})


def test_a_run_without_derivative_is_named():
    """A box that falls flat: its nearest point is not one."""
    scene = cvi.Scene()
    scene.add_box("box", (0.2, 0.2, 0.1))
    scene.add_halfspace()
    scene.set_contact(restitution=0.5)
    q = np.tile(scene.neutral(), (2, 1))
    q[:, 2] = 0.2, 10.0
    batch = Rollouts(scene, q, np.zeros(6), steps=20, dt=0.01, order=4)
    with pytest.raises(cvi.NotDifferentiable, match="Run 0 of the batch"):
        batch.gradients(*weights(batch))


def test_approximate_derivatives_are_warned_of():
    """As by cvi.gradient: boxes that fall flat on each other share the load in no one way. Refused but for "taken"."""
    scene, q, v = dropped()
    refused, taken = (
        Rollouts(scene, q, v, steps=20, dt=5e-3, on_kink=on_kink, **DENSE) for on_kink in ("raise", "taken")
    )
    with pytest.raises(cvi.NotDifferentiable, match="share"):
        refused.gradients(*weights(refused))
    with pytest.warns(cvi.ApproximateDerivativeWarning):
        taken.gradients(*weights(taken))


def test_a_failure_ends_the_other_threads():
    started = threading.Event()

    def call(k: int, check: Any) -> None:
        if k == 0:
            assert started.wait(30.0)
            raise cvi.errors.InputError("No", expected="a", got="b", remedy="Do")
        started.set()
        while True:  # until it raises
            check()

    with pytest.raises(cvi.errors.InputError, match="Run 0 of the batch: No"):
        Workers(2).each(2, call)


def test_runs_without_gradients_build_no_scene(monkeypatch):
    """The engine's threads make them, with the bits of single runs of scenes that have their parameters."""
    scene, q, v = thrown_box()
    mass = np.array([[1.0], [1.3], [1.7]])
    with monkeypatch.context() as patch:
        patch.setattr(SceneCache, "_compiled", None)
        made = Rollouts(scene, q, v, steps=STEPS, parameters={"mass:box": mass}, **SETTINGS)
    for k in range(3):
        own = scene.with_parameters({"mass:box": mass[k]})
        run = cvi.simulate(own, q, v, duration=STEPS * SETTINGS["dt"], record="gradient", **SETTINGS)
        assert made.q[k].tobytes() == run.q.tobytes()
        assert made.v[k].tobytes() == run.v.tobytes()
