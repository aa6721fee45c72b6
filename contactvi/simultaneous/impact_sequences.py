"""Sequences of single impacts at one configuration: all orders, and the one that a run takes.

Simultaneous impacts are no law of their own here: they are single impacts one after another until every contact
separates (Seghete, Murphey 2009/2010, "Variational Solutions to Simultaneous Collisions between Multiple Rigid
Bodies"). Everything happens in the coordinates x = L^T v, M = L L^T, where the kinetic metric is Euclid's: a contact's
row W becomes the vector a = L^-1 W^T, its inverse inertia G_c = |a|^2, its normal speed gamma = a.x, and a single
elastic impact is the reflection of x in the plane a.x = 0. Frictionless.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Array = NDArray[np.float64]

ENDLESS = 1e-9  # of the first closing speeds: where an endless sequence is cut and ends plastically
_ROUNDING = 1e-13  # likewise: below it a speed is rounding
_NOISE = 64 * np.finfo(float).eps  # of |x|: likewise, of bodies that fly almost together
_MERGE = 1e-11  # of |x|: states that are one; well below ENDLESS, so that a converging sequence is not taken for a loop
_SAME = 1e-8  # of |x|: ends that are one outcome; sequences cut at ENDLESS agree to about that
_TIE = 1e-12  # of the closing speed: ties between contacts, decided by their number


@dataclass(frozen=True)
class End:
    """Where a sequence of impacts ends.

    Attributes:
        x: state, shape (nv,).
        impulse: sums per contact [N s], one array (m,) each, of its points.
        steps: the impacts in order, each the numbers of the contacts struck as one.
        cut: whether the sequence is endless and was cut.
    """

    x: Array
    impulse: tuple[Array, ...]
    steps: tuple[tuple[int, ...], ...]
    cut: bool


class Impacts:
    """The single impacts that are possible at one configuration.

    Attributes:
        rows: a of the points of each contact, arrays of shape (m, nv).
        restitution: of each contact, in [0, 1].
        x: the state before, shape (nv,).
    """

    def __init__(self, rows: Sequence[Array], restitution: Sequence[float], x: Array) -> None:
        self.rows, self.restitution, self.x = list(rows), list(restitution), x
        self._lengths = [np.linalg.norm(a, axis=1) for a in self.rows]
        # not speeds but a.x / |a|: one unit for contacts [m/s] and limits of revolute joints [rad/s]
        self._grid = _MERGE * max(float(np.linalg.norm(x)), np.finfo(float).tiny / _MERGE)
        self._floor = _NOISE * float(np.linalg.norm(x))
        self._scale = max(float(np.abs(self._speeds(i, x)).max()) for i in range(len(self.rows)))

    def _speeds(self, i: int, x: Array) -> Array:
        return np.asarray(self.rows[i] @ x / self._lengths[i])

    def closing(self, x: Array, share: float = ENDLESS) -> list[int]:
        """Return the contacts that close faster than this share of the first speeds, and than rounding."""
        least = max(share * self._scale, self._floor)
        return [i for i in range(len(self.rows)) if float(self._speeds(i, x).min()) < -least]

    def strike(self, i: int, x: Array) -> tuple[Array, Array]:
        """Return x after a single impact of contact i, and the impulses of its points (m,).

        Poisson: compression is the plastic impact of all its points, expansion gives back at least e of each impulse.
        With one point this is gamma+ = -e gamma-.
        """
        a, e = self.rows[i], self.restitution[i]
        if len(a) == 1:
            impulse = -(1.0 + e) * (a @ x) / self._lengths[i] ** 2
            return x + a.T @ impulse, impulse
        first = _plastic(a, x)
        given = (1.0 + e) * first
        impulse = given + _plastic(a, x + a.T @ given)
        return x + a.T @ impulse, impulse

    def settle(self, chosen: Sequence[int], x: Array) -> tuple[Array, list[Array]]:
        """Return x after these contacts end plastically as one problem, and the impulses of their points."""
        a = np.vstack([self.rows[i] for i in chosen])
        impulse = _plastic(a, x)
        ends = np.cumsum([len(self.rows[i]) for i in chosen])[:-1]
        return x + a.T @ impulse, np.split(impulse, ends)

    def every_order(self, limit: int) -> tuple[list[End], bool]:
        """Return the ends of all sequences, the first found of each, and whether at most `limit` states were enough.

        Depth first, the contact that closes most first; a state reached twice is followed once.
        """
        start = _Path(self.x, tuple(np.zeros(len(a)) for a in self.rows), None, ())
        stack, seen, ends = [start], {self._key(self.x)}, list[End]()
        size = float(np.linalg.norm(self.x))
        while stack:
            path = stack.pop()
            closing = self.closing(path.x)
            if not closing:
                end = self._end(path)
                if all(np.linalg.norm(end.x - other.x) > _SAME * size for other in ends):
                    ends.append(end)
                continue
            for i in sorted(closing, key=lambda i: -float(self._speeds(i, path.x).min())):
                after = self._struck(path, i)
                key = self._key(after.x)
                if key in seen:
                    continue
                if len(seen) >= limit:
                    return ends, False
                seen.add(key)
                stack.append(after)
        return ends, True

    def chosen(self, limit: int) -> End:
        """Return the end of the sequence that a run takes.

        The elastic contact (e > 0) whose gap closes fastest, the lowest number where speeds tie; where none closes, all
        plastic contacts as one problem, the limit of their endless sequence; again until none closes.
        """
        path = _Path(self.x, tuple(np.zeros(len(a)) for a in self.rows), None, ())
        plastic = [i for i, e in enumerate(self.restitution) if e == 0.0]
        for _ in range(limit):
            closing = self.closing(path.x)
            if not closing:
                return self._end(path)
            elastic = [i for i in closing if self.restitution[i] > 0.0]
            if elastic:
                speed = [float((self.rows[i] @ path.x).min()) for i in elastic]
                path = self._struck(path, elastic[_first_lowest(speed)])
            else:
                path = self._settled(path, plastic)
        return self._end(path, endless=True)

    def _struck(self, path: _Path, i: int) -> _Path:
        x, impulse = self.strike(i, path.x)
        total = tuple(old + impulse if k == i else old for k, old in enumerate(path.impulse))
        return _Path(x, total, path, (i,))

    def _settled(self, path: _Path, contacts: Sequence[int]) -> _Path:
        x, impulses = self.settle(contacts, path.x)
        new = dict(zip(contacts, impulses, strict=True))
        total = tuple(old + new[k] if k in new else old for k, old in enumerate(path.impulse))
        struck = tuple(k for k in contacts if np.any(new[k] > 0.0))
        return _Path(x, total, path, struck)

    def _end(self, path: _Path, endless: bool = False) -> End:
        """Return the end of a path; what closes still ends plastically, all contacts as one problem."""
        left = bool(self.closing(path.x, _ROUNDING))
        if left:
            path = self._settled(path, range(len(self.rows)))
        return End(path.x, path.impulse, path.steps(), endless or left)

    def _key(self, x: Array) -> bytes:
        return (np.rint(x / self._grid) + 0.0).tobytes()  # + 0: one zero, not two


class _Path:
    """A state on the way: x, impulses so far, the state before and the contacts struck between the two."""

    __slots__ = ("before", "impulse", "struck", "x")

    def __init__(self, x: Array, impulse: tuple[Array, ...], before: _Path | None, struck: tuple[int, ...]) -> None:
        self.x, self.impulse, self.before, self.struck = x, impulse, before, struck

    def steps(self) -> tuple[tuple[int, ...], ...]:
        found, path = [], self
        while path.before is not None:
            found.append(path.struck)
            path = path.before
        return tuple(found[::-1])


def _plastic(a: Array, x: Array) -> Array:
    """Return the impulses >= 0 of points a (m, nv) with gamma+ = a (x + a^T impulse) >= 0, complementary, shape (m,).

    That is x + a^T impulse = the point of the cone {gamma >= 0} nearest to x: least squares over impulses >= 0.
    """
    return np.asarray(nnls(a.T, -x)[0])


def _first_lowest(values: Sequence[float]) -> int:
    lowest = min(values)
    return next(k for k, value in enumerate(values) if value <= lowest + _TIE * abs(lowest))
