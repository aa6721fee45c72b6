"""Killed writers and full disks leave the old file, or the new one, and nothing in between."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from helpers import commands, killed_runs

pytestmark = pytest.mark.long


def test_a_killed_command_leaves_whole_files(tmp_path: Path):
    began = time.monotonic()
    _, errors = killed_runs.run(tmp_path, killed_runs.DURATIONS[0]).communicate(timeout=60)
    whole = time.monotonic() - began
    assert killed_runs.problems(tmp_path / "out", killed_runs.DURATIONS[:1]) == [], errors
    assert [found for seed in range(20) for found in killed_runs.kill_command(tmp_path, seed, whole)] == []
    _, errors = killed_runs.run(tmp_path, killed_runs.DURATIONS[1]).communicate(timeout=60)
    assert killed_runs.problems(tmp_path / "out", killed_runs.DURATIONS[1:]) == [], errors
    assert killed_runs.parts(tmp_path / "out") == []


def test_a_killed_save_leaves_a_whole_file(tmp_path: Path):
    assert [found for seed in range(20) for found in killed_runs.kill_save(tmp_path, seed)] == []
    killed_runs.save_one(tmp_path)
    assert killed_runs.problems(tmp_path, killed_runs.DURATIONS[:1]) == []
    assert killed_runs.parts(tmp_path) == []


@pytest.mark.parametrize("limit", [1, 4096, 20_000])
def test_a_file_that_may_not_grow(tmp_path: Path, limit: int):
    folder = tmp_path / "small"
    folder.mkdir()
    assert killed_runs.kept_after_full(folder, limit) == []


def test_a_full_disk(tmp_path: Path):
    folder = tmp_path / "disk"
    folder.mkdir()
    with killed_runs.small_disk(folder) as mounted:
        if not mounted:
            pytest.skip("mounting is not allowed here")
        assert killed_runs.kept_after_full(folder, 0) == []
        # Of the command, too: a message and the exit code of wrong input.
        scene = killed_runs.scene_file(tmp_path, 400.0)
        process = commands.start([*commands.program(), "run", str(scene), "-o", str(folder)], tmp_path)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 2, errors
        assert "Cannot write" in errors
        assert "Traceback" not in errors
        assert (folder / "trajectory.npz").read_bytes() == b"old trajectory.npz"
        assert killed_runs.parts(folder) == []
