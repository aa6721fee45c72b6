"""Arguments of the wrong kind are errors of ours that name the argument, in Python and in scene files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import contactvi as cvi


@pytest.fixture(scope="module")
def scene() -> cvi.Scene:
    made = cvi.Scene()
    made.add_halfspace()
    made.add_sphere("ball", 0.1, placement=(0, 0, 0.11))
    return made


@pytest.fixture(scope="module")
def traj(scene: cvi.Scene) -> cvi.Trajectory:
    return cvi.simulate(scene, duration=0.2, dt=1e-2)


SCENE: dict[str, tuple[Callable[[cvi.Scene], object], str]] = {
    "configuration": (lambda s: s.configuration(3), "values"),
    "velocity": (lambda s: s.velocity([1]), "values"),
    "name": (lambda s: s.copy().add_sphere("\ud800", 0.1), "name"),
    "samples": (lambda s: cvi.simulate(s, duration=0.1, dt=1e-3, sample_dt=1e-12), "sample_dt"),
    "tiny samples": (lambda s: cvi.simulate(s, duration=0.1, dt=1e-3, sample_dt=1e-300), "sample_dt"),
    "iterations": (lambda s: cvi.simulate(s, duration=0.1, dt=1e-3, max_iterations=10**30), "max_iterations"),
    "options": (lambda s: cvi.Options.from_dict(3), "settings"),
    "path": (lambda s: cvi.load_scene("a\0b"), "path"),
    "run": (lambda s: cvi.Trajectory.load(3), "path"),
}
RUN: dict[str, tuple[Callable[[cvi.Trajectory], object], str]] = {
    "on": (lambda t: t.contacts.on(3), "body"),
    "at": (lambda t: t.contacts.at("x"), "t"),
    "array": (lambda t: t.contacts.array("nothing"), "name"),
    "plot": (lambda t: cvi.plot(3), "traj"),
    "plot_forces": (lambda t: cvi.plot_forces(3), "traj"),
}


@pytest.mark.parametrize("case", SCENE)
def test_of_a_scene(scene: cvi.Scene, case: str):
    call, name = SCENE[case]
    with pytest.raises(cvi.InputError) as caught:
        call(scene)
    assert caught.value.name == name


@pytest.mark.parametrize("case", RUN)
def test_of_a_run(traj: cvi.Trajectory, case: str):
    call, name = RUN[case]
    with pytest.raises(cvi.InputError) as caught:
        call(traj)
    assert caught.value.name == name


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[initial]\nq = 3", "q is not usable"),
        ("[initial]\nv = [1]", "v is not usable"),
        ("[contact]\nenable = 3", "enable is not usable"),
        ("[contact]\ndisable = [[1]]", "Entry of disable"),
        ("[[initial.body]]\nname = 'b'\nvelocity = [1, [2]]", "velocity"),
        ("[[initial.body]]\nname = 'b'\nxyz = 3", "xyz"),
        ("[run]\ndt = 1e-3\nmax_iterations = 99999999999999999999", "max_iterations"),
        ("[initial]\nconfiguration = 'home'", "Unknown configuration"),
        ("x = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
    ],
)
def test_of_a_scene_file(tmp_path: Path, text: str, says: str):
    file = tmp_path / "m.toml"
    body = "[[sphere]]\nname = 'b'\nradius = 0.1\n"
    file.write_text(text if text.startswith("x") else body + text)
    with pytest.raises(cvi.ContactviError, match=says):
        cvi.load_scene(file)


def test_special_files_are_no_scenes():
    with pytest.raises(cvi.SceneError, match="a device, a pipe or another special file"):
        cvi.load_scene("/dev/zero")
