"""A problem at one point: the run, its cost and constraints, and their gradients once they are asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from contactvi.control.terms import TermValues
from contactvi.control.variables import Variables
from contactvi.errors import ContactviError
from contactvi.trajectory.gradient import RunGradients
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Failure:
    """A point at which the run or its derivative failed, and why.

    Attributes:
        z: (n,). error: what was raised.
    """

    z: Array
    error: ContactviError


class Evaluation:
    """What a problem is at one point; it is constant.

    Attributes:
        z: the point (n,). trajectory: the run there, with record="gradient".
        cost: J. constraints: numbers (m,). lower, upper: their bounds (m,).
    """

    def __init__(self, z: Array, traj: Trajectory, terms: TermValues, variables: Variables, gradients: RunGradients):
        self.z, self.trajectory = z, traj
        self.cost, self.constraints = terms.cost, terms.constraints
        self.lower, self.upper = terms.lower, terms.upper
        self._terms, self._variables, self._gradients = terms, variables, gradients
        self._values = variables.split(z)

    @cached_property
    def gradient(self) -> Array:
        """The gradient of the cost, shape (n,): one pass backward through the run."""
        found = np.zeros(len(self.z))
        if self._terms.nodes is not None:
            self._gradients.warn(stacklevel=2)
            found = self._pulled(*self._terms.nodes)
        for name, slope in self._terms.direct.items():
            found[self._variables.blocks[name]] += slope.ravel()
        return found

    @cached_property
    def jacobian(self) -> Array:
        """The derivatives of the constraints, shape (m, n): one pass backward for each."""
        found = np.zeros((len(self.constraints), len(self.z)))
        for k, (lq, lv) in enumerate(self._terms.rows):
            found[k] = self._pulled(lq, lv)
        return found

    def _pulled(self, lq: Array, lv: Array) -> Array:
        if not (np.any(lq) or np.any(lv)):
            return np.zeros(len(self.z))
        return self._variables.gradient(self._values, self._gradients.of(lq, lv))


class Solvable(Protocol):
    """What solvers need of a problem (contactvi.control.Problem)."""

    lower: Array
    upper: Array
    runs: int
    variables: Variables

    @property
    def z0(self) -> Array: ...

    def evaluate(self, z: Any) -> Evaluation: ...

    def hessian_product(self, z: Any, w: Any) -> Array: ...

    def check_second(self) -> None: ...

    def second_missing(self) -> str | None: ...
