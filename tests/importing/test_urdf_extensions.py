"""What newer readers of URDF, Drake, Bullet and Gazebo put into a file: what it means, and what the report says."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.errors import SceneError

INERTIAL = '<inertial><mass value="1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>'
DRAKE = 'xmlns:drake="http://drake.mit.edu"'


def shape(geometry: str, role: str = "collision", more: str = "") -> str:
    return f"<{role}><geometry>{geometry}</geometry>{more}</{role}>"


def link(name: str, inner: str) -> str:
    return f'<link name="{name}">{INERTIAL}{inner}</link>'


def file_of(folder: Path, inner: str, attributes: str = DRAKE) -> Path:
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="robot" {attributes}>{inner}</robot>')
    return path


def scene_of(folder: Path, inner: str, attributes: str = DRAKE, **options) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_urdf(file_of(folder, inner, attributes), base="free", **options)
    return scene


@pytest.mark.parametrize("tag", ["capsule", "drake:capsule"])
@pytest.mark.parametrize("attributes", [DRAKE, "", 'version="1.1"', 'version="1.2"'])
def test_a_capsule_has_the_length_of_its_cylinder(tag: str, attributes: str, tmp_path: Path, capfd):
    scene = scene_of(tmp_path, link("finger", shape(f'<{tag} radius=".01" length=".08"/>')), attributes)
    (found,) = scene.collision_model.geometryObjects
    assert isinstance(found.geometry, coal.Capsule)
    assert (found.geometry.radius, found.geometry.halfLength) == (0.01, 0.04)
    scene.add_halfspace()
    assert scene.gaps([0, 0, 0.1, 0, 0, 0, 1])[0] == pytest.approx(0.1 - 0.04 - 0.01, abs=1e-15)
    assert cvi.simulate(scene, [0, 0, 0.051, 0, 0, 0, 1], duration=0.05, dt=1e-3).status.ok
    assert capfd.readouterr().err == "", "Pinocchio's reader says what it does not know"


def test_an_ellipsoid_has_half_axes(tmp_path: Path):
    inner = link("egg", shape('<drake:ellipsoid a=".1" b=".2" c=".3"/>', more='<origin xyz="0 0 .05"/>'))
    scene = scene_of(tmp_path, inner)
    (found,) = scene.collision_model.geometryObjects
    np.testing.assert_array_equal(found.geometry.radii, [0.1, 0.2, 0.3])
    scene.add_halfspace()
    assert scene.gaps([0, 0, 1, 0, 0, 0, 1])[0] == pytest.approx(1.0 + 0.05 - 0.3, abs=1e-12)


def test_they_are_pictures_as_well(tmp_path: Path):
    inner = link(
        "body",
        shape('<capsule radius=".01" length=".08"/>', "visual")
        + shape('<box size="1 1 1"/>', "visual")
        + shape('<drake:ellipsoid a=".1" b=".2" c=".3"/>', "visual"),
    )
    part = scene_of(tmp_path, inner)._parts.parts[0]
    kinds = [type(picture.geometry.geometry) for picture in part.load_pictures()]
    assert kinds == [coal.Capsule, coal.Box, coal.Ellipsoid]


@pytest.mark.parametrize(
    ("geometry", "got"),
    [
        ('<capsule radius="0" length="1"/>', "'0'"),
        ('<capsule radius=".1"/>', "None"),
        ('<capsule radius=".1" length="-1"/>', "'-1'"),
        ('<drake:ellipsoid a="1" b="1"/>', "None"),
        ("<ellipsoid/>", "<ellipsoid>"),
    ],
)
def test_wrong_sizes_are_refused_with_link_and_file(geometry: str, got: str, tmp_path: Path):
    with pytest.raises(SceneError, match=f"robot.urdf: .*link 'body': expected .* got {got}") as caught:
        scene_of(tmp_path, link("body", shape(geometry)))
    assert caught.value.remedy


def test_a_rotation_may_be_a_quaternion(tmp_path: Path):
    turn = pin.Quaternion(np.array([0.1, -0.5, 0.3, 0.7])).normalized()
    numbers = " ".join(map(str, 2.0 * turn.coeffs()))  # of any length
    origin = f'<origin xyz="1 2 3" quat_xyzw="{numbers}"/>'
    inner = link("body", shape('<box size="1 2 3"/>', more=origin))
    (found,) = scene_of(tmp_path, inner, 'version="1.1"').collision_model.geometryObjects
    np.testing.assert_allclose(found.placement.rotation, turn.matrix(), rtol=0, atol=1e-14)


@pytest.mark.parametrize("origin", ['rpy="0 0 0" quat_xyzw="0 0 0 1"', 'quat_xyzw="0 0 0 0"', 'quat_xyzw="0 0 1"'])
def test_a_wrong_quaternion_is_refused(origin: str, tmp_path: Path):
    with pytest.raises(SceneError, match="quat_xyzw of"):
        scene_of(tmp_path, link("body", shape('<box size="1 2 3"/>', more=f"<origin {origin}/>")))


THREE = "".join(link(name, shape('<sphere radius=".1"/>')) for name in ("a", "b", "c", "d")) + "".join(
    f'<joint name="j{k}" type="prismatic"><parent link="{parent}"/><child link="{child}"/>'
    f'<origin xyz="{k + 1} 0 0"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
    for k, (parent, child) in enumerate((("a", "b"), ("b", "c"), ("c", "d")))
)


def test_links_of_ignored_groups_do_not_collide(tmp_path: Path):
    groups = (
        '<drake:collision_filter_group name="ends"><drake:member link="a"/><drake:member link="d"/>'
        '<drake:ignored_collision_filter_group name="ends"/></drake:collision_filter_group>'
        '<drake:collision_filter_group name="all"><drake:member_group name="ends"/>'
        '<drake:ignored_collision_filter_group name="middle"/></drake:collision_filter_group>'
        '<drake:collision_filter_group name="middle"><drake:member link="b"/></drake:collision_filter_group>'
    )
    free = scene_of(tmp_path, THREE)
    assert free.pair_names == [("a_0", "c_0"), ("a_0", "d_0"), ("b_0", "d_0")]
    scene = scene_of(tmp_path, THREE + groups)
    assert scene.pair_names == [("a_0", "c_0")]
    assert "groups 'ends' and 'ends'" in str(scene.report)
    with pytest.raises(SceneError, match="group of 'ends': expected the name of a group, got 'nobody'"):
        scene_of(tmp_path, THREE + groups.replace('group name="ends"/></drake:c', 'group name="nobody"/></drake:c', 1))


FRICTION = {
    "drake": shape(
        '<sphere radius=".1"/>',
        more='<drake:proximity_properties><drake:mu_dynamic value="0.3"/><drake:mu_static value="0.4"/>'
        '<drake:hydroelastic_modulus value="1e7"/></drake:proximity_properties>',
    ),
    "bullet": shape('<sphere radius=".1"/>')
    + '<contact><lateral_friction value="0.3"/><rolling_friction value="0.1"/></contact>',
    "gazebo": shape('<sphere radius=".1"/>'),
}
GAZEBO = '<gazebo reference="ball"><mu1>0.5</mu1><mu2>0.3</mu2><kp>1e6</kp><selfCollide>true</selfCollide></gazebo>'


@pytest.mark.parametrize("kind", FRICTION)
def test_friction_of_surfaces_is_read_where_it_is_asked_for(kind: str, tmp_path: Path):
    inner = link("ball", FRICTION[kind]) + (GAZEBO if kind == "gazebo" else "")
    for asked, wanted in ((False, 0.0), (True, 0.3)):
        scene = scene_of(tmp_path, inner, contact_friction=asked)
        scene.add_halfspace()
        assert scene.pair_friction.tolist() == [wanted]
        text = str(scene.report)
        assert ("unless with contact_friction=True" in text) == (not asked)
    scene.set_contact("ball", friction=0.9)
    assert scene.pair_friction.tolist() == [0.9], "what the user sets counts more"


def test_a_negative_coefficient_is_refused(tmp_path: Path):
    inner = link("ball", FRICTION["bullet"].replace("0.3", "-0.3"))
    with pytest.raises(SceneError, match="lateral_friction.*link 'ball': expected a number >= 0, got '-0.3'"):
        scene_of(tmp_path, inner, contact_friction=True)
    assert scene_of(tmp_path, inner).nv == 6


def test_the_report_names_each_tag_once(tmp_path: Path):
    joint = (
        '<joint name="j" type="revolute"><parent link="ball"/><child link="other"/><drake:damping value="1"/>'
        '<limit lower="0" upper="1" effort="1" velocity="1" acceleration="2" drake:acceleration="1"/></joint>'
    )
    other = link("other", FRICTION["drake"] + FRICTION["drake"])
    text = str(scene_of(tmp_path, link("ball", FRICTION["bullet"]) + other + joint + GAZEBO).report)
    for said in (
        "<rolling_friction> of <contact>",
        "<drake:hydroelastic_modulus> of <drake:proximity_properties>",
        "<kp> of <gazebo>",
        "<selfCollide> of <gazebo>",
        "<drake:damping> of <joint>",
        "acceleration of <limit>",
    ):
        assert text.count(f": {said}") == 1 or said == "acceleration of <limit>", said
        assert said in text


@pytest.mark.parametrize("kind", ["ball", "planar", "screw", "universal"])
def test_joints_of_drake_are_refused_by_name(kind: str, tmp_path: Path):
    joint = f'<drake:joint name="hip" type="{kind}"><parent link="a"/><child link="b"/></drake:joint>'
    with pytest.raises(SceneError, match=f"<drake:joint> 'hip': .* got type '{kind}'") as caught:
        scene_of(tmp_path, link("a", "") + link("b", "") + joint)
    assert caught.value.joint == "hip"


def test_a_scene_file_says_it_as_well(tmp_path: Path):
    file_of(tmp_path, link("ball", FRICTION["drake"]))
    page = tmp_path / "scene.toml"
    page.write_text(
        '[[urdf]]\npath = "robot.urdf"\nbase = "free"\ncontact_friction = true\n'
        '[[ellipsoid]]\nname = "egg"\nradii = [0.1, 0.2, 0.3]\nxyz = [0, 0, 2]\n[[halfspace]]\n'
    )
    scene = cvi.load_scene(page)
    friction = {frozenset(pair): mu for pair, mu in zip(scene.pair_names, scene.pair_friction, strict=True)}
    assert friction == {
        frozenset(("ball_0", "egg")): 0.3, frozenset(("ball_0", "ground")): 0.3, frozenset(("egg", "ground")): 0.0,
    }  # fmt: skip
