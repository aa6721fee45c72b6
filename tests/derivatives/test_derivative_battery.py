"""The battery of derivatives: no column disagrees with its differences by more than the bar and their own error."""

from __future__ import annotations

from dataclasses import replace

import pytest

from helpers.derivative_battery import BAR, SYMPLECTIC, measure, sample, symplectic_error
from helpers.derivative_cases import FAMILIES, ORDERS, all_cases

EVERY = 3  # of the families in the short run one
DECIDED = 0.95  # of the columns: differences are worth something


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("joints", FAMILIES)
def test_steps_of_momenta_are_symplectic(joints, order):
    assert symplectic_error(joints, order, 7) <= SYMPLECTIC


def test_a_case_of_every_third_family():
    cases = sample(all_cases(), 1)[::EVERY]
    rows = measure(replace(case, columns=1) for case in cases)
    assert not [fault for row in rows for fault in row.faults]
    compared = sum(sum(row.columns.values()) for row in rows)
    assert sum(row.columns["both"] for row in rows) >= DECIDED * compared
    assert compared > len(cases)


@pytest.mark.long
def test_all_cases(capsys):
    rows = measure(all_cases())
    with capsys.disabled():
        print(f"\n{sum(row.cases for row in rows)} cases, {sum(row.impacts for row in rows)} impacts")
    assert not [fault for row in rows for fault in row.faults]
    for row in rows:
        for part in (row.state, row.times):
            assert part is None or part.relative_difference <= BAR, row.family
        assert sum(row.refused.values()) <= 0.5 * row.cases, (row.family, row.refused)
    compared = sum(sum(row.columns.values()) for row in rows)
    assert sum(row.columns["both"] for row in rows) >= DECIDED * compared
