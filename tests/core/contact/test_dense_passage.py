"""Bodies do not pass through each other in dense steps, however fast they are; elastic impacts are counted singly."""

from __future__ import annotations

import numpy as np

import contactvi as cvi
from contactvi.verify import systems

START = [systems.RADIUS + 1.0, 3.0 * systems.RADIUS + 2.0]


def test_elastic_impacts_are_located() -> None:
    """A block of 1e8 times the mass makes 31415 collisions, with the default options."""
    masses = np.array([1e-8, 1.0])
    run = cvi.simulate(systems.ball_row(masses), START, [0.0, -1.0], duration=10.0, dt=0.5, record_contacts=False)
    assert run.stats.dense_steps == 0
    assert len(run.events) == 31415


def test_fast_bodies_keep_their_order() -> None:
    """A ball that moves farther than both are thick in a dense step stays on its side."""
    for speed in (10.0, 1e3, 1e5):
        scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
        scene.add_sphere("left", 0.1)
        scene.add_sphere("right", 0.1)
        scene.set_contact(restitution=0.5)
        q = [0.0, 0.0, 0.0, 0, 0, 0, 1, 0.3, 0.0, 0.0, 0, 0, 0, 1]
        v = np.zeros(12)
        v[0] = speed
        run = cvi.simulate(scene, q, v, duration=0.02, dt=0.01, contact_mode="steps", throw=False)
        assert np.all(run.q[:, 0] < run.q[:, 7])
        assert run.status.ok
        np.testing.assert_allclose(run.v[-1][[0, 6]], [0.25 * speed, 0.75 * speed], rtol=1e-6)
