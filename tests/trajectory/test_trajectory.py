"""Trajectory: what follows from its arrays, interpolation, and the file it is kept in."""

from __future__ import annotations

import io
import os
import pickle
import re
import subprocess
import sys
import zipfile
from dataclasses import fields
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.records import contacts, dense_steps
from contactvi.records.inputs import STORED
from contactvi.trajectory import polynomials as dense
from contactvi.trajectory import storage
from helpers.run_scenes import FIRST_IMPACT, GRAVITY, HEIGHT, RADIUS, ball_scene, hand_scene, slider_scene

EPS = np.finfo(float).eps
ARRAYS = ("t", "q", "p", "v", "energy", "kinetic_energy", "potential_energy", "modified_energy", "impact_energy")


@pytest.fixture(scope="module")
def ball() -> cvi.Trajectory:
    """Falls one metre, spinning and drifting, loses energy at four impacts."""
    scene = ball_scene(restitution=0.8)
    v0 = scene.velocity({"ball": ((0.5, -0.2, 0.0), (0.0, 3.0, 7.0))})
    return cvi.simulate(scene, None, v0, duration=2.5, dt=1e-2)


@pytest.fixture(scope="module")
def hand() -> cvi.Trajectory:
    scene, q0 = hand_scene()
    return cvi.simulate(scene, q0, duration=0.8, dt=1e-3)


# -- what follows from the arrays -------------------------------------------------------------------------------------


def test_velocity_and_energy_are_those_of_pinocchio(hand):
    model, data = hand.scene.model, hand.scene.model.createData()
    stiffness = np.where([joint.nq == 1 for joint in model.joints], 1.0, 0.0)
    for k in (0, 300, 800):
        q, v, p = hand.q[k], hand.v[k], hand.p[k]
        inertia = pin.crba(model, data, q, pin.Convention.WORLD)
        scale = np.abs(inertia) @ np.abs(v) + 1e-12
        assert np.all(np.abs(inertia @ v - p) <= 1e3 * EPS * scale.max())
        assert hand.kinetic_energy[k] == pytest.approx(pin.computeKineticEnergy(model, data, q, v), rel=1e-12)
        springs = sum(
            0.5 * stiffness[i] * (q[joint.idx_q] - hand.q[0][joint.idx_q]) ** 2
            for i, joint in enumerate(model.joints)
            if joint.nq == 1
        )
        expected = pin.computePotentialEnergy(model, data, q) + springs
        assert hand.potential_energy[k] == pytest.approx(expected, rel=1e-12)
    np.testing.assert_array_equal(hand.energy, hand.kinetic_energy + hand.potential_energy)


def test_derived_arrays_are_computed_once(ball):
    assert ball.v is ball.v
    assert ball.modified_energy is ball.modified_energy
    assert ball.modified_energy.shape == ball.energy.shape == ball.t.shape


def test_impacts_account_for_the_energy(ball):
    """H jumps by (gamma+^2 - gamma-^2) / (2 G_c) at an impact and is constant between them."""
    model, data = ball.scene.model, ball.scene.model.createData()
    for event in ball.events:
        inverse = np.linalg.inv(pin.crba(model, data, event.q, pin.Convention.WORLD))
        jump = 0.5 * (event.p_plus @ inverse @ event.p_plus - event.p_minus @ inverse @ event.p_minus)
        assert event.energy_change == pytest.approx(jump, abs=1e-12 * ball.energy[0])
        assert event.gamma_plus == pytest.approx(-0.8 * event.gamma_minus, rel=16 * EPS)
    rest = ball.energy - ball.energy[0] - ball.impact_energy
    assert np.abs(rest).max() <= 10 * ball.options.solver_tol * ball.energy[0]


def test_events_are_a_sequence(ball):
    log = ball.events
    assert len(log) == len(list(log)) == 4
    assert log[-1].time == log[3].time == log.array("time")[3]
    assert [event.time for event in log[1:3]] == list(log.array("time")[1:3])
    assert log[0].kind == "contact"
    assert log[0].method == "ctec"
    assert log[0].fallback is None
    assert "ball | ground" in str(log[0])
    with pytest.raises(IndexError):
        log[4]


def test_gaps_of_the_pairs_that_touched(ball):
    times, pairs, gaps = ball.gaps
    assert pairs == [("ball", "ground")]
    assert gaps[:, 0] == pytest.approx(ball.q[:, 2] - RADIUS, abs=1e-12)
    np.testing.assert_array_equal(times, ball.t)


def test_gaps_along_a_run_are_those_of_single_configurations():
    """To the bit, in any order of pairs: a distance does not depend on those that were computed before it."""
    scene, start = hand_scene()
    traj = cvi.simulate(scene, start, duration=0.3, dt=1e-3)
    core, pairs = scene.core(), np.arange(len(scene.pair_names))[::-3].copy()
    single = np.array([core.gaps(q)[0][pairs] for q in traj.q[::20]])
    np.testing.assert_array_equal(core.gaps_along(traj.q[::20].copy(), pairs), single)
    assert core.gaps_along(traj.q[:2], pairs[:0]).shape == (2, 0)
    for wrong in (traj.q[:, :-1].copy(), traj.q):
        with pytest.raises(cvi.ContactviError):
            core.gaps_along(wrong, np.array([len(scene.pair_names)]))


# -- interpolation ----------------------------------------------------------------------------------------------------


def test_nodes_and_impacts_are_met(ball):
    """To rounding: pin.interpolate and the normalisation of quaternions cost a few bits."""
    assert ball.resample(ball.t) == pytest.approx(ball.q, abs=64 * EPS)
    for event in ball.events:
        assert ball.resample([event.time])[0] == pytest.approx(event.q, abs=64 * EPS)


def test_between_the_nodes(ball):
    """A chord of the parabola is off by at most g dt^2 / 8, sideways the ball flies straight although it spins."""
    times = np.linspace(0.0, FIRST_IMPACT, 777)
    q = ball.resample(times)
    height = RADIUS + HEIGHT - 0.5 * GRAVITY * times**2
    assert np.abs(q[:, 2] - height).max() <= GRAVITY * 1e-4 / 8 * (1 + 1e-6)
    assert q[:, 0] == pytest.approx(0.5 * times, abs=1e-12)
    assert q[:, 1] == pytest.approx(-0.2 * times, abs=1e-12)
    assert np.all(ball.resample(np.linspace(0, 2.5, 1001))[:, 2] >= RADIUS - 1e-12)


@pytest.mark.parametrize("time", [-0.1, 2.6, np.nan])
def test_outside_the_run(ball, time):
    for ask in (ball.at, ball.resample):
        with pytest.raises(cvi.InputError, match=r"expected a time in \[0, 2.5\] s"):
            ask(time)


# -- the file ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ball", "hand"])
def test_round_trip(name, request, tmp_path):
    traj = request.getfixturevalue(name)
    loaded = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    for array in ARRAYS:
        np.testing.assert_array_equal(getattr(loaded, array), getattr(traj, array))
    assert loaded.status == traj.status
    assert loaded.stats == traj.stats
    assert loaded.options == traj.options
    assert loaded.gaps[1] == traj.gaps[1]
    np.testing.assert_array_equal(loaded.gaps[2], traj.gaps[2])
    assert len(loaded.events) == len(traj.events)
    for a, b in zip(loaded.events, traj.events, strict=True):
        for field in fields(a):
            np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name))
    for a, b in zip(loaded.visuals, traj.visuals, strict=True):
        for field in fields(a):
            np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name))
    assert loaded.scene.pair_names == traj.scene.pair_names
    times = np.linspace(traj.t[0], traj.t[-1], 57)
    np.testing.assert_array_equal(loaded.resample(times), traj.resample(times))


def test_a_loaded_run_can_be_run_again(ball, tmp_path):
    loaded = cvi.Trajectory.load(ball.save(tmp_path / "run.npz"))
    again = cvi.simulate(loaded.scene, loaded.q[0], loaded.v[0], duration=2.5, dt=1e-2)
    # Pinocchio's numbers of an inertia are rounded on the way through plain data; impacts pass that on, no more.
    assert again.q == pytest.approx(ball.q, abs=1e-10)


def test_limits_and_runs_without_events_are_stored(tmp_path):
    for steps in (10, 400):
        traj = cvi.simulate(slider_scene(), duration=steps * 1e-3, dt=1e-3)
        loaded = cvi.Trajectory.load(traj.save(tmp_path / "run.npz", overwrite=True))
        assert [event.pair for event in loaded.events] == [event.pair for event in traj.events]
        assert loaded.gaps[1] == []


def test_partial_run_is_stored(tmp_path):
    traj = cvi.simulate(ball_scene(0.5), duration=3.0, dt=1e-2, throw=False, zeno="end")
    loaded = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    assert loaded.status == traj.status
    assert not loaded.status.ok


def test_every_entry_is_documented(ball, tmp_path):
    with np.load(ball.save(tmp_path / "run.npz"), allow_pickle=False) as file:
        stored = set(file.files)
    described = set(re.findall(r"^([a-zA-Z_]+(?:/[a-zA-Z_0-9]+)?) {2,}\(", storage.__doc__, re.MULTILINE))
    stored |= {"discrete_energy"}  # of DTEC's runs, tests/simulation/test_impact_options.py
    stored |= {f"segment/{name}" for name in dense.FIELDS} - {"segment/persistent"}  # of runs with polynomials
    stored |= {"segment/held", "segmentK/trees"}  # the latter of runs in which groups of bodies are run apart
    stored |= {f"contact/{name}" for name in contacts.FIELDS}  # of runs with contacts
    stored |= {f"change/{name}" for name in contacts.CHANGE_FIELDS} | {f"phase/{name}" for name in ("t", "dt", "held")}
    stored |= {f"dense/{name}" for name in dense_steps.FIELDS}  # of runs with dense steps
    stored |= {"force/work", "force/reactions"}  # tests/elements/test_elements.py
    stored |= {f"input/{name}" for name in ("saturated", "control", "target", *STORED)}  # test_stored_inputs.py
    stored |= {"effort"}  # of runs with driven joints, tests/trajectory/test_efforts.py
    stored |= {"arc/t", "arc/dt"}  # of runs with dt "auto", tests/simulation/test_adaptive.py
    assert described == {name for name in stored if not name.startswith("array/")}


def test_replay_needs_no_engine(hand, tmp_path):
    """Loading, the page and the figure work where contactvi._core cannot be imported."""
    hand.save(tmp_path / "run.npz")
    program = """
import sys
sys.modules["contactvi._core"] = None
import contactvi as cvi
traj = cvi.Trajectory.load("run.npz")
traj.to_html("run.html")
cvi.plot(traj).savefig("run.png")
print(traj.energy[-1], traj.resample([0.1234])[0])
"""
    environment = {**os.environ, "PYTHONPATH": str(Path(cvi.__file__).parents[1])}
    command = [sys.executable, "-c", program]
    run = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "run.html").stat().st_size > 500_000
    assert (tmp_path / "run.png").stat().st_size > 10_000


# -- files that are something else ------------------------------------------------------------------------------------


def rewrite(path: Path, **changes: np.ndarray | None) -> None:
    """Change entries of an npz; None removes one."""
    with np.load(path) as file:
        entries = {name: file[name] for name in file.files}
    for name, value in changes.items():
        key = name.replace("__", "/")
        if value is None:
            del entries[key]
        else:
            entries[key] = value
    np.savez(path, **entries)


def header(path: Path) -> str:
    with np.load(path) as file:
        return str(file["header"])


class Bomb:
    """Would leave a mark if it were unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return (Path.touch, (self.mark,))


@pytest.fixture
def saved(ball, tmp_path) -> Path:
    return ball.save(tmp_path / "run.npz")


@pytest.mark.parametrize("part", [0.0, 0.001, 0.3, 0.9, 0.999])
def test_truncated_file(saved, part):
    data = saved.read_bytes()
    saved.write_bytes(data[: int(part * len(data))])
    with pytest.raises(cvi.SceneError, match="Cannot read the run") as caught:
        cvi.Trajectory.load(saved)
    assert caught.value.path == str(saved)


def test_damaged_bytes(saved):
    data = bytearray(saved.read_bytes())
    middle = len(data) // 3
    data[middle : middle + 200] = bytes(200)
    saved.write_bytes(bytes(data))
    with pytest.raises(cvi.SceneError, match="Cannot read the run"):
        cvi.Trajectory.load(saved)


@pytest.mark.parametrize("content", [b"", b"hello\n" * 100, b"\x93NUMPY\x01\x00", b"PK\x03\x04" + bytes(50)])
def test_not_an_npz(tmp_path, content):
    path = tmp_path / "run.npz"
    path.write_bytes(content)
    with pytest.raises(cvi.ContactviError, match=r"expected an npz file written by Trajectory\.save"):
        cvi.Trajectory.load(path)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(cvi.SceneError, match="no such file"):
        cvi.Trajectory.load(tmp_path / "none.npz")
    with pytest.raises(cvi.SceneError, match="no such file"):
        cvi.Trajectory.load(tmp_path)


def test_single_array(tmp_path):
    np.save(tmp_path / "run.npy", np.zeros(3))
    with pytest.raises(cvi.SceneError, match="one array, not an npz"):
        cvi.Trajectory.load(tmp_path / "run.npy")


def test_nothing_is_unpickled(saved, tmp_path):
    mark = tmp_path / "mark"
    (tmp_path / "pickle.npz").write_bytes(pickle.dumps(Bomb(mark)))
    objects = io.BytesIO()
    np.save(objects, np.array([Bomb(mark)], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(saved, "a") as archive:
        archive.writestr("more.npy", objects.getvalue())
    for path in (tmp_path / "pickle.npz", saved):
        with pytest.raises(cvi.SceneError, match="Cannot read the run"):
            cvi.Trajectory.load(path)
    assert not mark.exists()


def test_a_password_is_said(saved):
    data = bytearray(saved.read_bytes())
    for start in (i for i in range(len(data)) if data.startswith(b"PK\x01\x02", i)):
        data[start + 8] |= 1  # encrypted
    saved.write_bytes(data)
    with pytest.raises(cvi.SceneError, match="encrypted"):
        cvi.Trajectory.load(saved)


def test_lines_have_a_joint_for_each_vertex(tmp_path):
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    scene.add_spring("ball", "world", 10.0, point_b=(0, 0, 1))
    path = cvi.simulate(scene, duration=0.01, dt=1e-3).save(tmp_path / "run.npz")
    with np.load(path) as file:
        lines = {k: file[k] for k in file.files if k.startswith("array/") and file[k].shape == (2, 3)}
    assert lines
    rewrite(path, **{name: np.zeros((0, 3), dtype=np.float32) for name in lines})
    with pytest.raises(cvi.SceneError, match="expected two vertices or more"):
        cvi.Trajectory.load(path)


def test_other_schema(saved):
    rewrite(saved, header=np.array(header(saved).replace('"schema": 9', '"schema": 10')))
    with pytest.raises(cvi.SceneError, match="expected schema 9, got schema 10"):
        cvi.Trajectory.load(saved)


@pytest.mark.parametrize(
    "changes",
    [
        {"header": None},
        {"header": np.array("not json")},
        {"header": np.array("[1, 2]")},
        {"header": np.array('{"format": "contactvi-trajectory", "schema": 9}')},
        {"header": np.array("[" * 100_000)},
        {"header": np.zeros(3)},
        {"t": None},
        {"t": np.zeros(251)},
        {"t": np.arange(250.0)},
        {"t": np.zeros(0)},
        {"q": np.zeros((251, 8))},
        {"q": np.full((251, 7), np.nan)},
        {"q": np.zeros((251, 7), dtype=np.float32)},
        {"v": np.zeros((7, 251))},
        {"modified_energy": np.zeros((251, 1))},
        {"event__time": np.zeros((4, 1))},
        {"event__index": np.array([0, 0, 0, 99])},
        {"event__index": np.array([0, 0, 0, -1])},
        {"event__kind": np.array([0, 0, 0, 2])},
        {"event__q": None},
        {"event__q": np.full((4, 7), -np.inf)},
        {"event__impulse": np.full(4, np.nan)},
        {"event__energy_change": np.full(4, np.nan)},
        {"kinetic_energy": np.full(251, np.inf)},
        {"potential_energy": np.full(251, np.inf)},
        {"gap__time": np.full(251, np.nan)},
        {"gap__value": np.zeros((251, 2))},
        {"array__0": None},
        {"array__0": np.ones((3, 3), dtype=complex)},
    ],
)
def test_inconsistent_entries(saved, changes):
    rewrite(saved, **changes)
    with pytest.raises(cvi.ContactviError, match="Cannot read the run"):
        cvi.Trajectory.load(saved)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"dt": 0.01', '"dt": -0.01'),
        ('"code": 0', '"code": 77'),
        ('"dt": 0.01', '"delta": 0.01'),
        ('"type": "free"', '"type": "rope"'),
        ('"shape": "sphere"', '"shape": 5'),
        ('"steps": ', '"leaps": '),
        ('"placement": [[1.0,', '"placement": [[0.0,'),
        ('"placement": [[1.0,', '"placement": [[-1.0,'),
        ('"placement": [[1.0,', '"placement": [[1e300,'),
    ],
)
def test_wrong_header(saved, old, new):
    text = header(saved)
    assert old in text
    rewrite(saved, header=np.array(text.replace(old, new)))
    with pytest.raises(cvi.ContactviError):
        cvi.Trajectory.load(saved).to_html(saved.with_suffix(".html"))


@pytest.mark.parametrize("color", ["[]", "[0.1, 0.2, 0.3]", "[0.1, 0.2, 0.3, NaN]", '["a", "b", "c", "d"]', "5"])
def test_colours_are_four_numbers(saved, color):
    text, count = re.subn(r'"color": (\[[^]]*\]|null)', f'"color": {color}', header(saved))
    assert count
    rewrite(saved, header=np.array(text))
    with pytest.raises(cvi.SceneError, match="Cannot read the run"):
        cvi.Trajectory.load(saved)


@pytest.mark.parametrize("h", [5e-324, 1e-160])
def test_contacts_of_steps_too_short_for_their_impulse(tmp_path, h):
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, placement=(0, 0, 0.1))
    traj = cvi.simulate(scene, duration=0.02, dt=1e-3, contact_mode="steps")
    path = traj.save(tmp_path / "run.npz")
    lengths = np.array(traj.contacts.h)
    assert np.any(traj.contacts.impulse)
    rewrite(path, contact__h=np.where(lengths > 0.0, h, lengths))
    with pytest.raises(cvi.SceneError, match="forces larger than those of any run"):
        cvi.Trajectory.load(path)


def test_a_run_that_ended_may_have_an_infinite_energy(tmp_path):
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    traj = cvi.simulate(scene, duration=0.01, dt=1e-3)
    path = traj.save(tmp_path / "run.npz")
    text = header(path).replace('"code": 0', '"code": 3')
    rewrite(path, potential_energy=np.full(len(traj.t), np.inf), header=np.array(text))
    assert cvi.Trajectory.load(path).potential_energy[0] == np.inf


# -- writing ----------------------------------------------------------------------------------------------------------


def test_a_failed_save_leaves_the_old_file(ball, saved, monkeypatch):
    before = saved.read_bytes()

    def fail(file, **entries):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(cvi.InputError, match="No space left on device"):
        ball.save(saved, overwrite=True)
    assert saved.read_bytes() == before
    assert [path.name for path in saved.parent.iterdir()] == ["run.npz"]


def test_saving_into_no_folder(ball, tmp_path):
    with pytest.raises(cvi.InputError, match="Create the folder"):
        ball.save(tmp_path / "none" / "run.npz")


def test_saved_file_is_an_ordinary_one(saved):
    old = os.umask(0)
    os.umask(old)
    assert saved.stat().st_mode & 0o777 == 0o666 & ~old
