"""The runs that dt = "auto" compares: how far two are apart, and what part of that is the error of the finer one."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from contactvi.status import StatusCode

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]

_TIMES, _CONTACT_TIMES = 8, 24  # at which two runs are compared; in contact each pair of them is held to the law
_CODES = tuple(StatusCode)  # by number


class AutoRun:
    """A run at a level [m, rad] and with contact steps of at most dt_contact [s], and the engine at its end.

    Attributes:
        stage_tol: tolerance of its stage equations.
        interrupted: whether the user has stopped it.
    """

    def __init__(
        self, level: float, dt_contact: float, stage_tol: float, run: _core.KeptRun, interrupted: bool,
        simulator: _core.Simulator,
    ) -> None:  # fmt: skip
        self.level, self.dt_contact, self.stage_tol = level, dt_contact, stage_tol
        self.run, self.engine = run, simulator
        self.interrupted = interrupted
        self.code = _CODES[int(run.code)]

    @property
    def ok(self) -> bool:
        """Whether it has reached its end."""
        return self.code == StatusCode.SUCCESS

    @cached_property
    def contact_time(self) -> float:
        """Time in contact steps [s]."""
        return self.run.contact_time

    @property
    def in_contact(self) -> bool:
        """Whether there were contact steps or dense steps."""
        return self.contact_time > 0.0

    @property
    def touched(self) -> bool:
        """Whether contacts have persisted, in steps of any kind."""
        return self.in_contact or self.run.contact_changes > 0

    @property
    def took_dense_steps(self) -> bool:
        """Whether there were dense steps, whose error follows no law."""
        return self.run.dense_steps > 0

    @property
    def final(self) -> bool:
        """Whether no finer run is to be made: the user has stopped this one, or finer ones would end earlier."""
        return self.interrupted or self.code == StatusCode.TOO_MANY_STEPS or self.run.segments == 0


def ratio(companion: AutoRun, found: AutoRun) -> float:
    """Return error / (companion's error - error) by the levels, and by the contact steps where there are any."""
    least = (companion.level / found.level) ** 2
    if found.in_contact or companion.in_contact:
        least = min(least, (companion.dt_contact / found.dt_contact) ** 2)
    return 1.0 / (least - 1.0) if least > 1.0 else math.inf


def share(companion: AutoRun, found: AutoRun, power: int) -> float:
    """Return error / (companion's error - error) by the law h^power of the lengths h of the segments.

    Where the two runs do not meet the same impacts but both have contact steps, the levels alone decide.
    """
    by_segments = found.run.error_share(companion.run, power, found.dt_contact)
    return ratio(companion, found) if math.isnan(by_segments) else by_segments


def distances(other: AutoRun, found: AutoRun, ended: bool = False) -> Array:
    """Return |q - q'| of two runs at some nodes of the second; one that is infinite where a run ended much earlier.

    Args:
        ended: whether both ended before their time; then up to the earlier end.
    """
    times = _CONTACT_TIMES if found.touched else _TIMES
    return found.run.distances(other.run, times, found.in_contact, ended)


def largest(values: Array) -> float:
    """Return the largest value; infinite where one is not known."""
    found = float(values.max())
    return found if math.isfinite(found) else math.inf
