"""What a notebook shows of a run."""

from __future__ import annotations

from typing import Protocol

from contactvi.html import folded, html_fields
from contactvi.status import Stats, Status
from contactvi.trajectory import tables


class Run(tables.Run, Protocol):
    """What is shown; contactvi.Trajectory has it."""

    status: Status
    stats: Stats

    @property
    def stepping(self) -> str: ...


def run_html(traj: Run) -> str:
    """Return how a run went, and as folded tables its states and its last impacts."""
    status, energy = traj.status, traj.kinetic_energy + traj.potential_energy
    contacts = f"{len(traj.contacts)} rows of {len(traj.contacts.pairs)} pairs"
    fields: dict[str, object] = {
        "status": status.code.name if status.ok else str(status),
        "time": f"{traj.t[0]:.6g} to {traj.t[-1]:.6g} s, {len(traj.t)} nodes",
        "steps": traj.stepping,
        "impacts": f"{len(traj.events)} ({traj.events.method.upper()})",
        "contacts": f"{contacts}, {len(traj.contact_changes)} changes",
        "energy": f"{energy[0]:.6g} J at the start, {energy[-1]:.6g} J at the end",
        "time of the engine": f"{traj.stats.seconds:.3g} s",
    }
    folds = [folded("states", tables.table(traj, "states").html())]
    if len(traj.events):
        folds.append(folded("impacts", traj.events.html()))
    return html_fields("Trajectory", fields, folds)
