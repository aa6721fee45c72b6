"""What earlier processes have computed, kept on disk: what takes most of the time of loading a robot and of drawing it.

These are hulls of meshes, meshes as they are drawn, and what MuJoCo's compiler makes of a model.

An entry is a file with a few arrays, named by a digest of all that they were computed from; so it is never out of date,
and any number of processes may read and write entries at the same time. Entries that cannot be read, among them those
that were cut short when a machine went down, count as missing.

The folder is CONTACTVI_CACHE, or contactvi in XDG_CACHE_HOME, or ~/.cache/contactvi; there is no cache where
CONTACTVI_CACHE is empty. A folder that cannot be written is no error: everything is computed.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import platform
import tempfile
import zlib
from collections.abc import Iterable
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from contactvi.files import UNREADABLE
from contactvi.version import __version__

Arrays = list[NDArray[np.generic]]

FORMAT = 5  # raised where entries look different or hulls are computed in another way: no old entry is found then
LARGEST = 512_000_000  # bytes of all entries; the largest robots have entries of 5e6, with their meshes of 3e7
_SUFFIX = ".hull"


def folder() -> Path | None:
    """Return the folder of the cache, which may not exist yet; None for no cache."""
    named = os.environ.get("CONTACTVI_CACHE")
    if named is not None:
        return Path(named).absolute() if named else None
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(home) / "contactvi" if os.path.isabs(home) else None


def key(what: str, *parts: bytes | float | str) -> str:
    """Return the name of an entry.

    Args:
        what: was computed.
        parts: all that it was computed from, besides the programs, whose versions are part of every name.
    """
    digest = hashlib.sha256(_programs())
    for part in (what, *parts):
        kind, data = (b"b", part) if isinstance(part, bytes) else (b"r", repr(part).encode())
        digest.update((1 + len(data)).to_bytes(8, "little") + kind)
        digest.update(data)
    return digest.hexdigest()


def find(name: str) -> Arrays | None:
    """Return the arrays of an entry; None where there is no whole one."""
    path = _path(name)
    if path is None:
        return None
    try:
        with open(path, "rb") as file:
            data = file.read()
        arrays = _unpacked(data)
    except (*UNREADABLE, TypeError):
        return None
    with contextlib.suppress(OSError):  # of a folder that can be read only
        os.utime(path)  # used now: the oldest entries are the first to go
    return arrays


def keep(name: str, arrays: Iterable[NDArray[np.generic]]) -> None:
    """Write an entry, if the folder can be written."""
    path = _path(name)
    if path is None:
        return
    data = _packed(arrays)
    with contextlib.suppress(OSError):
        place = Path(path).parent
        place.mkdir(parents=True, exist_ok=True)
        _make_room(place)
        handle, part = tempfile.mkstemp(prefix=".", suffix=".part", dir=place)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            os.replace(part, path)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(part)
            raise


def _path(name: str) -> str | None:
    place = folder()
    return None if place is None else os.path.join(place, name + _SUFFIX)


def _packed(arrays: Iterable[NDArray[np.generic]]) -> bytes:
    """Return an entry: CRC-32 of what follows, length of the table of types and shapes (JSON), the table, the numbers.

    Numbers and not NumPy's files: the headers of these are Python text, and parsing it takes longer than all else.
    """
    kept = [np.ascontiguousarray(array) for array in arrays]
    table = json.dumps([[array.dtype.str, array.shape] for array in kept]).encode()
    body = b"".join((len(table).to_bytes(4, "little"), table, *(array.tobytes() for array in kept)))
    return zlib.crc32(body).to_bytes(4, "little") + body


def _unpacked(data: bytes) -> Arrays | None:
    """Return the arrays of an entry, which are read only. None, or one of UNREADABLE is raised, where it is none."""
    body = memoryview(data)[4:]
    if len(body) < 4 or zlib.crc32(body) != int.from_bytes(data[:4], "little"):
        return None
    at = 4 + int.from_bytes(body[:4], "little")
    arrays: Arrays = []
    for kind, shape in json.loads(bytes(body[4:at])):
        count = math.prod(shape)
        array = np.frombuffer(body, np.dtype(kind), count, at).reshape(shape) if count else np.empty(shape, kind)
        arrays.append(array)
        at += array.nbytes
    return arrays if at == len(body) else None


@lru_cache(maxsize=1)
def _programs() -> bytes:
    """Return what the numbers depend on besides their input."""
    try:
        libraries = version("coal"), version("libcoal")
    except PackageNotFoundError:
        libraries = ("unknown", "unknown")
    return repr((FORMAT, __version__, libraries, platform.machine())).encode()


@lru_cache(maxsize=8)
def _make_room(place: Path) -> None:
    """Remove the entries that were not used for the longest time where all are too large; once in a process.

    Parts that a process has left when it was killed are entries not used for long, too.
    """
    found = []
    for path in place.iterdir():
        if path.suffix in (_SUFFIX, ".part"):
            with contextlib.suppress(OSError):  # another process has removed it
                facts = path.stat()
                found.append((facts.st_mtime, facts.st_size, path))
    size = sum(entry[1] for entry in found)
    for _, own, path in sorted(found, key=lambda entry: entry[0]):
        if size <= LARGEST:
            return
        with contextlib.suppress(OSError):
            path.unlink()
        size -= own
