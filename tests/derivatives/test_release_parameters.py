"""Derivatives by parameters of the scene through the release of a persistent contact, whose time depends on them.

The force that falls to zero depends on inertias, gravity, springs, damping and servos at the state there. All runs keep
their derivatives, those of the differences, too: above order 2 other runs have other steps in contact.
"""

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import FOURTH, compare_parameters, transpose_error
from helpers.sprung_arm import COLUMNS, NAMES, SPRUNG_ARM, sprung_arm


def rising(start: float, steps: int, wait: int, by: float) -> np.ndarray:
    """Return targets that stay and then rise."""
    return start + by * np.maximum(np.arange(steps) - wait, 0.0)[:, None]


def ball_on_ball() -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
    """A ball that drops on a fixed one, rolls off and leaves it."""
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    scene.add_sphere("big", 0.5, free=False)
    scene.set_contact(restitution=0.0, friction=0.1)
    q = pin.neutral(scene.model)
    q[:3] = [0.3, 0.05, 0.615]
    return scene, q, np.array([0.3, 0.0, -0.3, 0.2, 0.1, 0.3])


def leg() -> cvi.Scene:
    """A leg with a tail on a hip that turns about all axes, lifted by a servo until its tip leaves the ground."""
    model = pin.Model()
    lift = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "lift")
    hip = model.addJoint(lift, pin.JointModelSpherical(), pin.SE3.Identity(), "hip")
    tail = model.addJoint(hip, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.0])), "tail")
    thigh = pin.Inertia(0.6, np.array([0.1, 0.02, 0.03]), np.diag([0.01, 0.02, 0.025]))
    shank = pin.Inertia(0.3, np.array([0.05, 0.01, 0.0]), np.diag([0.003, 0.004, 0.005]))
    for joint, inertia in ((lift, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3))), (hip, thigh), (tail, shank)):
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    shapes = pin.GeometryModel()
    place = pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.0]))
    shapes.addGeometryObject(pin.GeometryObject("tip", tail, place, coal.Sphere(0.05)))
    scene = cvi.Scene.from_pinocchio(model, shapes, name="leg")
    scene.add_halfspace()
    scene.set_contact(restitution=0.0, friction=0.05)
    scene.set_joint("hip", stiffness=6.0, damping=0.1, armature=0.02)
    scene.set_joint("tail", stiffness=5.0, rest=0.1, damping=0.02, armature=0.01)
    scene.set_servo("lift", kp=200.0, kd=10.0)
    return scene


def compare(scene: cvi.Scene, q: np.ndarray, v: np.ndarray, names: list[str], **options) -> None:
    options["record"] = "gradient"
    traj = cvi.simulate(scene, q, v, **options)
    assert [c.change for c in traj.contact_changes] == ["begin", "release"]
    assert transpose_error(traj, names) <= 2e-12
    S = traj.sensitivity(names)
    for name in names:
        values = scene.parameter(name)
        for k, value in enumerate(values):
            found = []  # steps at which what runs differ by through rounding, 1e-12, is less than 1e-8 of a column
            for step in (4e-4 * max(abs(value), 0.1), 2e-4 * max(abs(value), 0.1)):
                total = np.zeros(2 * scene.nv)
                for count, weight in FOURTH:
                    changed = scene.with_parameters({name: values + count * step * np.eye(len(values))[k]})
                    run = cvi.simulate(changed, q, v, **options)
                    moved = pin.difference(scene.model, traj.q[-1], run.q[-1])
                    total += weight / step * np.concatenate([moved, run.v[-1]])
                found.append(total)
            scale, own = np.abs(found[1]).max(), np.abs(found[1] - found[0]).max()
            assert own <= 1e-5 * scale
            assert np.abs(S.of(name)[-1][:, k] - found[1]).max() <= 1e-8 * scale + own, (name, k)


def test_a_ball_leaves_a_ball():
    compare(*ball_on_ball(), ["gravity", "mass:ball", "inertia:ball"], duration=0.6, dt=0.01, order=6)


@pytest.mark.parametrize("order", [2, 6])
def test_a_leg_is_lifted(order):
    scene = leg()
    q, v = pin.neutral(scene.model), np.array([0.0, 0.5, 0.8, 0.3, 0.0])
    q[0] = 0.2
    names = ["gravity", "mass:hip", "inertia:tail", "stiffness:hip", "damping:hip", "armature:hip", "armature:tail"]
    names += ["rest:tail", "kp:lift", "kd:lift"]
    compare(scene, q, v, names, duration=0.6, dt=0.01, order=order, target=rising(0.05, 60, 30, 0.02))


def test_an_arm_is_lifted_and_drops_again():
    scene_of, x = sprung_arm(restitution=0.0, friction=0.0), np.array(SPRUNG_ARM)
    q, v = np.array([0.4, -0.2]), np.array([0.0, 1.0])
    options = {"duration": 0.8, "dt": 0.005, "order": 4, "target": rising(0.3, 160, 60, 0.06), "record": "gradient"}
    traj = cvi.simulate(scene_of(x), q, v, **options)
    assert [c.change for c in traj.contact_changes] == ["begin", "release", "begin"]
    compare_parameters(traj, lambda x: cvi.simulate(scene_of(x), q, v, **options), x, NAMES, COLUMNS)
    assert transpose_error(traj, [*NAMES, "q0", "v0"]) <= 2e-12
