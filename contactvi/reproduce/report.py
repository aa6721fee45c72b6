"""What `contactvi reproduce` writes besides its pictures: table.csv with every number, report.md to be read."""

from __future__ import annotations

import csv
import io
import os
import platform
from collections.abc import Sequence
from pathlib import Path

from contactvi.files import write_atomic
from contactvi.reproduce.figures import Picture
from contactvi.reproduce.row import Row
from contactvi.reproduce.systems import MAPS
from contactvi.version import version

COLUMNS = ("row", "map", "case", "quantity", "value", "unit", "expected", "as_expected", "verdict_of_the_row")


def verdict(row: Row) -> str:
    """Return the verdict of a row in a few words: on the claim, then on the numbers."""
    numbers = {True: "numbers as expected", False: "numbers differ", None: "reported"}[row.as_expected]
    return f"{row.verdict}; {numbers}"


def save_table(rows: Sequence[Row], path: Path) -> Path:
    """Write every measured number as one line of a CSV file; return its path."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        for check in row.checks:
            met = {None: "", True: "yes", False: "no"}[check.ok]
            number = [check.what, f"{check.value:.10g}", check.unit, check.expectation, met]
            writer.writerow([row.key, check.map, check.case, *number, row.verdict])
    return write_atomic(path, lambda file: file.write(text.getvalue().encode("utf-8")))


def save_report(rows: Sequence[Row], pictures: Sequence[Picture], seconds: float, quick: bool, path: Path) -> Path:
    """Write the report; return its path. seconds: wall time of the whole reproduction."""
    text = "\n".join(report(rows, pictures, seconds, quick)) + "\n"
    return write_atomic(path, lambda file: file.write(text.encode("utf-8")))


def report(rows: Sequence[Row], pictures: Sequence[Picture], seconds: float, quick: bool) -> list[str]:
    """Return the lines of the report."""
    first, *others = pictures
    return [
        "# The paper's table and figure, reproduced",
        "",
        'Murphey, Pekarek, Seghete, "Variational Methods for Contact Mechanics": the impact maps CTEC (conserves the '
        "energy), DTEC (the discrete energy) and MHC (the modified energy). Problem B is the paper's double pendulum "
        "at a wall: two point masses of 1 kg on rods of 1 m, from rest at (0.3, 0.5) rad, elastic; the first impact "
        "is at 0.6567 s.",
        "",
        summary(rows),
        "",
        "## Table I",
        "",
        *_markdown([["claim", "paper", "found", "measured", "expected", "verdict"], *([*_cells(row)] for row in rows)]),
        "",
        "Every number is in `table.csv`.",
        *(line for row in rows if row.table for line in _small_table(row)),
        "",
        "## Fig. 1",
        "",
        *_picture(first),
        "## Convergence and long runs",
        "",
        *(line for picture in others for line in _picture(picture)),
        "## How the verdicts are made",
        "",
        "*Paper* and *found* say a word of each of CTEC, DTEC and MHC. One rule makes all verdicts: a claim holds "
        "where paper and numbers say the same of all three maps, in part where they do of one or two. *Expected* is "
        "what an earlier measurement found on the same problem; whether the numbers are these is judged separately. "
        "What is found follows from the numbers so:",
        "",
        *(f"- **{row.key}**: {row.rule}.{' ' + row.note if row.note else ''}" for row in rows),
        "",
        f"contactvi {version()}, {'quick run' if quick else 'full run'} in {seconds:.0f} s on {_machine()}.",
    ]


def summary(rows: Sequence[Row]) -> str:
    """Return one or two sentences: how many claims hold, which do not, and where numbers differ."""
    short = [f"{row.key} ({row.verdict})" for row in rows if row.verdict != "holds"]
    differ = [row.key for row in rows if row.as_expected is False]
    text = f"**{len(rows) - len(short)} of {len(rows)} claims hold**"
    text += f"; not, or not fully: {', '.join(short)}." if short else "."
    return text + (f" Numbers differ from what was expected in: {', '.join(differ)}." if differ else "")


def _cells(row: Row) -> list[str]:
    measured = row.measured.replace("; ", "<br>").replace(": CTEC", ":<br>CTEC")
    words = [
        "<br>".join(f"{name.upper()} {word}" for name, word in zip(MAPS, said, strict=True))
        for said in (row.paper, row.found)
    ]
    return [row.claim, *words, measured, row.expected.replace("; ", "<br>"), verdict(row).replace("; ", ";<br>")]


def _small_table(row: Row) -> list[str]:
    return ["", f"Relative jumps at impact 1 of problem B, h = 0.02 s ({row.key}):", "", *_markdown(row.table)]


def _picture(picture: Picture) -> list[str]:
    return [f"![{picture.caption}]({picture.png})", "", f"{picture.caption} Numbers: `{picture.csv}`.", ""]


def _markdown(cells: Sequence[Sequence[str]]) -> list[str]:
    """Return a Markdown table; a bar in a cell would end it."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in cells]
    return [lines[0], "|" + "---|" * len(cells[0]), *lines[1:]]


def _machine() -> str:
    return f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
