"""Short tables and short lists of fields as plain text, for print."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

_LONGEST = 60  # letters of a cell
_WRITTEN = 7  # numbers of an array that are written: a pose


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


def fields_shown(record: Any) -> str:
    """Return the repr of a dataclass in one line, with large arrays by their shapes."""
    fields = [f"{field.name} {_shown(getattr(record, field.name))}" for field in dataclasses.fields(record)]
    return f"<{type(record).__name__}: {', '.join(fields)}>"


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name!r}: {_shown(part)}" for name, part in value.items()) + "}"
    if isinstance(value, np.ndarray) and value.size > _WRITTEN:
        return "x".join(map(str, value.shape)) + " numbers"
    if isinstance(value, np.ndarray):
        return np.array2string(value, precision=6, max_line_width=10**6).replace("\n", "")
    return f"{value:.6g}" if isinstance(value, float) else _cut(str(value))
