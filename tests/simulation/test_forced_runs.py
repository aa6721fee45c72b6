"""Runs with springs, wrenches, functions of the user: closed forms, one law given in two ways, named errors."""

from __future__ import annotations

import gc
import math
import weakref

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.loop_scenes import BAR, arm_scene

EPS = np.finfo(float).eps


def ball_scene(gravity: float = 9.81, **options) -> cvi.Scene:
    scene = cvi.Scene((0.0, 0.0, -gravity))
    scene.add_sphere("ball", 0.1, mass=2.0, placement=(0, 0, 1), **options)
    return scene


# -- bad input --------------------------------------------------------------------------------------------------------


def failing(*arguments):
    raise ZeroDivisionError("mine")


@pytest.mark.parametrize(
    ("add", "name"),
    [
        (lambda s, f: s.add_force(lambda t, q, v: f(t) if t > 0.01 else np.zeros(6), name="wind"), "'wind'"),
        (lambda s, f: s.add_wrench("ball", lambda t: f(t) if t > 0.01 else np.zeros(3), name="push"), "push"),
        (
            lambda s, f: s.add_potential(
                lambda q: 0.0, lambda q: f(0.0) if q[2] < 0.999 else np.zeros(6), name="hill", check=False
            ),
            "gradient of 'hill'",
        ),
    ],
)
@pytest.mark.parametrize(
    ("function", "text"),
    [
        (failing, "ZeroDivisionError: mine"),
        (lambda t: np.full(6, math.nan), "not finite"),
        (lambda t: np.zeros(5), "wrong shape"),
        (lambda t: "x", "wrong shape"),
    ],
)
@pytest.mark.parametrize("throw", [True, False])
def test_functions_that_fail_end_the_run_by_name(add, name, function, text, throw):
    scene = ball_scene()
    add(scene, function if "push" not in name or text != "not finite" else lambda t: np.full(3, math.nan))
    with pytest.raises(cvi.UserFunctionError) as caught:
        cvi.simulate(scene, duration=0.1, dt=1e-3, throw=throw)
    assert name in str(caught.value)
    assert text in str(caught.value)
    if "hill" not in name:
        assert 0.01 < caught.value.time < 0.02
        assert f"at t = {caught.value.time:.9g} s" in str(caught.value)


def test_ctrl_c_in_a_function_interrupts_the_run():
    scene, calls = ball_scene(), []

    def force(t, q, v):
        calls.append(t)
        if len(calls) > 50:
            raise KeyboardInterrupt
        return np.zeros(6)

    scene.add_force(force)
    traj = cvi.simulate(scene, duration=1.0, dt=1e-3, throw=False)
    assert traj.status.code == cvi.StatusCode.INTERRUPTED
    assert 10 < len(traj) < 100


def test_the_control_is_named_with_the_time():
    def control(t, q, v):
        return np.zeros(6) if t < 0.0055 else np.full(6, math.nan)

    with pytest.raises(cvi.UserFunctionError, match=r"control .*at t = 0.006 s.*tau is not finite") as caught:
        cvi.simulate(ball_scene(), duration=0.1, dt=1e-3, control=control)
    assert caught.value.time == pytest.approx(0.006)


def test_dt_auto_is_refused_where_the_step_matters():
    scene = ball_scene()
    with pytest.raises(cvi.InputError, match="a time in seconds with control"):
        cvi.simulate(scene, duration=0.1, dt="auto", control=np.zeros(6))
    assert cvi.simulate(scene, duration=0.1, control=np.zeros(6)).options.dt == 1e-3
    scene.add_force(lambda t, q, v: np.zeros(6))
    with pytest.raises(cvi.InputError, match="energy_rise"):
        cvi.simulate(scene, duration=0.1, dt=1e-3, ledger={"energy_rise": 1e-9})
    with pytest.raises(cvi.InputError, match="conservative"):
        cvi.simulate(scene, duration=0.1, dt=1e-3, impact="mhc", mhc_reference="global")


# -- closed forms ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 4, 16])
def test_a_constant_force_is_a_parabola(order):
    scene = ball_scene()
    scene.add_wrench("ball", (1.0, 0.0, 2.0 * 9.81 - 4.0))
    traj = cvi.simulate(scene, duration=1.0, dt=0.05, order=order)
    t = traj.t
    wanted = np.column_stack([0.25 * t**2, 0 * t, 1.0 - t**2])
    assert traj.q[:, :3] == pytest.approx(wanted, abs=1e-13)


def test_a_force_off_the_centre_turns_the_body():
    """A force at a point of the body is that force at the centre and its moment."""
    one, two = ball_scene(0.0), ball_scene(0.0)
    one.add_wrench("ball", (0.0, 0.3, 0.0), point=(0.1, 0.0, 0.0), axes="body")
    two.add_wrench("ball", (0.0, 0.3, 0.0), (0.0, 0.0, 0.03), axes="body")
    a, b = (cvi.simulate(scene, duration=1.0, dt=1e-2) for scene in (one, two))
    assert a.q == pytest.approx(b.q, abs=1e-12)
    inertia = 0.4 * 2.0 * 0.1**2
    assert a.v[-1, 5] == pytest.approx(0.03 / inertia, rel=1e-12)


def test_a_wrench_in_time():
    scene = ball_scene(0.0)
    scene.add_wrench("ball", lambda t: (2.0 * math.cos(3.0 * t), 0.0, 0.0))
    errors = []
    for dt in (0.02, 0.01):
        traj = cvi.simulate(scene, duration=1.0, dt=dt)
        errors.append(abs(traj.q[-1, 0] - (1.0 - math.cos(3.0)) / 9.0))
    assert 3.8 < errors[0] / errors[1] < 4.2  # order 2


@pytest.mark.parametrize("order", [2, 4])
def test_two_balls_on_a_spring(order):
    scene = cvi.Scene((0, 0, 0))
    for k in range(2):
        scene.add_sphere(f"b{k}", 0.05, mass=1.0 + k, placement=(0.8 * k, 0, 0))
    scene.add_spring("b0", "b1", 50.0, rest_length=0.6)
    reduced = 2.0 / 3.0
    omega = math.sqrt(50.0 / reduced)
    errors = []
    for dt in (0.02, 0.01):
        traj = cvi.simulate(scene, duration=1.0, dt=dt, order=order)
        length = traj.q[:, 7] - traj.q[:, 0]
        errors.append(np.abs(length - 0.6 - 0.2 * np.cos(omega * traj.t)).max())
        assert traj.energy[0] == pytest.approx(0.5 * 50.0 * 0.2**2, rel=1e-14)
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.2)


def test_a_damper_takes_what_it_takes():
    """Along the line of two bodies c dl/dt: the relative speed falls with exp(-c t / m)."""
    scene = cvi.Scene((0, 0, 0))
    for k in range(2):
        scene.add_sphere(f"b{k}", 0.05, mass=1.0, placement=(0.8 * k, 0, 0))
    scene.add_spring("b0", "b1", 0.0, damping=0.5)
    v0 = scene.velocity({"b1": (1.0, 0, 0)})
    traj = cvi.simulate(scene, v0=v0, duration=1.0, dt=1e-3)
    assert traj.v[:, 6] - traj.v[:, 0] == pytest.approx(np.exp(-1.0 * traj.t), abs=1e-6)


def test_a_rope_only_pulls():
    scene = ball_scene()
    scene.add_spring("world", "ball", 1e3, rest_length=0.5, tension_only=True, point_a=(0, 0, 1.0))
    traj = cvi.simulate(scene, duration=0.3, dt=1e-3)
    assert traj.q[:, 2] == pytest.approx(1.0 - 0.5 * 9.81 * traj.t**2, abs=1e-12)  # it falls freely until it is taut
    later = cvi.simulate(scene, duration=2.0, dt=1e-3)
    assert later.q[:, 2].min() > 0.2
    assert later.energy == pytest.approx(np.full(len(later), later.energy[0]), abs=0.02)


def test_a_tape_is_as_long_as_its_line():
    """Over a pulley at the top a tape is a spring on the sum of both lengths."""
    scene = cvi.Scene()
    for k, x in enumerate((-0.5, 0.5)):
        scene.add_sphere(f"b{k}", 0.05, mass=1.0, placement=(x, 0, 0))
    scene.add_tape_spring(
        [("b0", (0, 0, 0)), ("world", (-0.5, 0, 1)), ("world", (0.5, 0, 1)), ("b1", (0, 0, 0))], 100.0
    )
    q = scene.configuration({"b0": (-0.5, 0, -0.2), "b1": (0.5, 0, 0.1)})
    stretch = 0.2 - 0.1
    energy = scene.core().energy(q[None], np.zeros((1, 12)))[0, 1]
    assert energy == pytest.approx(9.81 * (-0.2 + 0.1) + 50.0 * stretch**2, abs=1e-13)


# -- one law given in two ways ----------------------------------------------------------------------------------------


def start(scene: cvi.Scene) -> np.ndarray:
    return scene.configuration({"j1": 0.4, "j2": -0.7})


def test_nonlinear_spring_is_the_linear_one_and_a_potential():
    linear, series, user, cubic = (arm_scene(2) for _ in range(4))
    linear.set_joint("j1", stiffness=7.0, rest=0.2)
    series.set_joint("j1", spring=[7.0], rest=0.2)
    user.add_potential(
        lambda q: 3.5 * (q[0] - 0.2) ** 2,
        lambda q: np.array([7.0 * (q[0] - 0.2), 0.0]),
        lambda q: np.diag([7.0, 0.0]),
    )
    a, b, c = (cvi.simulate(s, start(s), duration=0.5, dt=1e-3) for s in (linear, series, user))
    assert b.q == pytest.approx(a.q, abs=1e-11)
    assert c.q == pytest.approx(a.q, abs=1e-11)
    assert c.energy == pytest.approx(a.energy, abs=1e-11)
    cubic.set_joint("j1", spring=[0.0, 1.0, 4.0], rest=0.2)
    x = start(cubic)[0] - 0.2
    potential = cubic.core().energy(start(cubic)[None], np.zeros((1, 2)))[0, 1]
    plain = arm_scene(2).core().energy(start(cubic)[None], np.zeros((1, 2)))[0, 1]
    assert potential - plain == pytest.approx(x**3 / 3.0 + x**4, rel=1e-12)


def test_user_force_is_damping():
    damped, user = arm_scene(2), arm_scene(2)
    damped.set_joint("j*", damping=0.3)
    user.add_force(lambda t, q, v: -0.3 * v, lambda t, q, v: (np.zeros((2, 2)), -0.3 * np.eye(2)))
    a, b = (cvi.simulate(s, start(s), duration=0.5, dt=1e-3) for s in (damped, user))
    assert b.q == pytest.approx(a.q, abs=1e-10)


def test_user_force_is_control():
    """A force that is constant over each step is a control."""
    user = arm_scene(2)
    user.add_force(lambda t, q, v: np.array([0.3, -0.2]))
    plain = arm_scene(2)
    a = cvi.simulate(user, start(user), duration=0.5, dt=1e-3)
    b = cvi.simulate(plain, start(plain), duration=0.5, dt=1e-3, control=np.tile([0.3, -0.2], (500, 1)))
    assert a.q == pytest.approx(b.q, abs=1e-12)


def test_stiff_springs_run():
    """1e5 N/m on half a kilogram at 1 ms: a natural frequency of 71 Hz, and a damper of 1e3 N s/m."""
    scene = arm_scene(2)
    scene.add_spring("world", "j2", 1e5, damping=1e3, point_a=(2 * BAR, 0, 0.1), point_b=(BAR, 0, 0), rest_length=0.1)
    traj = cvi.simulate(scene, duration=1.0, dt=1e-3)
    assert traj.status.ok
    assert np.all(np.diff(traj.energy[500:]) < 1e-9)


def test_potentials_enter_the_modified_energy():
    """It varies by O(h^4) where the energy varies by O(h^2)."""
    scene = arm_scene(2)
    scene.add_spring("world", "j2", 40.0, point_a=(0, 0, 0.6), point_b=(BAR, 0, 0), rest_length=0.2)
    scene.set_joint("j1", spring=[1.0, 2.0])
    spread = {}
    for dt in (0.004, 0.002):
        traj = cvi.simulate(scene, start(scene), duration=0.4, dt=dt)
        spread[dt] = np.ptp(traj.energy), np.ptp(traj.modified_energy)
    assert math.log2(spread[0.004][0] / spread[0.002][0]) == pytest.approx(2.0, abs=0.1)
    assert math.log2(spread[0.004][1] / spread[0.002][1]) == pytest.approx(4.0, abs=0.3)


def test_auto_with_springs():
    scene = arm_scene(2)
    scene.add_spring("world", "j2", 40.0, point_a=(0, 0, 0.6), point_b=(BAR, 0, 0), rest_length=0.2)
    traj = cvi.simulate(scene, start(scene), duration=1.0, tol=1e-9)
    fine = cvi.simulate(scene, start(scene), duration=1.0, dt=1e-3, order=8)
    assert traj.error_estimate < 1e-9
    assert traj.q[-1] == pytest.approx(fine.q[-1], abs=1e-8)


def test_gravity_is_that_of_the_scene():
    scene = cvi.Scene((1.0, 0.0, -3.0))
    scene.add_sphere("ball", 0.1, placement=(0, 0, 1))
    traj = cvi.simulate(scene, duration=0.5, dt=1e-2)
    assert traj.q[-1, :3] == pytest.approx([0.125, 0.0, 1.0 - 0.375], abs=1e-13)


def test_the_tangent_of_free_bodies():
    """A potential of the body's own axis: the gradient is in the body's axes, where v is; the body swings about it."""
    scene = cvi.Scene((0, 0, 0))
    scene.add_box("box", (0.2, 0.1, 0.3), placement=((0, 0, 0), (0.4, 0.2, 0.1)))

    def up(q):
        return pin.XYZQUATToSE3(q).rotation[2]  # the world's z in the body's axes

    def gradient(q):
        return np.concatenate([np.zeros(3), -0.3 * np.cross([0.0, 0.0, 1.0], up(q))])

    scene.add_potential(lambda q: -0.3 * up(q)[2], gradient)
    traj = cvi.simulate(scene, duration=2.0, dt=1e-2, order=8)
    assert np.ptp(traj.potential_energy) > 0.01
    assert np.ptp(traj.energy) < 1e-12


def test_a_prescribed_motion_bears_the_friction_of_what_it_drags():
    """Friction of the driven joint, and of a ball that is dragged without turning: both are in the reaction."""
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    lift = model.addJoint(slide, pin.JointModelPZ(), pin.SE3.Identity(), "lift")
    model.appendBodyToJoint(lift, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    for name in ("lowerPositionLimit", "upperPositionLimit"):
        getattr(model, name)[:] = -np.inf if "lower" in name else np.inf
    shapes = pin.GeometryModel()
    shapes.addGeometryObject(pin.GeometryObject("ball", lift, pin.SE3.Identity(), coal.Sphere(0.1)))
    scene = cvi.Scene.from_pinocchio(model, shapes)
    scene.add_halfspace(offset=-0.1)
    scene.set_contact(restitution=0.0, friction=0.4)
    scene.set_joint("slide", friction=1.5)
    scene.prescribe("slide", lambda t: (t, 1.0, 0.0), name="motion")
    traj = cvi.simulate(scene, duration=0.1, dt=1e-3)
    assert traj.reactions("motion")[5:, 0] == pytest.approx(0.4 * 9.81 + 1.5, abs=1e-9)
    assert traj.work.joint_friction[-1] == pytest.approx(1.5 * 0.1, abs=1e-9)
    assert np.abs(traj.ledger.energy_balance).max() < 1e-9
    assert traj.ledger.constraint_residual.max() <= 1e-12


def test_a_scene_that_its_own_functions_hold_is_freed():
    """The scene keeps what its runs need, the engine keeps the functions, and these keep the scene: a cycle."""

    def run() -> weakref.ref:
        scene = ball_scene()
        scene.add_force(lambda t, q, v: np.zeros(scene.nv))
        cvi.simulate(scene, duration=0.02, dt=0.01)
        return weakref.ref(scene)

    found = run()
    gc.collect()
    assert found() is None
