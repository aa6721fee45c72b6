"""The inputs of a run, kept where its derivatives are wanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


# The numbers of contactvi._core.KeptContactSteps, as files name them. What laws of contact need is apart from the
# steps: files of older versions lack it.
STORED = ("contact_steps", "impact_blocks", "dense_steps", "held_steps", "contact_laws", "held_laws")


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
        earlier: those of earlier calls, read from a file or a pickle: the numbers of `STORED`, one dimension each;
            empty where `contact_steps` holds all.
    """

    control: Array | None
    target: Array | None
    saturated: int = 0
    contact_steps: tuple[Any, ...] = ()
    earlier: tuple[Array, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle and deepcopy keep: contact steps as numbers, which the engine reads again."""
        kept = self.stored()
        return RunInputs, (self.control, self.target, self.saturated, (), tuple(kept[name] for name in STORED))

    def stored(self) -> dict[str, NDArray[Any]]:
        """Return what a file keeps of them, by name."""
        found: dict[str, NDArray[Any]] = {"saturated": np.array(self.saturated, dtype=np.int64)}
        found.update(zip(STORED, _numbers(self.earlier, self.contact_steps), strict=True))
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
        self._earlier: tuple[Array, ...] = ()  # of a pickle, as numbers

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
        return RunInputs(control, target, self.saturated, tuple(self._contact_steps), self._earlier)


def _joined(counts: Sequence[int], parts: Sequence[Array | None]) -> Array | None:
    width = next((part.shape[1] for part in parts if part is not None), None)
    if width is None:
        return None
    return np.concatenate(
        [np.zeros((steps, width)) if part is None else np.asarray(part, dtype=float)[:steps]
         for steps, part in zip(counts, parts, strict=True)]
    )  # fmt: skip


def _numbers(earlier: tuple[Array, ...], calls: Sequence[Any]) -> tuple[Array, ...]:
    """Return all kinds of `STORED` as numbers: those given so, then those of the calls."""
    all_calls = [*([earlier] if earlier else []), *(kept.numbers() for kept in calls)]
    return tuple(np.concatenate([np.zeros(0), *(call[k] for call in all_calls)]) for k in range(len(STORED)))
