"""A sample of benchmarks/estimates.py: the error estimate of dt = "auto" beside the true error, with contact."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
SEED = 12  # seeds with an estimate that is too small are known: 12 of 735 motions, docs/benchmarks.md


@pytest.fixture
def estimates(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(FOLDER)
    return importlib.import_module("estimates")


@pytest.mark.slow
def test_estimates_of_a_motion_of_each_family(estimates):
    rows = [estimates.measure(family, SEED) for family in estimates.estimate_scenes.FAMILIES]
    told = [row for row in rows if row.told]
    assert len(told) >= 16, rows  # the others multiply errors
    assert not [row for row in rows if row.fault]  # none is below a third of the true error and does not warn
    assert not [row for row in told if row.error > row.tol and not row.warned]
