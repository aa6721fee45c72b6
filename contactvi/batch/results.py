"""The result of a batch of runs: arrays over the runs, statuses, errors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from contactvi.batch.blocks import Block
from contactvi.errors import ContactviError, InputError
from contactvi.html import html_fields, html_table
from contactvi.inputs import short
from contactvi.records.rows import Items, Places
from contactvi.records.table import Column, Table, Words
from contactvi.simulation.messages import REACHED
from contactvi.status import Status, StatusCode

if TYPE_CHECKING:
    import pandas

    from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]
_SHOWN = 6  # runs that ended early which a notebook shows


class BatchStatus(Items[Status]):
    """How the runs of a batch ended: a sequence of `Status`, without one object for each of them."""

    _word = "run"

    def __init__(self, codes: NDArray[np.int64], times: Array, messages: Mapping[int, str]) -> None:
        self.codes, self.times, self._messages = codes, times, messages

    def __len__(self) -> int:
        return len(self.codes)

    def __repr__(self) -> str:
        codes, counts = np.unique(self.codes, return_counts=True)
        words = ", ".join(f"{count} {StatusCode(int(code)).name}" for code, count in zip(codes, counts, strict=True))
        return f"<BatchStatus: {words or 'no runs'}>"

    def _item(self, i: int) -> Status:
        return Status(StatusCode(int(self.codes[i])), self._messages.get(i, REACHED), float(self.times[i]))


class Batch(ABC):
    """The runs of a batch, in the order of their starts: what they are in memory and in a file.

    Attributes:
        keep: "ends": t (runs,), q (runs, nq) and v (runs, nv) are those of the ends of the runs. "nodes" and "runs": at
            the nodes, t (runs, nodes), q (runs, nodes, nq), v (runs, nodes, nv), as those of `Trajectory`; after the
            end of a run that has fewer nodes than others they are NaN. A run that was refused has NaN everywhere.
        nodes: number of nodes of each run, (runs,).
        status: how each run ended, a sequence of `Status`; `ok` the same as an array of truth values (runs,).
        errors: index of the run -> the error that `simulate` would have raised.
        impacts, dense_steps: of each run, (runs,). seconds: inside the engine [s], (runs,); runs that are made side by
            side in one thread share the time that it takes.
        error_estimate: with dt="auto" as `Trajectory.error_estimate`, else NaN, (runs,).
        q0, v0: the starts that were given, (runs, nq) and (runs, nv); None where they were not.
        parameters: their values that were given, by name, (runs, ...).
    """

    keep: str
    t: Array
    q: Array
    v: Array
    nodes: NDArray[np.int64]
    impacts: NDArray[np.int64]
    dense_steps: NDArray[np.int64]
    seconds: Array
    error_estimate: Array
    status: BatchStatus
    errors: dict[int, ContactviError]
    q0: Array | None
    v0: Array | None
    parameters: dict[str, Array]

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Whether each run reached its end, (runs,)."""
        return np.asarray(self.status.codes == StatusCode.SUCCESS)

    @property
    def table(self) -> Table:
        """A row for each run: how and when it ended, what it cost, and its parameters, by components."""
        codes = sorted(StatusCode)
        places = np.searchsorted([int(code) for code in codes], self.status.codes)
        columns: dict[str, Column] = {
            "run": np.arange(len(self)), "status": Words(places, tuple(code.name for code in codes)),
            "t": self.status.times, "impacts": self.impacts, "dense_steps": self.dense_steps, "nodes": self.nodes,
            "seconds": self.seconds, "error_estimate": self.error_estimate,
        }  # fmt: skip
        for name, values in self.parameters.items():
            rows = values.reshape(len(self), -1)
            names = [name] if rows.shape[1] == 1 else [f"{name}[{k}]" for k in range(rows.shape[1])]
            columns |= dict(zip(names, rows.T, strict=True))
        return Table("runs", columns, {"t": "s", "seconds": "s"})

    def to_pandas(self) -> pandas.DataFrame:
        """Return `table` as a DataFrame, with the number of the run as index, needs `pip install "contactvi[pandas]"`.

        Raises:
            ContactviError: pandas is not installed.
        """
        return self.table.to_pandas("run")

    def __len__(self) -> int:
        return len(self.nodes)

    def __iter__(self) -> Iterator[Trajectory]:
        return (self[k] for k in range(len(self)))

    @overload
    def __getitem__(self, k: int) -> Trajectory: ...
    @overload
    def __getitem__(self, k: slice | Sequence[int] | NDArray[Any]) -> BatchResult: ...
    @abstractmethod
    def __getitem__(self, k: int | slice | Sequence[int] | NDArray[Any]) -> Trajectory | BatchResult:
        """Return a run (with keep="runs"), or the result of some of the runs: a slice, indices, truth values.

        Raises:
            InputError: for one run where runs were not kept. IndexError: there is no such run. The error of the run,
                where nothing was computed.
        """

    @property
    @abstractmethod
    def block(self) -> Block:
        """The arrays as they are stored, of all runs."""

    def _where(self) -> str:
        return ""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {len(self)} runs, {int(self.ok.sum())} ok, keep={self.keep!r}{self._where()}>"

    def _repr_html_(self) -> str:
        """Return what a notebook shows: how the runs ended, and the first that did not reach their end."""
        ended = np.flatnonzero(~self.ok)
        fields = {
            "runs": f"{len(self)}, {int(self.ok.sum())} reached their end", "kept": self.keep,
            "nodes": _range(self.nodes), "impacts": _range(self.impacts), "dense steps": _range(self.dense_steps),
            "time of the engine": f"{float(self.seconds.sum()):.3g} s",
        }  # fmt: skip
        rows = [(str(k), self.status[int(k)].code.name, f"{self.status[int(k)].time:.6g}", self.status[int(k)].message)
                for k in ended[:_SHOWN]]  # fmt: skip
        more = f"and {len(ended) - _SHOWN} more" if len(ended) > _SHOWN else ""
        parts = [html_table("Ended early", ("run", "status", "t [s]", "reason"), rows, more)] if rows else []
        return html_fields("Batch of runs" + self._where(), fields, parts)


class BatchResult(Batch):
    """The runs of a batch in memory; see `Batch` for its attributes."""

    def __init__(self, keep: str, block: Block) -> None:
        self.keep, self._block = keep, block
        columns = block.columns
        ends = 0 if keep == "ends" else slice(None)
        self.t: Array = columns["t"][:, ends, 0]
        self.q: Array = columns["q"][:, ends]
        self.v: Array = columns["v"][:, ends]
        self.nodes: NDArray[np.int64] = columns["nodes"]
        self.impacts: NDArray[np.int64] = columns["impacts"]
        self.dense_steps: NDArray[np.int64] = columns["dense_steps"]
        self.seconds: Array = columns["seconds"]
        self.error_estimate: Array = columns["error_estimate"]
        self.status = BatchStatus(columns["code"], columns["time"], block.messages)
        self.errors: dict[int, ContactviError] = dict(sorted(block.errors.items()))
        self.q0: Array | None = block.given.get("q0")
        self.v0: Array | None = block.given.get("v0")
        self.parameters: dict[str, Array] = {
            name: values for name, values in block.given.items() if name not in ("q0", "v0")
        }

    def __reduce__(self) -> tuple[Any, ...]:
        return BatchResult, (self.keep, self._block)

    @overload
    def __getitem__(self, k: int) -> Trajectory: ...
    @overload
    def __getitem__(self, k: slice | Sequence[int] | NDArray[Any]) -> BatchResult: ...
    def __getitem__(self, k: int | slice | Sequence[int] | NDArray[Any]) -> Trajectory | BatchResult:
        """Return a run (with keep="runs"), or the result of some of the runs: a slice, indices, truth values.

        Raises:
            InputError: for one run where runs were not kept. IndexError: there is no such run. The error of the run,
                where nothing was computed.
        """
        if not isinstance(k, (int, np.integer)):
            return BatchResult(self.keep, self._block.rows([int(i) for i in np.arange(len(self))[k]]))
        row = Places(len(self), "Run")[int(k)]
        if self._block.trajectories is None:
            raise not_kept(self.keep, k)
        traj = self._block.trajectories[row]()
        if traj is None:
            raise self.errors[row]
        return traj

    @property
    def block(self) -> Block:
        """The arrays as they are stored."""
        return self._block


def not_kept(keep: str, k: Any) -> InputError:
    """Return the error of a run that was not kept as a whole."""
    return InputError(
        "The runs of this batch were not kept", name="keep", expected="'runs'", got=repr(keep),
        remedy=f"Give keep='runs' to simulate_batch, or take result.q[{short(k)}]",
    )  # fmt: skip


def _range(counts: NDArray[np.int64]) -> str:
    low, high = (int(counts.min()), int(counts.max())) if len(counts) else (0, 0)
    return str(low) if low == high else f"{low} to {high}"
