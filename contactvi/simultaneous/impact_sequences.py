"""Sequences of single impacts at one configuration: the ends of all orders, and the one that a run takes.

Simultaneous impacts are no law of their own here: they are single impacts one after another until every contact
separates (Seghete, Murphey 2009/2010, "Variational Solutions to Simultaneous Collisions between Multiple Rigid
Bodies"). The single impacts and the order of a run are the engine's; this module searches the other orders. It
measures in the coordinates x = L^-1 p, M = L L^T, where the kinetic metric is Euclid's: a contact's row W becomes the
vector a = L^-1 W^T, its inverse inertia G_c = |a|^2, its normal speed gamma = a.x, and a single elastic impact is the
reflection of x in the plane a.x = 0. Frictionless.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from contactvi.scene.engine import ImpactsAt

Array = NDArray[np.float64]

ENDLESS = 1e-9  # of the first closing speeds: where an endless sequence is cut and ends plastically
_ROUNDING = 1e-13  # of the first closing speeds: below it a speed is rounding
_NOISE = 64 * np.finfo(float).eps  # of |x|: below it the closing speed of bodies that fly almost together is rounding
_MERGE = 1e-11  # of |x|: states that are one; well below ENDLESS, so that a converging sequence is not taken for a loop
SAME = 1e-8  # of |x|: ends that are one outcome; sequences cut at ENDLESS agree to about that


@dataclass(frozen=True)
class End:
    """Where a sequence of impacts ends.

    Attributes:
        p: momentum, engine coordinates, shape (nv,).
        impulse: sums per contact [N s], shape (n,).
        steps: the impacts in order, each the numbers of the contacts struck as one.
        cut: whether the sequence is endless and was cut.
    """

    p: Array
    impulse: Array
    steps: tuple[tuple[int, ...], ...]
    cut: bool


class Impacts:
    """The single impacts that are possible at one configuration.

    The impacts are homogeneous of degree one in the momentum. All is computed for a momentum of about unit size and
    scaled back by a power of two, which is exact, so that the engine's absolute threshold for speeds plays no part.
    """

    def __init__(
        self, engine: ImpactsAt, mobile: Sequence[NDArray[np.bool_]], mass: Array, basis: Array | None, p: Array
    ) -> None:
        """Take the engine's contacts, the mass matrix M, and the momentum.

        `mobile` says of each point of each contact whether its gap can change: only those have rows. `mass` (nv, nv)
        and `p` (nv,) are in engine coordinates; `basis`: S of coupled joints, v = S u, (nv, n), None without them.
        """
        self._engine, self._basis = engine, basis
        own = mass if basis is None else basis.T @ mass @ basis
        self._lower: Array = np.linalg.cholesky(0.5 * (own + own.T)).astype(float, copy=False)
        self.rows = [self.metric(engine.directions(k)[moves].T).T for k, moves in enumerate(mobile)]
        self._lengths = [np.linalg.norm(a, axis=1) for a in self.rows]
        size = float(np.linalg.norm(self.metric(p)))
        self._unit = 2.0 ** -round(np.log2(size)) if size > 0.0 else 1.0
        self._p = self._unit * p
        x = self.metric(self._p)
        # Speeds are taken over |a|: one unit for contacts [m/s] and for limits of revolute joints [rad/s].
        self._grid = _MERGE * max(float(np.linalg.norm(x)), np.finfo(float).tiny / _MERGE)
        self._floor = _NOISE * float(np.linalg.norm(x))
        self._scale = max(float(np.abs(self._speeds(i, x)).max()) for i in range(len(self.rows)))
        self._size = float(np.linalg.norm(x))

    def metric(self, p: Array) -> Array:
        """Return x = L^-1 p of the Cholesky factor L of M, shape (nv,), or of several columns.

        Of coupled joints x = L^-1 S^T p with that of S^T M S, shape (n,).
        """
        return np.asarray(np.linalg.solve(self._lower, p if self._basis is None else self._basis.T @ p), dtype=float)

    def apart(self, one: End, other: End) -> bool:
        """Return whether two ends are two outcomes."""
        distance = float(np.linalg.norm(self.metric(one.p - other.p)))
        return self._unit * distance > SAME * self._size

    def every_order(self, limit: int) -> tuple[list[End], bool]:
        """Return the ends of all sequences, the first found of each, and whether at most `limit` states were enough.

        Depth first, the contact that closes most first; a state reached twice is followed once.
        """
        start = _Path(self._p, np.zeros(len(self.rows)), None, ())
        stack, seen, ends = [start], {self._key(self._p)}, list[End]()
        while stack:
            path = stack.pop()
            x = self.metric(path.p)
            closing = self._closing(x, ENDLESS)
            if not closing:
                end = self._end(path)
                if all(self.apart(end, other) for other in ends):
                    ends.append(end)
                continue
            for i in sorted(closing, key=lambda i: -float(self._speeds(i, x).min())):
                after = self._struck(path, i)
                key = self._key(after.p)
                if key in seen:
                    continue
                if len(seen) >= limit:
                    return ends, False
                seen.add(key)
                stack.append(after)
        return ends, True

    def chosen(self) -> End:
        """Return the end of the sequence that a run takes.

        The elastic contact (e > 0) whose gap closes fastest, the lowest number where speeds tie; where none closes, all
        plastic contacts as one problem, the limit of their endless sequence; again until none closes.
        """
        p, impulse, struck, ended, cut = self._engine.run(self._p)
        steps = tuple(tuple(step) for step in struck)
        if ended:
            return self._scaled(p, impulse, steps, cut)
        p, last = self._engine.settle(p)
        return self._scaled(p, impulse + last, (*steps, tuple(np.flatnonzero(last > 0.0).tolist())), True)

    def _speeds(self, i: int, x: Array) -> Array:
        return np.asarray(self.rows[i] @ x / self._lengths[i])

    def _closing(self, x: Array, share: float) -> list[int]:
        """Return the contacts that close faster than this share of the first speeds, and than rounding."""
        least = max(share * self._scale, self._floor)
        return [i for i in range(len(self.rows)) if float(self._speeds(i, x).min()) < -least]

    def _struck(self, path: _Path, i: int) -> _Path:
        p, impulse = self._engine.strike(i, path.p)
        total = path.impulse.copy()
        total[i] += impulse
        return _Path(p, total, path, (i,))

    def _end(self, path: _Path) -> End:
        """Return the end of a path; what closes still ends plastically, all contacts as one problem."""
        left = bool(self._closing(self.metric(path.p), _ROUNDING))
        if left:
            p, impulse = self._engine.settle(path.p)
            path = _Path(p, path.impulse + impulse, path, tuple(np.flatnonzero(impulse > 0.0).tolist()))
        return self._scaled(path.p, path.impulse, path.steps(), left)

    def _scaled(self, p: Array, impulse: Array, steps: tuple[tuple[int, ...], ...], cut: bool) -> End:
        return End(p / self._unit, impulse / self._unit, tuple(step for step in steps if step), cut)

    def _key(self, p: Array) -> bytes:
        return (np.rint(self.metric(p) / self._grid) + 0.0).tobytes()  # + 0: one zero, not two


class _Path:
    """A state on the way: momentum, impulses so far, the state before and the contacts struck between the two."""

    __slots__ = ("before", "impulse", "p", "struck")

    def __init__(self, p: Array, impulse: Array, before: _Path | None, struck: Sequence[int]) -> None:
        self.p, self.impulse, self.before, self.struck = p, impulse, before, tuple(struck)

    def steps(self) -> tuple[tuple[int, ...], ...]:
        """Return the contacts struck on the way here, in order."""
        found, path = [], self
        while path.before is not None:
            found.append(path.struck)
            path = path.before
        return tuple(found[::-1])
