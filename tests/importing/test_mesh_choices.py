"""Meshes of models as hulls, pieces and fields: what is taken, how far it is from the mesh, and what touches it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from contactvi.errors import InputError, SceneError
from contactvi.importing.mesh_bodies import MeshSource
from contactvi.importing.mesh_distance import from_hulls, places
from helpers.extras import needs_mujoco

SIZE = 0.1  # [m] of the arms of the L across


def l_mesh() -> tuple[np.ndarray, np.ndarray]:
    """A prism of height SIZE over an L with arms 2 SIZE long and SIZE across, whose notch is at (SIZE, SIZE)."""
    outline = SIZE * np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], dtype=float)
    vertices = np.concatenate([np.column_stack([outline, np.full(6, z)]) for z in (0.0, SIZE)])
    top = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    faces = [(c, b, a) for a, b, c in top] + [(a + 6, b + 6, c + 6) for a, b, c in top]
    for i in range(6):
        j = (i + 1) % 6
        faces += [(i, j, j + 6), (i, j + 6, i + 6)]
    return vertices, np.array(faces)


def write_obj(path: Path, open_: bool = False) -> None:
    vertices, faces = l_mesh()
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += ["f " + " ".join(str(k + 1) for k in face) for face in faces[1 if open_ else 0 :].tolist()]
    path.write_text("\n".join(lines))


def urdf(folder: Path, open_: bool = False) -> Path:
    """A link with the L, called "ell_0", and a box, fixed to the world."""
    write_obj(folder / "ell.obj", open_)
    file = folder / "ell.urdf"
    file.write_text(
        '<robot name="r"><link name="ell"><collision><geometry><mesh filename="ell.obj"/></geometry></collision>'
        '<collision><origin xyz="0 0 -1"/><geometry><box size=".1 .1 .1"/></geometry></collision></link></robot>'
    )
    return file


def taken(scene: cvi.Scene) -> list[str]:
    return [note.text for note in scene.report.all_notes("changed", "mesh") if "taken as" in note.text]


def distances(text: str) -> tuple[float, float]:
    """The largest and the mean distance of a finding [m]."""
    words = text.partition(": its surface is ")[2].split()
    return float(words[0]), float(words[words.index("most,") + 1])


def test_by_default_meshes_are_hulls_without_a_measure(tmp_path: Path):
    scene = cvi.Scene()
    scene.add_urdf(urdf(tmp_path))
    assert taken(scene) == []
    assert scene.collision_model.geometryObjects[0].geometry.num_points == 10  # all corners but those of the notch


def test_the_distance_of_a_hull_is_that_of_the_notch(tmp_path: Path):
    """Half way up the walls of the notch are SIZE / 2 from the hull's top and bottom, and the hull from the walls.

    Places are some SIZE / 70 apart, and three digits are printed.
    """
    scene = cvi.Scene()
    scene.add_urdf(urdf(tmp_path), shape="hull")
    (text,) = taken(scene)
    largest, mean = distances(text)
    assert 0.48 * SIZE < largest <= 0.5 * SIZE
    assert 0.0 < mean < 0.5 * largest


def test_the_distance_is_measured_both_ways():
    """One arm of the L against all of it: what is missing is seen from one side alone, either way."""
    vertices, faces = l_mesh()
    box = SIZE * np.array([(x, y, z) for x in (0, 2) for y in (0, 1) for z in (0, 1)], dtype=float)
    sides = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6),
             (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
    arm = (box, np.array(sides))
    ell = (vertices, faces)
    # The end of the other arm is SIZE away; of the arm itself only its wall to the other one is off.
    assert abs(from_hulls(MeshSource(None, *ell), [arm]).largest - SIZE) < 1e-12
    assert abs(from_hulls(MeshSource(None, *arm), [ell]).largest - SIZE) < 1e-12


def test_places_are_on_the_triangles_and_even():
    """On the L each face has its share of the places, to the error of a sequence that fills the square evenly."""
    vertices, faces = l_mesh()
    at, normals = places(vertices, faces, 4000)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    on_top = np.isclose(at[:, 2], SIZE, atol=1e-15) & (normals[:, 2] > 0.5)
    known = 3.0 * SIZE**2 / area.sum()
    assert abs(on_top.mean() - known) < 2e-3
    assert np.allclose(at[on_top, :2].mean(axis=0), SIZE * np.array([2.5, 2.5]) / 3.0, atol=2e-2 * SIZE)


def test_a_field_is_the_mesh_with_its_notch(tmp_path: Path):
    """Beside both walls of the notch, which the hull does not have, a ball has two feet at the walls."""
    spacing, radius = 0.01, 0.03
    scene = cvi.Scene()
    scene.add_urdf(urdf(tmp_path), shape={"ell_0": "field"}, spacing=spacing)
    (text,) = taken(scene)
    largest, mean = distances(text)
    assert largest < 0.5 * spacing  # at the corners, where three edges meet in less than a cell
    assert mean < 0.1 * largest
    assert scene.report.parts[0].geometries[0].shape == "Sampled solid"
    number = scene.collision_model.getGeometryId("ell_0")
    centre = np.array([SIZE + radius, SIZE + radius, 0.5 * SIZE])
    feet = scene.core().feet(number, centre, 2.0 * radius)
    assert len(feet) == 2
    assert np.abs(feet[:, 0] - radius).max() < 1e-2 * spacing  # three samples from the notch it has ripples
    hull = cvi.Scene()
    hull.add_urdf(urdf(tmp_path))
    assert [p.surface is None for p in scene.pictures()] == [False, True]  # the field is drawn as its surface
    assert [p.surface is None for p in hull.pictures()] == [True, True]


def test_a_prefix_and_a_stored_scene_keep_the_field(tmp_path: Path):
    scene = cvi.Scene()
    scene.add_urdf(urdf(tmp_path), shape={"ell.obj": "field"}, spacing=0.02, prefix="left_")
    scene.add_sphere("ball", 0.03, placement=(0.13, 0.13, 0.05))
    assert ("left_ell_0", "ball") in scene.pair_names
    again = cvi.Scene.from_dict(scene.to_dict())
    q = scene.neutral()
    assert np.array_equal(scene.core().gaps(q)[0], again.core().gaps(q)[0])


@needs_mujoco
def test_what_a_file_says_of_a_geometry_holds_of_its_pieces(tmp_path: Path):
    write_obj(tmp_path / "ell.obj")
    (tmp_path / "m.xml").write_text(
        '<mujoco><asset><mesh name="ell" file="ell.obj"/></asset><worldbody>'
        '<geom name="a" type="mesh" mesh="ell" friction=".3"/><geom name="far" size=".1" pos="9 9 9"/>'
        '<body pos="0 0 .5"><freejoint/><geom name="ball" size=".03" friction=".2"/></body></worldbody></mujoco>'
    )
    scene = cvi.Scene.from_mjcf(tmp_path / "m.xml", shape={"ell": "pieces"})
    (text,) = taken(scene)
    count = int(text.split()[2])
    assert count > 1
    names = {f"a_{k}" for k in range(count)}
    pairs = {frozenset(pair): friction for pair, friction in zip(scene.pair_names, scene.pair_friction, strict=True)}
    assert set(pairs) == {frozenset((name, "ball")) for name in {*names, "far"}}
    assert all(pairs[frozenset((name, "ball"))] == 0.3 for name in names)  # MuJoCo takes the larger one
    assert distances(text)[0] < 0.05 * SIZE  # CoACD's concavity is relative to the mesh


def test_a_scene_file_and_the_command_line_choose_as_python_does(tmp_path: Path):
    from contactvi.commands.models import Choice, read_scene

    file = urdf(tmp_path)
    (tmp_path / "scene.toml").write_text(
        f'[[urdf]]\npath = "{file.name}"\nshape = {{ ell_0 = "field" }}\nspacing = 0.02\n'
    )
    given = cvi.Scene()
    given.add_urdf(file, shape={"ell_0": "field"}, spacing=0.02)
    listed = read_scene(str(tmp_path / "scene.toml"), Choice())
    typed = read_scene(str(file), Choice(shape=["ell_0=field"], spacing=0.02))
    assert taken(given) == taken(listed) == taken(typed) != []
    assert Choice(shape=["hull"]).meshes() == {"shape": "hull"}
    saved = given.save(tmp_path / "saved.toml")
    assert taken(cvi.load_scene(saved)) == taken(given)


@pytest.mark.parametrize(("shape", "match"), [("convex", "What a mesh becomes"), ({"el": "field"}, "Shape of a mesh")])
def test_wrong_choices_are_refused(tmp_path: Path, shape: object, match: str):
    with pytest.raises(InputError, match=match):
        cvi.Scene().add_urdf(urdf(tmp_path), shape=shape)


def test_a_field_needs_a_closed_mesh(tmp_path: Path):
    with pytest.raises(SceneError, match="not closed"):
        cvi.Scene().add_urdf(urdf(tmp_path, open_=True), shape="field")


@needs_mujoco
def test_an_sdf_plugin_is_the_field_of_its_mesh(tmp_path: Path):
    """A torus of MuJoCo's plugin: the report says what is taken, and its distances are those of the torus.

    MuJoCo's mesh of it has cells; their error is what is left.
    """
    (tmp_path / "m.xml").write_text(
        '<mujoco><extension><plugin plugin="mujoco.sdf.torus"><instance name="t"><config key="radius1" value=".35"/>'
        '<config key="radius2" value=".15"/></instance></plugin></extension>'
        '<asset><mesh name="ring"><plugin instance="t"/></mesh></asset>'
        '<worldbody><geom name="ring" type="sdf" mesh="ring"><plugin instance="t"/></geom>'
        '<body pos="0 0 1"><freejoint/><geom name="ball" size=".05"/></body></worldbody></mujoco>'
    )
    scene = cvi.Scene.from_mjcf(tmp_path / "m.xml", shape="field")
    assert any("signed distance field" in note.text for note in scene.report.all_notes("ignored", "geom"))
    assert len(taken(scene)) == 1
    number = scene.collision_model.getGeometryId("ring")
    feet = scene.core().feet(number, np.array([0.35, 0.0, 0.3]), 0.0)
    assert abs(feet[0, 0] - 0.15) < 5e-3
