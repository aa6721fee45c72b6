"""How long the arrows of forces and impulses are, and where those of one time end: a picture shows them whole."""

from __future__ import annotations

import numpy as np

from contactvi.playback.animation import Array, Frames
from contactvi.playback.contact_frames import ContactFrames
from contactvi.playback.event_list import HappeningList

ARROW_LENGTH = 0.4  # of the size of the bodies, for the full force and for the strongest impulse
LONGEST = 1.5  # of that: longer arrows of forces are cut, where their scale is not given
AFTERGLOW = 0.25  # [s] of viewing for which an impact is shown


def arrow_tips(
    contacts: ContactFrames | None,
    happened: HappeningList,
    start: float,
    moment: float,
    frames: Frames,
    size: float,
    force_scale: float | None,
) -> Array:
    """Return both ends of the arrows that a picture of one time shows [m], world frame, (n, 3).

    Where the scale is given an arrow may be of any length: as much of it counts as would be drawn without.

    Args:
        start: of the run [s]. moment: of the picture [s], from the start on.
        size: of the bodies [m].
        force_scale: [N/m]; None: the longest arrows are those of the full force.
    """
    full, ends = ARROW_LENGTH * size, [np.zeros((0, 3))]
    if contacts is not None:
        frame = int(np.argmin(np.abs(contacts.times - start - moment)))
        rows = slice(int(contacts.first[frame]), int(contacts.first[frame + 1]))
        strength = np.linalg.norm(contacts.force[rows], axis=1, keepdims=True)
        length = strength / force_scale if force_scale is not None else full * strength / contacts.full
        along = contacts.force[rows] / np.maximum(strength, 1e-300) * np.minimum(length, LONGEST * full)
        ends += [contacts.point[rows], contacts.point[rows] + along]
    span = float(frames.times[-1])
    time, strongest = happened.time - start, float(happened.impulse.max(initial=0.0))
    shown = happened.drawn & (time <= moment + 1e-9) & (time > moment - min(AFTERGLOW, span / 12.0) - 1e-9)
    share = happened.impulse[shown, None] / max(strongest, 1e-300)
    ends += [happened.point[shown], happened.point[shown] + full * share * happened.direction[shown]]
    return np.concatenate(ends)
