"""Text tables of the command line: fitted to a terminal, and elsewhere plain, with every line at its full length."""

from __future__ import annotations

import io
from collections.abc import Collection, Iterable, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

_WIDE = 100_000  # columns of a page on which nothing has to be cut or wrapped


def text_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    right: Collection[str] = (),
    styles: dict[str, str] | None = None,
) -> Table:
    """Return a table with a header and without lines.

    Args:
        right: names of the columns whose cells stand at their right end.
        styles: rich style of a cell, by its text.
    """
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for k, name in enumerate(columns):
        last = k == len(columns) - 1
        table.add_column(escape(name), justify="right" if name in right else "left", no_wrap=not last, overflow="fold")
    for row in rows:
        table.add_row(*(_cell(text, (styles or {}).get(text)) for text in row))
    return table


def name_table(pairs: Iterable[Sequence[str]]) -> Table:
    """Return a table without a header whose first column holds names: (name, text, ...) each row."""
    rows = list(pairs)
    table = Table.grid(padding=(0, 2, 0, 0))
    for k in range(max(map(len, rows), default=0)):
        table.add_column(style="bold" if k == 0 else None, overflow="fold")
    for row in rows:
        table.add_row(*map(_cell, row))
    return table


def print_table(console: Console, table: Table) -> None:
    """Print a table: on a terminal that is wide enough fitted to it, elsewhere with every line at its full length."""
    fits = Console(width=_WIDE).measure(table).minimum <= console.width
    if console.is_terminal and fits:
        console.print(table, soft_wrap=False)
        return
    for line in lines_of(table):
        console.print(line, markup=False)


def lines_of(table: Table) -> list[str]:
    """Return the lines of a table as plain text, none of them cut or wrapped."""
    page = io.StringIO()
    Console(file=page, width=_WIDE, color_system=None, force_terminal=False).print(table)
    return [line.rstrip() for line in page.getvalue().splitlines()]


def _cell(text: str, style: str | None = None) -> str:
    return f"[{style}]{escape(text)}[/]" if style else escape(text)
