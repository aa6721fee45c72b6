"""Parts put on the ground, and parts whose links do not touch each other."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.importing.report import SELF_COLLISION

ROBOTS = "example-robot-data://robots/"
SOLO = ROBOTS + "solo_description/robots/solo12.urdf"
ALLEGRO = ROBOTS + "allegro_hand_description/urdf/allegro_right_hand.urdf"
NORMAL = np.array([0.2, -0.3, 1.0]) / np.linalg.norm([0.2, -0.3, 1.0])


def gap_to(scene: cvi.Scene, q: np.ndarray, ground: str) -> float:
    return min(gap for pair, gap in zip(scene.gap_names, scene.gaps(q), strict=True) if ground in pair)


@pytest.mark.parametrize("height", [-3.0, 0.1, 2.0])
def test_a_robot_stands_on_tilted_ground(height):
    scene = cvi.Scene()
    robot = scene.add_urdf(SOLO, base="free", placement=((0.3, 0.2, height), (0.1, 0.2, 0.4)))
    scene.add_halfspace(NORMAL, 0.25)
    scene.add_sphere("ball", 0.1, placement=(5.0, 0.0, 5.0))
    q = scene.neutral()
    placed = scene.place_on_ground(robot)
    assert abs(gap_to(scene, placed, "ground")) < 1e-15
    # The base moves along the normal, and nothing else does.
    base = scene.q_index("root_joint")
    moved = (placed - q)[base][:3]
    np.testing.assert_allclose(moved, (moved @ NORMAL) * NORMAL, atol=1e-14)
    np.testing.assert_array_equal(np.delete(placed, range(base.start, base.start + 3)),
                                  np.delete(q, range(base.start, base.start + 3)))  # fmt: skip
    cvi.Simulator(scene, dt=1e-3).reset(placed)  # which refuses overlaps


def test_at_the_start_of_the_scene_or_at_a_given_configuration():
    scene = cvi.Scene()
    box = scene.add_box("box", size=(0.2, 0.2, 0.4), placement=(0, 0, 1))
    scene.add_halfspace()
    tilted = scene.configuration({box: ((0.5, 0.0, 3.0), (0.3, 0.0, 0.0))})
    corner = 0.1 * np.sin(0.3) + 0.2 * np.cos(0.3)
    assert scene.place_on_ground(box, tilted)[2] == pytest.approx(corner, abs=1e-15)
    scene.q0 = tilted
    assert scene.place_on_ground("box")[2] == pytest.approx(corner, abs=1e-15)
    scene.q0 = scene.place_on_ground(box, scene.neutral())
    assert scene.q0[2] == pytest.approx(0.2, abs=1e-15)
    assert np.abs(cvi.simulate(scene, duration=0.1, dt=1e-3).q[-1] - scene.q0).max() < 1e-9  # it rests


@pytest.mark.parametrize("shape", ["sphere", "capsule", "cylinder"])
def test_primitives_touch_the_ground(shape):
    scene = cvi.Scene()
    sizes = {"radius": 0.1} if shape == "sphere" else {"radius": 0.1, "length": 0.3}
    body = getattr(scene, f"add_{shape}")("body", **sizes, placement=((0, 0, 0), (0.4, 0.2, 0.0)))
    scene.add_halfspace(NORMAL, -0.1)
    assert abs(gap_to(scene, scene.place_on_ground(body), "ground")) < 1e-15


def test_a_base_whose_joint_is_turned():
    model = pin.Model()
    turn = pin.SE3(pin.rpy.rpyToMatrix(0.4, 0.5, 0.6), np.array([0.1, 0.2, 0.3]))
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), turn, "base")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    frame = model.addFrame(pin.Frame("ball", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    import coal

    shapes = pin.GeometryModel()
    shapes.addGeometryObject(pin.GeometryObject("ball", joint, frame, pin.SE3.Identity(), coal.Sphere(0.1)))
    scene = cvi.Scene.from_pinocchio(model, shapes, name="ball")
    scene.add_halfspace(NORMAL)
    q = scene.place_on_ground("base")
    assert abs(gap_to(scene, q, "ground")) < 1e-15
    assert (turn * pin.XYZQUATToSE3(q)).translation @ NORMAL == pytest.approx(0.1, abs=1e-15)


def test_a_part_may_be_named_by_its_body_or_be_the_only_free_one():
    scene = cvi.Scene()
    robot = scene.add_urdf(SOLO, base="free", placement=(0.0, 0.0, 3.0))
    scene.add_box("table", size=(1, 1, 1), free=False, placement=(9, 0, 5))
    scene.add_halfspace()
    expected = scene.place_on_ground(robot)
    for part in (None, "base_link", "FL_LOWER_LEG", "root_joint"):
        np.testing.assert_array_equal(scene.place_on_ground(part), expected)
    with pytest.raises(cvi.InputError, match="cannot be placed"):
        scene.place_on_ground("table")
    scene.add_sphere("ball", 0.1, placement=(5.0, 0.0, 5.0))
    with pytest.raises(cvi.InputError, match="'root_joint', 'ball'"):
        scene.place_on_ground()


def test_what_cannot_be_placed_is_refused():
    scene = cvi.Scene()
    hand = scene.add_urdf(ALLEGRO, placement=(0, 0, 1))
    box = scene.add_box("box", size=(0.1, 0.1, 0.1), placement=(1, 0, 0))
    table = scene.add_box("table", size=(1, 1, 1), free=False, placement=(9, 0, 0))
    with pytest.raises(cvi.InputError, match="has no ground to stand on"):
        scene.place_on_ground(box)
    scene.add_halfspace()
    with pytest.raises(cvi.InputError, match="'allegro_hand_right' cannot be placed.*base='free'"):
        scene.place_on_ground(hand)
    with pytest.raises(cvi.InputError, match="cannot be placed"):
        scene.place_on_ground(table)
    with pytest.raises(cvi.InputError, match="Unknown part"):
        scene.place_on_ground("bax")
    scene.add_halfspace((1, 0, 0), -3.0, name="wall")
    with pytest.raises(cvi.InputError, match="'box' meets several halfspaces.*'ground', 'wall'.*ground="):
        scene.place_on_ground(box)
    assert gap_to(scene, scene.place_on_ground(box, ground="wall"), "wall") == pytest.approx(0.0, abs=1e-15)


def test_links_of_a_part_without_self_collision_do_not_touch_each_other():
    scene = cvi.Scene()
    hand = scene.add_urdf(ALLEGRO, self_collision=False, placement=(0, 0, 1))
    scene.add_sphere("ball", 0.03, placement=(0, 0, 3))
    scene.add_halfspace()
    own = set(hand.geometries)
    assert not [pair for pair in scene.pair_names if set(pair) <= own]
    assert {name for pair in scene.pair_names for name in pair} >= own - {"palm_link_0"} | {"ball", "ground"}
    assert any(row.reason == SELF_COLLISION for row in scene.report.removed)
    scene.enable_pair("link_3.0_tip", "link_15.0_tip")
    assert [pair for pair in scene.pair_names if set(pair) <= own] == [("link_3.0_tip_0", "link_15.0_tip_0")]


def test_self_collision_of_pinocchios_models_and_scene_files(tmp_path):
    with_pairs = cvi.Scene()
    with_pairs.add_urdf(ALLEGRO)
    geometry = pin.GeometryModel(with_pairs.collision_model)
    assert len(geometry.collisionPairs) > 100
    scene = cvi.Scene.from_pinocchio(with_pairs.model, geometry, self_collision=False)
    assert scene.pair_names == []
    file = tmp_path / "scene.toml"
    file.write_text(f'[[urdf]]\npath = "{ALLEGRO}"\nself_collision = false\n')
    assert cvi.load_scene(file).pair_names == []
    with pytest.raises(cvi.InputError, match="self_collision"):
        cvi.Scene().add_urdf(ALLEGRO, self_collision=0)


def test_an_mjcf_without_self_collision_keeps_its_floor_and_its_other_bodies(tmp_path):
    pytest.importorskip("mujoco")
    file = tmp_path / "two.xml"
    arm = """<body name="{0}1" pos="0 {1} 0.5"><freejoint/><geom name="{0}a" type="sphere" size=".1"/>
      <body name="{0}2" pos=".3 0 0"><joint name="{0}h" axis="0 1 0"/><geom name="{0}b" type="sphere" size=".1"/>
      <body name="{0}3" pos=".3 0 0"><joint axis="0 1 0"/><geom name="{0}c" type="sphere" size=".1"/></body>
      </body></body>"""
    file.write_text(
        '<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>'
        + arm.format("l", 0)
        + arm.format("r", 1)
        + "</worldbody></mujoco>"
    )
    scene = cvi.Scene()
    scene.add_mjcf(file, self_collision=False)
    pairs = {frozenset(pair) for pair in scene.pair_names}
    links = [f"{side}{k}" for side in "lr" for k in "abc"]
    assert pairs == {frozenset(("floor", link)) for link in links} | {
        frozenset((a, b)) for a, b in combinations(links, 2) if a[0] != b[0]
    }
    with pytest.raises(cvi.InputError, match="one free base"):
        scene.place_on_ground("MuJoCo Model")
