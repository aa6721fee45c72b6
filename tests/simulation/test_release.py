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


# Padé's approximant of exp(i x), which turns the phase of a swing in a step of s Gauss stages: its numerator.
PHASES = {
    2: lambda x: np.arctan2(x / 2.0, 1.0),
    6: lambda x: np.arctan2(x / 2.0 - x**3 / 120.0, 1.0 - x**2 / 10.0),
}


def late(dt: float, order: int, step: float, order_of_steps: int, **options) -> tuple[float, float]:
    """Return by how much the foot is released late, and by how much steps of this length say so.

    The body swings with the frequency w on its spring, which pulls the foot up. Steps of order 2 turn the phase by
    2 atan(w h / 2) instead of w h: the swing takes 1 + (w h)^2 / 12 times as long.

    Args:
        step: length of the steps in contact. order_of_steps: their order.
    """
    start = [0.1, 0.5 - BODY * G / SPRING - SQUEEZE]
    traj = cvi.simulate(two_masses(), start, duration=0.2, dt=dt, order=order, **options)
    release = next(c.time for c in traj.contact_changes if c.change == "release")
    w = np.sqrt(SPRING / BODY)
    time = np.arccos(-(BODY + FOOT) * G / (SPRING * SQUEEZE)) / w
    phase = 2.0 / step * PHASES[order_of_steps](w * step)  # per second
    return release - time, time * (w / phase - 1.0)


@pytest.mark.parametrize("h", [0.02, 0.01, 0.005, 0.001])
def test_a_spring_lifts_a_foot(h):
    """Only the spring changes the force. The last step is a partial one, with a smaller error than whole ones."""
    found, expected = late(h, 2, h, 2)
    steps = 0.14 / h
    assert found == pytest.approx(expected, rel=1.0 / steps)


@pytest.mark.parametrize("record", ["states", "gradient"])
@pytest.mark.parametrize("dt_contact", [None, 1e-3])
@pytest.mark.parametrize("h", [0.04, 0.02, 0.01, 0.005])
def test_a_spring_lifts_a_foot_in_steps_of_order_six(h, dt_contact, record):
    """The release is located to the error of the smooth steps, whatever dt_contact says."""
    found, expected = late(h, 6, h, 6, dt_contact=dt_contact, record=record)
    steps = 0.14 / h
    assert found == pytest.approx(expected, rel=1.0 / steps, abs=1e-13)
