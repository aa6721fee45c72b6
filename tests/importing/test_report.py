"""The import report: everything that is used, changed, ignored or refused is reported."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from contactvi.errors import InputError, SceneError, UnsupportedJointError
from contactvi.importing.hulls import crowded_text, hull_of_points
from contactvi.importing.report import ImportReport
from contactvi.scene.scene import Scene
from contactvi.scene.toml import load_scene

ROBOTS = "example-robot-data://robots/"
HAND = ROBOTS + "allegro_hand_description/urdf/allegro_right_hand.urdf"


def loaded(file: str, **options) -> Scene:
    scene = Scene()
    scene.add_urdf(ROBOTS + file, **options)
    return scene


def report_of(file: str, **options) -> ImportReport:
    return loaded(file, **options).report


def names(report: ImportReport, use: str, text: str) -> set[str]:
    return {note.name for note in report.all_notes(use) if text in note.text}


def test_allegro():
    report = report_of("allegro_hand_description/urdf/allegro_right_hand.urdf")
    (part,) = report.parts
    joints = {joint.name for joint in part.joints}
    assert len(joints) == 16
    assert names(report, "suspicious", "damping") == joints
    assert names(report, "ignored", "joint friction") == joints
    assert names(report, "ignored", "effort and velocity") == joints
    assert sum(body.mass for body in part.bodies) == pytest.approx(0.4154 + 0.5395, abs=1e-4)
    masses = {body.name: body.mass for body in part.bodies}
    assert (masses["link_3.0"], masses["link_3.0_tip"]) == pytest.approx((0.0096, 0.0168), abs=1e-12)
    row = next(joint for joint in part.joints if joint.name == "joint_12.0")
    assert (row.lower, row.upper, row.damping, row.friction, row.limited) == (0.263, 1.396, 3.0, 10.0, True)
    assert "Box 0.0408 x 0.113 x 0.095" in {shape.shape for shape in part.geometries}
    text = str(report)
    for word in (*joints, *masses, "Collision pairs: 185 tested, 21 not", "6.83 mm deep", "0 refused"):
        assert word in text


def test_damping_that_was_replaced_is_no_longer_suspicious():
    scene = Scene()
    scene.add_urdf(ROBOTS + "allegro_hand_description/urdf/allegro_right_hand.urdf")
    scene.set_joint("joint_1*", damping=1e-3)
    assert len(names(scene.report, "suspicious", "damping")) == 9
    assert len(names(scene.report, "changed", "damping set to 0.001")) == 7


def test_limits_of_a_model(tmp_path):
    """Limits are on by default, off for a whole model in code and in files; the report shows what is simulated."""
    on, off = Scene(), Scene()
    on.add_urdf(HAND)
    hand = off.add_urdf(HAND, limits=False, prefix="a/")
    assert on.built().arrays.limits.sum() == 16
    assert not off.built().arrays.limits.any()
    off.set_joint("a/joint_0.0", limits=True)
    assert off.built().arrays.limits.sum() == 1
    rows = {row.name: row.limited for row in off.report.parts[0].joints}
    assert [name for name, limited in rows.items() if limited] == ["a/joint_0.0"]
    assert len(hand.joints) == 16
    text = f'[[urdf]]\npath = "{HAND}"\nlimits = false\n'
    (tmp_path / "hand.toml").write_text(text)
    assert not load_scene(tmp_path / "hand.toml").built().arrays.limits.any()
    (tmp_path / "hand.toml").write_text(text.replace("false", "[0.0, 1.0]"))
    with pytest.raises(InputError, match=r"\[\[urdf\]\] 1: limits is not usable: expected True or False"):
        load_scene(tmp_path / "hand.toml")


def test_limits_upside_down_are_none(tmp_path):
    (tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="base"/><link name="rod"><inertial><mass value="1"/><inertia ixx="1" iyy="1"'
        ' izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="revolute"><parent link="base"/>'
        '<child link="rod"/><axis xyz="0 1 0"/><limit lower="0" upper="0" effort="1" velocity="1"/></joint></robot>'
    )
    scene = Scene()
    scene.add_urdf(tmp_path / "arm.urdf")
    assert not scene.built().arrays.limits.any()
    assert "limits lower >= upper (0, 0): treated as no limit" in str(scene.report)
    assert re.search(r"j +revolute +universe +0 +0 +none", str(scene.report))


def test_talos_mimic_tags_and_hulls():
    scene = loaded("talos_data/robots/talos_full_v2.urdf", base="free")
    report = scene.report
    (part,) = report.parts
    tagged = {joint.name for joint in part.joints if joint.mimic}
    # A text search finds 24: twelve are <mimicJoint> of Gazebo plugins.
    assert len(tagged) == 12
    assert tagged == names(report, "used", "mimic tag: a coupled joint")
    assert {element.name for element in scene.elements} == {f"mimic_{name}" for name in tagged}
    free = loaded("talos_data/robots/talos_full_v2.urdf", base="free", mimic=False)
    assert tagged == names(free.report, "suspicious", "mimic") == names(free.report, "ignored", "mimic tag")
    assert not free.elements
    assert part.joints[0].type == "free"
    assert len(names(report, "changed", "convex hull")) == 47
    assert all("hull of" in shape.note for shape in part.geometries if "Hull" in shape.shape)
    assert {"<transmission>", "<gazebo>"} <= {note.name for note in report.all_notes("ignored")}


@pytest.mark.parametrize(
    ("file", "joints"), [("panda_description/urdf/panda.urdf", 9), ("baxter_description/urdf/baxter.urdf", 19)]
)
def test_other_robots(file, joints):
    report = report_of(file)
    assert len(report.parts[0].joints) == joints
    assert not report.refused


@pytest.mark.long
def test_g1_with_hands():
    report = report_of("g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", base="free")
    assert len(report.parts[0].joints) == 44
    assert len(names(report, "changed", "convex hull")) == 38


def urdf(inertia: str, mass: str = "1", limit: str = 'lower="-1" upper="1"', dynamics: str = "") -> str:
    return f"""<robot name="r"><link name="a"/>
      <link name="b"><inertial><mass value="{mass}"/><inertia {inertia} ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
      <limit {limit} effort="1" velocity="1"/>{dynamics}<safety_controller k_velocity="1"/></joint>
      <transmission name="t"/></robot>"""


GOOD = 'ixx="1" iyy="1" izz="1"'


@pytest.mark.parametrize(
    ("text", "use", "finding"),
    [
        (urdf(GOOD, limit='lower="0" upper="0"'), "suspicious", "lower >= upper"),
        (urdf(GOOD, limit='lower="1" upper="-1"'), "suspicious", "lower >= upper"),
        (urdf('ixx="1" iyy="1" izz="3"'), "suspicious", "triangle inequality"),
        (urdf('ixx="-1" iyy="1" izz="1"'), "suspicious", "negative moment"),
        (urdf(GOOD, mass="0"), "suspicious", "no mass"),
        (urdf(GOOD, dynamics='<dynamics damping="1e4" friction="2"/>'), "suspicious", "dies within 0.0001 s"),
        (urdf(GOOD, dynamics='<dynamics friction="2"/>'), "ignored", "joint friction"),
        (urdf(GOOD), "ignored", "safety_controller"),
        (urdf(GOOD), "ignored", "effort and velocity"),
        (urdf(GOOD).replace('name="r"', ""), "changed", "no name"),
    ],
)
def test_single_findings(tmp_path: Path, text: str, use: str, finding: str):
    file = tmp_path / "r.urdf"
    file.write_text(text)
    scene = Scene()
    scene.add_urdf(file)
    assert names(scene.report, use, finding)


def test_good_data_are_not_suspicious(tmp_path: Path):
    file = tmp_path / "r.urdf"
    file.write_text(urdf(GOOD))
    scene = Scene()
    scene.add_urdf(file)
    assert not scene.report.suspicious
    assert not scene.report.refused


def test_a_refused_model_leaves_its_report():
    model = pin.Model()
    for k, kind in enumerate((pin.JointModelRX, pin.JointModelSphericalZYX)):
        model.addJoint(k, kind(), pin.SE3.Identity(), f"j{k}")
        model.appendBodyToJoint(k + 1, pin.Inertia.Random(), pin.SE3.Identity())
    with pytest.raises(UnsupportedJointError) as caught:
        Scene.from_pinocchio(model)
    assert "JointModelSphericalZYX is not supported" in ImportReport([caught.value.report]).text()


class TestHulls:
    def test_hull_of_a_cube(self):
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
        inside = 0.2 + 0.6 * np.random.default_rng(0).random((50, 3))
        hull = hull_of_points(np.vstack([inside, corners]), "cube")
        assert hull.num_points == 8
        assert hull.computeVolume() == pytest.approx(1.0, abs=1e-14)

    @pytest.mark.parametrize("count", [400, 2000])
    def test_a_finely_divided_disc_keeps_its_vertices(self, count):
        angle = 2 * np.pi * np.arange(count) / count
        ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
        hull = hull_of_points(np.vstack([ring, ring + [0, 0, 1.0]]), "disc")
        assert hull.num_points == 2 * count
        assert hull.computeVolume() == pytest.approx(0.5 * count * np.sin(2 * np.pi / count), rel=1e-13)
        assert crowded_text(hull) == "", "its fans lie in planes"

    @pytest.mark.parametrize(
        "points", [np.zeros((3, 3)), np.zeros((9, 3)), np.eye(4)[:, [0, 1, 0]], np.full((8, 3), np.nan)]
    )
    def test_what_encloses_nothing_is_an_error_and_no_crash(self, points):
        with pytest.raises(SceneError, match="expected a solid"):
            hull_of_points(points, "mesh")
