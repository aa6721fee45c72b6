"""The derivatives of dense steps with laws of friction and restitution that are drawn at random, on surfaces that may
move, against differences of the runs, and the adjoint against the tangent.

In a dense step friction, and restitution by the closing speed, are those of the speeds at its start.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import transpose_error
from derivatives.test_dense_sensitivity import DENSE, Start, compare

SEEDS, LONG = 12, 150
SHAPES = {"ball": 0.25, "corner": 0.12, "rim": 0.1, "balls": 0.2}  # duration [s]


def friction(rng: np.random.Generator) -> dict[str, Any]:
    """Return arguments of set_contact for a law of friction."""
    mu = float(rng.uniform(0.05, 0.8))
    match rng.integers(5):
        case 0:
            return {"friction": mu}
        case 1:
            return {"friction": mu, "static_friction": 1.3 * mu}
        case 2:
            low, scale = mu * float(rng.uniform(0.4, 1.0)), float(rng.uniform(0.1, 1.0))
            return {"friction": lambda v: low + (mu - low) * math.exp(-v / scale)}
        case 3:
            return {"friction": lambda v: mu * (1.0 + 0.3 * v / (1.0 + v)), "static_friction": 1.2 * mu}
        case _:
            axis = rng.normal(size=3)
            return {"friction": (mu, float(rng.uniform(0.05, 0.8))), "friction_axis": axis + np.sign(axis)}


def restitution(rng: np.random.Generator) -> dict[str, Any]:
    """Return arguments of set_contact for restitution, that of a number or of the closing speed."""
    e = float(rng.choice([0.0, rng.uniform(0.2, 0.8)]))
    return {"restitution": e} if rng.integers(2) else {"restitution": lambda v: e / (1.0 + 0.2 * v)}


def drawn(seed: int) -> tuple[Start, dict[str, Any]]:
    """Return a start and the options of its run."""
    rng = np.random.default_rng(4400 + seed)
    shape = list(SHAPES)[seed % len(SHAPES)]
    slope = float(rng.uniform(0.0, 0.3))
    scene = cvi.Scene(gravity=9.81 * np.array([math.sin(slope), 0.0, -math.cos(slope)]))
    scene.add_halfspace(name="ground")
    if shape == "corner":
        scene.add_box("body", [0.2, 0.3, 0.25])
    elif shape == "rim":
        scene.add_cylinder("body", 0.1, 0.3)
    else:
        scene.add_sphere("body", 0.1)
    first = ["body", "ground"][:: int(rng.choice([-1, 1]))]  # whose axis it is
    scene.set_contact(*first, **friction(rng), **restitution(rng))
    if shape == "balls":
        scene.add_sphere("upper", 0.08, mass=0.4)
        scene.set_contact("upper", "body", **friction(rng), **restitution(rng))
        scene.set_contact("upper", "ground", friction=0.2, restitution=0.0)
    if rng.integers(3):
        profile = None if rng.integers(2) else (lambda t: 1.0 + math.sin(5.0 * t))
        linear, angular = [*rng.normal(size=2), 0.0], [0.0, 0.0, rng.normal()]
        scene.set_surface_velocity("ground", linear, angular, profile=profile)
    turned = rng.uniform(-1, 1, scene.nv) * np.tile([0, 0, 0, 1, 1, 1], scene.nv // 6)
    q = pin.integrate(scene.model, pin.neutral(scene.model), turned)
    up = pin.Quaternion(q[3:7]).matrix()[2]  # of the vertical in the body's axes
    lowest = {"corner": np.abs(up) @ [0.1, 0.15, 0.125], "rim": 0.1 * math.hypot(*up[:2]) + 0.15 * abs(up[2])}
    q[2] = lowest.get(shape, 0.1) + 0.02
    if shape == "balls":
        q[7:10] = [0.03, 0.02, 0.32]
    v = rng.normal(size=scene.nv)
    v[2::6] = -0.3
    v[:3] = pin.Quaternion(q[3:7]).matrix().T @ v[:3]
    return (scene, q, v), {"duration": SHAPES[shape], "dt": 0.01, **DENSE}


def examine(seed: int) -> str:
    """Compare the derivatives of a run; return why they are approximate, empty where they are not."""
    start, options = drawn(seed)
    scene, q, v = start
    run = cvi.simulate(scene, q, v, record="gradient", **options)
    assert len(run.dense_steps)
    assert len(run.contacts)
    try:
        S = run.sensitivity()
    except cvi.NotDifferentiable as error:
        if error.reason != "redundant":  # points of a rim, or of a face, that land together
            raise
        return error.reason
    wrt = ["q0", "v0", "control", "friction", "restitution", "inertia:" + scene.model.names[-1]]
    assert transpose_error(run, wrt) <= 1e-9  # the loads that a rim's points share are found to some digits less
    if reasons := {step.reason for step in S.report.dense_steps if step.reason}:
        return "; ".join(sorted(reasons))
    directions = np.random.default_rng(seed).standard_normal((2 * scene.nv, 4))
    compare(S, start, directions / np.linalg.norm(directions, axis=0), (1e-6, 5e-7), options)
    return ""


@pytest.mark.filterwarnings("ignore::contactvi.ApproximateDerivativeWarning")
@pytest.mark.parametrize("seed", range(SEEDS))
def test_drawn_laws(seed: int) -> None:
    examine(seed)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::contactvi.ApproximateDerivativeWarning")
def test_many_drawn_laws() -> None:
    """The same for hundreds of scenes, of which some have approximate derivatives."""
    reasons = [examine(1000 + seed) for seed in range(LONG)]
    assert sum(not reason for reason in reasons) > 0.6 * LONG


def test_friction_of_rest_that_a_direction_takes_away() -> None:
    """A ball held on a slope by its friction of rest alone: moved at the start it is held no more, a jump."""
    scene = cvi.Scene(gravity=(4.0, 0.0, -9.0))
    scene.add_halfspace(name="ground")
    scene.add_box("body", (0.2, 0.2, 0.2))
    scene.set_contact(restitution=0.0, friction=0.3, static_friction=0.6)
    q = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0])
    run = cvi.simulate(scene, q, duration=0.05, record="gradient", **{"dt": 0.01, **DENSE})
    assert np.abs(run.v[-1]).max() <= 1e-9
    assert not run.sensitivity("control").report.approximate
    S = run.sensitivity("v0")
    assert {step.reason for step in S.report.dense_steps if step.reason} == {
        "friction of rest that a direction takes away"
    }
