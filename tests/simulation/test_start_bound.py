"""A start may overlap by what a run promises of its own nodes, so that any node can be a start, and by no more."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi

PROMISED, RADIUS = 1e-9, 0.1


def at(height: float, restitution: float) -> tuple[cvi.Scene, np.ndarray]:
    """A ball whose lowest point is at this height over the ground."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", RADIUS, mass=1.0)
    scene.set_contact(restitution=restitution, friction=0.5)
    q = scene.neutral()
    q[2] = RADIUS + height
    return scene, q


@pytest.mark.parametrize("mode", ["events", "steps"])
@pytest.mark.parametrize("restitution", [0.0, 0.8])
@pytest.mark.parametrize("depth", [1e-11, 3e-10, 0.9 * PROMISED])
def test_an_overlap_that_a_run_may_leave_is_a_start(depth, restitution, mode):
    """It ends within a step or two, and no energy comes of it but what lifts the ball."""
    scene, q = at(-depth, restitution)
    traj = cvi.simulate(scene, q, duration=0.05, dt=1e-3, contact_mode=mode)
    gaps = np.array([scene.gaps(q)[0] for q in traj.q])
    assert gaps.min() >= -depth - 1e-11
    assert np.abs(gaps[5:]).max() < 2e-9
    assert traj.energy.max() - traj.energy[0] < 2.0 * 9.81 * PROMISED


def test_more_is_refused_with_the_remedy():
    scene, q = at(-2.0 * PROMISED, 0.0)
    with pytest.raises(cvi.ContactviError, match="overlap") as refused:
        cvi.simulate(scene, q, duration=0.05, dt=1e-3)
    assert "separate" in str(refused.value)
