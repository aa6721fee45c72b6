"""Bodies whose pose is prescribed: driven exactly, with the wrench of the motion, and a hand that lifts a ball."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.grasp_scene import CLOSED, OPEN
from helpers.run_scenes import HAND_URDF

AXIS = np.array([0.3, 0.5, -1.0])


def screw(t: float) -> tuple[pin.SE3, tuple[np.ndarray, np.ndarray]]:
    """A pose and its velocity in world axes."""
    place = pin.SE3(pin.exp3(AXIS * np.sin(2.0 * t)), np.array([np.sin(t), t, 0.3 * np.cos(2.0 * t)]))
    velocity = np.array([np.cos(t), 1.0, -0.6 * np.sin(2.0 * t)]), AXIS * 2.0 * np.cos(2.0 * t)
    return place, velocity


def screw_twist(t: float) -> np.ndarray:
    """The body twist of `screw`."""
    place, (v, w) = screw(t)
    return np.concatenate([place.rotation.T @ v, place.rotation.T @ w])


def screw_twist_rate(t: float) -> np.ndarray:
    """Its derivative in time: of R^T v it is R^T (a - w x v), of R^T w it is R^T alpha."""
    place, (v, w) = screw(t)
    a = np.array([-np.sin(t), 0.0, -1.2 * np.cos(2.0 * t)])
    alpha = -4.0 * AXIS * np.sin(2.0 * t)
    return np.concatenate([place.rotation.T @ (a - np.cross(w, v)), place.rotation.T @ alpha])


def driven_box() -> tuple[cvi.Scene, np.ndarray]:
    scene = cvi.Scene()
    box = scene.add_box("box", size=(0.2, 0.3, 0.1), mass=2.0)
    scene.prescribe(box, screw, name="hand")
    return scene, scene.assemble()


def test_a_free_body_follows_its_pose_exactly_and_its_wrench_is_that_of_newton_and_euler():
    scene, q0 = driven_box()
    errors, balances = [], []
    for dt in (4e-3, 2e-3):
        traj = cvi.simulate(scene, q0, duration=1.0, dt=dt)
        off = [pin.log6(screw(t)[0].actInv(pin.XYZQUATToSE3(q))).vector for t, q in zip(traj.t, traj.q, strict=True)]
        assert np.abs(off).max() < 1e-13
        np.testing.assert_allclose(traj.v, [screw_twist(t) for t in traj.t], atol=1e-12)
        model, middle = scene.model, 0.5 * (traj.t[1:] + traj.t[:-1])
        expected = [
            pin.rnea(model, model.createData(), pin.SE3ToXYZQUAT(screw(t)[0]), screw_twist(t), screw_twist_rate(t))
            for t in middle
        ]
        assert traj.reactions("hand").shape == (len(traj.t), 6)
        errors.append(np.abs(traj.reactions("hand")[1:] - expected).max())
        balances.append(np.abs(traj.ledger.energy_balance).max())
    assert errors[0] / errors[1] > 3.5  # both are O(dt^2)
    assert errors[1] < 5e-5
    assert balances[0] / balances[1] > 3.5


def test_the_work_of_the_motion_is_the_change_of_the_energy():
    scene, q0 = driven_box()
    traj = cvi.simulate(scene, q0, duration=1.0, dt=1e-3)
    assert traj.work.prescribed[-1] == pytest.approx(traj.energy[-1] - traj.energy[0], abs=1e-5)
    assert abs(traj.work.prescribed).max() > 1.0


def test_the_jacobian_and_the_rate_are_the_derivatives_of_the_residual():
    scene, _ = driven_box()
    core, q, t, step = scene.core(), scene.configuration({"box": ((0.3, 0.2, 0.4), (0.3, 0.5, -0.7))}), 0.4, 1e-6

    def residual(w: np.ndarray, at: float) -> np.ndarray:
        return np.asarray(core.constraint_residual(pin.integrate(scene.model, q, w), at))

    J = np.array([(residual(step * e, t) - residual(-step * e, t)) / (2.0 * step) for e in np.eye(6)]).T
    np.testing.assert_allclose(scene.constraint_jacobian(q, t, "hand"), J, atol=1e-9)
    none = np.zeros(6)
    rate = (residual(none, t + step) - residual(none, t - step)) / (2.0 * step)
    np.testing.assert_allclose(core.constraint_rate(q, t), rate, atol=1e-9)


def test_a_link_of_an_arm_and_a_table_of_poses(tmp_path):
    """The last link of an arm on a free base is held in the world; then the arm swings below it."""
    scene = cvi.Scene()
    scene.add_urdf("example-robot-data://robots/ur_description/urdf/ur5_robot.urdf", base="free", self_collision=False,
                   limits=False)  # fmt: skip
    times = [0.0, 0.1, 0.2, 0.3]
    poses = [pin.SE3ToXYZQUAT(pin.SE3(pin.exp3(np.array([0.0, 0.0, 2.0 * t])), np.array([0.0, 0.0, t]))) for t in times]
    scene.prescribe("wrist_3_link", (times, poses), name="held")
    scene.set_joint("*_joint", damping=5.0)
    traj = cvi.simulate(scene, scene.assemble(), duration=0.3, dt=1e-3)
    model, data = scene.model, scene.model.createData()
    pin.framesForwardKinematics(model, data, traj.q[-1])
    found = data.oMf[model.getFrameId("wrist_3_link", pin.FrameType.BODY)]
    np.testing.assert_allclose(found.homogeneous, pin.XYZQUATToSE3(poses[-1]).homogeneous, atol=1e-10)
    traj.save(tmp_path / "run.npz")
    again = cvi.Trajectory.load(tmp_path / "run.npz")
    np.testing.assert_array_equal(again.reactions("held"), traj.reactions("held"))
    rerun = cvi.simulate(again.scene, traj.q[0], duration=0.3, dt=1e-3)
    np.testing.assert_array_equal(rerun.q[-1], traj.q[-1])


@pytest.mark.parametrize("moved", ["pose", "joint"])
def test_a_run_over_exactly_its_table_with_contacts(moved, tmp_path):
    """A tray goes along a cubic, which is its own spline: with the table the forces are those with the function."""
    lift = [lambda t: 0.1 + 0.4 * t**2 - 0.3 * t**3, lambda t: 0.8 * t - 0.9 * t**2, lambda t: 0.8 - 1.8 * t]
    path = tmp_path / "lift.urdf"
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    shape = '<collision><geometry><box size="1 1 0.1"/></geometry></collision>'
    path.write_text(
        f'<robot name="lift"><link name="base"/><link name="tray">{inertial}{shape}</link><joint name="up" '
        'type="prismatic"><parent link="base"/><child link="tray"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    times = np.linspace(0.0, 0.4, 6)

    def run(table: bool) -> tuple[np.ndarray, np.ndarray]:
        scene = cvi.Scene()
        if moved == "joint":
            scene.add_urdf(path, limits=False)
            scene.prescribe("up", (times, lift[0](times)) if table else lambda t: tuple(f(t) for f in lift))
        else:
            tray = scene.add_box("tray", (1.0, 1.0, 0.1), mass=1.0)
            function = lambda t: ((0, 0, lift[0](t), 0, 0, 0, 1), ((0, 0, lift[1](t)), (0, 0, 0)))  # noqa: E731
            scene.prescribe(tray, (times, [(0, 0, lift[0](t), 0, 0, 0, 1) for t in times]) if table else function)
        scene.add_box("box", (0.1, 0.1, 0.1), mass=2.0, placement=(0, 0, 0.2))
        scene.set_contact(restitution=0.0, friction=0.3)
        return cvi.simulate(scene, scene.assemble(), duration=0.4, dt=1e-2).contacts.on("box")

    (t, force), (same, expected) = run(True), run(False)
    assert t == pytest.approx(same, abs=1e-12)
    assert force == pytest.approx(expected, abs=1e-8)
    middle = np.array([lift[2](x) for x in t])
    assert force[:, 2] == pytest.approx(2.0 * (9.81 + middle), abs=1e-3)  # [N]; the second-order step


HEIGHT, FROM, SPAN = 0.1, 0.6, 0.5  # [m], [s]
PALM_UP = pin.rpy.rpyToMatrix(0.0, -np.pi / 2, 0.0)


def lift(t: float) -> tuple[pin.SE3, tuple[np.ndarray, np.ndarray]]:
    """The wrist rests, goes up by HEIGHT and turns by half a radian on the way, and rests; smooth."""
    s = float(np.clip((t - FROM) / SPAN, 0.0, 1.0))
    part, rate = s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3), 140.0 * s**3 * (1.0 - s) ** 3 / SPAN
    up = np.array([0.0, 0.0, 1.0])
    place = pin.SE3(pin.exp3(0.5 * part * up) @ PALM_UP, HEIGHT * part * up)
    return place, (HEIGHT * rate * up, 0.5 * rate * up)


@pytest.fixture(scope="module")
def grasp() -> tuple[cvi.Scene, cvi.Trajectory]:
    """The Allegro hand on a driven wrist closes around a ball and lifts it."""
    scene = cvi.Scene()
    hand = scene.add_urdf(HAND_URDF, base="free", placement=((0, 0, 0), (0, -np.pi / 2, 0)), limits=False,
                          self_collision=False)  # fmt: skip
    joints = [name for name in hand.joints if name.startswith("joint_")]
    for name in joints:
        number = int(name.removeprefix("joint_").removesuffix(".0"))
        scene.set_joint(name, damping=0.0, friction=0.0)
        scene.set_servo(name, kp=0.5, kd=0.01, target=CLOSED[number])
    scene.add_sphere("ball", 0.03, mass=0.1, placement=(-0.003, -0.016, 0.05))
    scene.set_contact(restitution=0.0, friction=0.8)
    scene.prescribe(hand, lift, name="wrist")
    start = {name: OPEN[int(name.removeprefix("joint_").removesuffix(".0"))] for name in joints}
    traj = cvi.simulate(scene, scene.configuration(start), duration=1.3, dt=1e-3)
    return scene, traj


def test_a_driven_wrist_lifts_a_ball_that_the_hand_holds(grasp):
    scene, traj = grasp
    base, ball = scene.q_index("root_joint"), scene.q_index("ball")
    off, held = [], []
    for t, q in zip(traj.t, traj.q, strict=True):
        wrist = pin.XYZQUATToSE3(q[base])
        off.append(pin.log6(lift(t)[0].actInv(wrist)).vector)
        held.append(wrist.actInv(q[ball][:3]))
    assert np.abs(off).max() < 1e-12
    assert traj.q[-1][base][2] == pytest.approx(HEIGHT, abs=1e-12)
    lifted = np.array(held)[traj.t >= FROM]
    assert np.abs(lifted - lifted[0]).max() < 1e-3  # the servos give way a little, the ball stays in the hand
    assert traj.q[-1][ball][2] - traj.q[traj.t.searchsorted(FROM)][ball][2] == pytest.approx(HEIGHT, abs=1e-3)
    assert len(traj.contacts.at(1.29)) >= 3
    assert min(gap for q in traj.q[::10] for gap in scene.gaps(q)) > -1e-9
    np.testing.assert_allclose(traj.v[:, scene.v_index("root_joint")],
                               [[*(x := lift(t))[0].rotation.T @ x[1][0], *x[0].rotation.T @ x[1][1]] for t in traj.t],
                               atol=1e-9)  # fmt: skip


def test_the_wrench_of_the_wrist_carries_hand_and_ball(grasp):
    """The impulse of the reaction is the change of the total momentum, less that of gravity."""
    scene, traj = grasp
    mass = sum(inertia.mass for inertia in scene.model.inertias)
    h = np.diff(traj.t)
    momentum = np.asarray(scene.core().spatial_momentum(traj.q, traj.p))[:, :3]
    # The axes of the wrench turn in a step; it acts, half and half, in those of the ends of the step.
    turned = np.array([lift(t)[0].rotation for t in traj.t])
    force = 0.5 * (turned[:-1] + turned[1:]) @ traj.reactions("wrist")[1:, :3, None]
    impulse = np.cumsum(force[:, :, 0] * h[:, None], axis=0)
    change = momentum[1:] - momentum[0] + mass * np.array([0.0, 0.0, 9.81]) * (traj.t[1:] - traj.t[0])[:, None]
    still = traj.t[1:] <= FROM
    np.testing.assert_allclose(impulse[still], change[still], atol=1e-9)
    np.testing.assert_allclose(impulse, change, atol=1e-5)  # O(h^2) where the wrist turns
    assert traj.reactions("wrist")[-1] @ np.array([1.0, 0, 0, 0, 0, 0]) == pytest.approx(9.81 * mass, rel=1e-2)


def test_a_simulator_has_the_wrench_along_the_jacobian(grasp):
    scene, traj = grasp
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset(traj.q[0])
    sim.run(300)
    np.testing.assert_array_equal(sim.q, traj.q[300])
    np.testing.assert_array_equal(sim.reaction("wrist"), traj.reactions("wrist")[300])
    expected = np.zeros((6, scene.nv))
    expected[:, scene.v_index("root_joint")] = np.eye(6)
    np.testing.assert_allclose(sim.constraint_jacobian("wrist"), expected, atol=1e-9)  # twist of the driven body


def test_starts_velocities_and_functions_are_checked():
    scene, q0 = driven_box()
    with pytest.raises(cvi.ConstraintError, match="'hand'.*scene.assemble"):
        cvi.simulate(scene, scene.neutral(), duration=0.1, dt=1e-3)
    with pytest.raises(cvi.ConstraintError, match="initial velocity"):
        cvi.simulate(scene, q0, np.zeros(6), duration=0.1, dt=1e-3)
    np.testing.assert_allclose(scene.consistent_velocity(q0), screw_twist(0.0), atol=1e-14)
    # No force moves a body whose pose is prescribed.
    traj = cvi.simulate(scene, q0, duration=0.1, dt=1e-3, record="gradient")
    assert np.abs(traj.sensitivity(["control"]).matrix[-1]).max() <= 1e-12
    assert np.abs(cvi.linearize(scene, q0, screw_twist(0.0))[1]).max() <= 1e-12
    assert np.abs(cvi.forward_dynamics_derivatives(scene, q0, screw_twist(0.0)).a_tau).max() <= 1e-12
    wrong = cvi.Scene()
    body = wrong.add_sphere("ball", 0.1)
    wrong.prescribe(body, lambda t: (screw(t)[0], (screw(t)[1][0], (0.0, 0.0, 1.0))))
    with pytest.raises(cvi.DerivativeError, match="angular velocity along x of motion of 'ball' is wrong"):
        cvi.simulate(wrong, wrong.assemble(), duration=0.1, dt=1e-3)


def test_a_pose_that_jumps_ends_the_run():
    scene = cvi.Scene()
    ball = scene.add_sphere("ball", 0.1)
    still = (0.0, 0.0, 0.0)
    scene.prescribe(ball, lambda t: ((0, 0, 0.1 * (t > 0.0505), 0, 0, 0, 1), (still, still)), name="jump")
    traj = cvi.simulate(scene, duration=0.1, dt=1e-3, throw=False)
    assert (traj.status.code.name, "jump" in traj.status.message) == ("CONSTRAINT", True)
    assert traj.t[-1] == pytest.approx(0.05, abs=1e-3)


def test_what_is_driven():
    scene = cvi.Scene()
    hand = scene.add_urdf(HAND_URDF, base="free", prefix="left_")
    scene.add_urdf("models/double_pendulum.urdf", placement=(3, 0, 0))
    scene.add_sphere("ball", 0.1, placement=(1, 0, 1))
    for what, body in ((hand, "left_palm_link"), ("left_root_joint", "left_palm_link"), ("ball", "ball"),
                       ("left_link_3.0_tip", "left_link_3.0_tip")):  # fmt: skip
        name = scene.prescribe(what, (0, 0, 1))
        assert scene.elements[-1].body == body
        assert f"{body!r} follows a prescribed motion" in scene.elements[-1].describe()
        scene.remove(name)
    scene.prescribe("joint_1", 0.2)
    assert scene.elements[-1].joint == "joint_1"
    with pytest.raises(cvi.InputError, match="The world does not move"):
        scene.prescribe("world", (0, 0, 1))
    with pytest.raises(cvi.InputError, match="expected one joint"):
        scene.prescribe("joint_*", 0.2)
    with pytest.raises(cvi.InputError, match="Unknown joint"):
        scene.prescribe("bal", (0, 0, 1))


def test_a_pose_in_a_scene_file(tmp_path):
    (tmp_path / "scene.toml").write_text(
        '[[sphere]]\nname = "ball"\nradius = 0.1\n[[prescribe]]\njoint = "ball"\n'
        "motion = { times = [0, 1], poses = [[0, 0, 1, 0, 0, 0, 1], [0, 0, 2, 0, 0, 0, 1]] }\n"
        "[initial]\nassemble = true\n"
    )
    scene = cvi.load_scene(tmp_path / "scene.toml")
    traj = cvi.simulate(scene, duration=0.5, dt=1e-2)
    assert traj.q[-1][2] == pytest.approx(1.5, abs=1e-12)
    assert cvi.Scene.from_dict(scene.to_dict()).elements[0].motion(0.25).position[2] == pytest.approx(1.25)


@pytest.mark.parametrize("size", [0.002, 0.02])
def test_a_box_on_a_tray_that_swings_keeps_its_steps(size: float):
    """The tray goes up and down with z(t) = size sin(3 t): in each step it gives the box its weight and its new speed.

    Where z'' is zero and z''' largest a step seems to gain m g h^3 z''' / 12, by which the trapezoid of the speeds of a
    motion differs from its way: an error of the balance of the energy of O(h^2), and none that calls for shorter steps.
    """
    mass, unbalanced = 0.5, []
    for dt in (1e-2, 5e-3):
        scene = cvi.Scene()
        scene.add_box("tray", (1.0, 1.0, 0.1), mass=2.0)
        scene.add_box("box", (0.1, 0.1, 0.1), mass=mass, placement=(0.0, 0.0, 0.1))
        scene.set_contact(friction=0.5, restitution=0.0)
        scene.prescribe("tray", lambda t: (0.0, 0.0, size * np.sin(3.0 * t), 0.0, 0.0, 0.0, 1.0))
        traj = cvi.simulate(scene, scene.neutral(), scene.consistent_velocity(), duration=1.0, dt=dt)
        assert traj.status.ok
        assert traj.stats.halved == 0
        lasting = traj.contacts.rows(traj.contacts.h > 0.0)
        start, of_row = np.unique(lasting.t, return_inverse=True)
        np.testing.assert_allclose(start, traj.t[:-1], atol=1e-12)
        impulse = np.bincount(of_row.reshape(-1), np.abs(lasting.impulse[:, 2]))
        speed = 3.0 * size * np.cos(3.0 * traj.t)
        # To the tolerance of the gaps, 1e-11 m, over the step.
        np.testing.assert_allclose(impulse, mass * (9.81 * dt + np.diff(speed)), atol=1e-8)
        balance = traj.ledger.energy_balance
        unbalanced.append(np.abs(balance - balance[0]).max())
    assert unbalanced[0] / unbalanced[1] == pytest.approx(4.0, rel=0.05)
