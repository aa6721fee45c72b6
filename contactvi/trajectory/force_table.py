"""The table of contact forces at times of the caller's: one mean force for each pair and window.

A step of contact gives each window the part of its impulse that lies in it, in proportion to the time; an impact gives
all of it to the window that begins before it or at it. So force times length, summed over the windows, is the impulse
of the run, whatever the windows are.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contactvi.records.codes import GuardKind
from contactvi.records.contacts import ContactLog
from contactvi.records.table import Column, Table

Array = NDArray[np.float64]


class Run(Protocol):
    """What the table is made of; contactvi.Trajectory has it."""

    t: Array
    contacts: ContactLog


def force_table(run: Run, edges: Array | None = None) -> Table:
    """Return the forces of a run, a row per window; without contacts it has no rows.

    Args:
        edges: of the windows, increasing [s], (n + 1,); None: the nodes of the run.
    """
    log, edges = run.contacts, run.t if edges is None else edges
    if not len(log) or len(edges) < 2:
        return Table("forces", {"t": np.zeros(0), "h": np.zeros(0)}, {"t": "s", "h": "s"})
    columns: dict[str, Column] = {"t": edges[:-1], "h": np.diff(edges)}
    units = {"t": "s", "h": "s"}
    guards = np.stack([log.array("kind"), log.array("index")], axis=1)
    found, of_row = np.unique(guards, axis=0, return_inverse=True)
    order = np.argsort(of_row.reshape(-1), kind="stable")
    ends = np.cumsum(np.bincount(of_row.reshape(-1)))
    for (kind, index), rows in zip(found.tolist(), np.split(order, ends[:-1]), strict=True):
        name, limit = " | ".join(log.label(kind, index)), kind == GuardKind.LIMIT
        force = _impulses(log.t[rows], log.h[rows], log.impulse[rows], edges) / np.diff(edges)[:, None]
        axes = ("",) if limit else (".x", ".y", ".z")
        columns |= {name + axis: force[:, k] for k, axis in enumerate(axes)}
        units |= {name + axis: "N, N m" if limit else "N" for axis in axes}
    return Table("forces", columns, units)


def _impulses(t: Array, h: Array, impulse: Array, edges: Array) -> Array:
    """Return the impulses (n, 3) [N s] in the windows between `edges` (n + 1,), of rows (m,)."""
    end, last = t + h, len(edges) - 2
    first = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, last)
    final = np.where(h > 0.0, np.clip(np.searchsorted(edges, end, side="left") - 1, first, last), first)
    found = np.zeros((last + 1, 3))
    for ahead in range(int(np.max(final - first, initial=0)) + 1):
        chosen = np.flatnonzero(first + ahead <= final)
        window = first[chosen] + ahead
        within = np.minimum(end[chosen], edges[window + 1]) - np.maximum(t[chosen], edges[window])
        whole = first[chosen] == final[chosen]
        share = np.where(whole, 1.0, within / np.where(h[chosen] > 0.0, h[chosen], 1.0))
        np.add.at(found, window, share[:, None] * impulse[chosen])
    return found
