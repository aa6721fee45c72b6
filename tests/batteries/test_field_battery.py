"""Random runs on height fields and solids: each ends well, and at no node is a gap below -1e-9 m.

Gaps are measured without the engine: by a search everywhere on the same spline of another library, and by the closed
forms of tori and superellipsoids.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from oracles.nearest_on_height import feet
from simulation.test_height_fields import spline

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::contactvi.DenseStepWarning")]
DEPTH = -1e-9  # [m] promised
RING, RADII, N = 0.5, np.array([0.5, 0.4, 0.3]), 4.0
CORNERS = np.array([(x, y, z) for x in (-0.15, 0.15) for y in (-0.1, 0.1) for z in (-0.05, 0.05)])
Gap = Callable[[np.ndarray], float]


def _turned(q: np.ndarray) -> np.ndarray:
    return pin.Quaternion(q[3:7]).toRotationMatrix()


def _any_turn(rng: np.random.Generator) -> list[float]:
    return pin.Quaternion(pin.exp3(rng.uniform(-1.0, 1.0, 3))).coeffs().tolist()


@pytest.mark.parametrize("seed", range(8))
def test_balls_on_rough_ground(seed: int) -> None:
    """Hollows wider and narrower than the ball, with all laws, at orders 2 and 4."""
    rng = np.random.default_rng(seed)
    n, high, radius = int(rng.integers(8, 40)), 10.0 ** rng.uniform(-2.5, -0.9), 10.0 ** rng.uniform(-1.7, -0.7)
    heights, size = high * rng.uniform(-1.0, 1.0, (n, n)), np.array([2.0, 2.0])
    scene = cvi.Scene()
    scene.add_heightfield("ground", heights, size)
    scene.add_sphere("ball", radius)
    scene.set_contact(restitution=rng.choice([0.0, 0.3, 0.8]), friction=rng.choice([0.0, 0.3, 1.0]))
    order, v = int(rng.choice([2, 4])), rng.uniform(-1.0, 1.0, 6)
    run = cvi.simulate(scene, [0, 0, high + radius + 0.1, 0, 0, 0, 1], v, duration=0.7, dt=4e-3, order=order)
    assert run.status.ok
    assert len(run.events) > 0
    surface = spline(heights, size)
    for q in run.q[::10]:
        low, high_end = np.maximum(q[:2] - 1.5 * radius, -1.0), np.minimum(q[:2] + 1.5 * radius, 1.0)
        if (low >= high_end).any():
            continue
        nearest = feet(lambda x, y: float(surface.ev(x, y)), low, high_end, q[:3], 16)[0]
        assert nearest - radius > DEPTH


def _torus(p: np.ndarray, tube: float) -> float:
    return float(np.hypot(np.hypot(p[0], p[1]) - RING, p[2]) - tube)


def _channel(scene: cvi.Scene, rng: np.random.Generator, tube: float) -> tuple[list[float], Gap]:
    radius = tube * rng.uniform(0.2, 0.9)
    scene.add_torus("ring", RING, tube, free=False, hollow=True)
    scene.add_sphere("body", radius)
    return [RING, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], lambda q: -_torus(q[:3], tube) - radius


def _falling_ring(scene: cvi.Scene, rng: np.random.Generator, tube: float) -> tuple[list[float], Gap]:
    scene.add_torus("ring", RING, tube, mass=2.0)
    balls = [np.array([RING * np.cos(a), RING * np.sin(a), 0.0]) for a in (0.0, 2.0, 4.0)]
    for k, ball in enumerate(balls):
        scene.add_sphere(f"ball_{k}", 0.1, free=False, placement=tuple(ball))
    return [0.03, 0.02, tube + 0.15, 0.0, 0.0, 0.0, 1.0], lambda q: min(
        _torus(_turned(q).T @ (ball - q[:3]), tube) - 0.1 for ball in balls
    )


def _box_on_stone(scene: cvi.Scene, rng: np.random.Generator, tube: float) -> tuple[list[float], Gap]:
    scene.add_superellipsoid("stone", RADII, N, free=False)
    scene.add_box("body", 2.0 * CORNERS[-1])
    return [0.05, 0.02, 0.6, *_any_turn(rng)], lambda q: min(
        float((np.abs((_turned(q) @ x + q[:3]) / RADII) ** N).sum() ** (1.0 / N) - 1.0) for x in CORNERS
    )


def _capsule_on_ring(scene: cvi.Scene, rng: np.random.Generator, tube: float) -> tuple[list[float], Gap]:
    scene.add_torus("ring", RING, tube, free=False)
    scene.add_capsule("body", 0.05, 0.3)
    return [RING - 0.05, 0.02, tube + 0.3, *_any_turn(rng)], lambda q: min(
        _torus(_turned(q) @ [0.0, 0.0, z] + q[:3], tube) - 0.05 for z in (-0.15, 0.15)
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("make", [_channel, _falling_ring, _box_on_stone, _capsule_on_ring])
def test_solids(make: Callable[..., tuple[list[float], Gap]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = cvi.Scene()
    q, gap = make(scene, rng, rng.uniform(0.1, 0.3))
    scene.set_contact(restitution=rng.choice([0.0, 0.4, 0.8]), friction=rng.choice([0.0, 0.3, 1.0]))
    order, v = int(rng.choice([2, 4])), rng.uniform(-0.5, 0.5, 6)
    run = cvi.simulate(scene, q, v, duration=0.8, dt=4e-3, order=order)
    assert run.status.ok
    assert len(run.events) > 0
    assert min(gap(state) for state in run.q) > DEPTH
