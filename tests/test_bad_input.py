"""Bad models and arguments: each raises an error of contactvi with expected and got, and never crashes the interpreter.

Several of these end the process or pass silently in Pinocchio 4.1, urdfdom or coal 3.0: see urdf.py, hulls.py.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi
from contactvi.errors import ContactviError, InputError, SceneError
from contactvi.scene.scene import Scene
from helpers.extras import needs_mujoco

LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def link(name: str, mass: str = "1", inside: str = "", inertia: str = "1") -> str:
    moments = f'ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"'
    return f'<link name="{name}"><inertial><mass value="{mass}"/><inertia {moments}/></inertial>{inside}</link>'


def joint(name: str = "j", parent: str = "a", child: str = "b", kind: str = "revolute", inside: str = LIMIT) -> str:
    axis = "" if "<axis" in inside else '<axis xyz="1 0 0"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{axis}{inside}</joint>'


def robot(*parts: str) -> str:
    return f'<robot name="r">{"".join(parts)}</robot>'


def shape(text: str) -> str:
    return robot(link("a"), link("b", inside=f"<collision><geometry>{text}</geometry></collision>"), joint())


def chain(count: int) -> str:
    joints = (joint(f"j{k}", f"l{k}", f"l{k + 1}") for k in range(count))
    return robot(*(link(f"l{k}") for k in range(count + 1)), *joints)


URDFS = {
    "empty": ("", "Broken XML"),
    "broken": ("<robot name='r'>\n<link", "line 2"),
    "binary": ("\x00\x01\x02", "Broken XML"),
    "other XML": ("<html/>", "<html>"),
    "MJCF": ("<mujoco/>", "add_mjcf"),
    "SDF": ("<sdf/>", "SDF is not supported"),
    "xacro": (
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="x"/></robot>',
        "xacro",
    ),
    "deep": ("<robot name='r'><link name='a'/>" + "<x>" * 900 + "</x>" * 900 + "</robot>", "nested too deeply"),
    "long chain": (chain(5000), "at most 1500 joints"),
    "digits of Python": (robot(link("a", mass="1_0")), "finite number"),
    "other digits": (robot(link("a", mass="\u0661")), "finite number"),
    "no-break space": (robot(link("a", mass="1\u00a0")), "finite number"),
    "no link": (robot(), "no link"),
    "link without a name": (robot("<link/>"), "without a name"),
    "two links of a name": (robot(link("a"), link("a")), "'a'"),
    "two joints of a name": (robot(link("a"), link("b"), link("c"), joint(), joint(child="c")), "'j'"),
    "unknown link": (robot(link("a"), link("body"), joint(child="bod")), "Did you mean 'body'"),
    "two roots": (robot(link("a"), link("b")), "one tree"),
    "loop": (robot(link("a"), link("b"), joint(), joint("k", "b", "a")), "one tree"),
    "closed chain": (
        robot(link("a"), link("b"), link("c"), joint(), joint("k", "a", "c"), joint("l", "c")),
        "two joints",
    ),
    "no limit": (robot(link("a"), link("b"), joint(inside="")), "<limit"),
    "joint type": (robot(link("a"), link("b"), joint(kind="revolut")), "Did you mean 'revolute'"),
    "zero axis": (robot(link("a"), link("b"), joint(inside=f'<axis xyz="0 0 0"/>{LIMIT}')), "nonzero"),
    "axis of two": (robot(link("a"), link("b"), joint(inside=f'<axis xyz="0 1"/>{LIMIT}')), "3 finite"),
    "nan origin": (robot(link("a"), link("b"), joint(inside=f'<origin xyz="nan 0 0"/>{LIMIT}')), "finite"),
    "mass in words": (robot(link("a"), link("b", mass="heavy"), joint()), "'heavy'"),
    "nan mass": (robot(link("a"), link("b", mass="nan"), joint()), "finite"),
    "infinite inertia": (robot(link("a"), link("b", inertia="inf"), joint()), "finite"),
    "negative mass": (robot(link("a"), link("b", mass="-1"), joint()), ">= 0 kg"),
    "zero mass": (robot(link("a"), link("b", mass="0", inertia="0"), joint()), "moves no mass"),
    "mass of nearly zero": (
        robot(link("a"), link("b", mass="5e-324", inertia="5e-324"), joint(kind="floating")),
        "joint 'j' moves no mass",
    ),
    "no inertial": (robot(link("a"), '<link name="b"/>', joint()), "moves no mass"),
    "negative damping": (robot(link("a"), link("b"), joint(inside=LIMIT + '<dynamics damping="-1"/>')), "damping"),
    "negative radius": (shape('<sphere radius="-1"/>'), "> 0"),
    "nan radius": (shape('<sphere radius="nan"/>'), "finite"),
    "flat box": (shape('<box size="0 1 1"/>'), "> 0"),
    "unknown shape": (shape('<torus radius="1"/>'), "<torus>"),
    "no shape": (shape(""), "none"),
    "missing mesh": (shape('<mesh filename="package://nowhere/m.stl"/>'), "package_dirs"),
    "mesh on the web": (shape('<mesh filename="http://x/m.stl"/>'), "http://"),
    "empty mesh": (shape('<mesh filename="empty.stl"/>'), "empty.stl"),
    "not a mesh": (shape('<mesh filename="junk.stl"/>'), "junk.stl"),
    "flat mesh": (shape('<mesh filename="flat.stl"/>'), r"in a plane"),
    "one triangle": (shape('<mesh filename="one.stl"/>'), "fewer than 4"),
    "nan mesh": (shape('<mesh filename="nan.stl"/>'), "not finite"),
    "mesh scaled to nothing": (shape('<mesh filename="flat.stl" scale="0 0 0"/>'), "nonzero"),
}


def mujoco(*bodies: str, head: str = "", tail: str = "") -> str:
    return f'<mujoco model="m">{head}<worldbody>{"".join(bodies)}</worldbody>{tail}</mujoco>'


def body(inside: str = '<joint name="h"/><geom type="sphere" size="1"/>', where: str = "") -> str:
    return f'<body name="a" {where}>{inside}</body>'


MJCFS = {
    "broken": ("<mujoco>", "Broken XML"),
    "URDF": ("<robot/>", "add_urdf"),
    "nothing": ("<mujoco/>", "nothing in it"),
    "no world": ("<mujoco><asset/></mujoco>", "nothing in it"),
    "two bodies of a name": (mujoco(body(), body()), "repeated name 'a'"),
    "far place": (mujoco(body('<body><geom size="1"/><geom size="1" pos="0 0 1e200"/></body>')), "not finite"),
    "nan place": (mujoco(body(where='pos="nan 0 0"')), "finite"),
    "words for numbers": (mujoco(body(where='pos="a 0 0"')), "bad format in attribute 'pos'"),
    "too few numbers": (mujoco(body(where='pos="1 0"')), "pos"),
    "negative size": (mujoco(body('<joint/><geom type="sphere" size="-1"/>')), "size"),
    "zero axis": (mujoco(body('<joint axis="0 0 0"/><geom type="sphere" size="1"/>')), "axis"),
    "rotation of a body": (mujoco(body(where='quat="1 0 0 1e155"')), "rotation of body 'a' is lost"),
    "rotation of a site": (
        mujoco(body('<joint/><geom size="1"/><site name="s" quat="1 0 0 1e155"/>')),
        "rotation of site 's' is lost",
    ),
    "rotation of a weld": (
        mujoco(body(), tail='<equality><weld name="w" body1="a" relpose="0 0 0 1 0 0 1e155"/></equality>'),
        "rotation of equality 'w' is lost",
    ),
    "no mass": (mujoco(body("<joint/>")), "mass and inertia of moving bodies"),
    "joint type": (mujoco(body('<joint type="wobble"/><geom type="sphere" size="1"/>')), "invalid keyword: 'wobble'"),
    "shape": (mujoco(body('<joint/><geom type="wobble" size="1"/>')), "invalid keyword: 'wobble'"),
    "missing include": (mujoco('<include file="none.xml"/>'), "none.xml"),
    "include without a file": (mujoco("<include/>"), "include"),
    "circular include": (mujoco('<include file="model.xml"/>'), "already included"),
    "missing mesh": (mujoco(body(), head='<asset><mesh name="t" file="no.stl"/></asset>'), "no.stl"),
    "unknown mesh": (mujoco(body('<joint/><geom type="mesh" mesh="t"/>')), "mesh"),
    "unknown joint of an equality": (mujoco(body(), tail='<equality><joint joint1="x"/></equality>'), "'x'"),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    def stl(name: str, *triangles: str) -> None:
        loops = ["facet normal 0 0 1 outer loop " + t + " endloop endfacet" for t in triangles]
        (tmp_path / name).write_text("solid x\n" + "\n".join(loops).replace(" vertex", "\nvertex") + "\nendsolid x\n")

    first, second = "vertex 0 0 0 vertex 1 0 0 vertex 0 1 0", "vertex 1 0 0 vertex 1 1 0 vertex 0 1 0"
    stl("flat.stl", first, second)
    stl("one.stl", first)
    stl("nan.stl", first, "vertex 0 0 0 vertex 1 0 0 vertex nan 0 1", "vertex 0 0 0 vertex 0 1 0 vertex 0 0 1")
    thin = ["vertex 0 0 0 vertex 1 0 0 vertex 0 1 0", "vertex 0 0 0 vertex 1 0 0 vertex .2 .2 1e-9"]
    stl("thin.stl", *thin, "vertex 1 0 0 vertex 0 1 0 vertex .2 .2 1e-9", "vertex 0 1 0 vertex 0 0 0 vertex .2 .2 1e-9")
    (tmp_path / "empty.stl").touch()
    (tmp_path / "junk.stl").write_bytes(bytes(range(256)) * 10)
    return tmp_path


@pytest.mark.parametrize("case", URDFS)
def test_urdf(folder: Path, case: str):
    text, says = URDFS[case]
    file = folder / "model.urdf"
    file.write_text(text)
    with pytest.raises(SceneError, match=says) as caught:
        Scene().add_urdf(file)
    assert caught.value.path
    if caught.value.report is not None:
        assert caught.value.report.notes


@needs_mujoco
@pytest.mark.parametrize("case", MJCFS)
def test_mjcf(folder: Path, case: str):
    text, says = MJCFS[case]
    file = folder / "model.xml"
    file.write_text(text)
    with pytest.raises(SceneError, match=says):
        Scene().add_mjcf(file)


@pytest.mark.parametrize("mesh", ["flat.stl", "nan.stl", "thin.stl"])
def test_meshes_that_kill_a_process_do_not_kill_ours(folder: Path, mesh: str):
    """A process of its own runs it, because a failure would end the test runner."""
    (folder / "model.urdf").write_text(shape(f'<mesh filename="{mesh}"/>'))
    code = f"""
import sys; sys.path.insert(0, {str(Path(contactvi.__file__).parents[1])!r})
from contactvi import Scene, SceneError
try:
    Scene().add_urdf({str(folder / "model.urdf")!r})
except SceneError:
    print("refused")
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout.strip()) == (0, "refused"), run.stderr


class TestPaths:
    def test_missing_file_names_the_nearest(self, folder: Path):
        (folder / "robot.urdf").write_text(robot(link("a")))
        with pytest.raises(SceneError, match=r"Did you mean '.*robot\.urdf'"):
            Scene().add_urdf(folder / "robto.urdf")

    def test_only_similar_names_of_models_and_scenes_are_suggested(self, folder: Path):
        for name in ("pyproject.toml", "robot.py", "ball.toml"):
            (folder / name).touch()
        (folder / "models").mkdir()
        for wrong, right in {
            "nothere.toml": "Name one of the files in .*: ball.toml",
            "pyprojekt.toml": "Name one of the files in .*: ball.toml",
            "robot.urdf": "has no .urdf file like it",
            "bal.toml": r"Did you mean '.*ball\.toml'",
            "ball.tml": r"Did you mean '.*ball\.toml'",
            "model/ball.toml": "Did you mean '.*models'",
            "elsewhere/ball.toml": "Correct 'elsewhere'",
        }.items():
            with pytest.raises(SceneError, match=right):
                contactvi.load_scene(folder / wrong)

    @pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs a device")
    def test_a_device_is_no_file(self):
        with pytest.raises(SceneError, match="a regular file, got /dev/zero, a device") as caught:
            contactvi.load_scene("/dev/zero")
        assert "Did you mean" not in caught.value.remedy

    def test_folder_lists_its_models(self, folder: Path):
        (folder / "robot.urdf").touch()
        with pytest.raises(SceneError, match=r"robot\.urdf"):
            Scene().add_urdf(folder)

    @pytest.mark.parametrize(
        "path", ["", None, 3, "example-robot-data://robots/nothing.urdf", "package://nowhere/x.urdf"]
    )
    def test_no_path(self, path):
        with pytest.raises(ContactviError):
            Scene().add_urdf(path)


MINIMAL = Path(__file__).parents[1] / "models" / "damped_pendulum.urdf"
ARGUMENTS = {
    "gravity shape": (lambda s: Scene(gravity=(0, 0)), r"\(3,\)"),
    "gravity nan": (lambda s: Scene(gravity=(0, 0, np.nan)), "finite"),
    "gravity words": (lambda s: Scene(gravity="down"), "3 numbers"),
    "radius": (lambda s: s.add_sphere("x", -1.0), "> 0"),
    "radius word": (lambda s: s.add_sphere("x", "big"), "radius"),
    "radius bool": (lambda s: s.add_sphere("x", True), "radius"),
    "radius NumPy bool": (lambda s: s.add_sphere("x", np.True_), "radius"),
    "radius array": (lambda s: s.add_sphere("x", np.array([1.0])), "radius"),
    "radius too large for a float": (lambda s: s.add_sphere("x", 10**400), "radius"),
    "limits word": (lambda s: s.add_urdf(MINIMAL, limits="yes"), "True or False"),
    "mass zero": (lambda s: s.add_sphere("x", 1.0, 0.0), "mass"),
    "mass nan": (lambda s: s.add_sphere("x", 1.0, np.nan), "mass"),
    "mass infinite": (lambda s: s.add_sphere("x", 1.0, np.inf), "mass"),
    "name": (lambda s: s.add_sphere("", 1.0), "non-empty"),
    "name type": (lambda s: s.add_sphere(3, 1.0), "non-empty"),
    "size": (lambda s: s.add_box("x", (1, 2)), r"\(3,\)"),
    "size sign": (lambda s: s.add_box("x", (1, 2, 0)), "> 0"),
    "length": (lambda s: s.add_capsule("x", 1.0, 0.0), "length"),
    "color": (lambda s: s.add_sphere("x", 1.0, color=(1, 0)), r"\(4,\)"),
    "normal": (lambda s: s.add_halfspace((0, 0, 0)), "nonzero"),
    "offset": (lambda s: s.add_halfspace((0, 0, 1), np.nan), "offset"),
    "quaternion": (lambda s: s.add_sphere("x", 1.0, placement=[0, 0, 0, 0, 0, 0, 2]), "length 1"),
    "placement shape": (lambda s: s.add_sphere("x", 1.0, placement=[0, 0]), "xyz"),
    "placement nan": (lambda s: s.add_sphere("x", 1.0, placement=[0, 0, np.nan]), "finite"),
    "placement matrix": (lambda s: s.add_sphere("x", 1.0, placement=2 * np.eye(4)), "rigid"),
    "placement word": (lambda s: s.add_sphere("x", 1.0, placement="here"), "xyz"),
    "base": (lambda s: s.add_urdf("x", base="loose"), "'fixed' or 'free'"),
    "restitution": (lambda s: s.set_contact(restitution=1.1), r"\[0, 1\]"),
    "restitution nan": (lambda s: s.set_contact(restitution=np.nan), r"\[0, 1\]"),
    "friction": (lambda s: s.set_contact(friction=-0.1), ">= 0"),
    "body": (lambda s: s.set_contact("bal", restitution=0.1), "Did you mean 'ball'"),
    "body type": (lambda s: s.set_contact(3, restitution=0.1), "a handle"),
    "pair": (lambda s: s.disable_pair("ball", "grund"), "Did you mean 'ground'"),
    "joint": (lambda s: s.set_joint("bal", damping=1.0), "Did you mean 'ball'"),
    "joint of a fixed body": (lambda s: s.set_joint("ground", damping=1.0), "with joints"),
    "spring of a free body": (lambda s: s.set_joint("ball", stiffness=1.0), "free"),
    "stiffness": (lambda s: s.set_joint("hinge", stiffness=-1.0), ">= 0"),
    "damping": (lambda s: s.set_joint("hinge", damping=np.inf), "damping"),
    "damping shape": (lambda s: s.set_joint("hinge", damping=(1.0, 2.0)), "damping"),
    "rest": (lambda s: s.set_joint("hinge", rest=(1.0, 2.0)), "rest"),
    "limits": (lambda s: s.set_joint("hinge", limits=(1.0, -1.0)), "lower < upper"),
    "limits shape": (lambda s: s.set_joint("hinge", limits=(1.0,)), r"\(2,\)"),
    "limit restitution": (lambda s: s.set_joint("hinge", restitution=2.0), r"\[0, 1\]"),
    "configuration joint": (lambda s: s.configuration({"hing": 1.0}), "Did you mean 'hinge'"),
    "configuration value": (lambda s: s.configuration({"hinge": "far"}), "hinge"),
    "configuration quaternion": (lambda s: s.configuration({"ball": [0, 0, 0, 0, 0, 0, 0]}), "length 1"),
    "configuration base": (lambda s: s.configuration({}, base=np.zeros(3)), r"\(8,\)"),
    "velocity": (lambda s: s.velocity({"ball": (1, 2)}), "linear, angular"),
    "velocity nan": (lambda s: s.velocity({"hinge": np.nan}), "hinge"),
    "q_index": (lambda s: s.q_index("*"), "one joint"),
    "model": (lambda s: Scene.from_pinocchio("model"), "pin.Model"),
    "geometry": (lambda s: Scene.from_pinocchio(pin.Model(), pin.Model()), "pin.GeometryModel"),
}


@pytest.fixture
def scene() -> Scene:
    model = pin.Model()
    model.appendBodyToJoint(
        model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "hinge"),
        pin.Inertia.FromSphere(1.0, 1.0),
        pin.SE3.Identity(),
    )
    scene = Scene.from_pinocchio(model)
    scene.add_sphere("ball", 0.1)
    scene.add_halfspace()
    return scene


@pytest.mark.parametrize("case", ARGUMENTS)
def test_argument(scene: Scene, case: str):
    call, says = ARGUMENTS[case]
    before = scene.to_dict()
    with pytest.raises(InputError, match=says) as caught:
        call(scene)
    assert caught.value.expected
    assert caught.value.got
    assert str(scene.to_dict()) == str(before)  # A refused call changes nothing.


def test_numbers_of_array_libraries():
    """Arrays without dimensions and NumPy's truth values are what they hold."""
    scene = Scene()
    scene.add_sphere("ball", np.array(0.1), np.float32(2.0), free=np.True_)
    assert scene.model.inertias[1].mass == 2.0


def one_body(shape: coal.CollisionGeometry, inertia: pin.Inertia | None = None) -> tuple[pin.Model, pin.GeometryModel]:
    model, geometry = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, inertia or pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    geometry.addGeometryObject(pin.GeometryObject("shape", joint, pin.SE3.Identity(), shape))
    return model, geometry


@pytest.mark.parametrize(
    ("shape", "says"),
    [
        (coal.Plane(np.array([0.0, 0.0, 1.0]), 0.0), "coal.Halfspace"),
        (coal.Cone(1.0, 1.0), "Cone"),
        (coal.Sphere(-1.0), "sizes > 0"),
        (coal.Sphere(np.nan), "sizes > 0"),
        (coal.Box(1.0, 0.0, 1.0), "sizes > 0"),
        (coal.Halfspace(np.array([0.0, 0.0, 1.0]), np.nan), "Halfspace"),
        (coal.BVHModelOBBRSS(), "fewer than 4"),
    ],
)
def test_geometry_of_a_pinocchio_model(shape: coal.CollisionGeometry, says: str):
    with pytest.raises(SceneError, match=says):
        Scene.from_pinocchio(*one_body(shape))


def test_inertia_of_a_pinocchio_model():
    bad = pin.Inertia(np.nan, np.zeros(3), np.eye(3))
    with pytest.raises(SceneError, match="finite"):
        Scene.from_pinocchio(*one_body(coal.Sphere(1.0), bad))
    with pytest.raises(SceneError, match="moves no mass"):
        Scene.from_pinocchio(*one_body(coal.Sphere(1.0), pin.Inertia.Zero()))


@pytest.mark.parametrize(("what", "dof"), [("damping", 1), ("damping", 4), ("armature", slice(0, 6))])
def test_numbers_that_the_engine_cannot_have(what: str, dof: int | slice):
    model, geometry = one_body(coal.Sphere(1.0))
    getattr(model, what)[dof] = 0.1
    with pytest.raises(SceneError, match=f"{what} of the free joint 'body'"):
        Scene.from_pinocchio(model, geometry)


def test_geometry_on_a_joint_that_is_not_there():
    model, geometry = one_body(coal.Sphere(1.0))
    geometry.geometryObjects[0].parentJoint = 7
    with pytest.raises(SceneError, match="parent joint below 2"):
        Scene.from_pinocchio(model, geometry)


@pytest.mark.parametrize("matrix", [2.0 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan)])
def test_place_of_a_geometry_that_is_no_rotation(matrix: np.ndarray):
    model, geometry = one_body(coal.Sphere(1.0))
    place = pin.SE3.Identity()
    place.rotation = matrix
    pictures = geometry.copy()
    pictures.geometryObjects[0].placement = place
    with pytest.raises(SceneError, match="placement of geometry 'shape': expected finite numbers and a rotation"):
        Scene.from_pinocchio(model, geometry, pictures)


def test_a_free_body_of_nearly_no_mass(tmp_path):
    (tmp_path / "speck.urdf").write_text(robot(link("a", mass="5e-324")))
    with pytest.raises(SceneError, match="moves no mass") as caught:
        Scene().add_urdf(tmp_path / "speck.urdf", base="free")
    assert caught.value.joint == "root_joint"


def test_a_base_without_mass_is_named(tmp_path):
    """The cart slides on a rail of no mass: what has to get an inertial is the rail, before the joint."""
    text = robot('<link name="rail"/>', link("cart"), joint(kind="prismatic", parent="rail", child="cart"))
    (tmp_path / "cart.urdf").write_text(text)
    with pytest.raises(SceneError, match="moves no mass") as caught:
        Scene().add_urdf(tmp_path / "cart.urdf", base="free")
    assert "Give the link 'rail' an <inertial>" in caught.value.remedy


def test_two_hinges_on_one_axis_with_one_body():
    """Each hinge has the inertia of the body behind it, and turning one against the other moves nothing."""
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "first")
    second = model.addJoint(first, pin.JointModelRZ(), pin.SE3.Identity(), "second")
    model.appendBodyToJoint(second, pin.Inertia(1.0, np.zeros(3), 2.0 * np.eye(3)), pin.SE3.Identity())
    with pytest.raises(SceneError, match="moves no mass") as caught:
        Scene.from_pinocchio(model, pin.GeometryModel())
    assert "others together that moves nothing" in caught.value.got
    assert "2 about this joint alone" in caught.value.got


@needs_mujoco
@pytest.mark.parametrize("size", [1e-200, 1e-10, 1e100, 1e153])
def test_a_quaternion_of_any_length_is_a_rotation(tmp_path, size: float):
    """A body on a hinge, a free one and a site, each a right angle about z from what carries it."""
    turn = f'quat="{size} 0 0 {size}"'
    hinged = f'<body name="a" {turn}><joint/><geom size="1"/><site name="s" {turn}/></body>'
    free = f'<body name="b" pos="9 0 0" {turn}><freejoint/><geom size="1"/></body>'
    (tmp_path / "turned.xml").write_text(mujoco(hinged, free))
    scene = Scene()
    scene.add_mjcf(tmp_path / "turned.xml")
    model, data = scene.model, scene.model.createData()
    pin.framesForwardKinematics(model, data, scene.neutral())
    for name, angle in (("a", np.pi / 2), ("b", np.pi / 2), ("s", np.pi)):
        rotation = data.oMf[model.getFrameId(name)].rotation
        np.testing.assert_allclose(rotation, pin.rpy.rpyToMatrix(0.0, 0.0, angle), atol=1e-15)


def test_a_loop_of_links_beside_the_tree(tmp_path):
    joint = '<joint name="{}" type="fixed"><parent link="{}"/><child link="{}"/></joint>'
    links = "".join(f'<link name="{name}"/>' for name in "abcd")
    joints = joint.format("j1", "a", "b") + joint.format("j2", "c", "d") + joint.format("j3", "d", "c")
    (tmp_path / "loop.urdf").write_text(f'<robot name="r">{links}{joints}</robot>')
    with pytest.raises(SceneError, match="links form a loop beside the tree: expected one tree, got [cd] - [cd]"):
        contactvi.Scene().add_urdf(tmp_path / "loop.urdf")
