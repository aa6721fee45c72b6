"""The polynomials of the steps of a run: states between the nodes, samples, and frames for pictures.

A segment is one solved step, or the part of one between two impacts. The engine evaluates its polynomial: through the
Gauss stages, raised so that it meets the velocities at both ends (core/step/path.hpp), it is accurate to O(h^(s+2))
in q with s = order / 2 stages; at the ends of segments it is the run itself. In long steps of high order that is much
less than at the nodes: what is asked for one by one is found by a step that ends there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.scene.engine import engine_states

Array = NDArray[np.float64]

# name -> axis after that of the segments: "q", "v" sizes of configuration and velocity, "sv" of all stages
FIELDS: dict[str, tuple[str, ...]] = {
    "t": (),  # start [s]
    "h": (),  # length [s]
    "q": ("q",),  # start
    "p": ("v",),  # momentum at the start, in the engine's coordinates
    "p1": ("v",),  # momentum at the end, before an impact there, in the engine's coordinates
    "rates": ("sv",),  # chart rates at the stages, one after the other, in the engine's coordinates
    "held": (),  # 1 where contacts were held: a midpoint step whatever the order
}
FRAME_DT = 1.0 / 60.0  # [s] between two frames of a picture
MAX_FRAMES = 6000


@dataclass(frozen=True, eq=False)
class State:
    """The state of a run at t [s]: q (nq,), v (nv,), p = M(q) v (nv,); for an array of n times with a first axis n."""

    t: Any
    q: Array
    v: Array
    p: Array


class Segments:
    """The segments of a run, in the order of time.

    Attributes:
        arrays: as in FIELDS, n segments along the first axis.
        order: of the integrator.
    """

    def __init__(self, arrays: Mapping[str, NDArray[Any]], order: int) -> None:
        arrays = {"held": np.zeros(len(arrays["t"])), **arrays}
        self.arrays = {name: np.ascontiguousarray(arrays[name], dtype=float) for name in FIELDS}
        self.order = order

    def __len__(self) -> int:
        return len(self.arrays["t"])

    def states(self, core: Any, times: Array, exact: bool = False) -> tuple[Array, Array]:
        """Return q (N, nq) and v (N, nv) at times [s], at an impact those after it. `core`: the engine's scene.

        Args:
            exact: by steps of the lengths in between, which start from the polynomials and are as accurate as the
                nodes; not of runs with inputs, which segments do not keep. Where contacts are held it is always the
                polynomial: the step is one of equations that segments do not keep either.
        """
        times = np.ascontiguousarray(times, dtype=float)
        held = self.held_at(times) if exact else np.ones(len(times), dtype=bool)
        if held.all() or not held.any():
            return engine_states(core, self.arrays, times, self.order, exact and not held.any())
        parts = [(chosen, engine_states(core, self.arrays, times[chosen], self.order, free))
                 for chosen, free in ((held, False), (~held, True))]  # fmt: skip
        q, v = (np.empty((len(times), parts[0][1][k].shape[1])) for k in (0, 1))
        for chosen, (part_q, part_v) in parts:
            q[chosen], v[chosen] = part_q, part_v
        return q, v

    def held_at(self, times: Array) -> NDArray[np.bool_]:
        """Return at which of these times [s] contacts were held, shape (N,)."""
        at = np.searchsorted(self.arrays["t"], times, side="right") - 1
        return np.asarray(self.arrays["held"][np.clip(at, 0, None)] != 0.0)


def joined(parts: Sequence[Mapping[str, NDArray[Any]]], order: int) -> Segments | None:
    """Return the segments of consecutive parts of a run; None where there are none."""
    parts = [part for part in parts if len(part["t"])]
    if not parts:
        return None
    if len(parts) == 1:
        return Segments(parts[0], order)
    whole = [Segments(part, order).arrays for part in parts]
    return Segments({name: np.concatenate([part[name] for part in whole]) for name in FIELDS}, order)


def sample_times(start: float, end: float, step: float) -> Array:
    """Return start, start + step, ... and end [s]; the last full step is left out where it all but meets the end."""
    count = int(np.floor((end - start) / step * (1.0 + 1e-12) + 1e-9))
    times: Array = start + step * np.arange(count + 1, dtype=np.float64)
    if end - times[-1] > 1e-9 * step:
        return np.append(times, end)
    times[-1] = end
    return times


def frame_times(t: Array) -> Array:
    """Return the times of frames between nodes t [s] further apart than FRAME_DT, none where all are closer."""
    if len(t) < 2 or not np.any(np.diff(t) > FRAME_DT):
        return np.zeros(0)
    count = min(MAX_FRAMES, int(np.ceil((t[-1] - t[0]) / FRAME_DT)) + 1)
    return np.asarray(np.linspace(t[0], t[-1], count))
