"""Contact points with their frames, and the Jacobian of the velocities there with its change along the motion.

The frame C of a contact point has its z axis along the normal, from the first shape of the pair to the second. Its x
axis is the world's x axis, made orthogonal to the normal, or the world's y axis where the normal is within 45 degrees
of the x axis: on horizontal ground C has the axes of the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import InputError, did_you_mean
from contactvi.inputs import entries, short
from contactvi.scene.build import Built
from contactvi.scene.engine import engine_contact_points
from contactvi.scene.point_pairs import PointPairs, skew
from contactvi.scene.selection import PartHandle, Selector

Array = NDArray[np.float64]

AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class ContactFrame:
    """A contact point of a pair at a configuration.

    Attributes:
        pair: names of the two shapes, (first, second).
        point: number of the point within the pair: 0, 1, 2, ... at a state of a scene; of a simulator, that of
            `Contact.point`.
        position: middle of the two points [m], world frame, shape (3,).
        rotation: R_WC, which takes coordinates in C to world axes, shape (3, 3); its last column is the normal.
        gap: [m].
        friction: Coulomb's coefficient of the pair.
    """

    pair: tuple[str, str]
    point: int
    position: Array
    rotation: Array
    gap: float
    friction: float

    @property
    def normal(self) -> Array:
        """Unit normal from the first shape to the second, world axes, shape (3,)."""
        return np.array(self.rotation[:, 2])


class ContactRow(NamedTuple):
    """What a row of a `ContactJacobian` belongs to: pair and number of the contact point, axis "x", "y" or "z" of C."""

    pair: tuple[str, str]
    point: int
    axis: str


class ContactJacobian:
    """J_C of n contact points: J_C v is the velocity of the second body relative to the first, in the frames C.

    It is that of the two points of the bodies that are nearest to each other, so that each third row, along the normal,
    is the gradient of the gap of its point. Forces f_C (3 n,) [N] on the second bodies, in the frames C, and the
    opposite ones on the first are the generalized force J_C^T f_C; of a `Contact`, f_C = R_WC^T force.

    Attributes:
        matrix: shape (3 n, nv), for each point the rows along x, y and z of its frame; columns are Pinocchio's v.
    """

    def __init__(self, built: Built, q: Array, points: Sequence[TouchingPoint]) -> None:
        self._points, self._names = list(points), built.names
        self._shapes = list(built.carriers)  # in the order of the geometries
        numbers = [built.pair_numbers[p.pair] for p in points]
        self._friction = [float(built.friction[number]) for number in numbers]
        places = np.array([[p.point_a for p in points], [p.point_b for p in points]]).reshape(2, -1, 3)
        joints = np.array([[built.carriers[p.pair[side]] for p in points] for side in (0, 1)], dtype=np.int64)
        self._states = built.states
        self._fixed = PointPairs(built.engine.model, q, joints, places, frames_along(_normals(points)))
        self.matrix = self._fixed.jacobian()

    @cached_property
    def contacts(self) -> tuple[ContactFrame, ...]:
        """The points with their frames."""
        return tuple(
            ContactFrame(p.pair, p.point, 0.5 * (p.point_a + p.point_b), R_WC, p.gap, friction)
            for p, R_WC, friction in zip(self._points, self._fixed.axes, self._friction, strict=True)
        )

    @property
    def rows(self) -> list[ContactRow]:
        """The name of each row of `matrix`."""
        return [ContactRow(p.pair, p.point, axis) for p in self._points for axis in AXES]

    def bias_acceleration(self, v: ArrayLike) -> Array:
        """Return (dJ_C/dt) v, shape (3 n,) [m/s^2], rows as of `matrix`, with the velocity v (nv,).

        J_C a + (dJ_C/dt) v is the acceleration of the second body's point relative to the first body's, both fixed on
        their bodies, in frames C that stand still; a = dv/dt of Pinocchio's v, as in the equations of motion. This
        acceleration is zero where a vertex or a flat face sticks. Where a round shape rolls, the place of the contact
        moves over it, and its material point does accelerate, away from the contact: a sphere of radius r on a plane
        by w^2 r.
        """
        return self._fixed.bias_acceleration(self._states.velocity(v, "v"))

    def on(self, body: Selector | Sequence[Selector]) -> ContactJacobian:
        """Return the Jacobian of the points of a body, seen from it: in each pair it is the second.

        Normals point into the body, J v is its velocity relative to what it touches, and forces f_C act on it, those
        along z never negative. Points between shapes that both belong to it are left out; without contacts there are
        no rows.

        Args:
            body: a handle of the scene, the name of a body, a shape or a joint, a pattern, or several of them.

        Raises:
            InputError: unknown name, or a body without a shape.
        """
        several = None if isinstance(body, (str, PartHandle)) else entries(body)
        bodies: tuple[Any, ...] = (body,) if several is None else several
        selected = [k for one in bodies for k in self._names.select_geometries(one, "body")]
        own = {self._shapes[k] for k in selected}
        chosen = [k for k, p in enumerate(self._points) if (p.pair[0] in own) != (p.pair[1] in own)]
        turned = np.array([self._points[k].pair[0] in own for k in chosen], dtype=bool)
        seen = copy(self)
        seen._points = [self._points[k].seen_from_first() if turn else self._points[k]
                        for k, turn in zip(chosen, turned.tolist(), strict=True)]  # fmt: skip
        seen._friction = [self._friction[k] for k in chosen]
        seen._fixed = self._fixed.chosen(chosen, turned, frames_along(_normals(seen._points)))
        seen.matrix = seen._fixed.jacobian()
        seen.__dict__.pop("contacts", None)
        return seen

    def of(self, a: str, b: str, point: int | None = None) -> Array:
        """Return the rows of the points of a pair of shapes, named in whichever order, or of one of its points.

        Shape (3 k, nv). The order of the names changes no sign: it stays that of the pair as `contacts` names it. With
        the signs of one body: `on`.

        Raises:
            InputError: the pair, or the point, is not among the contacts.
        """
        of_pair = [k for k, p in enumerate(self._points) if (a, b) in (p.pair, p.pair[::-1])]
        if not of_pair:
            known = list(dict.fromkeys(" ".join(p.pair) for p in self._points))
            nothing = (
                "Nothing touches at this state: ask len(J.contacts) first, or give a larger margin to contact_jacobian"
            )
            raise InputError(
                "No contact of these two", name="pair", expected="one of the pairs of .contacts",
                got=f"({short(a)}, {short(b)})", remedy=did_you_mean(f"{a} {b}", known) if known else nothing,
            )  # fmt: skip
        chosen = [k for k in of_pair if point is None or self._points[k].point == point]
        if not chosen:
            raise InputError(
                "No such point of the pair", name="point", expected="a number of .contacts", got=short(point),
                remedy=f"Give one of {[self._points[k].point for k in of_pair]}",
            )  # fmt: skip
        return np.concatenate([self.matrix[3 * k : 3 * k + 3] for k in chosen])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.matrix, dtype=dtype)

    def __repr__(self) -> str:
        return f"<ContactJacobian: {len(self._points)} points, shape {self.matrix.shape}>"


class TouchingPoint(NamedTuple):
    """A contact point: its number within the pair, the nearest points of both shapes and the normal, world."""

    pair: tuple[str, str]
    point: int
    point_a: Array
    point_b: Array
    normal: Array
    gap: float

    def seen_from_first(self) -> TouchingPoint:
        """Return the point with the two shapes in the other order."""
        return TouchingPoint(self.pair[::-1], self.point, self.point_b, self.point_a, -self.normal, self.gap)


def _normals(points: Sequence[TouchingPoint]) -> Array:
    return np.array([point.normal for point in points]).reshape(-1, 3)


def frames_along(normals: Array) -> Array:
    """Return R_WC (n, 3, 3) of contacts with these unit normals (n, 3)."""
    x = np.eye(3)[(np.abs(normals[:, 0]) > np.sqrt(0.5)).astype(int)]
    x = x - np.einsum("ni,ni->n", x, normals)[:, None] * normals
    x /= np.sqrt(np.einsum("ni,ni->n", x, x))[:, None]
    return np.stack([x, (skew(normals) @ x[:, :, None])[:, :, 0], normals], axis=2)


def touching_points(built: Built, q: Array, gaps: Array, margin: float) -> list[TouchingPoint]:
    """Return the points of all pairs whose gaps, (npairs,), are at most margin [m], at q (nq,)."""
    found = []
    for index in np.flatnonzero(gaps <= margin):
        points = engine_contact_points(built.engine, q, int(index), margin)
        for k, gap in enumerate(points["gap"]):
            a, b, normal = (points[name][k] for name in ("point_a", "point_b", "normal"))
            found.append(TouchingPoint(built.pairs[index], k, a, b, normal, float(gap)))
    return found
