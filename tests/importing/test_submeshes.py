"""Mesh files of several meshes: pictures, volumes and faces are those of all of them."""

from __future__ import annotations

import coal
import numpy as np
import pytest

import contactvi as cvi
from contactvi.importing.submeshes import arrays_of, surface_of, unused_vertices, volume_of
from contactvi.playback.scene_visuals import from_scene

CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
FACES = np.array(
    [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
     (1, 5, 7), (1, 7, 3)]
)  # fmt: skip
PLACES = ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 0.0, 4.0))  # of three cubes
SIZES = (1.0, 0.5, 2.0)


def collada(nested: bool) -> str:
    """Three cubes: two as materials of one geometry, the third in another node, which may be inside of the first."""
    points = np.concatenate([np.array(at) + size * CORNERS for at, size in zip(PLACES, SIZES, strict=True)])
    floats = lambda values: " ".join(f"{x:g}" for x in np.ravel(values))  # noqa: E731

    def geometry(name: str, first: int, cubes: int) -> str:
        own = points[8 * first : 8 * (first + cubes)]
        parts = "".join(
            f'<triangles count="12" material="m{k}"><input semantic="VERTEX" source="#{name}v" offset="0"/>'
            f"<p>{floats(FACES + 8 * k)}</p></triangles>"
            for k in range(cubes)
        )
        return (
            f'<geometry id="{name}"><mesh><source id="{name}p"><float_array id="{name}a" count="{own.size}">'
            f'{floats(own)}</float_array><technique_common><accessor source="#{name}a" count="{len(own)}" stride="3">'
            '<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>'
            f'</technique_common></source><vertices id="{name}v"><input semantic="POSITION" source="#{name}p"/>'
            f"</vertices>{parts}</mesh></geometry>"
        )

    second = '<node id="b"><instance_geometry url="#two"/></node>'
    first = f'<node id="a"><instance_geometry url="#one"/>{second if nested else ""}</node>{"" if nested else second}'
    return (
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>'
        '<unit meter="1" name="meter"/><up_axis>Z_UP</up_axis></asset><library_geometries>'
        f"{geometry('one', 0, 2)}{geometry('two', 2, 1)}</library_geometries><library_visual_scenes>"
        f'<visual_scene id="s">{first}</visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )


MATERIALS = "".join(f"newmtl m{k}\nKd 0.{k + 1} 0 0\n" for k in range(3))


def wavefront() -> str:
    """Three cubes in one object, of three materials."""
    lines = ["mtllib cubes.mtl", "o cubes"]
    for k, (at, size) in enumerate(zip(PLACES, SIZES, strict=True)):
        lines += [f"usemtl m{k}"]
        lines += [f"v {x} {y} {z}" for x, y, z in np.array(at) + size * CORNERS]
        lines += [f"f {a} {b} {c}" for a, b, c in FACES + 8 * k + 1]
    return "\n".join(lines) + "\n"


FILES = {"flat.dae": collada(False), "nested.dae": collada(True), "groups.obj": wavefront()}


@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (0.1, 0.2, -0.3)])
@pytest.mark.parametrize("name", FILES)
def test_all_meshes_of_a_file_are_whole(name, scale, tmp_path):
    path = tmp_path / name
    path.write_text(FILES[name])
    (tmp_path / "cubes.mtl").write_text(MATERIALS)
    mesh = coal.MeshLoader(coal.BV_AABB).load(str(path), np.array(scale))
    assert unused_vertices(*arrays_of(mesh))  # as coal reads it
    vertices, faces = surface_of(mesh, str(path), np.array(scale))
    assert unused_vertices(vertices, faces) == 0
    assert len(faces) == 36
    corners = np.unique(vertices[faces].reshape(-1, 9).round(9), axis=0)
    expected = np.concatenate([np.array(at) + size * CORNERS for at, size in zip(PLACES, SIZES, strict=True)])
    wanted = (expected * scale)[np.concatenate([FACES + 8 * k for k in range(3)])]
    centres = np.unique(wanted.mean(axis=1).round(6), axis=0)
    np.testing.assert_allclose(np.unique(vertices[faces].mean(axis=1).round(6), axis=0), centres, atol=2e-6)
    assert len(corners) == 36
    volume = sum(size**3 for size in SIZES) * np.prod(scale)
    assert volume_of(mesh, str(path), np.array(scale)) == pytest.approx(volume, rel=1e-5)


@pytest.mark.parametrize("name", FILES)
def test_pictures_and_hulls_of_a_model(name, tmp_path):
    """The picture has all three cubes, and the hull their outermost corners."""
    (tmp_path / name).write_text(FILES[name])
    (tmp_path / "cubes.mtl").write_text(MATERIALS)
    mesh = f'<geometry><mesh filename="{name}"/></geometry>'
    (tmp_path / "robot.urdf").write_text(
        '<robot name="r"><link name="l"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
        f'iyz="0"/></inertial><visual>{mesh}</visual><collision>{mesh}</collision></link></robot>'
    )
    scene = cvi.Scene()
    scene.add_urdf(tmp_path / "robot.urdf", base="free")
    (visual,) = from_scene(scene)
    assert unused_vertices(visual.vertices, visual.faces) == 0
    a, b, c = (visual.vertices[visual.faces[:, k]].astype(float) for k in range(3))
    assert np.sum(a * np.cross(b, c)) / 6.0 == pytest.approx(sum(size**3 for size in SIZES), rel=1e-5)
    hull = np.array(scene.collision_model.geometryObjects[0].geometry.points())
    np.testing.assert_allclose(hull.max(axis=0), [3.5, 2.0, 6.0], atol=1e-6)


def test_what_stays_torn_is_warned_of(tmp_path):
    path = tmp_path / "flat.dae"
    path.write_text(FILES["flat.dae"])
    mesh = coal.MeshLoader(coal.BV_AABB).load(str(path), np.ones(3))
    path.unlink()
    with pytest.warns(cvi.TornMeshWarning, match=r"flat.dae is drawn torn: 8 of 24 vertices"):
        surface_of(mesh, str(path), np.ones(3))
