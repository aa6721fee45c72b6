"""Starts in penetration, moved apart by the least: a sequence of quadratic problems.

    minimise  1/2 d^T M d   subject to   gap_i + W_i s >= 0,   J s = -phi

d is the whole change of q, s the change from the present iterate, where gaps, normals and the gradients W are looked at
anew: those of all contact points of pairs that overlap or are near, and of the limits of joints. J, phi: constraints.
With the Cholesky factor of M each problem asks for the point of a polyhedron that is nearest to zero, which is a
non-negative least squares problem (Lawson, Hanson: Solving Least Squares Problems, 1974, chapter 23).

Free bodies and bases of robots are moved first, with all other joints as they are; where that does not end the overlaps
all joints move, and their changes count more than those of bases.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import SeparationError
from contactvi.importing.joint_kinds import joint_kind
from contactvi.importing.kinematics import joint_placements
from contactvi.scene.build import Built
from contactvi.scene.contact_frames import ContactJacobian, touching_points
from contactvi.scene.dynamics import gap_names, gaps, mass_matrix

Array = NDArray[np.float64]

LIMIT = 0.01  # [m] default of how far a body may be moved
PART = 0.25  # of the size of the smaller shape: deeper overlaps may be left on the wrong side
ACCEPTED = 5e-12  # [m, rad] overlap of the result; the engine accepts twice as much
_CLOSED = 1e-10  # [m, rad] residual of constraints
_NEAR = 1e-4  # [m] points that are as near as this, besides twice the deepest overlap, are looked at
_STEPS = 100  # iterations
_PATIENCE = 15  # iterations without progress
_SETTLED = 1e-4  # of the whole change: with smaller steps the result is as near as it is going to be
_TURN = 0.3  # [rad, m] largest change in one iteration
_CUTS = 8  # iterations after which those before are kept in mind
_JOINTS = 100.0  # weight of changes of joints beside those of free bases
_INFEASIBLE = 1e-9  # residual, relative, at which no point satisfies the inequalities
_ELASTIC = 1e3  # weight of what is left of them there


@dataclass(frozen=True)
class BodyMove:
    """How far a body was moved: name, distance of the point of its shapes that moved most [m], angle [rad]."""

    body: str
    distance: float
    angle: float


@dataclass(frozen=True, eq=False)
class Separation:
    """A configuration without overlaps, and what was changed for it.

    Attributes:
        q: the configuration, shape (nq,).
        moves: the bodies that were moved, that which moved most first.
        overlaps: (pair, or joint and limit) -> depth before [m; rad], the deepest first.
        before, after: the deepest overlap before and after [m; rad], 0 where there is none.
        iterations: quadratic problems that were solved.
    """

    q: Array
    moves: tuple[BodyMove, ...]
    overlaps: dict[tuple[str, str], float] = field(default_factory=dict)
    before: float = 0.0
    after: float = 0.0
    iterations: int = 0

    @property
    def largest(self) -> float:
        """How far a point of a body was moved at most [m]."""
        return max((move.distance for move in self.moves), default=0.0)

    def __repr__(self) -> str:
        if not self.overlaps:
            return "<Separation: nothing overlaps, nothing was moved>"
        (a, b), depth = next(iter(self.overlaps.items()))
        more = f" and {len(self.overlaps) - 1} more" if len(self.overlaps) > 1 else ""
        return f"<Separation: {a!r} and {b!r} ({depth:.3g} deep){more}; moved {self.text()}>"

    def text(self, most: int = 3) -> str:
        """Return which bodies were moved how far, in words."""
        listed = [
            f"{move.body!r} by {1e3 * move.distance:.3g} mm"
            + (f" and {move.angle:.2g} rad" if move.angle > 1e-6 else "")
            for move in self.moves[:most]
        ]
        more = f" and {len(self.moves) - most} more" if len(self.moves) > most else ""
        return ", ".join(listed) + more if listed else "nothing"


def separate(built: Built, q: Array, limit: float | None, fixed: Sequence[int], t: float) -> Separation:
    """Return the configuration near q (nq,) without overlaps.

    Args:
        limit: how far a point of a body may be moved [m]; None: LIMIT, and no overlap of more than PART of a shape.
        fixed: degrees of freedom that stay as they are.
        t: time [s], for constraints that depend on it.

    Raises:
        SeparationError: there is none within the limit.
    """
    at = gaps(built, q)
    bad = [int(k) for k in np.argsort(at) if at[k] < -ACCEPTED]
    off = _residual(built, q, t)
    if not bad and off <= _CLOSED:
        return Separation(q.copy(), ())
    names = gap_names(built)
    overlaps = {names[k]: float(-at[k]) for k in bad}
    if limit is None:
        _check_depths(built, overlaps)
    free = np.setdiff1d(np.arange(built.model.nv), fixed)
    bases = np.intersect1d(free, _bases(built.model))
    count, best, far = 0, None, None
    for dofs in (bases, free) if 0 < len(bases) < len(free) else (free,):
        found, steps, left = _search(built, q, dofs, bases, t)
        count += steps
        if left > ACCEPTED:
            best = found if best is None else best
            continue
        moves = _moves(built, q, found)
        result = Separation(found, moves, overlaps, max(overlaps.values(), default=0.0), max(left, 0.0), count)
        if result.largest <= (LIMIT if limit is None else limit):
            return result
        far = result if far is None or result.largest < far.largest else far
    raise _too_far(far, LIMIT if limit is None else limit) if far is not None else _stuck(built, overlaps, best, t)


def _search(built: Built, q0: Array, dofs: NDArray[np.intp], bases: Array, t: float) -> tuple[Array, int, float]:
    """Return the best configuration that the iteration finds, its number of steps, and the overlap that is left."""
    if not len(dofs):
        return q0, 0, np.inf
    model, q, first = built.model, q0, gaps(built, q0)
    still = np.all(np.abs(np.asarray(built.engine.gap_gradients(q0))[first < -ACCEPTED][:, dofs]) < 1e-12, axis=1)
    if still.any():  # These degrees of freedom have no part in it.
        return q0, 0, np.inf
    near, least, at_least = _NEAR + 2.0 * max(0.0, -float(first.min(initial=0.0))), np.inf, 0
    L = _factor(built, q0, dofs, bases)
    cuts: list[tuple[Array, Array, Array]] = []  # configuration, gaps and gradients of earlier iterates
    for count in range(_STEPS):
        at = gaps(built, q)
        change = np.asarray(pin.difference(model, q0, q))[dofs]
        g, W = _rows(built, q, at, near)
        W = W[:, dofs]
        own = (q, g, W)
        for where, values, rows in cuts if count > _CUTS else []:
            moved = np.asarray(pin.difference(model, where, q))[dofs]
            g, W = np.concatenate([g, values + rows @ moved]), np.concatenate([W, rows])
        cuts = [*cuts[-2:], own] if count >= _CUTS else []
        phi, J = _constraints(built, q, t)
        step = _nearest(L, change, g, W, phi, J[:, dofs])
        largest = float(np.abs(step).max(initial=0.0))
        left = _left(built, at, q, t)
        settled = largest <= _SETTLED * float(np.abs(change).max(initial=0.0))
        if left <= ACCEPTED and (settled or count == _STEPS - 1):
            return q, count, left
        worst = max(-float(at.min(initial=0.0)), float(np.abs(phi).max(initial=0.0)))
        least, at_least = (worst, count) if worst < 0.9 * least else (least, at_least)
        if not np.isfinite(largest) or (left > ACCEPTED and count - at_least > _PATIENCE):
            break
        full = np.zeros(model.nv)
        full[dofs] = step * min(1.0, _TURN / largest) if largest > 0.0 else step
        q = _within_limits(built, np.asarray(pin.integrate(model, q, full)))
    return q, count, _left(built, gaps(built, q), q, t)


def _left(built: Built, at: Array, q: Array, t: float) -> float:
    """Return the deepest overlap, infinite where the constraints are not satisfied."""
    return float(-at.min(initial=0.0)) if _residual(built, q, t) <= _CLOSED else np.inf


def _factor(built: Built, q: Array, dofs: NDArray[np.intp], bases: Array) -> Array:
    """Return the Cholesky factor of the metric of changes of these degrees of freedom."""
    M = mass_matrix(built, q)[np.ix_(dofs, dofs)]
    joints = ~np.isin(dofs, bases)
    if joints.any() and not joints.all():
        M[np.ix_(joints, joints)] *= 1.0 + _JOINTS
    M += 1e-12 * float(np.trace(M)) / len(M) * np.eye(len(M))  # motions without inertia
    return np.asarray(np.linalg.cholesky(M))


def _rows(built: Built, q: Array, at: Array, near: float) -> tuple[Array, Array]:
    """Return gaps and gradients of what is near: of each pair its least gap and its points; limits of joints."""
    gradients, pairs = np.asarray(built.engine.gap_gradients(q)), len(built.pairs)
    points = touching_points(built, q, at[:pairs], near)
    rows = np.flatnonzero(at <= near)
    g, W = at[rows], gradients[rows]
    if points:
        g = np.concatenate([g, [point.gap for point in points]])
        W = np.concatenate([W, ContactJacobian(built, q, points).matrix[2::3]])
    return g, W


def _constraints(built: Built, q: Array, t: float) -> tuple[Array, Array]:
    if not built.elements.constraints:
        return np.zeros(0), np.zeros((0, built.model.nv))
    phi = np.asarray(built.engine.constraint_residual(q, t))
    return phi, np.asarray(built.engine.constraint_jacobian(q, t)).reshape(-1, built.model.nv)


def _residual(built: Built, q: Array, t: float) -> float:
    return float(np.abs(_constraints(built, q, t)[0]).max(initial=0.0))


def _nearest(L: Array, change: Array, g: Array, W: Array, phi: Array, J: Array) -> Array:
    """Return s with g + W s >= 0 and J s = -phi (to least squares) for which |L^T (change + s)| is least.

    Where the inequalities contradict each other they are met as well as they can be.
    """
    A, b = np.linalg.solve(L, W.T).T, -g + W @ change  # of x = L^T (change + s): A x >= b
    x, Z = np.zeros(len(L)), np.eye(len(L))
    if len(phi):
        E = np.linalg.solve(L, J.T).T
        U, sizes, V = np.linalg.svd(E)
        rank = int(np.sum(sizes > 1e-9 * sizes.max(initial=0.0)))
        x = V[:rank].T @ ((U[:, :rank].T @ (-phi + J @ change)) / sizes[:rank])
        Z = V[rank:].T
    x = x + Z @ _least_distance(A @ Z, b - A @ x)
    return np.asarray(np.linalg.solve(L.T, x) - change)


def _least_distance(A: Array, b: Array) -> Array:
    """Return the shortest x with A x >= b; where there is none, that which comes near to it."""
    sizes = np.linalg.norm(A, axis=1)
    able = sizes > 1e-12 * sizes.max(initial=0.0)
    A, b = A[able] / sizes[able, None], b[able] / sizes[able]
    scale = float(b.max(initial=0.0))
    if scale <= 0.0:
        return np.zeros(A.shape[1])
    x = _by_nnls(A, b / scale)
    if x is None:  # A common slack, which costs much: it can always be met.
        x = _by_nnls(np.hstack([A, np.full((len(A), 1), 1.0 / _ELASTIC)]), b / scale)
        x = np.zeros(A.shape[1]) if x is None else x[:-1]
    return scale * x


def _by_nnls(A: Array, b: Array) -> Array | None:
    """Return the shortest x with A x >= b; None where there is none."""
    from scipy.optimize import lsq_linear, nnls

    E, f = np.vstack([A.T, b]), np.zeros(A.shape[1] + 1)
    f[-1] = 1.0
    try:
        u = nnls(E, f, maxiter=30 * E.shape[1])[0]
    except RuntimeError:  # too many iterations
        u = lsq_linear(E, f, (0.0, np.inf), method="bvls").x
    r = E @ u - f
    if np.linalg.norm(r) <= _INFEASIBLE or r[-1] >= 0.0:
        return None
    active = u > 0.0
    x = np.asarray(-r[:-1] / r[-1])
    # The active rows hold as equations: their solution has the digits that the quotient loses.
    exact = np.linalg.lstsq(A[active], b[active], rcond=1e-10)[0]
    return np.asarray(exact if np.all(A @ exact >= b - 1e-9) else x)


def _bases(model: pin.Model) -> NDArray[np.intp]:
    """Return the degrees of freedom of the joints that place a tree: they hang at the world and move freely."""
    free = ("free", "planar", "translation")
    roots = [i for i in range(1, model.njoints) if model.parents[i] == 0 and joint_kind(model.joints[i]) in free]
    return np.array([dof for i in roots for dof in range(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])], dtype=int)


def _within_limits(built: Built, q: Array) -> Array:
    """Return q with joints that are beyond a limit by rounding on it."""
    limits = built.limits
    beyond = limits.gaps(q)
    for k in np.flatnonzero((beyond < 0.0) & (beyond > -1e-6)):
        q[limits.at[k]] = limits.bound[k]
    return q


def _moves(built: Built, q0: Array, q1: Array) -> tuple[BodyMove, ...]:
    """Return the bodies that moved, one for each joint, that which moved most first."""
    model = built.model
    before, after = joint_placements(model, q0), joint_placements(model, q1)
    corners: dict[int, list[Array]] = {i: [np.zeros((1, 3))] for i in range(1, model.njoints)}
    for geometry in built.collision.geometryObjects:
        if geometry.parentJoint and not isinstance(geometry.geometry, coal.Halfspace):
            points = _corners(geometry.geometry)
            place = geometry.placement
            corners[int(geometry.parentJoint)].append(points @ place.rotation.T + place.translation)
    names: dict[int, str] = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            names.setdefault(int(frame.parentJoint), str(frame.name))
    found = []
    for i, parts in corners.items():
        points = np.concatenate(parts[1:] or parts)
        A, B = before[i], after[i]
        moved = points @ (B.rotation - A.rotation).T + (B.translation - A.translation)
        distance = float(np.linalg.norm(moved, axis=1).max())
        angle = float(np.linalg.norm(pin.log3(A.rotation.T @ B.rotation)))
        if distance > 1e-12 or angle > 1e-12:
            found.append(BodyMove(names.get(i, str(model.names[i])), distance, angle))
    return tuple(sorted(found, key=lambda move: -move.distance))


def _box(shape: coal.CollisionGeometry) -> tuple[Array, Array]:
    """Return the corners of the box of a shape along its own axes."""
    if not isinstance(shape, coal.Convex):  # Hulls have their boxes.
        shape = shape.clone()
        shape.computeLocalAABB()
    return np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)


def _corners(shape: coal.CollisionGeometry) -> Array:
    ends = _box(shape)
    return np.array([[ends[i][0], ends[j][1], ends[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def _sizes(built: Built, pair: tuple[str, str]) -> Iterator[float]:
    """Yield the longest edges of the boxes of two shapes [m]; none with a halfspace, whose way out is known."""
    shapes = {g.name: g.geometry for g in built.collision.geometryObjects}
    if not any(isinstance(shapes[name], coal.Halfspace) for name in pair):
        for name in pair:
            low, high = _box(shapes[name])
            yield float((high - low).max())


def _check_depths(built: Built, overlaps: dict[tuple[str, str], float]) -> None:
    tested = built.pair_numbers
    for pair, depth in overlaps.items():
        most = PART * min(_sizes(built, pair), default=np.inf) if pair in tested else np.inf
        if depth > most:
            raise SeparationError(
                f"{pair[0]!r} and {pair[1]!r} overlap so deep that their way out is not known", pair=pair, depth=depth,
                expected=f"at most {most:.3g} m, a quarter of the smaller shape", got=f"{depth:.3g} m",
                remedy=f"Move the start apart, or give limit={_round_up(2.0 * depth):.1g}; {_OTHERS}",
            )  # fmt: skip


_OTHERS = "scene.disable_pair(a, b) and scene.disable_overlapping(q) take out pairs that overlap by construction"


def _round_up(value: float) -> float:
    """Return a number of one digit that is not below."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(np.ceil(value / power) * power)


def _too_far(found: Separation, limit: float) -> SeparationError:
    pair, depth = next(iter(found.overlaps.items()), ((), 0.0))
    move = found.moves[0]
    return SeparationError(
        f"To end the overlaps, {move.body!r} would have to be moved by {move.distance:.3g} m",
        pair=pair or None, depth=depth, moves=found.moves,
        expected=f"at most {limit:.3g} m", got=f"{found.text()}; {_deepest(found.overlaps)}",
        remedy=f"If that is meant give limit={_round_up(found.largest):.1g}, else move the start; {_OTHERS}",
    )  # fmt: skip


def _stuck(built: Built, overlaps: dict[tuple[str, str], float], best: Array | None, t: float) -> SeparationError:
    q = best
    assert q is not None
    at = gaps(built, q)
    k = int(np.argmin(at)) if len(at) else -1
    off = _residual(built, q, t)
    pair, depth = next(iter(overlaps.items()), ((), 0.0))
    left = (
        f"{-at[k]:.3g} m or rad left at {' and '.join(map(repr, gap_names(built)[k]))}" if k >= 0 and at[k] < 0 else ""
    )
    open_ = f"constraints off by {off:.3g} m or rad" if off > _CLOSED else ""
    return SeparationError(
        "The overlaps cannot be ended near this configuration",
        pair=pair or None, depth=depth,
        expected="shapes that can move apart within the limits of the joints, on the constraints",
        got=f"{_deepest(overlaps)}; {', '.join(text for text in (left, open_) if text) or 'no way out'} at best",
        remedy=f"Start from another q, or fix fewer joints; {_OTHERS}",
    )  # fmt: skip


def _deepest(overlaps: dict[tuple[str, str], float]) -> str:
    if not overlaps:
        return "no overlap, but constraints that are not satisfied"
    (a, b), depth = next(iter(overlaps.items()))
    return f"{a!r} and {b!r} {depth:.3g} deep"
