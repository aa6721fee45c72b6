"""Motions made of smooth phases: each is integrated by SciPy's DOP853 up to where one of its guards falls through zero.

What is slow is obvious: a change that was found on the interpolant of a step is looked for again on a piece of the
motion that is so short that the interpolant is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
Guard = Callable[[float, Array], float]

TOLERANCE = 1e-13  # relative and absolute, of each step
LONGEST = 0.02  # [s] of a step: no guard of the motions here comes through zero twice within it
SHORT = 2e-4  # [s] of the piece on which a change is looked for again


class Phases(Protocol):
    """A motion with modes; a mode ends where a guard, which is positive in it, falls through zero."""

    def rate(self, mode: str, t: float, y: Array) -> Array:
        """Return dy/dt."""

    def guards(self, mode: str) -> Sequence[Guard]:
        """Return what ends the mode."""

    def after(self, mode: str, guard: int, t: float, y: Array) -> str:
        """Return the mode that follows where this guard has fallen through zero."""


@dataclass(frozen=True)
class Change:
    """Where a mode begins."""

    t: float
    mode: str


def motion(phases: Phases, mode: str, start: Array, times: Array) -> tuple[Array, list[Change]]:
    """Return the states at the times [s], (n, m), from this start at the first of them, and the changes of the mode."""
    t, y, rows, changes = float(times[0]), np.asarray(start, dtype=float), [], []
    for end in times:
        while t < end:
            found, later, state = _advance(phases, mode, t, y, float(end))
            if found is not None:  # once more, on a short piece
                before = max(t, later - 0.5 * SHORT)
                if before > t:
                    _, t, y = _advance(phases, mode, t, y, before, events=False)
                found, later, state = _advance(phases, mode, t, y, min(float(end), t + SHORT))
            t, y = later, state
            if found is not None:
                mode = phases.after(mode, found, t, y)
                changes.append(Change(t, mode))
        rows.append(y)
    return np.array(rows), changes


def _advance(
    phases: Phases, mode: str, t: float, y: Array, end: float, events: bool = True
) -> tuple[int | None, float, Array]:
    """Return the guard that has ended the mode, or None, and where: the time and the state there."""
    guards = list(phases.guards(mode)) if events else []
    for guard in guards:
        guard.terminal, guard.direction = True, -1.0  # type: ignore[attr-defined]
    run = solve_ivp(
        lambda at, state: phases.rate(mode, at, state), (t, end), y, "DOP853", rtol=TOLERANCE, atol=TOLERANCE,
        max_step=LONGEST, events=guards or None,
    )  # fmt: skip
    assert run.success
    fallen = [k for k, at in enumerate(run.t_events or []) if len(at)]
    return (fallen[0] if fallen else None), float(run.t[-1]), run.y[:, -1]
