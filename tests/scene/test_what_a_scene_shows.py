"""What a scene says of itself, what is refused of it, and `load` for all files."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi
from helpers.run_scenes import HAND_URDF, ball_file, ball_scene


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("Q0", "Did you mean 'q0'"),
        ("seting", "Did you mean 'settings'"),
        ("restitution", "set_contact(restitution=...)"),
        ("gravity", "Scene(gravity=(0, 0, -9.81))"),
        ("dt", 'settings["dt"]'),
        ("add_sphere", "Call it"),
        ("nq", "follows from what was added"),
    ],
)
def test_attributes_that_a_scene_has_not_are_refused(name, says):
    scene = ball_scene()
    before = dict(vars(scene))
    with pytest.raises(cvi.InputError) as told:
        setattr(scene, name, 1.0)
    assert says in str(told.value)
    assert told.value.name == name
    assert vars(scene) == before


def test_attributes_that_a_scene_has_are_set():
    scene = ball_scene()
    scene.q0, scene.v0, scene.camera = scene.neutral(), np.zeros(6), "front"
    scene.settings["dt"] = 1e-2
    assert scene.copy().camera == "front"
    assert cvi.simulate(scene, duration=0.1).options.dt == 1e-2


def test_a_class_of_the_user_may_have_more():
    class Bench(cvi.Scene):
        pass

    scene = Bench()
    scene.note = "mine"
    assert scene.copy().note == "mine"


def test_a_scene_is_printed_with_its_sizes():
    scene = cvi.Scene()
    scene.add_urdf(HAND_URDF)
    scene.add_sphere("ball", 0.03, placement=(0.0, 0.0, 0.3))
    scene.add_spring("palm_link", "ball", stiffness=3.0)
    pairs, bodies = len(scene.pair_names), sum(len(part.bodies) for part in scene.parts)
    first, *parts = str(scene).splitlines()
    assert first == repr(scene)
    assert first == f"<Scene: nq 23, nv 22, {bodies} bodies, {pairs} pairs, 2 parts, 1 element>"
    assert any(line.startswith("  ball: 1 body, 1 joint, 1 shape") for line in parts)
    assert "spring" in parts[-1]


def test_the_line_of_a_scene_builds_nothing():
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    assert repr(scene) == "<Scene: nq 7, nv 6, 1 body, 1 part, 0 elements>"


@pytest.mark.parametrize(
    "run",
    [
        lambda scene: cvi.simulate(scene, duration=1.0),
        lambda scene: cvi.Simulator(scene, dt=1e-3),
        lambda scene: cvi.simulate_batch(scene, duration=1.0),
    ],
)
def test_an_empty_scene_says_so(run):
    scene = cvi.Scene()
    with pytest.raises(cvi.InputError, match=r"The scene is empty: expected .*got no parts.*add_sphere"):
        run(scene)


def test_load_reads_every_file_of_ours_by_what_is_in_it(tmp_path):
    scene = cvi.load(ball_file(tmp_path))
    assert isinstance(scene, cvi.Scene)
    (tmp_path / "out").mkdir()
    traj = cvi.simulate(scene)
    traj.save(tmp_path / "out" / "trajectory.npz")
    for path in (tmp_path / "out", tmp_path / "out" / "trajectory.npz"):
        run = cvi.load(path)
        assert isinstance(run, cvi.Trajectory)
        np.testing.assert_array_equal(run.q, traj.q)
    cvi.simulate_batch(scene, np.tile(scene.q0, (3, 1)), path=tmp_path / "runs.bin")
    batch = cvi.load(tmp_path / "runs.bin")
    with pytest.raises(cvi.SceneError, match="is a batch of runs"):
        cvi.Trajectory.load(tmp_path / "runs.bin")
    assert isinstance(batch, cvi.StoredBatch)
    assert len(batch) == 3


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("none.npz", "There is no file"),
        ("folder", "a folder with trajectory.npz"),
        ("arm.urdf", "scene.add_urdf"),
        ("text.npz", "a file of another kind"),
        ("objects.npz", "Python objects"),
        ("objects.npy", "Python objects"),
        ("other.npz", "without the entry 'header'"),
        ("page.html", "got a page. Name the file of its run, trajectory.npz"),
        ("states.csv", "got a table"),
    ],
)
def test_what_load_cannot_read(tmp_path, name, says):
    (tmp_path / "folder").mkdir()
    (tmp_path / "arm.urdf").write_text("<robot/>")
    (tmp_path / "text.npz").write_text("hello")
    np.savez(tmp_path / "objects.npz", header=np.array([{}], dtype=object))
    np.save(tmp_path / "objects.npy", np.array([{}], dtype=object))
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for shown in ("page.html", "states.csv"):
        (tmp_path / shown).write_text("hello")
    with pytest.raises(cvi.SceneError) as told:
        cvi.load(tmp_path / name)
    assert says in str(told.value)
    assert "allow_pickle" not in str(told.value)


@pytest.mark.parametrize("read", [cvi.Trajectory.load, cvi.load_batch])
def test_no_advice_on_pickles_reaches_a_user(tmp_path, read):
    """NumPy's way out of files with Python objects in them runs code of the file."""
    np.savez(tmp_path / "objects.npz", header=np.array([{}], dtype=object))
    np.save(tmp_path / "objects.npy", np.array([{}], dtype=object))
    (tmp_path / "text").write_text("hello")
    for name in ("objects.npz", "objects.npy", "text"):
        with pytest.raises(cvi.SceneError) as told:
            read(tmp_path / name)
        assert "allow_pickle" not in str(told.value)
        assert "unsafe" not in str(told.value)


def test_contacts_and_ledger_and_sensors_show_themselves():
    scene = ball_scene()
    traj = cvi.simulate(scene, duration=1.0, dt=1e-2)
    (contact,) = traj.contacts
    assert repr(contact).startswith("<Contact: t = ")
    for text in ("ball | ground", "impact", f"{np.linalg.norm(contact.impulse):.6g} N s"):
        assert text in repr(contact)
    assert "<th" in contact._repr_html_()
    assert f"{contact.impulse[2]:.6g}" in contact._repr_html_()
    assert repr(traj.ledger).startswith("<Ledger: 101 nodes, 1 impacts")
    lines = [line.split() for line in str(traj.ledger).splitlines()[1:]]
    rows = {words[0]: float(words[1]) for words in lines if words[0] in ("energy_balance", "own_jump")}
    assert rows["energy_balance"] == pytest.approx(np.abs(traj.ledger.energy_balance).max(), rel=0.01)
    assert rows["own_jump"] == pytest.approx(np.abs(traj.ledger.own_jump).max(), rel=0.01)
    assert "own_jump" in traj.ledger._repr_html_()


def test_sensors_show_what_they_read():
    sim = cvi.Simulator(ball_scene(), dt=1e-3)
    sensors = cvi.Imu(sim, "ball"), cvi.ContactSensor(sim, "ball"), cvi.JointEncoder(sim, "ball")
    for sensor in sensors:
        assert "nothing to read before the first step" in repr(sensor)
        assert "nothing before the first step" in sensor._repr_html_()
    sim.reset()
    sim.step()
    imu, touch, encoder = map(repr, sensors)
    assert imu.startswith("<Imu on 'ball' at t = 0.001 s: specific force (")
    assert "force (0, 0, 0) N, torque (0, 0, 0) N m, points 0" in touch
    assert f"{sim.q[2]:.6g}" in encoder
    assert all("t</th>" in sensor._repr_html_() for sensor in sensors)
