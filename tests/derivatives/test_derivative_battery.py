"""The battery of derivatives: no column disagrees with its differences by more than the bar and their own error."""

from __future__ import annotations

from dataclasses import replace

import pytest

import contactvi as cvi
from helpers.derivative_battery import BAR, KNOWN, SYMPLECTIC, examine, known, measure, sample, symplectic_error
from helpers.derivative_cases import FAMILIES, ORDERS, all_cases, drops

EVERY = 3  # of the families in the short run one
DECIDED = 0.95  # of the columns: differences are worth something


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("joints", FAMILIES)
def test_steps_of_momenta_are_symplectic(joints, order):
    assert symplectic_error(joints, order, 7) <= SYMPLECTIC


def test_a_case_of_every_third_family():
    cases = sample([case for case in all_cases() if known(case) is None], 1)[::EVERY]
    rows = measure(replace(case, columns=1) for case in cases)
    assert not [fault for row in rows for fault in row.faults]
    compared = sum(sum(row.columns.values()) for row in rows)
    assert sum(row.columns["both"] for row in rows) >= DECIDED * compared
    assert compared > len(cases)


def test_contact_steps_that_were_cut_after_bouncing():
    """Their lengths do not move with the time at which the bouncing ended."""
    name = "cylinder ctec e 0.3 mu 0.2 order 2 seed 29"
    case = next(case for case in drops(30) if case.label == name)
    check = examine(replace(case, columns=3))
    assert isinstance(check, cvi.GradientCheck)
    assert check.ok
    scene, q, v = case.make()
    assert cvi.simulate(scene, q, v, **case.options).stats.halved > 0


@pytest.mark.long
def test_all_cases(capsys):
    rows = measure(case for case in all_cases() if known(case) is None)
    with capsys.disabled():
        print(f"\n{sum(row.cases for row in rows)} cases, {sum(row.impacts for row in rows)} impacts")
    assert not [fault for row in rows for fault in row.faults]
    for row in rows:
        for part in (row.state, row.times):
            assert part is None or part.relative_difference <= BAR, row.family
        assert sum(row.refused.values()) <= 0.5 * row.cases, (row.family, row.refused)
    compared = sum(sum(row.columns.values()) for row in rows)
    assert sum(row.columns["both"] for row in rows) >= DECIDED * compared


@pytest.mark.long
@pytest.mark.parametrize("name", KNOWN)
@pytest.mark.xfail(strict=True, reason="KNOWN: takes itself off the list when it is mended")
def test_known_disagreements(name):
    rows = measure(case for case in all_cases() if known(case) == name)
    assert not [fault for row in rows for fault in row.known], KNOWN[name]
