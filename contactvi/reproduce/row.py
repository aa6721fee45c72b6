"""A row of the reproduced table: its checks, and the verdict that follows from them by stated rules."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from contactvi.options import ImpactMap
from contactvi.reproduce.check import Check

HOLDS, IN_PART, HOLDS_NOT = "holds", "holds in part", "does not hold"


@dataclass(frozen=True)
class Row:
    """One claim.

    Attributes:
        key: short name.
        claim: as the paper's table states it.
        measured, expected: what was measured and expected, in a few words with numbers.
        rule: how the verdict follows from the numbers.
        verdict: "holds", "holds in part" or "does not hold".
        checks: every measured number, with what is expected of it.
        note: what has to be known to read the numbers.
        table: further numbers as a small table, its header first.
    """

    key: str
    claim: str
    measured: str
    expected: str
    rule: str
    verdict: str
    checks: Sequence[Check]
    note: str = ""
    table: list[list[str]] = field(default_factory=list)

    @property
    def as_expected(self) -> bool | None:
        """Whether every check holds that expects something; None where none does."""
        verdicts = [check.ok for check in self.checks if check.ok is not None]
        return all(verdicts) if verdicts else None


def listed(values: Iterable[float], digits: str = ".2g") -> str:
    """Return numbers as "1.96 1.99 2.00"."""
    return " ".join(f"{value:{digits}}" for value in values)


def per_map(values: Mapping[ImpactMap, str] | Mapping[str, str]) -> str:
    """Return "CTEC 1, DTEC 2, MHC 3"."""
    return "; ".join(f"{name.upper()} {text}" for name, text in values.items())
