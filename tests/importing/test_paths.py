"""Files are found without a hard-coded prefix."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import contactvi
from contactvi.errors import ContactviError, SceneError
from contactvi.importing.paths import example_robot_data_share, resolve_path, resolve_resource
from contactvi.scene.scene import Scene
from contactvi.scene.toml import load_scene
from helpers.extras import needs_mujoco

PACKAGE_XML = "<package><name>{}</name></package>"


def mesh(path: Path) -> Path:
    """A tetrahedron of edge 1."""
    corners = ["0 0 0", "1 0 0", "0 1 0", "0 0 1"]
    faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
    loops = [
        "facet normal 0 0 0\nouter loop\n" + "".join(f"vertex {corners[k]}\n" for k in face) + "endloop\nendfacet\n"
        for face in faces
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("solid t\n" + "".join(loops) + "endsolid t\n")
    return path


def urdf(path: Path, reference: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    geometry = f'<collision><geometry><mesh filename="{reference}"/></geometry></collision>'
    path.write_text(f'<robot name="r"><link name="a">{inertial}{geometry}</link></robot>')
    return path


def test_a_package_above_the_file_is_found_by_its_folder_or_its_manifest(tmp_path: Path):
    found = mesh(tmp_path / "arm_description" / "meshes" / "m.stl")
    start = tmp_path / "arm_description" / "urdf" / "deep"
    start.mkdir(parents=True)
    assert resolve_resource("package://arm_description/meshes/m.stl", start) == found
    (tmp_path / "arm_description").rename(tmp_path / "checkout-1.2")
    start = tmp_path / "checkout-1.2" / "urdf" / "deep"
    with pytest.raises(SceneError, match="no package of that name"):
        resolve_resource("package://arm_description/meshes/m.stl", start)
    (tmp_path / "checkout-1.2" / "package.xml").write_text(PACKAGE_XML.format("arm_description"))
    assert resolve_resource("package://arm_description/meshes/m.stl", start).parent.parent.name == "checkout-1.2"


def test_a_sibling_package_is_found(tmp_path: Path):
    found = mesh(tmp_path / "src" / "meshes_pkg" / "m.stl")
    start = tmp_path / "src" / "robot_pkg" / "urdf"
    start.mkdir(parents=True)
    assert resolve_resource("package://meshes_pkg/m.stl", start) == found


def test_package_dirs_come_before_ancestors_and_the_ros_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    above = mesh(tmp_path / "pkg" / "m.stl")
    given = mesh(tmp_path / "given" / "pkg" / "m.stl")
    ros = mesh(tmp_path / "ros" / "pkg" / "m.stl")
    only_ros = mesh(tmp_path / "ros" / "stack" / "other" / "m.stl")
    monkeypatch.setenv("ROS_PACKAGE_PATH", os.pathsep.join(["/nowhere", str(tmp_path / "ros")]))
    url = "package://pkg/m.stl"
    assert resolve_resource(url, tmp_path / "pkg") == above
    assert resolve_resource(url, tmp_path / "pkg", [tmp_path / "given"]) == given
    assert resolve_resource(url, tmp_path / "pkg", [tmp_path / "given" / "pkg"]) == given
    assert resolve_resource(url, tmp_path / "ros" / "x") == ros
    assert resolve_resource("package://other/m.stl", tmp_path / "pkg") == only_ros


def test_a_package_without_the_file_does_not_hide_the_next(tmp_path: Path):
    (tmp_path / "empty" / "pkg").mkdir(parents=True)
    found = mesh(tmp_path / "full" / "pkg" / "m.stl")
    dirs = [tmp_path / "empty", tmp_path / "full"]
    assert resolve_resource("package://pkg/m.stl", tmp_path / "x", dirs) == found
    with pytest.raises(SceneError, match="empty.*full"):  # Every folder that was tried is named.
        resolve_resource("package://pkg/other.stl", tmp_path / "x", dirs)


def test_plain_file_and_escaped_references(tmp_path: Path):
    found = mesh(tmp_path / "my meshes" / "m.stl")
    for url in ("my meshes/m.stl", "my%20meshes/m.stl", str(found), f"file://{found}"):
        assert resolve_resource(url, tmp_path) == found


def test_example_robot_data_is_found():
    file = resolve_path("example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf")
    assert file.is_relative_to(example_robot_data_share())
    assert (
        resolve_path("package://example-robot-data/robots/allegro_hand_description/urdf/allegro_right_hand.urdf")
        == file
    )


@pytest.mark.parametrize("reference", ["package://robot/meshes/m.stl", "../meshes/m.stl"])
def test_meshes_of_a_model_are_found(tmp_path: Path, reference: str, monkeypatch: pytest.MonkeyPatch):
    mesh(tmp_path / "robot" / "meshes" / "m.stl")
    file = urdf(tmp_path / "robot" / "urdf" / "r.urdf", reference)
    monkeypatch.chdir(tmp_path)
    scene = Scene()
    scene.add_urdf(file.relative_to(tmp_path))
    (hull,) = scene.collision_model.geometryObjects
    assert hull.geometry.num_points == 4
    assert hull.geometry.computeVolume() == pytest.approx(1 / 6, abs=1e-15)
    assert hull.geometry.aabb_radius < 2.0  # Coal leaves it infinite until it is computed.


def test_a_missing_picture_is_ignored_and_said(tmp_path: Path):
    file = tmp_path / "r.urdf"
    text = urdf(file, str(mesh(tmp_path / "m.stl"))).read_text()
    visual = '<visual><geometry><mesh filename="package://gone/m.dae"/></geometry></visual>'
    file.write_text(text.replace("<collision>", visual + "<collision>"))
    scene = Scene()
    scene.add_urdf(file)
    assert any("gone/m.dae" in note.text for note in scene.report.all_notes("ignored", "visual"))
    assert len(scene.visual_model.geometryObjects) == 1  # The collision shape is shown.


@pytest.mark.parametrize(
    "path",
    ["x" * 300, "a/" * 3000, "~no_such_user/a.urdf", "loop", "package://" + "x" * 300 + "/a", "file://%00", "\ud800"],
)
def test_paths_that_no_file_can_have(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, path: str):
    """Too long, a loop of links, without a home, not writable in the file system: as a model, in it, beside it."""
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    Path("plain.urdf").write_text('<robot name="r"><link name="a"/></robot>')
    named = path if path != "\ud800" else "x" * 300  # no file in UTF-8 can say it
    urdf(Path("mesh.urdf"), named)
    Path("include.xml").write_text(f'<mujoco><include file="{named}"/></mujoco>')
    calls = (
        lambda: Scene().add_urdf(path),
        lambda: Scene().add_urdf("plain.urdf", srdf=path),
        lambda: Scene().add_urdf("package://p/a.urdf", package_dirs=[path]),
        lambda: Scene().add_urdf("mesh.urdf"),
        lambda: Scene.from_mjcf(path),
        lambda: Scene.from_mjcf("include.xml"),
        lambda: contactvi.load_scene(path),
        lambda: contactvi.Trajectory.load(path),
    )
    for call in calls:
        with pytest.raises(ContactviError):
            call()


@pytest.mark.parametrize(
    ("name", "load"),
    [
        ("big.urdf", lambda path: Scene().add_urdf(path)),
        pytest.param("big.xml", lambda path: Scene().add_mjcf(path), marks=needs_mujoco),
        ("big.toml", load_scene),
    ],
)
def test_files_that_are_too_large_are_not_read(tmp_path, name, load):
    """A sparse file: it takes no room, and would take minutes and gigabytes to read."""
    with (tmp_path / name).open("wb") as file:
        file.truncate(600_000_000)
    with pytest.raises(SceneError, match="too large: expected at most 500 MB, got 600 MB"):
        load(tmp_path / name)
