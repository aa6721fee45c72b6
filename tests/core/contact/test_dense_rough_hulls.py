"""Dense steps with hulls whose faces are flat but for the rounding of their vertices, as in single precision."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi

SIDES, SIZE, BODIES = 12, 0.1, 3  # corners of a face, [m], prisms on each other


def rough_prism(rng: np.random.Generator, noise: float) -> np.ndarray:
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    ring = SIZE * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(SIDES)])
    corners = np.vstack([ring - [0.0, 0.0, SIZE / 2], ring + [0.0, 0.0, SIZE / 2]])
    return corners + noise * rng.uniform(-1.0, 1.0, corners.shape)


@pytest.mark.parametrize("noise", [0.0, 1e-8, 3e-8, 1e-7])
def test_a_stack_does_not_sink(noise: float) -> None:
    """The gap of a pair has the noise of its faces: neither gaps nor energy are a reason to make the steps shorter.

    They were, and the shortest steps gave up a gap for the energy: bodies sank into each other by 1e-4 m/s.
    """
    rng = np.random.default_rng(1)
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(BODIES):
        scene.add_mesh(f"prism{k}", rough_prism(rng, noise), mass=1.0)
    scene.set_contact(friction=0.5, restitution=0.0)
    q, v = pin.neutral(scene.model), np.zeros(scene.nv)
    for k in range(BODIES):
        q[7 * k + 2] = SIZE * (k + 0.5) + 1e-6 * (k + 1)
    v[0], v[5] = 0.3, 1.0
    run = cvi.simulate(scene, q, v, 0.2, dt=1e-3, contact_mode="steps")
    assert run.stats.halved == 0
    # A face of each body, whose corners miss it by noise to both sides.
    assert min(scene.gaps(q).min() for q in run.q) >= -1e-9 - 4.0 * noise
