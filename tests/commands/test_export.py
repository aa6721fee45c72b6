"""`contactvi export`: the tables of a stored run as CSV."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import contactvi as cvi
from helpers.run_scenes import ball_file


def test_tables_of_a_stored_run(command, tmp_path):
    assert command("run", ball_file(tmp_path), "-o", "out", "--no-html", "--no-plot").exit_code == 0
    result = command("export", "out/trajectory.npz", "-o", "tables")
    assert result.exit_code == 0
    names = sorted(path.name for path in Path("tables").iterdir())
    assert names == ["contacts.csv", "energies.csv", "events.csv", "poses.csv", "states.csv", "units.csv"]
    assert all(f"tables/{name}" in result.stdout for name in names)
    traj = cvi.Trajectory.load("out/trajectory.npz")
    with open("tables/states.csv") as file:
        assert file.readline().strip().split(",") == list(traj.table("states").columns)
    written = np.loadtxt("tables/states.csv", delimiter=",", skiprows=1)
    assert np.array_equal(written, np.column_stack([traj.t, traj.q, traj.v]))


def test_one_table_beside_the_run(command, tmp_path):
    command("run", ball_file(tmp_path), "-o", "out", "--no-html", "--no-plot")
    assert command("export", "out/trajectory.npz", "--table", "events", "--table", "changes").exit_code == 0
    folder = Path("out/trajectory")
    assert sorted(path.name for path in folder.iterdir()) == ["changes.csv", "events.csv", "units.csv"]


def test_forces_of_windows(command, tmp_path):
    command("run", ball_file(tmp_path), "-o", "out", "--no-html", "--no-plot")
    assert command("export", "out/trajectory.npz", "--table", "forces", "--sample-dt", "0.1").exit_code == 0
    traj = cvi.Trajectory.load("out/trajectory.npz")
    written = np.loadtxt("out/trajectory/forces.csv", delimiter=",", skiprows=1)
    assert np.array_equal(written[:, 0], 0.1 * np.arange(len(written)))
    assert np.array_equal(written[:, 4], traj.table("forces", 0.1).column("ball | ground.z"))
    assert command("export", "out/trajectory.npz", "-o", "all", "--sample-dt", "0.1").exit_code == 0
    assert {"forces.csv", "states.csv"} <= {path.name for path in Path("all").iterdir()}
    assert command("export", "out/trajectory.npz", "--sample-dt", "-1").exit_code == 2


def test_the_folder_of_a_run_stands_for_it(command, tmp_path):
    """As `contactvi plot` takes it; what is written beside the run is then in that folder."""
    command("run", ball_file(tmp_path), "-o", "out", "--no-html", "--no-plot")
    assert command("export", "out", "--table", "events").exit_code == 0
    assert Path("out/trajectory/events.csv").is_file()
    assert command("play", "out", "--no-browser").exit_code == 0
    assert "<title>out</title>" in Path("out/trajectory.html").read_text()
    result = command("render", "out", "-o", "picture.jpg", "--at", "0.5")
    assert result.exit_code == 2
    assert "Name it picture.png" in result.stderr
    assert "there is no such file" in command("render", "missing").stderr


def test_wrong_input(command, tmp_path):
    result = command("export", "missing.npz")
    assert result.exit_code == 2
    assert "there is no such file" in result.stderr
    command("run", ball_file(tmp_path), "-o", "out", "--no-html", "--no-plot")
    result = command("export", "out/trajectory.npz", "--table", "contact")
    assert result.exit_code == 2
    assert "Did you mean 'contacts'?" in result.stderr
    Path("file").write_text("")
    assert command("export", "out/trajectory.npz", "-o", "file").exit_code == 2
