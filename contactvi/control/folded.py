"""Batches of runs for libraries that add leading dimensions to the arrays of a function that they map over."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.batch.shapes import Batch
from contactvi.control.rollouts import Rollouts, rollouts_of
from contactvi.trajectory.compiled import CompiledScene

if TYPE_CHECKING:
    from contactvi.scene.scene import Scene

Array = NDArray[np.float64]
Shape = tuple[int, ...]


@dataclass(frozen=True)
class FoldedRollouts:
    """The states of a batch of runs as a function of arrays that may have further leading dimensions.

    These are those of NumPy's broadcasting; all runs are made by one call. It is equal to another one that has the same
    attributes.

    Attributes:
        compiled: the scene as it was.
        names: of the inputs. single, full: their shapes, as in contactvi.batch.shapes.
        runs: number of runs of the batch. steps: of every run.
        workers, on_kink: as for Rollouts. settings: (name, value) of dt and the options.
    """

    compiled: CompiledScene
    names: tuple[str, ...]
    single: tuple[Shape, ...]
    full: tuple[Shape, ...]
    runs: int
    steps: int
    workers: int | None
    on_kink: str
    settings: tuple[tuple[str, Any], ...]

    @classmethod
    def of(
        cls, compiled: CompiledScene, batch: Batch, workers: int | None, on_kink: str, settings: dict[str, Any]
    ) -> FoldedRollouts:
        """Return the function of a batch."""
        single, full = tuple(batch.single.values()), tuple(batch.full.values())
        return cls(
            compiled, tuple(batch.full), single, full, batch.runs, batch.steps, workers, on_kink,
            tuple(sorted(settings.items())),
        )  # fmt: skip

    @property
    def shapes(self) -> tuple[Shape, Shape]:
        """The shapes of q and v at the nodes of all runs, without further dimensions."""
        states = self.compiled.states
        return (self.runs, self.steps + 1, states.nq), (self.runs, self.steps + 1, states.nv)

    def states(self, *arrays: ArrayLike) -> tuple[Array, Array]:
        """Return q and v of all runs at their nodes."""
        values = [np.asarray(array) for array in arrays]
        outer = self._outer(values)
        made = self._made(values, outer)
        return made.q.reshape(outer + self.shapes[0]), made.v.reshape(outer + self.shapes[1])

    def gradients(self, names: tuple[str, ...], gq: ArrayLike, gv: ArrayLike, *arrays: ArrayLike) -> tuple[Array, ...]:
        """Return the gradients in inputs from those at the nodes; the runs are made again, each of them once."""
        values, ends = [np.asarray(array) for array in arrays], [np.asarray(gq), np.asarray(gv)]
        own = self._outer(values)
        made = self._made(values, own)
        outer = np.broadcast_shapes(own, *(end.shape[:-3] for end in ends))
        lq, lv = (np.broadcast_to(end, outer + shape) for end, shape in zip(ends, self.shapes, strict=True))
        numbers = np.arange(made.batch.runs).reshape(*own, self.runs)
        of = np.broadcast_to(numbers, (*outer, self.runs)).ravel()
        rows = made.gradients(lq.reshape(-1, *lq.shape[-2:]), lv.reshape(-1, *lv.shape[-2:]), names, of)
        return tuple(self._gathered(name, rows[name], outer) for name in names)

    def _gathered(self, name: str, rows: Array, outer: Shape) -> Array:
        k = self.names.index(name)
        found = rows.reshape(*outer, self.runs, *self.single[k])
        return found.sum(axis=len(outer)) if self._shared(k) else found

    def _shared(self, k: int) -> bool:
        """Return whether an input is the same in all runs of the batch."""
        return self.full[k] == self.single[k]

    def _outer(self, values: list[Array]) -> Shape:
        """Return the leading dimensions that the arrays have besides those of the batch."""
        own = [value.shape[: value.ndim - len(full)] for value, full in zip(values, self.full, strict=True)]
        return np.broadcast_shapes(*own)

    def _made(self, values: list[Array], outer: Shape) -> Rollouts:
        inputs = {name: self._unfolded(k, values[k], outer) for k, name in enumerate(self.names)}
        return rollouts_of(self._scene, inputs, self.steps, self.workers, self.on_kink, dict(self.settings))

    def _unfolded(self, k: int, value: Array, outer: Shape) -> Array:
        """Return an input for all runs, a parameter that is one for all of them without leading dimension."""
        single = self.single[k]
        if not self._shared(k):
            return np.broadcast_to(value, outer + self.full[k]).reshape(-1, *single)
        if value.size == np.prod(single):
            return value.reshape(single)
        return np.repeat(np.broadcast_to(value, outer + single).reshape(-1, *single), self.runs, axis=0)

    @cached_property
    def _scene(self) -> Scene:
        return self.compiled.scene()


@dataclass(frozen=True)
class FoldedGradients:
    """The gradients of a `FoldedRollouts` in some of its inputs, as a function that is equal to others of these."""

    rollouts: FoldedRollouts
    names: tuple[str, ...]

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Their shapes, without further dimensions."""
        full = dict(zip(self.rollouts.names, self.rollouts.full, strict=True))
        return tuple(full[name] for name in self.names)

    def __call__(self, gq: ArrayLike, gv: ArrayLike, *arrays: ArrayLike) -> tuple[Array, ...]:
        """Return them from gradients at the nodes."""
        return self.rollouts.gradients(self.names, gq, gv, *arrays)
