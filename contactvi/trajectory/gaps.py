"""The gaps of a run over time, of the pairs that touched."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


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
