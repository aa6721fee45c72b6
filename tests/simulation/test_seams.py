"""What slides over ten flush tiles moves as on one plate.

A gap touches from 1e-11 m on. A ball of radius R is as near to the edge of the next tile d = sqrt(2e-11 R) = 1e-6 m
before it is over it, and closes there with v d / R, some 1e-5 m/s: small impacts remain at seams, also where
corners of a box come down on the next tile within the step in which they have left the last one.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi

TILES, LENGTH = 10, 0.2  # [m]
RADIUS = 0.05  # [m] of what rolls


def slide(kind: str, tiled: bool, friction: float, dt: float) -> cvi.Trajectory:
    """A body slides along x at 1.5 m/s for 0.7 s, in a frame that is turned so that no coordinate is exact."""
    turn = pin.rpy.rpyToMatrix(0.3, -0.4, 1.1)
    scene = cvi.Scene(gravity=turn @ np.array([0.0, 0.0, -9.81]))

    def at(x: float, z: float, rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> pin.SE3:
        return pin.SE3(turn @ pin.rpy.rpyToMatrix(*rpy), turn @ np.array([x, 0.0, z]))

    for k in range(TILES if tiled else 1):
        size = LENGTH if tiled else TILES * LENGTH
        scene.add_box(f"tile{k}", (size, 1.0, 0.1), free=False, placement=at((k + 0.5) * size, -0.05))
    if kind == "box":
        scene.add_box("body", (0.3, 0.2, 0.1), placement=at(0.237, 0.05))
    elif kind == "turned box":
        scene.add_box("body", (0.13, 0.07, 0.1), placement=at(0.237, 0.05, (0.0, 0.0, 0.4)))
    elif kind == "cylinder":
        scene.add_cylinder("body", RADIUS, 0.25, placement=at(0.237, RADIUS, (0.5 * np.pi, 0.0, 0.0)))
    elif kind == "capsule":
        scene.add_capsule("body", 0.05, 0.25, placement=at(0.237, 0.05, (0.0, 0.5 * np.pi, 0.0)))
    else:
        scene.add_sphere("body", 0.05, placement=at(0.237, 0.05))
    scene.set_contact(friction=friction, restitution=0.0)
    q = scene.neutral()
    spin = turn @ np.array([0.0, 1.5 / RADIUS, 0.0]) if kind == "cylinder" else np.zeros(3)
    v = scene.velocity({"body": (turn @ np.array([1.5, 0.0, 0.0]), spin)}, q)
    return cvi.simulate(scene, q, v, duration=0.7, dt=dt, start="separate")


@pytest.mark.parametrize("friction", [0.0, 0.1])
@pytest.mark.parametrize(("kind", "bound"), [("box", 1e-10), ("turned box", 1e-8), ("capsule", 1e-10), ("ball", 1e-6)])
def test_a_body_slides_over_tiles_as_over_a_plate(kind: str, bound: float, friction: float):
    """Equal ends; what closes at a seam is far slower than the 2e-2 m/s of a fall of one step."""
    plate, tiles = (slide(kind, tiled, friction, 2e-3) for tiled in (False, True))
    assert plate.status.ok
    assert tiles.status.ok
    assert np.abs(plate.q[-1] - tiles.q[-1]).max() < bound
    assert np.abs(plate.v[-1] - tiles.v[-1]).max() < 10.0 * bound
    assert len({pair for change in tiles.contact_changes for pair in change.pair if pair != "body"}) > 4
    assert max((-event.gamma_minus for event in tiles.events if event.time > 1e-3), default=0.0) < 1e-3


@pytest.mark.parametrize("friction", [0.0, 0.1])
def test_a_cylinder_rolls_over_seams_as_over_a_plate(friction: float):
    """With its axis along the seam it stands over the groove between two edges of radius r, r^2 / 2 R deep."""
    plate, tiles = (slide("cylinder", tiled, friction, 2e-3) for tiled in (False, True))
    r = 1e-6
    assert plate.status.ok
    assert tiles.status.ok
    assert np.abs(plate.q[-1] - tiles.q[-1]).max() < 1e-7
    assert np.abs(plate.v[-1] - tiles.v[-1]).max() < 1e-6
    # From one edge to the next its centre moves along a path that turns by 2 r / (R + r), as its speed does.
    assert max((-event.gamma_minus for event in tiles.events if event.time > 1e-3), default=0.0) < 3.0 * r / RADIUS
