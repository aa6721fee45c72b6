"""The derivatives of runs with friction against spinning and rolling, against differences of the runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import transpose_error
from derivatives.test_friction_laws import ALL, FLAT
from derivatives.test_persistent_sensitivity import Start, check, compare

SPINS = {"spinning_radius": 0.02}
ROLLS = {"rolling_radius": 0.005}
BOTH = SPINS | ROLLS
TURNTABLE = {"linear": (0.3, 0.0, 0.0), "angular": (0.2, 0.0, 1.5), "profile": lambda t: 1.0 + math.sin(4.0 * t)}


def ball(
    radii: dict[str, float], e: float = 0.0, height: float = 0.11, mu: float = 0.3, tilt: float = 0.0, **surface: Any
) -> Start:
    scene = cvi.Scene()
    scene.add_halfspace([math.sin(tilt), 0.0, math.cos(tilt)], name="ground")
    scene.add_sphere("body", 0.1, mass=0.7)
    scene.set_contact("ground", "body", restitution=e, friction=mu, **radii)
    if surface:
        scene.set_surface_velocity("ground", **surface)
    q = pin.integrate(scene.model, pin.neutral(scene.model), np.array([0.1, 0.2, 0.0, 0.3, -0.4, 0.2]))
    q[2] = height
    return scene, q, np.array([1.0, 0.4, 0.0, 0.5, -2.0, 3.0])


def on_ball() -> Start:
    """A ball that rolls on a larger one, and leaves it."""
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    scene.add_sphere("big", 0.5, free=False)
    scene.set_contact(restitution=0.0, friction=0.8, **BOTH)
    q = pin.neutral(scene.model)
    q[:3] = [0.3, 0.05, 0.615]
    return scene, q, np.array([0.3, 0.0, -0.3, 0.2, 0.1, 0.3])


def corner() -> Start:
    """A box that slides and spins on a corner."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("body", [0.2, 0.3, 0.25])
    scene.set_contact(restitution=0.0, friction=0.2, **BOTH)
    q = pin.integrate(scene.model, pin.neutral(scene.model), np.array([0, 0, 0, 0.4, -0.7, 0.2]))
    q[2] = 0.25
    return scene, q, np.array([0.5, 0.2, -0.3, 0.4, -0.3, 2.0])


def resting(radii: dict[str, float], v: tuple[float, ...]) -> Start:
    """A ball on the ground, which may be moved along it."""
    scene = ball(radii)[0]
    return scene, np.array([0.1, 0.2, 0.1, 0.0, 0.0, 0.0, 1.0]), np.array(v)


# name -> start, directions of (q0, v0), duration
RUNS: dict[str, tuple[Callable[[], Start], list[int], float]] = {
    "a ball bounces and spins": (lambda: ball(SPINS, 0.7, 0.3), ALL, 0.4),
    "a ball bounces and rolls": (lambda: ball(ROLLS, 0.7, 0.3, 1.5), ALL, 0.4),
    "a ball bounces, spins and rolls": (lambda: ball(BOTH, 0.7, 0.3), ALL, 0.4),
    "a ball bounces on a turntable": (lambda: ball(BOTH, 0.5, 0.3, 0.3, **TURNTABLE), ALL, 0.4),
    "a ball slips and spins": (lambda: ball(SPINS), ALL, 0.16),
    "a ball slips and rolls": (lambda: ball(ROLLS), ALL, 0.16),
    "a ball slips, spins and rolls": (lambda: ball(BOTH), ALL, 0.16),
    "a ball slips on a turntable": (lambda: ball(BOTH, **TURNTABLE), ALL, 0.16),
    "a ball slips down a slope": (lambda: ball(BOTH, tilt=0.3, height=0.14), ALL, 0.16),
    "a ball comes to roll on a turntable": (lambda: ball(ROLLS, **TURNTABLE), ALL, 0.5),
    "a ball spins down": (lambda: resting(SPINS, (0.0, 0.0, 0.0, 0.0, 0.0, 3.0)), [0, 1, 5, 11], 0.5),
    "a ball rolls to rest": (lambda: resting({"rolling_radius": 0.02}, (0.4, 0.1, 0.0, -1.0, 2.0, 0.0)), FLAT, 0.5),
    "a ball rolls on a ball and leaves it": (on_ball, ALL, 0.5),
    "a corner slides and spins": (corner, ALL, 0.12),
}


@pytest.mark.parametrize("name", RUNS)
def test_runs_with_friction_against_turning(name: str) -> None:
    make, directions, duration = RUNS[name]
    traj = check(make(), directions, (1e-4, 5e-5), duration=duration, dt=0.01, order=2)
    assert traj.status.ok
    assert transpose_error(traj, ["q0", "v0", "friction", "gravity", "inertia:" + traj.scene.model.names[-1]]) <= 1e-11


def test_a_slip_and_a_spin_that_come_to_rest_together() -> None:
    """Their direction turns up to the end, which leaves the limit of friction within a short step: a kink."""
    (scene, q, v), options = ball(BOTH), {"duration": 0.5, "dt": 0.01, "order": 2, "record": "gradient"}
    traj = cvi.simulate(scene, q, v, **options)
    with pytest.raises(cvi.NotDifferentiable, match="sticking and slipping"):
        traj.sensitivity()

    def end(change: np.ndarray) -> np.ndarray:
        run = cvi.simulate(scene, pin.integrate(scene.model, q, change[:6]), v + change[6:], **options)
        return np.concatenate([pin.difference(scene.model, traj.q[-1], run.q[-1]), run.v[-1]])

    compare(traj.sensitivity(on_kink="taken"), end, ALL, (1e-4, 5e-5))
