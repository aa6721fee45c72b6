"""Names of the tested pairs, a few bytes for each: with tuples the names of a large scene take more than its engine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import SupportsIndex, overload

import numpy as np
from numpy.typing import NDArray

Names = tuple[str, str]
_CHUNK = 4096


class PairNames(Sequence[Names]):
    """The tested pairs (geometry, geometry) in the engine's order; it is constant.

    Args:
        geometries: names of all geometries.
        pairs: numbers of geometries, shape (npairs, 2).
    """

    def __init__(self, geometries: Sequence[str], pairs: NDArray[np.int32]) -> None:
        self._geometries, self._pairs = tuple(geometries), pairs

    @property
    def numbers(self) -> NDArray[np.int32]:
        """The numbers of the geometries, shape (npairs, 2)."""
        return self._pairs

    def __len__(self) -> int:
        return len(self._pairs)

    @overload
    def __getitem__(self, index: SupportsIndex) -> Names: ...

    @overload
    def __getitem__(self, index: slice) -> PairNames: ...

    def __getitem__(self, index: SupportsIndex | slice) -> Names | PairNames:
        if isinstance(index, slice):
            return PairNames(self._geometries, self._pairs[index])
        first, second = self._pairs[index]
        return self._geometries[first], self._geometries[second]

    def __iter__(self) -> Iterator[Names]:
        names = self._geometries
        for start in range(0, len(self._pairs), _CHUNK):  # Rows of lists are quick, and a list of all is large.
            for first, second in self._pairs[start : start + _CHUNK].tolist():
                yield names[first], names[second]
