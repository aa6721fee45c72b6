"""A row of the reproduced table: what the paper says of each map, what was found, and the one rule for a verdict."""

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
        claim: what the row is about.
        paper, found: a word for each of CTEC, DTEC and MHC: what the paper says, and what the numbers say by `rule`.
        measured, expected: what was measured and expected, in a few words with numbers.
        rule: how what is found follows from the numbers.
        checks: every measured number, with what is expected of it.
        note: what has to be known to read the numbers.
        table: further numbers as a small table, its header first.
    """

    key: str
    claim: str
    paper: tuple[str, ...]
    found: tuple[str, ...]
    measured: str
    expected: str
    rule: str
    checks: Sequence[Check]
    note: str = ""
    table: list[list[str]] = field(default_factory=list)

    @property
    def verdict(self) -> str:
        """What is left of the claim: it holds where paper and numbers say the same of all maps, in part of some."""
        same = [said == is_so for said, is_so in zip(self.paper, self.found, strict=True)]
        return HOLDS if all(same) else IN_PART if any(same) else HOLDS_NOT

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


def answers(holds: Iterable[bool]) -> tuple[str, ...]:
    """Return "yes" or "no" for each map."""
    return tuple("yes" if value else "no" for value in holds)
