"""The command line: what it writes, prints and returns."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import contactvi as cvi
from contactvi.progress import RunProgress, describe
from helpers.extras import needs_mujoco
from helpers.playback_data import run_data
from helpers.run_scenes import HAND_URDF, ball_file

OK, WRONG_INPUT, ENDED_EARLY = 0, 2, 3


# -- run --------------------------------------------------------------------------------------------------------------


def test_run_writes_everything(command, tmp_path):
    result = command("run", ball_file(tmp_path), "-o", "out", "--plot")
    assert result.exit_code == OK
    assert sorted(path.name for path in Path("out").iterdir()) == ["energy.png", "playback.html", "trajectory.npz"]
    texts = ("SUCCESS", "1 s simulated in 100 steps", "order 2, dt = 0.01 s", "impacts 1", "x real time")
    for text in (*texts, "out/trajectory.npz"):
        assert text in " ".join(result.stdout.split())
    traj = cvi.Trajectory.load("out/trajectory.npz")
    assert traj.status.ok
    assert len(traj) == 101
    assert "<title>ball</title>" in Path("out/playback.html").read_text()
    assert Path("out/energy.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_line_starts_without_the_engine_and_pinocchio():
    code = "import sys, contactvi.commands.cli; print({'pinocchio', 'coal', 'matplotlib'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "set()"


def test_plots_are_drawn_when_they_are_asked_for(command, tmp_path):
    """A run does not load what draws them; `plot` draws them beside the run, anew where they are there."""
    code = (
        "import sys; from contactvi.commands.cli import app\n"
        f"try: app(['run', {str(ball_file(tmp_path))!r}, '-o', 'out'])\n"
        "except SystemExit as end: print('matplotlib' in sys.modules, end.code)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "False 0"
    assert "contactvi plot out" in run.stdout
    assert sorted(path.name for path in Path("out").iterdir()) == ["playback.html", "trajectory.npz"]
    for _ in range(2):
        assert command("plot", "out", "--no-browser").exit_code == OK
        assert Path("out/energy.png").read_bytes().startswith(b"\x89PNG")
    assert not Path("out/forces.png").exists()  # nothing persists
    assert command("plot", "out/trajectory.npz", "--no-browser", "--format", "svg", "-o", "there").exit_code == OK
    assert "<svg" in Path("there/energy.svg").read_text()
    reported(command("plot", "out", "--no-browser", "--format", "svg", "-o", "there"), "--force")
    reported(command("plot", "out", "--no-browser", "--format", "gif"), "'png' | 'svg'")
    reported(command("plot", "none"), "no such file")


def test_reactions_are_drawn_of_runs_with_constraints(command, tmp_path):
    """Of a pendulum whose string is a distance, and not of a ball without any."""
    scene = Path("loop.toml")
    scene.write_text(
        '[[sphere]]\nname = "ball"\nradius = 0.1\nxyz = [0.5, 0.0, 0.0]\n'
        '[[distance]]\nname = "string"\na = "world"\nb = "ball"\nlength = 0.5\n'
        "[run]\ndt = 1e-2\nduration = 0.2\n"
    )
    assert command("run", scene, "-o", "out", "--no-html", "--plot").exit_code == OK
    assert Path("out/reactions.png").read_bytes().startswith(b"\x89PNG")
    assert command("plot", "out", "--no-browser", "-o", "there", "--format", "svg").exit_code == OK
    assert "<svg" in Path("there/reactions.svg").read_text()
    assert command("run", scene, "-o", "out", "--no-html", "--plot").exit_code == OK  # replaces its own


def test_the_folder_of_a_run_is_reused_by_its_scene_alone(command, tmp_path):
    """Settings may differ; another scene needs --force, and so do results that no run of ours has made."""
    scene = ball_file(tmp_path)
    quick = ("-o", "out", "--no-html", "--no-plot")
    assert command("run", scene, *quick).exit_code == OK
    assert command("run", scene, "--dt", 5e-3, "--duration", 0.5, *quick).exit_code == OK
    before = Path("out/trajectory.npz").read_bytes()
    assert cvi.Trajectory.load("out/trajectory.npz").options.dt == 5e-3
    other = tmp_path / "other.toml"
    other.write_text(Path(scene).read_text() + '\n[[sphere]]\nname = "more"\nradius = 0.1\nxyz = [2.0, 0.0, 3.0]\n')
    result = command("run", other, *quick)
    reported(result, "--force")
    assert "trajectory.npz" in result.stderr
    assert Path("out/trajectory.npz").read_bytes() == before
    assert command("run", other, *quick, "--force").exit_code == OK
    assert cvi.Trajectory.load("out/trajectory.npz").q.shape[1] == 14
    Path("mine").mkdir()
    Path("mine/energy.png").write_text("drawn by hand")
    reported(command("run", scene, "-o", "mine"), "energy.png")
    assert Path("mine/energy.png").read_text() == "drawn by hand"


def test_commands_that_write_beside_a_run_replace_its_page_alone(command, tmp_path):
    cvi.simulate(cvi.load_scene(ball_file(tmp_path)), duration=0.1).save("run.npz")
    assert command("play", "run.npz", "--no-browser").exit_code == OK
    assert command("play", "run.npz", "--no-browser").exit_code == OK  # its own page
    Path("run.html").write_text("<html>mine</html>")
    reported(command("play", "run.npz", "--no-browser"), "--force")
    assert command("play", "run.npz", "--no-browser", "--force").exit_code == OK
    assert command("export", "run.npz").exit_code == OK
    reported(command("export", "run.npz"), "--force")
    assert command("export", "run.npz", "--force").exit_code == OK


def test_run_with_other_settings(command, tmp_path):
    settings = ("--dt", 5e-3, "--duration", 0.5, "--record-every", 10, "--impact", "ctec", "--order", 2)
    settings += ("--solver-tol", 1e-10)
    result = command("run", ball_file(tmp_path), *settings, "--no-html", "--no-plot")
    assert result.exit_code == OK
    assert [path.name for path in Path("ball").iterdir()] == ["trajectory.npz"]  # the folder has the scene's name
    options = cvi.Trajectory.load("ball/trajectory.npz").options
    assert options == cvi.Options(dt=5e-3, duration=0.5, record_every=10, solver_tol=1e-10)


def test_run_that_ends_early(command, tmp_path):
    result = command("run", ball_file(tmp_path, restitution=0.5, duration=3.0), "-o", "out", "--zeno", "end", "--plot")
    assert result.exit_code == ENDED_EARLY
    assert "ended early: ZENO" in result.stderr
    assert "'ball' and 'ground' accumulate" in result.stderr
    assert len(list(Path("out").iterdir())) == 3
    assert cvi.Trajectory.load("out/trajectory.npz").status.code == cvi.StatusCode.ZENO


def test_ctrl_c_keeps_what_was_computed(tmp_path):
    """The real program and the real signal."""
    scene = ball_file(tmp_path, duration=1e5)
    environment = {**os.environ, "PYTHONPATH": str(Path(cvi.__file__).parents[1])}
    arguments = ["run", str(scene), "-o", "out", "--no-html", "--no-plot", "--record-every", "1000000"]
    code = """
from contactvi.commands.cli import app
from contactvi.interrupts import CtrlC

check = CtrlC.check

def first(self):
    CtrlC.check = check
    print("the run has begun", flush=True)
    check(self)

CtrlC.check = first
app()
"""
    run = subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Children of a shell's background job inherit an ignored SIGINT.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert run.stdout is not None
    assert "the run has begun\n" in iter(run.stdout.readline, "")
    run.send_signal(signal.SIGINT)
    _, errors = run.communicate(timeout=30)
    assert run.returncode == ENDED_EARLY, errors
    assert "INTERRUPTED" in errors
    assert cvi.Trajectory.load(tmp_path / "out" / "trajectory.npz").status.code == cvi.StatusCode.INTERRUPTED


def reported(result, *texts: str) -> None:
    """The command refused its input in the form: error, expected, got, remedy; no traceback."""
    assert result.exit_code == WRONG_INPUT
    assert "Error:" in result.stderr
    assert "expected:" in result.stderr
    assert "got:" in result.stderr
    assert "Traceback" not in result.stderr + result.stdout
    for text in texts:
        assert text in result.stderr


def test_wrong_input_of_run(command, tmp_path):
    scene = ball_file(tmp_path)
    reported(command("run", scene, "--dt", -1), "dt is not usable", "-1.0")
    reported(command("run", scene, "--impact", "mch"), "Did you mean 'mhc'", "remedy:")
    reported(command("run", scene, "--impact", "mhc", "--mhc-reference", "start"), "'local' | 'global'")
    reported(command("run", scene, "--duration", 1.0055), "whole number of steps", "Use --duration 1.01")
    reported(command("run", scene, "--fps", 0, "-o", "out"), "fps")
    (tmp_path / "file").write_text("")
    reported(command("run", scene, "-o", "file/out"), "Cannot make the folder")
    assert command("run", "none.toml").exit_code == WRONG_INPUT
    scene.write_text(scene.read_text().replace("restitution", "restituton"))
    result = command("run", scene)
    assert result.exit_code == WRONG_INPUT
    assert "'restitution'" in result.stderr


def test_start_in_penetration(command, tmp_path):
    scene = ball_file(tmp_path)
    scene.write_text(scene.read_text().replace("1.1]", "0.05]"))
    reported(command("run", scene, "-o", "out"), "'ball' and 'ground' overlap by 0.05 m")
    assert list(Path("out").iterdir()) == []


# -- play -------------------------------------------------------------------------------------------------------------


def test_play(command, tmp_path, monkeypatch):
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda url, new=0: opened.append(url) or True)
    command("run", ball_file(tmp_path), "-o", "out", "--no-html", "--no-plot")
    assert command("play", "out/trajectory.npz").exit_code == OK
    assert opened == [(tmp_path / "out" / "trajectory.html").as_uri()]
    assert "<title>out</title>" in Path("out/trajectory.html").read_text()
    result = command("play", "out/trajectory.npz", "--no-browser", "-o", "other.html")
    assert result.exit_code == OK
    assert "other.html" in result.stdout
    assert Path("other.html").is_file()
    assert len(opened) == 1


def test_cameras_of_the_commands(command, tmp_path):
    """What --camera says is in the page of play, and with run in the stored run too."""
    file = ball_file(tmp_path)
    assert command("run", file, "-o", "out", "--camera", '{"follow": "ball"}', "--no-plot").exit_code == OK
    assert "follow" in run_data(Path("out/playback.html").read_text())["camera"]
    assert cvi.Trajectory.load("out/trajectory.npz").scene.camera == {"follow": "ball"}
    assert command("play", "out/trajectory.npz", "--no-browser", "--camera", "top").exit_code == OK
    assert run_data(Path("out/trajectory.html").read_text())["camera"]["preset"] == "top"


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        ("tip", "Did you mean 'top'"),
        ('{"follow": "bal"}', "Did you mean 'ball'"),
        ('{"eye": [0, 0, 1]}', "Add target"),
        ("{follow: ball}", "in single quotes"),
    ],
)
def test_wrong_cameras(command, tmp_path, camera, words):
    result = command("run", ball_file(tmp_path), "-o", "out", "--camera", camera)
    reported(result, words)
    assert not Path("out/trajectory.npz").exists()


def test_wrong_input_of_render(command, tmp_path):
    cvi.simulate(cvi.load_scene(ball_file(tmp_path)), duration=0.1).save("run.npz")
    reported(command("render", "run.npz", "-o", "run.avi"), ".gif, .mp4, .png")
    reported(command("render", "run.npz", "-o", "run.png"), "Use --at 0.5")
    reported(command("render", "run.npz", "--size", "big"), "800x600")
    reported(command("render", "none.npz"), "no such file")
    Path("page.html").write_text("<!DOCTYPE html>\n<html></html>")
    reported(command("run", "page.html"), "page.html is a page, not a scene")
    Path("stored").mkdir()
    Path("run.npz").rename("stored/trajectory.npz")
    reported(command("run", "stored"), "contactvi play stored")
    Path("run.npz").write_text("taken")
    reported(command("run", ball_file(tmp_path), "-o", "run.npz"), "a file of this name")


@pytest.mark.browser
def test_render(command, tmp_path):
    cvi.simulate(cvi.load_scene(ball_file(tmp_path)), duration=0.1).save("run.npz")
    result = command("render", "run.npz", "--size", "64x48", "--fps", 20)
    assert result.exit_code == OK
    assert "run.gif" in result.stdout
    assert Path("run.gif").read_bytes().startswith(b"GIF89a")
    assert command("render", "run.npz", "--at", 0.05, "--size", "64x48", "--camera", "side").exit_code == OK
    assert Path("run.png").read_bytes().startswith(b"\x89PNG")


def test_wrong_input_of_play(command, tmp_path):
    Path("bad.npz").write_bytes(b"no")
    reported(command("play", "bad.npz"), "Cannot read the run bad.npz")
    reported(command("play", "none.npz"), "no such file")


# -- check ------------------------------------------------------------------------------------------------------------


def test_check_urdf(command):
    result = command("check", HAND_URDF)
    assert result.exit_code == OK
    for text in ("joint_15.0", "link_15.0", "damping", "Suspicious"):
        assert text in result.stdout


def test_check_scene_file(command, tmp_path):
    result = command("check", ball_file(tmp_path))
    assert result.exit_code == OK
    assert "ball" in result.stdout
    assert "ground" in result.stdout


@needs_mujoco
def test_check_mjcf(command):
    Path("arm.xml").write_text(
        '<mujoco><worldbody><body name="arm"><joint name="hinge" type="hinge" axis="0 1 0"/>'
        '<geom name="rod" type="capsule" fromto="0 0 0 0 0 -1" size="0.05"/></body></worldbody></mujoco>'
    )
    result = command("check", "arm.xml")
    assert result.exit_code == OK
    assert "hinge" in result.stdout


def test_check_prints_the_report_of_a_refused_model(command):
    """What was found up to the refusal, then the refusal."""
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    Path("arm.urdf").write_text(
        f'<robot name="arm"><link name="a"><inertial><mass value="-1"/>{inertia}</inertial></link></robot>'
    )
    result = command("check", "arm.urdf")
    reported(result, ">= 0 kg")
    assert "Refused (this model" in result.stdout
    assert "Findings: 1 refused" in result.stdout


def test_wrong_input_of_check(command):
    reported(command("check", "hand.sdf"), ".urdf")
    reported(command("check", "hand"), "no ending")
    assert command("check", "none.urdf").exit_code == WRONG_INPUT
    Path("bad.urdf").write_text("<robot")
    assert command("check", "bad.urdf").exit_code == WRONG_INPUT


# -- the program ------------------------------------------------------------------------------------------------------


def test_help_and_version(command):
    assert f"contactvi {cvi.__version__}" in command("--version").stdout
    text = command("--help").stdout
    for name in ("run", "play", "check"):
        assert name in text
    assert "Scene file" in command("run", "--help").stdout
    assert command("dance").exit_code == WRONG_INPUT


def test_progress_text():
    assert describe(0.5, 2.0, 7, 0.25) == "0.5/2 s, 2 x real time, 7 impacts, left"
    with RunProgress(2.0) as bar:  # no terminal: nothing is drawn, nothing fails
        bar(0.5, 7)
        assert bar.seconds >= 0.0


def test_progress_argument_of_simulate(tmp_path):
    scene = cvi.load_scene(ball_file(tmp_path))
    assert cvi.simulate(scene, progress=True).status.ok


@pytest.mark.parametrize(("given", "meant"), [("--timestep", "--dt"), ("--t-end", "--duration"), ("--T", "--duration")])
def test_options_that_others_call_otherwise_lead_to_ours(command, tmp_path, given, meant):
    result = command("run", ball_file(tmp_path), given, "1")
    assert result.exit_code == WRONG_INPUT
    assert f"No such option: {given}" in result.stderr
    assert meant in result.stderr
