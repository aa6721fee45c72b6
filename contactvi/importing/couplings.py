"""Joints that follow others, q = offset + ratio q_leader: coordinates of the engine, not constraints with reactions.

Linear joint equalities, chains of them composed, leave one free joint in each set of joints that they connect. What
closes a circle of them is redundant or contradictory, and stays a constraint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from contactvi.elements.constraints import EqualityConstraint
from contactvi.elements.element import Element
from contactvi.importing.engine_model import engine_model

# Of the mass matrix, scaled to ones on its diagonal: below this pivot a link counts as one without a mass of its own.
_NO_MASS = 1e-6
# What is lent to such links, in parts of the inertia of the coupled motion; the first sign that gives good pivots.
_LENT = (1.0, -1.0, 0.3, -0.3, 0.1, -0.1, 3.0, -3.0)
_LEAST = 1e-14  # pivot that is rounding
_GAIN = 1.0  # of the sum of the logarithms of the pivots: less is not worth another choice
_POSES = 4  # at which the mass matrix is looked at, neutral among them


@dataclass(frozen=True)
class Coupled:
    """A joint of the model (index) that follows another one."""

    joint: int
    leader: int
    ratio: float
    offset: float


@dataclass(frozen=True)
class Couplings:
    """The coupled joints of a scene.

    Attributes:
        followers: the joints that follow, each once; their leaders follow no others.
        names: of the equalities that they stand for.
        lent: armature, (nv,) or empty, that the coupled motion does not know: it gives links without a mass of their
            own some of their leader's, so that the mass matrix of all joints has an inverse.
    """

    followers: list[Coupled] = field(default_factory=list)
    names: frozenset[str] = frozenset()
    lent: np.ndarray = field(default_factory=lambda: np.zeros(0))


def find_couplings(model: pin.Model, start: np.ndarray, elements: Sequence[Element]) -> Couplings:
    """Return the coupled joints of a scene with these elements; start: its neutral configuration (nq,)."""
    followers, names = find_followers(model, elements)
    return Couplings(followers, names, _lent(model, start, followers)) if followers else Couplings()


def find_followers(
    model: pin.Model, elements: Sequence[Element], prefix: str = ""
) -> tuple[list[Coupled], frozenset[str]]:
    """Return the joints that follow others, and the names of the equalities that say so.

    prefix: of the names of joints in the elements, which the model does not have.
    """
    links: dict[int, list[tuple[int, float, float]]] = {}  # joint -> (other, ratio, offset): q_other = offset + ratio q
    names: set[str] = set()
    follows: set[int] = set()
    roots = list(range(model.njoints))

    def root(i: int) -> int:
        while roots[i] != i:
            i = roots[i]
        return i

    for equality in elements:
        if not isinstance(equality, EqualityConstraint) or not _is_linear(equality):
            continue
        ends = [str(name).removeprefix(prefix) for name in (equality.joint, equality.other)]
        if not all(model.existJointName(name) for name in ends):
            continue
        joint, other = (int(model.getJointId(name)) for name in ends)
        if root(joint) == root(other):
            continue
        roots[root(joint)] = root(other)
        c0, c1 = (float(c) for c in equality.coefficients[:2])
        links.setdefault(other, []).append((joint, c1, c0))
        links.setdefault(joint, []).append((other, 1.0 / c1, -c0 / c1))
        follows.add(joint)
        names.add(equality.name)
    followers: list[Coupled] = []
    seen: set[int] = set()
    for joint in sorted(links, key=lambda i: (i in follows, i)):  # those that follow nobody lead
        if joint not in seen:
            followers += _led_by(joint, links, seen)
    followers.sort(key=lambda f: f.joint)
    return followers, frozenset(names)


def on_couplings(model: pin.Model, q: np.ndarray, followers: Sequence[Coupled]) -> np.ndarray:
    """Return the configuration q (nq,) with the followers where their leaders put them."""
    q = q.copy()
    for f in followers:
        q[model.idx_qs[f.joint]] = f.offset + f.ratio * q[model.idx_qs[f.leader]]
    return q


def coupled_basis(model: pin.Model, followers: Sequence[Coupled]) -> np.ndarray:
    """Return S of v = S u, (nv, nv - followers): the velocities that the couplings leave."""
    S = np.eye(model.nv)
    for f in followers:
        S[model.idx_vs[f.joint]] = 0.0
        S[model.idx_vs[f.joint], model.idx_vs[f.leader]] = f.ratio
    return np.delete(S, [model.idx_vs[f.joint] for f in followers], axis=1)


def _is_linear(equality: EqualityConstraint) -> bool:
    c = np.asarray(equality.coefficients, dtype=float)
    return equality.other is not None and len(c) > 1 and c[1] != 0.0 and not np.any(c[2:])


def _led_by(leader: int, links: dict[int, list[tuple[int, float, float]]], seen: set[int]) -> list[Coupled]:
    """Return the joints that follow a leader, along chains."""
    found, at = [], [(leader, 1.0, 0.0)]
    seen.add(leader)
    while at:
        joint, ratio, offset = at.pop()
        for other, c1, c0 in links[joint]:
            if other in seen:
                continue
            seen.add(other)
            at.append((other, c1 * ratio, c0 + c1 * offset))
            found.append(Coupled(other, leader, c1 * ratio, c0 + c1 * offset))
    return found


def _lent(model: pin.Model, start: np.ndarray, followers: Sequence[Coupled]) -> np.ndarray:
    """Return the armature that the couplings lend, see Couplings.

    With e on a follower and -ratio^2 e on its leader S^T M S stays as it is. Each coupling takes, one after the other,
    what makes the pivots of the elimination along the tree largest.
    """
    own = engine_model(model)
    poses = [_pose(model, start, followers, k) for k in range(_POSES)]
    masses = [np.asarray(own.mass_matrix(q)) for q in poses]
    lent = np.zeros(model.nv)
    if _pivots(masses, lent).min() > _NO_MASS:
        return np.zeros(0)

    def score(armature: np.ndarray) -> float:
        return float(np.log(np.maximum(_pivots(masses, armature), _LEAST)).sum())

    S = coupled_basis(model, followers)
    for leader in sorted({f.leader for f in followers}):
        led = [f for f in followers if f.leader == leader]
        column = S[:, int(np.flatnonzero(S[model.idx_vs[leader]])[0])]
        inertia = float(np.mean([column @ M @ column for M in masses]))
        best, chosen = score(lent), lent
        for share in _LENT:
            trial = lent.copy()
            for f in led:
                e = share * inertia / (1.0 + f.ratio**2) / len(led)
                trial[model.idx_vs[f.joint]] += e
                trial[model.idx_vs[leader]] -= f.ratio**2 * e
            found = score(trial)
            if found > best + _GAIN:
                best, chosen = found, trial
        lent = chosen
    return lent if np.any(lent) else np.zeros(0)


def _pose(model: pin.Model, start: np.ndarray, followers: Sequence[Coupled], k: int) -> np.ndarray:
    q = pin.integrate(model, start, 0.3 * k * np.sin(1.0 + k + np.arange(model.nv)))
    return on_couplings(model, np.asarray(q), followers)


def _pivots(masses: Sequence[np.ndarray], armature: np.ndarray) -> np.ndarray:
    """Return the least pivots of matrices by row, eliminated from the last one on, in parts of what is eliminated."""
    least = np.full(len(armature), np.inf)
    for mass in masses:
        D = mass + np.diag(armature)
        size = np.diag(mass) + np.abs(armature)
        for i in range(len(D) - 1, -1, -1):
            pivot = abs(D[i, i]) / size[i] if size[i] > 0.0 else 0.0
            least[i] = min(least[i], pivot)
            if pivot > _LEAST:
                D[:i, :i] -= np.outer(D[:i, i], D[i, :i]) / D[i, i]
    return least
