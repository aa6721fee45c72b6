"""Contacts of a run that stick although their friction is at its limit: more force on one side makes them slip.

The derivative of the run there is that of sticking. On the other side it is another one, of which nothing in the steps
tells: they are solved as if the contacts stuck, with room to spare.
"""

from __future__ import annotations

import numpy as np

from contactvi.records.codes import MODES, GuardKind
from contactvi.records.contacts import ContactLog
from contactvi.scene.scene import Scene
from contactvi.trajectory.tables import friction_ratio

# Part of the limit that counts as all of it: forces of contacts are solved to 1e-12 of themselves, in sums of some
# hundred of them.
_AT_LIMIT = 1e-10


def held_at_limits(scene: Scene, log: ContactLog, stop: float) -> list[tuple[float, tuple[str, str]]]:
    """Return (time, pair) of the first step in which each such pair sticks at its limit with all of its points.

    It does so in the next step, too: where friction comes to its limit and the contact slips from then on, the run
    has found the event and its derivative.

    Args:
        stop: time of the end of the run [s].
    """
    ratio = friction_ratio(scene, log)
    rows = np.flatnonzero(np.isfinite(ratio))
    if not len(rows):
        return []
    steps, group = np.unique(
        np.column_stack([log.array("index")[rows], log.t[rows]]), axis=0, return_inverse=True
    )  # fmt: skip
    group = group.reshape(-1)
    normal = np.bincount(group, log.normal_impulse[rows])
    used = np.bincount(group, ratio[rows] * log.normal_impulse[rows]) / normal
    sticks = np.bincount(group, log.array("mode")[rows] != MODES.index("stick")) == 0
    end = np.zeros(len(steps))
    np.maximum.at(end, group, (log.t + log.h)[rows])
    same = np.append(steps[1:, 0] == steps[:-1, 0], False)
    goes_on = np.where(same, np.append(sticks[1:], False), end >= stop)
    found = np.flatnonzero(sticks & goes_on & (used >= 1.0 - _AT_LIMIT))
    _, first = np.unique(steps[found, 0], return_index=True)
    return [(float(steps[k, 1]), log.label(int(GuardKind.CONTACT), int(steps[k, 0]))) for k in found[first]]
