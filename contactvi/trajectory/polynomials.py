"""The polynomials of the steps of a run: states between the nodes, samples, and frames for pictures.

A segment is one solved step, or the part of one between two impacts. Its polynomial goes through the Gauss stages and
meets the velocities at both ends (core/step/path.hpp). It is accurate to O(h^(s+2)) in q with s = order / 2 stages, and
exact at the ends. In long steps of high order it is much less accurate than the nodes are; states that are asked for
one by one are therefore found by a step that ends there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactvi.scene.engine import engine_states, static_trees
from contactvi.text import fields_shown

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

    __repr__ = fields_shown


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

    @property
    def steps(self) -> list[Mapping[str, Array]]:
        """The steps of the bodies that are advanced together: {"t", "h", "persistent"} of each such group of them."""
        return [self.arrays]

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


class SegmentsApart:
    """The segments of a run in which groups of bodies are advanced apart from each other.

    Attributes:
        parts: the static trees of each group, by number, and its segments, in its own numbers.
    """

    def __init__(self, parts: Sequence[tuple[tuple[int, ...], Segments]]) -> None:
        self.parts = list(parts)
        self._scenes: tuple[_core.Scene, list[_core.ScenePart]] | None = (
            None  # of the parts, and what they are parts of
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle keeps: the parts."""
        return SegmentsApart, (self.parts,)

    def __len__(self) -> int:
        return sum(len(segments) for _, segments in self.parts)

    @property
    def steps(self) -> list[Mapping[str, Array]]:
        """As those of `Segments`."""
        return [segments.arrays for _, segments in self.parts]

    def states(self, core: _core.Scene, times: Array, exact: bool = False) -> tuple[Array, Array]:
        """As that of `Segments`."""
        return self._of_all(core, times, lambda segments, scene: segments.states(scene, times, exact))

    def exact_momenta(self, core: _core.Scene, times: Array) -> tuple[Array, Array]:
        """As that of `Segments`."""
        return self._of_all(core, times, lambda segments, scene: segments.exact_momenta(scene, times))

    def _of_all(
        self, core: _core.Scene, times: Array, find: Callable[[Segments, _core.Scene], tuple[Array, Array]]
    ) -> tuple[Array, Array]:
        q, v = np.zeros((len(times), core.nq)), np.zeros((len(times), core.nv))
        for part, (_, segments) in zip(self._scenes_of(core), self.parts, strict=True):
            q[:, part.q], v[:, part.v] = find(segments, part.scene)
        return q, v

    def _scenes_of(self, core: _core.Scene) -> list[_core.ScenePart]:
        if self._scenes is not None and self._scenes[0] is core:
            return self._scenes[1]
        trees = static_trees(core)
        scenes = [trees.part(list(chosen)) for chosen, _ in self.parts]
        if not core.calls_functions:  # else they are not kept: functions may hold the run, which no collector would see
            self._scenes = core, scenes
        return scenes


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
