"""What users can measure of persistent contacts in smooth steps: gaps, energy, impulses; and what is left to others."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi
from helpers import held_contact_scenes as scenes

GRAVITY = 9.81


def rolling_cylinder(friction: float) -> cvi.Scene:
    """A cylinder dropped on its rim: it rocks and rolls from side to side, faster the flatter it lies."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_cylinder("can", radius=0.08, length=0.2, placement=((0.0, 0.0, 0.35), (0.7, 0.2, 0.1)))
    scene.set_contact(restitution=0.0, friction=friction)
    return scene


@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize("friction", [0.0, 0.3, 0.8])
def test_a_rim_gains_no_energy(friction, order):
    """Where the rim falls nearly flat its point runs around it; steps that do not resolve that are not taken."""
    scene = rolling_cylinder(friction)
    traj = cvi.simulate(scene, None, [0.3, -0.2, 0.0, 0.5, 0.4, 0.1], duration=1.5, dt=1e-2, order=order)
    assert traj.phases is not None
    assert min(scene.gaps(q).min() for q in traj.q) >= -1e-9
    rise = traj.energy - np.minimum.accumulate(traj.energy)
    assert rise.max() <= 1e-3 * traj.kinetic_energy.max()  # what a step may be off by


@pytest.mark.parametrize("order", [4, 8])
def test_impulses_are_those_of_the_motion(order):
    """The normal turns while a ball rolls off another: the impulses, gravity and the momentum balance exactly."""
    held = scenes.ball_off_sphere()
    traj = held.run(8, order)
    log = traj.contacts
    mass = traj.scene.model.inertias[1].mass
    momentum = mass * held.observe(traj.q, traj.v)[:, 2:4]  # x and z
    for k in range(len(traj) - 1):
        inside = (log.t >= traj.t[k] - 1e-12) & (log.t < traj.t[k + 1] - 1e-12)
        impulse = log.array("start")[inside].sum(axis=0) + log.array("end")[inside].sum(axis=0)
        weight = mass * GRAVITY * (traj.t[k + 1] - traj.t[k])
        change = momentum[k + 1] - momentum[k] + np.array([0.0, weight])
        np.testing.assert_allclose(impulse[[0, 2]], change, atol=1e-13)
    impulses = log.array("start") + log.array("end")
    along = np.einsum("ij,ij->i", impulses, log.array("normal"))
    across = np.linalg.norm(impulses - along[:, None] * log.array("normal"), axis=1)
    assert (along > 0.0).all()
    assert (across <= 0.3 * along * (1.0 + 1e-12)).all()
    assert np.abs(np.linalg.norm(log.array("normal"), axis=1) - 1.0).max() < 1e-14


@pytest.mark.parametrize("order", [4, 8])
def test_what_rigid_bodies_leave_open(order):
    """How the corners of a box share its weight decides how it spins while it slides: contact steps take over."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", size=(0.2, 0.3, 0.1), mass=2.0, placement=((0.0, 0.0, 0.05), (0.0, 0.0, 0.0)))
    scene.set_contact(restitution=0.0, friction=0.3)
    v = [1.0, 0.3, 0.0, 0.0, 0.0, 3.0]
    exact = cvi.simulate(scene, None, v, duration=0.2, dt=1e-4, order=2)
    traj = cvi.simulate(scene, None, v, duration=0.2, dt=1e-2, order=order)
    assert traj.stats.contact_steps > 0
    assert "order 2" in traj.stepping
    # of contact steps of 1e-3 s; the error of such steps falls with their square
    assert np.abs(traj.q[-1] - exact.q[-1]).max() < 1e-6
    # without the spin the split of the load does not matter
    straight = cvi.simulate(scene, None, [1.0, 0.3, 0.0, 0.0, 0.0, 0.0], duration=0.2, dt=1e-2, order=order)
    assert straight.stats.contact_steps == 0


@pytest.mark.slow
@pytest.mark.parametrize("order", [4, 8])
def test_rolling_keeps_its_energy_for_long(order):
    """A coin that wobbles along for 1e5 steps: its energy stays within the error of the first turns."""
    held = scenes.rolling_coin(1.0)
    dt = {4: 5e-3, 8: 2e-2}[order]
    traj = cvi.simulate(held.scene, held.q, held.v, duration=1e5 * dt, dt=dt, order=order, record_every=50)
    first = np.ptp(traj.energy[: len(traj) // 50])
    assert np.ptp(traj.energy) <= 1.5 * first + 1e-10 * abs(traj.energy[0])
