"""The file of a batch: a zip of npy arrays, written block after block while runs end, and read in parts.

===================== ==================================================================================
entry                 meaning
===================== ==================================================================================
header                JSON text: format, schema, version, keep, runs, options (contactvi.Options); given: names of the
                      starts ("q0", "v0") and parameters that were given
FIRST/COUNT/NAME      a column of contactvi.batch.blocks of the runs FIRST to FIRST + COUNT - 1
FIRST/COUNT/given/K   what was given of these runs, with the K-th name of the header
FIRST/COUNT/texts     JSON text: {"messages": {run: text}, "errors": {run: {type, what, ...}}}, runs from 0
===================== ==================================================================================

Nothing in it is compressed or pickled, and nothing is executed on loading.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from contactvi import errors
from contactvi.batch.blocks import COLUMNS, Block, joined
from contactvi.batch.plan import Plan
from contactvi.batch.results import BatchResult, BatchStatus
from contactvi.errors import ContactviError, InputError, SceneError
from contactvi.files import UNREADABLE, as_a_path, checked_path, told, write_atomic
from contactvi.inputs import short
from contactvi.options import Options
from contactvi.status import StatusCode
from contactvi.version import version

FORMAT = "contactvi-batch"
SCHEMA = 1


def save_batch(
    path: str | os.PathLike[str], plan: Plan, blocks: Iterable[Block], overwrite: bool = False
) -> StoredBatch:
    """Write blocks to a file as they come; return the file."""

    def write(file: IO[bytes]) -> None:
        with zipfile.ZipFile(file, "w") as archive:
            header = {
                "format": FORMAT, "schema": SCHEMA, "version": version(), "keep": plan.keep, "runs": plan.runs,
                "options": plan.options.to_dict(), "given": list(plan.given),
            }  # fmt: skip
            _put(archive, "header", np.array(json.dumps(header)))
            first = 0
            for block in blocks:
                for name in COLUMNS:
                    _put(archive, f"{first}/{len(block)}/{name}", block.columns[name])
                for k, values in enumerate(block.given.values()):
                    _put(archive, f"{first}/{len(block)}/given/{k}", values)
                _put(archive, f"{first}/{len(block)}/texts", np.array(json.dumps(_texts(block))))
                first += len(block)

    return StoredBatch(write_atomic(path, write, overwrite))


def load_batch(path: str | os.PathLike[str]) -> StoredBatch:
    """Open the file of a batch (`simulate_batch(path=)`); `[a:b]` reads these runs and no others.

    Raises:
        SceneError: for a file that is missing, damaged, or of another format.
    """
    return StoredBatch(checked_path(path))


class StoredBatch:
    """The runs of a batch in a file; a slice of it reads these runs, as a `BatchResult`.

    Attributes:
        path: of the file. keep: "ends" or "nodes". options: of the runs.
        given: names of the starts and parameters that were given.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with as_a_path(path):
            if not path.is_file():
                _refuse(path, "there is no such file")
        try:
            with zipfile.ZipFile(path) as archive:
                header = json.loads(str(_take(archive, "header")))
                if header.get("format") != FORMAT or header.get("schema") != SCHEMA:
                    _refuse(path, "a file of another format or schema")
                places = {tuple(map(int, name.split("/")[:2])) for name in archive.namelist() if "/" in name}
                self.keep, self._runs = str(header["keep"]), int(header["runs"])
                self.options = Options.from_stored(header["options"])
                self.given = tuple(map(str, header.get("given", ())))
        except (*UNREADABLE, TypeError) as error:
            _refuse(path, told(error), error)
        self._places = sorted(places)
        ends = [0, *(first + count for first, count in self._places)]
        if [first for first, _ in self._places] != ends[:-1] or ends[-1] != self._runs:
            _refuse(path, "blocks of runs that are not one after the other")

    def __len__(self) -> int:
        return self._runs

    def __repr__(self) -> str:
        return f"<StoredBatch: {len(self)} runs in {self.path}, keep={self.keep!r}>"

    @cached_property
    def status(self) -> BatchStatus:
        """How the runs ended, as of a `BatchResult`; their states are not read."""
        return self._ends[0]

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Whether each run reached its end, (runs,)."""
        return np.asarray(self.status.codes == StatusCode.SUCCESS)

    @property
    def errors(self) -> dict[int, ContactviError]:
        """The errors of the runs that have one, by run."""
        return self._ends[1]

    @cached_property
    def _ends(self) -> tuple[BatchStatus, dict[int, ContactviError]]:
        messages: dict[int, str] = {}
        found: dict[int, ContactviError] = {}
        with _readable(self.path), zipfile.ZipFile(self.path) as archive:
            codes, times = (np.concatenate([_take(archive, f"{a}/{n}/{name}") for a, n in self._places])
                            for name in ("code", "time"))  # fmt: skip
            for first, count in self._places:
                texts = _read_texts(archive, first, count)
                messages |= {first + k: text for k, text in texts[0].items()}
                found |= {first + k: error for k, error in texts[1].items()}
        if len(codes) != self._runs or len(times) != self._runs:
            _refuse(self.path, "columns of different lengths")
        return BatchStatus(codes, times, messages), dict(sorted(found.items()))

    def __getitem__(self, k: slice) -> BatchResult:
        """Return the result of some of the runs.

        Raises:
            InputError: no slice with a step of 1, or an empty one. SceneError: the file is damaged.
        """
        first, last, step = k.indices(self._runs) if isinstance(k, slice) else (0, 0, 0)
        if step != 1 or last <= first:
            raise InputError(
                "These are no runs of the file", name="k", expected=f"a slice within 0:{self._runs}", got=short(k),
                remedy="Take batch[a:b], and single rows from its arrays",
            )  # fmt: skip
        parts = []
        with _readable(self.path), zipfile.ZipFile(self.path) as archive:
            for start, count in self._places:
                if start < last and start + count > first:
                    block = _read(archive, start, count, self.given)
                    if any(len(values) != count for values in (*block.columns.values(), *block.given.values())):
                        _refuse(self.path, "columns of different lengths")
                    parts.append(block.rows(range(max(first - start, 0), min(last - start, count))))
        return BatchResult(self.keep, joined(parts))


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise SceneError for what a damaged file makes its readers raise."""
    try:
        yield
    except (*UNREADABLE, TypeError) as error:
        if isinstance(error, ContactviError):
            raise
        _refuse(path, told(error), error)


def _put(archive: zipfile.ZipFile, name: str, values: NDArray[Any]) -> None:
    with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
        np.lib.format.write_array(entry, np.asarray(values), allow_pickle=False)


def _take(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    with archive.open(f"{name}.npy") as entry:
        found: NDArray[Any] = np.lib.format.read_array(entry, allow_pickle=False)
        return found


def _read(archive: zipfile.ZipFile, first: int, count: int, given: Sequence[str]) -> Block:
    columns = {name: _take(archive, f"{first}/{count}/{name}") for name in COLUMNS}
    starts = {name: _take(archive, f"{first}/{count}/given/{k}") for k, name in enumerate(given)}
    messages, found = _read_texts(archive, first, count)
    return Block(columns, messages, found, given=starts)


def _read_texts(archive: zipfile.ZipFile, first: int, count: int) -> tuple[dict[int, str], dict[int, ContactviError]]:
    texts = json.loads(str(_take(archive, f"{first}/{count}/texts")[()]))
    messages = {int(k): str(text) for k, text in texts["messages"].items()}
    return messages, {int(k): _error(fields) for k, fields in texts["errors"].items()}


def _texts(block: Block) -> dict[str, Any]:
    return {
        "messages": block.messages,
        "errors": {
            k: {"type": type(error).__name__, "what": error.what, "expected": str(error.expected),
                "got": str(error.got), "remedy": error.remedy}
            for k, error in block.errors.items()
        },
    }  # fmt: skip


def _error(fields: dict[str, str]) -> ContactviError:
    """Return an error with the texts of the one that was stored."""
    kind = getattr(errors, fields["type"], ContactviError)
    kind = kind if isinstance(kind, type) and issubclass(kind, ContactviError) else ContactviError
    texts = {name: fields[name] for name in ("expected", "got", "remedy")}
    return kind(fields["what"], **texts)


def _refuse(path: Path, got: str, error: Exception | None = None) -> NoReturn:
    raise SceneError(
        f"{path} cannot be read", path=path, expected="the file of a batch of runs", got=got,
        remedy="Correct the path, or write the file again: simulate_batch(..., path=path)",
    ) from error  # fmt: skip
