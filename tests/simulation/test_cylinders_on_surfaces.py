"""Cylinders on smooth height fields and on solids: against a search everywhere, other shapes and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import RectBivariateSpline

import contactvi as cvi
from contactvi.errors import SceneError
from derivatives.test_persistent_sensitivity import check
from oracles.cylinder_on_surface import HeightDistance, minima

GRAVITY = 9.81
RADIUS, HALF = 0.1, 0.08
SIZE = np.array([2.0, 2.0])
RING, TUBE = 0.3, 0.1


def hills(high: float = 0.06, count: int = 17, seed: int = 1) -> np.ndarray:
    return high * np.random.default_rng(seed).uniform(-1.0, 1.0, (count, count))


def spline(heights: np.ndarray, size: np.ndarray = SIZE) -> RectBivariateSpline:
    y, x = (np.linspace(-0.5 * length, 0.5 * length, n) for length, n in zip(size[::-1], heights.shape, strict=True))
    return RectBivariateSpline(x, y, heights.T, s=0)


def torus(p: np.ndarray) -> np.ndarray:
    return np.hypot(np.hypot(p[:, 0], p[:, 1]) - RING, p[:, 2]) - TUBE


def normals_of(scene: cvi.Scene, R: np.ndarray, t: np.ndarray, reach: float) -> np.ndarray:
    """Rows gap, normal, place on the surface, place on the cylinder in its frame, part, depth in that."""
    model = scene.collision_model
    return scene.core().common_normals(model.getGeometryId("ground"), model.getGeometryId("can"), R, t, reach)


def turned(rng: np.random.Generator) -> np.ndarray:
    quaternion = rng.normal(size=4)
    return np.asarray(pin.Quaternion(quaternion / np.linalg.norm(quaternion)).toRotationMatrix())


def pose(center: Any, R: np.ndarray | None = None) -> np.ndarray:
    return np.array([*center, *(pin.Quaternion(R).coeffs() if R is not None else (0.0, 0.0, 0.0, 1.0))])


ALONG_Y = pin.rpy.rpyToMatrix(0.5 * np.pi, 0.0, 0.0)
ALONG_X = pin.rpy.rpyToMatrix(0.0, 0.5 * np.pi, 0.0)


# --- distances -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ground", ["hills", "torus"])
def test_all_local_minima_are_found(ground: str) -> None:
    """In random poses near the surface: gaps, places and normals, against a search everywhere."""
    scene = cvi.Scene()
    if ground == "hills":
        heights = hills()
        scene.add_heightfield("ground", heights, SIZE)
        distance: Any = HeightDistance(spline(heights), SIZE)
    else:
        scene.add_torus("ground", RING, TUBE, free=False)
        distance = torus
    scene.add_cylinder("can", RADIUS, 2.0 * HALF)
    rng = np.random.default_rng(5)
    parts, reach = set(), 0.03
    for k in range(8 if ground == "torus" else 3):  # A search everywhere on the hills takes seconds.
        # Every other one lies, so that sides touch.
        R = turned(rng) if k % 2 else pin.rpy.rpyToMatrix(0.0, 0.0, rng.uniform(0.0, np.pi)) @ ALONG_X
        t = np.array([*rng.uniform(-0.4, 0.4, 2), 0.4])
        # Down to a gap of a millimetre; whether it is one is asked below.
        for _ in range(30):
            t[2] -= 0.5 * (normals_of(scene, R, t, 0.0)[:, 0].min() - 1e-3)
        known = minima(distance, RADIUS, HALF, R, t)
        found = normals_of(scene, R, t, max(known[0].gap, 0.0) + reach)
        assert abs(found[:, 0].min() - known[0].gap) < 1e-9
        assert 0.0 < known[0].gap < reach  # near enough that places besides the least one are within reach
        for m in known:
            if m.gap > known[0].gap + 0.9 * reach or not m.is_least:
                continue
            off = np.abs(found[:, 0] - m.gap) + np.linalg.norm(found[:, 7:10] - m.place, axis=1)
            off[found[:, 10] != m.part] = np.inf
            assert off.min() < 1e-6, (m, found)
            parts.add(m.part)
        for gap, *rest, part, depth in found:
            n, p, x = np.array(rest).reshape(3, 3)
            y = R @ x + t
            np.testing.assert_allclose(y - p, gap * n, atol=1e-9)
            assert abs(distance(y[None])[0] - gap) < 1e-9
            around = y + 1e-6 * np.eye(3)
            slope = (distance(around) - distance(2.0 * y - around)) / 2e-6
            np.testing.assert_allclose(n, slope, atol=1e-6)
            if depth > 0.0 and np.isfinite(depth):
                assert part in (1, 2) or np.abs(x[2]) <= HALF
    assert parts & {1, 2}
    assert ground != "torus" or 3 in parts


def test_shallow_overlaps_have_their_depth() -> None:
    """A gap goes through zero: moved along its normal by d it changes by d."""
    scene = cvi.Scene()
    scene.add_heightfield("ground", hills(), SIZE)
    scene.add_cylinder("can", RADIUS, 2.0 * HALF)
    rng = np.random.default_rng(2)
    for _ in range(20):
        R, t = turned(rng), np.array([*rng.uniform(-0.4, 0.4, 2), 0.4])
        first = normals_of(scene, R, t, 0.0)
        for depth in (1e-3, 0.0, -1e-6, -1e-4):
            for _ in range(12):
                least = normals_of(scene, R, t, 0.0)
                k = int(np.argmin(least[:, 0]))
                t = t - (least[k, 0] - depth) * least[k, 1:4]
            assert abs(normals_of(scene, R, t, 0.0)[:, 0].min() - depth) < 1e-12
        assert first[:, 0].min() > 0.0


def test_a_short_reach_finds_what_a_long_one_does() -> None:
    """A peg that touches in a cavity: cells that a bound on their gaps leaves out for the short one have none in it."""
    scene = cvi.Scene()
    scene.add_solid("ground", cavity, [(-0.08, 0.08), (-0.08, 0.08), (-0.28, 0.28)], 0.015, hollow=True)
    scene.add_cylinder("can", 0.045, 0.1)
    rng = np.random.default_rng(6)
    most = 0
    for _ in range(20):
        R = pin.exp3(np.array([*rng.uniform(-0.09, 0.09, 2), 0.0]))
        t = np.array([*rng.uniform(-1e-3, 1e-3, 2), rng.uniform(-0.05, 0.05)])
        every = normals_of(scene, R, t, 4e-3)
        for reach in (0.0, 1e-5, 1e-3):
            found = normals_of(scene, R, t, reach)
            wanted = every[every[:, 0] <= max(reach, every[:, 0].min()) - 1e-12]
            assert abs(found[:, 0].min() - every[:, 0].min()) < 1e-12
            for row in wanted:
                off = np.abs(found[:, [0, *range(4, 11)]] - row[[0, *range(4, 11)]]).max(axis=1)
                assert off.min() < 1e-8
            most = max(most, len(wanted))
    assert most > 1


# --- motions ---------------------------------------------------------------------------------------------------------


def both(ground: str, slope: float, friction: float, restitution: float = 0.0) -> list[cvi.Scene]:
    """Return two scenes of a cylinder on a plane that falls along x: of a field or a solid, and a halfspace."""
    scenes = []
    for made in (True, False):
        scene = cvi.Scene()
        normal = np.array([slope, 0.0, 1.0]) / np.hypot(1.0, slope)
        if not made:
            scene.add_halfspace(normal, name="ground")
        elif ground == "field":
            x = np.linspace(-3.0, 3.0, 31)
            scene.add_heightfield("ground", np.tile(-slope * x, (11, 1)), (6.0, 2.0))
        else:
            low, high = [-1.0, -0.5, -0.5], [3.0, 0.5, 0.2]
            box = np.array([low, high]).T

            def block(p: np.ndarray, normal: np.ndarray = normal) -> np.ndarray:
                # The plane as the surface, but near the border of the box, where it bends down.
                bowl = np.maximum(
                    np.maximum(-0.85 - p[:, 0], p[:, 0] - 2.85), np.maximum(np.abs(p[:, 1]) - 0.4, -0.4 - p[:, 2])
                )
                return np.maximum(p @ normal, bowl)

            scene.add_solid("ground", block, box, 0.05)
        scene.add_cylinder("can", RADIUS, 2.0 * HALF)
        scene.set_contact(restitution=restitution, friction=friction)
        scenes.append(scene)
    return scenes


@pytest.mark.parametrize("order", [2, 4])
def test_a_cylinder_rolls_down_a_plane_of_heights(order: int) -> None:
    """With 2/3 g sin, as on the halfspace."""
    slope = 0.2
    runs = []
    normal = np.array([slope, 0.0, 1.0]) / np.hypot(1.0, slope)
    for scene in both("field", slope, 1.0):
        q = pose(np.array([-1.03, 0.02, 1.03 * slope]) + RADIUS * normal, ALONG_Y)
        runs.append(cvi.simulate(scene, q, None, duration=1.0, dt=0.01, order=order))
    found, known = runs
    assert found.status.ok
    np.testing.assert_allclose(found.q, known.q, atol=1e-9)
    way = (found.q[-1, :3] - found.q[0, :3]) @ np.array([1.0, 0.0, -slope]) / np.hypot(1.0, slope)
    assert abs(way - 0.5 * 2.0 / 3.0 * GRAVITY * slope / np.hypot(1.0, slope)) < (1e-4 if order == 2 else 1e-8)
    assert min(found.scene.core().gaps(q)[0][0] for q in found.q) > -1e-9


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_cylinder_falls_on_a_plane_of_heights(seed: int) -> None:
    """Tumbling down as on the halfspace, by rims, to the same impacts."""
    R, runs = turned(np.random.default_rng(seed)), []
    for scene in both("field", 0.0, 0.4, 0.3):
        runs.append(
            cvi.simulate(scene, pose([0.03, 0.02, 0.3], R), [0.3, 0.1, 0.0, 1.0, 2.0, 0.5], duration=0.3, dt=0.005)
        )
    found, known = runs
    assert found.status.ok
    assert len(found.events) == len(known.events) > 0
    np.testing.assert_allclose([e.time for e in found.events], [e.time for e in known.events], atol=1e-9)
    np.testing.assert_allclose(found.q[-1], known.q[-1], atol=1e-7)


def test_a_cylinder_stands_and_slides_on_a_plane_of_heights() -> None:
    """On points of its rim, without rocking: g (sin - mu cos)."""
    slope, friction = 0.2, 0.05
    size = np.hypot(1.0, slope)
    normal, along = np.array([slope, 0.0, 1.0]) / size, np.array([1.0, 0.0, -slope]) / size
    q = pose(np.array([-1.03, 0.02, 1.03 * slope]) + HALF * normal, pin.rpy.rpyToMatrix(0.0, np.arctan(slope), 0.0))
    run = cvi.simulate(both("field", slope, friction)[0], q, None, duration=0.5, dt=0.01)
    assert run.status.ok
    way = (run.q[-1, :3] - run.q[0, :3]) @ along
    assert abs(way - 0.5 * GRAVITY * (slope - friction) / size * 0.25) < 1e-9
    assert np.abs(run.v[:, 3:]).max() < 1e-8


def test_a_cylinder_rolls_across_two_ridges() -> None:
    """On two points, each with half of its weight: 2/3 g sin along the ridges."""
    tilt, apart = 0.1, 0.1
    x = np.linspace(-0.5, 0.5, 51)
    ridges = sum(0.05 * np.exp(-(((x - side * apart) / 0.05) ** 2)) for side in (-1.0, 1.0))
    scene = cvi.Scene(GRAVITY * np.array([0.0, np.sin(tilt), -np.cos(tilt)]))
    scene.add_heightfield("ground", np.tile(ridges, (21, 1)), (1.0, 4.0))
    scene.add_cylinder("can", 0.05, 0.4, mass=2.0)
    scene.set_contact(restitution=0.0, friction=1.0)
    top = spline(np.tile(ridges, (21, 1)), np.array([1.0, 4.0]))(np.linspace(0.05, 0.15, 100001), [0.0]).max()
    run = cvi.simulate(scene, pose([0.0, -1.0, top + 0.05], ALONG_X), None, duration=0.5, dt=0.01, order=4)
    assert run.status.ok
    assert abs(run.q[-1, 1] + 1.0 - 0.5 * 2.0 / 3.0 * GRAVITY * np.sin(tilt) * 0.25) < 1e-7
    force = run.contacts.force_of("ground", "can")[1][-1]
    assert abs(force[2] - 2.0 * GRAVITY * np.cos(tilt)) < 1e-6


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_cylinder_on_a_ball_of_a_function_as_on_a_ball(seed: int) -> None:
    """By its side, its rims and its ends: a superellipsoid of exponent 2 against a built-in ball.

    Where the point goes from a rim to an end it is let go and comes down again, in order 2.
    """
    R, runs = turned(np.random.default_rng(seed)), []
    for made in (True, False):
        scene = cvi.Scene()
        if made:
            scene.add_superellipsoid("ground", [0.5] * 3, 2.0, free=False)
        else:
            scene.add_sphere("ground", 0.5, free=False)
        scene.add_cylinder("can", RADIUS, 2.0 * HALF)
        scene.set_contact(restitution=0.3, friction=0.4)
        runs.append(
            cvi.simulate(scene, pose([0.03, 0.02, 0.75], R), [0.1, 0.1, 0.0, 1.0, 2.0, 0.5], duration=0.3, dt=0.00125)
        )
    found, known = runs
    assert found.status.ok
    assert len(found.events) >= len(known.events) > 0
    times = [[e.time for e in run.events][: len(known.events)] for run in runs]
    np.testing.assert_allclose(*times, atol=1e-7)
    np.testing.assert_allclose(found.q[-1], known.q[-1], atol=2e-5)
    assert min(scene.core().gaps(q)[0][0] for q in found.q) > -1e-9


def cavity(p: np.ndarray) -> np.ndarray:
    """The distance from a capsule along z."""
    return np.hypot(np.hypot(p[:, 0], p[:, 1]), np.maximum(np.abs(p[:, 2]) - 0.2, 0.0)) - 0.05


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_a_peg_slides_in_a_hole(friction: float) -> None:
    """Along the wall of a cavity, on both of its rims: g (cos - mu sin)."""
    tilt = 0.4
    scene = cvi.Scene(GRAVITY * np.array([0.0, -np.sin(tilt), -np.cos(tilt)]))
    scene.add_solid("hole", cavity, [(-0.08, 0.08), (-0.08, 0.08), (-0.28, 0.28)], 0.015, hollow=True)
    scene.add_cylinder("peg", 0.045, 0.1)
    scene.set_contact(restitution=0.0, friction=friction)
    q = pose([0.0, -0.005, 0.12])
    gap = scene.core().gaps(q)[0][0]
    run = cvi.simulate(scene, pose([0.0, -0.005 - gap, 0.12]), None, duration=0.04, dt=0.005)
    assert run.status.ok
    assert min(scene.core().gaps(q)[0][0] for q in run.q) > -1e-9
    # The samples of the wall ripple by some micrometres.
    way = 0.5 * GRAVITY * (np.cos(tilt) - friction * np.sin(tilt)) * 0.04**2
    assert abs(0.12 - run.q[-1, 2] - way) < 1e-3 * way


def test_a_wheel_keeps_its_energy_on_hills() -> None:
    """Without friction, bouncing and sliding: no gap below what is promised, and no energy lost or made."""
    scene = cvi.Scene()
    scene.add_heightfield("ground", hills(0.03), SIZE)
    scene.add_cylinder("can", RADIUS, 2.0 * HALF)
    scene.set_contact(restitution=1.0, friction=0.0)
    run = cvi.simulate(
        scene, pose([0.03, 0.02, 0.3], ALONG_Y), [0.3, 0.1, 0.0, 0.0, 2.0, 0.5], duration=0.6, dt=0.002, order=4
    )
    assert run.status.ok
    assert len(run.events) > 1
    model = scene.model
    data = model.createData()

    def energy(q: np.ndarray, v: np.ndarray) -> float:
        return float(pin.computeKineticEnergy(model, data, q, v) + pin.computePotentialEnergy(model, data, q))

    energies = [energy(q, v) for q, v in zip(run.q, run.v, strict=True)]
    assert np.ptp(energies) < 1e-6
    assert min(scene.core().gaps(q)[0][0] for q in run.q) > -1e-9


# --- what else stands on heights -------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ["ellipsoid", "stone"])
def test_round_shapes_fall_on_a_plane_of_heights_as_on_a_halfspace(shape: str) -> None:
    runs = []
    for made in (True, False):
        scene = cvi.Scene()
        if made:
            scene.add_heightfield("ground", np.zeros((9, 9)), (4.0, 4.0))
        else:
            scene.add_halfspace()
        if shape == "ellipsoid":
            scene.add_ellipsoid("stone", [0.3, 0.2, 0.15], mass=2.0)
        else:
            scene.add_superellipsoid("stone", [0.3, 0.2, 0.15], 3.0, mass=2.0)
        scene.set_contact(restitution=0.3, friction=0.4)
        runs.append(cvi.simulate(scene, pose([0.0, 0.0, 0.6]), [0.0, 0.0, 0.0, 1.0, 0.5, 0.0], duration=0.8, dt=0.005))
    found, known = runs
    assert found.status.ok
    assert len(found.events) == len(known.events) > 1
    np.testing.assert_allclose([e.time for e in found.events], [e.time for e in known.events], atol=1e-9)
    np.testing.assert_allclose(found.q[-1], known.q[-1], atol=1e-7)


def test_common_normals_of_a_torus_and_hills() -> None:
    """The least gap against all places of the torus, each with its nearest place of the hills."""
    scene = cvi.Scene()
    heights = hills()
    scene.add_heightfield("ground", heights, SIZE)
    scene.add_torus("ring", 0.15, 0.05)
    distance, model = HeightDistance(spline(heights), SIZE), scene.collision_model
    u, w = np.meshgrid(*[2.0 * np.pi * np.arange(240) / 240] * 2, indexing="ij")
    out = 0.15 + 0.05 * np.cos(w)
    places = np.stack([out * np.cos(u), out * np.sin(u), 0.05 * np.sin(w)], axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(4)
    for _ in range(5):
        R, t = turned(rng), np.array([*rng.uniform(-0.4, 0.4, 2), 0.35])
        found = scene.core().common_normals(model.getGeometryId("ground"), model.getGeometryId("ring"), R, t, 0.0)
        least = distance(places @ R.T + t).min()
        # The places of the grid are 4 mm apart.
        assert -1e-9 <= least - found[:, 0].min() < 1e-4


# --- derivatives, and what is refused --------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("way", ["side", "rim"])
def test_derivatives_of_a_cylinder_on_hills(way: str) -> None:
    """Tangents against differences, through an impact and sliding, with the curvature of the hills and the cylinder."""
    scene = cvi.Scene()
    x = np.linspace(-1.0, 1.0, 21)
    curved = (-0.2 if way == "side" else 0.2) * (x**2 + x[:, None] ** 2)
    scene.add_heightfield("ground", curved, SIZE)
    scene.add_cylinder("can", RADIUS, 2.0 * HALF)
    scene.set_contact(restitution=0.0, friction=0.1)
    R = ALONG_Y if way == "side" else pin.rpy.rpyToMatrix(0.4, 0.1, 0.0)
    traj = check(
        (scene, pose([0.05, 0.02, RADIUS + 0.03], R), np.array([0.3, 0.2, 0.0, 0.1, 0.2, 0.1])),
        list(range(2 * scene.nv)), (1e-5, 5e-6), duration=0.12, dt=0.005, order=2,
    )  # fmt: skip
    assert traj.status.ok
    assert len(traj.contact_changes) > 0


def test_the_border_of_a_field_is_refused() -> None:
    """A cylinder that comes down on it, with a message; beside it there is a distance."""
    scene = cvi.Scene()
    scene.add_heightfield("ground", np.zeros((5, 5)), SIZE)
    scene.add_cylinder("can", RADIUS, 2.0 * HALF)
    beside = scene.core().gaps(pose([1.0 + RADIUS + 0.2, 0.0, -0.5]))[0][0]
    assert abs(beside - 0.2) < 1e-12
    with pytest.raises(SceneError, match="nearest point"):
        cvi.simulate(scene, pose([1.0, 0.0, 0.3], pin.rpy.rpyToMatrix(0.0, 0.3, 0.0)), None, duration=1.0, dt=0.01)
