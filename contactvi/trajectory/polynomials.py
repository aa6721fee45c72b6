"""The polynomials of the steps of a run: states between the nodes, samples, and frames for pictures.

A segment is one solved step, or the part of one between two impacts. Its polynomial goes through the Gauss stages and
meets the velocities at both ends (core/step/path.hpp). It is accurate to O(h^(s+2)) in q with s = order / 2 stages, and
exact at the ends. In long steps of high order it is much less accurate than the nodes are; states that are asked for
one by one are therefore found by a step that ends there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactvi.scene.engine import engine_states

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]

# name -> axis after that of the segments: "q", "v" sizes of configuration and velocity, "sv" of all stages
FIELDS: dict[str, tuple[str, ...]] = {
    "t": (),  # start [s]
    "h": (),  # length [s]
    "q": ("q",),  # start
    "p": ("v",),  # momentum at the start, in the engine's coordinates
    "p1": ("v",),  # momentum at the end, before an impact there, in the engine's coordinates
    "rates": ("sv",),  # chart rates at the stages, one after the other, in the engine's coordinates
    "persistent": (),  # 1: a contact step or a dense one, of order 2; 2: a smooth step that holds contacts; 0: neither
}
CONTACT_STEP = 1.0
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
        tol: to which the stage equations of the steps are solved, and those of the partial steps to states in between.
    """

    def __init__(self, arrays: Mapping[str, NDArray[Any]], order: int, tol: float) -> None:
        self.arrays = {name: np.ascontiguousarray(arrays[name], dtype=float) for name in FIELDS}
        self.order, self.tol = order, tol

    def __len__(self) -> int:
        return len(self.arrays["t"])

    def states(self, core: _core.Scene, times: Array, exact: bool = False) -> tuple[Array, Array]:
        """Return q (N, nq) and v (N, nv) at times [s], at an impact those after it.

        Args:
            core: the engine's scene.
            exact: find them by partial steps, which are as accurate as the nodes, where the polynomials leave out more
                than `tol`. Runs with inputs cannot have that, because segments do not keep inputs. Steps with
                persistent contacts always give their polynomial, because segments do not keep the equations of these
                steps either.
        """
        times = np.ascontiguousarray(times, dtype=float)
        return engine_states(core, self.arrays, times, self.order, self.tol, exact)

    def exact_momenta(self, core: _core.Scene, times: Array) -> tuple[Array, Array]:
        """Return q (N, nq) and p (N, nv) at times [s], exact as those of `states`."""
        times = np.ascontiguousarray(times, dtype=float)
        return engine_states(core, self.arrays, times, self.order, self.tol, exact=True, momenta=True)


def joined(parts: Sequence[Mapping[str, NDArray[Any]]], order: int, tol: float) -> Segments | None:
    """Return the segments of consecutive parts of a run; None where there are none."""
    parts = [part for part in parts if len(part["t"])]
    if not parts:
        return None
    if len(parts) == 1:
        return Segments(parts[0], order, tol)
    return Segments({name: np.concatenate([part[name] for part in parts]) for name in FIELDS}, order, tol)


def sample_times(start: float, end: float, step: float) -> Array:
    """Return start, start + step, ... and end [s]; a last step shorter than rounding is left out."""
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
