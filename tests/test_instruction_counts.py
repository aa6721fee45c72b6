"""The comparison of instruction counts with stored ones: benchmarks/instructions.py."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"
SETTING = {"compiler": "GCC 12", "libc": "glibc 2.36"}
STORED: dict[str, Any] = {"measured with": SETTING, "counts": {"chain": 1000_000, "heap": 2000_000}}


@pytest.fixture
def instructions(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(FOLDER)
    return importlib.import_module("instructions")


@pytest.mark.parametrize("chain", [970_001, 1000_000, 1029_999])
def test_counts_within_three_percent_are_right(instructions, chain):
    found = instructions.verdict(STORED, SETTING, {"chain": chain, "heap": 2000_000})
    assert found.compared
    assert found.wrong == ()


@pytest.mark.parametrize("chain", [900_000, 969_000, 1031_000])
def test_a_count_further_away_is_wrong_on_both_sides(instructions, chain):
    found = instructions.verdict(STORED, SETTING, {"chain": chain, "heap": 2000_000})
    assert found.compared
    assert found.wrong == ("chain",)
    assert "CHANGED" in found.lines[0]
    assert "CHANGED" not in found.lines[1]


def test_a_scene_without_stored_count_is_wrong(instructions):
    assert instructions.verdict(STORED, SETTING, {"ball": 5}).wrong == ("ball",)


@pytest.mark.parametrize("other", [{"compiler": "GCC 13", "libc": "glibc 2.36"}, {"compiler": "GCC 12"}])
def test_counts_of_another_setting_are_not_compared_and_it_says_so(instructions, other):
    found = instructions.verdict(STORED, other, {"chain": 5000_000})
    assert not found.compared
    assert found.wrong == ()
    assert found.lines[0].startswith("not compared, ")
    assert "here" in found.lines[0]


def test_every_scene_has_a_stored_count(instructions):
    stored = json.loads(instructions.STORED.read_text())
    assert set(stored["counts"]) == set(instructions.SCENES)
    assert stored["measured with"]["instruction set"] == instructions.INSTRUCTION_SET


def test_the_libraries_are_those_that_the_build_requires(instructions):
    """In whatever environment: a user's does not hold what was needed to build."""
    text = '[build-system]\nrequires = [\n    "a>=1.1,<2",\n    "libcoal[build]==3.0.3",\n]\nname = "x==1"\n'
    assert instructions.libraries(text) == "libcoal 3.0.3"
    assert "cmeel-eigen 3." in instructions.libraries(instructions.REQUIRES.read_text())
