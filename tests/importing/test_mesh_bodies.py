"""Bodies made of meshes: hulls and convex pieces, with the mass and inertia of the solids that collide."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.importing import mesh_bodies

SIZES = np.array([0.2, 0.3, 0.1])
CORNERS = 0.5 * SIZES * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
# Outward triangles of the box with these corners.
FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip


def write_obj(file: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    file.write_text("\n".join(lines) + "\n")
    return file


def angle_profile() -> tuple[np.ndarray, np.ndarray]:
    """An L of two boxes, 0.3 x 0.1 x 0.1 and 0.1 x 0.1 x 0.2 on its end, as one closed surface."""
    outline = np.array([[0, 0], [0.3, 0], [0.3, 0.1], [0.1, 0.1], [0.1, 0.3], [0, 0.3]])
    n = len(outline)
    vertices = np.array([[x, y, z] for y in (0.0, 0.1) for x, z in outline])
    cap = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]  # seen from below: the outline runs counterclockwise in x, z
    sides = [t for k in range(n) for t in ([k, n + k, (k + 1) % n], [(k + 1) % n, n + k, n + (k + 1) % n])]
    faces = np.array([*cap, *([n + a, n + c, n + b] for a, b, c in cap), *([a, b, c] for a, b, c in sides)])
    return vertices, faces


def assert_inertia(actual: pin.Inertia, expected: pin.Inertia, tolerance: float = 1e-14) -> None:
    assert actual.mass == pytest.approx(expected.mass, rel=tolerance)
    np.testing.assert_allclose(actual.lever, expected.lever, atol=tolerance * max(1.0, np.abs(expected.lever).max()))
    np.testing.assert_allclose(actual.inertia, expected.inertia, atol=tolerance * np.abs(expected.inertia).max())


@pytest.mark.parametrize("given", ["points", "faces", "file"])
def test_a_box_as_a_mesh_is_a_box(given, tmp_path):
    mesh = {"points": CORNERS, "faces": (CORNERS, FACES), "file": write_obj(tmp_path / "box.obj", CORNERS, FACES)}[
        given
    ]
    scene, boxes = cvi.Scene(), cvi.Scene()
    body = scene.add_mesh("box", mesh, 2.0, placement=((0, 0, 0.5), (0.3, 0.2, 0.1)))
    boxes.add_box("box", SIZES, 2.0, placement=((0, 0, 0.5), (0.3, 0.2, 0.1)))
    assert (body.bodies, body.geometries, body.joint) == (("box",), ("box",), "box")
    assert_inertia(scene.model.inertias[1], pin.Inertia.FromBox(2.0, *SIZES), 1e-7 if given == "file" else 1e-14)
    for made in (scene, boxes):
        made.add_halfspace()
        made.set_contact(restitution=0.3, friction=0.5)
    runs = [cvi.simulate(made, duration=0.4, dt=1e-3) for made in (scene, boxes)]
    assert len(runs[0].events) == len(runs[1].events) > 0
    # A file's vertices are of single precision.
    np.testing.assert_allclose(runs[0].q[-1], runs[1].q[-1], atol=1e-4 if given == "file" else 1e-9)


def test_mass_from_density_and_scale_in_millimetres(tmp_path):
    file = write_obj(tmp_path / "box.obj", 1000.0 * CORNERS + [500.0, 0.0, 0.0], FACES)
    scene = cvi.Scene()
    scene.add_mesh("box", file, density=700.0, scale=1e-3)
    mass = 700.0 * SIZES.prod()
    moved = pin.Inertia(mass, np.array([0.5, 0.0, 0.0]), pin.Inertia.FromBox(mass, *SIZES).inertia)
    assert_inertia(scene.model.inertias[1], moved, 1e-7)
    scene.add_mesh("slab", CORNERS, density=700.0, scale=(1.0, 2.0, 0.5))
    assert_inertia(scene.model.inertias[2], pin.Inertia.FromBox(mass, *(SIZES * [1.0, 2.0, 0.5])))
    scene.add_mesh("light", CORNERS)
    assert scene.model.inertias[3].mass == pytest.approx(1.0, rel=1e-15)


def test_the_inertia_of_a_tetrahedron_far_from_the_origin():
    """Its centre is the mean of its corners, its second moments about it the sum of the corners' over 20."""
    corners = np.random.default_rng(0).uniform(-0.1, 0.1, (4, 3))
    for away in (0.0, 1e3):
        scene = cvi.Scene()
        scene.add_mesh("solid", corners + away, 3.0)
        apart = corners - corners.mean(axis=0)
        second = 3.0 / 20.0 * apart.T @ apart
        found = scene.model.inertias[1]
        np.testing.assert_allclose(found.lever, corners.mean(axis=0) + away, rtol=1e-15, atol=1e-15)
        expected = np.trace(second) * np.eye(3) - second
        # The corners themselves are rounded at 1e-16 of their distance.
        np.testing.assert_allclose(found.inertia, expected, atol=(1e-14 + 1e-14 * away) * np.abs(expected).max())


def test_pieces_leave_room_where_the_hull_does_not():
    vertices, faces = angle_profile()
    scene = cvi.Scene()
    pieces = scene.add_mesh("angle", (vertices, faces), density=100.0, free=True, decompose=True)
    assert pieces.bodies == ("angle",)
    assert pieces.geometries == tuple(f"angle_{k}" for k in range(len(pieces.geometries)))
    assert len(pieces.geometries) >= 2
    # Two boxes: volumes 0.003 and 0.002, centres (0.15, 0.05, 0.05) and (0.05, 0.05, 0.2).
    low = pin.Inertia(0.3, np.array([0.15, 0.05, 0.05]), pin.Inertia.FromBox(0.3, 0.3, 0.1, 0.1).inertia)
    high = pin.Inertia(0.2, np.array([0.05, 0.05, 0.2]), pin.Inertia.FromBox(0.2, 0.1, 0.1, 0.2).inertia)
    # The pieces cover the mesh; where CoACD does not cut along the edge, they cover a little more.
    assert scene.model.inertias[1].mass >= 0.5 * (1.0 - 1e-6)
    assert_inertia(scene.model.inertias[1], low + high, 5e-3)
    hull = cvi.Scene()
    hull.add_mesh("angle", (vertices, faces))
    for made in (scene, hull):
        made.add_sphere("ball", 0.05, placement=(0.2, 0.05, 0.16))
    assert min(scene.gaps(scene.neutral())) == pytest.approx(0.01, abs=1e-3)
    assert min(hull.gaps(hull.neutral())) < -0.01


def test_a_ball_rests_in_the_corner_of_a_decomposed_mesh():
    scene = cvi.Scene()
    scene.add_mesh("angle", angle_profile(), free=False, decompose=True, placement=((0, 0, 0), (0, -0.3, 0)))
    scene.add_sphere("ball", 0.04, placement=(0.2, 0.05, 0.22))
    scene.set_contact(restitution=0.0, friction=0.2)
    traj = cvi.simulate(scene, duration=2.0, dt=1e-3)
    assert abs(traj.v[-1]).max() < 1e-6
    assert {name for contact in traj.contacts.at(2.0) for name in contact.pair} > {"ball"}
    assert min(scene.gaps(traj.q[-1])) > -1e-9


def test_equal_meshes_have_equal_pieces():
    scene = cvi.Scene()
    for name in ("a", "b"):
        scene.add_mesh(name, angle_profile(), decompose=0.1)
    shapes = {g.name: np.array(g.geometry.points()) for g in scene.collision_model.geometryObjects}
    pairs = [(f"a_{k}", f"b_{k}") for k in range(len(shapes) // 2)]
    assert pairs
    for a, b in pairs:
        np.testing.assert_array_equal(shapes[a], shapes[b])


def test_meshes_are_stored_and_stand_in_scene_files(tmp_path):
    write_obj(tmp_path / "angle.obj", *angle_profile())
    (tmp_path / "scene.toml").write_text(
        '[[mesh]]\nname = "angle"\npath = "angle.obj"\ndensity = 100.0\ndecompose = true\nxyz = [0, 0, 1]\n'
        '[[mesh]]\nname = "hull"\npath = "angle.obj"\nfree = false\nscale = 2.0\n'
    )
    scene = cvi.load_scene(tmp_path / "scene.toml")
    assert scene.model.inertias[1].mass == pytest.approx(0.5, rel=5e-3)
    again = cvi.Scene.from_dict(scene.to_dict())
    assert again.pair_names == scene.pair_names
    np.testing.assert_array_equal(again.gaps(again.neutral()), scene.gaps(scene.neutral()))
    assert "convex pieces" in str(scene.report)


def test_what_is_no_mesh_is_refused(tmp_path, monkeypatch):
    scene = cvi.Scene()
    with pytest.raises(cvi.SceneError, match="points in a plane"):
        scene.add_mesh("flat", CORNERS[:4])
    with pytest.raises(cvi.InputError, match="path of an STL"):
        scene.add_mesh("number", 3.0)
    with pytest.raises(cvi.InputError, match="faces of 'far'"):
        scene.add_mesh("far", (CORNERS, FACES + 1))
    with pytest.raises(cvi.InputError, match="a mass and a density"):
        scene.add_mesh("both", CORNERS, 1.0, density=1.0)
    with pytest.raises(cvi.InputError, match="scale"):
        scene.add_mesh("none", CORNERS, scale=0.0)
    with pytest.raises(cvi.InputError, match="has no faces"):
        scene.add_mesh("points", CORNERS, decompose=True)
    with pytest.raises(cvi.InputError, match="concavity"):
        scene.add_mesh("much", (CORNERS, FACES), decompose=7)
    with pytest.raises(cvi.SceneError, match="missing.stl"):
        scene.add_mesh("gone", tmp_path / "missing.stl")
    (tmp_path / "text.stl").write_text("no mesh")
    with pytest.raises(cvi.ContactviError, match="text.stl"):
        scene.add_mesh("text", tmp_path / "text.stl")
    monkeypatch.setattr(mesh_bodies, "_DECOMPOSE", "import os; os.abort()")
    with pytest.raises(cvi.SceneError, match="Join vertices at one place"):
        scene.add_mesh("pieces", (0.9 * CORNERS, FACES), decompose=True)
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(cvi.SceneError, match=r'pip install "contactvi\[decompose\]"'):
        scene.add_mesh("pieces", (CORNERS, FACES), decompose=True)
    assert scene.parts == []
