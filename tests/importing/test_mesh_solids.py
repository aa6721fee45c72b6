"""Solids of closed meshes: distances against closed forms, surfaces against the mesh, a mug that holds a ball."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial import ConvexHull
from scipy.special import ellipk

import contactvi as cvi
from contactvi import _core
from contactvi.errors import InputError, SceneError
from contactvi.importing import mesh_solids

Mesh = tuple[np.ndarray, np.ndarray]


def turned(outline: np.ndarray, sides: int) -> Mesh:
    """A closed outline (n, 2) of (r, z) with r > 0, anticlockwise with r to the right, turned about z."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    r, z = outline.T
    vertices = np.stack(
        [np.outer(r, np.cos(angles)), np.outer(r, np.sin(angles)), np.repeat(z[:, None], sides, 1)], axis=-1
    ).reshape(-1, 3)
    n, faces = len(outline), []
    for i in range(n):
        for k in range(sides):
            a, b = i * sides + k, i * sides + (k + 1) % sides
            c, d = ((i + 1) % n) * sides + k, ((i + 1) % n) * sides + (k + 1) % sides
            faces += [(a, b, d), (a, d, c)]
    return vertices, np.array(faces)


def box_mesh(size: np.ndarray) -> Mesh:
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.5 * size
    faces = ConvexHull(corners).simplices
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return corners, faces


def mug(sides: int = 64) -> Mesh:
    """A cup of 80 mm across and 100 mm high with walls and a bottom of 10 mm, its bottom with a hole of 2 mm across."""
    outline = np.array([(0.001, 0.0), (0.04, 0.0), (0.04, 0.1), (0.03, 0.1), (0.03, 0.01), (0.001, 0.01)])
    return turned(outline, sides)


def feet_of(scene: cvi.Scene, name: str, point: np.ndarray) -> np.ndarray:
    return scene.core().feet(scene.collision_model.getGeometryId(name), np.asarray(point, dtype=float), 0.0)


def test_distances_from_a_box_are_those_of_the_closed_form() -> None:
    """To rounding, inside and outside, also where edges and corners are nearest."""
    size = np.array([0.6, 0.4, 1.0])
    vertices, faces = box_mesh(size)
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (5000, 3))
    off = np.abs(points) - 0.5 * size
    known = np.linalg.norm(np.maximum(off, 0.0), axis=1) + np.minimum(off.max(axis=1), 0.0)
    np.testing.assert_allclose(_core.mesh_distances(vertices, faces.astype(np.int32), points), known, atol=1e-15)


def test_signs_of_a_body_that_is_not_convex() -> None:
    """In the wall, the bottom and the hollow of the mug, against its outline; turned by many sides it is round."""
    vertices, faces = mug(256)
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.06, -0.06, -0.02], [0.06, 0.06, 0.12], (4000, 3))
    r, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    inside = (r < 0.04) & (z > 0.0) & (z < 0.1) & ((r > 0.03) | (z < 0.01)) & (r > 0.001)
    clear = np.abs(_core.mesh_distances(vertices, faces.astype(np.int32), points)) > 1e-4
    found = _core.mesh_distances(vertices, faces.astype(np.int32), points) < 0.0
    assert clear.sum() > 3500
    np.testing.assert_array_equal(found[clear], inside[clear])


def test_the_report_says_how_far_the_surface_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bound holds at points of the mesh, halves with the spacing at edges, and comes from the cache then."""
    monkeypatch.setenv("CONTACTVI_CACHE", str(tmp_path))
    vertices, faces = box_mesh(np.array([0.3, 0.2, 0.25]))
    stated = []
    for spacing in (0.02, 0.01):
        scene = cvi.Scene()
        scene.add_mesh("block", (vertices, faces), spacing=spacing, free=False)
        scene.add_sphere("ball", 0.05, placement=(0.0, 0.0, 1.0))
        (note,) = [n for n in scene.report.all_notes("changed") if "from the mesh" in n.text]
        stated.append(float(note.text.split()[0]))
        rng = np.random.default_rng(2)
        weights = rng.dirichlet(np.ones(3), 200)
        places = np.einsum("nk,nkj->nj", weights, vertices[faces[rng.integers(len(faces), size=200)]])
        off = np.array([abs(feet_of(scene, "block", place)[0, 0]) for place in places])
        assert off.max() < 2.0 * stated[-1]
        assert off.max() < 0.3 * spacing
        # Away from edges the distance of a flat face is met to the decay of a spline: .27 with each sample.
        flat = np.sort(np.abs(np.abs(places) - 0.5 * np.ptp(vertices, axis=0)), axis=1)[:, 1] > 5.0 * spacing
        assert flat.any() or spacing > 0.01
        assert off[flat].max(initial=0.0) < 2e-3 * spacing
    assert stated[0] > 1.2 * stated[1]
    assert len(list(tmp_path.iterdir())) == 2
    monkeypatch.setattr(mesh_solids, "mesh_distances", None)  # of what is kept none is computed
    again = cvi.Scene()
    again.add_mesh("block", (vertices, faces), spacing=0.01, free=False)
    (note,) = [n for n in again.report.all_notes("changed") if "from the mesh" in n.text]
    assert float(note.text.split()[0]) == stated[1]


@pytest.mark.slow
def test_a_mug_holds_a_ball() -> None:
    """A ball falls into it, stays in it and comes to rest on its bottom."""
    scene = cvi.Scene()
    scene.add_mesh("mug", mug(), mass=0.3, spacing=0.002, free=False)
    scene.add_sphere("ball", 0.015, mass=0.02)
    scene.set_contact(restitution=0.3, friction=0.4)
    run = cvi.simulate(scene, [0.006, 0.003, 0.13, 0, 0, 0, 1], duration=1.5, dt=1e-3)
    assert run.status.ok
    assert np.hypot(*run.q[-1, :2]) < 0.016
    assert abs(run.q[-1, 2] - 0.025) < 5e-4  # on the bottom, to the ripples of the surface
    assert scene.core().gaps(run.q[-1])[0][0] > -1e-9


@pytest.mark.slow
def test_a_ball_in_a_bowl_of_triangles_has_the_period_of_the_sphere() -> None:
    """A turned bowl, inner radius .3 m, of triangles 6 mm long: half a period, to what the facets do to a ball."""
    t = np.linspace(-0.5 * np.pi, 0.0, 100)[1:]
    inner, outer = (radius * np.stack([np.cos(t), np.sin(t)], axis=1) for radius in (0.3, 0.42))
    scene = cvi.Scene()
    scene.add_mesh("bowl", turned(np.vstack([outer, inner[::-1]]), 300), spacing=0.012, free=False)
    scene.add_sphere("ball", 0.1)
    scene.set_contact(restitution=0.0, friction=0.0)
    angle, length = 0.5, 0.2
    start = [length * np.sin(angle), 0.0, -length * np.cos(angle) + 2e-4, 0, 0, 0, 1]
    run = cvi.simulate(scene, start, duration=0.8, dt=2e-3)
    assert run.status.ok
    zeros = np.flatnonzero(np.diff(np.sign(run.q[:, 0])))
    times = run.t[zeros] - run.q[zeros, 0] * np.diff(run.t)[zeros] / np.diff(run.q[:, 0])[zeros]
    known = 2.0 * np.sqrt(length / 9.81) * ellipk(np.sin(0.5 * angle) ** 2)
    np.testing.assert_allclose(np.diff(times), known, rtol=2e-3)


def test_the_inertia_is_that_of_the_mesh() -> None:
    size = np.array([0.3, 0.2, 0.25])
    scene = cvi.Scene()
    scene.add_mesh("block", box_mesh(size), spacing=0.02, density=500.0)
    known = pin.Inertia.FromBox(500.0 * float(size.prod()), *size)
    assert abs(scene.model.inertias[1].mass - known.mass) < 1e-12
    np.testing.assert_allclose(scene.model.inertias[1].inertia, known.inertia, atol=1e-12)
    assert isinstance(scene.collision_model.geometryObjects[0].geometry, coal.Halfspace)


def test_what_is_refused() -> None:
    vertices, faces = box_mesh(np.ones(3))
    scene = cvi.Scene()
    with pytest.raises(SceneError, match="not closed"):
        scene.add_mesh("a", (vertices, faces[1:]), spacing=0.1)
    with pytest.raises(InputError, match="less than half"):
        scene.add_mesh("a", (vertices, faces), spacing=0.6)
    with pytest.raises(InputError, match="decompose or spacing"):
        scene.add_mesh("a", (vertices, faces), spacing=0.1, decompose=True)
    with pytest.raises(InputError, match="no faces"):
        scene.add_mesh("a", vertices, spacing=0.1)
