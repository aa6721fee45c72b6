"""Names of the last release still work: attributes, arguments of constructors, keys."""

from __future__ import annotations

import numpy as np

import contactvi as cvi
from helpers.contact_runs import sliding_box
from helpers.run_scenes import ball_scene


def test_stats():
    stats = cvi.Stats(steps=3, sweeps=7, held_steps=2, contact_rounds=5)
    assert stats == cvi.Stats(steps=3, stage_iterations=7, contact_steps=2, contact_iterations=5)
    assert (stats.sweeps, stats.iterations, stats.residuals) == (7, 7, 7)
    assert (stats.held_steps, stats.contact_rounds) == (2, 5)


def test_names_of_stored_counts():
    """The file of a run keeps its names, and has the stage iterations under three of them."""
    stats = cvi.Stats(steps=3, stage_iterations=7, contact_steps=2, contact_iterations=5, seconds=0.5)
    stored = stats.to_dict()
    assert (stored["sweeps"], stored["iterations"], stored["residuals"]) == (7, 7, 7)
    assert (stored["held_steps"], stored["contact_rounds"]) == (2, 5)
    assert cvi.Stats.from_dict(stored) == stats


def test_phases_and_contacts():
    box = sliding_box()
    assert box.phases["held"] is box.phases["persistent"]
    assert box.contacts.lasting is box.contacts.has_force
    assert box.ledger.held is box.ledger.persistent


def test_adaptive_steps():
    traj = cvi.simulate(ball_scene(0.8), duration=1.0)
    assert traj.arcs is traj.adaptive_steps
    arcs = {"t": np.zeros(1), "dt": np.ones(1)}
    args = (traj.scene, traj.options, traj.t, traj.q, traj.p, traj.events, traj.status, traj.stats)
    assert cvi.Trajectory(*args, arcs=arcs).adaptive_steps == arcs


def test_work():
    work = cvi.simulate(ball_scene(0.8), duration=0.1, dt=0.01).work
    assert work.dry is work.joint_friction
    assert work.drive is work.prescribed
