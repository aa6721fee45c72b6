"""The contacts that are closed at a state: their points, normals in joint space, restitution."""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError, PenetrationError, did_you_mean
from contactvi.inputs import array, entries, real, short
from contactvi.records.events import label
from contactvi.scene.engine import engine_impacts
from contactvi.trajectory.compiled import CompiledScene

if TYPE_CHECKING:
    from contactvi.scene.engine import ImpactsAt

Array = NDArray[np.float64]
Pair = tuple[str, str]

_IMMOBILE = 1e-12  # of the inverse inertia without constraints: below it they block the point, as in the engine


@dataclass(frozen=True, eq=False)
class ClosedContact:
    """A contact that takes part.

    Attributes:
        pair: names of the two shapes, or (joint, "lower limit"), (joint, "upper limit").
        restitution: e in [0, 1].
        gap: [m; rad].
        gamma_minus: normal speed before, of the point that closes most; negative where it closes [m/s; rad/s].
        W: d(gap)/dq of its points, shape (points, nv), Pinocchio's coordinates.
        mobile: of each point, whether the constraints let its gap change, shape (points,).
    """

    pair: Pair
    restitution: float
    gap: float
    gamma_minus: float
    W: Array
    mobile: NDArray[np.bool_]

    def __str__(self) -> str:
        return f"{self.pair[0]} | {self.pair[1]}"


def closed_contacts(
    compiled: CompiledScene,
    q: Array,
    v: Array,
    pairs: Sequence[Sequence[str]] | None,
    e: Any,
    margin: float,
    limit: int,
) -> tuple[tuple[ClosedContact, ...], ImpactsAt]:
    """Return the contacts that take part, in the engine's order, and the engine's impacts of them.

    Args:
        compiled: the compiled scene.
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
        pairs: names of the contacts; None: those with gaps within `margin`.
        e: restitution of all, or of each; None: the scene's.
        margin: [m; rad].
        limit: number of impacts after which a sequence is endless.

    Raises:
        InputError: for unknown names, a bad e, where there is no contact, and for one whose gap cannot change.
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
    engine = engine_impacts(compiled.core, q, chosen, values, margin, limit)
    found = []
    for k, number in enumerate(chosen):
        rows = engine.gradients(k)
        if not np.all(np.any(rows != 0.0, axis=1)):
            raise InputError(
                f"{' and '.join(names[number])} cannot move against each other",
                name="pairs",
                expected="a gap that some joint changes",
                got="none",
                remedy="Leave this pair out of pairs=[...]",
            )
        mobile = _mobile(compiled, q, rows, engine.directions(k))
        if not mobile.any():
            raise InputError(
                f"The constraints do not let {' and '.join(names[number])} move against each other",
                name="pairs",
                expected="a gap that changes in a motion which the constraints allow",
                got="none",
                remedy="Name the other contacts with pairs=[...], or remove a constraint",
            )
        speed = float((rows @ v).min())
        found.append(ClosedContact(names[number], float(values[k]), float(gaps[number]), speed, rows, mobile))
    return tuple(found), engine


def _mobile(compiled: CompiledScene, q: Array, rows: Array, directions: Array) -> NDArray[np.bool_]:
    """Return of each point whether an impulse can change its gap's speed: its inverse inertia is not rounding.

    Args:
        rows: d(gap)/dq, shape (points, nv), Pinocchio's coordinates.
        directions: what an impulse of each point adds to the momentum, constraints included, engine coordinates.
    """
    core = compiled.core

    def inverse_inertia(momenta: Array) -> Array:
        return np.array([float(p @ np.asarray(core.velocity(q[None], p[None]))[0]) for p in momenta])

    held = np.array([core.momentum_to_public(q, p) for p in directions])
    return np.asarray(inverse_inertia(held) > _IMMOBILE * inverse_inertia(rows))


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
    given = None if isinstance(pairs, str) else entries(pairs)
    if given is None:
        raise InputError(
            "pairs is not usable", name="pairs", expected='[("shape", "shape"), ...]', got=short(pairs),
            remedy="Give a list of pairs of names",
        )  # fmt: skip
    known = {key: k for k, (a, b) in enumerate(names) for key in ((a, b), (b, a))}
    found = []
    for pair in given:
        key = tuple(map(str, pair)) if isinstance(pair, (list, tuple)) else (str(pair),)
        if key not in known:
            raise InputError(
                f"There is no contact {key!r}",
                name="pairs",
                expected="two names of one tested pair or limit",
                got=short(pair),
                remedy=did_you_mean(" | ".join(key), [f"{a} | {b}" for a, b in names]),
            )
        found.append(known[key])
    return sorted(set(found))


def _restitution(e: Any, own: Array) -> Array:
    if e is None:
        return own
    if isinstance(e, numbers.Real) or (isinstance(e, np.ndarray) and e.ndim == 0):
        return np.full(len(own), real("e", e, 0.0, 1.0))
    values = array("e", e, (len(own),), f"one number, or one for each of {len(own)} contacts")
    return np.array([real("e", value, 0.0, 1.0) for value in values])
