"""Contact points with their frames, and the Jacobian of the velocities there.

The frame C of a contact point has its z axis along the normal, from the first shape of the pair to the second. Its x
axis is the world's x axis, made orthogonal to the normal, or the world's y axis where the normal is within 45 degrees
of the x axis: on horizontal ground C has the axes of the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import InputError, did_you_mean
from contactvi.inputs import short
from contactvi.scene.build import Built
from contactvi.scene.engine import engine_contact_points

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
        contacts: the points with their frames.
    """

    def __init__(self, matrix: Array, contacts: Sequence[ContactFrame]) -> None:
        self.matrix = matrix
        self.contacts = tuple(contacts)

    @property
    def rows(self) -> list[ContactRow]:
        """The name of each row of `matrix`."""
        return [ContactRow(c.pair, c.point, axis) for c in self.contacts for axis in AXES]

    def of(self, a: str, b: str, point: int | None = None) -> Array:
        """Return the rows of the points of a pair of shapes, named in whichever order, or of one of its points.

        Shape (3 k, nv). The signs stay those of the pair as `contacts` names it.

        Raises:
            InputError: the pair, or the point, is not among the contacts.
        """
        of_pair = [k for k, c in enumerate(self.contacts) if (a, b) in (c.pair, c.pair[::-1])]
        if not of_pair:
            known = list(dict.fromkeys(" ".join(c.pair) for c in self.contacts))
            raise InputError(
                "No contact of these two", name="pair", expected="one of the pairs of .contacts",
                got=f"({short(a)}, {short(b)})", remedy=did_you_mean(f"{a} {b}", known),
            )  # fmt: skip
        chosen = [k for k in of_pair if point is None or self.contacts[k].point == point]
        if not chosen:
            raise InputError(
                "No such point of the pair", name="point", expected="a number of .contacts", got=short(point),
                remedy=f"Give one of {[self.contacts[k].point for k in of_pair]}",
            )  # fmt: skip
        return np.concatenate([self.matrix[3 * k : 3 * k + 3] for k in chosen])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.matrix, dtype=dtype)

    def __repr__(self) -> str:
        return f"<ContactJacobian: {len(self.contacts)} points, shape {self.matrix.shape}>"


class TouchingPoint(NamedTuple):
    """A contact point: its number within the pair, the nearest points of both shapes and the normal, world."""

    pair: tuple[str, str]
    point: int
    point_a: Array
    point_b: Array
    normal: Array
    gap: float


def frame_along(normal: Array) -> Array:
    """Return R_WC (3, 3) of a contact with this unit normal (3,)."""
    x = np.eye(3)[1 if abs(normal[0]) > np.sqrt(0.5) else 0]
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(normal, x), normal])


def touching_points(built: Built, q: Array, gaps: Array, margin: float) -> list[TouchingPoint]:
    """Return the points of all pairs whose gaps, (npairs,), are at most margin [m], at q (nq,)."""
    found = []
    for index in np.flatnonzero(gaps <= margin):
        points = engine_contact_points(built.engine, q, int(index), margin)
        for k, gap in enumerate(points["gap"]):
            a, b, normal = (points[name][k] for name in ("point_a", "point_b", "normal"))
            found.append(TouchingPoint(built.pairs[index], k, a, b, normal, float(gap)))
    return found


def contact_jacobian(built: Built, q: Array, points: Sequence[TouchingPoint]) -> ContactJacobian:
    """Return J_C of these points at q (nq,)."""
    model = built.model
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    matrix, contacts = np.zeros((3 * len(points), model.nv)), []
    for k, touching in enumerate(points):
        rotation = frame_along(touching.normal)
        first, second = (built.carriers[name] for name in touching.pair)
        apart = _point_rows(model, data, second, touching.point_b) - _point_rows(model, data, first, touching.point_a)
        matrix[3 * k : 3 * k + 3] = rotation.T @ apart
        friction = float(built.friction[built.pair_numbers[touching.pair]])
        middle = 0.5 * (touching.point_a + touching.point_b)
        contacts.append(ContactFrame(touching.pair, touching.point, middle, rotation, touching.gap, friction))
    return ContactJacobian(matrix, contacts)


def _point_rows(model: pin.Model, data: pin.Data, joint: int, x_W: Array) -> Array:
    """Return the Jacobian (3, nv) of the velocity of the point of a body that is at x_W (3,), world axes."""
    if joint == 0:
        return np.zeros((3, model.nv))
    placement = data.oMi[joint]
    J = pin.getJointJacobian(model, data, joint, pin.LOCAL)
    local = placement.actInv(x_W)
    return np.asarray(placement.rotation @ (J[:3] - pin.skew(local) @ J[3:]))
