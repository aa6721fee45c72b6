"""Ctrl-C at any moment: the program ends soon, and what was computed is not lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers import interrupted_runs

pytestmark = pytest.mark.long


def checked(trials: list[interrupted_runs.Trial]) -> None:
    wrong = [f"at {trial.share:.3f}: {text}" for trial in trials for text in trial.findings]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("kind", [*interrupted_runs.RUNS, *interrupted_runs.LOOPS])
def test_runs_and_loops(kind: str):
    checked(interrupted_runs.in_process(kind, 45, 1))


@pytest.mark.parametrize("kind", interrupted_runs.COMMANDS)
def test_commands(kind: str, tmp_path: Path):
    checked(interrupted_runs.of_commands(kind, 15, 2, tmp_path))


def test_imports(tmp_path: Path):
    checked(interrupted_runs.of_imports(15, 3, tmp_path))
