"""`contactvi check-gradient`: what it prints, and its exit codes."""

from __future__ import annotations

from pathlib import Path

import contactvi as cvi
from helpers.run_scenes import ball_file

OK, FAILED, WRONG_INPUT, ENDED_EARLY, NO_DERIVATIVE = 0, 1, 2, 3, 4
COLUMNS = 100


def test_columns_that_agree(command, tmp_path):
    scene = ball_file(tmp_path, restitution=0.7)
    result = command("check-gradient", scene, "--duration", 0.6, "--order", 4, "--wrt", "q0,v0,restitution")
    assert result.exit_code == OK, result.stderr
    assert "1 events, growth" in result.stdout
    assert "ball | ground" in result.stdout
    assert "12 of 13 columns compared: 12 agree to 1e-07" in result.stdout
    assert max(map(len, result.stdout.splitlines())) <= COLUMNS
    few = command(
        "check-gradient", scene, "--duration", 0.1, "--columns", 3, "--wrt", "q0, v0 ,restitution", "--seed", 4
    )
    assert "3 of 13 columns compared" in few.stdout
    for name in ("q0[", "v0[", "restitution "):
        assert sum(line.startswith(name) for line in few.stdout.splitlines()) == 1


ROD = """
[[sphere]]
name = "bob"
radius = 0.1
xyz = [1.0, 0.0, 0.0]
[[distance]]
a = "world"
b = "bob"
[[halfspace]]
normal = [0.0, 0.0, 1.0]
offset = -0.5
[run]
dt = 0.01
duration = 0.5
"""


def test_starts_are_brought_back_to_the_constraints(command, tmp_path):
    """A ball on a rod swings to the ground."""
    (tmp_path / "rod.toml").write_text(ROD)
    result = command("check-gradient", tmp_path / "rod.toml", "--wrt", "q0,v0,restitution")
    assert result.exit_code == OK, result.stderr
    assert "1 events, growth" in result.stdout
    assert "12 of 13 columns compared: 12 agree to 1e-07" in result.stdout


def test_a_fault_is_found(command, tmp_path, monkeypatch):
    """An exact derivative that is wrong by 1e-6 is named, with the exit code 1."""
    right = cvi.Trajectory.sensitivity

    def wrong(self, *args, **options):
        found = right(self, *args, **options)
        found.matrix[-1][:, 2] *= 1.0 + 1e-6
        return found

    monkeypatch.setattr(cvi.Trajectory, "sensitivity", wrong)
    result = command("check-gradient", ball_file(tmp_path), "--duration", 0.5, "--wrt", "q0")
    assert result.exit_code == FAILED
    bad = [line for line in result.stdout.splitlines() if "a fault" in line]
    assert len(bad) == 1
    assert bad[0].startswith("q0[2] ball[2]")
    assert "neither" in bad[0]
    assert "5 agree to 1e-07, 1 disagree" in result.stdout


def test_a_kink_is_told(command, tmp_path):
    """Two balls that hit the ground at one instant: no derivative, or that of the order taken, without differences."""
    scene = Path(ball_file(tmp_path))
    other = '[[sphere]]\nname = "other"\nradius = 0.1\nxyz = [1.0, 0.0, 1.1]\n[[halfspace]]'
    scene.write_text(scene.read_text().replace("[[halfspace]]", other))
    refused = command("check-gradient", scene, "--duration", 0.6)
    assert refused.exit_code == NO_DERIVATIVE
    for text in ("one instant", "expected:", "got:", "remedy:"):
        assert text in refused.stderr
    taken = command("check-gradient", scene, "--duration", 0.6, "--on-kink", "taken", "--wrt", "v0", "--columns", 20)
    assert taken.exit_code == OK
    rows = {line.split()[1]: line for line in taken.stdout.splitlines() if line.startswith("v0")}
    assert "exact" in rows["ball[2]"]
    assert "a kink" in rows["ball[2]"]
    assert "both" in rows["ball[0]"]


def test_other_exit_codes(command, tmp_path):
    scene = ball_file(tmp_path, restitution=0.5, duration=3.0)
    refused = command("check-gradient", scene, "--wrt", "v0", "--duration", 0.6, "--impact", "mhc", "--order", 2)
    assert refused.exit_code == NO_DERIVATIVE
    assert "Error:" in refused.stderr
    for wrong in (("--wrt", "mass"), ("--dt", -1), ("--columns", -3), ("--on-kink", "ignore"), ("--impact", "mch")):
        result = command("check-gradient", scene, "--duration", 0.1, *wrong)
        assert result.exit_code == WRONG_INPUT, wrong
        assert "remedy:" in result.stderr
    assert command("check-gradient", "none.toml").exit_code == WRONG_INPUT
