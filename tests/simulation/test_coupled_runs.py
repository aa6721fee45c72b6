"""Runs of robots with coupled joints against the equations in the coordinates that are left (oracles/coupled.py)."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi import _core
from helpers.coupled_hands import finger, gripper, hand, limited, mimics, scene_of, start_of, with_ball
from oracles.coupled import Coupled

_BEND = [("right", -0.05, 0.01)]
ROBOTS = {
    "two links": finger(2),
    "three links": finger(3),
    "four links": finger(4),
    "side by side": gripper(-0.05, 0.01),
    "five fingers": hand(),
    "on an arm": hand(mount="arm"),
}
# A step of the lowest order that the run compares with its half, where errors are far from rounding.
STEPS = {2: 0.005, 4: 0.01, 8: 0.02}


def error(traj, q, v):
    return max(np.abs(traj.q[-1] - q).max(), np.abs(traj.v[-1] - v).max() / max(1.0, np.abs(v).max()))


def followers_off(scene, text, q):
    """Return how far followers are from what their leaders give them, (nodes,)."""
    oracle = Coupled(scene.model, mimics(text))
    return np.abs(q - (oracle.c + q[:, oracle.free] @ oracle.S.T)).max(axis=1)


@pytest.mark.parametrize("name", ROBOTS)
def test_orders(name, tmp_path):
    text = ROBOTS[name]
    scene = scene_of(text, tmp_path)
    oracle = Coupled(scene.model, mimics(text))
    y, u, q0, v0 = start_of(oracle)
    q, v, _ = oracle.run(y, u, 0.2)
    for order, dt in STEPS.items():
        errors = [
            error(cvi.simulate(scene, q0, v0, duration=0.2, dt=h, order=order, solver_tol=1e-14), q, v)
            for h in (dt, dt / 2)
        ]
        assert np.log2(errors[0] / errors[1]) > order - 0.4 or errors[1] < 1e-11
    # DOP853 itself is good to some 1e-13 of the speeds.
    assert error(cvi.simulate(scene, q0, v0, duration=0.2, dt=0.01, order=16, solver_tol=1e-14), q, v) < 1e-12


@pytest.mark.parametrize("name", ["three links", "on an arm"])
def test_the_run_chooses_its_steps(name, tmp_path):
    text = ROBOTS[name]
    scene = scene_of(text, tmp_path)
    oracle = Coupled(scene.model, mimics(text))
    y, u, q0, v0 = start_of(oracle)
    traj = cvi.simulate(scene, q0, v0, duration=0.5, tol=1e-9)
    assert traj.options.auto
    assert traj.options.order == 16
    assert np.abs(traj.q[-1] - oracle.run(y, u, 0.5)[0]).max() < 1e-9
    # One rounding of each term of the sum.
    assert followers_off(scene, text, traj.q).max() <= 4 * np.finfo(float).eps


def test_springs_damping_and_armature_of_either_joint(tmp_path):
    text = finger(3)
    scene = scene_of(text, tmp_path)
    numbers = {
        "stiffness": {"j0": 0.4, "j2": 0.7},
        "damping": {"j0": 1e-3, "j1": 2e-3},
        "armature": {"j0": 1e-5, "j2": 3e-5},
    }
    for what, values in numbers.items():
        for joint, value in values.items():
            scene.set_joint(joint, **{what: value})
    for joint in ("j0", "j2"):
        scene.set_joint(joint, rest=0.0)
    oracle = Coupled(scene.model, mimics(text), **{**numbers, "armature": None})
    y, u, q0, v0 = start_of(oracle)
    q, v, _ = oracle.run(y, u, 0.2)
    assert error(cvi.simulate(scene, q0, v0, duration=0.2, dt=0.005, order=12, solver_tol=1e-14), q, v) < 1e-12


def test_forces_on_either_joint(tmp_path):
    text = finger(3)
    scene = scene_of(text, tmp_path)
    oracle = Coupled(scene.model, mimics(text))
    y, u, q0, v0 = start_of(oracle)
    tau = np.array([0.02, -0.03, 0.015])
    q, v, _ = oracle.run(y, u, 0.1, tau=tau)
    traj = cvi.simulate(scene, q0, v0, duration=0.1, dt=0.01, order=12, solver_tol=1e-14, control=tau)
    assert error(traj, q, v) < 1e-12


@pytest.mark.parametrize("impact", ["ctec", "dtec", "mhc"])
@pytest.mark.parametrize("restitution", [1.0, 0.5])
@pytest.mark.parametrize("joint", ["j0", "j2"])
def test_limits_of_either_joint(joint, restitution, impact, tmp_path):
    bound = 0.5 if joint == "j0" else 0.9
    text = limited(finger(3), joint, -2.0, bound)
    scene = scene_of(text, tmp_path)
    scene.set_joint(joint, restitution=restitution)
    oracle = Coupled(scene.model, mimics(text))
    y, u = np.zeros(1), np.array([3.0])
    q, v, hits = oracle.run(y, u, 0.3, limits=[(joint, -2.0, 1.0), (joint, bound, -1.0)], restitution=restitution)
    traj = cvi.simulate(
        scene, oracle.q(y), oracle.S @ u, duration=0.3, dt=0.005, order=12, impact=impact, solver_tol=1e-14
    )
    assert len(traj.events) == len(hits) > 0
    np.testing.assert_allclose([event.time for event in traj.events], hits, rtol=0, atol=1e-12)
    assert error(traj, q, v) < 1e-11  # an event is located to 1e-12 m


def test_energy_stays_flat_over_many_steps(tmp_path):
    scene = scene_of(finger(4), tmp_path)
    oracle = Coupled(scene.model, mimics(finger(4)))
    _, _, q0, v0 = start_of(oracle, 1.0)
    traj = cvi.simulate(scene, q0, v0, duration=40.0, dt=0.002, order=2)
    H = traj.ledger.modified_energy
    drift = np.abs(H[-2000:].mean() - H[:2000].mean())
    assert drift < 1e-9 * np.ptp(traj.kinetic_energy)


def test_momentum_of_a_floating_hand(tmp_path):
    text = (
        hand(mount="arm")
        .replace('<link name="base"/>', "")
        .replace(re.search(r'<joint name="w0".*?</joint>', hand(mount="arm"))[0], "")
    )
    scene = scene_of(text, tmp_path, gravity=(0.0, 0.0, 0.0), base="free")
    nv = scene.model.nv
    followers = [scene.model.idx_vs[scene.model.getJointId(name)] for name in mimics(text)]
    q0 = scene.built().start
    v0 = scene.consistent_velocity(v=np.sin(1.0 + np.arange(nv)) * 2.0)
    assert len(followers) == 10
    for order, dt in ((2, 1e-3), (8, 0.01)):
        traj = cvi.simulate(scene, q0, v0, duration=1.0, dt=dt, order=order, solver_tol=1e-14)
        ledger = traj.ledger
        size = np.abs(scene.core().spatial_momentum(traj.q[:1], traj.p[:1])).max()
        for momentum in (ledger.linear_momentum, ledger.angular_momentum):
            assert np.abs(momentum - momentum[0]).max() < 1e-12 * size


def test_momentum_is_that_of_all_links(tmp_path):
    text = hand(mount="arm")
    scene = scene_of(text, tmp_path)
    oracle = Coupled(scene.model, mimics(text))
    _, _, q0, v0 = start_of(oracle)
    traj = cvi.simulate(scene, q0, v0, duration=0.1, dt=0.01, order=8)
    data = scene.model.createData()
    for q, v, p in zip(traj.q, traj.v, traj.p, strict=True):
        M = np.triu(pin.crba(scene.model, data, q))
        np.testing.assert_allclose(p, (M + np.triu(M, 1).T) @ v, rtol=0, atol=1e-13 * np.abs(p).max())


def test_a_start_off_the_coupling_is_refused(tmp_path):
    scene = scene_of(finger(3), tmp_path)
    with pytest.raises(cvi.ConstraintError, match="mimic_j1"):
        cvi.simulate(scene, q0=[0.1, 0.3, 0.1], duration=0.1)
    with pytest.raises(cvi.ConstraintError):
        cvi.simulate(scene, v0=[1.0, 0.0, 0.0], duration=0.1)


def test_circles_and_curves_stay_constraints(tmp_path):
    text = finger(4)
    scene = scene_of(text, tmp_path)
    scene.add_joint_equality("j3", "j0", [0.2 + 0.5 * (-0.05 + 0.7 * 0.1), 1.1 * 0.7 * 0.5])  # what the chain says
    assert [row.coupled for row in scene.built().elements.constraints] == [True, True, True, False]
    oracle = Coupled(scene.model, mimics(text))
    y, u, q0, v0 = start_of(oracle, 1.0)
    q, _, _ = oracle.run(y, u, 0.1)
    traj = cvi.simulate(scene, q0, v0, duration=0.1, dt=1e-3)
    assert traj.options.order == 2
    fine = cvi.simulate(scene, q0, v0, duration=0.1, dt=5e-4)
    errors = [np.abs(t.q[-1] - q).max() for t in (traj, fine)]
    assert errors[0] < 1e-5
    assert errors[0] / errors[1] > 3.0


def test_a_massless_link_that_is_coupled(tmp_path):
    """A leader without a mass turns about the same axis as its follower, which has all of it."""
    text = (
        '<robot name="pinch"><link name="base"/><link name="spread"/>'
        '<link name="finger"><inertial><origin xyz="0.01 0 .03"/><mass value=".02"/>'
        '<inertia ixx="1e-5" iyy="1e-5" izz="2e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="a" type="revolute"><parent link="base"/><child link="spread"/><axis xyz="0 1 0"/>'
        '<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
        '<joint name="b" type="revolute"><parent link="spread"/><child link="finger"/><axis xyz="0 1 0"/>'
        '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
        '<mimic joint="a" multiplier="%s" offset="0.0"/></joint></robot>'
    )
    for ratio in (0.5, 1.0, 2.0, -0.3):
        scene = scene_of(text % ratio, tmp_path)
        oracle = Coupled(scene.model, {"b": ("a", ratio, 0.0)})
        y, u, q0, v0 = start_of(oracle)
        q, v, _ = oracle.run(y, u, 0.3)
        traj = cvi.simulate(scene, q0, v0, duration=0.3, dt=0.01, order=12, solver_tol=1e-14)
        assert error(traj, q, v) < 1e-12


def test_massless_followers_of_a_hand(tmp_path):
    text = hand(massless=("f0l2", "f1l2", "f3l2"))
    scene = scene_of(text, tmp_path)
    oracle = Coupled(scene.model, mimics(text))
    y, u, q0, v0 = start_of(oracle)
    q, v, _ = oracle.run(y, u, 0.2)
    assert error(cvi.simulate(scene, q0, v0, duration=0.2, dt=0.01, order=16, solver_tol=1e-14), q, v) < 1e-11
    energy = cvi.simulate(scene, q0, v0, duration=0.2, dt=0.01, order=16).energy
    assert abs(energy[0] - oracle.energy(y, u)) < 1e-13


def test_links_without_any_mass_are_refused(tmp_path):
    with pytest.raises(cvi.SceneError, match="moves no mass"):
        scene_of(hand(massless=("f0l0", "f0l1", "f0l2")), tmp_path)


def reactions_of(text, folder, settings, change=lambda scene: None):
    """Return two runs: with coupled joints, and with the same equalities as constraint rows of order 2."""
    runs = []
    for rows in (False, True):
        scene = scene_of(text, folder, rows=rows)
        change(scene)
        oracle = Coupled(scene.model, mimics(text))
        q0, v0 = oracle.q(np.array([0.1])), oracle.S @ np.array([1.0])
        runs.append(cvi.simulate(scene, q0, v0, order=2, **settings))
    return runs


@pytest.mark.parametrize("what", ["free", "servo", "contact", "dense", "limit"])
def test_reactions_on_demand(what, tmp_path):
    """They are those of the constraint rows, whose steps of order 2 are the same steps."""
    text, settings = finger(3), {"duration": 0.2, "dt": 1e-3}

    def change(scene):
        if what == "servo":
            scene.set_servo("j2", kp=0.3, kd=0.01, target=0.4)
            scene.set_joint("j1", damping=1e-3)
        if what in ("contact", "dense"):
            scene.add_halfspace(offset=-0.05)
            # Friction on one degree of freedom leaves open how contact and coupling share a load.
            scene.set_contact(restitution=0.0, friction=0.3 if what == "contact" else 0.0)

    if what in ("contact", "dense"):
        text = with_ball(text, "l2", 0.006, 0.034)
    if what == "dense":
        settings["contact_mode"] = "steps"
    if what == "limit":
        text = limited(text, "j2", -3.0, 0.8)
    traj, rows = reactions_of(text, tmp_path, settings, change)
    assert np.abs(traj.q - rows.q).max() < 1e-10
    assert sorted(row.name for row in traj.constraints) == ["mimic_j1", "mimic_j2"]
    for name in ("mimic_j1", "mimic_j2"):
        found, wanted = traj.reactions(name), rows.reactions(name)
        assert found.shape == wanted.shape
        assert np.abs(wanted).max() > 1e-4
        # Differences of momenta over a step, and velocities that agree to 1e-9.
        assert np.abs(found - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_reactions_of_stored_runs_and_simulators(tmp_path):
    scene = scene_of(finger(3), tmp_path)
    oracle = Coupled(scene.model, mimics(finger(3)))
    _, _, q0, v0 = start_of(oracle)
    traj = cvi.simulate(scene, q0, v0, duration=0.1, dt=1e-3)
    traj.save(tmp_path / "run.npz")
    stored = cvi.Trajectory.load(tmp_path / "run.npz")
    np.testing.assert_array_equal(stored.reactions("mimic_j2"), traj.reactions("mimic_j2"))
    simulator = cvi.Simulator(scene, dt=1e-3)
    simulator.reset(q0, v0)
    simulator.run(100)
    np.testing.assert_allclose(simulator.reaction("mimic_j2"), traj.reactions("mimic_j2")[-1], rtol=1e-12)
    # Samples in between have the same impulse.
    sampled = cvi.simulate(scene, q0, v0, duration=0.1, dt=1e-3, sample_dt=0.01)
    impulse = traj.reactions("mimic_j1").sum() * 1e-3
    assert sampled.reactions("mimic_j1").sum() * 0.01 == pytest.approx(impulse, rel=1e-9)


def test_a_saved_simulator_goes_on_with_the_same_bits(tmp_path):
    scene = scene_of(hand(2, mount="arm"), tmp_path)
    simulator = cvi.Simulator(scene, dt=1e-3)
    simulator.reset()
    simulator.run(50)
    saved = simulator.save()
    simulator.run(50)
    q, p = np.array(simulator.q), np.array(simulator.p)
    simulator.load(saved)
    simulator.run(50)
    assert np.array_equal(simulator.q, q)
    assert np.array_equal(simulator.p, p)


@pytest.mark.parametrize("contact", [False, True])
@pytest.mark.parametrize("order", [2, 8])
@pytest.mark.parametrize("mount", ["fixed", "arm"])
def test_runs_of_a_batch_have_the_bits_of_single_runs(mount, order, contact, tmp_path):
    text = with_ball(hand(3, mount=mount), "f1l2", 0.008, 0.02)
    scene = scene_of(text, tmp_path)
    if contact:
        scene.add_halfspace(offset=-0.2 if mount == "arm" else -0.08)
    oracle = Coupled(scene.model, mimics(text))
    y, u, _, _ = start_of(oracle, 1.0)
    qs = np.array([oracle.q(y + 0.02 * k) for k in range(12)])
    vs = np.array([oracle.S @ (u - 0.1 * k) for k in range(12)])
    settings = {"duration": 0.3, "dt": 2e-3, "order": order}
    batch = cvi.simulate_batch(scene, qs, vs, keep="runs", workers=1, **settings)
    ends = cvi.simulate_batch(scene, qs, vs, keep="ends", **settings)
    assert bool(batch.impacts.any()) == contact
    for k in range(12):
        single = cvi.simulate(scene, qs[k], vs[k], **settings)
        for name in ("q", "v", "p"):
            assert np.array_equal(getattr(single, name), getattr(batch[k], name))
        assert np.array_equal(single.reactions("mimic_f0j1"), batch[k].reactions("mimic_f0j1"))
        assert np.array_equal(single.q[-1], ends.q[k])
        assert np.array_equal(single.v[-1], ends.v[k])


@pytest.mark.parametrize("order", [2, 8])
def test_equal_bits_on_all_instruction_sets(order, tmp_path):
    scene = scene_of(hand(2, mount="arm"), tmp_path)
    oracle = Coupled(scene.model, mimics(hand(2, mount="arm")))
    _, _, q0, v0 = start_of(oracle)
    kept, runs = _core.instruction_set(), set()
    for name in _core.instruction_sets():
        _core.instruction_set(name)
        runs.add(cvi.simulate(scene, q0, v0, duration=0.2, dt=5e-3, order=order).q.tobytes())
    _core.instruction_set(kept)
    assert len(runs) == 1


def test_islands(tmp_path):
    """Two hands far from each other are advanced by themselves, and have the numbers that they have alone."""
    text = with_ball(hand(2), "f0l2", 0.008, 0.02)
    both = cvi.Scene()
    path = tmp_path / "hand.urdf"
    path.write_text(text)
    both.add_urdf(path, prefix="a_")
    both.add_urdf(path, prefix="b_", placement=pin.SE3(np.eye(3), np.array([0.0, 2.0, 0.0])))
    both.add_halfspace(offset=-0.06)
    alone = cvi.Scene()
    alone.add_urdf(path)
    alone.add_halfspace(offset=-0.06)
    oracle = Coupled(alone.model, mimics(text))
    _, _, q0, v0 = start_of(oracle, 1.0)
    settings = {"duration": 0.2, "dt": 1e-3}
    one = cvi.simulate(alone, q0, v0, **settings)
    two = cvi.simulate(both, np.tile(q0, 2), np.tile(v0, 2), **settings)
    assert np.abs(two.q - np.hstack([one.q, one.q])).max() < 1e-9
    for name in ("f0j1", "f1j2"):
        for prefix in ("a_", "b_"):
            found = two.reactions(f"mimic_{prefix}{name}")
            assert np.abs(found - one.reactions(f"mimic_{name}")).max() < 1e-6


def test_equalities_between_trees(tmp_path):
    """Two fingers on the world of which one follows the other: the trees are one."""
    scene = scene_of(hand(2, links=1, ratio=lambda f, k: 0.0), tmp_path)
    scene.add_joint_equality("f1j0", "f0j0", [0.1, -0.7])
    oracle = Coupled(scene.model, {"f1j0": ("f0j0", -0.7, 0.1)})
    y, u, q0, v0 = start_of(oracle)
    q, v, _ = oracle.run(y, u, 0.2)
    assert error(cvi.simulate(scene, q0, v0, duration=0.2, dt=0.01, order=12, solver_tol=1e-14), q, v) < 1e-12


def test_joint_friction_of_a_follower(tmp_path):
    """Order 2, as with the constraint rows; it sticks where it can."""

    def change(scene):
        scene.set_joint("j2", friction=2e-3)

    traj, rows = reactions_of(finger(3), tmp_path, {"duration": 0.3, "dt": 1e-3}, change)
    assert np.abs(traj.q - rows.q).max() < 1e-9


@pytest.mark.parametrize("mode", ["events", "steps"])
def test_beside_other_constraints(mode, tmp_path):
    """A wrist that is driven, and a finger tip in contact: against the couplings as constraint rows."""
    text, runs = with_ball(hand(2, mount="arm"), "f0l2", 0.008, 0.028), []
    for rows in (False, True):
        scene = scene_of(text, tmp_path, rows=rows)
        scene.prescribe("w1", lambda t: 0.2 * np.sin(3.0 * t))
        scene.add_halfspace(offset=-0.1)
        scene.set_contact(restitution=0.0, friction=0.0)
        q0 = scene.neutral()
        # Later the finger whips round, and what differs by rounding grows.
        runs.append(cvi.simulate(scene, q0, duration=0.155, dt=1e-3, contact_mode=mode))
    traj, rows = runs
    assert len(traj.contacts) >= 10
    assert np.abs(traj.q - rows.q).max() < 1e-7
    for row in rows.constraints:
        found, wanted = traj.reactions(row.name), rows.reactions(row.name)
        size = max(np.abs(wanted).max(), 1e-3)
        assert np.abs(found - wanted).max() < 1e-3 * size  # impulses of an impact that is 1e-7 s off


def test_starts_and_accelerations_without_an_inverse_of_M(tmp_path):
    """Starts, momenta and accelerations where M itself has no inverse."""
    text = hand(2, mount="arm", massless=("f0l2",))
    scene = scene_of(text, tmp_path)
    oracle = Coupled(scene.model, mimics(text))
    y, u, q0, v0 = start_of(oracle)
    v = scene.consistent_velocity(v=np.ones(scene.model.nv), q=q0)
    np.testing.assert_allclose(v, oracle.S @ v[oracle.free], rtol=0, atol=1e-14)
    # The nearest one in the metric of the mass: S^T M (1 - v) = 0.
    M = np.triu(pin.crba(scene.model, scene.model.createData(), q0))
    off = oracle.S.T @ (M + np.triu(M, 1).T) @ (1.0 - v)
    assert np.abs(off).max() < 1e-13
    found = cvi.forward_dynamics_derivatives(scene, q0, v0)
    wanted = oracle.S @ oracle.acceleration(y, u)
    assert np.abs(found.a - wanted).max() < 1e-11 * np.abs(wanted).max()


def test_simultaneous_impacts_of_two_tips(tmp_path):
    """Every order of two elastic impacts keeps the energy of the leaders, and p = M v of all joints."""
    text = with_ball(with_ball(hand(2, mount="arm"), "f0l2", 0.008, 0.028), "f1l2", 0.008, 0.028)
    scene = scene_of(text, tmp_path)
    scene.add_halfspace(offset=-0.1)
    scene.set_contact(restitution=1.0)
    oracle = Coupled(scene.model, mimics(text))
    _, _, q0, _ = start_of(oracle)
    u = np.array([1.0, 0.3, 0.5, 0.4])
    found = cvi.simultaneous_outcomes(scene, q0, oracle.S @ u, tolerance=1.0)
    energy = 0.5 * u @ oracle.mass(q0) @ u
    M = np.triu(pin.crba(scene.model, scene.model.createData(), q0))
    M = M + np.triu(M, 1).T
    assert found.energy == pytest.approx(energy, rel=1e-12)
    for outcome in found.outcomes:
        v = outcome.v_plus
        np.testing.assert_allclose(v, oracle.S @ v[oracle.free], rtol=0, atol=1e-13)
        np.testing.assert_allclose(outcome.p_plus, M @ v, rtol=0, atol=1e-14)
        assert outcome.energy == pytest.approx(energy, rel=1e-12)


def test_equalities_of_an_mjcf(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "two.xml").write_text("""
    <mujoco><compiler angle="radian"/><worldbody>
      <body><joint name="a" axis="0 1 0"/><geom type="capsule" size="0.01 0.05" pos="0.05 0 0" mass="0.1"/>
        <body pos="0.1 0 0"><joint name="b" axis="0 1 0"/><geom type="capsule" size="0.01 0.04" mass="0.05"/></body>
      </body>
      </worldbody><equality><joint name="gear" joint1="b" joint2="a" polycoef="0.1 -0.6 0 0 0"/></equality></mujoco>""")
    scene = cvi.Scene()
    scene.add_mjcf(tmp_path / "two.xml", prefix="m_")
    assert [(row.name, row.coupled) for row in scene.built().elements.constraints] == [("m_gear", True)]
    traj = cvi.simulate(scene, duration=0.3)
    assert traj.options.auto
    assert np.abs(traj.q[:, 1] - (0.1 - 0.6 * traj.q[:, 0])).max() < 1e-15
