"""Dense steps of a run, which have all impacts inside of them without their times, and how exactly their law holds.

Columns, one row per dense step, shapes (n,):

- t, h: start and length [s]; step: index of the step of length dt that it belongs to (int64).
- island: the joint, by its number in the model, that is the first one of the island, which is the bodies that touch or
  may touch in the step and are advanced together (int64). Islands take their dense steps at the same time.
- residual: largest residual of Coulomb's law in the contact problems of the step, as a speed over the largest speed
  that a contact would have without impulses; 0 is exact. The gap by which a loaded contact is open at the end, over h,
  is such a speed.
- gap: least gap at the end of the step [m; rad]; below zero the shapes overlap.
- energy_loss: what the energy fell by, less the works of inputs, damping and joint friction [J]: what contacts took by
  restitution and friction. It is a difference of energies and so contains the error of the step; where it is below zero
  the energy rose.
- energy_error: how much the energy may rise [J]: the error of the step without contacts from the same state, and what
  the curvature of the contacts and the tolerance of the contact problems add, and 1e-8 of the kinetic energy.
- energy_rise: how far it rose beyond that [J]; 0 where the promise is kept.
- contacts: contact points that carried an impulse (int64); repaired: contact problems whose answer was repaired or
  blended, so that gaps and energy are kept and Coulomb's law is not (int64).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.records.rows import Array, Arrays, Fields, StepRows, joined

# The order is that of the file format.
FIELDS: Fields = {
    "t": (0, float),
    "h": (0, float),
    "step": (0, np.int64),
    "island": (0, np.int64),
    "residual": (0, float),
    "gap": (0, float),
    "energy_rise": (0, float),
    "energy_loss": (0, float),
    "energy_error": (0, float),
    "contacts": (0, np.int64),
    "repaired": (0, np.int64),
}


class DenseSteps(StepRows):
    """The dense steps of a run in the order of time; see the module for what the columns are.

    `len(steps)` is their number, `steps["gap"]` or `steps.array("gap")` a column, shape (n,).
    """

    _fields = FIELDS

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    @property
    def span(self) -> float:
        """Time in which some island took dense steps [s]."""
        if not len(self):
            return 0.0
        ends = np.maximum.accumulate(self.end)
        return float(np.sum(np.maximum(0.0, ends - np.maximum(self.t, np.append(self.t[0], ends[:-1])))))

    @property
    def repaired(self) -> int:
        """Number of contact problems whose answer was repaired or blended."""
        return int(self._arrays["repaired"].sum())

    @cached_property
    def energy_margin(self) -> Array:
        """How much further the energy could have risen within its error [J], shape (n,); below zero it rose too far.

        It is energy_error less the rise, which is 0 where the energy fell.
        """
        return np.asarray(self._arrays["energy_error"] - np.maximum(0.0, -self._arrays["energy_loss"]))

    def worst(self) -> str:
        """Return the worst figures in words."""
        low = min(0.0, float(self._arrays["gap"].min(initial=0.0)))
        residual, rise = (float(self._arrays[name].max(initial=0.0)) for name in ("residual", "energy_rise"))
        margin = float(self.energy_margin.min(initial=np.inf))
        energy = f"up by {rise:.2g} J beyond its error" if rise > 0.0 else f"within its error (margin {margin:.2g} J)"
        repaired = f", {self.repaired} contact problems repaired" if self.repaired else ""
        return (
            f"residual of Coulomb's law up to {residual:.2g} of the largest free speed, overlap up to "
            f"{-low:.2g} m, energy {energy}{repaired}"
        )

    def __repr__(self) -> str:
        return f"<DenseSteps: {len(self)} steps, {self.span:.4g} s>"


def of_parts(parts: Sequence[Arrays]) -> DenseSteps:
    """Return the dense steps that the engine reported in several calls."""
    return DenseSteps(partial(joined, parts, FIELDS))


def no_dense_steps() -> DenseSteps:
    """Return a log without dense steps."""
    return of_parts(())
