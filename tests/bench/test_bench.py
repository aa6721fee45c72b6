"""`contactvi bench`: orders seen, files written, advice given, and scenes where an error means little."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.bench.bench import BENCHED, Bench, Row, bench
from contactvi.bench.report import COLUMNS, advice, heading, notes, table, targets
from contactvi.tables import lines_of
from helpers.run_scenes import ball_file, hand_scene

WRONG_INPUT = 2  # exit code

PENDULUM = """
[[urdf]]
path = "pendulum.urdf"
[[joint]]
name = "*"
limits = false
[initial]
q = { hinge = 1.0 }
[run]
dt = 0.01
duration = 1.6
"""
PENDULUM_URDF = """<robot name="pendulum"><link name="world"/>
<link name="bob"><inertial><origin xyz="0 0 -1"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="world"/><child link="bob"/><axis xyz="0 1 0"/></joint></robot>"""


@pytest.fixture
def pendulum(tmp_path) -> Path:
    (tmp_path / "pendulum.urdf").write_text(PENDULUM_URDF.replace("continuous", "revolute").replace(
        "<axis", '<limit lower="-9" upper="9" effort="1" velocity="1"/><axis'))  # fmt: skip
    path = tmp_path / "pendulum.toml"
    path.write_text(PENDULUM)
    return path


def test_orders_of_a_smooth_scene(pendulum):
    result = bench(cvi.load_scene(pendulum), budget=5)
    assert result.impacts == 0
    assert {row.impact for row in result.rows} == {"ctec"}  # without impacts the maps are the same
    assert result.horizon == pytest.approx(1.6)
    # The term O(dt^4) is (omega dt)^2 = 0.06 of the first at dt = 0.08, omega = 3.1/s, at most, and shifts it by 0.03.
    assert result.slope("ctec") == pytest.approx(2.0, abs=0.05)
    # Longer steps, where the next term is a good part of the first: a third of an order.
    assert result.slope("ctec", 4) == pytest.approx(4.0, abs=0.35)
    assert {row.order for row in result.rows} == set(BENCHED)
    assert all(row.seconds > 0 for row in result.rows)
    assert result.reference_error < 1e-10


def test_higher_orders_take_longer_steps_for_small_errors():
    """What the orders are for: for the error of the finest run of order 2, steps a hundred times as long and more."""
    scene = cvi.load_scene(Path(__file__).resolve().parents[2] / "models" / "double_pendulum_wall.toml")
    result = bench(scene, budget=10, maps=("ctec",))
    low = min((row for row in result.good() if row.order == 2), key=lambda row: row.error)
    for order in (8, 16):
        assert max(row.dt for row in result.good() if row.order == order and row.error <= low.error) >= 100 * low.dt


def test_maps_of_an_elastic_impact_have_order_two():
    scene = cvi.load_scene(Path(__file__).resolve().parents[2] / "models" / "double_pendulum_wall.toml")
    result = bench(scene, budget=10, dt=0.002, duration=1.6)
    assert result.impacts == 1
    for impact in {row.impact for row in result.rows}:
        # One impact at a different fraction of the step at each dt: the constant of the error changes with it.
        assert result.slope(impact) == pytest.approx(2.0, abs=0.3), impact
    assert result.reference_error < min(row.error for row in result.rows)


def test_command_writes_table_picture_and_advice(command, pendulum):
    result = command("bench", pendulum, "-o", "out", "--budget", 5, "--orders", "2,6")
    assert result.exit_code == 0
    assert sorted(path.name for path in Path("out").iterdir()) == ["bench.csv", "bench.png"]
    assert Path("out/bench.png").read_bytes().startswith(b"\x89PNG")
    rows = list(csv.DictReader(Path("out/bench.csv").read_text().splitlines()))
    assert tuple(rows[0]) == COLUMNS
    assert {row["order"] for row in rows} == {"2", "6"}
    errors = [float(row["error"]) for row in rows if row["order"] == "2"]
    assert len(errors) == 7
    assert errors == sorted(errors, reverse=True)
    line = next(line for line in result.stdout.splitlines() if line.startswith("advice"))
    assert re.search(r"error 1e-\d\d: order [26], ctec, dt = 0\.\d+ s \(.* ms\)", line), line


def test_wrong_input(command, pendulum):
    for arguments in (("none.toml",), (pendulum, "--budget", 0), (pendulum, "--dt", 0.03), (pendulum, "--dt", -1),
                      (pendulum, "--orders", "3"), (pendulum, "--orders", "two")):  # fmt: skip
        result = command("bench", *arguments)
        assert result.exit_code == WRONG_INPUT
        assert "Error:" in result.stderr


def test_accumulation_bounds_the_horizon(tmp_path):
    """Impacts of a ball with e = 0.5 accumulate at 3 t1 = 1.355 s; the scene asks for 2 s."""
    scene = cvi.load_scene(ball_file(tmp_path, restitution=0.5, duration=2.0))
    scene.settings["zeno"] = "end"
    result = bench(scene, budget=5)
    assert 0.5 < result.horizon < 1.356
    assert result.impacts >= 1
    assert any("ends with ZENO at 1.35" in text for text in result.warnings)
    assert any(row.impact == "ctec" and not row.note for row in result.rows)
    assert all(np.isfinite(row.error) and np.isfinite(row.seconds) for row in result.rows)
    # With known times: measured ones may have another map as the quickest in every run.
    times = {"ctec": 1.0}
    rows = [replace(row, seconds=times.get(row.impact, 2.0) / row.dt) for row in result.rows]
    assert ", ctec, dt = " in advice(replace(result, rows=rows))


def test_chaotic_motion_has_a_horizon(tmp_path):
    """A double pendulum thrown over the top: runs of different dt part after seconds, and the bench reports when."""
    model = pin.Model()
    inertia, parent = pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), 1e-3 * np.eye(3)), 0
    for k in range(2):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -float(k)]))
        parent = model.addJoint(parent, pin.JointModelRY(), place, f"j{k}")
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model)
    scene.set_joint("j*", limits=False)
    scene.q0, scene.v0 = np.array([2.5, 1.0]), np.zeros(2)
    result = bench(scene, budget=10, dt=0.01, duration=40.0)
    assert 1.0 < result.horizon < 20.0
    assert any("agree up to" in text for text in result.warnings)
    # Up to there the finest run of the lowest order measures its own error and not the reference's.
    finest = [row for row in result.rows if row.order == 2][-1]
    assert finest.note == ""
    assert 3.0 * result.reference_error < finest.error


def test_start_in_penetration(tmp_path):
    path = ball_file(tmp_path)
    path.write_text(path.read_text().replace("1.1]", "0.05]"))
    with pytest.raises(cvi.PenetrationError):
        bench(cvi.load_scene(path), budget=2)


def test_steps_that_do_not_divide(pendulum):
    """A prime number of steps leaves the finer half of the ladder; all nodes are common still."""
    result = bench(cvi.load_scene(pendulum), budget=5, duration=0.97, orders=(2,))
    assert [round(row.dt / 0.01 * 8) for row in result.rows] == [8, 4, 2, 1]
    assert result.slope("ctec") == pytest.approx(2.0, abs=0.05)


def test_budget_too_small_for_the_scene_shortens_it():
    scene, q0 = hand_scene()
    scene.q0 = q0
    result = bench(scene, budget=1.0, dt=1e-3, duration=200.0)
    assert result.horizon < 200.0
    assert any("--budget" in text for text in result.warnings)


def test_advice_and_table_from_known_rows():
    rows = [
        Row("ctec", 0.1, 9e-3, 0.0, 1e-3, 3),
        Row("mhc", 0.1, 8e-4, 0.0, 1.05e-3, 3),
        Row("mhc", 0.05, 2e-4, 0.0, 4e-3, 3),
        Row("ctec", 0.05, 1e-9, 0.0, 1e-4, 2, note="another sequence of impacts", order=4),
    ]
    result = Bench(rows, 1.0, 2.0, 1e-4, 1e-9, 3)
    assert result.best(1e-3) is rows[1]
    assert result.best(1e-2) is rows[1]  # 5 % slower than ctec, ten times more accurate
    assert result.best(1e-5) is None
    text = advice(result)
    assert text.startswith("error 1e-03: order 2, mhc, dt = 0.1 s (1.05 ms)")  # also the setting for 1e-2: advised once
    assert "smallest measured, 2.0e-04: order 2, mhc, dt = 0.05 s" in text
    assert "1 s of 2 s" in heading(result)
    assert notes(result)[0] == "order seen over the ladder: 2 ctec none seen, 2 mhc 2.00, 4 ctec none seen"
    head, *lines = lines_of(table(result))
    assert head.split() == ["order", "map", "dt", "[s]", "error", "slope", "energy", "[J]", "time", "impacts", "note"]
    assert lines[-1].split(None, 6)[:5] == ["4", "ctec", "0.05", "1.00e-09", "0.00e+00"]
    assert lines[-1].endswith("another sequence of impacts")
    lost = Bench([replace(row, note="another motion") for row in rows], 1.0, 2.0, 1e-4, 1e-9, 3)
    assert advice(lost).startswith("No advice")


def test_targets():
    assert targets([3e-3, 2e-7]) == [1e-2, 1e-4, 1e-6]
    assert targets([3e-3]) == [1e-2]
