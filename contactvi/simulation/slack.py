"""Ropes that go slack or taut inside of a run: there the force has a kink, and the law of an order does not hold.

A rope is a spring that acts in tension only (`add_spring(tension_only=True)`). The steps of a run do not end where its
tension becomes zero; what they lose there goes with the square of their length at best, whatever the order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactvi.importing.kinematics import JointChains
from contactvi.scene.element_rows import SpringRow
from contactvi.simulation.recorder import Record
from contactvi.trajectory.compiled import CompiledScene
from contactvi.trajectory.polynomials import Segments

Array = NDArray[np.float64]

_INNER = 8  # configurations inside of a step that are looked at
_NEAR = 2.0  # of the changes of length around a step: where a rope is as near to its rest length, it is looked inside


def switching_ropes(compiled: CompiledScene, record: Record) -> list[str]:
    """Return the names of the ropes that are taut at one time of a run and slack at another, in a run with polynomials.

    It looks at all nodes, and inside of the steps that begin or end near the rest length.
    """
    found = []
    for name, rope in compiled.ropes:
        chains = JointChains(compiled.built.model, sorted(set(rope.joints)))
        t, q, _ = record.nodes()
        over = _excess(rope, chains, q)
        taut = _taut(rope, over, t)
        if len(t) > 1 and (taut.any() != taut.all() or _switches_inside(rope, chains, compiled, record, t, over)):
            found.append(name)
    return found


def _switches_inside(
    rope: SpringRow, chains: JointChains, compiled: CompiledScene, record: Record, t: Array, over: Array
) -> bool:
    """Return whether a rope that is taut at all nodes, or slack at all, is something else in between."""
    segments: Segments | None = record.segments_joined()
    change = np.abs(np.diff(over))
    around = np.maximum(change, np.maximum(np.append(change[1:], 0.0), np.append(0.0, change[:-1])))
    near = np.flatnonzero(np.minimum(np.abs(over[:-1]), np.abs(over[1:])) <= _NEAR * around)
    if segments is None or not len(near):
        return False
    parts = np.arange(1, _INNER + 1) / (_INNER + 1)
    times = (t[near, None] + (t[near + 1] - t[near])[:, None] * parts).ravel()
    inside = _excess(rope, chains, segments.states(compiled.core, times)[0])
    return bool(np.any(_sign(inside) != _sign(over[:1])))


def _taut(rope: SpringRow, over: Array, t: Array) -> NDArray[np.bool_]:
    """Return where a rope pulls: it is longer than at rest, and does not shorten faster than its damper bears."""
    if rope.damping == 0.0 or len(t) < 2:
        return _sign(over)
    return (over > 0.0) & (rope.stiffness * over + rope.damping * np.gradient(over, t) > 0.0)


def _sign(over: Array) -> NDArray[np.bool_]:
    return np.asarray(over > 0.0)


def _excess(rope: SpringRow, chains: JointChains, q: Array) -> Array:
    """Return the lengths of a rope over its rest length at configurations (N, nq), shape (N,) [m]."""
    number = {joint: k for k, joint in enumerate(sorted(set(rope.joints)))}
    lengths = np.empty(len(q))
    for k, row in enumerate(q):
        places = chains.places(row)
        points = np.array([
            places[number[joint]].act(point) for joint, point in zip(rope.joints, rope.points, strict=True)
        ])  # fmt: skip
        lengths[k] = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    return lengths - rope.rest_length
