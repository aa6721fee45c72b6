"""Drawn cases of every way into the package: refused with an error of ours, or finite and with a documented end.

The law is in fuzz/law.py. Each case is made in a process of its own that may crash or hang. More of them:

    python -m pytest -m long tests/fuzz
    python tests/fuzz/run.py --cases 100000 --jobs 2
"""

from __future__ import annotations

import os
import time

import pytest

from fuzz import campaign, families
from helpers.extras import needs_mujoco

CASES, MANY = 120, 3000
# Below, a family would test little but its first checks.
LEAST_ACCEPTED = 0.1


# Where no MJCF can be read, none is accepted.
NAMES = [pytest.param(name, marks=needs_mujoco) if name == "mjcf" else name for name in families.NAMES]


def check(tally: campaign.Tally, count: int) -> None:
    assert not tally.findings, "\n\n".join(str(finding) for finding in tally.findings.values())
    assert tally.cases == count
    assert tally.share_accepted >= LEAST_ACCEPTED


@pytest.mark.parametrize("family", NAMES)
@pytest.mark.slow
def test_a_few(family: str):
    check(campaign.chunk(family, 0, CASES), CASES)


@pytest.mark.long
@pytest.mark.parametrize("family", NAMES)
def test_many(family: str):
    check(campaign.many(family, MANY, seed=1), MANY)


@pytest.mark.long
def test_all_findings_are_seen():
    tally = campaign.chunk("broken", 0, 70, seconds=0.5)
    assert tally.cases == 70
    assert set(tally.counts) == set(campaign.COLUMNS)
    assert {finding.outcome for finding in tally.findings.values()} == set(campaign.FINDINGS)
    assert all(finding.case["way"] in (finding.outcome, "memory") for finding in tally.findings.values())


def test_a_worker_that_has_made_its_last_case_is_not_waiting(tmp_path):
    """Its case.json is gone then, and its log is as old as the process."""
    long_ago = time.time() - 10.0 * campaign.WALL
    (tmp_path / "log").touch()
    os.utime(tmp_path / "log", (long_ago, long_ago))
    assert campaign._age(tmp_path) > campaign.WALL
    (tmp_path / "outcomes.jsonl").touch()
    assert campaign._age(tmp_path) < campaign.WALL
