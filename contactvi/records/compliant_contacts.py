"""Compliant contacts of a run: where two soft shapes overlap at its nodes, and with what force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CompliantContacts:
    """One row per node and place of a compliant pair at which its shapes overlap; m rows.

    Attributes:
        node: number of the node, shape (m,), ascending. time: of it [s], shape (m,).
        pairs: names of all compliant pairs. pair: number of the row's pair in `pairs`, shape (m,).
        depth: of the overlap [m], > 0, shape (m,).
        normal: unit, from the first shape of the pair to the second one, world frame, shape (m, 3).
        point: where the force acts, the midpoint of the nearest points [m], world frame, shape (m, 3).
        force: at the node, on the second shape, that on the first one is opposite [N], world frame, shape (m, 3).
    """

    pairs: tuple[tuple[str, str], ...]
    node: NDArray[np.int64]
    time: Array
    pair: NDArray[np.int64]
    depth: Array
    normal: Array
    point: Array
    force: Array

    def __len__(self) -> int:
        return len(self.node)

    def __repr__(self) -> str:
        deepest = f", at most {self.depth.max():.4g} m deep" if len(self) else ""
        return f"<CompliantContacts: {len(self)} rows of {len(set(self.pair.tolist()))} pairs{deepest}>"

    @property
    def normal_force(self) -> Array:
        """The force along the normal, >= 0 [N], shape (m,)."""
        return np.asarray(np.einsum("ij,ij->i", self.force, self.normal), dtype=float)

    def of(self, a: str, b: str) -> CompliantContacts:
        """Return the rows of one pair, by the names of its shapes in any order."""
        wanted = [k for k, names in enumerate(self.pairs) if names in ((a, b), (b, a))]
        rows = np.isin(self.pair, wanted)
        columns: dict[str, Any] = {
            name: getattr(self, name)[rows] for name in ("node", "time", "pair", "depth", "normal", "point", "force")
        }
        return CompliantContacts(self.pairs, **columns)


def compliant_contacts(
    pairs: Sequence[tuple[str, str]], t: Array, numbers: NDArray[Any], values: Array
) -> CompliantContacts:
    """Return the contacts at the times t (N,) from rows of the engine: (node, pair) (m, 2) and numbers (m, 10)."""
    node, pair = numbers.astype(np.int64).reshape(-1, 2).T
    parts = np.split(values.reshape(-1, 10), [1, 4, 7], axis=1)
    return CompliantContacts(tuple(pairs), node, t[node], pair, parts[0][:, 0], *parts[1:])
