"""The scene: the model assembled from its parts, its names and pairs, and the arrays for the engine."""

from __future__ import annotations

import copy

import coal
import numpy as np
import pinocchio as pin
import pytest

from contactvi.errors import InputError, SceneError, UnsupportedJointError
from contactvi.importing.paths import resolve_path
from contactvi.scene.scene import Scene

ROBOTS = "example-robot-data://robots/"
ALLEGRO = ROBOTS + "allegro_hand_description/urdf/allegro_right_hand.urdf"
PANDA = ROBOTS + "panda_description/urdf/panda.urdf"
EPS = np.finfo(float).eps
IDENTITY = pin.SE3.Identity()


def hand_and_ball() -> Scene:
    scene = Scene()
    scene.add_urdf(ALLEGRO)
    scene.add_sphere("ball", 0.03, 0.1, placement=(0.0, 0.0, 1.0))
    scene.add_halfspace((0, 0, 1), -0.5)
    return scene


def direct(path: str, *root: pin.JointModel) -> pin.Model:
    return pin.buildModelFromUrdf(str(resolve_path(path)), *root)


def chain(parents: list[int], kind: type = pin.JointModelRX) -> pin.Model:
    model = pin.Model()
    for k, parent in enumerate(parents):
        joint = model.addJoint(parent, kind(), pin.SE3(np.eye(3), np.array([0.0, 0.0, 1.0])), f"j{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), IDENTITY)
    return model


def assert_same_dynamics(a: pin.Model, b: pin.Model, q: np.ndarray) -> None:
    """The forces of a generic motion agree, so placements, inertias, armature and order do."""
    v, acc = np.sin(1.0 + np.arange(a.nv)), np.cos(2.0 * np.arange(a.nv))
    one = pin.rnea(a, a.createData(), q, v, acc)
    two = pin.rnea(b, b.createData(), q, v, acc)
    assert np.max(np.abs(one - two)) <= 128 * EPS * max(1.0, np.max(np.abs(one)))


class TestAssembly:
    def test_one_part_is_the_model_pinocchio_reads(self):
        scene = Scene()
        scene.add_urdf(PANDA)
        reference = direct(PANDA)
        assert list(scene.model.names) == list(reference.names)
        assert_same_dynamics(scene.model, reference, pin.integrate(reference, pin.neutral(reference), np.full(9, 0.3)))

    def test_two_hands_and_a_ball_keep_their_dynamics(self):
        where = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.4, 0.5, 0.6]))
        scene = Scene(gravity=(1.0, 2.0, -3.0))
        scene.add_urdf(ALLEGRO, prefix="left_", placement=where)
        scene.add_sphere("ball", 0.1, 2.0)
        scene.add_urdf(ALLEGRO, prefix="right_")
        assert (scene.nq, scene.nv) == (16 + 7 + 16, 16 + 6 + 16)
        reference = direct(ALLEGRO)
        # The left hand feels gravity in its own axes.
        reference.gravity.linear = where.rotation.T @ np.array([1.0, 2.0, -3.0])
        q, v = scene.neutral(), np.sin(np.arange(scene.nv, dtype=float))
        tau = pin.rnea(scene.model, scene.model.createData(), q, v, v)
        alone = pin.rnea(reference, reference.createData(), q[:16], v[:16], v[:16])
        assert np.max(np.abs(tau[:16] - alone)) <= 128 * EPS * np.max(np.abs(alone))

    def test_armature_damping_friction_and_limits_survive(self):
        model = chain([0, 1])
        model.armature[:] = [0.1, 0.2]
        model.damping[:] = [0.3, 0.4]
        model.upperDryFrictionLimit[:] = [0.5, 0.6]
        model.lowerPositionLimit[:], model.upperPositionLimit[:] = [-1, -2], [1, 2]
        got = Scene.from_pinocchio(model).model
        for name in ("armature", "damping", "upperDryFrictionLimit", "lowerPositionLimit", "upperPositionLimit"):
            assert np.array_equal(getattr(got, name), getattr(model, name)), name

    def test_free_base_starts_at_its_placement_and_q_is_the_world_pose(self):
        scene = Scene()
        scene.add_urdf(ALLEGRO, base="free", placement=((1, 2, 3), (0.1, 0.2, 0.3)))
        q = scene.neutral()
        assert np.array_equal(q[:3], [1.0, 2.0, 3.0])
        data = scene.model.createData()
        pin.forwardKinematics(scene.model, data, q)
        assert np.allclose(data.oMi[1].homogeneous, pin.XYZQUATToSE3(q[:7]).homogeneous, atol=8 * EPS)

    def test_frames_and_geometry_move_with_a_fixed_part(self):
        scene = Scene()
        scene.add_urdf(ALLEGRO, placement=(0, 0, 2))
        palm = scene.collision_model.geometryObjects[0]
        assert palm.placement.translation == pytest.approx([-0.0093, 0, 1.9525], abs=1e-15)
        assert scene.model.frames[palm.parentFrame].name == "palm_link"
        assert scene.model.inertias[0].lever[2] == pytest.approx(2.0475, abs=1e-12)

    def test_from_pinocchio_leaves_its_arguments_alone(self):
        model, geometry = chain([0]), pin.GeometryModel()
        geometry.addGeometryObject(pin.GeometryObject("a", 1, IDENTITY, coal.Sphere(0.1)))
        before = model.saveToString(), geometry.saveToString()
        scene = Scene.from_pinocchio(model, geometry)
        scene.set_joint("j0", damping=3.0, limits=False)
        assert scene.model.damping[0] == 3.0
        assert (model.saveToString(), geometry.saveToString()) == before

    @pytest.mark.parametrize("parents", [[0, 1, 1, 2], [0, 0, 1]])
    def test_order_that_is_not_depth_first_is_refused(self, parents):
        with pytest.raises(SceneError, match="depth-first"):
            Scene.from_pinocchio(chain(parents))

    def test_a_reduced_model_is_taken(self):
        """Frames of its locked joints are their own parents."""
        model = direct("example-robot-data://robots/panda_description/urdf/panda.urdf")
        fingers = [i for i, name in enumerate(model.names) if "finger" in name]
        reduced = pin.buildReducedModel(model, fingers, pin.neutral(model))
        assert any(frame.parentFrame >= i > 0 for i, frame in enumerate(reduced.frames))  # The model has such frames.
        scene = Scene.from_pinocchio(reduced)
        assert_same_dynamics(scene.model, reduced, pin.neutral(reduced))
        for frame in reduced.frames[1:]:
            own = scene.model.frames[scene.model.getFrameId(frame.name)]
            assert own.parentJoint == frame.parentJoint
            assert own.placement.isApprox(frame.placement, 1e-12)

    @pytest.mark.parametrize("parents", [[0, 1, 1], [0, 1, 2, 1, 0]])
    def test_depth_first_orders_are_taken(self, parents):
        assert Scene.from_pinocchio(chain(parents)).nv == len(parents)

    @pytest.mark.parametrize("name", ["lowerPositionLimit", "upperPositionLimit", "damping", "armature"])
    def test_arrays_of_another_length_are_refused(self, name):
        model = pin.buildSampleModelManipulator()
        setattr(model, name, np.zeros(2))
        with pytest.raises(SceneError, match=f"{name} of the model: expected {model.nv} entries") as caught:
            Scene.from_pinocchio(model)
        assert caught.value.remedy

    @pytest.mark.parametrize("kind", [pin.JointModelSphericalZYX, pin.JointModelUniversal, pin.JointModelEllipsoid])
    def test_unsupported_joints_are_refused_by_name(self, kind):
        with pytest.raises(UnsupportedJointError) as caught:
            Scene.from_pinocchio(chain([0, 1], kind))
        assert caught.value.joint == "j0"
        assert caught.value.joint_type == kind.__name__
        assert [note.name for note in caught.value.report.notes if note.use == "refused"] == ["j0", "j1"]

    def test_solid_shapes_have_their_textbook_inertia(self):
        scene = Scene()
        scene.add_sphere("s", 0.2, 3.0)
        scene.add_box("b", (0.1, 0.2, 0.3), 12.0)
        scene.add_cylinder("c", 0.2, 0.6, 12.0)
        scene.add_capsule("k", 0.5, 1e-9, 5.0)  # It is a ball in the limit.
        scene.add_ellipsoid("e", (0.1, 0.2, 0.3), 5.0)
        s, b, c, k, e = (np.diag(scene.model.inertias[i].inertia) for i in range(1, 6))
        assert s == pytest.approx([0.4 * 3 * 0.04] * 3)
        assert b == pytest.approx([0.13, 0.10, 0.05])
        assert c == pytest.approx([0.04 * 3 + 0.36, 0.04 * 3 + 0.36, 0.24])
        assert k == pytest.approx([0.4 * 5 * 0.25] * 3)
        assert e == pytest.approx([0.04 + 0.09, 0.01 + 0.09, 0.01 + 0.04])


class TestNames:
    def test_handles_know_their_parts(self):
        scene = Scene()
        hand = scene.add_urdf(ALLEGRO, prefix="r_")
        ball = scene.add_sphere("ball", 0.03)
        table = scene.add_box("table", (1, 1, 0.1), free=False)
        assert (len(hand.joints), len(hand.geometries), hand.bodies[0]) == (16, 21, "r_palm_link")
        assert (ball.joint, ball.geometries, table.joint) == ("ball", ("ball",), None)
        assert str(ball) == "ball"
        assert [part.name for part in scene.parts] == ["r_allegro_hand_right", "ball", "table"]

    def test_a_second_part_of_the_same_names_needs_a_prefix(self):
        scene = Scene()
        scene.add_urdf(ALLEGRO)
        with pytest.raises(InputError, match="prefix"):
            scene.add_urdf(ALLEGRO)
        scene.add_urdf(ALLEGRO, prefix="b_")
        scene.add_sphere("ball", 0.1)
        with pytest.raises(InputError, match="'ball'"):
            scene.add_sphere("ball", 0.1)
        assert scene.nv == 32 + 6

    def test_an_unknown_joint_names_the_nearest(self):
        with pytest.raises(InputError, match=r"Did you mean 'joint_12\.0'\?"):
            hand_and_ball().set_joint("joint_12", stiffness=1.0)

    def test_a_handle_of_another_scene_is_refused(self):
        scene, other = hand_and_ball(), Scene()
        with pytest.raises(InputError):
            scene.set_contact(other.add_sphere("other", 0.1), restitution=0.5)


class TestContactRules:
    def test_combine_rule(self):
        scene = hand_and_ball()
        scene.set_contact(restitution=0.8)
        scene.set_contact("ground", restitution=0.6)
        scene.set_contact("link_3.0_tip", restitution=0.9)
        scene.set_contact("ball", "palm_link", restitution=1.0)
        e = dict(zip(scene.pair_names, scene.pair_restitution, strict=True))
        assert e["palm_link_0", "ball"] == 1.0  # the pair's own
        assert e["link_3.0_tip_0", "ground"] == 0.6  # the smaller of two sides
        assert e["link_3.0_tip_0", "ball"] == 0.9  # the only side that has one
        assert e["link_2.0_0", "ball"] == 0.8  # the default
        scene.set_contact("ball", restitution=0.1)
        scene.set_contact("ball", restitution=0.2)  # The last call counts.
        e = dict(zip(scene.pair_names, scene.pair_restitution, strict=True))
        assert (e["palm_link_0", "ball"], e["ball", "ground"]) == (1.0, 0.2)

    def test_patterns_parts_joints_and_handles_select_geometries(self):
        scene = hand_and_ball()
        hand = scene.parts[0]
        scene.set_contact(restitution=0.0)
        scene.set_contact("*_tip", "ball", restitution=0.5)
        scene.set_contact("joint_0.0", "ball", restitution=0.25)
        scene.set_contact("ground", hand, restitution=1.0)
        e = dict(zip(scene.pair_names, scene.pair_restitution, strict=True))
        assert sum(value == 0.5 for value in e.values()) == 4
        assert e["link_0.0_0", "ball"] == 0.25
        assert sum(value == 1.0 for value in e.values()) == 20

    def test_friction_is_stored(self):
        scene = hand_and_ball()
        scene.set_contact(friction=0.7)
        assert set(scene.pair_friction) == {0.7}


class TestJoints:
    def test_spring_damping_and_limits_reach_the_arrays(self):
        scene = hand_and_ball()
        scene.set_joint("joint_[048].0", stiffness=2.0, rest=0.1, damping=0.3)
        scene.set_joint("joint_12.0", limits=(0.5, 0.7), restitution=0.25)
        scene.set_joint("joint_13.0", limits=False)
        scene.set_joint("ball", damping=(0.1, 0.2))
        scene.set_contact(restitution=0.6)
        model, arrays = scene.model, scene.built().arrays
        index = model.getJointId("joint_4.0")
        assert (arrays.stiffness[index], arrays.rest[scene.q_index("joint_4.0")]) == (2.0, 0.1)
        assert model.damping[scene.v_index("joint_4.0")] == 0.3
        assert model.damping[scene.v_index("ball")] == pytest.approx([0.1] * 3 + [0.2] * 3)
        twelve, thirteen = model.getJointId("joint_12.0"), model.getJointId("joint_13.0")
        assert (arrays.limit_restitution[twelve], arrays.limit_restitution[thirteen]) == (0.25, 0.6)
        assert arrays.limits[twelve]
        assert not arrays.limits[thirteen]
        assert scene.neutral()[scene.q_index("joint_12.0")] == 0.5  # Zero is moved into the limits.
        assert model.lowerPositionLimit[scene.q_index("joint_13.0")] == -np.inf

    def test_limits_without_meaning_are_not_used(self):
        model = chain([0, 0, 0])
        model.lowerPositionLimit[:], model.upperPositionLimit[:] = [0, 1, -np.inf], [0, -1, 1]
        scene = Scene.from_pinocchio(model)
        assert not scene.built().arrays.limits.any()
        with pytest.raises(InputError, match="lower < upper"):
            scene.set_joint("j0", limits=True)

    def test_configuration_and_velocity_by_joint(self):
        scene = hand_and_ball()
        turned = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, np.pi / 2)).coeffs()
        q = scene.configuration({"joint_1*": 0.3, "joint_1.0": 0.4, "ball": [1, 2, 3, *turned]})
        assert q[scene.q_index("joint_1.0")] == 0.4
        assert q[scene.q_index("joint_10.0")] == 0.3
        assert q[scene.q_index("joint_2.0")] == 0.0
        v = scene.velocity({"ball": ((1, 0, 0), (0, 0, 5)), "joint_0.0": -2.0}, q)
        # Seen from a body turned by 90 degrees about z, the world's x is its -y.
        assert v[scene.v_index("ball")] == pytest.approx([0, -1, 0, 0, 0, 5], abs=4 * EPS)
        assert v[scene.v_index("joint_0.0")] == -2.0

    def test_values_of_every_joint_type(self):
        model = pin.Model()
        kinds = (pin.JointModelRUBX, pin.JointModelPlanar, pin.JointModelSpherical, pin.JointModelTranslation)
        for k, kind in enumerate(kinds):
            joint = model.addJoint(k, kind(), IDENTITY, kind.__name__)
            model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), IDENTITY)
        scene = Scene.from_pinocchio(model)
        half = np.sqrt(0.5)
        q = scene.configuration(
            {
                "JointModelRUBX": np.pi / 2,
                "JointModelPlanar": (1, 2, np.pi),
                "JointModelSpherical": (half, 0, 0, half),
                "JointModelTranslation": (4, 5, 6),
            }
        )
        assert q == pytest.approx([0, 1, 1, 2, -1, 0, half, 0, 0, half, 4, 5, 6], abs=4 * EPS)


class TestCopies:
    def test_a_copy_is_edited_apart(self):
        scene = hand_and_ball()
        scene.set_contact("ball", friction=0.3)
        built, before = scene.built(), str(scene.to_dict())
        twin = scene.copy()
        assert twin.built() is built
        twin.add_sphere("other", 0.01)
        twin.set_contact("ball", "ground", restitution=0.9, friction=0.1)
        twin.disable_pair("other", "ground")
        twin.set_joint("joint_*", damping=0.2)
        twin.add_point("ball", "other")
        twin.settings["dt"] = 0.01
        assert scene.built() is built
        assert str(scene.to_dict()) == before
        scene.add_sphere("other", 0.02)  # The name is still free here.
        assert twin.nv == scene.nv
        assert str(twin.to_dict()) != str(scene.to_dict())

    def test_a_deep_copy_has_its_own_start(self):
        scene = Scene()
        scene.add_sphere("ball", 0.1, placement=(0.0, 0.0, 1.0))
        scene.q0 = scene.neutral()
        scene.core()  # The engine's scene cannot be copied, and need not be.
        twin = copy.deepcopy(scene)
        twin.q0[2] = 2.0
        assert scene.q0[2] == 1.0
        assert copy.copy(scene).core() is twin.core() is scene.core()


def test_friction_and_armature_of_a_part_leave_its_free_base_out():
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    hinge = model.addJoint(base, pin.JointModelRZ(), pin.SE3.Identity(), "hinge")
    for joint in (base, hinge):
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    scene = Scene.from_pinocchio(model, pin.GeometryModel())
    scene.set_joint("*", friction=0.5, armature=0.25, damping=0.1)
    own = {name: scene._joints.of(name) for name in ("base", "hinge")}
    assert (own["base"].friction, own["base"].armature) == (None, None)
    assert (own["hinge"].friction, own["hinge"].armature) == (0.5, 0.25)
    assert np.all(own["base"].damping == 0.1)  # which a free joint has, too
    for refused in ({"friction": 0.5}, {"armature": 0.25}):
        with pytest.raises(InputError, match="'base'"):
            scene.set_joint("base", **refused)
