"""What Stats tells about dense steps: counts that add up, and go on where a run is continued."""

from __future__ import annotations

import pytest

import contactvi as cvi
from contactvi.bench import heaps

COUNTS = (
    "dense_steps",
    "dense_passes",
    "dense_problems",
    "dense_sweeps",
    "dense_factorizations",
    "dense_gap_iterations",
)
pytestmark = pytest.mark.filterwarnings("ignore::contactvi.DenseStepWarning")


def test_a_heap_counts_what_its_dense_steps_need():
    scene, q, v = heaps.to_scene(heaps.make("cards", 1, restitution=0.0, friction=0.5))
    stats = cvi.simulate(scene, q, v, duration=0.2, dt=1e-3, contact_mode="steps").stats
    assert stats.dense_steps >= 200
    assert stats.dense_passes >= stats.dense_steps + stats.halved
    assert stats.dense_problems >= 2 * stats.dense_steps  # of the position and the velocity impulse
    assert stats.dense_sweeps > 0
    assert stats.dense_factorizations > 0
    assert stats.dense_gap_iterations > 0


def test_located_runs_count_none():
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, mass=1.0, placement=(0.0, 0.0, 0.3))
    stats = cvi.simulate(scene, duration=0.5, dt=1e-3, contact_mode="events").stats
    assert [getattr(stats, name) for name in COUNTS] == [0] * len(COUNTS)
