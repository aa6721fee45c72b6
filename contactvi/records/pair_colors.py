"""One colour for each pair that touched in a run, the same in all plots and pictures."""

from __future__ import annotations

import numpy as np

from contactvi.records.codes import GuardKind
from contactvi.records.contacts import ContactLog
from contactvi.records.events import EventLog

# Told apart on white, on grey and on each other, the first ones the best; none is the red of impacts.
PAIR_COLORS = (
    "#1e4fbf", "#e67e00", "#17853f", "#8a3fb5", "#00a0b4", "#8c5a2b", "#d6409f", "#6b7280", "#9aa80a", "#4b2e83",
)  # fmt: skip


def pair_colors(events: EventLog, contacts: ContactLog) -> dict[tuple[str, str], str]:
    """Return the colours #rrggbb of the pairs of shapes that touched, by their names.

    They go by impulse, the strongest pair first; of more than twenty pairs some have the same colour.
    """
    size: dict[int, float] = {}
    for log, impulse in ((contacts, np.abs(contacts.normal_impulse)), (events, np.zeros(len(events)))):
        rows = log.array("kind") == GuardKind.CONTACT
        touching, place = np.unique(log.array("index")[rows], return_inverse=True)
        for pair, total in zip(touching.tolist(), np.bincount(place.reshape(-1), impulse[rows]), strict=True):
            size[pair] = size.get(pair, 0.0) + float(total)
    order = sorted(size, key=lambda pair: (-size[pair], pair))
    return {events.label(int(GuardKind.CONTACT), pair): pair_color(k) for k, pair in enumerate(order)}


def pair_color(k: int) -> str:
    """Return the colour #rrggbb of the k-th pair: ten colours, then the same ones darker, then again."""
    color = PAIR_COLORS[k % len(PAIR_COLORS)]
    if k // len(PAIR_COLORS) % 2 == 0:
        return color
    return "#" + "".join(f"{int(color[i : i + 2], 16) * 11 // 20:02x}" for i in (1, 3, 5))
