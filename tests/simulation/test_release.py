"""The time at which a contact force falls to zero, against the closed form."""

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi

FOOT, BODY, SPRING, G = 0.5, 2.0, 400.0, 9.81  # [kg], [kg], [N/m], [m/s^2]
SQUEEZE = 0.15  # of the spring beyond its length under the body's weight [m]


def two_masses() -> cvi.Scene:
    """A foot on the ground that carries a body on a spring."""
    model = pin.Model()
    foot = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "foot")
    body = model.addJoint(foot, pin.JointModelPZ(), pin.SE3.Identity(), "body")
    for joint, mass in ((foot, FOOT), (body, BODY)):
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    shapes = pin.GeometryModel()
    shapes.addGeometryObject(pin.GeometryObject("foot", foot, pin.SE3.Identity(), coal.Sphere(0.1)))
    scene = cvi.Scene.from_pinocchio(model, shapes, name="two masses")
    scene.add_halfspace()
    scene.set_contact(restitution=0.0)
    scene.set_joint("body", stiffness=SPRING, rest=0.5)
    return scene


def late(dt: float, order: int) -> float:
    """Return by how much the foot is released late: the body swings, and the spring pulls the foot up."""
    start = [0.1, 0.5 - BODY * G / SPRING - SQUEEZE]
    traj = cvi.simulate(two_masses(), start, duration=0.2, dt=dt, order=order)
    release = next(c.time for c in traj.contact_changes if c.change == "release")
    return release - np.arccos(-(BODY + FOOT) * G / (SPRING * SQUEEZE)) / np.sqrt(SPRING / BODY)


def test_a_spring_lifts_a_foot():
    """Only the spring changes the force; the error is that of the midpoint rule, and falls like the square of dt."""
    errors = np.array([late(dt, 2) for dt in (0.02, 0.01, 0.005)])
    assert np.all(np.abs(errors) <= 1e-3 * np.array([1.0, 0.25, 0.0625]))
    assert errors[:-1] / errors[1:] == pytest.approx(4.0, rel=0.02)


def test_a_step_of_high_order_has_contact_steps_short_enough():
    assert abs(late(0.02, 6)) <= 5e-6
