"""What the tests of the batteries share: a table of the runs, and trajectories that are wrong on purpose."""

from __future__ import annotations

import itertools
from collections import Counter
from typing import Any

import numpy as np

import contactvi as cvi
from batteries.runner import Report
from contactvi.records.contacts import ContactLog


def table(reports: dict[str, list[Report]]) -> str:
    """Runs, impacts, contact steps, seconds and statuses of each family and of all."""
    rows = [f"{'family':8}{'runs':>6}{'impacts':>10}{'contact steps':>15}{'seconds':>9}  statuses"]
    for family, these in [*reports.items(), ("all", list(itertools.chain(*reports.values())))]:
        sums = [sum(getattr(r, name) for r in these) for name in ("impacts", "contact_steps", "seconds")]
        statuses = ", ".join(f"{n} {status}" for status, n in Counter(r.status for r in these).most_common())
        rows.append(f"{family:8}{len(these):6}{sums[0]:10}{sums[1]:12}{sums[2]:9.1f}  {statuses}")
    return "\n".join(rows)


class Altered:
    """A trajectory of which some things were changed."""

    def __init__(self, traj: cvi.Trajectory, **changes: Any) -> None:
        self._traj, self._changes = traj, changes

    def __getattr__(self, name: str) -> Any:
        return self._changes[name] if name in self._changes else getattr(self._traj, name)


def altered_rows(traj: cvi.Trajectory, name: str, change: Any) -> Altered:
    """Contact rows with one field changed, in the row of a persistent contact with the largest impulse."""
    arrays = {key: values.copy() for key, values in traj.contacts.arrays.items()}
    row = int(np.argmax(np.where(traj.contacts.h > 0.0, np.abs(arrays["end"][:, 2]), 0.0)))
    arrays[name][row] = change(arrays[name][row])
    return Altered(traj, contacts=ContactLog(arrays, traj.scene.pair_names, []))
