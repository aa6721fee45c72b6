"""Loops and prescribed motions in steps of orders 4 to 16, and with dt = "auto"."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.verify import systems
from oracles import four_bar as reference
from oracles.momentum_maps import spatial_momentum

BARS = systems.FOUR_BAR
SIZES = {"upper": ((0.1, 0.12, 0.6), 1.0), "lower": ((0.1, 0.08, 0.5), 0.7)}


def four_bar_start(scene: cvi.Scene, crank: float = 0.3, rate: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    q = systems.four_bar_angles(crank)
    v = scene.consistent_velocity(q, [1.0, 0.0, 0.0])
    return q, v * (rate / v[0])


def hung_boxes() -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
    """Two free boxes on points, one below the other: a spherical double pendulum."""
    scene = cvi.Scene()
    for (name, (size, mass)), height in zip(SIZES.items(), (-0.3, -0.85), strict=True):
        scene.add_box(name, size, mass, placement=(0, 0, height))
    scene.disable_pair("upper", "lower")
    scene.add_point("world", "upper", (0, 0, 0), (0, 0, 0.3), name="top")
    scene.add_point("upper", "lower", (0, 0, -0.3), (0, 0, 0.25), name="middle")
    q, spins = scene.configuration({}), np.zeros(12)
    spins[3:6], spins[9:12] = (1.0, 2.0, 0.5), (-1.0, 0.5, 1.0)
    return scene, q, scene.consistent_velocity(q, spins)


def hung_tree() -> cvi.Scene:
    """The same bodies on spherical joints."""
    model, joint, at = pin.Model(), 0, np.zeros(3)
    for (name, (size, mass)), below in zip(SIZES.items(), (0.3, 0.25), strict=True):
        joint = model.addJoint(joint, pin.JointModelSpherical(), pin.SE3(np.eye(3), at), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(mass, *size), pin.SE3(np.eye(3), np.array([0, 0, -below])))
        at = np.array([0.0, 0.0, -0.6])
    return cvi.Scene.from_pinocchio(model)


@pytest.mark.parametrize(("order", "steps"), [(4, (160, 320)), (8, (40, 60)), (12, (20, 30)), (16, (14, 20))])
def test_four_bar_has_the_order(order, steps):
    """Against its motion in one coordinate (oracles/four_bar.py)."""
    scene = systems.four_bar()
    q, v = four_bar_start(scene)
    exact = reference.motion(BARS, 0.3, 2.0, np.array([0.0, 0.5]))[-1, 0]
    errors = []
    for count in steps:
        traj = cvi.simulate(scene, q, v, duration=0.5, dt=0.5 / count, order=order, solver_tol=1e-14)
        errors.append(abs(traj.q[-1, 0] - exact))
        assert np.abs(traj.ledger.constraint_residual).max() < 1e-13
    seen = np.log(errors[0] / errors[1]) / np.log(steps[1] / steps[0])
    assert seen > order - 0.3 or errors[1] < 1e-12
    assert errors[1] < 1e-6


@pytest.mark.parametrize(("order", "steps"), [(4, (40, 80)), (8, (10, 20)), (12, (5, 8))])
def test_spherical_double_pendulum_has_the_order(order, steps):
    """Free bodies held by points move as bodies on spherical joints do."""
    scene, q, v = hung_boxes()
    tree = hung_tree()
    spins = np.concatenate([v[3:6], v[9:12] - v[3:6]])
    fine = cvi.simulate(tree, tree.neutral(), spins, duration=0.5, dt=2.5e-3, order=16, solver_tol=1e-14)
    turn = pin.Quaternion(*fine.q[-1, [3, 0, 1, 2]]).matrix() @ pin.Quaternion(*fine.q[-1, [7, 4, 5, 6]]).matrix()
    upper = pin.Quaternion(*fine.q[-1, [3, 0, 1, 2]]).matrix()
    place = upper @ (0, 0, -0.6) + turn @ (0, 0, -0.25)
    errors = []
    for count in steps:
        traj = cvi.simulate(scene, q, v, duration=0.5, dt=0.5 / count, order=order, solver_tol=1e-14)
        errors.append(np.abs(traj.q[-1, 7:10] - place).max())
    assert np.log(errors[0] / errors[1]) / np.log(steps[1] / steps[0]) > order - 0.3 or errors[1] < 1e-12
    assert errors[1] < 1e-6


def geared_four_bars(ahead: float = 0.0) -> cvi.Scene:
    """Two four-bars whose cranks are coupled one to one, the second one by an angle [rad] ahead of the first."""
    model, bars = systems.empty_model(systems.GRAVITY), BARS[:3]
    for side in "ab":
        joint, at = 0, 0.0
        for k, length in enumerate(bars):
            joint = model.addJoint(joint, systems.hinge(), systems.place(at), f"{side}{k}")
            inertia = pin.Inertia(length, np.array([0.5 * length, 0.0, 0.0]), length**3 / 12.0 * np.eye(3))
            model.appendBodyToJoint(joint, inertia, systems.place())
            at = length
    scene = cvi.Scene.from_pinocchio(model)
    for side in "ab":
        scene.add_point("world", f"{side}2", (BARS[3], 0.0, 0.0), (BARS[2], 0.0, 0.0))
    scene.add_joint_equality("b0", "a0", (ahead, 1.0), name="gear")
    return scene


@pytest.mark.parametrize("order", [4, 8, 16])
def test_loops_of_coupled_joints(order):
    """Two equal four-bars with one crank move as one of them does."""
    both, one = geared_four_bars(), systems.four_bar()
    q, v = four_bar_start(one)
    alone = cvi.simulate(one, q, v, duration=0.5, dt=0.02, order=order, solver_tol=1e-14)
    geared = cvi.simulate(both, np.tile(q, 2), np.tile(v, 2), duration=0.5, dt=0.02, order=order, solver_tol=1e-14)
    assert geared.q[:, :3] == pytest.approx(alone.q, abs=1e-12)
    assert geared.q[:, 3:] == pytest.approx(alone.q, abs=1e-12)


@pytest.mark.parametrize(("order", "dt"), [(4, 0.005), (8, 0.01)])
def test_reaction_of_a_gear_between_loops(order, dt):
    """What the loops do to the joint that follows is part of the reaction: against Newton's law in one coordinate."""
    ahead, scene = 0.7, geared_four_bars(0.7)
    q = np.concatenate([systems.four_bar_angles(0.3), systems.four_bar_angles(0.3 + ahead)])
    v = scene.consistent_velocity(q, np.eye(6)[0])
    v *= 2.0 / v[0]
    traj = cvi.simulate(scene, q, v, duration=0.5, dt=dt, order=order, solver_tol=1e-14)
    exact = reference.geared(BARS, 0.3, ahead, 2.0, traj.t)
    assert traj.q[:, 0] == pytest.approx(exact[:, 0], abs=1e-7)
    mean = np.diff(exact[:, 1]) / np.diff(traj.t)
    assert traj.reactions("gear")[1:, 0] == pytest.approx(mean, abs=1e-5 * np.abs(mean).max())


@pytest.mark.parametrize("tol", [1e-4, 1e-6, 1e-8, 1e-10])
def test_auto_meets_the_accuracy(tol):
    scene = systems.four_bar()
    q, v = four_bar_start(scene)
    traj = cvi.simulate(scene, q, v, duration=1.0, tol=tol)
    assert traj.options.auto
    exact = reference.motion(BARS, 0.3, 2.0, traj.t)[:, 0]
    error = np.abs(traj.q[:, 0] - exact).max()
    assert error <= 3.0 * traj.error_estimate
    assert traj.error_estimate <= tol


def test_auto_with_a_motion():
    """The driven slider-crank: its place in closed form, over a second of few steps."""
    scene = systems.slider_crank((0.1, 0.3), (1.0, 2.0, 3.0), 10.0)
    q = np.array([0.0, 0.0, 0.4])
    traj = cvi.simulate(scene, q, scene.consistent_velocity(q), duration=1.0, tol=1e-8)
    phi = 10.0 * traj.t
    place = 0.1 * np.cos(phi) + np.sqrt(0.3**2 - (0.1 * np.sin(phi)) ** 2)
    assert traj.q[:, 2] == pytest.approx(place, abs=1e-8)
    assert len(traj.t) < 200
    assert np.abs(traj.ledger.energy_balance).max() < 1e-7  # the work of the motion is what the energy has gained


def free_chain() -> cvi.Scene:
    """Three free bodies on two points."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    for k in range(3):
        scene.add_box(f"bar_{k}", (0.4, 0.1, 0.05), 1.0 + 0.5 * k, placement=(0.45 * k, 0, 0))
    for k in range(2):
        scene.disable_pair(f"bar_{k}", f"bar_{k + 1}")
        scene.add_point(f"bar_{k}", f"bar_{k + 1}", (0.225, 0, 0), (-0.225, 0, 0))
    return scene


def free_ring() -> cvi.Scene:
    """A free body with two arms of two links on spherical joints, whose hands are joined: a closed loop in flight."""
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia.FromBox(3.0, 0.4, 0.3, 0.2), pin.SE3.Identity())
    for side, name in ((1.0, "left"), (-1.0, "right")):
        shoulder = pin.SE3(np.eye(3), np.array([0.0, 0.2 * side, 0.0]))
        upper = model.addJoint(base, pin.JointModelSpherical(), shoulder, f"{name}_upper")
        turned = pin.SE3(pin.exp3(np.array([0.0, 0.0, -side * np.arccos(-0.5)])), np.array([0.3, 0.1 * side, 0.0]))
        lower = model.addJoint(upper, pin.JointModelSpherical(), turned, f"{name}_lower")
        middle = pin.SE3(np.eye(3), np.array([0.15, 0.0, 0.0]))
        model.appendBodyToJoint(upper, pin.Inertia.FromBox(1.0, 0.3, 0.08, 0.06), middle)
        model.appendBodyToJoint(lower, pin.Inertia.FromBox(0.6, 0.3, 0.06, 0.05), middle)
    model.gravity.linear = np.zeros(3)
    scene = cvi.Scene.from_pinocchio(model)
    scene.add_point("left_lower", "right_lower", (0.3, 0.0, 0.0), (0.3, 0.0, 0.0))
    return scene


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("order", "dt"), [(4, 0.005), (8, 0.01), (16, 0.02)])
@pytest.mark.parametrize("make", [free_chain, free_ring])
def test_momentum_of_a_free_linkage(make, order, dt):
    """Loops in flight without gravity, 2000 steps: the momentum about the origin stays, also at order 4."""
    scene = make()
    q = scene.assemble(scene.neutral()) if make is free_ring else scene.configuration({})
    rng = np.random.default_rng(3)
    v = scene.consistent_velocity(q, rng.standard_normal(scene.nv))
    # The centre of mass at rest: far from the origin the rounding of places would be that of the momentum.
    drift = pin.jacobianCenterOfMass(scene.model, scene.model.createData(), q) @ v
    for joint in scene.model.joints:
        if joint.shortname() == "JointModelFreeFlyer":  # all stand upright
            v[joint.idx_v : joint.idx_v + 3] -= drift
    traj = cvi.simulate(
        scene, q, v, duration=2000 * dt, dt=dt, order=order, solver_tol=1e-14, record_every=10, dense=False
    )
    sums = np.array([spatial_momentum(scene.model, row, p) for row, p in zip(traj.q, traj.p, strict=True)])
    # rounding and the tolerance of the steps, of some N m s
    assert np.abs(sums - sums[0]).max() < 1e-12


def energy_over(steps: int) -> np.ndarray:
    scene = systems.four_bar()
    q, v = four_bar_start(scene)
    traj = cvi.simulate(scene, q, v, duration=0.02 * steps, dt=0.02, order=6, record_every=10, dense=False)
    return np.asarray(traj.energy)


def test_energy_stays_flat():
    energy = energy_over(10_000)
    early, late = np.ptp(energy[:100]), np.ptp(energy[-100:])
    assert late < 2.0 * early
    assert abs(energy[-100:].mean() - energy[:100].mean()) < early


@pytest.mark.slow
def test_energy_stays_flat_over_1e5_steps():
    energy = energy_over(100_000)
    assert abs(energy[-100:].mean() - energy[:100].mean()) < np.ptp(energy[:100])


@pytest.mark.parametrize("impact", ["ctec", "dtec", "mhc"])
def test_impacts_on_a_loop(impact):
    """An elastic stop: the map's order is that of the steps, and all maps come to the same motion."""
    scene = systems.four_bar(stop=0.55)
    q = systems.four_bar_angles(0.4)
    v = scene.consistent_velocity(q, [5.0, -5.0, 0.0])
    fine = cvi.simulate(scene, q, v, duration=0.8, dt=0.01, order=16, solver_tol=1e-14)
    assert len(fine.events) == 1
    errors = []
    for count in (40, 80):
        traj = cvi.simulate(scene, q, v, duration=0.8, dt=0.8 / count, order=4, impact=impact)
        assert len(traj.events) == 1
        errors.append(np.abs(traj.q[-1] - fine.q[-1]).max())
    assert errors[1] < errors[0] / 8.0
    close = cvi.simulate(scene, q, v, duration=0.8, dt=0.01, order=8, impact=impact, solver_tol=1e-14)
    assert np.abs(close.q[-1] - fine.q[-1]).max() < 1e-9


def test_a_loop_closed_three_times():
    """Redundant rows: the same motion, and each of the three bears a third."""
    scene = systems.four_bar()
    q, v = four_bar_start(scene)
    once = cvi.simulate(scene, q, v, duration=0.3, dt=0.02, order=8)
    for name in ("second", "third"):
        scene.add_point("world", "bar_3", (BARS[3], 0.0, 0.0), (BARS[2], 0.0, 0.0), name=name)
    thrice = cvi.simulate(scene, q, v, duration=0.3, dt=0.02, order=8)
    assert thrice.q == pytest.approx(once.q, abs=1e-10)
    for name in ("loop", "second", "third"):
        assert 3.0 * thrice.reactions(name)[1:] == pytest.approx(once.reactions("loop")[1:], abs=1e-6)


def test_what_cannot_be_met_is_named():
    """A crank that is driven past where its rocker can follow."""
    scene = systems.four_bar()
    scene.prescribe("bar_3", lambda t: (systems.four_bar_angles(0.3)[2] + 4.0 * t, 4.0, 0.0), name="drive")
    q = systems.four_bar_angles(0.3)
    traj = cvi.simulate(
        scene, q, scene.consistent_velocity(q), duration=2.0, dt=0.01, order=8, throw=False, contact_mode="events"
    )
    assert traj.status.code.name == "CONSTRAINT"
    assert "drive" in str(traj.status) or "loop" in str(traj.status)


def test_states_between_the_nodes_are_on_the_loop():
    scene = systems.four_bar()
    q, v = four_bar_start(scene)
    traj = cvi.simulate(scene, q, v, duration=0.5, dt=0.05, order=8)
    exact = reference.motion(BARS, 0.3, 2.0, np.array([0.0, 0.123, 0.337]))[1:, 0]
    for time, phi in zip((0.123, 0.337), exact, strict=True):
        assert traj.at(time).q[0] == pytest.approx(phi, abs=1e-6)


def test_a_run_goes_on_with_the_same_digits():
    scene = systems.four_bar()
    whole = cvi.Simulator(scene, dt=0.01, order=8)
    whole.reset(*four_bar_start(scene))
    for _ in range(20):
        whole.step()
    other = cvi.Simulator.of(whole.save())
    for _ in range(20):
        whole.step()
        other.step()
    assert np.array_equal(whole.q, other.q)
    assert np.array_equal(whole.reaction("loop"), other.reaction("loop"))
