"""Where the numbers of parameters stand in the engine's scene, so that copies of it are made with others of them.

What such a copy has is what `Scene.with_parameters` builds, to the bit. Values that no scene has, and those that change
which servos there are, are told apart: scenes of these are built, or refused, one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from contactvi.scene.build import Built
from contactvi.scene.parameter_values import LIMITS, OF_CONTACTS, ParameterValues, body_numbers, in_range

Array = NDArray[np.float64]
Place = tuple[str, int]  # name of contactvi._core.SceneNumber, index


class ParameterPlaces:
    """The places of some parameters of a complete scene; InputError for names that it has not.

    Attributes:
        names: of the parameters.
    """

    def __init__(self, built: Built, names: Sequence[str]) -> None:
        self._values, self._model = ParameterValues(built), built.model
        self._pairs = {pair: k for k, pair in enumerate(built.pairs)}
        self.names = tuple(names)
        self._parts = [self._part(name) for name in names]

    @property
    def places(self) -> list[tuple[str, int, int]]:
        """Kind (a name of contactvi._core.SceneNumber), index and column in the rows of every number."""
        found: list[tuple[str, int, int]] = []
        first = 0
        for places, columns, _ in self._parts:
            one = len(places) != columns  # a value for several places, or the ten numbers of a body
            found += [(kind, i, first if one else first + k) for k, (kind, i) in enumerate(places)]
            first += columns
        return found

    def rows(self, values: Mapping[str, Array]) -> tuple[Array, NDArray[np.bool_]]:
        """Return the numbers of values (runs, width), and which of the runs have a scene that a copy can be.

        Args:
            values: by name, with a row for each run.
        """
        usable = np.ones(len(next(iter(values.values()))), dtype=bool)
        columns = []
        for name, (_, _, numbers) in zip(self.names, self._parts, strict=True):
            own = values[name]
            usable &= in_range(name, own)
            found = numbers(np.where(usable[:, None], own, 1.0))
            usable &= np.isfinite(found).all(axis=1)
            columns.append(found)
        return np.concatenate(columns, axis=1), usable

    def _part(self, name: str) -> tuple[list[Place], int, Callable[[Array], Array]]:
        """Return the places of a parameter, its number of columns, and the function that makes them of values."""
        self._values.of(name)
        kind, _, of = name.partition(":")
        if kind in OF_CONTACTS:
            return [self._contact(kind, names) for names, _ in self._values.contacts(name)], 1, _same
        if kind == "gravity":
            return [("GRAVITY", i) for i in range(3)], 3, _same
        joint = self._values.joint(kind, of)
        if kind in ("mass", "inertia"):
            body = self._values.body(of)
            return [("BODY", joint)], 10, lambda values: body_numbers(kind, body, values)
        if kind == "stiffness":
            return [("STIFFNESS", joint)], 1, _same
        if kind == "rest":
            q, count = self._model.idx_qs[joint], self._model.nqs[joint]
            places: list[Place] = [("REST", q + i) for i in range(count)]
            return places, count, _on_circle if self._values.is_circle(of) else _same
        v = self._model.idx_vs[joint]
        return [(kind.upper(), v + i) for i in range(self._model.nvs[joint])], self._model.nvs[joint], _same

    def _contact(self, kind: str, names: tuple[str, str]) -> Place:
        if names[1] in LIMITS and names not in self._pairs:
            return "LIMIT_RESTITUTION", int(self._model.getJointId(names[0]))
        return kind.upper(), self._pairs[names]


def _same(values: Array) -> Array:
    return values


def _on_circle(values: Array) -> Array:
    """Return cosines and sines of angles (runs, 1), number by number as for a single scene."""
    return np.array([[np.cos(angle), np.sin(angle)] for angle in values[:, 0]])
