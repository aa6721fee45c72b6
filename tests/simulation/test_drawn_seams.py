"""What slides or rolls over flush shapes moves as on one plate, and real edges stay edges.

The reference is one box in the place of many: the path is that of the rigid body on a plane. Layouts are drawn: a plate
is cut again and again across one of its sides, in a frame that is turned so that no coordinate is exact.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi

SIZE = np.array([2.0, 1.0])  # of the plate [m]
SPEED = 1.5  # [m/s]
RADIUS = 0.05  # [m] of what is round
# [m/s] Features touch to 1e-11 m: the normal of a ball on the edge of the next tile, or of two edges rounded by
# 1e-6 m, is then off by sqrt(2e-11 / RADIUS) = 2e-5 rad. A body that trips closes with some SPEED.
CLOSES = 1e-4
Rectangle = tuple[np.ndarray, np.ndarray]


def cut(rng: np.random.Generator, low: np.ndarray, high: np.ndarray, times: int) -> list[Rectangle]:
    """Cut a rectangle in two, and its parts again, `times` times."""
    if times == 0:
        return [(low, high)]
    axis = int(rng.integers(2))
    at = low[axis] + (high - low)[axis] * rng.uniform(0.3, 0.7)
    first, second = high.copy(), low.copy()
    first[axis] = second[axis] = at
    return cut(rng, low, first, times - 1) + cut(rng, second, high, times - 1)


def tiles(layout: str, seed: int) -> list[Rectangle]:
    """Rectangles that cover the plate."""
    if layout == "plate":
        return [(np.zeros(2), SIZE)]
    if layout == "ten":
        return [(np.array([0.2 * k, 0.0]), np.array([0.2 * (k + 1), 1.0])) for k in range(10)]
    return cut(np.random.default_rng(seed + 1000), np.zeros(2), SIZE, 4)


def angle_mesh() -> tuple[np.ndarray, np.ndarray]:
    """An L, 0.1 m thick, whose top is z = 0."""
    outline = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.8, 1.0], [0.8, 2.0], [0.0, 2.0]])
    n = len(outline)
    top = [(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)]
    faces = [(a + n, b + n, c + n) for a, b, c in top] + [(c, b, a) for a, b, c in top]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, j, j + n), (i, j + n, i + n)]
    vertices = np.vstack([np.c_[outline, np.full(n, -0.1)], np.c_[outline, np.zeros(n)]])
    return vertices, np.array(faces)


def slide(kind: str, layout: str, seed: int, friction: float, x: float = 0.3) -> cvi.Trajectory:
    """A body slides or rolls along the plate, from some x [m]."""
    rng = np.random.default_rng(seed)
    turn = pin.rpy.rpyToMatrix(*rng.uniform(-1.5, 1.5, 3))
    scene = cvi.Scene(gravity=turn @ np.array([0.0, 0.0, -9.81]))

    def at(x: float, y: float, z: float, rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> pin.SE3:
        return pin.SE3(turn @ pin.rpy.rpyToMatrix(*rpy), turn @ np.array([x, y, z]))

    if layout == "field":
        scene.add_heightfield("tile", np.zeros((5, 11)), SIZE, smooth=False, placement=at(*(0.5 * SIZE), 0.0))
    elif layout == "pieces":
        scene.add_mesh(
            "tile", angle_mesh(), free=False, decompose=True, placement=at(0.0, 1.0, 0.0, (0.0, 0.0, -0.5 * np.pi))
        )
    else:
        for k, (low, high) in enumerate(tiles(layout, seed)):
            middle = 0.5 * (low + high)
            scene.add_box(f"tile{k}", (*(high - low), 0.1), free=False, placement=at(*middle, -0.05))
    y, yaw, way = 0.5 + rng.uniform(-0.1, 0.1), rng.uniform(-3.0, 3.0), rng.uniform(-0.15, 0.15)
    spin = np.zeros(3)
    if kind == "box":
        scene.add_box("body", (*rng.uniform(0.05, 0.2, 2), 0.1), placement=at(x, y, 0.05, (0.0, 0.0, yaw)))
    elif kind == "cylinder":
        scene.add_cylinder("body", RADIUS, 0.2, placement=at(x, y, RADIUS, (0.5 * np.pi, 0.0, 0.0)))
        spin, way = turn @ np.array([0.0, SPEED / RADIUS, 0.0]), 0.0
    elif kind == "capsule":
        scene.add_capsule("body", RADIUS, 0.15, placement=at(x, y, RADIUS, (0.0, 0.5 * np.pi, 0.0)))
    else:
        scene.add_sphere("body", RADIUS, placement=at(x, y, RADIUS))
    scene.set_contact(friction=friction, restitution=0.0)
    q = scene.neutral()
    v = scene.velocity({"body": (turn @ (SPEED * np.array([np.cos(way), np.sin(way), 0.0])), spin)}, q)
    return cvi.simulate(scene, q, v, duration=0.6, dt=2e-3, start="separate")


def check_as_on_a_plate(kind: str, layout: str, seed: int, friction: float, bound: float, x: float = 0.3) -> None:
    plate, seams = (slide(kind, name, seed, friction, x) for name in ("plate", layout))
    assert plate.status.ok
    assert seams.status.ok
    assert np.abs(plate.q[-1] - seams.q[-1]).max() < bound
    assert np.abs(plate.v[-1] - seams.v[-1]).max() < 10.0 * bound
    crossed = {name for change in seams.contact_changes for name in change.pair} - {"body"}
    assert len(crossed) > (1 if layout == "pieces" else 2)
    assert max((-event.gamma_minus for event in seams.events if event.time > 1e-3), default=0.0) < CLOSES


# [m] What closes at a seam with 3e-5 m/s along a normal that is off by 2e-5 rad takes 6e-10 m/s of the speed at most.
BOUNDS = {"box": 1e-9, "capsule": 1e-9, "ball": 1e-9, "cylinder": 1e-9}


# A capsule that lies across seams has more points than on a plate, and where friction turns it the share of its weight
# at each counts (docs/limits.md).
WITH_FRICTION = [(kind, friction) for kind in BOUNDS for friction in (0.0, 0.2) if (kind, friction) != ("capsule", 0.2)]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("layout", ["ten", "drawn"])
@pytest.mark.parametrize(("kind", "friction"), WITH_FRICTION)
def test_a_body_moves_over_tiles_as_over_a_plate(kind: str, layout: str, friction: float, seed: int):
    check_as_on_a_plate(kind, layout, seed, friction, BOUNDS[kind])


@pytest.mark.parametrize(("kind", "friction"), [pair for pair in WITH_FRICTION if pair != ("cylinder", 0.2)])
def test_a_body_moves_over_a_flat_field_of_triangles_as_over_a_plate(kind: str, friction: float):
    check_as_on_a_plate(kind, "field", 0, friction, BOUNDS[kind])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("kind", "friction"), WITH_FRICTION)
def test_a_body_moves_over_pieces_of_a_mesh_as_over_a_plate(kind: str, friction: float, seed: int):
    """The longer arm of an L that CoACD has cut across it."""
    check_as_on_a_plate(kind, "pieces", seed, friction, BOUNDS[kind], x=0.7)


@pytest.mark.parametrize("step", [1e-3, 1e-5])
def test_a_step_up_is_an_edge(step: float):
    """A box slides from one tile against the side of another one that is higher: it stops, whatever is below it."""
    scene = cvi.Scene()
    scene.add_box("low", (1.0, 1.0, 0.1), free=False, placement=(0.0, 0.0, -0.05))
    scene.add_box("high", (1.0, 1.0, 0.1), free=False, placement=(1.0, 0.0, -0.05 + step))
    scene.add_box("body", (0.2, 0.2, 0.1), placement=(0.2, 0.0, 0.05))
    scene.set_contact(friction=0.0, restitution=0.0)
    v = scene.velocity({"body": (np.array([1.0, 0.0, 0.0]), np.zeros(3))}, scene.neutral())
    traj = cvi.simulate(scene, scene.neutral(), v, duration=0.3, dt=2e-3)
    first = next(event for event in traj.events if "high" in event.pair)
    assert -first.gamma_minus == pytest.approx(1.0, rel=1e-2)  # its edge and that of the tile are rounded by 1e-6 m
    assert first.time == pytest.approx(0.2, abs=1e-5)


def test_what_stands_in_a_corner_touches_the_floor_and_the_wall():
    """A wall on a floor: its lower edge lies in the floor, and what is pushed into the corner meets the wall."""
    scene = cvi.Scene()
    scene.add_box("floor", (2.0, 1.0, 0.1), free=False, placement=(0.0, 0.0, -0.05))
    scene.add_box("wall", (0.1, 1.0, 0.5), free=False, placement=(0.5, 0.0, 0.25))
    scene.add_box("body", (0.2, 0.2, 0.1), placement=(0.2, 0.0, 0.05))
    scene.set_contact(friction=0.0, restitution=0.5)
    v = scene.velocity({"body": (np.array([1.0, 0.0, 0.0]), np.zeros(3))}, scene.neutral())
    traj = cvi.simulate(scene, scene.neutral(), v, duration=0.3, dt=2e-3)
    assert traj.status.ok
    hit = [event for event in traj.events if "wall" in event.pair]
    assert hit[0].time == pytest.approx(0.15, abs=1e-9)
    assert traj.v[-1, 0] == pytest.approx(-0.5, abs=1e-9)
