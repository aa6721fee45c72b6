"""Where bodies touch in a run, and how strongly: what a picture of it shows in its middle and leaves in sight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.records.codes import GuardKind
from contactvi.records.contacts import ContactLog
from contactvi.scene.scene import Scene

Array = NDArray[np.float64]

_UNLIKELY = 1e-3  # weight of a pair that is too far apart to count
MOST = 60  # points of one moment that are looked at, the strongest ones


@dataclass(frozen=True)
class Touches:
    """Contact points, each over one step or in one impact.

    Attributes:
        begin, end: of the step [s] from the start of the run, (n,); equal for an impact.
        point: [m], world frame, (n, 3).
        weight: size of the impulse [N s], > 0, (n,).
    """

    begin: Array
    end: Array
    point: Array
    weight: Array

    @classmethod
    def of(cls, log: ContactLog, start: float = 0.0) -> Touches:
        """Return those of a log of contacts; start: of the run [s]."""
        weight = np.linalg.norm(log.impulse, axis=1)
        kept = (log.array("kind") == GuardKind.CONTACT) & np.isfinite(log.position).all(axis=1) & (weight > 0.0)
        begin = log.t[kept] - start
        return cls(begin, begin + log.h[kept], log.position[kept], weight[kept])

    @classmethod
    def expected(cls, scene: Scene, q: Array, trees: NDArray[np.int64]) -> Touches:
        """Return where a scene will touch, as far as its start tells: between 0 and 1 s, with weights of at most 1.

        They are the nearest points, on both sides, of what hangs on different trees, the nearest pairs above all: a
        ball over a hand will fall into the hand, not onto itself or to the side. A pair counts 1/e where it is farther
        apart than the nearest one by the size of an ordinary shape.

        Args:
            q: the start, (nq,). trees: as of `trees_of`.
        """
        shapes = scene.collision_model.geometryObjects
        ends = np.array([(pair.first, pair.second) for pair in scene.collision_model.collisionPairs]).reshape(-1, 2)
        tree = trees[[shape.parentJoint for shape in shapes]] if len(shapes) else np.zeros(0, np.int64)
        apart = np.flatnonzero(tree[ends[:, 0]] != tree[ends[:, 1]]) if len(ends) else np.zeros(0, np.int64)
        if not len(apart):
            return cls(np.zeros(0), np.zeros(0), np.zeros((0, 3)), np.zeros(0))
        gap, _, a, b = (values[apart] for values in scene.core().gaps(q))
        sizes = [_radius(shape) for shape in shapes]
        ordinary = float(np.median([size for size in sizes if np.isfinite(size)] or [1.0]))
        gap = np.maximum(gap, 0.0)
        weight = np.exp(-(gap - gap.min()) / ordinary)
        likely = (weight > _UNLIKELY) & np.isfinite(a + b).all(axis=1)
        points = np.concatenate([a[likely], b[likely]])
        return cls(np.zeros(len(points)), np.ones(len(points)), points, 0.5 * np.tile(weight[likely], 2))

    def __len__(self) -> int:
        return len(self.weight)

    def near(self, place: Array, far: float) -> Touches:
        """Return those that are not further than `far` [m] from a place (3,)."""
        return self._rows(np.linalg.norm(self.point - place, axis=1) <= far)

    def at(self, moment: float) -> Touches:
        """Return the strongest ones at a time [s]: of the step around it, and impacts at it."""
        slack = 1e-9 * max(1.0, abs(moment))
        rows = np.flatnonzero((self.begin <= moment + slack) & (self.end >= moment - slack))
        return self._rows(np.sort(rows[np.argsort(-self.weight[rows], kind="stable")[:MOST]]))

    def moments(self, shares: tuple[float, ...]) -> list[float]:
        """Return the middles of the steps up to which so much of the whole impulse has passed, each once [s]."""
        order = np.argsort(self.begin, kind="stable")
        passed = np.cumsum(self.weight[order])
        rows = order[np.searchsorted(passed, np.array(shares) * passed[-1])]
        return [float(t) for t in np.unique(0.5 * (self.begin[rows] + self.end[rows]))]

    def center(self) -> Array:
        """Return the mean of the points, weighted by their impulses [m], (3,)."""
        return np.asarray(self.weight @ self.point / self.weight.sum())

    def _rows(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Touches:
        return Touches(self.begin[rows], self.end[rows], self.point[rows], self.weight[rows])


def _radius(shape: pin.GeometryObject) -> float:
    """Return the size of a shape [m], without end for a halfspace."""
    solid = shape.geometry
    if type(solid).__name__ in ("Halfspace", "Plane"):
        return float("inf")
    solid.computeLocalAABB()
    return float(solid.aabb_radius)
