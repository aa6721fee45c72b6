"""Runs with record="gradient" from files: their derivatives have the bits of those of the runs themselves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi


def bouncing() -> cvi.Trajectory:
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_sphere("ball", 0.1, placement=(0, 0, 0.3))
    scene.set_contact(restitution=0.6, friction=0.3)
    v0 = np.array([0.5, 0.2, -1.0, 0.3, -0.2, 0.1])
    return cvi.simulate(scene, v0=v0, duration=0.3, dt=1e-2, order=4, record="gradient")


def sliding() -> cvi.Trajectory:
    """A sphere that lands plastically, slips and then rolls: persistent contact, and its changes."""
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_sphere("ball", 0.1, placement=(0, 0, 0.12))
    scene.set_contact(restitution=0.0, friction=0.4)
    control = np.zeros((60, 6))
    control[:, 0] = 0.3 * np.sin(np.arange(60))
    return cvi.simulate(scene, v0=[1.0, 0, 0, 0, 0, 0], duration=0.6, dt=1e-2, control=control, record="gradient")


def box() -> cvi.Trajectory:
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_box("box", (0.3, 0.2, 0.1), placement=(0, 0, 0.05))
    scene.set_contact(restitution=0.0, friction=0.3)
    return cvi.simulate(scene, v0=[1.0, 0, 0, 0, 0, 0], duration=0.3, dt=1e-2, contact_points=3, record="gradient")


def arm() -> cvi.Trajectory:
    """A pendulum with a servo and friction in its joint that runs into its limit."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0])))
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -0.5, 0.3
    scene = cvi.Scene.from_pinocchio(model)
    scene.set_servo("hinge", 40.0, 1.0)
    scene.set_joint("hinge", restitution=0.5, limits=True)
    return cvi.simulate(scene, [-0.2], [1.0], duration=0.5, dt=1e-2, target={"hinge": 0.5}, record="gradient")


def rubbing() -> cvi.Trajectory:
    """Two sliders with friction in their joints."""
    model = pin.Model()
    for name, axis in (("x", pin.JointModelPX()), ("y", pin.JointModelPY())):
        joint = model.addJoint(model.njoints - 1, axis, pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model)
    scene.set_joint("x", friction=0.5)
    return cvi.simulate(scene, [0.0, 0.0], [1.0, 0.5], duration=0.3, dt=1e-2, record="gradient")


def landing() -> cvi.Trajectory:
    """A box that lands flat: an impact of several points at once, plastic."""
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_box("box", (0.3, 0.2, 0.1), placement=(0, 0, 0.1))
    scene.set_contact(restitution=0.0, friction=0.0)
    return cvi.simulate(scene, v0=[0.3, 0, 0, 0, 0, 0], duration=0.2, dt=1e-2, contact_points=3, record="gradient")


RUNS: dict[str, tuple[Callable[[], cvi.Trajectory], tuple[str, ...]]] = {
    "bouncing": (bouncing, ("q0", "v0", "control", "restitution", "friction", "gravity", "mass:ball")),
    "sliding": (sliding, ("q0", "v0", "control", "friction")),
    "landing": (landing, ("gravity", "mass:box")),
    "box": (box, ("v0", "friction")),
    "arm": (arm, ("q0", "v0", "control", "kp:hinge")),
    "rubbing": (rubbing, ("q0", "v0", "control")),
}


def derivatives(traj: cvi.Trajectory, wrt: tuple[str, ...]) -> list[Any]:
    nv = traj.v.shape[1]
    found = traj.sensitivity(wrt, on_kink="taken")
    rng = np.random.default_rng(1)
    cost = rng.normal(size=(2, len(traj.t), nv))
    try:
        gradient: list[Any] = list(cvi.gradient(traj, (cost[0], cost[1]), wrt, on_kink="taken")[1].values())
    except cvi.NotDifferentiable as error:  # what the adjoint does not know
        gradient = [str(error)]
    times = traj.t[::3] if len(traj.inputs.stored()["contact_steps"]) else np.linspace(traj.t[0], traj.t[-1], 17)
    return [found.matrix, found.event_times, str(found.report), found.at(times), *gradient]


@pytest.mark.parametrize("name", RUNS)
def test_derivatives_of_a_loaded_run_have_the_same_bits(name, tmp_path):
    make, wrt = RUNS[name]
    traj = make()
    assert name == "bouncing" or name == "arm" or traj.inputs.contact_steps
    assert name != "landing" or len(traj.inputs.stored()["impact_blocks"])
    expected = derivatives(traj, wrt)
    first = cvi.Trajectory.load(traj.save(tmp_path / "first.npz"))
    again = cvi.Trajectory.load(first.save(tmp_path / "again.npz"))
    for loaded in (first, again):
        for want, got in zip(expected, derivatives(loaded, wrt), strict=True):
            if isinstance(want, str):
                assert got == want
            else:
                assert np.array_equal(got, want)
                assert np.asarray(got).tobytes() == np.asarray(want).tobytes()


def test_a_saturated_run_is_still_refused(tmp_path):
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model)
    scene.set_actuator("slide", velocity=0.1)
    traj = cvi.simulate(scene, [0.0], [0.0], duration=0.1, dt=1e-2, control=np.full((10, 1), 3.0), record="gradient")
    loaded = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    for run in (traj, loaded):
        with pytest.raises(cvi.NotDifferentiable, match="at limits of speed"):
            run.sensitivity()


def changed(path: Path, name: str, values: np.ndarray) -> Path:
    with np.load(path) as file:
        entries = {entry: file[entry] for entry in file.files}
    entries[name] = values
    np.savez(path, **entries)
    return path


@pytest.mark.parametrize("how", ["cut", "longer", "fraction", "huge", "negative", "guard", "empty", "shifted"])
def test_contact_steps_of_another_run_are_refused(how, tmp_path):
    """Numbers that are none of the scene's contact steps: an error of ours, never a crash."""
    traj = sliding()
    path = traj.save(tmp_path / "run.npz")
    numbers = traj.inputs.stored()["contact_steps"]
    kinds = {
        "cut": numbers[:-3],
        "longer": np.append(numbers, [1.0, 2.0]),
        "fraction": np.where(np.arange(len(numbers)) == 4, 7.5, numbers),
        "huge": np.where(np.arange(len(numbers)) == 4, 1e9, numbers),
        "negative": np.where(np.arange(len(numbers)) == 4, -1.0, numbers),
        "guard": np.full(len(numbers), 3.0),
        "empty": np.zeros(0),
        "shifted": np.roll(numbers, 1),
    }
    loaded = cvi.Trajectory.load(changed(path, "input/contact_steps", kinds[how]))
    with pytest.raises(cvi.ContactviError) as caught:
        loaded.sensitivity("v0")
    if how != "empty":
        assert "contact steps" in str(caught.value)
        assert caught.value.remedy


def test_inputs_of_wrong_shapes_are_refused(tmp_path):
    traj = sliding()
    for name, values in (
        ("input/control", np.zeros((60, 5))),
        ("input/control", np.full((60, 6), np.nan)),
        ("input/target", np.zeros((60, 6))),
        ("input/saturated", np.zeros(2, dtype=np.int64)),
        ("input/contact_steps", np.full(3, np.inf)),
    ):
        with pytest.raises(cvi.SceneError, match="Cannot read the run"):
            cvi.Trajectory.load(changed(traj.save(tmp_path / "run.npz", overwrite=True), name, values))
    short = cvi.Trajectory.load(
        changed(traj.save(tmp_path / "run.npz", overwrite=True), "input/control", np.zeros((3, 6)))
    )
    with pytest.raises(cvi.ContactviError, match="do not cover the run"):
        short.sensitivity("v0")


@pytest.mark.parametrize("order", [2, 6])
@pytest.mark.parametrize("mass", [1e-6, 1.0, 1e6])
def test_a_run_that_grows_without_bound_is_read_back(mass, order, tmp_path):
    scene = cvi.Scene(gravity=(0, 0, 0))
    scene.add_sphere("ball", 0.1, mass, placement=(0, 0, 1))
    push = np.diag([50.0 * mass] * 3 + [0.0] * 3)
    scene.add_force(lambda t, q, v: push @ v, check=False)
    turned = [0, 0, 1, 0.5, 0.5, 0.5, 0.5]
    traj = cvi.simulate(scene, turned, [1, 1, 1, 0, 0, 0], duration=10.0, dt=1e-2, order=order, dense=True, throw=False)
    assert traj.status.code == cvi.StatusCode.NOT_FINITE
    loaded = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    for name in ("t", "q", "p", "v", "energy"):
        assert np.array_equal(getattr(loaded, name), getattr(traj, name))
        assert np.all(np.isfinite(getattr(loaded, name)))
