"""Accelerations under constraints and their derivatives, from those of a tree without (core/model/tree_motion.hpp).

With the gradients J of the constraints, the forces lambda along them and the rates of motions r(t),

    M a + b(q, v) = f + J^T lambda,    J a + gamma(q, v) = r(t),

the derivatives along (dq, dv, df), with a and lambda held on the right, solve

    M da - J^T dlambda = df + [d(J^T lambda)/dq - d rnea(q, v, a)/dq] dq - d rnea(q, v, a)/dv dv,
    J da               = -d(J a + gamma)/dq dq - d gamma/dv dv.

d(J^T lambda)/dq is known from that of velocities: w . d(J^T lambda)/dq = lambda . d(J w)/dq for every w. Where
constraints depend on each other lambda is that of least norm.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.elements.pose_signals import PoseSignal
from contactvi.errors import NotDifferentiable
from contactvi.scene.build import Built
from contactvi.scene.dynamics import bias_forces
from contactvi.scene.element_rows import ConstraintRow

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]

# Of the matrix J M^-1 J^T, scaled to ones on its diagonal: eigenvalues below are those of constraints that depend on
# others, as in a step.
REDUNDANT = 1e-9
ARM = 0.1  # [m] from the origin of a frame to the further points that hold its orientation


class PointMotion(NamedTuple):
    """Place, velocity and acceleration of a point (3,), world, and derivatives (3, nv) in q, v and a."""

    place: Array
    velocity: Array
    acceleration: Array
    J: Array
    velocity_q: Array
    acceleration_q: Array
    acceleration_v: Array


class Point(NamedTuple):
    """A point of a body: joint (0: world) and place in its frame [m]."""

    joint: int
    place: Array


class Joined(NamedTuple):
    """Points of a and b that stay together along directions (k, 3) that are fixed in a, in its joint's frame."""

    a: Point
    b: Point
    directions: Array


class Rows(NamedTuple):
    """Rows of a constraint: J (rows, nv), acceleration J a + gamma - r (rows,) and its derivatives (rows, nv)."""

    J: Array
    acceleration: Array
    by_q: Array
    by_v: Array


class Accelerations(NamedTuple):
    """The acceleration (nv,) and its derivatives by q, v and the generalized force, (nv, nv) each."""

    a: Array
    by_q: Array
    by_v: Array
    by_force: Array


def constrained_accelerations(
    built: Built, inverse: Array, q: Array, v: Array, t: float, force: Array, force_q: Array, force_v: Array,
) -> Accelerations:  # fmt: skip
    """Return the acceleration and its derivatives.

    Args:
        inverse: M^-1 at q, shape (nv, nv).
        force, force_q, force_v: all forces but gravity's (nv,), and their derivatives (nv, nv).
    """
    constraints, nv = built.elements.constraints, int(built.model.nv)
    for row in constraints:
        _check_known(row)
    still = _all_rows(built, q, v, np.zeros(nv), t)
    free = inverse @ (force - bias_forces(built, q, v))
    solve = _Solver(inverse, still.J)
    a, forces = solve(free, -still.acceleration)
    rows = _all_rows(built, q, v, a, t)
    needed_q, needed_v = map(np.asarray, built.engine.model.motion(q, v, a).force_derivatives())
    turned = _turned_forces(built, q, t, forces)
    by_q = solve(inverse @ (force_q + turned - needed_q), -rows.by_q)[0]
    by_v = solve(inverse @ (force_v - needed_v), -rows.by_v)[0]
    return Accelerations(a, by_q, by_v, solve(inverse, np.zeros((len(forces), nv)))[0])


class _Solver:
    """Solves M x - J^T y = M free, J x = wanted."""

    def __init__(self, inverse: Array, J: Array) -> None:
        self._J, self._across = J, inverse @ J.T
        G = J @ self._across
        sizes = np.sqrt(np.maximum(np.diag(G), 0.0))
        scale = np.where(sizes > 0.0, 1.0 / np.where(sizes > 0.0, sizes, 1.0), 0.0)
        values, vectors = np.linalg.eigh(scale[:, None] * G * scale)
        kept = values > REDUNDANT * max(1.0, float(values.max(initial=0.0)))
        basis = scale[:, None] * vectors[:, kept]
        self._solve = basis / values[kept] @ basis.T

    def __call__(self, free: Array, wanted: Array) -> tuple[Array, Array]:
        y = self._solve @ (wanted - self._J @ free)
        return free + self._across @ y, y


def _check_known(row: ConstraintRow) -> None:
    if row.engine_kind != "screw" or float(row.numbers[0]) == 0.0:
        return
    raise NotDifferentiable(
        "Accelerations under a screw have no derivatives that are known", reason="constraint",
        expected="points, distances, welds, hinges, equalities and driven joints", got=row.name,
        remedy="Linearise a step: contactvi.linearize(...)",
    )  # fmt: skip


def _joined(row: ConstraintRow) -> list[Joined]:
    """Return the points of a and b that a constraint holds together, or at a distance.

    Of a weld three points, of a hinge two on its axis, each along what the ones before have left free.
    """
    x, y, z = np.eye(3)
    held: list[tuple[Array, Array]] = [(np.zeros(3), np.eye(3))]
    if row.engine_kind in ("weld", "pose"):
        held += [(ARM * x, np.array([y, z])), (ARM * y, np.array([z]))]
    elif row.engine_kind == "screw":
        held += [(ARM * z, np.array([x, y]))]
    (joint_a, R_a, p_a), (joint_b, R_b, p_b) = row.a, row.b
    return [
        Joined(Point(joint_a, p_a + R_a @ arm), Point(joint_b, p_b + R_b @ arm), along @ R_a.T) for arm, along in held
    ]


def _placed(row: ConstraintRow, t: float) -> ConstraintRow:
    """Return the constraint with the frame of a that a prescribed pose gives it."""
    return row if row.pose is None else replace(row, a=(0, row.pose(t).rotation, row.pose(t).position))


def _frame_acceleration(motion: PoseSignal, point: Point, t: float) -> Array:
    """Return that of a point of the world that moves with a prescribed pose, (3,)."""
    frame, acceleration = motion(t), motion.acceleration(t)
    arm = point.place - frame.position
    turning = np.cross(acceleration[3:], arm) + np.cross(frame.angular_velocity, np.cross(frame.angular_velocity, arm))
    return np.asarray(acceleration[:3] + turning)


def _apart(tree: _core.TreeMotion, joined: Joined) -> PointMotion:
    """Return the motion of b's point less that of a's."""
    ends = tree.point(*joined.a), tree.point(*joined.b)
    return PointMotion(*(np.subtract(b, a) for a, b in zip(*ends, strict=True)))


def _directions(tree: _core.TreeMotion, joined: Joined) -> Array:
    """Return the directions in the world, (k, 3)."""
    return np.array(joined.directions @ np.asarray(tree.rotation(joined.a.joint)).T)


def _all_rows(built: Built, q: Array, v: Array, a: Array, t: float) -> Rows:
    tree = built.engine.model.motion(q, v, a)
    found = [_rows(built.model, tree, row, q, v, a, t) for row in built.elements.constraints]
    return Rows(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _rows(model: pin.Model, tree: _core.TreeMotion, row: ConstraintRow, q: Array, v: Array, a: Array, t: float) -> Rows:
    if row.engine_kind in ("equality", "prescribed"):
        return _joint_rows(model, row, q, v, a, t)
    if row.engine_kind != "distance":
        found = []
        for joined in _joined(_placed(row, t)):
            # Nothing moves apart, so that it does not count that the directions turn.
            d, along = _apart(tree, joined), _directions(tree, joined)
            apart = d.acceleration if row.pose is None else d.acceleration - _frame_acceleration(row.pose, joined.a, t)
            found.append([along @ part for part in (d.J, apart, d.acceleration_q, d.acceleration_v)])
        return Rows(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
    # d . d'' + d' . d' = L'^2 + L L'', half of the second derivative of d . d.
    d = _apart(tree, _joined(row)[0])
    rate = acceleration = 0.0
    length = float(np.linalg.norm(d.place))
    if row.signal is not None:
        length, rate, acceleration = row.signal(t)
    value = d.place @ d.acceleration + d.velocity @ d.velocity - rate**2 - length * acceleration
    by_q = d.acceleration @ d.J + d.place @ d.acceleration_q + 2.0 * d.velocity @ d.velocity_q
    by_v = d.place @ d.acceleration_v + 2.0 * d.velocity @ d.J
    return Rows((d.place @ d.J)[None], np.array([value]), by_q[None], by_v[None])


def _joint_rows(model: pin.Model, row: ConstraintRow, q: Array, v: Array, a: Array, t: float) -> Rows:
    """Return the row of q_joint = c(q_other), or of q_joint = r(t)."""
    J, by_q, by_v = np.zeros((3, 1, model.nv))
    joint = int(model.idx_vs[row.b[0]])
    J[0, joint] = 1.0
    if row.signal is not None:
        return Rows(J, np.array([a[joint] - row.signal(t)[2]]), by_q, by_v)
    other, at = int(model.idx_vs[row.a[0]]), float(q[model.idx_qs[row.a[0]]])
    slope, bend, third = (float(np.polynomial.Polynomial(row.numbers).deriv(k)(at)) for k in (1, 2, 3))
    J[0, other] = -slope
    by_q[0, other] = -bend * a[other] - third * v[other] ** 2
    by_v[0, other] = -2.0 * bend * v[other]
    return Rows(J, np.array([a[joint] - slope * a[other] - bend * v[other] ** 2]), by_q, by_v)


def _turned_forces(built: Built, q: Array, t: float, forces: Array) -> Array:
    """Return d(J^T lambda)/dq at a constant lambda, shape (nv, nv)."""
    model = built.model
    T, still = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
    tree = built.engine.model.motion(q, still, still)
    first = 0
    for row in built.elements.constraints:
        if row.engine_kind in ("equality", "prescribed"):
            if row.signal is None:
                other, at = int(model.idx_vs[row.a[0]]), float(q[model.idx_qs[row.a[0]]])
                T[other, other] -= forces[first] * float(np.polynomial.Polynomial(row.numbers).deriv(2)(at))
            first += 1
            continue
        for joined in _joined(_placed(row, t)):
            if row.engine_kind == "distance":
                d = _apart(tree, joined)
                T += forces[first] * d.J.T @ d.J
                force, used = forces[first] * d.place, 1
            else:
                along = _directions(tree, joined)
                used = len(along)
                force = forces[first : first + used] @ along
            # With a fixed direction in the world.
            T += np.subtract(tree.turned_force(*joined.b, force), tree.turned_force(*joined.a, force))
            first += used
    return T
