"""Short tables for notebooks, as HTML. All text is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape

_MOST_COLUMNS = 24  # of a table; the others are counted
_LONGEST = 80  # letters of a cell


def html_table(title: str, heads: Sequence[str], rows: Iterable[Sequence[str] | None], note: str = "") -> str:
    """Return a table with a title above and a note below; None as a row says that some are left out."""
    left_out = len(heads) - _MOST_COLUMNS
    kept = slice(None) if left_out <= 0 else slice(0, _MOST_COLUMNS)
    more = [] if left_out <= 0 else [f"and {left_out} more"]
    lines = [f"<div><strong>{escape(title)}</strong>" if title else "<div>"]
    body = [_row([*row[kept], *("" for _ in more)] if row is not None else ["…"] * (len(heads[kept]) + len(more)), "td")
            for row in rows]  # fmt: skip
    if body:
        lines += ["<table>", "<thead>", _row([*heads[kept], *more], "th"), "</thead>"]
        lines += ["<tbody>", *body, "</tbody>", "</table>"]
    if note:
        lines.append(f"<div>{escape(note)}</div>")
    return "\n".join([*lines, "</div>"])


def html_fields(title: str, fields: Mapping[str, object], parts: Sequence[str] = ()) -> str:
    """Return a title, names with values, and further parts, which are HTML already and can be unfolded."""
    lines = [f"<div><strong>{escape(title)}</strong>", "<table>", "<tbody>"]
    for name, value in fields.items():
        lines.append(f'<tr><th style="text-align:left">{escape(name)}</th>')
        lines.append(f'<td style="text-align:left">{escape(_cut(str(value), 400))}</td></tr>')
    return "\n".join([*lines, "</tbody>", "</table>", *parts, "</div>"])


def shown_rows(count: int, most: int) -> list[int | None]:
    """Return the numbers of the rows that stand for so many: all, or the first and the last ones with None between."""
    if count <= most:
        return list(range(count))
    return [*range(most // 2), None, *range(count - most // 2, count)]


def folded(title: str, content: str) -> str:
    """Return HTML that shows its title and, when it is unfolded, its content, which is HTML."""
    return f"<details><summary>{escape(title)}</summary>\n{content}\n</details>"


def preformatted(text: str) -> str:
    """Return text with its lines as they are."""
    return f'<pre style="line-height:1.2">{escape(text)}</pre>'


def _row(cells: Sequence[str], tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(_cut(cell, _LONGEST))}</{tag}>" for cell in cells) + "</tr>"


def _cut(text: str, longest: int) -> str:
    return text if len(text) <= longest else text[: longest - 1] + "…"
