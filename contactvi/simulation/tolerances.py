"""Holds a run to tolerances on its ledger, block by block as it grows (bounds: contactvi.trajectory.ledger)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactvi.trajectory.ledger import Ledger

Array = NDArray[np.float64]


class Excess(NamedTuple):
    """A tolerance that was exceeded: its name, the value and the bound, time [s]."""

    name: str
    value: float
    bound: float
    time: float

    def __str__(self) -> str:
        relative = " of the largest kinetic energy" if self.name in _RELATIVE else ""
        return f"{self.name} is {self.value:.3g}{relative}, more than {self.bound:.3g}"


class LedgerWatch:
    """Holds the ledger of a growing run to its tolerances, block by block."""

    def __init__(self, tolerances: Mapping[str, float]) -> None:
        self._tolerances = dict(tolerances)
        self._start: dict[str, Any] = {}
        self._lost = 0.0
        self._least = np.inf
        self._scale = 0.0

    def check(self, block: Ledger) -> Excess | None:
        """Return the first excess in time of a block, None where the block keeps all tolerances.

        A block starts with the last node of the block before it, and has the events since.
        """
        nodes = np.maximum.accumulate(np.append(self._scale, block.kinetic_energy))[1:]
        hits = np.maximum.accumulate(np.append(self._scale, block.event_kinetic_energy))[1:]
        found: list[Excess] = []
        for name in self._tolerances:
            if name in _NODE:
                self._look(found, name, block.t, self._drift(block, name), nodes, block.persistent & (name in _FREE))
            if name in _EVENT:
                value = _EVENT[name](block)
                self._look(
                    found, name, block.events.array("time"), value, hits, block.event_in_contact & np.isnan(value)
                )
            if name in _CONTACT:
                value = _CONTACT[name](block)
                self._look(
                    found, name, block.contacts.time, value, np.ones(len(value)), np.zeros(len(value), dtype=bool)
                )
            if name in _DENSE:
                steps = block.dense_steps
                at = np.clip(np.searchsorted(block.t, steps.end - 0.5 * steps.h), 0, len(nodes) - 1)  # the node after
                self._look(found, name, steps.end, _DENSE[name](block), nodes[at], np.zeros(len(steps), dtype=bool))
        self._scale = max(self._scale, *nodes[-1:], *hits[-1:])
        self._lost += float(block.event_loss.sum() + block.friction_loss[-1])
        self._least = min(self._least, float(block.energy.min()))
        return min(found, key=lambda excess: excess.time, default=None)

    def _look(
        self, found: list[Excess], name: str, time: Array, value: Array, scale: Array, free: NDArray[np.bool_]
    ) -> None:
        """Add the first value above the bound to `found`; where `free` is true the value does not count."""
        if name in _RELATIVE:
            value = np.divide(value, scale, out=np.where(value > 0, np.inf, 0.0), where=scale > 0)
        bound = self._tolerances[name]
        holds = (value <= bound) | free
        if name in ("discrete_energy", "impulse_balance"):
            holds |= np.isnan(value)  # of steps cut by an impact or across a node; any other NaN is an excess
        over = np.flatnonzero(~holds)
        if len(over):
            found.append(Excess(name, float(value[over[0]]), bound, float(time[over[0]])))

    def _drift(self, block: Ledger, name: str) -> Array:
        """Return the distance of a quantity at the nodes from the start of the run, losses added back, shape (N,)."""
        if name == "energy_rise":
            return np.asarray(block.energy - np.minimum.accumulate(np.append(self._least, block.energy))[1:])
        value: Array = getattr(block, name)
        if name == "impulse_balance":
            return value
        if name in _RELATIVE:
            value = block.undriven_energy if name == "energy_balance" else value
            value = value + self._lost + block.loss
            known = value[np.isfinite(value)]
            if name not in self._start and len(known):
                self._start[name] = known[0]
            return np.asarray(np.abs(value - self._start.get(name, 0.0)))
        return np.asarray(np.linalg.norm(value - self._start.setdefault(name, value[0]), axis=1))


_NODE = (
    *("energy", "modified_energy", "discrete_energy", "linear_momentum", "angular_momentum"),
    *("energy_rise", "impulse_balance", "energy_balance"),
)
_FREE = ("modified_energy", "discrete_energy")  # defined for steps without persistent contacts only
_RELATIVE = (
    *("energy", "modified_energy", "discrete_energy", "energy_rise", "energy_balance", "dense_energy_rise"),
    *("energy_jump", "modified_energy_jump", "discrete_energy_jump", "own_jump"),
)
_EVENT: dict[str, Callable[[Ledger], Array]] = {
    "energy_jump": lambda ledger: np.abs(ledger.energy_jump),
    "modified_energy_jump": lambda ledger: np.abs(ledger.modified_energy_jump),
    "discrete_energy_jump": lambda ledger: np.abs(ledger.discrete_energy_jump),
    "own_jump": lambda ledger: np.abs(ledger.own_jump),
    "impulse": lambda ledger: -ledger.impulse,
    "complementarity": lambda ledger: np.abs(ledger.complementarity),
    "gap": lambda ledger: np.abs(ledger.gap),
    "linear_momentum_jump": lambda ledger: np.linalg.norm(ledger.linear_momentum_jump, axis=1),
    "angular_momentum_jump": lambda ledger: np.linalg.norm(ledger.angular_momentum_jump, axis=1),
}
_CONTACT: dict[str, Callable[[Ledger], Array]] = {
    "impulse": lambda ledger: -ledger.contacts.impulse,
    "complementarity": lambda ledger: np.abs(ledger.contacts.complementarity),
    "gap": lambda ledger: np.abs(ledger.contacts.gap),
}
_DENSE: dict[str, Callable[[Ledger], Array]] = {
    "dense_residual": lambda ledger: ledger.dense_residual,
    "dense_gap": lambda ledger: np.maximum(0.0, -ledger.dense_gap),
    "dense_energy_rise": lambda ledger: ledger.dense_energy_rise,
}
