"""The gaps of a run over time, of the pairs that touched."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from contactvi.records.codes import GuardKind
from contactvi.records.contacts import ContactLog
from contactvi.records.events import EventLog

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]
MOST_TIMES = 2000


class Run(Protocol):
    """What the gaps are found of; contactvi.Trajectory has it."""

    t: Array
    q: Array
    events: EventLog
    contacts: ContactLog

    @property
    def frames(self) -> tuple[Array, Array]: ...


class Gaps(NamedTuple):
    """Signed distances of the pairs that touched in a run; it unpacks as `t, pairs, gap = traj.gaps`.

    Attributes:
        t: times [s], (M,).
        pairs: names of the two shapes of each pair, in the order of the columns.
        gap: signed distance [m], (M, len(pairs)); negative in penetration, never NaN.
    """

    t: NDArray[np.float64]
    pairs: list[tuple[str, str]]
    gap: NDArray[np.float64]


def gaps_along(run: Run, engine: Callable[[], _core.Scene]) -> Gaps:
    """Return the gaps of a run at not more than MOST_TIMES of its nodes, its frames and its impacts.

    Args:
        engine: returns the engine's scene, which is asked for where something touched.
    """
    logs = (run.events, run.contacts)
    index = np.unique(np.concatenate([log.array("index")[log.array("kind") == GuardKind.CONTACT] for log in logs]))
    t, q = run.t, run.q
    if len(run.frames[0]):
        t = np.concatenate([t, run.frames[0], run.events.array("time")])
        t, first = np.unique(t, return_index=True)
        q = np.concatenate([q, run.frames[1], run.events.array("q")])[first]
    chosen = np.unique(np.linspace(0, len(t) - 1, min(len(t), MOST_TIMES)).round().astype(int))
    values = np.zeros((len(chosen), len(index)))
    if len(index):
        values = engine().gaps_along(np.ascontiguousarray(q[chosen]), index.astype(np.int64))
    return Gaps(t[chosen], [run.events.label(0, int(i)) for i in index], values)
