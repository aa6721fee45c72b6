"""Starts on constraints: assembly, consistent velocities, and the errors of loops that cannot be closed."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.loop_scenes import BAR, arm_scene, four_bar, four_bar_start


def residual(scene: cvi.Scene, q, t: float = 0.0) -> float:
    return float(np.abs(scene.core().constraint_residual(q, t)).max(initial=0.0))


# -- bad input --------------------------------------------------------------------------------------------------------


def test_a_start_off_the_loop_is_named():
    scene = four_bar()
    scene.add_joint_equality("j2", "j1", (0.3, 0.0), name="gear")
    with pytest.raises(cvi.ConstraintError) as caught:
        cvi.simulate(scene, duration=0.1, dt=1e-3)
    error = caught.value
    assert error.constraints == ("loop",)  # neutral() satisfies the gear.
    assert error.residuals["loop"] > 0.5
    assert "scene.assemble(q)" in str(error)
    with pytest.raises(cvi.ConstraintError) as caught:
        cvi.simulate(scene, [0.0, 0.1, 0.0], duration=0.1, dt=1e-3)
    assert caught.value.constraints == ("loop", "gear")
    assert caught.value.residuals["gear"] == pytest.approx(0.2)


def test_an_initial_velocity_across_the_loop_is_named():
    scene = four_bar()
    q = four_bar_start(scene)
    with pytest.raises(cvi.ConstraintError) as caught:
        cvi.Simulator(scene, dt=1e-3).reset(q, [1.0, 0.0, 0.0])
    assert caught.value.constraints == ("loop",)
    assert "scene.consistent_velocity(q, v, t)" in str(caught.value)


def test_a_joint_keeps_its_velocity():
    """The crank turns as it is told; without `fixed` the nearest velocity in the metric of the mass is a slower one."""
    scene = four_bar()
    q = four_bar_start(scene)
    wanted = np.array([6.0, 0.0, 0.0])
    found = scene.consistent_velocity(q, wanted, fixed="j1")
    assert found[0] == 6.0
    J = np.asarray(scene.core().constraint_jacobian(q, 0.0))
    assert np.abs(J @ found).max() < 1e-12 * 6.0
    assert np.allclose(J[:, 1:] @ found[1:], -6.0 * J[:, 0], atol=1e-12)
    assert abs(scene.consistent_velocity(q, wanted)[0] - 6.0) > 0.1
    with pytest.raises(cvi.ConstraintError, match="with 3 degrees of freedom fixed"):
        scene.consistent_velocity(q, wanted, fixed=["j1", "j2", "j3"])


def test_a_loop_that_cannot_be_closed_is_named():
    scene = four_bar(ground=3 * BAR + 0.1)
    with pytest.raises(cvi.ConstraintError) as caught:
        scene.assemble(np.array([0.1, 0.1, 0.1]))
    error = caught.value
    assert error.constraints == ("loop",)
    assert error.residuals["loop"] == pytest.approx(0.1, rel=1e-3)  # The stretched chain is too short by 0.1 m.
    assert "No configuration near the given one" in str(error)


def test_loops_that_contradict_each_other_are_named():
    scene = arm_scene(2)
    scene.prescribe("j1", 0.5, name="a")
    scene.add_joint_equality("j1", None, (0.7,), name="b")
    scene.add_joint_equality("j2", None, (0.2,), name="c")
    with pytest.raises(cvi.ConstraintError) as caught:
        scene.assemble()
    assert set(caught.value.constraints) == {"a", "b"}
    assert list(caught.value.residuals.values()) == pytest.approx([0.1, 0.1], rel=1e-6)


def test_a_motion_that_cannot_be_reached_is_named():
    scene = four_bar()
    scene.prescribe("j1", 2.0, name="crank")
    q = four_bar_start(scene_without := four_bar())
    assert residual(scene_without, q) < 1e-12
    with pytest.raises(cvi.ConstraintError) as caught:
        scene.assemble(q, fixed=["j1", "j2"])
    assert "crank" in caught.value.constraints
    assert "2 degrees of freedom fixed" in str(caught.value)


def test_drives_that_contradict_each_other_have_no_velocity():
    scene = arm_scene(1)
    scene.prescribe("j1", lambda t: t, name="slow")
    scene.prescribe("j1", lambda t: 2.0 * t, name="fast")
    with pytest.raises(cvi.ConstraintError, match="No velocity satisfies") as caught:
        scene.consistent_velocity()
    assert set(caught.value.constraints) == {"slow", "fast"}


@pytest.mark.parametrize("motion", [lambda t: math.nan, lambda t: 1.0 / 0.0, lambda t: "up"])
def test_a_motion_that_fails_is_named(motion):
    scene = arm_scene(1)
    scene.prescribe("j1", motion)
    with pytest.raises(cvi.UserFunctionError, match=r"motion of joint 'j1'.* at t = 0 s"):
        scene.assemble()
    with pytest.raises(cvi.UserFunctionError):
        cvi.Simulator(scene, dt=1e-3).reset()


def test_a_length_below_zero_is_named():
    scene = arm_scene(1)
    scene.add_distance("world", "j1", (0, 0, 0.3), (BAR, 0, 0), length=lambda t: 0.5 - t, name="winch")
    scene.assemble()
    with pytest.raises(cvi.UserFunctionError, match=r"length of 'winch' is not positive at t = 0.6 s"):
        scene.assemble(t=0.6)


def test_wrong_arguments():
    scene = four_bar()
    with pytest.raises(cvi.InputError, match="one configuration"):
        scene.assemble(np.zeros(2))
    with pytest.raises(cvi.InputError, match="Unknown joint"):
        scene.assemble(fixed=["j9"])
    with pytest.raises(cvi.InputError):
        scene.consistent_velocity(v=[1.0])


# -- results ---------------------------------------------------------------------------------------------------------


def test_assembly_closes_the_loop_and_keeps_what_is_fixed():
    scene = four_bar()
    q = four_bar_start(scene)
    assert residual(scene, q) < 1e-12
    assert q[0] == -np.pi / 3
    data = scene.model.createData()
    pin.forwardKinematics(scene.model, data, q)
    assert data.oMi[3].act(np.array([BAR, 0, 0])) == pytest.approx([0.5, 0, 0], abs=1e-12)
    assert scene.assemble(q) == pytest.approx(q, abs=1e-13)  # A closed loop stays where it is.


def test_assembly_is_near():
    """The step of Gauss-Newton is the shortest one, so to first order it is along the gradients."""
    scene = four_bar()
    q = four_bar_start(scene)
    gradients = scene.core().constraint_jacobian(q, 0.0)
    free = np.linalg.svd(gradients)[2][-1]  # the direction in which the loop moves
    across = 1e-4 * (gradients.T @ np.array([1.0, 0.0, 1.0]))
    back = scene.assemble(q + across)
    assert abs((back - q) @ free) < 1e-7  # of second order in the displacement


def test_assembly_leaves_special_places():
    """Stretched along x, no first-order motion of the rods closes the loop."""
    scene = four_bar()
    assert residual(scene, scene.assemble(np.zeros(3))) < 1e-10
    knee = four_bar(ground=0.0)
    assert residual(knee, knee.assemble(np.zeros(3))) < 1e-10


def test_assembly_keeps_limits():
    free = four_bar()
    q = free.assemble(np.array([0.3, -1.5, -0.5]))
    scene = four_bar()
    scene.set_joint("j1", limits=(q[0] + 0.1, q[0] + 0.5))
    found = scene.assemble(np.array([0.3, -1.5, -0.5]))
    assert residual(scene, found) < 1e-10
    assert q[0] + 0.1 <= found[0] <= q[0] + 0.5


def test_redundant_constraints_are_fine():
    scene = four_bar()
    scene.add_point("world", "j3", (0.5, 0.0, 0.0), (BAR, 0.0, 0.0), name="again")
    q = four_bar_start(scene)
    assert residual(scene, q) < 1e-12
    v = scene.consistent_velocity(q, np.array([1.0, 0.0, 0.0]))
    assert np.abs(scene.core().constraint_jacobian(q, 0.0) @ v).max() < 1e-13
    assert np.abs(v).max() > 0.1


def test_free_bodies_are_assembled():
    scene = cvi.Scene()
    for k in range(3):
        scene.add_box(f"b{k}", (0.4, 0.1, 0.1), placement=(0.5 * k, 0.0, 1.0))
    scene.add_weld("world", "b0", ((0.1, 0.2, 1.0), (0.1, 0.2, 0.3)))
    scene.add_point("b0", "b1", (0.2, 0, 0), (-0.2, 0, 0))
    scene.add_screw("b1", "b2", 0.05, ((0.2, 0, 0), (0, 1.2, 0)))
    scene.add_distance("world", "b2", (1.0, 1.0, 1.0), length=1.1)
    q = scene.assemble()
    assert residual(scene, q) < 1e-12


def test_the_velocity_is_the_nearest_in_the_metric_of_the_mass():
    scene = four_bar()
    q = four_bar_start(scene)
    wanted = np.array([1.0, -0.5, 0.3])
    v = scene.consistent_velocity(q, wanted)
    J = scene.core().constraint_jacobian(q, 0.0)
    assert np.abs(J @ v).max() < 1e-13
    mass = pin.crba(scene.model, scene.model.createData(), q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    free = np.linalg.svd(J)[2][-1]  # the loop has one degree of freedom
    assert abs(free @ mass @ (v - wanted)) < 1e-13
    assert scene.consistent_velocity(q) == pytest.approx(np.zeros(3), abs=1e-16)


def test_a_driven_start_takes_the_velocity_that_goes_with_it():
    scene = arm_scene(2)
    scene.prescribe("j1", lambda t: (0.5 * t, 0.5, 0.0))
    assert scene.consistent_velocity()[0] == pytest.approx(0.5, abs=1e-14)
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset()
    assert sim.v[0] == pytest.approx(0.5, abs=1e-13)
    with pytest.raises(cvi.ConstraintError):
        sim.reset(None, [0.0, 0.0])


def check_gradients(scene: cvi.Scene, q: np.ndarray) -> None:
    core, model = scene.core(), scene.model
    J, rate, h = core.constraint_jacobian(q, 0.2), core.constraint_rate(q, 0.2), 1e-6
    for k in range(model.nv):
        w = h * np.eye(model.nv)[k]
        ends = [core.constraint_residual(pin.integrate(model, q, s * w), 0.2) for s in (1, -1)]
        assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(J[:, k], abs=1e-9)  # eps / h
    ends = [core.constraint_residual(q, 0.2 + s * h) for s in (1, -1)]
    assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(rate, abs=1e-9)


def test_derivatives_of_the_residuals():
    """J is the derivative along the tangent of q, phi_t that at fixed q, for all kinds and with free bodies."""
    scene = arm_scene(2)
    scene.add_box("a", (0.4, 0.1, 0.1), placement=((0.5, 0.1, 1.0), (0.1, 0.2, 0.3)))
    scene.add_box("b", (0.4, 0.1, 0.1), placement=((0.1, 0.5, 1.0), (0.3, 0.2, 0.1)))
    scene.add_point("j2", "a", (0.1, 0.2, 0.3), (0.3, 0.2, 0.1))
    scene.add_distance("a", "b", (0.1, 0, 0), (0, 0.1, 0), length=lambda t: 0.5 + 0.1 * math.sin(t))
    scene.add_weld("a", "b", ((0.3, 0.2, 0.1), (0.5, 0.2, 0.1)))
    scene.add_joint_equality("j1", "j2", (0.1, 0.2, 0.3))
    scene.prescribe("j2", lambda t: math.sin(2 * t))
    check_gradients(scene, pin.integrate(scene.model, scene.neutral(), 0.3 * np.sin(np.arange(scene.nv))))


@pytest.mark.parametrize("pitch", [0.0, 0.1, -0.02])
def test_derivatives_of_a_screw(pitch):
    """J of a screw is compared where its axes coincide; elsewhere the angle about a common axis is not defined."""
    scene = cvi.Scene()
    for k, place in enumerate([((0.5, 0.1, 1.0), (0.1, 0.2, 0.3)), ((0.1, 0.5, 1.0), (0.3, 0.2, 0.1))]):
        scene.add_box(f"b{k}", (0.4, 0.1, 0.1), placement=place)
    scene.add_screw("b0", "b1", pitch, ((0.1, 0.2, 0.3), (0.3, 0.2, 0.1)))
    away = pin.integrate(scene.model, scene.neutral(), 0.3 * np.sin(np.arange(scene.nv)))
    check_gradients(scene, scene.assemble(away))


@pytest.mark.parametrize("dt", [1e-3, 1e-2])
def test_a_motion_that_jumps_is_refused(dt):
    """At a node the differences around it show the jump; between nodes no rate leads across it."""
    scene = arm_scene(1)
    scene.prescribe("j1", lambda t: 0.0 if t < 0.255 else 0.3, name="jump")
    with pytest.raises((cvi.UserFunctionError, cvi.ConstraintError, cvi.SimulationError), match="jump"):
        cvi.simulate(scene, duration=0.5, dt=dt)


def test_a_motion_with_a_kink_is_followed():
    scene = arm_scene(1)
    scene.prescribe("j1", lambda t: 0.3 * abs(t - 0.2503), name="kink")
    traj = cvi.simulate(scene, scene.assemble(), duration=0.5, dt=1e-3)
    assert traj.q[-1, 0] == pytest.approx(0.3 * (0.5 - 0.2503), abs=1e-12)
