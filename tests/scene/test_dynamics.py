"""The equations of motion of a scene at a state, against Pinocchio and differences."""

from __future__ import annotations

import copy
import pickle

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.trajectory.poses import point_jacobians
from helpers.chains import JOINTS, chain, state_of
from helpers.laws import mass_matrix, retract
from helpers.run_scenes import HAND_URDF

STEP = 1e-5  # [m, rad] of central differences: their error is O(STEP^2), that of rounding 1e-16 / STEP


def hand_with_ball() -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
    """The Allegro hand with springs, armature and damping, on a free base, and a ball on the ground that touches."""
    scene = cvi.Scene()
    scene.add_urdf(HAND_URDF, base="free", placement=((0, 0, 0.5), (0.3, -1.2, 0.4)), armature=1e-3)
    scene.add_halfspace((0.1, -0.2, 1.0), 0.02)
    scene.add_sphere("ball", 0.03, mass=0.2, placement=(0.3, 0.2, 0.2))
    scene.add_box("box", size=(0.1, 0.2, 0.05), mass=0.7, placement=((-0.4, 0.1, 0.3), (0.1, 0.2, 0.3)))
    scene.set_joint("joint_*", stiffness=2.0, rest=0.3, damping=0.05)
    scene.set_joint("ball", damping=(0.3, 0.01))
    rng = np.random.default_rng(3)
    q = scene.configuration({f"joint_{k}.0": rng.uniform(0.3, 0.45) for k in range(16)})
    return scene, q, rng.standard_normal(scene.nv)


@pytest.mark.parametrize("kind", list(JOINTS))
def test_mass_matrix_and_bias_forces_are_pinocchios(kind):
    scene, rng = chain(JOINTS[kind])
    model, (q, v, _) = scene.model, state_of(scene, rng)
    M = scene.mass_matrix(q)
    scale = np.abs(M).max()
    np.testing.assert_allclose(M, mass_matrix(model, q), atol=1e-13 * scale)
    np.testing.assert_array_equal(M, M.T)
    b = pin.nle(model, model.createData(), q, v)
    np.testing.assert_allclose(scene.bias_forces(q, v), b, atol=1e-12 * np.abs(b).max())


def test_armature_is_in_the_mass_matrix_and_springs_and_dampers_in_the_passive_forces():
    scene, q, v = hand_with_ball()
    twin = scene.copy()
    twin.set_joint("joint_*", armature=0.0, stiffness=0.0, damping=0.0)
    driven = [scene.v_index(name).start for name in scene.model.names if name.startswith("joint_")]
    armature = np.zeros((scene.nv, scene.nv))
    armature[driven, driven] = 1e-3
    np.testing.assert_allclose(scene.mass_matrix(q) - twin.mass_matrix(q), armature, atol=1e-15)
    np.testing.assert_array_equal(scene.bias_forces(q, v), twin.bias_forces(q, v))
    expected = np.zeros(scene.nv)
    for k in driven:
        expected[k] = -2.0 * (q[k + 1] - 0.3) - 0.05 * v[k]
    ball = scene.v_index("ball")
    expected[ball] = -np.repeat([0.3, 0.01], 3) * v[ball]
    np.testing.assert_allclose(scene.passive_forces(q, v), expected, atol=1e-15 * np.abs(expected).max())


def test_the_equations_of_motion_give_the_acceleration():
    scene, q, v = hand_with_ball()
    scene.add_spring("world", "box", 30.0, rest_length=0.1, damping=0.4, point_b=(0.05, 0.0, 0.0))
    scene.add_wrench("ball", force=lambda t: (np.sin(t), 0.2, 0.0), torque=(0.0, 0.0, 0.01))
    nv = scene.nv
    scene.add_force(lambda t, q, v: -0.1 * v * np.abs(v), lambda t, q, v: (np.zeros((nv, nv)), -0.2 * np.diag(abs(v))))
    tau = np.random.default_rng(4).standard_normal(nv)
    a = cvi.forward_dynamics_derivatives(scene, q, v, tau, t=0.7).a
    left = scene.mass_matrix(q) @ a + scene.bias_forces(q, v)
    right = tau + scene.passive_forces(q, v, 0.7)
    np.testing.assert_allclose(left, right, atol=1e-12 * np.abs(left).max())


def test_servos_are_no_passive_forces():
    scene, q, v = hand_with_ball()
    before = scene.passive_forces(q, v)
    scene.set_servo("joint_*", kp=5.0, kd=0.1, target=0.0)
    np.testing.assert_array_equal(scene.passive_forces(q, v), before)


def test_gap_gradients_are_the_derivatives_of_the_gaps():
    scene, q, _ = hand_with_ball()
    assert len(scene.gap_names) == len(scene.gaps(q)) == len(scene.pair_names) + 2 * 16
    core = np.asarray(scene.core().gaps(q)[0])
    np.testing.assert_array_equal(scene.gaps(q)[: len(core)], core)
    differences = np.array([
        (scene.gaps(retract(scene.model, q, STEP * unit)) - scene.gaps(retract(scene.model, q, -STEP * unit)))
        / (2.0 * STEP)
        for unit in np.eye(scene.nv)
    ]).T  # fmt: skip
    W = scene.gap_gradients(q)
    # Differences of coal's distances have 1e-15 / STEP of noise.
    np.testing.assert_allclose(W, differences, atol=1e-8)


def test_gaps_of_limits_by_name():
    scene, q, _ = hand_with_ball()
    gap, model = dict(zip(scene.gap_names, scene.gaps(q), strict=True)), scene.model
    at = scene.q_index("joint_3.0").start
    assert gap["joint_3.0", "lower limit"] == q[at] - model.lowerPositionLimit[at]
    assert gap["joint_3.0", "upper limit"] == model.upperPositionLimit[at] - q[at]
    scene.set_joint("joint_3.0", limits=False)
    assert ("joint_3.0", "lower limit") not in scene.gap_names


def box_on_box(turn: float = 0.0) -> tuple[cvi.Scene, np.ndarray]:
    """A box on another one on tilted ground, touching to rounding, and where they are."""
    scene = cvi.Scene()
    scene.add_halfspace((0.3, 0.1, 1.0), 0.4)
    place = pin.SE3(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array([0.3, 0.1, 1.0])).matrix(),
                    np.zeros(3))  # fmt: skip
    place.translation = place.rotation @ np.array([0.1, 0.2, 0.4 + 0.05])
    above = place * pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, turn), np.array([0.02, 0.01, 0.1]))
    scene.add_box("low", size=(0.3, 0.3, 0.1), mass=2.0, placement=place)
    scene.add_box("high", size=(0.1, 0.1, 0.1), mass=1.0, placement=above)
    scene.set_contact(restitution=0.0, friction=0.6)
    return scene, scene.neutral()


def test_contact_jacobian_is_the_velocity_of_material_points():
    """The points of both bodies at a contact point, moved along v, part with J_C v in the axes of the frame."""
    scene, q = box_on_box(0.3)
    model, J = scene.model, scene.contact_jacobian(q)
    assert [c.pair for c in J.contacts].count(("ground", "low")) == 4
    assert [c.pair for c in J.contacts].count(("low", "high")) == 4
    joint = {"ground": 0, "low": model.getJointId("low"), "high": model.getJointId("high")}
    v = np.random.default_rng(1).standard_normal(scene.nv)

    def place(name: str, at: np.ndarray) -> pin.SE3:
        data = model.createData()
        pin.forwardKinematics(model, data, at)
        return data.oMi[joint[name]].copy()

    for k, contact in enumerate(J.contacts):
        parts = []
        for name in contact.pair:
            local = place(name, q).actInv(contact.position)
            ends = [place(name, pin.integrate(model, q, s * STEP * v)).act(local) for s in (1.0, -1.0)]
            parts.append((ends[0] - ends[1]) / (2.0 * STEP))
        expected = contact.rotation.T @ (parts[1] - parts[0])
        np.testing.assert_allclose(J.matrix[3 * k : 3 * k + 3] @ v, expected, atol=1e-9)
        np.testing.assert_allclose(contact.rotation.T @ contact.rotation, np.eye(3), atol=1e-15)
        assert np.linalg.det(contact.rotation) > 0.0
        assert contact.friction == 0.6
        assert abs(contact.gap) < 1e-12


def moving_contacts() -> tuple[cvi.Scene, cvi.ContactJacobian, np.ndarray]:
    """A hand near a box and a ball far from the world's origin: points on chains of joints, on free bodies, on the
    ground; and a velocity."""
    scene, q, v = hand_with_ball()
    box, palm = scene.q_index("box"), scene.q_index("root_joint")
    q[box.start : box.start + 3] = q[palm.start : palm.start + 3] + np.array([0.02, 0.03, -0.2])
    J = scene.contact_jacobian(q, margin=0.3)
    pairs = {c.pair for c in J.contacts}
    assert any("box" in pair and "ground" not in pair for pair in pairs)
    assert any("ground" in pair for pair in pairs)
    assert sum(any(name.startswith("link_") for name in pair) for pair in pairs) > 5
    return scene, J, v


def fixed_points(scene: cvi.Scene, J: cvi.ContactJacobian) -> tuple[pin.Model, list[tuple[int, int]]]:
    """The model with a frame on each of the two bodies of every point, at its nearest point."""
    model, q, found = scene.model.copy(), J._fixed.q, []
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    for k in range(len(J.contacts)):
        both = []
        for side in (0, 1):
            joint = int(J._fixed.joints[side, k])
            local = pin.SE3(np.eye(3), data.oMi[joint].actInv(J._fixed.points[side, k]))
            frame = pin.Frame(f"{k} {side}", joint, 0, local, pin.FrameType.OP_FRAME)
            both.append(model.addFrame(frame))
        found.append((both[0], both[1]))
    return model, found


def test_bias_acceleration_is_pinocchios():
    """Of frames on the bodies: their classical accelerations where dv/dt = 0."""
    scene, J, v = moving_contacts()
    model, frames = fixed_points(scene, J)
    data = model.createData()
    pin.forwardKinematics(model, data, J._fixed.q, v, np.zeros(scene.nv))
    pin.updateFramePlacements(model, data)

    def acceleration(frame: int) -> np.ndarray:
        return pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear

    expected = np.concatenate([
        c.rotation.T @ (acceleration(b) - acceleration(a)) for c, (a, b) in zip(J.contacts, frames, strict=True)
    ])  # fmt: skip
    scale = np.abs(expected).max()
    assert scale > 1.0
    np.testing.assert_allclose(J.bias_acceleration(v), expected, atol=1e-13 * scale)


def test_bias_acceleration_is_the_change_of_the_velocity_of_fixed_points():
    """Central differences of the points' velocities along the motion with constant v, in frames that stand still."""
    scene, J, v = moving_contacts()
    model, frames = fixed_points(scene, J)
    data, ends = model.createData(), []
    for sign in (1.0, -1.0):
        q = pin.integrate(model, J._fixed.q, sign * STEP * v)
        pin.forwardKinematics(model, data, q, v)
        pin.updateFramePlacements(model, data)
        velocity = [[pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear for frame in both]
                    for both in frames]  # fmt: skip
        ends.append([c.rotation.T @ (b - a) for c, (a, b) in zip(J.contacts, velocity, strict=True)])
    differences = (np.array(ends[0]) - np.array(ends[1])).ravel() / (2.0 * STEP)
    # Errors of STEP^2 times a third derivative (jerk of a turn with |w| < 10: 1e3), and of rounding.
    np.testing.assert_allclose(J.bias_acceleration(v), differences, atol=1e-6)


def test_with_minus_the_bias_acceleration_two_points_keep_together_to_third_order():
    """A motion that begins with J v = 0 and J a = -bias moves them apart by O(h^3), one with a = 0 by O(h^2)."""
    scene, J, _ = moving_contacts()
    k = next(k for k, c in enumerate(J.contacts) if c.pair == ("link_3.0_tip_0", "box"))
    rows, q = J.matrix[3 * k : 3 * k + 3], J._fixed.q
    null = np.linalg.svd(rows)[2][3:].T
    v = null @ np.random.default_rng(2).standard_normal(null.shape[1])
    a = -np.linalg.pinv(rows) @ J.bias_acceleration(v)[3 * k : 3 * k + 3]
    model, frames = fixed_points(scene, J)

    def apart(step: np.ndarray) -> np.ndarray:
        data = model.createData()
        pin.framesForwardKinematics(model, data, pin.integrate(model, q, step))
        first, second = (data.oMf[frame].translation for frame in frames[k])
        return second - first

    def moved(h: float, change: np.ndarray) -> float:
        return float(np.linalg.norm(apart(h * v + 0.5 * h**2 * change) - apart(0.0 * v)))

    held, free = (np.array([moved(h, change) for h in (1e-3, 1e-4)]) for change in (a, 0.0 * a))
    assert 900.0 < held[0] / held[1] < 1100.0
    assert 90.0 < free[0] / free[1] < 110.0


def test_a_sphere_that_rolls_has_material_points_that_accelerate_away():
    """The point that touches has v = 0 and the acceleration w^2 r towards the centre."""
    scene = cvi.Scene()
    scene.add_halfspace()
    ball = scene.add_sphere("ball", 0.1, placement=(0, 0, 0.1))
    J = scene.contact_jacobian(scene.neutral())
    v = scene.velocity({ball: ((0.3, 0.0, 0.0), (0.0, 3.0, 0.0))})
    np.testing.assert_allclose(J.matrix @ v, 0.0, atol=1e-15)
    # In Pinocchio's v of a free body, dv/dt = 0 turns the velocity with the body: w x v = (0, 0, -0.9) on top of it.
    np.testing.assert_allclose(J.bias_acceleration(v), [0.0, 0.0, 9.0 * 0.1 - 0.9], atol=1e-14)


def test_seen_from_a_body_it_is_the_second_of_each_pair():
    scene, q = box_on_box(0.3)
    J, v = scene.contact_jacobian(q), np.random.default_rng(6).standard_normal(scene.nv)
    low, high = J.on("low"), J.on("high")
    assert {c.pair for c in low.contacts} == {("ground", "low"), ("high", "low")}
    assert {c.pair for c in high.contacts} == {("low", "high")}
    for from_low in low.contacts:
        np.testing.assert_allclose(np.linalg.det(from_low.rotation), 1.0, atol=1e-14)
        assert from_low.friction == 0.6
    world = {(frozenset(c.pair), c.point): (c, k) for k, c in enumerate(J.contacts)}
    for name, seen in (("low", low), ("high", high)):
        for k, contact in enumerate(seen.contacts):
            there, j = world[frozenset(contact.pair), contact.point]
            sign = 1.0 if there.pair[1] == name else -1.0
            np.testing.assert_array_equal(contact.normal, sign * there.normal)
            for own, other in (
                (seen.matrix @ v, J.matrix @ v),
                (seen.bias_acceleration(v), J.bias_acceleration(v)),
            ):
                own_W, other_W = contact.rotation @ own[3 * k : 3 * k + 3], there.rotation @ other[3 * j : 3 * j + 3]
                np.testing.assert_allclose(own_W, sign * other_W, atol=1e-13)
    both = J.on(["low", "high"])
    assert {c.pair for c in both.contacts} == {("ground", "low")}
    with pytest.raises(cvi.InputError, match="Unknown body"):
        J.on("middle")


def test_a_robot_by_its_handle_or_a_link_by_its_name():
    scene, J, _ = moving_contacts()
    hand = next(handle for handle in scene.parts if "joint_0.0" in handle.joints)
    of_hand = J.on(hand)
    assert {c.pair[0] for c in of_hand.contacts} == {"box"}
    assert {c.pair[1] for c in of_hand.contacts} <= set(hand.geometries)
    link = of_hand.contacts[0].pair[1]
    assert {c.pair[1] for c in J.on(link).contacts} == {link}


def test_normal_rows_are_gradients_of_the_gaps():
    scene, q, _ = hand_with_ball()
    J, gradient = (
        scene.contact_jacobian(q, margin=0.02),
        dict(zip(scene.gap_names, scene.gap_gradients(q), strict=True)),
    )
    gap = dict(zip(scene.gap_names, scene.gaps(q), strict=True))
    assert len(J.contacts) > 5
    single = [k for k, c in enumerate(J.contacts) if abs(c.gap - gap[c.pair]) < 1e-13]
    assert len({J.contacts[k].pair for k in single}) == len({c.pair for c in J.contacts})  # the nearest point of each
    for k in single:
        np.testing.assert_allclose(J.matrix[3 * k + 2], gradient[J.contacts[k].pair], atol=1e-9)


def test_delassus_is_of_pinocchios_mass_matrix():
    scene, q = box_on_box(0.3)
    J = np.asarray(scene.contact_jacobian(q))
    expected = J @ np.linalg.solve(mass_matrix(scene.model, q), J.T)
    np.testing.assert_allclose(scene.delassus(q), expected, atol=1e-12 * np.abs(expected).max())


def test_rows_are_named():
    scene, q = box_on_box()
    J = scene.contact_jacobian(q)
    row = J.rows[4]
    assert (row.pair, row.point, row.axis) == (J.contacts[1].pair, J.contacts[1].point, "y")
    block = J.of("high", "low", J.rows[-1].point)
    np.testing.assert_array_equal(block, J.matrix[-3:])
    assert J.of("low", "high").shape == (12, scene.nv)
    with pytest.raises(cvi.InputError, match="No contact of these two"):
        J.of("ground", "high")
    with pytest.raises(cvi.InputError, match="No such point"):
        J.of("low", "high", 123456789)


def test_without_contacts_there_are_no_rows():
    scene, q = box_on_box()
    q[2] += 0.5
    q[9] += 1.0
    J = scene.contact_jacobian(q)
    assert J.matrix.shape == (0, scene.nv)
    assert J.bias_acceleration(np.ones(scene.nv)).shape == (0,)
    assert J.on("low").matrix.shape == (0, scene.nv)
    with pytest.raises(cvi.InputError, match="Nothing touches at this state"):
        J.of("low", "high")
    assert scene.delassus(q).shape == (0, 0)


def test_the_axes_on_horizontal_ground_are_the_worlds():
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, placement=(1.0, 2.0, 0.1))
    (contact,) = scene.contact_jacobian(scene.neutral()).contacts
    np.testing.assert_allclose(contact.rotation, np.eye(3), atol=1e-15)


def test_constraints_by_name():
    scene = cvi.Scene()
    scene.add_urdf("models/four_bar.urdf", limits=False)
    scene.add_point("world", "rocker", (1, 0, 0), (0.7, 0, 0), name="loop")
    scene.prescribe("hinge_crank", lambda t: 5 * t, name="motor")
    q = scene.assemble(scene.configuration({"hinge_coupler": 0.5, "hinge_rocker": -2.3}))
    J = scene.constraint_jacobian(q)
    np.testing.assert_array_equal(scene.constraint_jacobian(q, name="loop"), J[:3])
    np.testing.assert_array_equal(scene.constraint_jacobian(q, name="motor"), J[3:])
    np.testing.assert_array_equal(J[3:], [[1.0, 0.0, 0.0]])
    core = scene.core()
    differences = np.array([
        (np.asarray(core.constraint_residual(q + STEP * u)) - np.asarray(core.constraint_residual(q - STEP * u)))
        / (2.0 * STEP) for u in np.eye(3)
    ]).T  # fmt: skip
    np.testing.assert_allclose(J, differences, atol=1e-9)
    with pytest.raises(cvi.InputError, match="Unknown constraint"):
        scene.constraint_jacobian(q, name="lop")


def test_bad_states_are_refused():
    scene, q = box_on_box()
    with pytest.raises(cvi.InputError, match="wrong shape"):
        scene.mass_matrix(q[:-1])
    with pytest.raises(cvi.InputError, match="not a rotation"):
        scene.gaps(2.0 * q)
    with pytest.raises(cvi.InputError, match="wrong shape"):
        scene.bias_forces(q, [1.0])
    with pytest.raises(cvi.InputError, match="margin"):
        scene.contact_jacobian(q, margin=float("nan"))


def test_contact_jacobians_can_be_pickled_and_copied():
    scene, q = box_on_box(0.3)
    J, v = scene.contact_jacobian(q), np.ones(scene.nv)
    for twin in (pickle.loads(pickle.dumps(J)), copy.deepcopy(J)):
        np.testing.assert_array_equal(twin.matrix, J.matrix)
        np.testing.assert_array_equal(twin.bias_acceleration(v), J.bias_acceleration(v))
        np.testing.assert_array_equal(twin.on("low").matrix, J.on("low").matrix)


LINKS = 300  # whose pin.Data would take 1.7 GB


def test_no_question_about_a_long_chain_makes_the_pin_data_of_its_model(monkeypatch: pytest.MonkeyPatch):
    """Its own joints are one tree, so that no part of the model is small."""
    model, geometry = hanging_chain(LINKS)
    monkeypatch.setattr(pin.Model, "createData", forbidden)
    monkeypatch.setattr(pin, "Data", forbidden)
    scene = cvi.Scene.from_pinocchio(model, geometry, name="chain")
    scene.add_halfspace((0.0, 0.0, 1.0), -0.1 * LINKS - 0.06)
    q, v = scene.neutral(), np.linspace(-1.0, 1.0, scene.nv)
    # A weight that hangs straight down, at rest, puts no moment on any joint.
    np.testing.assert_allclose(scene.bias_forces(q), 0.0, atol=1e-9)
    # Links that turn all at once around the uppermost joint are pulled to it: no joint has a moment of that.
    np.testing.assert_allclose(scene.bias_forces(q, np.eye(LINKS)[0]), 0.0, atol=1e-9)
    # The lowest point of the ball at the tip goes along y with its distance from each joint, and towards the uppermost
    # one, around which all turns, with w^2 r.
    jacobian, radii = scene.contact_jacobian(q, margin=0.1).on("tip"), 0.03 + 0.1 * np.arange(LINKS, 0, -1)
    np.testing.assert_allclose(jacobian.matrix, [np.zeros(LINKS), radii, np.zeros(LINKS)], atol=1e-9)
    np.testing.assert_allclose(jacobian.bias_acceleration(np.eye(LINKS)[0]), [0.0, 0.0, radii[0]], atol=1e-9)
    # Of the weights below it each link has the stiffness m g r against its own angle, the sum of those of the joints.
    stiffness = 0.1 * 9.81 * (0.1 * np.arange(LINKS - 1, -1, -1) + 0.05)
    sums, M = np.tri(LINKS), scene.mass_matrix(q)
    wanted = -(sums.T * stiffness) @ sums
    found = M @ cvi.forward_dynamics_derivatives(scene, q).a_q
    rounding = np.finfo(float).eps * np.linalg.cond(M) * np.abs(wanted).max()
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=rounding)
    sim = cvi.Simulator(scene, dt=1e-4)
    sim.reset(q, v)
    sim.step()
    reading = cvi.Imu(sim, f"link{LINKS - 1}").read()
    np.testing.assert_allclose(reading.angular_velocity, [sim.v.sum(), 0.0, 0.0], atol=1e-9 * LINKS)
    run = cvi.simulate(scene, q, v, duration=1e-3, dt=1e-4)
    rows = point_jacobians(scene.built(), q[None], f"link{LINKS - 1}", np.array([0.0, 0.0, -0.13]))[0]
    np.testing.assert_allclose(rows, jacobian.matrix, atol=1e-9)
    place = run.poses(f"link{LINKS - 1}").position
    angles = np.cumsum(run.q, axis=1)[:, :-1]
    np.testing.assert_allclose(place[:, 2], -0.1 * np.cos(angles).sum(axis=1), atol=1e-9)


def hanging_chain(links: int) -> tuple[pin.Model, pin.GeometryModel]:
    """Links of 0.1 m that hang from the world one below the other, with a ball at the tip."""
    model, geometry = pin.Model(), pin.GeometryModel()
    for k in range(links):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1 if k else 0.0]))
        joint = model.addJoint(k, pin.JointModelRX(), place, f"j{k}")
        model.appendBodyToJoint(joint, pin.Inertia(0.1, np.array([0, 0, -0.05]), 1e-4 * np.eye(3)), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"link{k}", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1]))
    frame = model.nframes - 1
    geometry.addGeometryObject(
        pin.GeometryObject("tip", model.frames[frame].parentJoint, frame, place, coal.Sphere(0.03))
    )
    return model, geometry


def forbidden(*arguments: object, **more: object) -> None:
    raise AssertionError("the pin.Data of a model was made")
