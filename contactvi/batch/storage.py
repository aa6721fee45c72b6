"""The file of a batch: a zip of npy arrays, written block after block while runs end, and read in parts.

===================== ==================================================================================
entry                 meaning
===================== ==================================================================================
header                JSON text: format, schema, version, keep, runs, options (contactvi.Options); given: names of the
                      starts ("q0", "v0") and parameters that were given; fingerprint of the scene; key: hash of all
                      that the runs depend on (contactvi.batch.resume), None for runs that resume was not asked for
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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn, overload

import numpy as np
from numpy.typing import NDArray

from contactvi import errors
from contactvi.batch.blocks import COLUMNS, PADDED, Block, joined, padded
from contactvi.batch.plan import Plan
from contactvi.batch.results import Batch, BatchResult, BatchStatus, not_kept
from contactvi.errors import ContactviError, InputError, SceneError
from contactvi.files import UNREADABLE, as_a_path, check_free, checked_path, told, write_atomic
from contactvi.inputs import short
from contactvi.options import Options
from contactvi.records.rows import Places
from contactvi.scene.fingerprint import fingerprint
from contactvi.version import version

if TYPE_CHECKING:
    from contactvi.trajectory.trajectory import Trajectory

FORMAT = "contactvi-batch"
SCHEMA = 1
# What shards have in common: the entry of their headers, and what it is called.
_SHARED = {"fingerprint": "scene", "keep": "keep", "options": "options", "given": "what was given"}


def save_batch(
    path: str | os.PathLike[str], plan: Plan, blocks: Iterable[Block], overwrite: bool = False, key: str | None = None
) -> StoredBatch:
    """Write blocks to a file as they come; return the file."""

    header = {
        "keep": plan.keep, "runs": plan.runs, "options": plan.options.to_dict(), "given": list(plan.given),
        "fingerprint": fingerprint(plan.scene.to_dict()), "key": key,
    }  # fmt: skip
    return write_batch(path, header, blocks, overwrite)


def write_batch(
    path: str | os.PathLike[str], header: Mapping[str, Any], blocks: Iterable[Block], overwrite: bool
) -> StoredBatch:
    """Write blocks to a file as they come, below a header without format, schema and version; return the file."""

    def write(file: IO[bytes]) -> None:
        with zipfile.ZipFile(file, "w") as archive:
            whole = {"format": FORMAT, "schema": SCHEMA, "version": version(), **header}
            _put(archive, "header", np.array(json.dumps(whole)))
            first = 0
            for block in blocks:
                for name in COLUMNS:
                    _put(archive, f"{first}/{len(block)}/{name}", block.columns[name])
                for k, values in enumerate(block.given.values()):
                    _put(archive, f"{first}/{len(block)}/given/{k}", values)
                _put(archive, f"{first}/{len(block)}/texts", np.array(json.dumps(_texts(block))))
                first += len(block)

    return StoredBatch(write_atomic(path, write, overwrite))


def join_batches(
    batches: Sequence[str | os.PathLike[str] | StoredBatch], path: str | os.PathLike[str], *, overwrite: bool = False
) -> StoredBatch:
    """Write the runs of several files, such as the shards of a job array, to one file, in this order; return it.

    Args:
        batches: files of `simulate_batch(path=)`, or what it returned: of one scene, with the same options, the same
            `keep`, and the same starts and parameters given.
        path: of the file to write, block after block, so that memory stays bounded.
        overwrite: whether a file at `path` is replaced.

    Raises:
        InputError: there are none, or they do not belong together. OverwriteError: there is a file at `path`.
        SceneError: one of them cannot be read.
    """
    check_free(path, overwrite)
    if isinstance(batches, (str, os.PathLike)) or not batches:
        raise InputError(
            "There is nothing to join", name="batches", expected="a list of files of batches", got=short(batches),
            remedy="Give a list, for example sorted(Path().glob('shard-*.npz'))",
        )  # fmt: skip
    parts = [batch if isinstance(batch, StoredBatch) else load_batch(batch) for batch in batches]
    first = parts[0].header
    for part in parts[1:]:
        unlike = [name for name in _SHARED if part.header[name] != first[name]]
        if unlike:
            raise InputError(
                f"The batches {parts[0].path} and {part.path} do not belong together", name="batches",
                expected="one scene, the same options, keep and names of what was given",
                got="runs that differ in " + " and ".join(_SHARED[name] for name in unlike),
                remedy="Join the shards of one call, or make them again with the same scene and options",
            )  # fmt: skip
    header = {**first, "runs": sum(map(len, parts)), "key": None}
    return write_batch(path, header, (block for part in parts for block in part.blocks()), overwrite)


def load_batch(path: str | os.PathLike[str]) -> StoredBatch:
    """Open the file of a batch (`simulate_batch(path=)`); `[a:b]` reads these runs and no others.

    Raises:
        SceneError: for a file that is missing, damaged, or of another format.
    """
    return StoredBatch(checked_path(path))


class StoredBatch(Batch):
    """The runs of a batch in a file: all that a `BatchResult` has, read when it is asked for.

    A slice of it, or some of its runs by their numbers, is a `BatchResult`, for which no other blocks are read.

    Attributes:
        path: of the file. options: of the runs. given: names of the starts and parameters that were given.
        header: what the file says of all runs, without its format: keep, runs, options, given, fingerprint, key.
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
                names = ("keep", "runs", "options", "given", "fingerprint", "key")
                self.header: dict[str, Any] = {name: header.get(name) for name in names}
        except (*UNREADABLE, TypeError) as error:
            _refuse(path, told(error), error)
        self._places = sorted(places)
        ends = [0, *(first + count for first, count in self._places)]
        if [first for first, _ in self._places] != ends[:-1] or ends[-1] != self._runs:
            _refuse(path, "blocks of runs that are not one after the other")

    def __len__(self) -> int:
        return self._runs

    def _where(self) -> str:
        return f" in {self.path}"

    @cached_property
    def status(self) -> BatchStatus:  # type: ignore[override]
        """How the runs ended, as of a `BatchResult`; their states are not read."""
        return self._ends[0]

    @property
    def errors(self) -> dict[int, ContactviError]:  # type: ignore[override]
        """The errors of the runs that have one, by run."""
        return self._ends[1]

    @cached_property
    def _ends(self) -> tuple[BatchStatus, dict[int, ContactviError]]:
        messages: dict[int, str] = {}
        found: dict[int, ContactviError] = {}
        codes, times = self._column("code"), self._column("time")
        with _readable(self.path), zipfile.ZipFile(self.path) as archive:
            for first, count in self._places:
                texts = _read_texts(archive, first, count)
                messages |= {first + k: text for k, text in texts[0].items()}
                found |= {first + k: error for k, error in texts[1].items()}
        return BatchStatus(codes, times, messages), dict(sorted(found.items()))

    def _column(self, name: str) -> NDArray[Any]:
        """Read one column of all runs; states end with NaN where others have more nodes."""
        with _readable(self.path), zipfile.ZipFile(self.path) as archive:
            parts = [_take(archive, f"{first}/{count}/{name}") for first, count in self._places]
        if [len(part) for part in parts] != [count for _, count in self._places]:
            _refuse(self.path, "columns of different lengths")
        if name in PADDED:
            nodes = max(part.shape[1] for part in parts)
            parts = [padded(part, nodes) for part in parts]
        return np.concatenate(parts)

    def __getattr__(self, name: str) -> Any:
        """Read an attribute of a `BatchResult` from the file, and keep it."""
        if name not in (*COLUMNS, "q0", "v0", "parameters") or name in ("code", "time") or "_places" not in vars(self):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        found: Any = None
        if name in COLUMNS:
            ends = 0 if self.keep == "ends" else slice(None)
            value = self._column(name)
            found = value[:, ends, 0] if name == "t" else value[:, ends] if name in ("q", "v") else value
        elif name == "parameters":
            found = {
                known: self._column(f"given/{k}") for k, known in enumerate(self.given) if known not in ("q0", "v0")
            }
        elif name in self.given:
            found = self._column(f"given/{self.given.index(name)}")
        vars(self)[name] = found
        return found

    @overload
    def __getitem__(self, k: int) -> Trajectory: ...
    @overload
    def __getitem__(self, k: slice | Sequence[int] | NDArray[Any]) -> BatchResult: ...
    def __getitem__(self, k: int | slice | Sequence[int] | NDArray[Any]) -> Trajectory | BatchResult:
        """Return the result of some of the runs, as of a `BatchResult`: a slice, indices, truth values.

        Raises:
            InputError: for one run, because files do not keep runs as a whole; for no runs. IndexError: there is no
                such run. SceneError: the file is damaged.
        """
        if isinstance(k, (int, np.integer)):
            Places(self._runs, "Run")[int(k)]
            raise not_kept(self.keep, k)
        none = isinstance(k, str) or (not isinstance(k, slice) and len(k) == 0)
        chosen = np.zeros(0, dtype=int) if none else np.arange(self._runs)[k]
        if not len(chosen):
            raise InputError(
                "These are no runs of the file", name="k", expected=f"some of 0:{self._runs}", got=short(k),
                remedy="Take batch[a:b], numbers of runs or truth values, and single rows from its arrays",
            )  # fmt: skip
        places = [(a, n) for a, n in self._places if np.any((chosen >= a) & (chosen < a + n))]
        numbers = np.concatenate([np.arange(a, a + n) for a, n in places])
        whole = joined(list(self.blocks(places)))
        return BatchResult(self.keep, whole.rows([int(i) for i in np.searchsorted(numbers, chosen)]))

    def blocks(self, places: Iterable[tuple[int, int]] | None = None) -> Iterator[Block]:
        """Yield the runs as they are stored, block after block; places: (first run, number of runs) of some of them."""
        with _readable(self.path), zipfile.ZipFile(self.path) as archive:
            for first, count in self._places if places is None else places:
                block = _read(archive, first, count, self.given)
                if any(len(values) != count for values in (*block.columns.values(), *block.given.values())):
                    _refuse(self.path, "columns of different lengths")
                yield block

    @property
    def block(self) -> Block:
        """The arrays as they are stored, of all runs."""
        return joined(list(self.blocks()))


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
