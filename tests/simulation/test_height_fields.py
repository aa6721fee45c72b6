"""Height fields: against planes, a search everywhere, DOP853 on the offset surface and closed forms of grooves."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import RectBivariateSpline

import contactvi as cvi
from contactvi.errors import InputError, SceneError
from oracles.nearest_on_height import feet
from oracles.surface_ball import GRAVITY, BallOnSurface

RADIUS = 0.1
SIZE = np.array([4.0, 3.0])


def hills(rows: int = 16, columns: int = 21, high: float = 0.1, seed: int = 1) -> np.ndarray:
    return high * np.random.default_rng(seed).uniform(-1.0, 1.0, (rows, columns))


def spline(heights: np.ndarray, size: np.ndarray = SIZE) -> RectBivariateSpline:
    """The same surface by another library: z(x, y)."""
    y, x = (np.linspace(-0.5 * length, 0.5 * length, n) for length, n in zip(size[::-1], heights.shape, strict=True))
    return RectBivariateSpline(x, y, heights.T, s=0)


def scene_of(heights: np.ndarray, size: Any = SIZE, friction: float = 0.0, restitution: float = 0.0) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_heightfield("ground", heights, size)
    scene.add_sphere("ball", RADIUS)
    scene.set_contact(restitution=restitution, friction=friction)
    return scene


def feet_of(scene: cvi.Scene, name: str, point: Any, reach: float = 0.0) -> np.ndarray:
    """Rows of distance and normal of the feet of a point in the frame of the surface."""
    return scene.core().feet(scene.collision_model.getGeometryId(name), np.asarray(point, dtype=float), reach)


def at(center: Any) -> np.ndarray:
    return np.array([*center, 0.0, 0.0, 0.0, 1.0])


# --- the surface -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 4])
def test_a_sphere_rolls_over_a_plane_of_heights_as_over_a_plane(order: int) -> None:
    """Over thirty cells in two seconds, slipping at first: to 1e-12 m, with the same changes of the contact."""
    slope = np.array([0.1, -0.05])
    x, y = np.linspace(-4.0, 4.0, 81), np.linspace(-2.0, 2.0, 41)
    heights = slope[0] * x + slope[1] * y[:, None]
    normal = np.array([*-slope, 1.0]) / np.sqrt(1.0 + slope @ slope)
    runs = []
    for smooth in (True, False):
        scene = cvi.Scene()
        if smooth:
            scene.add_heightfield("ground", heights, (8.0, 4.0))
        else:
            scene.add_halfspace(normal)
        scene.add_sphere("ball", RADIUS)
        scene.set_contact(restitution=0.0, friction=0.1)
        start = np.array([0.5, 0.0, 0.05]) + RADIUS * normal
        v = np.array([-1.0, 0.3, 0.0, 0.0, 0.0, 0.0])
        v[:3] -= normal * (normal @ v[:3])
        runs.append(cvi.simulate(scene, at(start), v, duration=2.0, dt=0.01, order=order))
    found, known = runs
    assert found.status.ok
    assert known.status.ok
    assert np.ptp(found.q[:, 0]) > 1.5
    np.testing.assert_allclose(found.q[:, :3], known.q[:, :3], atol=1e-12)
    np.testing.assert_allclose(found.v, known.v, atol=1e-11)
    assert [c.change for c in found.contact_changes] == [c.change for c in known.contact_changes]


def test_gaps_around_the_block() -> None:
    """Of places far beside it, above and below its edges, against the nearest of all places of the solid."""
    heights = hills(rows=6, columns=7, high=0.3)
    surface = spline(heights)
    scene = scene_of(heights)
    x, y = (np.linspace(-0.5 * length, 0.5 * length, 401) for length in SIZE)
    top = surface(x, y)
    rng = np.random.default_rng(4)
    beside = 0
    for point in rng.uniform([-4.0, -3.5, -1.0], [4.0, 3.5, 2.0], (1500, 3)):
        over = np.maximum(0.0, point[2] - top)
        known = float(np.sqrt(((x - point[0]) ** 2)[:, None] + (y - point[1]) ** 2 + over**2).min())
        if known < 0.02:
            continue  # in the block, or nearly
        beside += bool((np.abs(point[:2]) > 0.5 * SIZE).any())
        # The nearest place of the grid is off by less than its diagonal, 0.013 m, and so is the distance, from above.
        assert known - 0.013 <= feet_of(scene, "ground", point)[0, 0] <= known + 1e-9
    assert beside > 800


def test_the_nearest_point_is_found_everywhere() -> None:
    """All feet within a reach, against a search from everywhere, also near and above the border."""
    heights = hills(high=0.3)
    surface = spline(heights)
    scene = scene_of(heights)
    rng = np.random.default_rng(3)
    several = 0
    for _ in range(12):
        u = rng.uniform(-0.5, 0.5, 2) * (SIZE + 0.1)
        inside = np.clip(u, -0.5 * SIZE, 0.5 * SIZE)
        point = np.array([*u, float(surface.ev(*inside)) + rng.uniform(0.05, 0.5)])
        reach = 0.6
        known = feet(lambda x, y: float(surface.ev(x, y)), -0.5 * SIZE, 0.5 * SIZE, point, 60)
        known = known[(known < reach) | (known == known[0])]
        found = feet_of(scene, "ground", point, reach)
        several += len(known) > 1
        assert abs(found[0, 0] - known[0]) < 1e-8
        assert all(np.abs(found[:, 0] - distance).min() < 1e-8 for distance in known)
        # Also shallow ones are, which the search from everywhere runs past: all around them the surface is farther.
        for distance, *normal in found:
            foot = (point - distance * np.array(normal))[:2]
            around = foot + 1e-4 * np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)])
            held = np.clip(around, -0.5 * SIZE, 0.5 * SIZE)
            away = np.column_stack([held, surface.ev(*held.T)]) - point
            assert np.linalg.norm(away, axis=1).min() > distance - 1e-12
    assert several > 3


def test_beside_the_block_are_its_sides() -> None:
    """Distances from the vertical sides, from an edge, and inside, where the nearest of top and sides counts."""
    scene = scene_of(np.full((4, 5), 0.2))
    x = 0.5 * SIZE[0]
    np.testing.assert_allclose(feet_of(scene, "ground", [x + 0.3, 0.1, -5.0]), [[0.3, 1.0, 0.0, 0.0]], atol=1e-14)
    corner = feet_of(scene, "ground", [x + 0.3, 0.1, 0.6])
    np.testing.assert_allclose(corner, [[0.5, 0.6, 0.0, 0.8]], atol=1e-12)
    np.testing.assert_allclose(feet_of(scene, "ground", [x - 0.1, 0.1, -0.3]), [[-0.1, 1.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(feet_of(scene, "ground", [0.0, 0.1, 0.1]), [[-0.1, 0.0, 0.0, 1.0]], atol=1e-12)


def test_a_ball_rolls_off_the_border_onto_the_floor() -> None:
    """Over the edge, which it leaves, down beside the block, and on along the floor."""
    scene = scene_of(np.full((4, 4), 0.2), (1.0, 1.0), friction=0.5)
    scene.add_halfspace(name="floor")
    run = cvi.simulate(scene, at([0.3, 0.0, 0.3]), [0.8, 0.0, 0.0, 0.0, 8.0, 0.0], duration=1.0, dt=0.005)
    assert run.status.ok
    assert abs(run.q[-1, 2] - RADIUS) < 1e-9
    assert run.q[-1, 0] > 0.5 + RADIUS
    for q in run.q:
        out = np.array([max(q[0] - 0.5, 0.0), max(q[2] - 0.2, 0.0)])
        assert np.linalg.norm(out) - RADIUS > -1e-9


# --- motions ---------------------------------------------------------------------------------------------------------


def _gentle() -> tuple[np.ndarray, BallOnSurface]:
    heights = hills(9, 11, 0.05, 7)
    s = spline(heights)
    return heights, BallOnSurface(
        lambda u: float(s.ev(*u)),
        lambda u: np.array([float(s.ev(*u, dx=1)), float(s.ev(*u, dy=1))]),
        lambda u: np.array(
            [[s.ev(*u, dx=2), s.ev(*u, dx=1, dy=1)], [s.ev(*u, dx=1, dy=1), s.ev(*u, dy=2)]], dtype=float
        ),
        RADIUS,
    )


def test_a_ball_slides_and_rolls_on_hills() -> None:
    """Against the equations of sliding and of rolling on the offset surface of the same spline by another library.

    Third derivatives jump from cell to cell, so that the order of the method is not reached there.
    """
    heights, oracle = _gentle()
    u, along = np.array([-0.6, 0.2]), np.array([0.6, -0.2])
    v = oracle.center_change(u) @ along
    slid = cvi.simulate(scene_of(heights), at(oracle.center(u)), [*v, 0, 0, 0], duration=1.0, dt=2e-3, order=4)
    assert slid.status.ok
    np.testing.assert_allclose(slid.q[-1, :3], oracle.slide(u, v, np.array([0.0, 1.0]))[0][-1], atol=1e-7)
    omega = np.array([2.0, 5.0, 0.0])
    v = RADIUS * np.cross(omega, oracle.normal(u))
    rolled = cvi.simulate(
        scene_of(heights, friction=2.0), at(oracle.center(u)), [*v, *omega], duration=1.0, dt=2e-3, order=4
    )
    assert rolled.status.ok
    np.testing.assert_allclose(rolled.q[-1, :3], oracle.roll(u, omega, np.array([0.0, 1.0]))[0][-1], atol=1e-7)


GROOVE_X = np.linspace(-0.6, 0.6, 61)
GROOVE_DEEP, GROOVE_WAVE = 0.04, 2.0 * np.pi / 0.3


def groove(length: float = 6.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A groove along y, narrower than the ball at its bottom; the size, and the feet of the ball over its middle.

    The feet are where the line from the centre (0, h) is normal to the profile at distance R, as (x, slope, h).
    """
    profile = -GROOVE_DEEP * np.cos(GROOVE_WAVE * GROOVE_X)
    y = np.linspace(-0.5 * length, 0.5 * length, 13)
    heights = np.tile(profile, (len(y), 1))
    s = spline(heights, np.array([1.2, length]))

    def slope(x: float) -> float:
        return float(s.ev(x, 0.0, dx=1))

    # On the normal of (x, f(x)) at distance R the centre has the place x - R slope / root; the foot is where that is 0.
    low, high = 0.02, 0.12
    for _ in range(200):
        x = 0.5 * (low + high)
        low, high = (x, high) if x - RADIUS * slope(x) / np.hypot(1.0, slope(x)) < 0.0 else (low, x)
    return (
        heights,
        np.array([1.2, length]),
        np.array([x, slope(x), float(s.ev(x, 0.0)) + RADIUS / np.hypot(1.0, slope(x))]),
    )


def test_a_ball_rests_in_a_groove_on_both_walls() -> None:
    """It falls in, and rests on two points with the load m g / (2 cos) each, at the height of the closed form."""
    heights, size, (x, slope, high) = groove()
    scene = scene_of(heights, size, friction=0.3)
    run = cvi.simulate(scene, at([0.01, 0.0, high + 0.05]), duration=2.0, dt=0.005)
    assert run.status.ok
    np.testing.assert_allclose(run.q[-1, :3], [0.0, run.q[-1, 1], high], atol=1e-8)
    found = feet_of(scene, "ground", run.q[-1, :3], 1.01 * RADIUS)
    np.testing.assert_allclose(found[:, 0], RADIUS, atol=1e-9)
    np.testing.assert_allclose(sorted(found[:, 1]), np.array([-1.0, 1.0]) * slope / np.hypot(1.0, slope), atol=1e-7)


def test_a_ball_rolls_down_a_groove() -> None:
    """On two rails: a = g sin(alpha) / (1 + 2/5 (R / rho)^2), rho the distance of the centre from their line."""
    scene = cvi.Scene(9.81 * np.array([0.0, np.sin(0.1), -np.cos(0.1)]))
    heights, size, (_, slope, high) = groove()
    scene.add_heightfield("ground", heights, size)
    scene.add_sphere("ball", RADIUS)
    scene.set_contact(restitution=0.0, friction=2.0)
    run = cvi.simulate(scene, at([0.0, -2.0, high]), duration=1.5, dt=0.01, order=4)
    assert run.status.ok
    rho = RADIUS / np.hypot(1.0, slope)
    acceleration = GRAVITY * np.sin(0.1) / (1.0 + 0.4 * (RADIUS / rho) ** 2)
    np.testing.assert_allclose(run.q[:, 1], -2.0 + 0.5 * acceleration * run.t**2, atol=1e-8)
    np.testing.assert_allclose(run.q[:, 0], 0.0, atol=1e-9)


def test_a_saved_state_goes_on_with_both_feet() -> None:
    """Between two walls: what goes on from a saved state is the same to the last bit."""
    heights, size, (_, _, high) = groove()
    scene = cvi.Scene(GRAVITY * np.array([0.0, np.sin(0.1), -np.cos(0.1)]))
    scene.add_heightfield("ground", heights, size)
    scene.add_sphere("ball", RADIUS)
    scene.set_contact(restitution=0.0, friction=0.5)
    run = cvi.Simulator(scene, dt=0.005)
    run.reset(at([0.01, -2.0, high + 0.05]))
    run.run(120)
    saved = run.save()
    run.run(100)
    q = run.q.copy()
    run.load(saved)
    run.run(100)
    np.testing.assert_array_equal(run.q, q)


def test_a_ball_drops_from_a_wide_valley_into_narrow_ones() -> None:
    """A rough field of hollows narrower than the ball: it rolls through them, and no gap is below -1e-9 m at a node."""
    heights = hills(41, 41, 0.02, 5)
    size = np.array([2.0, 2.0])
    scene = scene_of(heights, size, friction=0.4)
    run = cvi.simulate(scene, at([0.0, 0.0, 0.3]), [0.5, 0.3, 0, 0, 0, 0], duration=1.5, dt=0.002)
    assert run.status.ok
    s = spline(heights, size)
    for q in run.q[::25]:
        nearest = feet(lambda x, y: float(s.ev(x, y)), q[:2] - 0.15, q[:2] + 0.15, q[:3], 30)[0]
        assert nearest - RADIUS > -1e-9


def test_shapes_on_hills() -> None:
    """A capsule, a box and a hull come to rest with closed gaps."""
    scene = cvi.Scene()
    scene.add_heightfield("ground", hills(9, 11, 0.05, 7), SIZE)
    scene.add_capsule("capsule", 0.05, 0.3, placement=((0.0, 0.0, 0.3), (0.0, np.pi / 2, 0.0)))
    scene.add_box("box", (0.2, 0.3, 0.1), placement=(0.8, 0.0, 0.3))
    scene.set_contact(restitution=0.1, friction=0.7)
    run = cvi.simulate(scene, duration=2.0, dt=0.005)
    assert run.status.ok
    gaps = dict(zip(scene.pair_names, scene.core().gaps(run.q[-1])[0], strict=True))
    assert abs(gaps["ground", "capsule"]) < 1e-8
    assert abs(gaps["ground", "box"]) < 1e-8


# --- ways in ---------------------------------------------------------------------------------------------------------


def test_it_is_stored_with_its_heights() -> None:
    """As data, by pickle and as a copy: runs are the same to the last bit."""
    scene = scene_of(hills(9, 11, 0.05, 7), friction=0.4)
    runs = [
        cvi.simulate(made, at([0.1, 0.1, 0.4]), duration=0.5, dt=0.01)
        for made in (scene, cvi.Scene.from_dict(scene.to_dict()), pickle.loads(pickle.dumps(scene)), scene.copy())
    ]
    assert scene.to_dict()["missing"] == []
    for run in runs[1:]:
        np.testing.assert_array_equal(run.q, runs[0].q)


def test_files(tmp_path: Path) -> None:
    """Arrays and pictures, by the method and in a scene file; the lowest row of a picture is at low y."""
    from PIL import Image

    values = np.array([[0, 51, 102], [153, 204, 255]], dtype=np.uint8)
    Image.fromarray(values).save(tmp_path / "hills.png")
    np.save(tmp_path / "hills.npy", values[::-1] / 255.0)
    (tmp_path / "scene.toml").write_text(
        '[[heightfield]]\nname = "a"\npath = "hills.png"\nsize = [2.0, 1.0]\nheight = 0.5\n'
        '[[heightfield]]\nname = "b"\npath = "hills.npy"\nsize = [2.0, 1.0]\nheight = 0.5\nxyz = [3.0, 0.0, 0.0]\n'
        '[[heightfield]]\nname = "c"\nheights = [[0.0, 1.0], [0.0, 1.0]]\nsize = [1.0, 1.0]\nsmooth = false\n'
        'xyz = [6.0, 0.0, 0.0]\n[[sphere]]\nname = "ball"\nradius = 0.1\nxyz = [0.0, 0.0, 2.0]\n',
        encoding="utf-8",
    )
    scene = cvi.load_scene(tmp_path / "scene.toml")
    known = 0.5 * values[::-1] / 255.0
    for name in ("a", "b"):
        np.testing.assert_allclose(scene.surfaces[name].heights, known, atol=1e-15)  # type: ignore[attr-defined]
    assert [g.name for g in scene.collision_model.geometryObjects if g.name.startswith("c")] == ["c_0", "c_1"]


@pytest.mark.parametrize(
    ("heights", "size", "options", "match"),
    [
        ([[0.0, 1.0]], (1.0, 1.0), {}, "two and more"),
        ([[0.0, np.nan], [0.0, 1.0]], (1.0, 1.0), {}, "finite"),
        ([[0.0, 1.0], [0.0, 1.0]], (1.0, -1.0), {}, "positive lengths"),
        ("none.npy", (1.0, 1.0), {}, "none.npy"),
        (np.zeros((50, 50)), (1.0, 1.0), {"smooth": False}, "2000 at most"),
    ],
)
def test_what_is_refused(heights: Any, size: Any, options: dict[str, Any], match: str) -> None:
    with pytest.raises((InputError, SceneError), match=match):
        cvi.Scene().add_heightfield("ground", heights, size, **options)


def test_the_deviation_from_the_triangles_is_that_of_a_parabola() -> None:
    """Of z = x^2 the spline is the parabola, and chords over cells of length h are h^2 / 4 above its middle."""
    x = np.linspace(-1.0, 1.0, 9)
    from contactvi.importing.height_fields import height_field

    off = height_field(np.tile(x**2, (5, 1)), (2.0, 1.0)).from_triangles()
    assert abs(off.largest - 0.25**2 / 4.0) < 1e-14
    # The mean of 4 t (1 - t) by the trapezoidal rule at quarters of a cell.
    assert abs(off.mean - 0.625 * off.largest) < 1e-14


def test_what_is_drawn_lies_on_it() -> None:
    heights = hills(9, 11, 0.05, 7)
    scene = scene_of(heights)
    vertices, faces = scene.surfaces["ground"].grid("ground")
    for vertex in np.asarray(vertices, dtype=float)[::97]:
        assert abs(feet_of(scene, "ground", vertex)[0, 0]) < 1e-6  # single precision
    a, b, c = (np.asarray(vertices, dtype=float)[faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0.0).all()


def test_on_a_placed_field_all_goes_along() -> None:
    """The same run in the frame of a field that is placed elsewhere, tilted with gravity."""
    heights, _ = _gentle()
    place = pin.SE3(pin.utils.rpyToMatrix(0.4, -0.3, 0.8), np.array([1.0, 2.0, 3.0]))
    runs = []
    for where in (pin.SE3.Identity(), place):
        scene = cvi.Scene(where.rotation @ np.array([0.0, 0.0, -GRAVITY]))
        scene.add_heightfield("ground", heights, SIZE, placement=where)
        scene.add_sphere("ball", RADIUS)
        scene.set_contact(restitution=0.3, friction=0.4)
        q = pin.SE3ToXYZQUAT(where * pin.SE3(np.eye(3), np.array([0.2, 0.1, 0.3])))
        run = cvi.simulate(scene, q, duration=0.8, dt=0.01)
        assert run.status.ok
        runs.append(np.array([where.actInv(x) for x in run.q[:, :3]]))
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-8)
