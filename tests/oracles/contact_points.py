"""Points where bodies touch, analytic: gap, normal and relative velocity W v of a corner, a sphere, a joint limit.

`body` touches `support`; the normal n points from the support to the body, W = (W_n; W_t) gives the velocity of the
body's point relative to the support's, rows (n, t1, t2). Joints are those of the split model (oracles.split), 0 is the
world; velocities are split ones. Where there is a gap, each body has its own point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .split import SplitModel


@dataclass(frozen=True)
class Touch:
    """gap [m], normal (3,), the points on support and body [m], world frame."""

    gap: float
    normal: np.ndarray
    on_support: np.ndarray
    on_body: np.ndarray


@dataclass(frozen=True)
class VertexPlane:
    """Sphere of `radius` about a point of `body` against a plane of `support`, n.x = offset, n outward.

    center (3,) [m] in the body's frame, normal (3,) and offset [m] in the support's. radius 0: a corner, whose point
    is fixed to the body (material).
    """

    body: int
    center: tuple[float, float, float]
    mu: float = 0.0
    support: int = 0
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    offset: float = 0.0
    radius: float = 0.0

    @property
    def material(self) -> bool:
        return self.radius == 0.0

    def touch(self, placements) -> Touch:
        s = placements[self.support]
        c = placements[self.body].act(np.array(self.center))
        n = s.rotation @ np.array(self.normal)
        height = n @ (c - s.translation) - self.offset
        return Touch(height - self.radius, n, c - height * n, c - self.radius * n)


@dataclass(frozen=True)
class SphereSphere:
    """Sphere (center, radius) of `body` on sphere (support_center, support_radius) of `support`, [m], own frames.

    A negative support_radius is a bowl: the body's sphere runs inside of it.
    """

    body: int
    center: tuple[float, float, float]
    radius: float
    support_center: tuple[float, float, float]
    support_radius: float
    mu: float = 0.0
    support: int = 0
    material = False

    def touch(self, placements) -> Touch:
        a = placements[self.support].act(np.array(self.support_center))
        c = placements[self.body].act(np.array(self.center))
        sign = np.sign(self.support_radius)
        distance = np.linalg.norm(c - a)
        n = sign * (c - a) / distance
        gap = sign * distance - self.support_radius - self.radius
        return Touch(gap, n, a + abs(self.support_radius) * sign * n, c - self.radius * n)


@dataclass(frozen=True)
class Limit:
    """A 1-dof joint at its limit: gap = side (q - bound) >= 0; side 1 for the lower, -1 for the upper limit."""

    joint: int
    bound: float
    side: float
    mu = 0.0
    material = False


class Points:
    """Kinematics of a list of points on a split model."""

    def __init__(self, split: SplitModel, points: list):
        self.split, self.points = split, points

    def touches(self, q) -> list[Touch]:
        pin.forwardKinematics(self.split.model, self.split.data, q)
        placements = [pin.SE3(m) for m in self.split.data.oMi]
        return [p.touch(placements) if not isinstance(p, Limit) else self._limit(p, q) for p in self.points]

    def _limit(self, p: Limit, q) -> Touch:
        j = self.split.joints[p.joint - 1]
        return Touch(float(p.side * (q[j.q][0] - p.bound)), np.zeros(3), np.zeros(3), np.zeros(3))

    def gaps(self, q) -> np.ndarray:
        return np.array([t.gap for t in self.touches(q)])

    def places(self, q) -> list[np.ndarray]:
        """The body's point in the support's frame."""
        touches = self.touches(q)
        pairs = zip(self.points, touches, strict=True)
        return [np.zeros(3) if isinstance(p, Limit) else self._frame(p).actInv(t.on_body) for p, t in pairs]

    def rotations(self, q) -> list[np.ndarray]:
        """Orientation of the supports."""
        self.touches(q)
        return [np.eye(3) if isinstance(p, Limit) else self._frame(p).rotation.copy() for p in self.points]

    def _frame(self, p) -> pin.SE3:
        return self.split.data.oMi[p.support]

    def bases(self, q) -> list[np.ndarray]:
        """[n t1 t2] of each point, (3, 3) with columns; any tangents."""
        return [_basis(t.normal) for t in self.touches(q)]

    def carried(self, bases, q) -> list[np.ndarray]:
        """The bases turned with the normals to their places at q, without turning about the normal."""
        return [_carry(b, t.normal) for b, t in zip(bases, self.touches(q), strict=True)]

    def gradients(self, q, bases) -> np.ndarray:
        """W at q, rows (n, t1, t2) by the bases, shape (m, 3, nv)."""
        model, data = self.split.model, self.split.data
        touches, w = self.touches(q), np.zeros((len(self.points), 3, self.split.nv))
        pin.computeJointJacobians(model, data, q)
        for i, (p, t) in enumerate(zip(self.points, touches, strict=True)):
            if isinstance(p, Limit):
                w[i, 0, self.split.joints[p.joint - 1].v] = p.side
                continue
            for joint, x, sign in ((p.support, t.on_support, -1.0), (p.body, t.on_body, 1.0)):
                if joint > 0:
                    j = pin.getJointJacobian(model, data, joint, pin.WORLD)
                    w[i] += sign * bases[i].T @ (j[:3] - np.cross(x, j[3:], axisb=0, axisc=0))
        return w


def _basis(n: np.ndarray) -> np.ndarray:
    if not n.any():
        return np.eye(3)
    t1 = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    t1 /= np.linalg.norm(t1)
    return np.column_stack([n, t1, np.cross(n, t1)])


def _carry(basis: np.ndarray, n: np.ndarray) -> np.ndarray:
    if not n.any():
        return basis
    axis, c = np.cross(basis[:, 0], n), basis[:, 0] @ n
    x = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return basis + x @ basis + x @ x @ basis / (1.0 + c)
