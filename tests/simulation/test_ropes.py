"""dt = "auto" with ropes: where they go slack or taut the force has a kink, and the estimate must not trust the law."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import contactvi as cvi


def bob(rest_length: float = 0.7, tension_only: bool = True, damping: float = 0.0) -> cvi.Scene:
    """A ball half a metre below the point where its rope is fixed."""
    scene = cvi.Scene()
    scene.add_sphere("bob", 0.05, 0.8, placement=(0, 0, -0.5))
    scene.add_spring(
        "world", "bob", 200.0, rest_length=rest_length, tension_only=tension_only, damping=damping, name="rope"
    )
    return scene


def error(scene: cvi.Scene, traj: cvi.Trajectory) -> float:
    """Of q over the nodes, against steps whose error is 1e-9 m."""
    fine = cvi.simulate(scene, traj.q[0], traj.v[0], duration=float(traj.t[-1]), dt=1e-5)
    exact = np.column_stack([np.interp(traj.t, fine.t, fine.q[:, k]) for k in range(3)])
    return float(np.linalg.norm(traj.q[:, :3] - exact, axis=1).max())


@pytest.mark.parametrize("damping", [0.0, 5.0])
@pytest.mark.parametrize("tol", [1e-4, 1e-6, 1e-8])
def test_a_rope_that_goes_slack_is_told(tol, damping):
    scene = bob(damping=damping)
    with pytest.warns(cvi.AccuracyWarning, match="'rope' goes slack or taut.*dt\\^2") as found:
        traj = cvi.simulate(scene, duration=1.5, tol=tol)
    assert len(found) == 1
    assert traj.error_estimate >= error(scene, traj)


@pytest.mark.parametrize(
    ("rest_length", "tension_only"),
    [(0.7, False), (0.45, True), (5.0, True)],  # a spring; always taut; always slack
)
def test_springs_without_a_kink_keep_the_law(rest_length, tension_only):
    scene = bob(rest_length, tension_only)
    scene.v0 = scene.velocity({"bob": (0.1, 0.0, 0.0)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        traj = cvi.simulate(scene, duration=0.3 if rest_length != 0.7 else 1.5)
    assert traj.error_estimate <= 1e-6
    assert error(scene, traj) <= 1e-6


def test_ropes_that_are_taut_for_less_than_a_step_are_found():
    """The ball flies by and stretches its rope for a hundredth of a second; both neighbouring nodes are slack."""
    scene = cvi.Scene(gravity=(0, 0, 0))
    scene.add_sphere("bob", 0.05, 1.0, placement=(-1.0, 1.0, 0))
    scene.add_spring("world", "bob", 50.0, rest_length=np.hypot(1.0, 1.0) - 1e-3, tension_only=True, name="rope")
    v0 = scene.velocity({"bob": (1.0, 0.0, 0.0)})
    with pytest.warns(cvi.AccuracyWarning, match="'rope'"):
        cvi.simulate(scene, None, v0, duration=2.0, tol=1e-9)


def test_estimates_of_drawn_ropes_are_above_the_errors():
    random = np.random.default_rng(3)
    for _ in range(6):
        scene = bob(rest_length=random.uniform(0.52, 0.9), damping=random.choice([0.0, 1.0]))
        v0 = scene.velocity({"bob": random.uniform(-0.5, 0.5, 3)})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", cvi.AccuracyWarning)
            traj = cvi.simulate(scene, None, v0, duration=1.5, tol=10.0 ** -random.integers(4, 8))
        assert traj.error_estimate >= error(scene, traj)
