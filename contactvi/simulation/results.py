"""The types of what the engine's simulator returns (contactvi._core.Simulator), in Pinocchio's coordinates.

Arrays have one row per node, contact, change or segment; contactvi.trajectory.storage describes them. Where there
is nothing to report an entry is None.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]
Columns = Mapping[str, NDArray[Any]]


class EngineStatus(TypedDict):
    """How the engine stands.

    Attributes:
        message: in the engine's words, without names.
        time: reached [s].
        guard_kind, guard_index: the pair or limit that the status is about, in the numbers of events; -1: none.
        accumulation_time: when impacts accumulate [s], NaN where they do not.
        depth: of a penetration [m; rad].
    """

    code: _core.StatusCode
    message: str
    time: float
    guard_kind: _core.GuardKind
    guard_index: int
    accumulation_time: float
    depth: float


class EngineCounts(TypedDict):
    """What the run cost so far, fields as in contactvi.Stats; the seconds are those of one call."""

    steps: int
    stage_iterations: int
    factorizations: int
    guards_evaluated: int
    guards_skipped: int
    distances: int
    impacts: int
    seconds: float
    halved: int
    rejected: int
    saturated: int
    switches: int
    held_branches: int
    contact_steps: int
    contact_iterations: int
    cone_problems: int
    cone_iterations: int
    cone_fallbacks: int
    contact_seconds: float
    dense_steps: int
    dense_passes: int
    dense_problems: int
    dense_sweeps: int
    dense_factorizations: int
    dense_gap_iterations: int


class EngineResult(EngineStatus):
    """What one call of the engine did.

    Attributes:
        t, q, p: times [s] (N,), configurations (N, nq) and momenta (N, nv) at the nodes.
        work: since the start [J], (N, 4), columns as in contactvi.records.work.WORKS.
        reactions: mean forces of the constraints since the node before, (N, rows).
        still: contacts of what lies still: the rows, and the other fields of a contactvi.records.still.Span.
        dense: one row per dense step, columns as in contactvi.records.dense_steps.
        kept_steps: those with persistent contacts, with record="gradient".
        forced: of single steps, whether some input was not zero.
        error: what a callback or a function of the user raised.
    """

    t: Array
    q: Array
    p: Array
    work: Array
    reactions: Array | None
    events: Columns | None
    contacts: Columns | None
    still: list[tuple[_core.StillRows, int, int, float, float, float]] | None
    changes: Columns | None
    phases: Columns | None
    dense: Columns | None
    segments: Columns | None
    adaptive_steps: Columns | None
    kept_steps: _core.KeptContactSteps | None
    stats: EngineCounts
    forced: bool
    error: BaseException | None
