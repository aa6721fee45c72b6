"""The derivatives of runs with contacts on surfaces given by functions, against differences of the runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import transpose_error
from derivatives.test_persistent_sensitivity import Start, check
from helpers.thinning import every
from helpers.wavy_ground import bend, slope, waves

MOVING = [1.0, 0.3, -0.1, 0.5, 0.2, 0.3]
ORDER_2, ORDER_4 = {"dt": 0.01, "order": 2}, {"dt": 0.01, "order": 4}


SURFACES: dict[str, dict[str, Any]] = {
    "waves": {"height": waves, "gradient": slope, "hessian": bend},
    "dome": {
        "distance": lambda p: np.linalg.norm(p + [0.1, 0.0, 2.0], axis=1) - 2.0,
        "gradient": lambda p: (p + [0.1, 0.0, 2.0]) / np.linalg.norm(p + [0.1, 0.0, 2.0], axis=1, keepdims=True),
        "extent": [(-0.5, 0.5), (-0.5, 0.5), (-0.5, 0.5)],
    },
}


def start(surface: str, shape: str, height: float, mu: float, e: float = 0.0) -> Start:
    scene = cvi.Scene()
    if shape == "box":
        scene.add_box("body", [0.2, 0.3, 0.25])
    else:
        scene.add_sphere("body", 0.1)
    scene.add_surface("ground", **SURFACES[surface])
    scene.set_contact(restitution=e, friction=mu)
    turn = np.random.default_rng(5).uniform(-1, 1, 3)
    q = pin.integrate(scene.model, pin.neutral(scene.model), np.r_[0, 0, 0, turn])
    q[2] = height
    return scene, q, np.array(MOVING)


# name -> start, duration, options
RUNS = {
    "a ball bounces": (lambda: start("waves", "ball", 0.2, 0.2, 0.8), 0.4, ORDER_2),
    "a ball slides": (lambda: start("waves", "ball", 0.12, 0.0), 0.2, ORDER_2),
    "a ball slips": (lambda: start("waves", "ball", 0.12, 0.1), 0.2, ORDER_2),
    "a ball rolls": (lambda: start("waves", "ball", 0.12, 1.0), 0.2, ORDER_2),
    "a ball slides, order 4": (lambda: start("waves", "ball", 0.12, 0.0), 0.2, ORDER_4),
    "a ball rolls, order 4": (lambda: start("waves", "ball", 0.12, 1.0), 0.2, ORDER_4),
    "a corner slides": (lambda: start("waves", "box", 0.26, 0.0), 0.15, ORDER_2),
    "a corner slips, order 4": (lambda: start("waves", "box", 0.26, 0.1), 0.12, ORDER_4),
    "a corner sticks": (lambda: start("waves", "box", 0.26, 1.2), 0.12, ORDER_2),
    "a ball slips on a dome": (lambda: start("dome", "ball", 0.12, 0.1), 0.2, ORDER_2),
    "a ball rolls on a dome, order 4": (lambda: start("dome", "ball", 0.12, 1.0), 0.2, ORDER_4),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", every(3, RUNS))
def test_runs_on_surfaces(name: str) -> None:
    """Tangent against differences, and the adjoint against the tangent."""
    make, duration, options = RUNS[name]
    made = make()
    traj = check(made, list(range(2 * made[0].nv)), (1e-4, 5e-5), duration=duration, **options)
    assert traj.status.ok
    assert len(traj.events) + len(traj.contact_changes) > 0
    assert transpose_error(traj, ["q0", "v0"]) <= 2e-12


def test_second_derivatives_are_refused() -> None:
    """The third derivatives of such a gap are not known."""
    scene, q, v = start("waves", "ball", 0.2, 0.0, 0.8)
    traj = cvi.simulate(scene, q, v, duration=0.2, dt=0.01, record="gradient")
    with pytest.raises(cvi.NotDifferentiable, match="surface given by a function"):
        cvi.hessian_vector(traj, (np.ones(scene.nv), np.ones(scene.nv)), {"v0": np.ones(scene.nv)}, hessp="linear")
