"""What happens in a run, as one list in the order of time: impacts, and changes of persistent contacts.

Points of one pair that change at one time in the same way are one entry. Run time, world frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from contactvi.playback.animation import Array, drawn_side
from contactvi.records.codes import Change, GuardKind
from contactvi.records.contacts import ChangeLog
from contactvi.records.events import EventLog
from contactvi.scene.scene import Scene

Indices = NDArray[np.int64]

# The kinds of entries, each at the place of its number.
KINDS = ("impact", "limit", "begin", "release", "stick", "slip", "zeno", "inconsistent", "overlap")
_OF_CHANGE = {
    Change.BEGIN: "begin", Change.RELEASE: "release", Change.STICK: "stick", Change.SLIP: "slip",
    Change.BOUNCING_ENDED: "zeno", Change.INCONSISTENT: "inconsistent",
    Change.OVERLAP: "overlap",
}  # fmt: skip
MAX_IMPACTS = 10_000  # listed of a run, the strongest ones; 80 bytes each: 0.8 MB of the page
MAX_CHANGES = 10_000  # spread over the run


class Happened(Protocol):
    """The part of a run in which things happen."""

    @property
    def scene(self) -> Scene: ...

    @property
    def events(self) -> EventLog: ...

    @property
    def contact_changes(self) -> ChangeLog: ...


@dataclass(frozen=True)
class HappeningList:
    """Entries in the order of time, (n,) each.

    Attributes:
        time: [s].
        kind: place in KINDS.
        name: place in `names`.
        count: of contact points, at least 1.
        impulse: of an impact [N s; N m s], else 0; before, after: its normal speeds [m/s; rad/s].
        point, direction: of the impact of a pair, (n, 3), the latter of the impulse on the body that can move more
            freely; zero of the others.
        drawn: whether it has a point.
        names: pairs of names.
        left_out: how many there were beside them.
    """

    time: Array
    kind: Indices
    name: Indices
    count: Indices
    impulse: Array
    before: Array
    after: Array
    point: Array
    direction: Array
    drawn: NDArray[np.bool_]
    names: list[tuple[str, str]]
    left_out: int

    def __len__(self) -> int:
        return len(self.time)


def happenings(run: Happened) -> HappeningList:
    """Return what happens in a run: at most MAX_IMPACTS impacts and MAX_CHANGES changes."""
    impacts, changes = _impacts(run), _changes(run)
    left_out = len(run.events) - len(impacts["time"]) + changes.pop("left_out")
    keys = np.concatenate([impacts.pop("key"), changes.pop("key")])
    unique, name = np.unique(keys, axis=0, return_inverse=True)
    names = [run.events.label(int(kind), int(index)) for kind, index in unique]
    joined = {field: np.concatenate([impacts[field], changes[field]]) for field in impacts}
    order = np.argsort(joined["time"], kind="stable")
    return HappeningList(
        name=name.reshape(-1)[order], names=names, left_out=left_out,
        **{field: values[order] for field, values in joined.items()},
    )  # fmt: skip


def _impacts(run: Happened) -> dict[str, Any]:
    events = run.events
    impulse = events.array("impulse")
    rows = np.sort(np.argsort(-impulse, kind="stable")[:MAX_IMPACTS])
    kind, index = events.array("kind")[rows], events.array("index")[rows]
    point, normal = events.array("point")[rows], events.array("normal")[rows]
    drawn = (kind == GuardKind.CONTACT) & np.isfinite(point).all(axis=1) & np.isfinite(normal).all(axis=1)
    sides = {int(k): drawn_side(run.scene, int(k)) for k in np.unique(index[drawn])}
    side = np.array([sides.get(int(k), 1.0) for k in index]).reshape(-1, 1)
    return {
        "time": events.array("time")[rows],
        "kind": np.where(kind == GuardKind.CONTACT, KINDS.index("impact"), KINDS.index("limit")),
        "key": np.column_stack([kind, index]).astype(np.int64).reshape(-1, 2),
        "count": np.maximum(events.array("points")[rows], 1).astype(np.int64),
        "impulse": impulse[rows],
        "before": events.array("gamma_minus")[rows],
        "after": events.array("gamma_plus")[rows],
        "point": np.where(drawn[:, None], point, 0.0),
        "direction": np.where(drawn[:, None], side * normal, 0.0),
        "drawn": drawn,
    }


def _changes(run: Happened) -> dict[str, Any]:
    log = run.contact_changes
    # All points of a pair that begin to slide in one step are one thing that happens.
    columns = [log.array(name).astype(float) for name in ("time", "kind", "index", "change")]
    groups, count = np.unique(np.column_stack(columns), axis=0, return_counts=True)
    rows = np.unique(np.linspace(0, len(groups) - 1, min(len(groups), MAX_CHANGES)).astype(np.int64))
    chosen = groups[rows]
    numbers = np.array([KINDS.index(_OF_CHANGE[change]) for change in Change], dtype=np.int64)
    n = len(rows)
    return {
        "time": chosen[:, 0],
        "kind": numbers[chosen[:, 3].astype(np.int64)],
        "key": chosen[:, 1:3].astype(np.int64),
        "count": count[rows].astype(np.int64),
        "impulse": np.zeros(n), "before": np.zeros(n), "after": np.zeros(n),
        "point": np.zeros((n, 3)), "direction": np.zeros((n, 3)), "drawn": np.zeros(n, bool),
        "left_out": len(groups) - n,
    }  # fmt: skip
