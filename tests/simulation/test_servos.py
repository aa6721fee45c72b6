"""Servos, targets, actuator limits: bad input, laws of PD, saturation, and targets given in several ways."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.loop_scenes import arm_scene, wheel_scenes
from helpers.run_scenes import HAND_URDF


def servo_scene(gravity: bool = False, **options) -> cvi.Scene:
    scene = arm_scene(2, gravity=gravity)
    scene.set_servo("j*", options.pop("kp", 20.0), options.pop("kd", 2.0), **options)
    return scene


# -- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("target", "text"),
    [
        (np.zeros(3), "shape (3,)"),
        (np.zeros((9, 2)), "shape (9, 2)"),
        ("up", "(2,), (4,), (10, 2) or (10, 4)"),
        ([0.0, math.nan], "not finite"),
        ({"j7": 0.1}, "Unknown joint"),
        ({"j1": "up"}, "Signal target of joint 'j1'"),
        (lambda t: np.zeros(3), "target returned the wrong shape at t = 0 s"),
        (lambda t: [0.0, math.inf], "at entry 1 (j2)"),
        (lambda t: 1 / 0, "ZeroDivisionError"),
    ],
)
def test_bad_targets(target, text):
    with pytest.raises(cvi.InputError) as caught:
        cvi.simulate(servo_scene(), duration=0.01, dt=1e-3, target=target)
    assert text in str(caught.value)


def test_targets_need_servos():
    with pytest.raises(cvi.InputError, match="set_servo"):
        cvi.simulate(arm_scene(2), duration=0.01, dt=1e-3, target=[0.0])
    scene = arm_scene(2)
    scene.set_servo("j1", 1.0, 1.0)
    with pytest.raises(cvi.InputError, match="'j2' has no servo"):
        cvi.simulate(scene, duration=0.01, dt=1e-3, target={"j2": 0.1})
    with pytest.raises(cvi.InputError, match="a time in seconds with a target for each step"):
        cvi.simulate(scene, duration=0.01, dt="auto", target=[[0.1]])


@pytest.mark.parametrize("limits", [{}, {"effort": 4.0}])
def test_auto_with_servos(limits):
    """Constant targets: the accuracy is met, against steps of one length; also where effort is at its limit."""
    scene = servo_scene(gravity=True, kp=60.0, kd=2.0)
    if limits:
        scene.set_actuator("j*", **limits)
    q0 = scene.configuration({"j1": -0.5, "j2": 0.3})
    v0 = np.array([2.0, -1.0])
    exact = cvi.simulate(scene, q0, v0, duration=1.0, dt=2e-3, order=8, solver_tol=1e-14).q[-1]
    for tol in (1e-4, 1e-8):
        traj = cvi.simulate(scene, q0, v0, duration=1.0, dt="auto", tol=tol)
        assert traj.error_estimate <= tol
        assert np.abs(traj.q[-1] - exact).max() <= 3.0 * traj.error_estimate + 1e-12
        assert len(traj.t) < 200


# -- laws -------------------------------------------------------------------------------------------------------------


def test_a_servo_holds_where_it_starts():
    scene = servo_scene(gravity=True, kp=1e4, kd=100.0)
    q0 = scene.configuration({"j1": -0.5, "j2": 0.3})
    traj = cvi.simulate(scene, q0, duration=1.0, dt=1e-3)
    assert np.abs(traj.q - q0).max() < 2e-3  # the weight, 12 N m, over 1e4 N m/rad


def test_a_servo_is_a_spring_and_a_damper():
    """Towards a target that stands still; as far as both are in the step in the same way, to O(h^2)."""
    sprung = arm_scene(2, gravity=False)
    sprung.set_joint("j*", stiffness=20.0, damping=2.0)
    sprung.set_joint("j1", rest=0.5)
    errors = []
    for dt in (2e-3, 1e-3):
        a = cvi.simulate(sprung, duration=1.0, dt=dt)
        b = cvi.simulate(servo_scene(), duration=1.0, dt=dt, target=[0.5, 0.0])
        errors.append(np.abs(a.q - b.q).max())
    assert errors[1] < 1e-5
    assert errors[1] < 0.3 * errors[0] or errors[0] < 1e-10


def test_targets_said_in_several_ways():
    """Constant over each step, taken at its start."""
    times = 1e-3 * np.arange(200)
    goal, rate = 0.3 * np.sin(5 * times), 1.5 * np.cos(5 * times)
    rows = np.column_stack([goal, 0 * goal, rate, 0 * goal])
    scene = servo_scene()
    given = [
        rows,
        lambda t: [0.3 * math.sin(5 * t), 0.0, 1.5 * math.cos(5 * t), 0.0],
        {"j1": lambda t: (0.3 * math.sin(5 * t), 1.5 * math.cos(5 * t), 0.0)},
    ]
    runs = [cvi.simulate(scene, duration=0.2, dt=1e-3, target=target).q for target in given]
    for other in runs[1:]:
        assert other == pytest.approx(runs[0], abs=1e-12)
    own = arm_scene(2, gravity=False)
    own.set_servo("j1", 20.0, 2.0, target=lambda t: (0.3 * math.sin(5 * t), 1.5 * math.cos(5 * t), 0.0))
    own.set_servo("j2", 20.0, 2.0)
    assert cvi.simulate(own, duration=0.2, dt=1e-3).q == pytest.approx(runs[0], abs=1e-12)
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset()
    for row in rows:
        sim.step(target=row)
    assert sim.q == pytest.approx(runs[0][-1], abs=1e-12)
    sim.reset()
    sim.run(200, target=rows)
    assert np.array_equal(sim.q, runs[0][-1])


def test_feed_forward_is_on_top():
    """Gravity compensation put in as control: the servo has nothing left to do."""
    scene = servo_scene(gravity=True)
    q0 = scene.configuration({"j1": -0.4, "j2": 0.2})
    weight = pin.computeGeneralizedGravity(scene.model, scene.model.createData(), q0)
    traj = cvi.simulate(scene, q0, duration=0.2, dt=1e-3, control=np.tile(weight, (200, 1)))
    assert np.abs(traj.q - q0).max() < 1e-12


def test_effort_is_limited():
    """Far from its target a servo pushes with what it has: constant acceleration."""
    scene = arm_scene(1, gravity=False)
    scene.set_servo("j1", 1e3, 0.0, effort=0.5)
    traj = cvi.simulate(scene, duration=0.3, dt=1e-3, target=[10.0])
    inertia = float(scene.core().momentum(np.zeros((1, 1)), np.ones((1, 1)))[0, 0])
    assert traj.q[:, 0] == pytest.approx(0.5 * 0.5 / inertia * traj.t**2, rel=1e-9, abs=1e-12)
    assert traj.work.input[-1] == pytest.approx(0.5 * traj.q[-1, 0], rel=1e-9)
    assert traj.energy - traj.energy[0] == pytest.approx(traj.work.input, abs=1e-9)


def test_the_file_limits_a_servo():
    scene = arm_scene(1, gravity=False, effort=0.5)
    scene.set_servo("j1", 1e3, 0.0)
    assert scene.built().arrays.servo[2, 0] == 0.5
    scene.set_servo("j1", 1e3, 0.0, effort=float("inf"))
    assert scene.built().arrays.servo[2, 0] == float("inf")


def test_actuators_limit_what_is_put_in():
    plain, limited = arm_scene(1, gravity=False), arm_scene(1, gravity=False)
    limited.set_actuator("j1", effort=0.5)
    a = cvi.simulate(plain, duration=0.2, dt=1e-3, control=np.full((200, 1), 0.5))
    b = cvi.simulate(limited, duration=0.2, dt=1e-3, control=np.full((200, 1), 7.0))
    assert np.array_equal(a.q, b.q)
    limited.set_actuator("j1", velocity=1.0)
    c = cvi.simulate(limited, duration=2.0, dt=1e-3, control=np.full((2000, 1), 0.5))
    assert c.v.max() < 1.0 + 2e-2  # the limit is looked at once per step
    assert c.v[-1, 0] > 0.98


def test_servos_of_a_part_leave_its_free_base_out():
    scene = cvi.Scene()
    robot = scene.add_urdf(HAND_URDF, base="free", limits=False)
    ball = scene.add_sphere("ball", 0.1)
    for selector in (robot, "*", robot.name):
        scene.set_servo(selector, kp=0.0, kd=0.0)
        assert scene.servo_joints == []
        scene.set_servo(selector, kp=5.0, kd=0.1)
        scene.set_actuator(selector, effort=2.0)
        assert set(scene.servo_joints) == {f"joint_{k}.0" for k in range(16)}
        assert np.isfinite(scene.built().arrays.actuator[0]).sum() == 16
    for selector in ("root_joint", ball):
        with pytest.raises(cvi.InputError, match="expected a joint with one degree of freedom, got a free joint"):
            scene.set_servo(selector, kp=5.0, kd=0.1)
        with pytest.raises(cvi.InputError, match="expected a joint with one degree of freedom, got a free joint"):
            scene.set_actuator(selector, effort=2.0)


def test_stiff_servos_on_a_hand():
    """The hand with the damping of its file, 3 to 10 N m s/rad on links of 1e-5 kg m^2, and PD, at 1 ms."""
    scene = cvi.Scene()
    scene.add_urdf("example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf")
    scene.set_servo("joint_*", 50.0, 1.0)
    q0 = scene.neutral()
    traj = cvi.simulate(scene, q0, duration=0.2, dt=1e-3, target=q0 + 0.1)
    assert traj.status.ok
    assert np.abs(traj.q[-1] - q0).max() < 0.11
    assert np.abs(traj.v).max() < 10.0


@pytest.mark.parametrize("order", [2, 6])
def test_a_wheel_goes_the_shorter_way(order):
    """A continuous joint, q = (cos, sin): as a revolute one with the target a turn away; a velocity alone as well."""
    scenes = wheel_scenes()
    for scene in scenes:
        scene.set_servo("wheel", kp=20.0, kd=0.8, effort=1.5)
    wheel, hinge = (
        cvi.simulate(scene, q, duration=1.0, dt=1e-3, order=order, target=[goal])
        for scene, q, goal in ((scenes[0], [np.cos(3.0), np.sin(3.0)], -3.0), (scenes[1], [3.0], 2 * np.pi - 3.0))
    )
    turned = np.unwrap(np.arctan2(wheel.q[:, 1], wheel.q[:, 0]))
    assert turned == pytest.approx(hinge.q[:, 0], abs=1e-11)
    scenes[0].set_servo("wheel", kp=0.0, kd=2.0)
    spun = cvi.simulate(scenes[0], [1.0, 0.0], duration=2.0, dt=1e-3, order=order, target=[0.0, 40.0])
    assert spun.v[-1, 0] == pytest.approx(40.0, rel=1e-9)
