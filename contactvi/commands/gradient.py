"""What `contactvi check-gradient` prints: the events on the way, and a row per column of the derivative."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table

from contactvi.tables import text_table

if TYPE_CHECKING:
    from contactvi.derivatives.gradient_check import ColumnCheck, GradientCheck

COLUMNS = ("column", "size", "step", "own error", "difference", "believe", "why")
_NUMBERS = COLUMNS[1:5]
_MOST_EVENTS = 10
_STYLES = {"both": "green", "neither": "bold red", "exact": "yellow"}


def lines(check: GradientCheck) -> list[str]:
    """Return what the derivative went through: events and growth."""
    text = str(check.sensitivity.report).splitlines()
    left = len(text) - 1 - _MOST_EVENTS
    shown = [*text[: 1 + _MOST_EVENTS], f"... and {left} more"] if left > 0 else text
    return [*shown, ""]


def table(check: GradientCheck) -> Table:
    """Return the table: size of the exact derivative, step and own error of the best differences, disagreement.

    Errors and disagreement are relative to the size.
    """
    return text_table(COLUMNS, [_row(column) for column in check.columns], right=_NUMBERS, styles=_STYLES)


def _row(column: ColumnCheck) -> list[str]:
    part = column.worse
    if part is None:
        return [column.name, "", "", "", "", column.believe, column.reason]
    return [
        column.name, f"{part.size:.3g}", f"{part.step:.1e}", f"{part.relative_own:.1e}",
        f"{part.relative_difference:.1e}", column.believe, column.reason,
    ]  # fmt: skip
