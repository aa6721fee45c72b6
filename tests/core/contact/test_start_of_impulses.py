"""Contacts that share a load in many ways: their problems start from the impulses that are unique."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi


def box_in_a_groove(friction: float) -> cvi.Simulator:
    """A long box in a groove of two planes, on eight corners: walls may press it against each other."""
    scene = cvi.Scene()
    scene.add_halfspace((1.0, 0.0, 1.0), name="left")
    scene.add_halfspace((-1.0, 0.0, 1.0), name="right")
    turn = pin.rpy.rpyToMatrix(0.0, np.pi / 4, 0.0)
    scene.add_box("box", (0.1, 0.3, 0.1), placement=pin.SE3(turn, np.array([0.0, 0.0, 0.05 * np.sqrt(2.0)])))
    scene.set_contact(restitution=0.0, friction=friction)
    simulator = cvi.Simulator(scene, dt=1e-3, contact_mode="events")
    simulator.reset()
    simulator.run(20)
    return simulator


@pytest.mark.parametrize("friction", [0.05, 0.1, 0.2, 0.5])
def test_rest_takes_few_iterations(friction: float):
    """One with the shift, one or two without it; from the impulses themselves it takes another one and a half."""
    simulator = box_in_a_groove(friction)
    before = simulator.trajectory().stats
    simulator.run(20)
    after = simulator.trajectory().stats
    problems = after.cone_problems - before.cone_problems
    assert problems >= 40
    assert after.cone_iterations - before.cone_iterations <= 2.7 * problems
    contacts = simulator.trajectory().contacts
    assert len(set(zip(contacts.array("index"), contacts.array("feature"), strict=True))) == 8


def test_a_copy_goes_on_with_the_same_bits():
    simulator = box_in_a_groove(0.1)
    copy = simulator.copy()
    for one in (simulator, copy):
        one.run(20)
    first, second = simulator.trajectory(), copy.trajectory()
    np.testing.assert_array_equal(first.q, second.q)
    np.testing.assert_array_equal(first.p, second.p)
    assert first.stats.cone_iterations == second.stats.cone_iterations
