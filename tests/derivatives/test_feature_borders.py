"""Derivatives through places where a contact comes to another feature of its shape."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import transpose_error
from helpers import held_contact_scenes as scenes
from helpers.held_contact_scenes import RADIUS, Held

STEP = 1e-5  # of central differences: STEP^2 is left out, and rounding over STEP


def run(held: Held, v: np.ndarray) -> cvi.Trajectory:
    return cvi.simulate(
        held.scene,
        held.q,
        v,
        duration=held.duration,
        dt=held.duration / 21,
        order=8,
        record="gradient",
        solver_tol=1e-13,
    )


def rolling(roller: str, held: Held) -> list[np.ndarray]:
    """Changes of the start's velocity that keep it rolling: forward; of a ball also to the side, and spinning."""
    turn = pin.Quaternion(*held.q[[6, 3, 4, 5]]).matrix()
    speeds = [([1.0, 0.0, 0.0], [0.0, 1.0 / RADIUS, 0.0])]
    if roller == "ball":
        speeds += [([0.0, 1.0, 0.0], [-1.0 / RADIUS, 0.0, 0.0]), ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])]
    changes = [np.concatenate([turn.T @ velocity, turn.T @ spin]) for velocity, spin in speeds]
    return [change / np.linalg.norm(change) for change in changes]


@pytest.mark.parametrize(
    ("roller", "kind"),
    [
        *[("ball", kind) for kind in scenes.EDGES if kind != "end of a cylinder"],
        ("capsule", "box"),
        ("capsule", "capsule"),
    ],
)
def test_bodies_that_roll_over_an_edge(roller, kind):
    held = scenes.over_edge(roller, kind)
    traj = run(held, held.v)
    assert traj.stats.contact_steps == 0
    model = held.scene.built().model
    matrix = np.reshape(traj.sensitivity("v0").at(traj.t[-1]), (2 * model.nv, model.nv))
    for direction in rolling(roller, held):
        above, below = (run(held, held.v + sign * STEP * direction) for sign in (1.0, -1.0))
        change = np.append(pin.difference(model, below.q[-1], above.q[-1]), above.v[-1] - below.v[-1]) / (2.0 * STEP)
        # of changes of about 10
        assert np.abs(matrix @ direction - change).max() < 1e-8
    assert transpose_error(traj, ["q0", "v0"]) <= 2e-12


def test_a_contact_that_slides_over_an_edge_is_refused():
    """Its friction jumps with the normal force, at a time that moves: that is not taken into account."""
    held = scenes.over_edge("ball", "box")
    held.scene.set_contact(restitution=0.0, friction=0.1)
    v = held.v.copy()
    v[3:] = 0.0
    v[0] = 1.0  # it slides all the way
    traj = run(held, v)
    assert traj.stats.contact_steps == 0
    with pytest.raises(cvi.NotDifferentiable, match="slides with friction comes to another feature"):
        traj.sensitivity("v0").at(traj.t[-1])


def test_the_border_of_the_end_of_a_cylinder_is_refused():
    """On the side of its rim the normal has a direction in which it does not turn, only there."""
    held = scenes.over_edge("ball", "end of a cylinder")
    with pytest.raises(cvi.NotDifferentiable, match="rim against ball"):
        run(held, held.v).sensitivity("v0").at(held.duration)
