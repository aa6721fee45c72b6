"""The runs that dt = "auto" compares: how far two are apart, and what part of that is the error of the finer one."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from contactvi.scene.engine import engine_halved_steps
from contactvi.simulation.recorder import Record
from contactvi.status import StatusCode
from contactvi.trajectory import polynomials

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]

_DISTINCT = 1.3  # ratio of errors, by the law, below which the steps of a flight are too much alike to compare
_MATTERS = 0.01  # share of a flight in the error, by the law, below which that does not matter
_TIMES, _CONTACT_TIMES = 6, 24  # at which two runs are compared; in contact each pair of them is held to the law
_STARTS = 3  # flights whose first step is looked at


class AutoRun:
    """A run at a level [m, rad] and with contact steps of at most dt_contact [s]: its record, the engine at its end."""

    def __init__(self, level: float, dt_contact: float, record: Record, simulator: _core.Simulator) -> None:
        self.level, self.dt_contact, self.record, self.engine = level, dt_contact, record, simulator

    @property
    def steps(self) -> Array:
        """Lengths of its adaptive steps [s], one for every time at which the length changes."""
        return np.zeros(0) if self.record.adaptive_steps is None else self.record.adaptive_steps["dt"]

    @cached_property
    def polynomials(self) -> polynomials.Segments | None:
        """Its segments; None without any."""
        return self.record.segments_joined()

    @property
    def segments(self) -> dict[str, Array]:
        """The arrays of its segments (contactvi.trajectory.polynomials)."""
        joined = self.polynomials
        return {name: np.zeros(0) for name in polynomials.FIELDS} if joined is None else joined.arrays

    @cached_property
    def in_contact(self) -> bool:
        """Whether there were persistent contacts or dense steps."""
        return bool(self.segments["persistent"].any())

    @property
    def took_dense_steps(self) -> bool:
        """Whether there were dense steps, whose error follows no law."""
        return self.record.stats.dense_steps > 0

    @property
    def contact_time(self) -> float:
        """Time in contact steps [s]."""
        segments = self.segments
        return float(segments["h"][segments["persistent"] != 0.0].sum())

    @property
    def interrupted(self) -> bool:
        """Whether the user has stopped it."""
        return self.record.status.code == StatusCode.INTERRUPTED

    @property
    def final(self) -> bool:
        """Whether no finer run is to be made: the user has stopped this one, or finer ones would end earlier."""
        return self.interrupted or self.record.status.code == StatusCode.TOO_MANY_STEPS or not len(self.segments["t"])


def ratio(companion: AutoRun, found: AutoRun) -> float:
    """Return error / (companion's error - error) by the levels, and by the contact steps where there are any."""
    least = (companion.level / found.level) ** 2
    if found.in_contact or companion.in_contact:
        least = min(least, (companion.dt_contact / found.dt_contact) ** 2)
    return 1.0 / (least - 1.0) if least > 1.0 else math.inf


def share(companion: AutoRun, found: AutoRun, power: int) -> float:
    """Return error / (companion's error - error) by the lengths h of the segments: an error is their sum of h^power.

    Lengths are counted in the adaptive steps that `found` has at the time of a segment, because the factor of the law
    has made these steps so long; with persistent contacts, in its contact steps. Where the two runs do not meet the
    same impacts but both have persistent contacts, the levels alone decide. The result is infinite where flights
    (between two impacts) that matter have almost the same segments in both runs.
    """
    steps = found.record.adaptive_steps
    if steps is None or not len(steps["t"]) or found.record.impacts != companion.record.impacts:
        return ratio(companion, found) if found.in_contact and companion.in_contact else math.inf
    sums = []
    for run in (found, companion):
        t, h, persistent = (run.segments[name] for name in ("t", "h", "persistent"))
        middles = t + 0.5 * h
        unit = steps["dt"][np.maximum(steps["t"].searchsorted(middles, side="right") - 1, 0)]
        weights = (h / unit) ** power
        if run.in_contact:
            weights = np.where(persistent != 0.0, (h / found.dt_contact) ** 3, weights)
        flight = run.record.impact_times().searchsorted(middles)
        sums.append(np.bincount(flight, weights, minlength=found.record.impacts + 1))
    own, other = sums
    whole = float(own.sum())
    if ((other < _DISTINCT * own) & (own > _MATTERS * whole)).any():
        return math.inf
    return whole / (float(other.sum()) - whole)


def transient(found: AutoRun) -> float:
    """Return the largest distance between a step and two halves of it, of the first ones of some flights.

    A stiff motion that damping ends within a step or two has an error there that later nodes do not show. Two runs are
    no comparison in their first step either: up to the end of the shorter one both have made one step.
    """
    segments, record = found.segments, found.record
    times = record.impact_times()
    chosen = times[np.linspace(0, len(times) - 1, _STARTS).astype(int)] if len(times) else times
    first = segments["t"].searchsorted(chosen)
    looked_at = np.array(sorted({0, *first[first < len(segments["t"])].tolist()}))
    looked_at = looked_at[segments["persistent"][looked_at] == 0.0]
    if not len(looked_at):
        return 0.0
    q, p, h = (segments[name][looked_at] for name in ("q", "p", "h"))
    options = record.options
    whole, halves = engine_halved_steps(record.compiled.core, q, p, h, options.stage_tol, options.order)
    return largest(record.compiled.states.distance(whole, halves))


def distances(other: AutoRun, found: AutoRun, ended: bool = False) -> Array:
    """Return |q - q'| of two runs at some nodes of the second; one that is infinite where a run ended much earlier.

    Args:
        ended: whether both ended before their time; then up to the earlier end.
    """
    t, q, _ = found.record.nodes()
    last = float(other.record.t[-1][-1])
    if len(t) < 2 or (not ended and abs(float(t[-1]) - last) > 1e-3 * (t[-1] - t[0])):
        return np.array([math.inf])
    count = int(t.searchsorted(last, side="right"))  # nodes that both runs have reached
    times = _CONTACT_TIMES if found.in_contact else _TIMES
    nodes = np.linspace(0, count - 1, times + 1)[1:].round().astype(int)
    if found.in_contact:  # their nodes are not spread evenly
        nodes = t.searchsorted(t[0] + (t[count - 1] - t[0]) * np.arange(1, times + 1) / times * (1.0 - 1e-12))
    assert other.polynomials is not None
    states, _ = other.polynomials.states(found.record.compiled.core, t[nodes], exact=True)
    return np.asarray(found.record.compiled.states.distance(states, q[nodes]))


def largest(values: Array) -> float:
    """Return the largest value; infinite where one is not known."""
    found = float(values.max())
    return found if math.isfinite(found) else math.inf
