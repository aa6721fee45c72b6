"""Impacts with friction: Poisson's law as two cone problems, all points of a pair at once.

Compression: e = 0 with Coulomb friction, Lam1. Expansion: Lam2_n >= e Lam1_n, gamma+ >= 0, complementary, and
|Lam2_t| <= mu Lam2_n with maximal dissipation on gamma+. Several pairs: the most closing elastic pair first, one at a
time; when none closes, all plastic pairs together in one problem; repeated until none closes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .contact_modes import Law, Problem


@dataclass(frozen=True)
class Pair:
    """Points of one pair: gradients W (m, 3, nv), rows (n, t1, t2); mu; restitution."""

    w: np.ndarray
    mu: float = 0.0
    restitution: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """p_plus (nv,), lam (m, 3) [N s] of all points, loss of kinetic energy [J], the restitution that was used."""

    p_plus: np.ndarray
    lam: np.ndarray
    loss: float
    restitution: float


def kinetic(mass, p):
    return 0.5 * p @ np.linalg.solve(mass, p)


def cone(mass, p, w, laws):
    """(p_plus, lam) of one problem M v = p + W^T lam with the laws on W v."""
    flat = w.reshape(-1, w.shape[2])
    eps = 1e-5 * float((flat @ np.linalg.solve(mass, flat.T)).diagonal().max()) if len(w) > 1 else 0.0
    found = Problem(lambda v: (mass @ v - p, w @ v), w, np.linalg.solve(mass, p), laws).solve(None, eps)
    return p + np.einsum("irk,ir->k", w, found.lam), found.lam


def poisson(mass, p, pair: Pair) -> Outcome:
    """One impact of one pair. e is lowered by bisection where the energy would rise (never seen)."""
    before, m = kinetic(mass, p), len(pair.w)
    middle, first = cone(mass, p, pair.w, [Law(pair.mu)] * m)
    pushed = np.where(first[:, 0] > 1e-13 * np.abs(first).max(), first[:, 0], 0.0)  # open points: rounding
    e, low, high = pair.restitution, 0.0, pair.restitution
    while True:
        after, second = cone(mass, middle, pair.w, [Law(pair.mu, e * x) for x in pushed])
        loss = before - kinetic(mass, after)
        if loss >= -1e-12 * before:
            low = e
            if e == pair.restitution or high - low < 1e-9:
                return Outcome(after, first + second, loss, e)
        else:
            high = e
        e = 0.5 * (low + high)


def plastic(mass, p, pairs: list[Pair]) -> Outcome:
    """All these pairs together with e = 0."""
    w = np.concatenate([pair.w for pair in pairs])
    laws = [Law(pair.mu) for pair in pairs for _ in pair.w]
    after, lam = cone(mass, p, w, laws)
    return Outcome(after, lam, kinetic(mass, p) - kinetic(mass, after), 0.0)


def sequence(mass, p, pairs: list[Pair], tolerance=1e-9, most=10_000):
    """(p_plus, list of the pairs hit, -1 for all plastic ones) of touching pairs, until none closes.

    tolerance: closing speeds below it, relative to the first, are none: the end of an endless sequence.
    """
    hits: list[int] = []
    scale = None
    for _ in range(most):
        v = np.linalg.solve(mass, p)
        closing = np.array([(pair.w[:, 0] @ v).min() for pair in pairs])
        scale = np.abs(closing).max() if scale is None else scale
        elastic = [i for i, pair in enumerate(pairs) if pair.restitution > 0.0 and closing[i] < -tolerance * scale]
        if elastic:
            i = min(elastic, key=lambda k: closing[k])
            p = poisson(mass, p, pairs[i]).p_plus
            hits.append(i)
            continue
        # with e = 0, and elastic ones whose sequence has come to its end
        rest = [pair for pair in pairs if pair.restitution == 0.0]
        if not rest or closing.min() >= -tolerance * scale:
            return p, hits
        p = plastic(mass, p, rest).p_plus
        hits.append(-1)
    raise ArithmeticError("the sequence of impacts does not end")
