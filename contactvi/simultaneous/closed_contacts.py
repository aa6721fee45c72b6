"""The contacts that are closed at a state: their points, normals in joint space, restitution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import InputError, PenetrationError, did_you_mean
from contactvi.inputs import real
from contactvi.records.events import label
from contactvi.scene.engine import engine_points
from contactvi.trajectory.compiled import CompiledScene

Array = NDArray[np.float64]
Pair = tuple[str, str]


@dataclass(frozen=True, eq=False)
class ClosedContact:
    """A contact that takes part.

    Attributes:
        pair: names of the two shapes, or (joint, "lower limit"), (joint, "upper limit").
        restitution: e in [0, 1].
        gap: [m; rad].
        gamma_minus: normal speed before, of the point that closes most; negative where it closes [m/s; rad/s].
        W: d(gap)/dq of its points, shape (points, nv), Pinocchio's coordinates.
    """

    pair: Pair
    restitution: float
    gap: float
    gamma_minus: float
    W: Array

    def __str__(self) -> str:
        return f"{self.pair[0]} | {self.pair[1]}"


def closed_contacts(
    compiled: CompiledScene, q: Array, v: Array, pairs: Sequence[Sequence[str]] | None, e: Any, margin: float
) -> tuple[ClosedContact, ...]:
    """Return the contacts with gaps within `margin` [m; rad], or those named by `pairs`, in the engine's order.

    q (nq,), v (nv,) : the state. e : restitution of all, or of each; the scene's where None.

    Raises:
        InputError: for unknown names, a bad e, and where there is no contact.
        PenetrationError: for one that is deeper.
    """
    gaps, names, restitution = _guards(compiled, q)
    if pairs is None:
        _check_depth(gaps, names, margin)
        chosen = [int(k) for k in np.flatnonzero(gaps <= margin)]
    else:
        chosen = _named(pairs, names)
    if not chosen:
        least = int(gaps.argmin()) if len(gaps) else -1
        raise InputError(
            "No contact is closed here",
            name="q",
            expected=f"a gap <= {margin:g}",
            got=f"{gaps[least]:.6g} between {' and '.join(names[least])}" if least >= 0 else "a scene without contacts",
            remedy="Name the contacts with pairs=[...]",
        )
    values = _restitution(e, restitution[chosen])
    gradients = np.asarray(compiled.core.gap_gradients(q))
    found = []
    for k, number in enumerate(chosen):
        rows = gradients[number][None]
        if number < len(compiled.pair_names):
            rows = _rows(compiled, q, number, max(margin, float(gaps[number])), rows)
        if not np.all(np.any(rows != 0.0, axis=1)):
            raise InputError(
                f"{' and '.join(names[number])} cannot move against each other",
                name="pairs",
                expected="a gap that some joint changes",
                got="none",
            )
        speed = float((rows @ v).min())
        found.append(ClosedContact(names[number], float(values[k]), float(gaps[number]), speed, rows))
    return tuple(found)


def _rows(compiled: CompiledScene, q: Array, pair: int, margin: float, witness: Array) -> Array:
    """Return n . (J_b(x) - J_a(x)) of the points of a pair, shape (points, nv); the witness's where there is one."""
    point_a, point_b, normal = engine_points(compiled.core, q, pair, margin)
    if len(normal) < 2:
        return witness
    model, collision = compiled.built.model, compiled.built.collision
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    shapes = collision.collisionPairs[pair]
    rows = np.zeros((len(normal), model.nv))
    for sign, shape, points in ((-1.0, shapes.first, point_a), (1.0, shapes.second, point_b)):
        joint = int(collision.geometryObjects[shape].parentJoint)
        if joint == 0:
            continue
        jacobian = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        arm = points - data.oMi[joint].translation
        rows += sign * (normal @ jacobian[:3] + np.cross(arm, normal) @ jacobian[3:])
    return rows


def _guards(compiled: CompiledScene, q: Array) -> tuple[Array, list[Pair], Array]:
    """Return gaps, names and restitution of all guards in the engine's order: pairs, then joint limits."""
    built = compiled.built
    gaps = [np.asarray(compiled.core.gaps(q)[0])]
    names, restitution = list(compiled.pair_names), list(built.restitution)
    for index in np.flatnonzero(built.arrays.limits):
        at = built.model.joints[int(index)].idx_q
        for side, bound in enumerate((built.model.lowerPositionLimit[at], built.model.upperPositionLimit[at])):
            if np.isfinite(bound):
                gaps.append(np.array([bound - q[at] if side else q[at] - bound]))
                names.append(label(1, 2 * int(index) + side, compiled.pair_names, compiled.joint_names))
                restitution.append(built.arrays.limit_restitution[int(index)])
    return np.concatenate(gaps), names, np.array(restitution, dtype=float)


def _check_depth(gaps: Array, names: Sequence[Pair], margin: float) -> None:
    if not np.any(gaps < -margin):
        return
    worst = int(gaps.argmin())
    raise PenetrationError(
        f"{' and '.join(names[worst])} overlap",
        pair=names[worst],
        depth=float(-gaps[worst]),
        expected=f"gaps >= {-margin:g}",
        got=f"{gaps[worst]:.6g}",
        remedy="Move the bodies apart, or raise tolerance=...",
    )


def _named(pairs: Any, names: Sequence[Pair]) -> list[int]:
    """Return the numbers of the named guards, in the engine's order."""
    known = {key: k for k, (a, b) in enumerate(names) for key in ((a, b), (b, a))}
    found = []
    for pair in pairs:
        key = tuple(pair) if not isinstance(pair, str) else (pair,)
        if key not in known:
            raise InputError(
                f"There is no contact {key!r}",
                name="pairs",
                expected="two names of one tested pair or limit",
                got=repr(pair),
                remedy=did_you_mean(" | ".join(map(str, key)), [f"{a} | {b}" for a, b in names]),
            )
        found.append(known[key])
    return sorted(set(found))


def _restitution(e: Any, own: Array) -> Array:
    if e is None:
        return own
    if np.ndim(e) == 0:
        return np.full(len(own), real("e", e, 0.0, 1.0))
    values = [real("e", value, 0.0, 1.0) for value in e]
    if len(values) != len(own):
        raise InputError("e", name="e", expected=f"one number, or one for each of {len(own)} contacts", got=len(values))
    return np.array(values)
