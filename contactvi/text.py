"""Short tables as plain text, for print."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

_LONGEST = 60  # letters of a cell


def plain_table(title: str, heads: Sequence[str], rows: Iterable[Sequence[str] | None]) -> str:
    """Return a table with a title above, its columns in line; None as a row says that some are left out."""
    cells = [[_cut(cell) for cell in (["..."] * len(heads) if row is None else row)] for row in rows]
    if not cells:
        return title
    widths = [max(len(row[k]) for row in [heads, *cells]) for k in range(len(heads))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in [heads, *cells]]
    return "\n".join([title, *(line.rstrip() for line in lines)])


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
