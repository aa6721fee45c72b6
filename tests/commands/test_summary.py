"""The energies in the summary of a run: what they leave over is the error of the steps."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import contactvi as cvi
from contactvi.commands.summary import summary

STRIKER = Path(__file__).resolve().parents[2] / "models" / "four_bar_striker.toml"


def test_the_work_of_a_motion_in_an_impact_counts_once():
    """A driven four-bar strikes a ball: with steps for an accuracy next to nothing is left over."""
    traj = cvi.simulate(cvi.load_scene(STRIKER), duration=1.0, dt="auto", tol=1e-8)
    assert len(traj.events) == 1
    (text,) = [line for _, line in summary(traj) if "by impacts" in line]
    left = float(re.search(r"([-+][0-9.e+-]+) J by integration error", text).group(1))
    assert left == pytest.approx(float(traj.ledger.energy_balance[-1]), abs=1e-6)
    assert abs(left) < 1e-6
