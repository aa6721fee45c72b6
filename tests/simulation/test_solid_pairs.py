"""Two solids that meet each other: their common normals against an independent search, motions against closed forms."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.errors import SceneError
from derivatives.test_persistent_sensitivity import check
from oracles.nearest_solids import common_normals

GRAVITY = 9.81
RING, TUBE = 0.5, 0.2
RADII, EXPONENT = np.array([0.3, 0.2, 0.15]), 3.0
PEAR = [(-0.4, 0.4), (-0.4, 0.4), (-0.5, 0.5)]


def at(center: Any) -> np.ndarray:
    return np.array([*center, 0.0, 0.0, 0.0, 1.0])


def torus(p: np.ndarray) -> np.ndarray:
    return np.hypot(np.hypot(p[:, 0], p[:, 1]) - RING, p[:, 2]) - TUBE


def stone(p: np.ndarray) -> np.ndarray:
    return (np.abs(p / RADII) ** EXPONENT).sum(axis=1) ** (1.0 / EXPONENT) - 1.0


def pear(p: np.ndarray) -> np.ndarray:
    """A smooth union of two balls, with a waist."""
    low, high = (np.linalg.norm(p - [0.0, 0.0, z], axis=1) - r for z, r in ((-0.15, 0.2), (0.2, 0.13)))
    return -0.05 * np.log(np.exp(-low / 0.05) + np.exp(-high / 0.05))


def two_solids(first: str, second: str) -> tuple[cvi.Scene, list[Callable[[np.ndarray], np.ndarray]], list[np.ndarray]]:
    """Return a scene of two solids, their functions in their own frames, and boxes around them."""
    scene, functions, boxes = cvi.Scene(np.zeros(3)), [], []
    for name, kind in (("a", first), ("b", second)):
        if kind == "torus":
            scene.add_torus(name, RING, TUBE, free=name == "b")
            functions.append(torus)
            boxes.append(np.outer([RING + TUBE, RING + TUBE, TUBE], [-1.0, 1.0]))
        elif kind == "stone":
            scene.add_superellipsoid(name, RADII, EXPONENT, free=name == "b")
            functions.append(stone)
            boxes.append(np.outer(RADII, [-1.0, 1.0]))
        else:
            inertia = pin.Inertia(1.0, np.zeros(3), 0.02 * np.eye(3)) if name == "b" else None
            scene.add_solid(name, pear, PEAR, 0.04, inertia=inertia)
            functions.append(lambda p, solid=scene.surfaces[name]: solid.at(p)[0])
            boxes.append(np.array(PEAR))
    return scene, functions, boxes


def normals_of(scene: cvi.Scene, R: np.ndarray, t: np.ndarray, reach: float) -> np.ndarray:
    """Rows gap, normal, place on a, place on b, of the engine, with b at R x + t; all but the last in a's frame."""
    model = scene.collision_model
    return scene.core().common_normals(model.getGeometryId("a"), model.getGeometryId("b"), R, t, reach)


def random_pose(rng: np.random.Generator, away: float) -> tuple[np.ndarray, np.ndarray]:
    quaternion = rng.normal(size=4)
    direction = rng.normal(size=3)
    R = pin.Quaternion(quaternion / np.linalg.norm(quaternion)).toRotationMatrix()
    return R, away * direction / np.linalg.norm(direction)


# --- distances -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pair", [("torus", "stone"), ("stone", "stone"), ("torus", "torus"), ("pear", "stone")])
def test_common_normals(pair: tuple[str, str]) -> None:
    """All local minima within a reach, in random poses, and again with an overlap of 1e-4 m."""
    scene, (first, second), (box_a, box_b) = two_solids(*pair)
    away = {"torus": 0.9, "stone": 0.5, "pear": 0.6}[pair[0]] + (0.3 if pair[1] == "torus" else 0.0)
    rng = np.random.default_rng(3)
    reach, compared = 0.1, 0
    for trial in range(4):
        R, t = random_pose(rng, away)
        if trial == 3 and pair == ("torus", "stone"):  # upright in the hole of the torus
            R, t = pin.rpy.rpyToMatrix(0.1, 0.5 * np.pi, 0.0), np.array([0.03, 0.02, 0.05])
        placed, shift = (lambda p, R=R, t=t: second((p - t) @ R)), np.zeros(3)
        corners = np.array(np.meshgrid(*box_b, indexing="ij")).reshape(3, -1).T @ R.T + t
        around = np.stack([corners.min(axis=0), corners.max(axis=0)], axis=1)
        known = common_normals(first, placed, (box_a + [-0.03, 0.03], around + [-0.03, 0.03]), 0.02)
        if not len(known) or known[0, 0] < -1e-3:
            continue
        compared += 1
        for depth in (None, 1e-4):
            if depth is not None:  # along its normal a gap changes by as much as the solids are moved
                shift = -(known[0, 0] + depth) * known[0, 1:4]
            found = normals_of(scene, R, t + shift, max(known[0, 0], 0.0) + reach if depth is None else 1e-9)
            if depth is None:
                within = known[known[:, 0] <= known[0, 0] + 0.99 * reach]
                for row in within:
                    off = np.abs(found[:, 0] - row[0]) + np.linalg.norm(found[:, 1:7] - row[1:7], axis=1)
                    assert off.min() < 1e-6, (trial, row, found)
                assert abs(found[:, 0].min() - known[0, 0]) < 1e-9
            else:
                k = int(np.argmin(found[:, 0]))
                if len(known) == 1 or known[1, 0] - known[0, 0] > 1e-3:
                    assert abs(found[k, 0] + depth) < 1e-9
                    np.testing.assert_allclose(found[k, 1:4], known[0, 1:4], atol=1e-6)
            # What is found are common normals.
            for gap, *rest in found:
                n, p, x = np.array(rest).reshape(3, 3)
                x = R @ x + t + shift
                np.testing.assert_allclose(x - p, gap * n, atol=1e-9)
                assert abs(first(p[None])[0]) < 1e-9
                assert abs(second((x - t - shift)[None] @ R)[0]) < 1e-9
    assert compared >= 2  # poses that overlap deeply are left out


@pytest.mark.parametrize("pair", [("torus", "stone"), ("stone", "stone")])
def test_a_short_reach_finds_what_a_long_one_does(pair: tuple[str, str]) -> None:
    """Cells that a bound on their gaps leaves out for the short one have no common normal within it."""
    scene, _, _ = two_solids(*pair)
    rng = np.random.default_rng(7)
    for _ in range(6):
        R, t = random_pose(rng, 0.9 if pair[0] == "torus" else 0.6)
        every = normals_of(scene, R, t, 0.3)
        least = every[:, 0].min()
        for reach in (0.0, max(least, 0.0) + 0.05):
            found = normals_of(scene, R, t, reach)
            assert abs(found[:, 0].min() - least) < 1e-12
            for row in every[every[:, 0] <= reach - 1e-9]:
                assert np.abs(found - row).max(axis=1).min() < 1e-7


def test_two_spheres_have_one_common_normal() -> None:
    """Superellipsoids of exponent 2 and equal axes: the distance of two balls, to rounding, apart and overlapping."""
    scene = cvi.Scene()
    scene.add_superellipsoid("a", [0.3] * 3, 2.0, free=False)
    scene.add_superellipsoid("b", [0.2] * 3, 2.0)
    rng = np.random.default_rng(0)
    for distance in (1.0, 0.6, 0.5, 0.4999, 0.45):
        R, t = random_pose(rng, distance)
        found = normals_of(scene, R, t, 0.0)
        assert len(found) == 1
        assert abs(found[0, 0] - (distance - 0.5)) < 1e-13
        np.testing.assert_allclose(found[0, 1:4], t / distance, atol=1e-9)


# --- motions ---------------------------------------------------------------------------------------------------------


def momentum(scene: cvi.Scene, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Linear and angular momentum about the origin of the world."""
    model = scene.model
    data = model.createData()
    pin.computeCentroidalMomentum(model, data, q, v)
    pin.centerOfMass(model, data, q)
    h = data.hg.vector.copy()
    h[3:] += np.cross(data.com[0], h[:3])
    return h


def energy(scene: cvi.Scene, q: np.ndarray, v: np.ndarray) -> float:
    model = scene.model
    data = model.createData()
    return float(pin.computeKineticEnergy(model, data, q, v) + pin.computePotentialEnergy(model, data, q))


@pytest.mark.parametrize("shapes", ["tori", "stones", "torus and stone"])
def test_solids_bounce(shapes: str) -> None:
    """Elastic and without friction: energy kept, momentum exact, gaps as promised."""
    scene = cvi.Scene(np.zeros(3))
    if shapes == "tori":
        scene.add_torus("a", 0.3, 0.1, mass=1.0)
        scene.add_torus("b", 0.25, 0.08, mass=2.0)
    elif shapes == "stones":
        scene.add_superellipsoid("a", [0.3, 0.2, 0.25], 3.0, mass=1.0)
        scene.add_superellipsoid("b", [0.2, 0.3, 0.15], 4.0, mass=2.0)
    else:
        scene.add_torus("a", 0.3, 0.1, mass=1.0)
        scene.add_superellipsoid("b", [0.2, 0.3, 0.15], 4.0, mass=2.0)
    scene.set_contact(restitution=1.0, friction=0.0)
    q = np.concatenate([at([0.0, 0.0, 0.0]), at([0.9, 0.1, 0.12])])
    v = np.array([0.5, 0.0, 0.0, 0.3, 1.0, -0.4, -0.5, 0.0, 0.0, 0.2, -0.5, 0.8])
    run = cvi.simulate(scene, q, v, duration=1.2, dt=0.01, order=4)
    assert run.status.ok
    assert len(run.events) > 0
    h0, e0 = momentum(scene, run.q[0], run.v[0]), energy(scene, run.q[0], run.v[0])
    np.testing.assert_allclose(momentum(scene, run.q[-1], run.v[-1]), h0, atol=1e-9)
    assert abs(energy(scene, run.q[-1], run.v[-1]) - e0) < 1e-7
    assert min(scene.core().gaps(q)[0][0] for q in run.q) > -1e-9


@pytest.mark.parametrize("other", ["superellipsoid", "ellipsoid"])
def test_spheres_of_functions_bounce_and_roll_as_balls(other: str) -> None:
    """Against the same as built-in balls: events, then sliding and rolling on a big fixed one."""
    runs = []
    for made in (True, False):
        scene = cvi.Scene()
        if made:
            scene.add_superellipsoid("floor", [1.0] * 3, 2.0, free=False)
            if other == "ellipsoid":
                scene.add_ellipsoid("ball", [0.2] * 3)
            else:
                scene.add_superellipsoid("ball", [0.2] * 3, 2.0)
        else:
            scene.add_sphere("floor", 1.0, free=False)
            scene.add_sphere("ball", 0.2)
        scene.set_contact(restitution=0.4, friction=0.3)
        runs.append(cvi.simulate(scene, at([0.1, 0.0, 1.3]), [0.2, 0.1, 0, 0, 1.0, 0], duration=1.0, dt=0.005))
    found, known = runs
    assert found.status.ok
    assert len(found.events) == len(known.events) > 2
    np.testing.assert_allclose([e.time for e in found.events], [e.time for e in known.events], atol=1e-9)
    np.testing.assert_allclose(found.q[-1], known.q[-1], atol=1e-7)


def test_a_solid_falls_on_a_halfspace_as_an_ellipsoid() -> None:
    runs = []
    for made in (True, False):
        scene = cvi.Scene()
        scene.add_halfspace((0.1, 0.0, 1.0))
        if made:
            scene.add_superellipsoid("stone", [0.3, 0.2, 0.15], 2.0, mass=2.0)
        else:
            scene.add_ellipsoid("stone", [0.3, 0.2, 0.15], mass=2.0)
        scene.set_contact(restitution=0.3, friction=0.4)
        runs.append(cvi.simulate(scene, at([0.0, 0.0, 0.6]), [0, 0, 0, 1.0, 0.5, 0.0], duration=0.8, dt=0.005))
    found, known = runs
    assert found.status.ok
    assert len(found.events) == len(known.events) > 1
    np.testing.assert_allclose([e.time for e in found.events], [e.time for e in known.events], atol=1e-9)
    np.testing.assert_allclose(found.q[-1], known.q[-1], atol=1e-7)


def test_a_chain_of_tori_hangs() -> None:
    """Rings in planes that cross: each hangs below the one above, and carries those below it."""
    ring, tube, mass = 0.1, 0.02, 0.5
    scene = cvi.Scene()
    upright, q = pin.rpy.rpyToMatrix(np.pi / 2, 0.0, 0.0), []
    scene.add_torus("ring_0", ring, tube, free=False, placement=((0.0, 0.0, 0.0), (np.pi / 2, 0.0, 0.0)))
    for k in (1, 2):
        scene.add_torus(f"ring_{k}", ring, tube, mass=mass)
        turned = pin.rpy.rpyToMatrix(0.0, 0.0, 0.5 * np.pi * k) @ upright
        q += [0.0, 0.0, -2.0 * k * (ring - tube), *pin.Quaternion(turned).coeffs()]
    scene.set_contact(restitution=0.0, friction=0.5)
    run = cvi.simulate(scene, np.array(q), None, duration=0.2, dt=2e-3, start="separate")
    assert run.status.ok
    np.testing.assert_allclose(run.q[-1], q, atol=1e-6)
    assert abs(run.v[-1]).max() < 1e-6
    for k in (1, 2):
        force = run.contacts.force_of(f"ring_{k - 1}", f"ring_{k}")[1][-1]
        assert abs(abs(force[2]) - (3 - k) * mass * GRAVITY) < 1e-6


# --- derivatives and ways in -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_derivatives_of_a_stone_on_a_torus() -> None:
    """Tangents against differences, through an impact and sliding, with the curvature of both."""
    scene = cvi.Scene()
    scene.add_superellipsoid("stone", [0.2, 0.15, 0.12], 3.0)
    scene.add_torus("ring", RING, TUBE, free=False)
    scene.set_contact(restitution=0.0, friction=0.2)
    q = at([RING - 0.02, 0.01, TUBE + 0.15])
    traj = check(
        (scene, q, np.array([0.1, 0.2, 0.0, 0.3, 0.2, 0.1])), list(range(2 * scene.nv)), (1e-4, 5e-5), duration=0.15,
        dt=0.005, order=2,
    )  # fmt: skip
    assert traj.status.ok
    assert len(traj.contact_changes) > 0


def test_runs_are_repeated_to_the_bit() -> None:
    scene = cvi.Scene()
    scene.add_torus("ring", RING, TUBE, free=False)
    scene.add_superellipsoid("stone", [0.3, 0.2, 0.1], 3.0)
    scene.set_contact(restitution=0.2, friction=0.3)
    runs = [
        cvi.simulate(made, at([0.5, 0.0, 0.4]), duration=0.3, dt=0.01)
        for made in (scene, cvi.Scene.from_dict(scene.to_dict()), pickle.loads(pickle.dumps(scene)))
    ]
    assert len(runs[0].events) > 0
    for run in runs[1:]:
        np.testing.assert_array_equal(run.q, runs[0].q)


def test_what_is_refused() -> None:
    """Surfaces of functions meet no solids."""
    scene = cvi.Scene()
    scene.add_torus("ring", RING, TUBE)
    scene.add_surface("ground", height=lambda p: 0.0 * p[:, 0])
    with pytest.raises(SceneError, match="no contact"):
        scene.core()
