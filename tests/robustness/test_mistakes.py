"""Mistakes that users make: what they are told to do instead."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import contactvi as cvi
from contactvi.control import Inputs, Problem


def falling() -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace(name="floor")
    scene.add_sphere("ball", 0.1, placement=(0, 0, 0.3))
    return scene


def pendulum() -> cvi.Scene:
    return cvi.load_scene(Path(__file__).resolve().parents[2] / "models" / "double_pendulum_wall.toml")


def starts(scene: cvi.Scene) -> np.ndarray:
    return np.tile(scene.neutral(), (4, 1))


def problem(inputs: Inputs | None = None) -> Problem:
    scene = pendulum()
    return Problem(scene, duration=0.4, dt=0.04, inputs=inputs or Inputs(scene, torques="*"))


def solid(function: Callable[[np.ndarray], object]) -> None:
    cvi.Scene().add_solid("egg", function, [(-1.2, 1.2)] * 3, 0.2)


def slide(law: Callable[..., object]) -> None:
    scene = falling()
    scene.set_contact("floor", "ball", friction_of_state=law)
    cvi.simulate(scene, v0=scene.velocity({"ball": (1, 0, 0)}), duration=0.5, dt=1e-2)


def batch(**parameters: object) -> cvi.BatchResult:
    scene = falling()
    return cvi.simulate_batch(scene, starts(scene), parameters=parameters, dt=1e-2, duration=0.1)


def derivative(wrt: str, **options: str) -> None:
    traj = cvi.simulate(pendulum(), duration=0.2, dt=0.02, record="gradient")
    cvi.gradient(traj, lambda t, q, v: (0.0, q[-1], v[-1]), wrt, **options)


MISTAKES: dict[str, tuple[Callable[[], object], str]] = {
    "a number for each run": (lambda: batch(friction=np.linspace(0, 1, 4)), r"Give values\[:, None\]"),
    "mu of a batch": (lambda: batch(mu=np.ones((4, 1))), "Did you mean 'friction'"),
    "u of a gradient": (lambda: derivative("u"), "Did you mean 'control'"),
    "forward at a kink": (lambda: derivative("control", on_kink="forward"), "directional_derivative"),
    "another name of inputs": (lambda: problem().pack({"u": 1.0}), "Use one of 'inputs'"),
    "inputs of another scene": (lambda: problem(Inputs(falling(), torques="*")), r"inputs=Inputs\(scene"),
    "positive inside": (lambda: solid(lambda p: 1.0 - np.sum(p**2, axis=1)), "Change the sign"),
    "arguments that are missing": (
        lambda: cvi.Scene().add_thread("screw", radius=0.01),  # type: ignore[call-arg]
        "lacks 'depth' and 'pitch' and 'length': .*Give depth=..., pitch=..., length=...",
    ),
    "one of two gains": (lambda: pendulum().set_servo("joint_1", kp=1.0), "Give kd=..."),  # type: ignore[call-arg]
    "law of nothing": (lambda: slide(lambda slip, normal, t: None), "got None"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_the_remedy_is_the_right_one(mistake: str):
    call, remedy = MISTAKES[mistake]
    with pytest.raises(cvi.InputError, match=remedy):
        call()


def test_a_run_that_is_not_there_is_named():
    """An IndexError, because iteration needs one."""
    with pytest.raises(IndexError, match="Run 7 of 4: expected an index from -4 to 3"):
        batch()[7]


def test_inputs_of_a_scene_whose_servos_differ_are_refused():
    scene, driven = pendulum(), pendulum()
    driven.set_servo("joint_1", kp=1.0, kd=0.1)
    with pytest.raises(cvi.InputError, match=r"servos of this one: \[\]"):
        Problem(scene, duration=0.4, dt=0.04, inputs=Inputs(driven, targets="joint_1"))


def test_files_of_height_fields(tmp_path: Path):
    scene = cvi.Scene()
    with pytest.raises(cvi.SceneError, match="there is none in .* Correct the path"):
        scene.add_heightfield("hills", tmp_path / "hills.npy", (4, 2))
    Image.fromarray(np.zeros((8, 8), np.uint8)).save(tmp_path / "hills.png")
    with pytest.raises(cvi.InputError, match="has no lengths") as caught:
        scene.add_heightfield("hills", tmp_path / "hills.png", (4, 2))
    assert "permissions" not in str(caught.value)
