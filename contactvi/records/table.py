"""A table of a run: named columns with units, for pandas, CSV files and notebooks."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError, did_you_mean, missing_package
from contactvi.html import html_table, shown_rows

if TYPE_CHECKING:
    import pandas

_ROWS = 8  # of a long table that a notebook shows, half of them from its end
_BLOCK = 4096  # rows that are written at once


class Words(NamedTuple):
    """A column of words (n,): codes (n,) are their places in `words`."""

    codes: NDArray[np.int64]
    words: tuple[str, ...]

    def spelled(self) -> NDArray[Any]:
        """Return the words of all rows, an array of str objects, shape (n,)."""
        return np.array([*self.words, ""], dtype=object)[self.codes]


Column = NDArray[Any] | Words


@dataclass(frozen=True, eq=False, repr=False)
class Table:
    """Rows of a run.

    Attributes:
        name: of the table.
        columns: by name; the first one is the time [s].
        units: of the columns that have one, by their name; "1" is a pure number.
    """

    name: str
    columns: Mapping[str, Column]
    units: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        first = next(iter(self.columns.values()))
        return len(first.codes if isinstance(first, Words) else first)

    def __repr__(self) -> str:
        columns = (f"{name} [{self.units[name]}]" if name in self.units else name for name in self.columns)
        return f"<Table {self.name!r}: {len(self)} rows, columns {', '.join(columns)}>"

    def column(self, name: str) -> NDArray[Any]:
        """Return a column (n,), words spelled out. Raises InputError for a name that the table does not have."""
        if name not in self.columns:
            raise InputError(
                f"Unknown column of the table {self.name!r}", name="name", expected=", ".join(self.columns),
                got=repr(name), remedy=did_you_mean(str(name), list(self.columns)),
            )  # fmt: skip
        found = self.columns[name]
        return found.spelled() if isinstance(found, Words) else found

    def to_pandas(self, index: str | None = None) -> pandas.DataFrame:
        """Return a DataFrame; `attrs["units"]` has the units, words are categories.

        Args:
            index: the column that becomes the index.

        Raises:
            ContactviError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise missing_package("pandas", "pandas") from error
        columns = {
            name: pandas.Categorical.from_codes(column.codes, categories=list(column.words))
            if isinstance(column, Words) else column
            for name, column in self.columns.items()
        }  # fmt: skip
        frame = pandas.DataFrame(columns)
        frame.attrs["units"] = dict(self.units)
        return frame if index is None else frame.set_index(index)

    def write_csv(self, file: IO[bytes]) -> None:
        """Write the table with a line of names; numbers have all their digits."""
        text = io.TextIOWrapper(file, encoding="utf-8", newline="", write_through=True)
        try:
            writer = csv.writer(text, lineterminator="\n")
            writer.writerow(self.columns)
            for first in range(0, len(self), _BLOCK):
                writer.writerows(self._rows(slice(first, first + _BLOCK)))
        finally:
            text.detach()  # the file is the caller's

    def _rows(self, rows: slice) -> Iterator[tuple[Any, ...]]:
        parts = [
            (Words(column.codes[rows], column.words).spelled() if isinstance(column, Words) else column[rows]).tolist()
            for column in self.columns.values()
        ]
        return zip(*parts, strict=True)

    def _repr_html_(self) -> str:
        return self.html()

    def html(self) -> str:
        """Return what a notebook shows: the first rows and the last ones."""
        count = len(self)
        chosen = shown_rows(count, _ROWS)
        rows = [None if k is None else [_shown(cell) for cell in next(self._rows(slice(k, k + 1)))] for k in chosen]
        heads = [f"{name} [{self.units[name]}]" if self.units.get(name, "1") != "1" else name for name in self.columns]
        return html_table(f"{self.name}: {count} rows", heads, rows)


def _shown(cell: Any) -> str:
    return f"{cell:.6g}" if isinstance(cell, float) else str(cell)
