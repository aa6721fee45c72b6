"""A checked number: what was expected, what was found, the tolerance and its reason, the verdict.

`contactvi verify` and `contactvi reproduce` consist of these. Expectations come from closed forms, from published
digits or from an independent measurement, never from an earlier output of the engine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Check:
    """One measured quantity against what is known of it.

    Attributes:
        what: the quantity.
        expected, got: as text; expected is empty where nothing is.
        tolerance: as text: a number, "bound", "bounds", "exact" for counts, or "a factor 2".
        reason: where the tolerance comes from.
        ok: the verdict; None where nothing is expected.
        value: what was found, nan where that is no single number.
        unit: of the value.
        map, case: of which impact map ("" for all), in which case ("h = 0.02 s").
    """

    what: str
    expected: str
    got: str
    tolerance: str
    reason: str
    ok: bool | None
    value: float = math.nan
    unit: str = ""
    map: str = ""
    case: str = ""

    @property
    def expectation(self) -> str:
        """What is expected together with its tolerance, as "2 +- 0.1", "<= 1e-11" or "3 within a factor 2"."""
        if self.tolerance in {"", "bound", "bounds", "exact"}:
            return self.expected
        return f"{self.expected} {'within' if self.tolerance.startswith('a ') else '+-'} {self.tolerance}"

    def of(self, map: str, case: str, unit: str) -> Check:
        """Return the check with the impact map, the case and the unit that it belongs to."""
        return replace(self, map=map, case=case, unit=unit)


def near(what: str, expected: ArrayLike, got: ArrayLike, tolerance: float, reason: str) -> Check:
    """Expect numbers of one shape within an absolute tolerance, each of them."""
    exact, found = np.asarray(expected, dtype=float), np.asarray(got, dtype=float)
    ok = exact.shape == found.shape and bool(np.all(np.abs(found - exact) <= tolerance))
    value = float(found) if found.ndim == 0 else math.nan
    return Check(what, _text(exact), _text(found), f"{tolerance:.3g}", reason, ok, value)


def about(what: str, expected: float, got: float, factor: float, reason: str) -> Check:
    """Expect a number (> 0) within a factor: for values known to one digit."""
    ok = bool(expected / factor <= got <= expected * factor)
    return Check(what, f"{expected:g}", f"{got:.6g}", f"a factor {factor:g}", reason, ok, float(got))


def between(what: str, low: float, high: float, got: float, reason: str) -> Check:
    """Expect a number in [low, high]."""
    return Check(what, f"{low:g} .. {high:g}", f"{got:.6g}", "bounds", reason, bool(low <= got <= high), float(got))


def at_most(what: str, bound: float, got: float, reason: str) -> Check:
    """Expect a number <= bound."""
    return Check(what, f"<= {bound:.3g}", f"{got:.3g}", "bound", reason, bool(got <= bound), float(got))


def at_least(what: str, bound: float, got: float, reason: str) -> Check:
    """Expect a number >= bound."""
    return Check(what, f">= {bound:.6g}", f"{got:.6g}", "bound", reason, bool(got >= bound), float(got))


def same(what: str, expected: object, got: object, reason: str = "a count or a choice") -> Check:
    """Expect exactly this."""
    return Check(what, str(expected), str(got), "exact", reason, bool(expected == got))


def reported(what: str, got: float) -> Check:
    """Report a number of which nothing is expected."""
    return Check(what, "", f"{got:.6g}", "", "", None, float(got))


def _text(values: NDArray[np.float64]) -> str:
    if values.ndim == 0:
        return f"{float(values):.11g}"
    if values.size > 8:
        return f"{values.size} values, {values.min():.6g} .. {values.max():.6g}"
    return "(" + ", ".join(f"{value:.10g}" for value in values.ravel()) + ")"
