"""What all logs of a run have in common: rows in the order of time, with one array per field."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError, did_you_mean
from contactvi.html import html_table, shown_rows
from contactvi.text import plain_table

Array = NDArray[np.float64]
Arrays = Mapping[str, NDArray[Any]]
# name -> (width, dtype) of one row; width 0 is a scalar.
Fields = Mapping[str, tuple[int, type]]
_SHOWN = 8  # items of a long log that print and notebooks show
Item = TypeVar("Item", covariant=True)


class Rows:
    """Rows as arrays, one per field."""

    _fields: ClassVar[Mapping[str, tuple[int | str, type]]]

    def __init__(self, arrays: Arrays | Callable[[], Arrays]) -> None:
        """Take the arrays of all fields, or a function that makes them when they are first asked for."""
        self._source = arrays

    @cached_property
    def _arrays(self) -> dict[str, NDArray[Any]]:
        arrays = self._source() if callable(self._source) else self._source
        self._source = {}
        return {name: np.asarray(arrays[name]) for name in self._fields}

    def array(self, name: str) -> NDArray[Any]:
        """Return one field of all rows as an array, shape (n,) or (n, width).

        Kinds, modes and other words are numbers there (contactvi.records.codes).
        """
        if not isinstance(name, str) or name not in self._arrays:
            raise InputError(
                "Unknown field",
                name="name",
                expected=" | ".join(self._arrays),
                got=repr(name),
                remedy=did_you_mean(str(name), list(self._arrays)),
            )
        return self._arrays[name]

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """All fields as arrays (the dictionary is a copy, the arrays are not)."""
        return dict(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays[next(iter(self._fields))])

    def __getstate__(self) -> dict[str, Any]:
        """Return what pickle and deepcopy keep: the arrays, and not what follows from them."""
        arrays = self._arrays
        derived = (name for name in vars(self) if isinstance(getattr(type(self), name, None), cached_property))
        left_out = {*derived, "_source"}
        kept = {name: value for name, value in vars(self).items() if name not in left_out}
        return {**kept, "_source": {}, "_arrays": arrays}


class StepRows(Rows):
    """Rows that belong to steps, of start t and length h."""

    @property
    def t(self) -> Array:
        """Starts of the steps [s], one per row."""
        return self._arrays["t"]

    @property
    def h(self) -> Array:
        """Lengths of the steps [s], one per row; 0 for impacts."""
        return self._arrays["h"]

    @property
    def end(self) -> Array:
        """Ends of the steps [s], one per row."""
        return self.t + self.h


class Places:
    """The places of a sequence of `count` items, of which -1 is the last; errors call an item `word`."""

    def __init__(self, count: int, word: str) -> None:
        self._count, self._word = count, word

    def __getitem__(self, index: int) -> int:
        place = index + self._count if index < 0 else index
        if not 0 <= place < self._count:
            # Not one of our errors: iteration and reversed need an IndexError of a sequence.
            known = f"expected an index from {-self._count} to {self._count - 1}" if self._count else "there is none"
            raise IndexError(f"{self._word} {index} of {self._count}: {known}. Look at len(...) first.")
        return place


class Items(Sequence[Item]):
    """A sequence whose items are made when they are asked for."""

    _word: ClassVar[str]  # for one item, in messages

    @abstractmethod
    def _item(self, i: int) -> Item: ...

    @overload
    def __getitem__(self, item: int) -> Item: ...
    @overload
    def __getitem__(self, item: slice) -> list[Item]: ...
    def __getitem__(self, item: int | slice) -> Item | list[Item]:
        if isinstance(item, slice):
            return [self._item(i) for i in range(*item.indices(len(self)))]
        return self._item(Places(len(self), self._word)[item])

    def __iter__(self) -> Iterator[Item]:
        return (self._item(i) for i in range(len(self)))

    def _shown(self) -> list[Item | None]:
        """Return the items that are shown, None where some are left out."""
        return [None if k is None else self._item(k) for k in shown_rows(len(self), _SHOWN)]


class Printed:
    """What print and notebooks show as a short table."""

    @abstractmethod
    def _brief(self) -> tuple[str, Sequence[str], list[Sequence[str] | None]]:
        """Return title, heads and rows of the table; None as a row says that some are left out."""

    def __str__(self) -> str:
        """Return what print shows."""
        return plain_table(*self._brief())

    def html(self) -> str:
        """Return what a notebook shows."""
        return html_table(*self._brief())

    def _repr_html_(self) -> str:
        return self.html()


def joined(parts: Sequence[Arrays], fields: Fields) -> dict[str, NDArray[Any]]:
    """Return the rows of several parts, one after the other."""
    if not parts:
        return {name: np.zeros((0, width) if width else 0, dtype=kind) for name, (width, kind) in fields.items()}
    found: dict[str, NDArray[Any]] = {}
    for name, (width, kind) in fields.items():
        shape = (-1, width) if width else (-1,)
        if len(parts) == 1:
            found[name] = np.array(parts[0][name], dtype=kind).reshape(shape)
            continue
        columns = [np.zeros((0, width) if width else 0), *(np.asarray(part[name]).reshape(shape) for part in parts)]
        found[name] = np.concatenate(columns).astype(kind)
    return found
