"""The inputs of a run, kept where its derivatives are wanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


# The kinds of steps and impacts of `RunInputs.contact_steps`, as files name their numbers.
STORED = ("contact_steps", "impact_blocks", "dense_steps", "held_steps")


@dataclass(frozen=True, eq=False)
class RunInputs:
    """What acted in the steps of a run, one row per step.

    Attributes:
        control: generalized forces, Pinocchio's coordinates, shape (steps, nv) [N, N m]; None where none were given.
        target: references of the servos, positions by dof and then velocities, shape (steps, 2 nv); None without.
        saturated: steps through whose actuators and ropes there are no derivatives: actuators at their limits in
            contact steps and dense steps, or at those of speed, and ropes with dampers that became taut.
        contact_steps: those with persistent contacts and dense ones, one contactvi._core.KeptContactSteps per call of
            the engine.
        stored_steps, stored_blocks, stored_dense, stored_held: those of earlier calls, read from a file or a pickle, as
            numbers, one dimension each: the contact steps, the impacts of several points, the dense steps, and the
            smooth steps with constraints; None where `contact_steps` holds all.
    """

    control: Array | None
    target: Array | None
    saturated: int = 0
    contact_steps: tuple[Any, ...] = ()
    stored_steps: Array | None = None
    stored_blocks: Array | None = None
    stored_dense: Array | None = None
    stored_held: Array | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle and deepcopy keep: contact steps as numbers, which the engine reads again."""
        kept = self.stored()
        return RunInputs, (self.control, self.target, self.saturated, (), *(kept[name] for name in STORED))

    def stored(self) -> dict[str, NDArray[Any]]:
        """Return what a file keeps of them, by name."""
        found: dict[str, NDArray[Any]] = {"saturated": np.array(self.saturated, dtype=np.int64)}
        earlier = (self.stored_steps, self.stored_blocks, self.stored_dense, self.stored_held)
        found.update(zip(STORED, _numbers(earlier, self.contact_steps), strict=True))
        for name, values in (("control", self.control), ("target", self.target)):
            if values is not None:
                found[name] = np.asarray(values, dtype=float)
        return found


class GrowingInputs:
    """The inputs of the calls of a run so far.

    Attributes:
        saturated: as in `RunInputs`.
    """

    def __init__(self) -> None:
        self.saturated = 0
        self._blocks: list[tuple[int, Array | None, Array | None]] = []
        self._contact_steps: list[Any] = []
        self._earlier: tuple[Array | None, ...] = (None,) * len(STORED)  # of a pickle, as numbers

    def __getstate__(self) -> dict[str, Any]:
        """Return what pickle keeps: contact steps as numbers."""
        return {**vars(self), "_contact_steps": [], "_earlier": _numbers(self._earlier, self._contact_steps)}

    def add(self, steps: int, control: Array | None, target: Array | None) -> None:
        """Take over the inputs of a call of so many steps."""
        self._blocks.append((steps, control, target))

    def add_contact_steps(self, steps: Any) -> None:
        """Take over the steps with persistent contacts of a call."""
        self._contact_steps.append(steps)

    def copy(self) -> GrowingInputs:
        """Return a copy, which grows on its own."""
        twin = GrowingInputs()
        twin._blocks, twin.saturated = list(self._blocks), self.saturated
        twin._contact_steps, twin._earlier = list(self._contact_steps), self._earlier
        return twin

    def joined(self) -> RunInputs:
        """Return the inputs of all calls; of calls without, zeros beside others."""
        counts = [steps for steps, _, _ in self._blocks]
        control, target = (
            _joined(counts, parts) for parts in ([b[1] for b in self._blocks], [b[2] for b in self._blocks])
        )
        return RunInputs(control, target, self.saturated, tuple(self._contact_steps), *self._earlier)


def _joined(counts: Sequence[int], parts: Sequence[Array | None]) -> Array | None:
    width = next((part.shape[1] for part in parts if part is not None), None)
    if width is None:
        return None
    return np.concatenate(
        [np.zeros((steps, width)) if part is None else np.asarray(part, dtype=float)[:steps]
         for steps, part in zip(counts, parts, strict=True)]
    )  # fmt: skip


def _numbers(earlier: Sequence[Array | None], calls: Sequence[Any]) -> tuple[Array, ...]:
    """Return all kinds of `STORED` as numbers: those given so, then those of the calls."""
    kinds: list[list[Array]] = [[] if numbers is None else [numbers] for numbers in earlier]
    for kept in calls:
        of_call = (kept.step_numbers(), kept.block_numbers(), kept.dense_numbers(), kept.held_numbers())
        for parts, numbers in zip(kinds, of_call, strict=True):
            parts.append(numbers)
    return tuple(np.concatenate(parts) if parts else np.zeros(0) for parts in kinds)
