"""Arguments of the wrong kind are errors of ours that name the argument, in Python and in scene files."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
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
    "no scene": (lambda s: cvi.simulate(3, duration=0.1, dt=1e-3), "scene"),
    "nothing to step": (lambda s: cvi.Simulator(None, 1e-3), "scene"),
    "nothing to step, no dt": (lambda s: cvi.Simulator("scene.toml"), "scene"),
    "no scene of impacts": (lambda s: cvi.simultaneous_outcomes(3), "scene"),
    "progress": (lambda s: cvi.simulate(s, duration=0.1, dt=1e-3, progress=3), "progress"),
    "progress of arrays": (lambda s: cvi.simulate(s, duration=0.1, dt=1e-3, progress=np.eye(2)), "progress"),
    "ledger": (lambda s: cvi.simulate(s, duration=0.1, dt=1e-3, ledger=np.zeros(2)), "ledger"),
    "folders": (lambda s: s.copy().add_urdf("a.urdf", package_dirs=3), "package_dirs"),
    "folder": (lambda s: s.copy().add_urdf("a.urdf", package_dirs=[3]), "package_dirs"),
    "prefix": (lambda s: s.copy().add_urdf("a.urdf", prefix=slice(1)), "prefix"),
    "free": (lambda s: s.copy().add_sphere("a", 0.1, free=np.eye(2)), "free"),
    "thin": (lambda s: s.copy().add_capsule("a", 1e-300, 0.3), "size"),
    "large": (lambda s: s.copy().add_box("a", (1e200, 1, 1)), "size of 'a'"),
    "complex": (lambda s: cvi.simulate(s, v0=np.ones(6, dtype=complex), duration=0.1, dt=1e-3), "v0"),
    "steps": (lambda s: cvi.simulate(s, duration=1e300, dt=1e-3), "duration"),
    "steps of a simulator": (lambda s: cvi.Simulator(s, 1e-3).run(10**30), "steps"),
    "pairs": (lambda s: cvi.simultaneous_outcomes(s, pairs=3), "pairs"),
    "pair": (lambda s: cvi.simultaneous_outcomes(s, pairs=[3]), "pairs"),
    "pair of lists": (lambda s: cvi.simultaneous_outcomes(s, pairs=[([], [])]), "pairs"),
    "restitution": (lambda s: cvi.simultaneous_outcomes(s, pairs=[("ball", "ground")], e=[[1], [2, 3]]), "e"),
    "speed": (lambda s: cvi.simulate(s, v0=np.full(6, 1.7e308), duration=0.1, dt=1e-3), "v0"),
    "energy": (lambda s: cvi.simulate(s, v0=np.full(6, 1e160), duration=0.1, dt=1e-3, throw=False), "v0"),
    "run": (lambda s: cvi.Trajectory.load(3), "path"),
    "throw": (lambda s: cvi.simulate(s, duration=0.1, dt=1e-3, throw=np.eye(2)), "throw"),
    "throw of auto": (lambda s: cvi.simulate(s, duration=0.1, dt="auto", throw=np.eye(2)), "throw"),
    "points": (lambda s: cvi.simulate(s, duration=0.1, dt=1e-3, contact_points=10**400), "contact_points"),
    "share of points": (lambda s: cvi.Options(1e-3, contact_points=Fraction(10**400, 3)), "contact_points"),
    "step in contact": (lambda s: cvi.simulate(s, duration=0.1, dt=1e-3, dt_contact=1e-20), "dt_contact"),
    "step in contact of a long run": (lambda s: cvi.Options(1e-3, 1e4, dt_contact=1e-13), "dt_contact"),
    "step in contact of a simulator": (lambda s: cvi.Simulator(s, 1e-3, dt_contact=1e-300), "dt_contact"),
    "step in contact of auto": (lambda s: cvi.Options("auto", 0.1, dt_contact=1e-20), "dt_contact"),
    "bound": (lambda s: cvi.Options(1e-3, ledger={"energy": 10**400}), "ledger"),
    "bound below": (lambda s: cvi.Options(1e-3, ledger={"energy": -(10**400)}), "ledger"),
    "order, no dt": (lambda s: cvi.simulate(s, duration=0.1, order=np.eye(2)), "order"),
    "impact, no dt": (lambda s: cvi.simulate(s, duration=0.1, impact=np.eye(2)), "impact"),
    "record, no dt": (lambda s: cvi.simulate(s, duration=0.1, record=np.eye(2)), "record"),
    "record_every, no dt": (lambda s: cvi.simulate(s, duration=0.1, record_every=np.eye(2)), "record_every"),
    "ledger, no dt": (lambda s: cvi.simulate(s, duration=0.1, ledger=np.eye(2)), "ledger"),
    "base": (lambda s: s.copy().add_urdf("a.urdf", base=np.eye(2)), "base"),
    "pairs of no dimension": (lambda s: cvi.simultaneous_outcomes(s, pairs=np.array(1.5)), "pairs"),
    "rows of two lengths": (lambda s: s.velocity({"ball": (np.array(1.5), np.eye(2))}), "velocity"),
    "damping of two lengths": (lambda s: s.copy().set_joint("ball", damping=[[1], [2, 3]]), "damping of 'ball'"),
    "place of several lengths": (lambda s: s.copy().add_sphere("a", 0.1, placement=[[1], [2, 3], [4]]), "placement"),
    "place of words": (lambda s: s.copy().add_sphere("a", 0.1, placement=["a"] * 7), "placement"),
    "more digits than Python writes": (lambda s: cvi.Options(10**5000), "dt"),
    "order of many digits": (lambda s: cvi.Options(1e-3, order=10**5000), "order"),
    "name of an element": (lambda s: s.copy().add_spring("ball", "world", 1.0, name="\ud800"), "name"),
    "body of many digits": (lambda s: s.copy().add_spring("ball", 10**5000, 1.0), "b"),
}
RUN: dict[str, tuple[Callable[[cvi.Trajectory], object], str]] = {
    "on arrays": (lambda t: t.contacts.on(np.eye(2)), "body"),
    "on": (lambda t: t.contacts.on(3), "body"),
    "at a huge number": (lambda t: t.at(10**400), "t"),
    "at": (lambda t: t.contacts.at("x"), "t"),
    "array": (lambda t: t.contacts.array("nothing"), "name"),
    "on an array of no dimension": (lambda t: t.contacts.on(np.array(1.5)), "body"),
    "impulse on an array of no dimension": (lambda t: t.contacts.impulse_on(np.array(1.5)), "body"),
    "browser": (lambda t: cvi.view(t, open_browser=np.eye(2)), "open_browser"),
    "option of the view": (lambda t: cvi.view(t, open_browser=False, speed=2), "speed"),
    "option of the live view": (lambda t: cvi.view(t, open_browser=False, realtime=True), "realtime"),
    "option of the page": (lambda t: t.to_html("a.html", speed=2), "speed"),
    "script of the page": (lambda t: t.to_html("a.html", script="x"), "script"),
    "option of a film": (lambda t: t.render("a.gif", rate=2), "rate"),
    "view": (lambda t: cvi.view(t.scene, open_browser=False), "run"),
    "title": (lambda t: t.to_html("a.html", title=3), "title"),
    "arrows": (lambda t: t.to_html("a.html", forces=np.eye(2)), "forces"),
    "plot": (lambda t: cvi.plot(3), "traj"),
    "plot_forces": (lambda t: cvi.plot_forces(3), "traj"),
    "plot_forces by": (lambda t: cvi.plot_forces(t, by=np.eye(2)), "by"),
    "plot_reactions": (lambda t: cvi.plot_reactions(3), "traj"),
    "plot_reactions of": (lambda t: cvi.plot_reactions(t, [np.eye(2)]), "constraints"),
    "plot_states": (lambda t: cvi.plot_states(3), "traj"),
    "poses": (lambda t: t.poses(np.eye(2)), "body"),
    "poses of a number": (lambda t: t.poses(3), "body"),
    "poses at": (lambda t: t.poses("ball", "x"), "t"),
    "table": (lambda t: t.table(np.eye(2)), "table"),
    "to_pandas": (lambda t: t.to_pandas(None), "table"),
    "to_csv": (lambda t: t.to_csv(3), "folder"),
    "to_csv a table": (lambda t: t.to_csv("tables", "states"), "names"),
    "to_csv tables": (lambda t: t.to_csv("tables", [3]), "table"),
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


@pytest.mark.parametrize("value", [10**400, [10**400], [[1], [2, 3]], np.ones(1, dtype=complex), 1j, "a"])
def test_of_what_functions_return(value: object):
    """Of targets, motions and controls: ours, without a warning of NumPy's."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 1.0), pin.SE3.Identity())
    hinge = cvi.Scene.from_pinocchio(model)
    hinge.set_servo("hinge", 1.0, 1.0)
    moved = cvi.Scene.from_pinocchio(model)
    moved.prescribe("hinge", lambda t: value)
    pushed = cvi.Scene.from_pinocchio(model)
    pushed.add_force(lambda t, q, v: value, check=False)
    run: dict[str, Any] = {"duration": 1e-3, "dt": 1e-3}
    calls = (
        lambda: cvi.simulate(hinge, target=value, **run),
        lambda: cvi.simulate(hinge, target=lambda t: value, **run),
        lambda: cvi.simulate(hinge, target={"hinge": lambda t: value}, **run),
        lambda: cvi.simulate(hinge, control=lambda t, q, v: value, **run),
        lambda: cvi.simulate(moved, **run),
        lambda: cvi.simulate(pushed, **run),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for call in calls:
            with pytest.raises(cvi.InputError):
                call()


def test_a_huge_normal_is_a_direction():
    made = cvi.Scene()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made.add_halfspace(normal=(0, 0, 1e40))
    assert made.collision_model.geometryObjects[0].geometry.n.tolist() == [0.0, 0.0, 1.0]


def test_far_points_have_a_distance_without_a_warning():
    made = cvi.Scene()
    made.add_sphere("ball", 0.1)
    made.add_distance("ball", "world", point_a=(1e40, 0, 0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        traj = cvi.simulate(made, duration=0.1, dt=1e-3, throw=False)
    assert np.all(np.isfinite(traj.q))


def test_special_files_are_no_scenes():
    with pytest.raises(cvi.SceneError, match="a device, a pipe or another special file"):
        cvi.load_scene("/dev/zero")


def test_a_control_of_other_arguments_is_refused():
    made = cvi.Scene()
    made.add_sphere("ball", 0.1)
    with pytest.raises(cvi.InputError, match=r"expected a function of \(t, q, v\), got one of \(\)"):
        cvi.simulate(made, duration=0.01, dt=1e-3, control=lambda: 1)
    traj = cvi.simulate(made, duration=0.01, dt=1e-3, control=lambda *state: np.zeros(6))
    with pytest.raises(cvi.InputError, match="expected a name, several names, or a handle"):
        traj.contacts.of(np.zeros(3), "ball")
