"""Pairs that are tested by default; every other one has its reason in the report."""

from __future__ import annotations

import warnings
from itertools import combinations
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.importing.report import ADJACENT, BY_FILE, BY_USER, HALFSPACES, NOT_GIVEN, OVERLAP
from contactvi.scene.scene import Scene

ROBOTS = "example-robot-data://robots/"
ALLEGRO = ROBOTS + "allegro_hand_description/urdf/allegro_right_hand.urdf"
IDENTITY = pin.SE3.Identity()


def assert_complete(scene: Scene) -> None:
    """Every two geometries on different bodies are a pair or have a reason, never both."""
    shapes = scene.collision_model.geometryObjects
    possible = {frozenset((a.name, b.name)) for a, b in combinations(shapes, 2) if a.parentJoint != b.parentJoint}
    tested = [frozenset(pair) for pair in scene.pair_names]
    removed = [frozenset((pair.first, pair.second)) for pair in scene.report.removed]
    assert len(tested) + len(removed) == len(possible)
    assert set(tested) | set(removed) == possible


def reason(scene: Scene, a: str, b: str) -> str | None:
    return next((p.reason for p in scene.report.removed if {p.first, p.second} == {a, b}), None)


def test_hand_ball_ground_and_table():
    scene = Scene()
    scene.add_urdf(ALLEGRO)
    scene.add_sphere("ball", 0.03)  # It lies in the palm at the neutral pose, which is a matter of the start.
    scene.add_halfspace((0, 0, 1), -0.5)
    scene.add_box("table", (1, 1, 0.1), free=False, placement=(0, 0, -0.4))
    assert_complete(scene)
    assert reason(scene, "palm_link_0", "link_0.0_0") == ADJACENT
    assert reason(scene, "link_1.0_0", "link_2.0_0") == ADJACENT
    assert reason(scene, "palm_link_0", "link_13.0_0") == OVERLAP
    pairs = {frozenset(pair) for pair in scene.pair_names}
    for body in ("palm_link_0", "ground", "table", "link_0.0_0"):
        assert frozenset(("ball", body)) in pairs
    # The first joints have the world as parent, as the table has, but they are not joined to the table.
    assert frozenset(("link_0.0_0", "table")) in pairs
    assert frozenset(("link_0.0_0", "ground")) in pairs
    # Two bodies fixed to the world never move against each other.
    assert frozenset(("palm_link_0", "ground")) not in pairs
    assert frozenset(("table", "ground")) not in pairs


def test_overlap_is_what_coal_says_at_the_neutral_pose():
    scene = Scene()
    scene.add_urdf(ROBOTS + "panda_description/urdf/panda_collision.urdf")
    assert_complete(scene)
    model, geometry = scene.model, scene.collision_model
    everything = pin.GeometryModel(geometry)
    everything.addAllCollisionPairs()
    data, shapes = model.createData(), everything.createData()
    pin.computeDistances(model, data, everything, shapes, scene.neutral())
    names = [g.name for g in geometry.geometryObjects]
    for pair, result in zip(everything.collisionPairs, shapes.distanceResults, strict=True):
        found = reason(scene, names[pair.first], names[pair.second])
        if found == OVERLAP:
            assert result.min_distance < 0.0
        elif found is None:
            assert result.min_distance > -1e-6


def test_user_switches_win_and_the_last_call_wins():
    scene = Scene()
    scene.add_urdf(ALLEGRO)
    scene.add_sphere("ball", 0.03)
    scene.disable_pair("ball", "palm_link")
    assert reason(scene, "ball", "palm_link_0") == BY_USER
    scene.enable_pair("palm_link", "ball")
    assert reason(scene, "ball", "palm_link_0") is None
    scene.enable_pair("palm_link", "link_13.0")
    assert ("palm_link_0", "link_13.0_0") in scene.pair_names
    assert_complete(scene)


def test_srdf_pairs_are_left_out_with_their_reason(tmp_path: Path):
    srdf = tmp_path / "hand.srdf"
    srdf.write_text(
        '<robot name="h"><disable_collisions link1="link_3.0_tip" link2="link_7.0" reason="Never"/>'
        '<disable_collisions link1="link_3.0_tip" link2="nobody"/></robot>'
    )
    scene = Scene()
    scene.add_urdf(ALLEGRO, srdf=srdf, prefix="r_")
    removed = [pair for pair in scene.report.removed if pair.reason == BY_FILE]
    assert [(p.first, p.second, p.detail) for p in removed] == [("r_link_3.0_tip_0", "r_link_7.0_0", "Never")]
    assert any("nobody" in note.name for note in scene.report.suspicious)
    assert_complete(scene)


def blocks(pairs: bool) -> Scene:
    """Two blocks on rails and a wall, all at the origin: the start of a run puts them apart."""
    model, geometry = pin.Model(), pin.GeometryModel()
    geometry.addGeometryObject(pin.GeometryObject("wall", 0, IDENTITY, coal.Box(0.1, 1.0, 1.0)))
    for name in ("a", "b"):
        joint = model.addJoint(0, pin.JointModelPX(), IDENTITY, name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), IDENTITY)
        geometry.addGeometryObject(pin.GeometryObject(name, joint, IDENTITY, coal.Sphere(0.1)))
    if pairs:
        geometry.addCollisionPair(pin.CollisionPair(1, 2))
    return Scene.from_pinocchio(model, geometry)


def test_bodies_placed_by_the_start_keep_their_pairs():
    assert blocks(pairs=False).pair_names == [("wall", "a"), ("wall", "b"), ("a", "b")]


def test_two_halfspaces_are_no_pair():
    model, geometry = pin.Model(), pin.GeometryModel()
    plate = model.addJoint(0, pin.JointModelPZ(), IDENTITY, "plate")
    model.appendBodyToJoint(plate, pin.Inertia.FromSphere(1.0, 0.1), IDENTITY)
    for joint in (0, plate):
        shape = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        geometry.addGeometryObject(pin.GeometryObject(f"plane_{joint}", joint, IDENTITY, shape))
    scene = Scene.from_pinocchio(model, geometry)
    assert scene.core().npairs == 0
    assert [pair.reason for pair in scene.report.removed] == [HALFSPACES]


def test_given_pairs_are_taken_as_they_are():
    scene = blocks(pairs=True)
    assert scene.pair_names == [("a", "b")]
    assert {pair.reason for pair in scene.report.removed} == {NOT_GIVEN}
    assert_complete(scene)


def test_a_pendulum_that_touches_its_wall_when_hanging_keeps_the_pair():
    model, geometry = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelRY(), IDENTITY, "hinge")
    tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0]))
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), tip)
    geometry.addGeometryObject(pin.GeometryObject("bob", joint, tip, coal.Sphere(0.125)))
    wall = coal.Halfspace(np.array([1.0, 0.0, 0.0]), -0.125)
    geometry.addGeometryObject(pin.GeometryObject("wall", 0, IDENTITY, wall))
    assert Scene.from_pinocchio(model, geometry).pair_names == [("bob", "wall")]


@pytest.mark.parametrize("file", ["talos_data/robots/talos_full_v2.urdf", "baxter_description/urdf/baxter.urdf"])
def test_every_pair_of_a_robot_is_accounted_for(file: str):
    scene = Scene()
    scene.add_urdf(ROBOTS + file)
    assert_complete(scene)


def test_engine_has_the_same_pairs_and_gaps_as_coal():
    scene = Scene()
    scene.add_sphere("a", 0.1, placement=(0, 0, 0.5))
    scene.add_sphere("b", 0.2, placement=(0, 0.7, 0.5))
    scene.add_halfspace((0, 0, 2.0), 0.125)
    core = scene.core()
    assert core.npairs == len(scene.pair_names) == 3
    gap, normal, point_a, point_b = core.gaps(scene.neutral())
    assert gap == pytest.approx([0.4, 0.275, 0.175], abs=1e-15)
    assert normal == pytest.approx(np.array([[0, 1, 0], [0, 0, -1], [0, 0, -1]]), abs=1e-15)
    assert np.einsum("ij,ij->i", point_b - point_a, normal) == pytest.approx(gap, abs=1e-15)
    assert scene.core() is core
    scene.set_contact(restitution=0.3)
    assert scene.core() is not core  # An edit makes a new one.


def test_a_default_that_no_pair_uses_is_warned_of(tmp_path: Path):
    """An MJCF gives its geoms restitution and friction; what is added beside them uses the default."""
    pytest.importorskip("mujoco")
    path = tmp_path / "balls.xml"
    body = '<body pos="{0} 0 1"><freejoint/><geom name="g{0}" size="0.1"/></body>'
    path.write_text(f"<mujoco><worldbody>{body.format(0)}{body.format(1)}</worldbody></mujoco>")
    scene = cvi.Scene.from_mjcf(path)
    with pytest.warns(
        cvi.UnusedSettingWarning, match=r"default restitution 0.6: .*set_contact\(part, restitution=0.6\)"
    ):
        scene.set_contact(restitution=0.6)
    assert not np.any(scene.pair_restitution)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.set_contact(scene.parts[0], restitution=0.6)
        assert np.all(scene.pair_restitution == 0.6)
        scene.add_sphere("mine", 0.1, placement=(5, 0, 1))
        scene.add_halfspace()
        scene.set_contact(friction=0.4)
        bouncing = cvi.Scene()
        bouncing.add_mjcf(path, restitution="solref")
        bouncing.set_contact(restitution=0.6)
        cvi.Scene().set_contact(restitution=0.6)
