"""Two shapes on free bodies as one collision pair of the engine, and shapes and poses to touch with."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from contactvi import _core
from helpers.engine import scene_of_shapes

WITNESS, VERTEX = _core.PointKind.WITNESS, _core.PointKind.VERTEX
RIM, EDGE = _core.PointKind.RIM, _core.PointKind.EDGE
END, RIM_LINE = _core.PointKind.END, _core.PointKind.RIM_LINE
ROUNDING = 1e-6  # of polytopes against polytopes [m]
SLACK = 3e-11
Z = np.array([0.0, 0.0, 1.0])
GROUND = coal.Halfspace(Z, 0.0)
IDENTITY = pin.SE3.Identity()


def turn(axis, angle: float) -> np.ndarray:
    axis = np.asarray(axis, float)
    return pin.AngleAxis(angle, axis / np.linalg.norm(axis)).toRotationMatrix()


def pose(x=0.0, y=0.0, z=0.0, R=None) -> pin.SE3:
    return pin.SE3(np.eye(3) if R is None else R, np.array([x, y, z]))


def hull(points: np.ndarray) -> coal.ConvexBase:
    vertices = coal.StdVec_Vec3s()
    for x in np.asarray(points, float):
        vertices.append(x)
    return coal.Convex.convexHull(vertices, True, "Qt")


def prism(corners: int, radius: float = 0.1, half: float = 0.07) -> np.ndarray:
    angles = 2 * np.pi * np.arange(corners) / corners
    return np.array([[radius * np.cos(a), radius * np.sin(a), z] for a in angles for z in (-half, half)])


class Two:
    """Two shapes on a free body each, as the pair (a, b) of an engine scene."""

    def __init__(self, a, b, place_a: pin.SE3 = IDENTITY, place_b: pin.SE3 = IDENTITY):
        self.model, shapes = pin.Model(), pin.GeometryModel()
        for name, shape, place in (("a", a, place_a), ("b", b, place_b)):
            joint = self.model.addJoint(0, pin.JointModelFreeFlyer(), IDENTITY, name)
            shapes.addGeometryObject(pin.GeometryObject(name, joint, place, shape))
        shapes.addCollisionPair(pin.CollisionPair(0, 1))
        self.core = scene_of_shapes(self.model, shapes)

    @staticmethod
    def q(a: pin.SE3, b: pin.SE3) -> np.ndarray:
        return np.concatenate([pin.SE3ToXYZQUAT(a), pin.SE3ToXYZQUAT(b)])

    def points(self, a: pin.SE3, b: pin.SE3, margin: float = 1e-9, most: int = 4) -> dict:
        found = _core.contact_points(self.core, self.q(a, b), 0, margin, most)
        assert np.isfinite(found["gap"]).all()
        assert all(found["valid"])
        found["x"] = 0.5 * (found["point_a"] + found["point_b"])
        return found

    def of(self, a: pin.SE3, b: pin.SE3, features: list[int]) -> dict:
        return _core.contact_points_of(self.core, self.q(a, b), 0, features)

    def rest(self, a: pin.SE3, b: pin.SE3, features: list[int], most: int = 4) -> float:
        return _core.rest_gap(self.core, self.q(a, b), 0, features, most)[0]

    def nearest(self, a: pin.SE3, b: pin.SE3) -> float:
        return _core.nearest_gap(self.core, self.q(a, b), 0)

    def noise(self) -> float:
        return _core.distance_noise(self.core, self.q(IDENTITY, IDENTITY), 0)

    def gap(self, a: pin.SE3, b: pin.SE3) -> float:
        return self.core.gaps(self.q(a, b))[0][0]

    def touching(self, a: pin.SE3, b: pin.SE3) -> pin.SE3:
        """b moved along the normal until it touches a by coal's distance."""
        for _ in range(40):
            gap, normal, *_ = self.core.gaps(self.q(a, b))
            if abs(gap[0]) < 1e-12:
                break
            b = pin.SE3(b.rotation, b.translation - gap[0] * normal[0])
        return b


def random_pose(rng: np.random.Generator, size: float = 1.0) -> pin.SE3:
    return pin.SE3(pin.Quaternion(rng.normal(size=4)).normalized().matrix(), size * rng.normal(size=3))


def random_hull(rng: np.random.Generator, count: int) -> np.ndarray:
    directions = rng.normal(size=(count, 3))
    return 0.1 * directions / np.linalg.norm(directions, axis=1)[:, None]


def stacked(angle=0.0, x=0.0, y=0.0, z=0.2) -> pin.SE3:
    return pose(x, y, z, turn(Z, angle))


STACKS = {
    "aligned": stacked(),
    "offset": stacked(0.0, 0.05, 0.03),
    "offset along one axis": stacked(0.0, 0.05),
    "turned by 45 degrees": stacked(np.pi / 4),
    "turned a little": stacked(1e-3, 0.01, 0.02),
    "turned by less than rounding": stacked(1e-13),
    "turned by a quarter": stacked(np.pi / 2, 1e-3),
    "overhanging corner": stacked(0.3, 0.12, 0.1),
}
