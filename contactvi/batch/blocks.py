"""The results of some runs of a batch, one after the other, as arrays."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import ContactviError
from contactvi.status import Status, StatusCode
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]

PADDED = ("t", "q", "v")  # rows of nodes
COUNTS = ("nodes", "code", "impacts", "dense_steps")
TIMES = ("time", "seconds", "error_estimate")
COLUMNS = (*PADDED, *COUNTS, *TIMES)


class KeptRun:
    """A run of a batch, made from the engine's arrays when it is first asked for; the engine gives these only once."""

    def __init__(self, make: Callable[[], Trajectory | None]) -> None:
        self._make: Callable[[], Trajectory | None] | None = make
        self._run: Trajectory | None = None
        self._lock = threading.Lock()

    def __call__(self) -> Trajectory | None:
        """Return the run, None where there is none; the same object each time."""
        with self._lock:
            if self._make is not None:
                self._run, self._make = self._make(), None
            return self._run

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle and deepcopy keep: the run instead of what makes it."""
        return _kept_run, (self(),)


def _kept_run(run: Trajectory | None) -> KeptRun:
    return KeptRun(lambda: run)


@dataclass(eq=False)
class Block:
    """Results of runs; rows belong to runs.

    Attributes:
        columns: by name, t (runs, nodes, 1), q (runs, nodes, nq), v (runs, nodes, nv), with NaN after the end of a run;
            the number of nodes, the code and time of the status, impacts, dense steps, seconds, the error estimate,
            each (runs,).
        messages: of the statuses that are not SUCCESS, by run.
        errors: by run.
        trajectories: the runs, where they are kept.
        given: starts and parameters that were given, by name: "q0", "v0" and names of parameters, (runs, ...).
    """

    columns: dict[str, NDArray[Any]]
    messages: dict[int, str] = field(default_factory=dict)
    errors: dict[int, ContactviError] = field(default_factory=dict)
    trajectories: list[KeptRun] | None = None
    given: dict[str, Array] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.columns["code"])

    def states(self, k: int) -> tuple[Array, Array, Array]:
        """Return t (N,), q (N, nq) and v (N, nv) of a run."""
        nodes = int(self.columns["nodes"][k])
        t, q, v = (self.columns[name][k, :nodes] for name in PADDED)
        return t[:, 0], q, v

    def fail(self, k: int, error: ContactviError, status: Status) -> None:
        """Enter the error and the status of a run that ended before its time."""
        self.errors[k], self.messages[k] = error, status.message
        self.columns["code"][k], self.columns["time"][k] = status.code, status.time

    def refuse(self, k: int, error: ContactviError) -> None:
        """Enter a run whose inputs cannot be used."""
        self.fail(k, error, Status(StatusCode.REFUSED, error.what, 0.0))

    def rows(self, chosen: Sequence[int]) -> Block:
        """Return some of the runs, in this order."""
        place = {k: row for row, k in enumerate(chosen)}
        return replace(
            self,
            columns={name: values[np.asarray(chosen, dtype=int)] for name, values in self.columns.items()},
            messages={place[k]: text for k, text in self.messages.items() if k in place},
            errors={place[k]: error for k, error in self.errors.items() if k in place},
            trajectories=None if self.trajectories is None else [self.trajectories[k] for k in chosen],
            given={name: values[np.asarray(chosen, dtype=int)] for name, values in self.given.items()},
        )


def joined(blocks: Sequence[Block]) -> Block:
    """Return blocks one after the other."""
    if len(blocks) == 1:
        return blocks[0]
    nodes = max(block.columns["t"].shape[1] for block in blocks)
    parts = [_padded(block.columns, nodes) for block in blocks]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in COLUMNS}
    messages: dict[int, str] = {}
    errors: dict[int, ContactviError] = {}
    trajectories: list[KeptRun] = []
    first = 0
    for block in blocks:
        messages |= {first + k: text for k, text in block.messages.items()}
        errors |= {first + k: error for k, error in block.errors.items()}
        trajectories += block.trajectories or []
        first += len(block)
    kept = blocks[0].trajectories is not None
    given = {name: np.concatenate([block.given[name] for block in blocks]) for name in blocks[0].given}
    return Block(columns, messages, errors, trajectories if kept else None, given)


def _padded(columns: dict[str, NDArray[Any]], nodes: int) -> dict[str, NDArray[Any]]:
    return columns | {name: padded(columns[name], nodes) for name in PADDED}


def padded(states: NDArray[Any], nodes: int) -> NDArray[Any]:
    """Return states (runs, N, n) of so many nodes, NaN after the first N."""
    missing = nodes - states.shape[1]
    return np.pad(states, ((0, 0), (0, missing), (0, 0)), constant_values=np.nan) if missing else states
