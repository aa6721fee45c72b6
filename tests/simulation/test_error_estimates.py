"""A sample of benchmarks/estimates.py: the error estimate of dt = "auto" beside the true error, with contact."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from contactvi.states import States

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
SEED = 12


@pytest.fixture
def estimates(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(FOLDER)
    return importlib.import_module("estimates")


@pytest.mark.parametrize(
    ("family", "seed", "until", "coarse"), [("box tumbles", 215, 0.3757, 10), ("robot stands", 111, 0.107, 14)]
)
def test_a_slip_that_has_just_begun_has_the_direction_of_its_law(estimates, family, seed, until, coarse):
    """Iterations may see slips turn back that do not: a step may not end with the directions of such ones."""
    motion, _ = estimates.estimate_scenes.make(family, seed)
    ends = []
    for steps in (coarse, 10 * coarse):
        traj = cvi.simulate(motion.scene, motion.q, motion.v, until, dt=until / steps, order=16, dt_contact=1e-4)
        assert traj.stats.contact_steps == 0
        ends.append(traj.q[-1:])
    assert States(motion.scene.model).distance(*ends)[0] < 1e-9


@pytest.mark.parametrize(
    "third", [pytest.param(k, marks=pytest.mark.slow if k == 0 else pytest.mark.long) for k in range(3)]
)
def test_estimates_of_a_motion_of_each_family(estimates, third):
    rows = [estimates.measure(family, SEED) for family in list(estimates.estimate_scenes.FAMILIES)[third::3]]
    told = [row for row in rows if row.told]
    assert 3 * len(told) >= 2 * len(rows), rows  # the others multiply errors
    # Below a third of the true error, without a warning.
    assert not [row for row in rows if row.fault]
    assert not [row for row in told if row.error > row.tol and not row.warned]


def test_a_robot_that_walks_is_held_by_smooth_steps(estimates):
    """A foot that the impact of another lifts at a micrometre per second, and slips that end within microseconds.

    Contact steps, of order 2, took over there, which left 1e-7 to 2e-6 whatever was asked for.
    """
    motion, _ = estimates.estimate_scenes.make("robot walks", 4)
    motion.duration = 0.05
    traj, warned = estimates.run(motion, 60.0, dt="auto", tol=5e-8)
    fixed, _ = estimates.run(
        motion, 60.0, motion.steady, dt=1e-3, order=8, solver_tol=1e-13, dt_contact=5e-5, dense=True
    )
    assert not warned
    assert traj.stats.contact_steps == fixed.stats.contact_steps == 0
    # Fixed steps are off by some 4e-9 (their distance from steps half as long), the other run by a part of its tol.
    assert estimates.distance(motion, traj, fixed, np.linspace(0.0, motion.duration, 21)[1:]) < 2e-8
