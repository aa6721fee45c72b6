"""`contactvi verify`: its list, single cases, exit codes, and that it can fail."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import contactvi as cvi
from contactvi.reproduce.check import Check, at_least, at_most, near, same
from contactvi.verify import report
from contactvi.verify import verify as verification
from contactvi.verify.case import COMPLEMENTARITY, GAP, Case, Runs
from helpers.run_scenes import ball_scene

PASSED, FAILED, WRONG_INPUT = 0, 1, 2
FAST = ("ball-chains", "three-balls", "rod", "joint-friction-stop", "screw", "slider-crank")


def wrong(_runs: Runs) -> list[Check]:
    return [near("one", 1.0, 1.0, 0.0, "exact"), near("two", 2.0, 2.1, 0.05, "to fail")]


def breaks(_runs: Runs) -> list[Check]:
    raise ValueError("what a pity")


def nothing(_runs: Runs) -> list[Check]:
    return []


def test_the_list_names_every_case_once(command):
    result = command("verify", "--list")
    assert result.exit_code == PASSED
    names = [line.split()[0] for line in result.stdout.splitlines()]
    assert names == [case.name for case in verification.CASES]
    assert len(set(names)) == len(names) >= 40
    for name in ("double-pendulum", "bouncing-ball", "painleve-rod", "slider-crank-clearance", "grazing"):
        assert name in names
    assert all(case.run is not None or case.excuse for case in verification.CASES)


@pytest.mark.parametrize("name", FAST)
def test_one_case_by_name(command, name):
    result = command("verify", name)
    assert result.exit_code == PASSED, result.stdout
    head, *rows = result.stdout.splitlines()
    assert head.split()[:2] == ["ok", name]
    numbers = [row for row in rows if row.startswith("  ok ")]
    for begin in ("expected", "got", "tolerance"):
        assert sum(row.lstrip().startswith(f"{begin}  ") for row in rows) == len(numbers) > 0
    assert "FAILED" not in result.stdout
    assert "1 of 1 cases passed" in rows[-1]


def test_every_case_passes(command):
    """All of them, as a user runs them; exit code 0 is what the README promises."""
    result = command("verify")
    assert result.exit_code == PASSED, result.stdout


def test_several_cases_as_json(command):
    result = command("verify", "three-balls", "ball-in-bowl", "--json")
    assert result.exit_code == PASSED
    data = json.loads(result.stdout)
    assert [entry["verdict"] for entry in data] == [
        "ok" if e["case"] == "three-balls" else "not applicable" for e in data
    ]
    assert {entry["case"] for entry in data} == {"three-balls", "ball-in-bowl"}
    assert all(check["ok"] and check["reason"] for entry in data for check in entry["checks"])


def long(_runs: Runs) -> list[Check]:
    text = " ".join(f"{k}.123456789," for k in range(30))
    return [same("a good one", 1, 1), Check("a bad one", text, text, "exact", "to be long", False)]


def test_lines_are_of_a_terminal():
    """No line is longer than WIDTH, nothing is cut; of the cases that are not named only what failed is shown."""
    results = [verification.measure(Case("injected", "a case " * 20, long))]
    for details in (True, False):
        lines = list(report.lines(results, details))
        assert max(map(len, lines)) <= report.WIDTH
        assert ("a good one" in "\n".join(lines)) is details
        assert sum(line.count(".123456789,") for line in lines) == 60
    assert [len(line) <= report.WIDTH for line in report.summary(results)] == [True]


def test_former_names_are_accepted():
    former = {case.former for case in verification.CASES if case.former}
    assert {"B", "N01", "N10", "N22", "N26-bowl", "N27", "dry-stop", "dry-spring"} <= former
    assert not former & {case.name for case in verification.CASES}
    assert [case.name for case in verification.chosen(["dry-stop", "N22"])] == [
        "joint-friction-stop",
        "slider-crank-clearance",
    ]


def test_unknown_names_are_refused(command):
    result = command("verify", "N99")
    assert result.exit_code == WRONG_INPUT
    assert "There is no case 'N99'" in result.stderr


@pytest.mark.parametrize("run", [wrong, breaks, nothing])
def test_a_case_that_fails_fails_the_command(command, monkeypatch, run):
    injected = Case("injected", "a case that fails", run)
    monkeypatch.setattr(verification, "CASES", (*verification.CASES, injected))
    result = command("verify", "injected")
    assert result.exit_code == FAILED
    assert "0 of 1 cases passed" in result.stdout
    assert "FAILED: injected" in result.stdout
    if run is breaks:
        assert "ValueError: what a pity" in result.stdout
    both = command("verify", "rod", "injected")
    assert both.exit_code == FAILED
    assert "1 of 2 cases passed" in both.stdout


def test_what_is_not_applicable_is_never_green(command):
    result = command("verify", "ball-in-bowl")
    assert result.exit_code == FAILED  # nothing was measured
    assert "0 of 0 cases passed" in result.stdout
    row = result.stdout.splitlines()[0]
    assert "not applicable" in row
    assert " ok" not in row


@pytest.mark.parametrize(
    ("check", "ok"),
    [
        (near("x", 1.0, 1.05, 0.1, "r"), True),
        (near("x", 1.0, 1.2, 0.1, "r"), False),
        (near("x", 1.0, math.nan, 0.1, "r"), False),
        (near("x", [1.0, 2.0], [1.0, 2.0], 0.0, "r"), True),
        (near("x", [1.0, 2.0], [1.0], 0.1, "r"), False),
        (near("x", [1.0], [], 0.1, "r"), False),
        (at_most("x", 1.0, 1.0, "r"), True),
        (at_most("x", 1.0, math.nan, "r"), False),
        (at_most("x", 1.0, math.inf, "r"), False),
        (at_least("x", 1.0, 0.9, "r"), False),
        (at_least("x", 1.0, math.nan, "r"), False),
        (same("x", 3, 3), True),
        (same("x", 3, 4), False),
    ],
)
def test_checks_can_fail(check, ok):
    assert check.ok is ok


def test_every_run_is_held_to_the_laws():
    runs = Runs()
    assert runs.laws() == []
    scene = ball_scene(1.0)
    runs.simulate(scene, None, None, 1.0, 0.01)
    ended, laws = runs.laws()
    assert ended.ok
    assert laws.ok
    for name, value in (
        ("_gap", 2 * GAP),
        ("_gap", math.nan),
        ("_impulse", -1e-15),
        ("_complementarity", 2 * COMPLEMENTARITY),
    ):
        broken = Runs()
        broken.simulate(scene, None, None, 1.0, 0.01)
        setattr(broken, name, value)
        assert not broken.laws()[1].ok


def test_a_run_that_ends_early_fails_its_case():
    runs = Runs()
    runs.simulate(ball_scene(0.5), None, None, 10.0, 0.01, zeno="end")
    ended = runs.laws()[0]
    assert not ended.ok
    assert "ZENO" in ended.got


def test_a_case_that_hangs_fails():
    def hangs(runs: Runs) -> list[Check]:
        scene = ball_scene(1.0)
        runs.simulate(scene, None, None, 1e6, 0.01)
        return [same("never seen", 1, 1)]

    result = verification.measure(Case("hangs", "a run without end", hangs), limit=0.3)
    assert result.verdict == "FAILED"
    assert "takes too long" in result.checks[-1].got
    assert result.seconds < 5.0


def test_gaps_count_at_the_nodes():
    """A run that starts apart and is moved into its floor afterwards is found out."""
    traj = cvi.simulate(ball_scene(1.0), duration=1.0, dt=0.01)
    from contactvi.verify.case import kept

    assert kept(traj)[0] >= GAP
    traj.q[50, 2] = 0.05
    assert kept(traj)[0] == pytest.approx(-0.05, abs=1e-12)
    assert np.isfinite(kept(traj)).all()
