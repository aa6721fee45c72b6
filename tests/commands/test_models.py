"""`contactvi run` and `check` of robot models: what is assumed, and the scene file that says it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from contactvi.commands.models import DURATION, HEIGHT, Choice, model_scene
from helpers.extras import needs_mujoco
from helpers.run_scenes import GRAVITY, HAND_URDF, ball_file

OK, WRONG_INPUT = 0, 2
INERTIA = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'


def link(name: str, shape: str = "", xyz: str = "0 0 0") -> str:
    collision = f'<collision><origin xyz="{xyz}"/><geometry>{shape}</geometry></collision>' if shape else ""
    return f'<link name="{name}"><inertial><mass value="1"/>{INERTIA}</inertial>{collision}</link>'


def joint(name: str, parent: str, child: str, kind: str = "continuous", more: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<axis xyz="0 1 0"/>{more}</joint>'


BOX = "<box size='0.4 0.2 0.1'/>"
BRICK = f'<robot name="brick">{link("a", BOX, "0 0 0.3")}</robot>'
ARM = (
    '<robot name="arm"><link name="base"/>'
    + link("upper")
    + joint("shoulder", "base", "upper", more='<origin xyz="0 0 1"/>')
    + '<link name="tip"><inertial><origin xyz="0.5 0 0"/><mass value="1"/>'
    + INERTIA
    + "</inertial></link>"
    + joint("elbow", "upper", "tip")
    + "</robot>"
)
FLOATING = '<robot name="r"><virtual_joint name="w" type="floating" parent_frame="world" child_link="base"/></robot>'


def run(command, *arguments: object) -> tuple[str, cvi.Trajectory]:
    """Run a model without pictures; return what was printed, in one line, and the run."""
    result = command("run", *arguments, "-o", "out", "--no-html", "--no-plot")
    assert result.exit_code == OK, result.stderr
    return " ".join(result.stdout.split()), cvi.Trajectory.load("out/trajectory.npz")


def write(name: str, text: str) -> str:
    Path(name).write_text(text)
    return name


def test_a_free_base_is_dropped_on_a_plane(command):
    text, traj = run(command, write("brick.urdf", BRICK), "--base", "free", "--height", 0.1)
    for words in ("base free", "a plane at z = 0, 0.1 m below", "friction 0.8", "joints limp", "2 s in steps"):
        assert words in text
    assert traj.q[0, 2] == pytest.approx(0.1 - 0.25, abs=1e-12)  # the box hangs 0.25 m above the origin of its link
    assert traj.events[0].time == pytest.approx(math.sqrt(2 * 0.1 / GRAVITY), abs=1e-12)
    assert traj.t[-1] == DURATION
    assert len(traj.contacts.at(DURATION)) == 4
    assert np.abs(traj.v[-1]).max() < 1e-10


def test_the_height_that_is_not_given(command):
    assert run(command, write("brick.urdf", BRICK), "--base", "free")[1].events[0].time == pytest.approx(
        math.sqrt(2 * HEIGHT / GRAVITY), abs=1e-12
    )


def test_a_fixed_base_is_held_and_its_joints_are_limp(command):
    text, traj = run(command, write("arm.urdf", ARM), "--duration", 0.5, "--order", 4)
    assert "base fixed" in text
    assert "none is added: the model is held" in text
    assert traj.t[-1] == 0.5
    assert np.abs(traj.q[-1] - traj.q[0]).max() > 0.1
    assert np.ptp(traj.energy) < 1e-9 * traj.kinetic_energy.max()  # nothing acts but gravity


def test_a_urdf_may_end_in_xml(command):
    assert "base fixed" in run(command, write("arm.xml", ARM), "--duration", 0.1)[0]


def test_the_srdf_says_that_the_base_floats(command):
    arm = ARM.replace('<link name="base"/>', link("base"))
    arguments = write("arm.urdf", arm), "--srdf", write("arm.srdf", FLOATING), "--duration", 0.1
    assert "base free, as the virtual joint of the SRDF says" in run(command, *arguments)[0]
    assert "base fixed, as --base says" in run(command, *arguments, "--base", "fixed", "--force")[0]


MJCF = """<mujoco><option gravity="0 0 -5"/><worldbody>{floor}<body name="ball" pos="0 0 {height}"><freejoint/>
<geom size="0.1"/></body></worldbody>
<keyframe><key name="high" qpos="0 0 7 1 0 0 0" qvel="1 0 0 0 0 0"/></keyframe></mujoco>"""
FLOOR = '<geom type="plane" size="1 1 1"/>'


@needs_mujoco
@pytest.mark.parametrize(
    ("floor", "height", "place"),
    [
        (FLOOR, 1.0, 1.0),  # as the file says
        (FLOOR, 0.05, 0.1 + HEIGHT),  # it overlaps the floor of the file
        ("", 1.0, 0.1 + HEIGHT),
        ("", -3.0, 0.1 + HEIGHT),
    ],
)
def test_the_floor_of_an_mjcf(command, floor, height, place):
    text, traj = run(command, write("m.xml", MJCF.format(floor=floor, height=height)), "--duration", 0.1)
    assert ("ground of the file" if floor else "a plane at z = 0") in text
    assert traj.q[0, 2] == pytest.approx(place, abs=1e-12)
    assert traj.v[-1, 2] == pytest.approx(-0.5, abs=1e-9)  # the gravity of the file
    assert "the files also have high" in text


@needs_mujoco
def test_a_height_that_is_given_is_that_above_the_floor_of_the_file(command):
    path = write("m.xml", MJCF.format(floor=FLOOR, height=1.0))
    text, traj = run(command, path, "--height", 0, "--duration", 0.1)
    assert traj.q[0, 2] == pytest.approx(0.1, abs=1e-12)
    assert "of the file, 0 m below the lowest shape" in text
    assert len(traj.contacts.at(0.1)) == 1


def test_a_height_that_means_nothing_is_said_to(command):
    assert "held; --height is not used" in run(command, write("a.urdf", ARM), "--duration", 0.1, "--height", 0.1)[0]


@needs_mujoco
def test_keys_that_say_nothing_are_not_listed(command):
    """<size nkey="5"/> makes keys without names, which are the start."""
    text = MJCF.format(floor=FLOOR, height=1.0).replace("<worldbody>", '<size nkey="5"/><worldbody>')
    printed, _ = run(command, write("m.xml", text), "--duration", 0.1)
    assert "the files also have high" in printed
    assert "key_" not in printed


@needs_mujoco
def test_a_configuration_of_the_file(command):
    _, traj = run(
        command, write("m.xml", MJCF.format(floor=FLOOR, height=1.0)), "--configuration", "high", "--duration", 0.1
    )
    assert (traj.q[0, 2], traj.v[0, 0]) == (7.0, 1.0)


OVERLAPPING = (
    '<robot name="r">'
    + "".join(link(name, "<sphere radius='0.1'/>") for name in "abc")
    + joint("ab", "a", "b", more='<origin xyz="0.25 0 0"/>')
    + joint("bc", "b", "c", more='<origin xyz="0.3 0 0"/>')
    + "</robot>"
)
FOLDED = '<robot name="r"><group_state name="folded" group="all"><joint name="ab" value="3.0"/></group_state></robot>'
STATE = ("--srdf", "models/r.srdf", "--configuration", "folded", "--base", "free", "--height", "0.2")


@pytest.mark.parametrize(("text", "more"), [(BRICK, ("--base", "free")), (ARM, ()), (OVERLAPPING, STATE)])
def test_the_saved_scene_runs_with_equal_bits(command, text, more):
    """From another folder, with the settings of the command line."""
    Path("models").mkdir()
    Path("scenes").mkdir()
    write("models/r.srdf", FOLDED)
    model = write("models/model.urdf", text)
    printed, traj = run(command, model, *more, "--duration", 0.5, "--order", 4, "--save-scene", "scenes/s.toml")
    assert "Scene file: scenes/s.toml" in printed
    assert command("run", "scenes/s.toml", "-o", "again", "--no-html", "--no-plot").exit_code == OK
    again = cvi.Trajectory.load("again/trajectory.npz")
    assert again.options == traj.options
    np.testing.assert_array_equal(again.q, traj.q)
    np.testing.assert_array_equal(again.v, traj.v)


def test_overlaps_of_the_model_are_left_out_and_told(command):
    Path("models").mkdir()
    write("models/r.srdf", FOLDED)
    text, traj = run(command, write("r.urdf", OVERLAPPING), *STATE, "--duration", 0.1)
    assert "pairs of the model that overlap at the start, left out: a_0 | c_0" in text
    assert {frozenset(pair) for pair in traj.scene.pair_names} == {frozenset((f"{k}_0", "ground")) for k in "abc"}


def test_a_scene_file_of_a_name_with_quotes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / 'a "b" \\ \u00fc'
    folder.mkdir()
    write(str(folder / "m.urdf"), BRICK)
    found = model_scene(str((folder / "m.urdf").relative_to(tmp_path)), Choice(base="free"))
    saved = found.save(Path("s.toml"), {"dt": None, "order": 4}, overwrite=False)
    with pytest.raises(cvi.OverwriteError):
        found.save(Path("s.toml"), {}, overwrite=False)
    scene = cvi.load_scene(saved)
    assert scene.settings == {"dt": 1e-3, "duration": 2.0, "order": 4}
    np.testing.assert_array_equal(scene.q0, found.scene.q0)


def test_check_tells_what_a_run_assumes(command):
    text = command("check", HAND_URDF).stdout
    assert "Assumed of allegro_right_hand.urdf" in text
    assert "none is added: the model is held" in text
    assert "Assumed" not in command("check", ball_file(Path.cwd())).stdout


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("ball.toml", "--base", "free"), "--base is of models"),
        (("ball.toml", "--package-dir", "."), "--package-dir is of models"),
        (("ball.toml", "--save-scene", "s.toml"), "--save-scene is of models"),
        (("m.xml", "--base", "free"), "--base is of URDF files"),
        (("rock.urdf",), "Nothing in the model moves"),
        (("brick.urdf", "--base", "free", "--configuration", "home"), "Unknown configuration"),
        (("brick.urdf", "--base", "loose"), "'fixed' or 'free'"),
        (("brick.urdf", "--base", "free", "--height", "-1"), "height"),
        (("brick.urdf", "--base", "free", "--height", "nan"), "height"),
        (("brik.urdf",), "Did you mean"),
    ],
)
def test_wrong_input(command, arguments, says):
    ball_file(Path.cwd())
    write("m.xml", MJCF.format(floor=FLOOR, height=1.0))
    write("brick.urdf", BRICK)
    write("rock.urdf", BRICK)
    result = command("run", *arguments, "-o", "out")
    assert result.exit_code == WRONG_INPUT
    for text in (says, "expected:", "got:", "remedy:"):
        assert text in result.stderr


SUNK = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 .1"/>
<body name="b" pos="0 0 .098"><freejoint/><geom name="g" size=".1"/></body></worldbody></mujoco>"""


@needs_mujoco
def test_a_start_with_overlaps_is_moved_apart_and_told(command):
    """A ball 2 mm in the floor of its file; 2 cm deep it is lifted, as before."""
    text, traj = run(command, write("m.xml", SUNK), "--duration", 0.1, "--save-scene", "s.toml")
    assert "floor | g overlapped by 0.002 m; the start was moved: 'b' by 2 mm" in text
    assert traj.q[0, 2] == pytest.approx(0.1, abs=1e-12)
    assert command("run", "s.toml", "-o", "again", "--no-html", "--no-plot").exit_code == OK
    np.testing.assert_array_equal(cvi.Trajectory.load("again/trajectory.npz").q, traj.q)
    text, traj = run(command, write("deep.xml", SUNK.replace(".098", ".08")), "--duration", 0.1, "--force")
    assert "0.05 m below the lowest shape" in text
    assert "overlap" not in text
