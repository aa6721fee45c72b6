"""Runs with constraints in the Python API: residuals, reactions, works, files; prescribed joints and mimic tags."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.loop_scenes import BAR, arm_scene, four_bar, four_bar_start, urdf
from helpers.violent_scenes import driven_wall

PHI = 1e-10  # [m, rad] what every node has to satisfy


def residuals(traj: cvi.Trajectory) -> float:
    core = traj.scene.core()
    return max(float(np.abs(core.constraint_residual(q, t)).max()) for t, q in zip(traj.t, traj.q, strict=True))


def crank(t: float) -> tuple[float, float, float]:
    return 0.3 * math.sin(2 * t), 0.6 * math.cos(2 * t), -1.2 * math.sin(2 * t)


# -- loops ------------------------------------------------------------------------------------------------------------


def test_a_four_bar_keeps_its_loop_and_its_energy():
    scene = four_bar()
    q = four_bar_start(scene)
    spread = []
    for dt in (4e-3, 2e-3):
        traj = cvi.simulate(scene, q, duration=2.0, dt=dt)
        assert residuals(traj) <= PHI
        J = scene.core().constraint_jacobian(traj.q[-1], 2.0)
        assert np.abs(J @ traj.v[-1]).max() <= 1e-8
        spread.append(np.abs(traj.energy - traj.energy[0]).max())
    assert math.log2(spread[0] / spread[1]) == pytest.approx(2.0, abs=0.3)


def test_order_two_against_a_fine_run():
    scene = four_bar()
    q = four_bar_start(scene)
    fine = cvi.simulate(scene, q, duration=0.5, dt=1.25e-4).q[-1]
    errors = [np.abs(cvi.simulate(scene, q, duration=0.5, dt=dt).q[-1] - fine).max() for dt in (4e-3, 2e-3)]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_reactions_carry_the_weight():
    """A linkage at rest: the wall carries what the first joint does not; a weld on a free body carries all of it."""
    scene = cvi.Scene()
    scene.add_box("box", (0.2, 0.1, 0.1), mass=3.0, placement=(0.5, 0, 1))
    scene.add_weld("world", "box", name="weld")
    traj = cvi.simulate(scene, duration=0.05, dt=1e-3)
    assert [tuple(row) for row in traj.constraints] == [("weld", "weld", 6)]
    force = traj.reactions("weld")
    assert force.shape == (51, 6)
    assert not force[0].any()
    assert force[1:, :3] == pytest.approx(np.tile([0, 0, 3.0 * 9.81], (50, 1)), abs=1e-7)
    with pytest.raises(cvi.InputError, match="Did you mean 'weld'"):
        traj.reactions("wled")


def test_a_distance_is_a_pendulum():
    """A point mass on a rod: the period of a pendulum, the pull of the rod (negative) at the lowest point."""
    scene = cvi.Scene()
    scene.add_sphere("bob", 1e-3, mass=1.0, placement=(1.0, 0, 0))
    scene.add_distance("world", "bob", name="rod")
    traj = cvi.simulate(scene, duration=2.0, dt=1e-3)
    assert residuals(traj) <= PHI
    lowest = np.argmin(traj.q[:1000, 2])
    assert traj.q[lowest, :3] == pytest.approx([0, 0, -1], abs=5e-3)
    assert traj.reactions("rod")[lowest, 0] == pytest.approx(-3.0 * 9.81, rel=1e-3)  # released from the side
    assert traj.work.prescribed == pytest.approx(np.zeros(2001), abs=1e-12)


def test_redundant_loops_run():
    scene = four_bar()
    scene.add_point("world", "j3", (0.5, 0.0, 0.0), (BAR, 0.0, 0.0), name="again")
    q = four_bar_start(scene)
    traj = cvi.simulate(scene, q, duration=0.5, dt=1e-3)
    plain = cvi.simulate(four_bar(), q, duration=0.5, dt=1e-3)
    assert traj.q == pytest.approx(plain.q, abs=1e-9)
    both = traj.reactions("loop") + traj.reactions("again")
    # the plane holds y in both: what is defined is the sum of x and z
    assert both[1:, [0, 2]] == pytest.approx(plain.reactions("loop")[1:, [0, 2]], abs=1e-5)


def test_a_screw_drives_a_nut():
    """A nut free on a screw about z, turned by a torque: m a = F, I alpha = tau - pitch F."""
    scene = cvi.Scene((0, 0, 0))
    scene.add_cylinder("nut", radius=0.1, length=0.1, mass=2.0)
    scene.add_screw("world", "nut", 0.05)
    scene.add_wrench("nut", torque=(0, 0, 0.4))
    traj = cvi.simulate(scene, duration=3.0, dt=1e-2)
    inertia = 0.5 * 2.0 * 0.1**2
    travel = 0.5 * 0.4 / (inertia + 2.0 * 0.05**2) * traj.t**2 * 0.05
    assert traj.q[:, 2] == pytest.approx(travel, abs=1e-8)  # several turns
    assert travel[-1] > 2 * math.pi * 0.05
    assert residuals(traj) <= PHI


# -- prescribed motions -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["function", "rates", "all", "table"])
def test_a_prescribed_joint_is_where_it_should_be(form):
    scene = arm_scene(2)
    times = np.linspace(0.0, 1.0, 101)
    motion = {
        "function": lambda t: crank(t)[0],
        "rates": lambda t: crank(t)[:2],
        "all": crank,
        "table": (times, np.array([crank(t)[0] for t in times])),
    }[form]
    scene.prescribe("j1", motion, name="crank")
    traj = cvi.simulate(scene, duration=1.0, dt=1e-3)
    assert traj.q[:, 0] == pytest.approx([crank(t)[0] for t in traj.t], abs=PHI if form != "table" else 1e-7)
    assert residuals(traj) <= PHI


def test_the_reaction_of_a_prescribed_joint_is_the_torque_of_inverse_dynamics():
    scene = arm_scene(1)
    scene.prescribe("j1", crank, name="crank")
    errors = []
    for dt in (4e-3, 2e-3):
        traj = cvi.simulate(scene, duration=1.0, dt=dt)
        middle = 0.5 * (traj.t[1:] + traj.t[:-1])
        data = scene.model.createData()
        exact = [float(pin.rnea(scene.model, data, *(np.array([x]) for x in crank(t)))[0]) for t in middle]
        errors.append(np.abs(traj.reactions("crank")[1:, 0] - exact).max())
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.3)


def test_the_prescribed_motion_does_the_work():
    scene = arm_scene(2)
    scene.prescribe("j1", crank)
    scene.set_joint("j2", damping=0.1)
    worst = []
    for dt in (4e-3, 2e-3):
        traj = cvi.simulate(scene, duration=2.0, dt=dt)
        assert np.ptp(traj.work.prescribed) > 0.1
        assert np.all(np.diff(traj.work.damping) >= 0.0)
        worst.append(np.abs(traj.ledger.energy_balance).max())
    assert math.log2(worst[0] / worst[1]) == pytest.approx(2.0, abs=0.3)


def test_a_prescribed_length_lifts():
    scene = cvi.Scene()
    scene.add_sphere("load", 0.05, mass=2.0, placement=(0, 0, 0))
    scene.add_distance("world", "load", (0, 0, 2.0), length=lambda t: (2.0 - 0.5 * t, -0.5, 0.0), name="winch")
    traj = cvi.simulate(scene, duration=1.0, dt=1e-3)
    assert traj.q[:, 2] == pytest.approx(0.5 * traj.t, abs=PHI)
    assert traj.reactions("winch")[5:, 0] == pytest.approx(np.full(996, -2.0 * 9.81), abs=1e-6)
    assert traj.work.prescribed[-1] == pytest.approx(2.0 * 9.81 * 0.5, rel=1e-6)


def test_a_motion_that_fails_ends_the_run_by_name():
    scene = arm_scene(1)
    scene.prescribe("j1", ([0.0, 0.1, 0.2], [0.0, 0.0, 0.0]))
    with pytest.raises(cvi.UserFunctionError, match=r"motion of joint 'j1' is asked for outside its table at t = 0.2"):
        cvi.simulate(scene, duration=0.3, dt=1e-3)


def test_a_motion_out_of_reach_is_named():
    """A linkage with a crank that cannot turn so far; a winch that gives more rope than there are rods."""
    scene = four_bar(ground=0.7)
    q = four_bar_start(scene)
    scene.prescribe("j1", lambda t: (q[0] - t, -1.0, 0.0), name="crank")
    with pytest.raises(cvi.ConstraintError) as caught:
        cvi.simulate(scene, q, duration=3.0, dt=1e-3)
    error = caught.value
    assert set(error.constraints) <= {"loop", "crank"}
    assert 0.4 < error.trajectory.t[-1] < 0.6
    assert "no way on for the constraints" in str(error)
    stopped = cvi.simulate(scene, q, duration=3.0, dt=1e-3, throw=False)
    assert "'loop'" in stopped.status.message
    assert residuals(stopped) <= PHI
    winch = arm_scene(2)
    winch.add_distance("world", "j2", (0, 0, 0.5), (BAR, 0, 0), length=lambda t: 1.0 + t, name="winch")
    with pytest.raises(cvi.ConstraintError, match=r"'winch', at t = 0\.(29|3)"):
        cvi.simulate(winch, winch.assemble(), duration=1.0, dt=1e-3)


def test_motions_that_contradict_each_other_are_named():
    scene = arm_scene(1)
    scene.prescribe("j1", 0.0, name="a")
    scene.prescribe("j1", lambda t: max(0.0, t - 0.5) ** 3, name="b")
    with pytest.raises(cvi.ConstraintError) as caught:
        cvi.simulate(scene, duration=1.0, dt=1e-3)
    assert set(caught.value.constraints) == {"a", "b"}


def test_continuous_joints_turn_round_and_round():
    scene = cvi.Scene.from_pinocchio(_wheel(), name="wheel")
    scene.prescribe("j1", lambda t: (20.0 * t, 20.0, 0.0))
    traj = cvi.simulate(scene, duration=1.0, dt=1e-3)
    assert traj.q[:, 0] == pytest.approx(np.cos(20.0 * traj.t), abs=1e-9)


def _wheel() -> pin.Model:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRUBY(), pin.SE3.Identity(), "j1")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    return model


# -- joints that follow -----------------------------------------------------------------------------------------------


def test_mimic_tags_run(tmp_path: Path):
    (tmp_path / "arm.urdf").write_text(urdf(two='<mimic joint="j1" multiplier="-2" offset="0.1"/>'))
    scene = cvi.Scene()
    scene.add_urdf(tmp_path / "arm.urdf", limits=False)
    traj = cvi.simulate(scene, v0=scene.consistent_velocity(v=[1.0, 0.0]), duration=0.5)
    assert traj.options.auto  # coupled joints are coordinates, not constraints
    assert traj.q[:, 1] == pytest.approx(0.1 - 2.0 * traj.q[:, 0], abs=PHI)
    assert np.ptp(traj.q[:, 0]) > 0.05


def test_a_quadratic_gear():
    scene = arm_scene(2)
    scene.add_joint_equality("j2", "j1", (0.1, 0.5, -0.3))
    fine = cvi.simulate(scene, duration=1.0, dt="auto", tol=1e-9)
    for traj in (cvi.simulate(scene, duration=1.0, dt=1e-3), fine):
        q = traj.q[:, 0]
        assert traj.q[:, 1] == pytest.approx(0.1 + 0.5 * q - 0.3 * q**2, abs=PHI)
    other = cvi.simulate(scene, duration=1.0, dt=0.005, order=10)
    assert other.q[-1] == pytest.approx(fine.q[-1], abs=1e-9)


# -- joint friction ---------------------------------------------------------------------------------------------------


def test_joint_friction_sticks_exactly_and_slips():
    scene = arm_scene(1)
    weight = 9.81 * 0.5 * BAR
    scene.set_joint("j1", friction=1.01 * weight)
    stuck = cvi.simulate(scene, duration=1.0, dt=1e-3)
    assert np.abs(stuck.q).max() <= 1e-12
    scene.set_joint("j1", friction=0.4 * weight)
    traj = cvi.simulate(scene, duration=1.0, dt=1e-3)
    assert traj.q[-1, 0] > 0.1
    assert traj.work.joint_friction[-1] > 0.1
    assert np.all(np.diff(traj.work.joint_friction) >= -1e-14)
    assert np.abs(traj.ledger.energy_balance).max() < 1e-4
    fell = 0.5 * (BAR**2 / 12.0 + 0.25 * BAR**2) * traj.v[100, 0] ** 2
    angle = traj.q[100, 0]
    assert fell == pytest.approx(weight * math.sin(angle) - 0.4 * weight * angle, rel=1e-3)


# -- contact ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("e", [1.0, 0.5])
def test_a_four_bar_that_hits_the_ground(e):
    scene = four_bar(gravity=True)
    q = four_bar_start(scene)
    scene.add_sphere("stop", 0.05, free=False, placement=(0.2, 0.0, -0.3))
    scene.add_halfspace(offset=-1.0)
    scene.set_joint("j1", limits=(-2.0, -0.9), restitution=e)
    traj = cvi.simulate(scene, q, duration=2.0, dt=1e-3)
    assert len(traj.events) > 0
    assert residuals(traj) <= PHI
    core = scene.core()
    for event in traj.events:
        J = core.constraint_jacobian(event.q, event.time)
        after = core.velocity(event.q[None], event.p_plus[None])[0]
        assert np.abs(J @ after).max() < 1e-8
    assert np.abs(traj.ledger.energy_balance).max() < 1e-3 * traj.kinetic_energy.max()


# -- files ------------------------------------------------------------------------------------------------------------


def test_a_run_with_constraints_is_stored(tmp_path: Path):
    scene = four_bar()
    q = four_bar_start(scene)
    scene.set_joint("j2", damping=0.1)
    traj = cvi.simulate(scene, q, duration=0.1, dt=1e-3)
    again = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    assert np.array_equal(again.reactions("loop"), traj.reactions("loop"))
    assert all(np.array_equal(a, b) for a, b in zip(again.work, traj.work, strict=True))
    assert again.constraints == traj.constraints
    assert np.array_equal(again.ledger.energy_balance, traj.ledger.energy_balance)
    assert [element.name for element in again.scene.elements] == ["loop"]


def test_a_run_with_functions_plays_back(tmp_path: Path):
    scene = arm_scene(2)
    scene.prescribe("j1", crank, name="crank")
    scene.add_force(lambda t, q, v: -0.1 * v, name="drag")
    traj = cvi.simulate(scene, duration=0.1, dt=1e-3)
    again = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    assert np.array_equal(again.reactions("crank"), traj.reactions("crank"))
    assert np.array_equal(again.energy, traj.energy)
    assert {"crank", "drag"} <= {note.name for note in again.scene.report.all_notes("ignored", "element")}
    assert again.to_html(tmp_path / "run.html").is_file()
    with pytest.raises(cvi.SceneError, match="lacks 'crank', 'drag'"):
        cvi.simulate(again.scene, duration=0.1)


def test_sampled_and_thinned_runs_keep_their_means():
    scene = arm_scene(1)
    scene.prescribe("j1", crank, name="crank")
    full = cvi.simulate(scene, duration=0.1, dt=1e-3)
    thin = cvi.simulate(scene, duration=0.1, dt=1e-3, record_every=10)
    sampled = cvi.simulate(scene, duration=0.1, dt=1e-3, sample_dt=0.01)
    wanted = full.reactions("crank")[1:].reshape(10, 10, 1).mean(axis=1)
    for traj in (thin, sampled):
        assert traj.reactions("crank")[1:] == pytest.approx(wanted, rel=1e-9)
        assert traj.work.prescribed == pytest.approx(full.work.prescribed[::10], abs=1e-12)


@pytest.mark.parametrize("gap", [0.0, 0.0123])
def test_an_impact_finds_prescribed_bodies_of_other_islands_where_they_are(gap):
    """Also at the start of a step, whose end the others have reached by then."""
    scene, q, v, _ = driven_wall(0.0, 0.0)
    q[3], q[10] = 0.05 + gap, 1.05
    v = scene.consistent_velocity(q)
    v[3] = -1.0
    events = cvi.simulate(scene, q, v, 0.05, 1e-2).events
    assert len(events) > 0
    assert (events.array("time")[0] == 0.0) == (gap == 0.0)
    driven = 0.5 * np.sin(3.0 * events.array("time"))
    assert events.array("q")[:, 0] == pytest.approx(driven, abs=1e-12)
