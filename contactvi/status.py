"""How a run ended and what it cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

from contactvi.aliases import alias, renamed_arguments


class StatusCode(IntEnum):
    """How a run ended.

    The numbers are those of the engine's status codes and of stored runs. Two of them the engine does not know: LEDGER,
    a tolerance of the ledger was exceeded; and REFUSED, a run of a batch whose inputs cannot be used.
    """

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
    TOO_MANY_STEPS = 10
    REFUSED = 11
    IMPACT_UNSOLVED = 12


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

    @classmethod
    def interrupted(cls, time: float) -> Status:
        """Return the status of a run that Ctrl-C has ended at `time` [s]."""
        return cls(StatusCode.INTERRUPTED, "stopped by the user", time)

    def __str__(self) -> str:
        return f"{self.code.name} at t = {self.time:.9g} s: {self.message}"


# Names in stored runs, where they are not those of the fields of Stats.
_STORED = {"stage_iterations": "sweeps", "contact_steps": "held_steps", "contact_iterations": "contact_rounds"}
_STORED_TWICE = ("iterations", "residuals")  # stored runs have the number of stage iterations under these names too


@renamed_arguments(
    sweeps="stage_iterations", held_steps="contact_steps", contact_rounds="contact_iterations",
)  # fmt: skip
@dataclass(frozen=True)
class Stats:
    """What a run cost.

    Attributes:
        steps: accepted steps of length dt, or with dt="auto" of the lengths chosen.
        stage_iterations: iterations on the equations of the Gauss stages, each with one evaluation of their residual.
        factorizations: of the mass matrix or the Newton matrix.
        halved: steps cut in two because their stage iterations did not converge.
        rejected: steps that "auto" made again shorter.
        guards_evaluated, guards_skipped: pairs and limits looked at, and those that could not be reached in the step.
        distances: of the pairs looked at, those that needed the general distance of convex shapes (GJK); others have
            a closed form, or touch in points that bound their distance.
        impacts: number of them.
        switches: where a rope went slack or taut, or an actuator came to its limit or left it, and a step ended there.
        held_branches: ropes and actuators whose law was kept over the rest of a step, where it would change for ever.
        seconds: wall time inside the engine.
        contact_steps: contact steps, of order 2, and parts of them; smooth steps that hold contacts are none of them.
        contact_iterations: iterations on the equations of these steps.
        cone_problems, cone_iterations: contact problems solved, and Newton iterations for them;
        cone_fallbacks: of the problems, those that needed another solver.
        contact_seconds: wall time inside contact steps.
        dense_steps: steps with all impacts inside of them (contact_mode).
        dense_passes: solutions of such steps, also of those that were made again shorter, or with points that joined.
        dense_problems, dense_sweeps, dense_factorizations: contact problems in these, Gauss-Seidel sweeps for them, and
            factorizations of Newton's method and the interior point method.
        dense_gap_iterations: solutions for the normal impulses that close the gaps at the ends of these steps.

    Old names, kept for this release: sweeps, iterations and residuals of stage_iterations, held_steps of
    contact_steps, contact_rounds of contact_iterations.
    """

    steps: int = 0
    stage_iterations: int = 0
    factorizations: int = 0
    guards_evaluated: int = 0
    guards_skipped: int = 0
    distances: int = 0
    impacts: int = 0
    seconds: float = 0.0
    halved: int = 0
    rejected: int = 0
    contact_steps: int = 0
    contact_iterations: int = 0
    cone_problems: int = 0
    cone_iterations: int = 0
    cone_fallbacks: int = 0
    contact_seconds: float = 0.0
    dense_steps: int = 0
    dense_passes: int = 0
    dense_problems: int = 0
    dense_sweeps: int = 0
    dense_factorizations: int = 0
    dense_gap_iterations: int = 0
    switches: int = 0
    held_branches: int = 0

    sweeps = iterations = residuals = alias("stage_iterations")
    held_steps = alias("contact_steps")
    contact_rounds = alias("contact_iterations")

    @classmethod
    def of(cls, counts: Mapping[str, Any], seconds: float = 0.0) -> Stats:
        """Return the engine's counts; `seconds` are those of the calls before."""
        found = cls.__new__(cls)
        values = vars(found)
        values.update(counts)
        del values["saturated"]  # the only one that is none of these: it is of derivatives
        values["seconds"] += seconds
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return the counts under the names of stored runs; `from_dict` reads them back."""
        values: dict[str, Any] = {_STORED.get(name, name): getattr(self, name) for name in _FIELDS}
        return values | dict.fromkeys(_STORED_TWICE, self.stage_iterations)

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> Stats:
        """Return the counts of `to_dict`. Raises TypeError for a name that it does not write."""
        own = {name: field for field, name in _STORED.items()}
        return cls(**{own.get(name, name): value for name, value in stored.items() if name not in _STORED_TWICE})


_FIELDS = tuple(field.name for field in fields(Stats))
