"""How a run ended and what it cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any


class StatusCode(IntEnum):
    """How a run ended (the numbers are the engine's; LEDGER is the face's: a tolerance of the ledger was exceeded)."""

    SUCCESS = 0
    ZENO = 1
    NEWTON_FAILED = 2
    NOT_FINITE = 3
    EVENT_UNRESOLVED = 4
    TOO_MANY_IMPACTS = 5
    PENETRATION = 6
    INTERRUPTED = 7
    LEDGER = 8
    CONSTRAINT = 9


@dataclass(frozen=True)
class Status:
    """How a run ended: code, message, time reached [s]. `ok` is True for SUCCESS."""

    code: StatusCode
    message: str
    time: float

    @property
    def ok(self) -> bool:
        """True when the run went to its end."""
        return self.code == StatusCode.SUCCESS

    def __str__(self) -> str:
        return f"{self.code.name} at t = {self.time:.9g} s: {self.message}"


@dataclass(frozen=True)
class Stats:
    """What a run cost.

    Attributes:
        steps: accepted steps of length dt, or with dt="auto" of the lengths chosen.
        iterations, sweeps: sweeps over the stages of a step (two names of one number).
        residuals: evaluations of the step equation.
        factorizations: of the mass matrix or the Newton matrix.
        halved: steps cut in two because their sweeps did not converge.
        rejected: steps that "auto" made again shorter.
        guards_evaluated, guards_skipped: pairs and limits looked at, and those that could not be reached in the step.
        impacts: number of them.
        seconds: wall time inside the engine.
        held_steps: steps and parts of steps with held contacts.
        contact_rounds: rounds of their equations.
        cone_problems, cone_iterations: contact problems solved, and Newton iterations for them;
        cone_fallbacks: of the problems, those that needed another solver.
        contact_seconds: wall time inside held steps.
    """

    steps: int = 0
    iterations: int = 0
    residuals: int = 0
    factorizations: int = 0
    guards_evaluated: int = 0
    guards_skipped: int = 0
    impacts: int = 0
    seconds: float = 0.0
    sweeps: int = 0
    halved: int = 0
    rejected: int = 0
    held_steps: int = 0
    contact_rounds: int = 0
    cone_problems: int = 0
    cone_iterations: int = 0
    cone_fallbacks: int = 0
    contact_seconds: float = 0.0

    @classmethod
    def of(cls, counts: Mapping[str, Any], seconds: float = 0.0) -> Stats:
        """Return the engine's counts; `seconds` are those of the calls before."""
        known = {name: counts[name] for name in _COUNTS if name in counts}
        return cls(**known, seconds=counts["seconds"] + seconds)


_COUNTS = tuple(name for name in Stats.__dataclass_fields__ if name != "seconds")
