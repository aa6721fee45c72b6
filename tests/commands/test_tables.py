"""Tables of the command line: nothing is cut where no terminal limits the width."""

from __future__ import annotations

import io

from rich.console import Console

from contactvi.tables import lines_of, name_table, print_table, text_table

LONG = "a reason that is much longer than the eighty columns that rich takes where it knows of no terminal at all"


def printed(table, **options) -> list[str]:
    page = io.StringIO()
    print_table(Console(file=page, soft_wrap=True, **options), table)
    return page.getvalue().splitlines()


def test_lines_are_whole_and_columns_stand_below_each_other():
    table = text_table(("case", "number", "reason"), [("one", "1.5", LONG), ("[two]", "10", "")], right=("number",))
    head, first, second = printed(table)
    assert head == "case   number  reason"
    assert first == f"one       1.5  {LONG}"
    assert second == "[two]      10"  # square brackets are text, no markup
    assert lines_of(table) == [head, first, second]


def test_a_terminal_folds_long_cells_and_styles_verdicts():
    table = text_table(("verdict", "reason"), [("ok", LONG)], styles={"ok": "green"})
    lines = printed(table, force_terminal=True, width=60, color_system="standard")
    assert len(lines) > 2
    assert "\x1b[32mok" in lines[1]
    narrow = printed(table, force_terminal=True, width=5, color_system=None)
    assert narrow == lines_of(table)  # too narrow for the columns: the terminal itself wraps the lines


def test_names_stand_in_the_first_column():
    assert lines_of(name_table([("status", "SUCCESS"), ("", "more")])) == ["status  SUCCESS", "        more"]
