"""A sample of benchmarks/estimates.py: the error estimate of dt = "auto" beside the true error, with contact."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
SEED = 12


@pytest.fixture
def estimates(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(FOLDER)
    return importlib.import_module("estimates")


@pytest.mark.slow
def test_estimates_of_a_motion_of_each_family(estimates):
    rows = [estimates.measure(family, SEED) for family in estimates.estimate_scenes.FAMILIES]
    told = [row for row in rows if row.told]
    assert len(told) >= 16, rows  # the others multiply errors
    # Below a third of the true error, without a warning: 1.4 % of 735 motions, of which this is a sample.
    assert len([row for row in rows if row.fault]) <= 1
    assert not [row for row in told if row.error > row.tol and not row.warned]
