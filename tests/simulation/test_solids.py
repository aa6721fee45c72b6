"""Solids that need not be convex: distances and motions against closed forms, convex shapes and general minimizers."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import ellipk

import contactvi as cvi
from contactvi.errors import InputError, SceneError, UserFunctionError
from derivatives.test_persistent_sensitivity import check

GRAVITY = 9.81
RING, TUBE, RADIUS = 0.5, 0.2, 0.08


def at(center: Any) -> np.ndarray:
    return np.array([*center, 0.0, 0.0, 0.0, 1.0])


def feet_of(scene: cvi.Scene, name: str, point: Any, reach: float = 0.0) -> np.ndarray:
    return scene.core().feet(scene.collision_model.getGeometryId(name), np.asarray(point, dtype=float), reach)


def torus_function(p: np.ndarray) -> np.ndarray:
    return np.hypot(np.hypot(p[:, 0], p[:, 1]) - RING, p[:, 2]) - TUBE


def period(length: float, angle: float, gravity: float = GRAVITY) -> float:
    """Of a pendulum of this length that swings to this angle."""
    return float(4.0 * np.sqrt(length / gravity) * ellipk(np.sin(0.5 * angle) ** 2))


# --- distances -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hollow", [False, True])
def test_distances_from_a_torus(hollow: bool) -> None:
    scene = cvi.Scene()
    scene.add_torus("ring", RING, TUBE, free=False, hollow=hollow)
    scene.add_sphere("ball", RADIUS)
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.9, 0.9, (60, 3))
    known = torus_function(points) * (-1.0 if hollow else 1.0)
    for point, distance in zip(points, known, strict=True):
        foot = feet_of(scene, "ring", point)[0]
        assert abs(foot[0] - distance) < 1e-13
        # The foot lies on the surface, along the normal.
        assert abs(torus_function((point - foot[0] * foot[1:])[None])[0]) < 1e-13


def test_distances_from_a_superellipsoid() -> None:
    """Against a general minimizer from many starts on the surface; a ball for the exponent 2."""
    radii, n = np.array([0.5, 0.3, 0.2]), 4.0
    scene = cvi.Scene()
    scene.add_superellipsoid("stone", radii, n, free=False)
    scene.add_superellipsoid("ball", [0.3, 0.3, 0.3], 2.0, free=False, placement=(3.0, 0.0, 0.0))
    scene.add_sphere("probe", 0.05, placement=(0.0, 0.0, 3.0))

    def on_surface(angles: np.ndarray) -> np.ndarray:
        a, b = angles
        d = np.array([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)])
        return d / (np.abs(d / radii) ** n).sum() ** (1.0 / n)

    rng = np.random.default_rng(1)
    for point in rng.uniform(-0.8, 0.8, (10, 3)):
        if (np.abs(point / radii) ** n).sum() < 1.0:
            continue
        best = min(
            minimize(
                lambda angles, point=point: float(((on_surface(angles) - point) ** 2).sum()), start, method="BFGS",
                options={"gtol": 1e-12},
            ).fun
            for start in rng.uniform([-np.pi, -1.5], [np.pi, 1.5], (12, 2))
        )  # fmt: skip
        assert abs(feet_of(scene, "stone", point)[0, 0] - np.sqrt(best)) < 1e-7
        assert abs(feet_of(scene, "ball", point)[0, 0] - (np.linalg.norm(point) - 0.3)) < 1e-13


@pytest.mark.parametrize("pitch", [0.3, -0.3])
def test_distances_from_a_thread(pitch: float) -> None:
    """Feet lie on the thread; a general minimizer finds none nearer, and a screw motion changes no distance."""
    radius, depth = 0.2, 0.05
    scene = cvi.Scene()
    scene.add_thread("bolt", radius, depth, pitch, 2.0)
    scene.add_sphere("ball", 0.01, placement=(3.0, 0.0, 0.0))

    def on_thread(u: np.ndarray) -> np.ndarray:
        out = radius + depth * np.cos(u[0] - 2.0 * np.pi * u[1] / pitch)
        return np.array([out * np.cos(u[0]), out * np.sin(u[0]), u[1]])

    rng = np.random.default_rng(4)
    for angle, out, z in rng.uniform([-3.0, 0.26, -0.3], [3.0, 0.35, 0.3], (12, 3)):
        point = np.array([out * np.cos(angle), out * np.sin(angle), z])
        gap, *n = feet_of(scene, "bolt", point)[0]
        foot = point - gap * np.array(n)
        u = np.array([np.arctan2(foot[1], foot[0]), foot[2]])
        np.testing.assert_allclose(on_thread(u), foot, atol=1e-12)
        best = min(
            minimize(lambda u, point=point: float(((on_thread(u) - point) ** 2).sum()), start, method="BFGS").fun
            for start in rng.uniform([angle - 1.0, z - 0.2], [angle + 1.0, z + 0.2], (8, 2))
        )
        assert gap < np.sqrt(best) + 1e-9
        turn = rng.uniform(-1.0, 1.0)
        c, s = np.cos(turn), np.sin(turn)
        moved = [c * point[0] - s * point[1], s * point[0] + c * point[1], point[2] + pitch * turn / (2.0 * np.pi)]
        assert abs(feet_of(scene, "bolt", moved)[0, 0] - gap) < 1e-12


def test_a_sampled_torus_is_as_near_as_the_report_says() -> None:
    """Of fourth order in the spacing; feet on the sampled surface are within the stated bound of the torus."""
    extent, stated = [(-0.8, 0.8), (-0.8, 0.8), (-0.3, 0.3)], []
    for spacing in (0.04, 0.02):
        scene = cvi.Scene()
        scene.add_solid("ring", torus_function, extent, spacing)
        scene.add_sphere("ball", RADIUS)
        (note,) = [n for n in scene.report.all_notes("changed") if "surface of the function" in n.text]
        stated.append(float(note.text.split()[0]))
        rng = np.random.default_rng(2)
        for angle, turn in rng.uniform(-np.pi, np.pi, (40, 2)):
            out = RING + 0.25 * np.cos(turn)
            foot = feet_of(scene, "ring", [out * np.cos(angle), out * np.sin(angle), 0.25 * np.sin(turn)])[0]
            assert abs(foot[0] - 0.05) < 1.2 * stated[-1]
    assert stated[0] / stated[1] > 10.0
    assert stated[1] < 1e-6


def test_a_ball_in_a_channel_has_both_walls_as_feet() -> None:
    """A dumbbell-shaped groove between two tubes: feet on both."""
    scene = cvi.Scene()

    def two(p: np.ndarray) -> np.ndarray:
        left, right = (np.linalg.norm((p - [x, 0.0, 0.0]) / [1.0, 1.5, 1.0], axis=1) - 0.3 for x in (-0.35, 0.35))
        return -np.log(np.exp(-60.0 * left) + np.exp(-60.0 * right)) / 60.0

    scene.add_solid("stones", two, [(-0.8, 0.8), (-0.6, 0.6), (-0.4, 0.4)], 0.02)
    scene.add_sphere("ball", 0.2)
    scene.set_contact(restitution=0.0, friction=0.5)
    run = cvi.simulate(scene, at([0.003, 0.0, 0.6]), duration=1.5, dt=0.005)
    assert run.status.ok
    found = feet_of(scene, "stones", run.q[-1, :3], 0.202)
    assert len(found) == 2
    np.testing.assert_allclose(found[:, 0], 0.2, atol=1e-9)
    assert abs(run.v[-1]).max() < 1e-9


# --- motions ---------------------------------------------------------------------------------------------------------


def _crossings(t: np.ndarray, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Instants at which x passes zero, by Hermite's cubic between the nodes."""
    from scipy.interpolate import CubicHermiteSpline

    return CubicHermiteSpline(t, x, v).roots(extrapolate=False)


@pytest.mark.parametrize("rolls", [False, True])
def test_a_ball_swings_across_a_torus_channel(rolls: bool) -> None:
    """In the circle of the tube: a pendulum of length r - a, slower by the root of 7/5 where it rolls."""
    scene = cvi.Scene()
    scene.add_torus("channel", RING, TUBE, free=False, hollow=True)
    scene.add_sphere("ball", RADIUS)
    scene.set_contact(restitution=0.0, friction=5.0 if rolls else 0.0)
    length, angle = TUBE - RADIUS, 0.6
    start = [RING + length * np.sin(angle), 0.0, -length * np.cos(angle)]
    run = cvi.simulate(scene, at(start), duration=1.5, dt=2e-3, order=4)
    assert run.status.ok
    np.testing.assert_allclose(np.hypot(run.q[:, 0] - RING, run.q[:, 2]), length, atol=1e-9)
    np.testing.assert_allclose(run.q[:, 1], 0.0, atol=1e-9)
    turn = [cvi_rotation(q) for q in run.q]
    speed = np.array([(R @ v)[0] for R, v in zip(turn, run.v[:, :3], strict=True)])
    zeros = _crossings(run.t, run.q[:, 0] - RING, speed)
    known = period(length, angle, GRAVITY * (5.0 / 7.0 if rolls else 1.0))
    np.testing.assert_allclose(np.diff(zeros), 0.5 * known, rtol=1e-6)


def cvi_rotation(q: np.ndarray) -> np.ndarray:
    import pinocchio as pin

    return pin.Quaternion(q[3:7]).toRotationMatrix()


def test_a_ball_rolls_along_a_standing_torus_channel() -> None:
    """The channel stands upright: at its bottom the ball swings along the ring, length R + r - a, rolling."""
    scene = cvi.Scene()
    scene.add_torus("channel", RING, TUBE, free=False, hollow=True, placement=((0.0, 0.0, 0.0), (np.pi / 2, 0.0, 0.0)))
    scene.add_sphere("ball", RADIUS)
    scene.set_contact(restitution=0.0, friction=5.0)
    length, angle = RING + TUBE - RADIUS, 0.4
    run = cvi.simulate(
        scene, at([length * np.sin(angle), 0.0, -length * np.cos(angle)]), duration=4.0, dt=5e-3, order=4
    )
    assert run.status.ok
    speed = np.array([(cvi_rotation(q) @ v[:3])[0] for q, v in zip(run.q, run.v, strict=True)])
    zeros = _crossings(run.t, run.q[:, 0], speed)
    np.testing.assert_allclose(np.diff(zeros), 0.5 * period(length, angle, GRAVITY / 1.4), rtol=1e-6)


def test_a_ball_in_a_sampled_bowl_has_the_period_of_the_sphere() -> None:
    """A bowl of samples, against the inside of a sphere: the period to the error of the surface."""
    bowl = 0.5

    def inside(p: np.ndarray) -> np.ndarray:
        return np.linalg.norm(p, axis=1) - bowl

    scene = cvi.Scene()
    scene.add_solid("bowl", inside, [(-0.6, 0.6)] * 3, 0.04, hollow=True)
    scene.add_sphere("ball", 0.1)
    scene.set_contact(restitution=0.0, friction=0.0)
    angle = 0.5
    start = [0.4 * np.sin(angle), 0.0, -0.4 * np.cos(angle)]
    run = cvi.simulate(scene, at(start), duration=2.0, dt=5e-3, order=4)
    assert run.status.ok
    zeros = _crossings(run.t, run.q[:, 0], run.v[:, 0])
    np.testing.assert_allclose(np.diff(zeros), 0.5 * period(0.4, angle), rtol=1e-4)


def test_a_free_superellipsoid_of_exponent_two_is_an_ellipsoid() -> None:
    """It falls on fixed balls as the built-in ellipsoid does: events to 1e-9 s."""
    runs = []
    for made in (True, False):
        scene = cvi.Scene()
        if made:
            scene.add_superellipsoid("stone", [0.3, 0.2, 0.15], 2.0, mass=2.0)
        else:
            scene.add_ellipsoid("stone", [0.3, 0.2, 0.15], mass=2.0)
        for k, (x, y) in enumerate(((0.2, 0.0), (-0.1, 0.15), (-0.1, -0.15))):
            scene.add_sphere(f"ball_{k}", 0.05, free=False, placement=(x, y, 0.0))
        scene.set_contact(restitution=0.5, friction=0.2)
        runs.append(cvi.simulate(scene, at([0.02, 0.01, 0.4]), duration=0.45, dt=0.005))
    found, known = runs
    assert found.status.ok
    assert len(found.events) == len(known.events) > 0
    np.testing.assert_allclose([e.time for e in found.events], [e.time for e in known.events], atol=1e-9)
    np.testing.assert_allclose(found.q[-1], known.q[-1], atol=1e-7)


def test_inertias() -> None:
    """Of torus and superellipsoid, against sums over fine cells."""
    torus = cvi.Scene()
    torus.add_torus("ring", RING, TUBE, mass=3.0)
    stone = cvi.Scene()
    stone.add_superellipsoid("stone", [0.5, 0.3, 0.2], 4.0, mass=3.0)
    n = 161
    for scene, box, solid in (
        (torus, [0.7, 0.7, 0.2], torus_function),
        (stone, [0.5, 0.3, 0.2], lambda p: (np.abs(p / [0.5, 0.3, 0.2]) ** 4).sum(axis=1) - 1.0),
    ):
        axes = [half * (2.0 * (np.arange(n) + 0.5) / n - 1.0) for half in box]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        within = points[solid(points) < 0.0]
        squares = 3.0 * (within**2).mean(axis=0)
        np.testing.assert_allclose(np.diag(scene.model.inertias[1].inertia), squares.sum() - squares, rtol=2e-3)


# --- derivatives and ways in -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_derivatives_of_a_run_in_a_channel() -> None:
    """Tangents against differences: falls in, slides, with the curvature of the torus."""
    scene = cvi.Scene()
    scene.add_sphere("ball", RADIUS)
    scene.add_torus("channel", RING, TUBE, free=False, hollow=True)
    scene.set_contact(restitution=0.0, friction=0.2)
    q = at([RING + 0.05, 0.0, -0.06])
    traj = check(
        (scene, q, np.array([0.1, 0.5, 0.0, 0.3, 0.2, 0.1])), list(range(2 * scene.nv)), (1e-4, 5e-5), duration=0.2,
        dt=0.005, order=2,
    )  # fmt: skip
    assert traj.status.ok
    assert len(traj.contact_changes) > 0


def test_they_are_stored() -> None:
    scene = cvi.Scene()
    scene.add_torus("ring", RING, TUBE, free=False)
    scene.add_superellipsoid("stone", [0.3, 0.2, 0.1], 3.0, free=False, placement=(2.0, 0.0, 0.0))
    scene.add_solid("sampled", torus_function, [(-0.8, 0.8), (-0.8, 0.8), (-0.3, 0.3)], 0.05, placement=(4.0, 0.0, 0.0))
    scene.add_thread("bolt", 0.2, 0.05, 0.3, 1.0, placement=(6.0, 0.0, 0.0))
    scene.add_sphere("ball", RADIUS)
    assert scene.to_dict()["missing"] == []
    runs = [
        cvi.simulate(made, at([0.5, 0.0, 0.4]), duration=0.3, dt=0.01)
        for made in (scene, cvi.Scene.from_dict(scene.to_dict()), pickle.loads(pickle.dumps(scene)))
    ]
    assert len(runs[0].events) > 0
    for run in runs[1:]:
        np.testing.assert_array_equal(run.q, runs[0].q)


def test_what_is_refused() -> None:
    scene = cvi.Scene()
    with pytest.raises(InputError, match="less than the ring"):
        scene.add_torus("a", 0.2, 0.3)
    with pytest.raises(InputError, match="fixed to the world"):
        scene.add_torus("a", 0.5, 0.2, hollow=True)
    with pytest.raises(InputError, match="less than the radius"):
        scene.add_thread("a", 0.1, 0.2, 0.3, 1.0)
    with pytest.raises(InputError, match="another number than zero"):
        scene.add_thread("a", 0.2, 0.1, 0.0, 1.0)
    with pytest.raises(InputError, match="exponent"):
        scene.add_superellipsoid("a", [1.0, 1.0, 1.0], 1.5)
    with pytest.raises(InputError, match="border of the extent"):
        scene.add_solid("a", torus_function, [(-0.6, 0.6), (-0.8, 0.8), (-0.3, 0.3)], 0.05)
    with pytest.raises(InputError, match="no negative value"):
        scene.add_solid("a", lambda p: 1.0 + p[:, 0] ** 2, [(-0.6, 0.6), (-0.8, 0.8), (-0.3, 0.3)], 0.05)
    with pytest.raises(UserFunctionError):
        scene.add_solid("a", lambda p: p, [(-0.6, 0.6), (-0.8, 0.8), (-0.3, 0.3)], 0.05)
    scene.add_torus("ring", RING, TUBE)
    scene.add_surface("ground", height=lambda p: 0.0 * p[:, 0])
    with pytest.raises(SceneError, match="no contact"):
        scene.core()
