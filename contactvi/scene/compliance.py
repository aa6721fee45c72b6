"""Compliant pairs of geometries: a force that is a law of the gap, in place of impacts and rigid contact."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contactvi.inputs import positive, real
from contactvi.scene.pair_rules import Rule

HERTZ = 1.5


@dataclass(frozen=True)
class Compliance:
    """The law of a compliant pair: f = stiffness d^exponent (1 + damping d'), d the depth [m], d' its rate [m/s].

    Attributes:
        stiffness: [N/m^exponent].
        exponent: 1 for a linear spring, 1.5 for Hertz's contact of balls.
        damping: Hunt and Crossley's [s/m].
        friction: Coulomb's coefficient; None: that of the pair.
        slip_speed: [m/s] below which friction is viscous: it is friction f s / sqrt(s^2 + slip_speed^2) at the speed s.
    """

    stiffness: float
    exponent: float = 1.0
    damping: float = 0.0
    friction: float | None = None
    slip_speed: float = 1e-3

    @classmethod
    def checked(
        cls, stiffness: Any, exponent: Any = 1.0, damping: Any = 0.0, friction: Any = None, slip_speed: Any = 1e-3
    ) -> Compliance:
        """Return the law with these numbers; InputError for bad ones."""
        return cls(
            positive("stiffness", stiffness, "a number > 0 N/m^exponent, or None for a rigid pair"),
            real("exponent", exponent, 1.0, 10.0),
            real("damping", damping, 0.0),
            None if friction is None else real("friction", friction, 0.0),
            positive("slip_speed", slip_speed, "a number > 0 m/s"),
        )

    def describe(self) -> str:
        """Return the law in words."""
        law = f"k d^{self.exponent:g}" if self.exponent != 1.0 else "k d"
        unit = "N/m" if self.exponent == 1.0 else f"N/m^{self.exponent:g}"
        damped = f", damping {self.damping:g} s/m" if self.damping else ""
        rubs = f", Coulomb friction {self.friction:g} above {self.slip_speed:g} m/s" if self.friction else ""
        return f"force {law}, k = {self.stiffness:g} {unit}{damped}{rubs}"

    def to_data(self) -> dict[str, float | None]:
        """Return the numbers by name; `checked` takes them."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


@dataclass(frozen=True)
class ComplianceRow:
    """A compliant pair as the engine takes it: numbers and names of its geometries, and a law with a friction."""

    a: int
    b: int
    names: tuple[str, str]
    law: Compliance


def softer(laws: list[Compliance | None], names: tuple[str, str]) -> Compliance | None:
    """Return the law of the softer one of two sides; None: both are rigid."""
    return min((law for law in laws if law is not None), key=lambda law: law.stiffness, default=None)


@dataclass
class ComplianceRule(Rule):
    """Which pairs of geometries are compliant: those set as pairs; else those of which a side is, by the softer side.

    The values are laws; None: rigid.
    """

    default: Compliance | None = None
    combine: Callable[[list[Any], tuple[str, str]], Any] = softer

    def mask(self, names: Sequence[str]) -> np.ndarray | None:
        """Return which pairs of these geometries are compliant, shape (n, n), above the diagonal; None: none is."""
        soft = np.array([self.single.get(name) is not None for name in names], dtype=bool)
        if not soft.any() and not any(law is not None for law in self.pair.values()):
            return None
        found = soft[:, None] | soft[None, :]
        index = {name: k for k, name in enumerate(names)}
        for (a, b), law in self.pair.items():
            if a in index and b in index:
                found[index[a], index[b]] = found[index[b], index[a]] = law is not None
        return np.asarray(np.triu(found, 1))


def compliance_rows(
    rule: ComplianceRule, names: Sequence[str], pairs: np.ndarray, friction: np.ndarray
) -> list[ComplianceRow]:
    """Return the laws of compliant pairs (n, 2), with the friction of the pairs (n,) where they give none."""
    rows = []
    for (a, b), mu in zip(pairs.tolist(), friction, strict=True):
        law = rule.value(names[a], names[b])
        assert law is not None
        own = float(mu) if law.friction is None else law.friction
        rows.append(ComplianceRow(a, b, (names[a], names[b]), replace(law, friction=own)))
    return rows


def compliances_to_dict(rows: Sequence[ComplianceRow]) -> list[dict[str, Any]]:
    """Return compliant pairs as plain data."""
    return [{"pair": list(row.names), **row.law.to_data()} for row in rows]


def compliances_from_dict(data: Sequence[Mapping[str, Any]]) -> ComplianceRule:
    """Return the rule that `compliances_to_dict` described."""
    rule = ComplianceRule()
    for row in data:
        a, b = map(str, row["pair"])
        rule.set([a], [b], Compliance.checked(**{key: value for key, value in row.items() if key != "pair"}))
    return rule
