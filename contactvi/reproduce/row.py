"""A row of the reproduced table: numbers, what was expected of each, and the verdict that follows by stated rules."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from contactvi.options import ImpactMap

HOLDS, IN_PART, HOLDS_NOT = "holds", "holds in part", "does not hold"


@dataclass(frozen=True)
class Number:
    """One measured number.

    Attributes:
        quantity, map, case: what it is ("order"), of which impact map ("" for all), in which case ("h = 0.02 s").
        expected: what is expected of it, with its tolerance; "" where nothing is.
        met: whether it is so; None likewise.
    """

    quantity: str
    map: str
    case: str
    value: float
    unit: str
    expected: str = ""
    met: bool | None = None

    def at_most(self, bound: float) -> Number:
        """Return the number, expected to be <= bound."""
        return self._expect(f"<= {bound:g}", self.value <= bound)

    def at_least(self, bound: float) -> Number:
        """Return the number, expected to be >= bound."""
        return self._expect(f">= {bound:g}", self.value >= bound)

    def near(self, value: float, tolerance: float) -> Number:
        """Return the number, expected to be value +- tolerance."""
        return self._expect(f"{value:g} +- {tolerance:g}", abs(self.value - value) <= tolerance)

    def about(self, value: float, factor: float = 2.0) -> Number:
        """Return the number, expected to be value (> 0) within a factor: for values known to one digit."""
        good = value / factor <= self.value <= value * factor
        return self._expect(f"{value:g} within a factor {factor:g}", good)

    def between(self, low: float, high: float) -> Number:
        """Return the number, expected in [low, high]."""
        return self._expect(f"{low:g} .. {high:g}", low <= self.value <= high)

    def _expect(self, text: str, met: bool) -> Number:
        return Number(self.quantity, self.map, self.case, self.value, self.unit, text, bool(met))


@dataclass(frozen=True)
class Row:
    """One claim.

    Attributes:
        key: short name.
        claim: what the paper's table says.
        measured, expected: the same in a few words with numbers.
        rule: how the verdict follows from the numbers.
        verdict: "holds", "holds in part" or "does not hold".
        note: what has to be known to read the numbers.
        table: further numbers as a small table, its header first.
    """

    key: str
    claim: str
    measured: str
    expected: str
    rule: str
    verdict: str
    numbers: Sequence[Number]
    note: str = ""
    table: list[list[str]] = field(default_factory=list)

    @property
    def as_expected(self) -> bool | None:
        """Whether every number that something is expected of meets it; None where nothing is expected."""
        met = [number.met for number in self.numbers if number.met is not None]
        return all(met) if met else None


def listed(values: Iterable[float], digits: str = ".2g") -> str:
    """Return numbers as "1.96 1.99 2.00"."""
    return " ".join(f"{value:{digits}}" for value in values)


def per_map(values: Mapping[ImpactMap, str] | Mapping[str, str]) -> str:
    """Return "CTEC 1, DTEC 2, MHC 3"."""
    return "; ".join(f"{name.upper()} {text}" for name, text in values.items())
