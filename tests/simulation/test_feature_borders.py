"""Smooth steps that end where a contact comes to another feature; motions with a known answer are in
test_contact_of_any_order.py."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers import held_contact_scenes as scenes
from helpers.contact_models import place
from helpers.held_contact_scenes import RADIUS

DURATION = 0.5  # [s]
MODELS = Path(__file__).resolve().parents[2] / "models"


def roof(scene: cvi.Scene) -> None:
    """A hull: level for x < 0, and 0.3 rad steep beyond."""
    profile = [(-1.0, 0.0), (0.0, 0.0), (1.0, -np.tan(0.3)), (-1.0, -1.0), (1.0, -1.0)]
    scene.add_mesh("table", np.array([[x, y, z] for y in (-0.5, 0.5) for x, z in profile]), free=False)


def table(scene: cvi.Scene) -> None:
    """A box with an edge at x = 0 and a corner at x = y = 0."""
    scene.add_box("table", (2.0, 2.0, 0.4), free=False, placement=place(-1.0, -1.0, -0.2))


# What it rolls or slides on, from where, at which speed, with which friction, and half axes of the body.
MOTIONS = {
    "from facet to facet of a hull": (roof, (-0.12, 0.0), (0.3, 0.0), 2.0, None),
    "over an edge": (table, (-0.12, -0.5), (0.3, 0.2), 2.0, None),
    "over a corner": (table, (-0.12, -0.13), (0.3, 0.3), 2.0, None),
    "slides over an edge": (table, (-0.12, -0.5), (0.5, 0.0), 0.1, None),
    "an ellipsoid": (table, (-0.12, -0.5), (0.3, 0.0), 2.0, (RADIUS, 0.14, RADIUS)),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_steps_of_any_length_agree(name):
    """Borders lie at other places in steps of other lengths."""
    under, at, speed, friction, radii = MOTIONS[name]
    scene = cvi.Scene()
    under(scene)
    if radii is None:
        scene.add_sphere("body", RADIUS)
    else:
        scene.add_ellipsoid("body", radii)
    scene.set_contact(restitution=0.0, friction=friction)
    q = pin.SE3ToXYZQUAT(place(*at, RADIUS))
    spin = np.zeros(2) if name.startswith("slides") else np.array([-speed[1], speed[0]]) / RADIUS
    v = np.array([*speed, 0.0, *spin, 0.0])
    runs = [
        cvi.simulate(scene, q, v, duration=DURATION, dt=DURATION / steps, order=order, solver_tol=1e-14)
        for steps, order in ((10, 16), (40, 8), (400, 12))
    ]
    runs.append(cvi.simulate(scene, q, v, duration=DURATION, dt="auto", tol=1e-8))
    assert runs[-1].error_estimate <= 1e-8
    for traj in runs:
        assert traj.stats.contact_steps == 0
        # rounding, of steps that are solved to it
        assert np.abs(traj.q[-1] - runs[2].q[-1]).max() < 1e-11
        assert all(float(scene.gaps(row)[0]) > -1e-12 for row in traj.q)


@pytest.mark.parametrize("order", [4, 8, 16])
@pytest.mark.parametrize("roller", ["ball", "capsule"])
def test_a_border_at_a_node(roller, order):
    """It is reached after .4 s, at the end of the fifth of seven steps, to rounding; no step is made for the rest."""
    held = scenes.over_edge(roller, "box")
    traj = held.run(7, order)
    assert traj.t[5] == pytest.approx(0.4, abs=1e-12)
    assert traj.stats.contact_steps == 0


@pytest.mark.slow
@pytest.mark.parametrize("duration", [1.0, 5.0])
def test_a_ball_in_a_hand_is_as_accurate_as_asked(duration):
    """It rolls over the edges of the palm and of the fingers, between two thousand impacts."""
    scene = cvi.load_scene(MODELS / "allegro_ball.toml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        traj = cvi.simulate(scene, duration=duration, dt="auto", tol=1e-6)
    assert traj.status.ok
    assert traj.error_estimate <= 1e-6
    assert traj.stats.dense_steps == 0
