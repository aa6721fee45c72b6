"""Writing files whole or not at all."""

from __future__ import annotations

import contextlib
import glob
import itertools
import os
import pickle
import socket
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

from contactvi.errors import ContactviError, InputError, OverwriteError, SceneError

# What NumPy and zipfile raise for an archive that is damaged, truncated or something else altogether: of an unknown
# compression NotImplementedError, of one with a password RuntimeError.
UNREADABLE = (
    OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError,
    MemoryError,
)  # fmt: skip


def check_free(path: str | os.PathLike[str], overwrite: bool) -> Path:
    """Return the path of a file that is to be written; to be called before the work that makes what is written.

    Raises:
        OverwriteError: there is such a file, and it is not to be replaced. InputError: no path.
    """
    from contactvi.inputs import flag  # which loads Pinocchio: the command line and readers of files need not

    named = checked_path(path)
    if not flag("overwrite", overwrite) and named.is_file():
        raise OverwriteError(
            f"There is a file {named}", path=named, expected="a name that is free, or overwrite=True",
            got=f"a file of {named.stat().st_size} bytes",
            remedy="Give another path, or overwrite=True, which replaces the file",
        )  # fmt: skip
    return named


def told(error: BaseException) -> str:
    """Return in one line why a file cannot be read; of NumPy's advice on pickles, which run code, nothing is told."""
    if isinstance(error, pickle.UnpicklingError) or "pickle" in str(error):
        return "a file of another kind, or with Python objects in it"
    return f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else 'unreadable'}"


def write_atomic(path: str | os.PathLike[str], write: Callable[[IO[bytes]], object], overwrite: bool = True) -> Path:
    """Let `write` fill a temporary file in the folder of `path` and put it in place when it is complete.

    A reader sees the old file or the new one, never a part. A link is followed; only a regular file is replaced.
    Temporary files that processes which are no more have left for this name are removed.

    Args:
        overwrite: whether a file of this name is replaced. One that comes into being while this one is written is not
            replaced either: this one is then kept under a name beside it, which the error tells.

    Raises:
        OverwriteError: there is such a file. InputError: no path, a device or another special file, or a folder that is
            missing or cannot be written.
    """
    named = check_free(path, overwrite)
    target = Path(os.path.realpath(named))
    try:
        kind = target.stat().st_mode if target.exists() else stat.S_IFREG
    except OSError:
        kind = stat.S_IFREG  # the folder cannot be read: writing says why
    if not stat.S_ISREG(kind):
        raise InputError(
            f"Cannot write {named}",
            name="path",
            expected="a file that can be replaced",
            got="a folder" if stat.S_ISDIR(kind) else "a device, a pipe or another special file",
            remedy="Choose another path",
        )
    try:
        _remove_left(target)
        handle, name = tempfile.mkstemp(
            prefix=f".{target.name}.{_writer(os.getpid())}-", suffix=".part", dir=target.parent
        )
    except OSError as error:
        raise InputError(
            f"Cannot write {named}",
            name="path",
            expected="a file name in a folder that exists and can be written",
            got=error.strerror or str(error),
            remedy="Create the folder, or choose another path",
        ) from error
    try:
        with os.fdopen(handle, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o666 & ~_umask())  # mkstemp makes private files, results are ordinary ones
        if overwrite:
            os.replace(name, target)
        elif not _takes_free_name(name, target):
            raise _written_meanwhile(named, name, target)
    except BaseException as error:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(name)
        if isinstance(error, OSError):
            raise InputError(
                f"Cannot write {named}",
                name="path",
                expected="a file that can be replaced",
                got=error.strerror,
                remedy="Make room, or choose another path",
            ) from error
        raise
    return named


def _takes_free_name(part: str, target: Path) -> bool:
    """Give a file that is complete its name, if no other process has made a file of this name before."""
    try:
        os.link(part, target)
    except FileExistsError:
        return False
    except OSError:  # a file system without links: another process may come in between
        if target.exists():
            return False
        os.replace(part, target)
        return True
    os.unlink(part)
    return True


def _written_meanwhile(named: Path, part: str, target: Path) -> OverwriteError:
    """Keep a part that is complete under a name of its own; return the error that tells it."""
    names = (target.with_name(f"{target.stem}-{k}{target.suffix}") for k in itertools.count(2))
    free = next(path for path in names if _takes_free_name(part, path))
    return OverwriteError(
        f"{named} was written by another process meanwhile", path=named, expected="a name that stays free",
        got="a file of this name", remedy=f"What was to be written is kept in {named.with_name(free.name)}",
    )  # fmt: skip


def checked_path(path: object, name: str = "path") -> Path:
    """Return a path; raise InputError for what is none. name: of the argument."""
    text = os.fspath(path) if isinstance(path, (str, os.PathLike)) else ""
    if not text or not isinstance(text, str) or "\0" in text or not _encodable(text):
        raise InputError(
            "Path of a file", name=name, expected="a non-empty str or Path", got=repr(path), remedy="Name a file"
        )
    return Path(text)


@contextlib.contextmanager
def as_a_path(name: object) -> Iterator[None]:
    """Turn what the system says of a path that no file can have into a SceneError: too long, a loop, no such home."""
    try:
        yield
    except ContactviError:
        raise
    except (OSError, RuntimeError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        shown = repr(str(name))
        raise SceneError(
            f"No file can be read at {shown if len(shown) <= 80 else shown[:77] + '...'}",
            path=name,
            expected="the path of a file",
            got=reason[:200],
            remedy="Give the path of a file that exists",
        ) from error


def _encodable(text: str) -> bool:
    try:
        os.fsencode(text)
    except UnicodeError:
        return False
    return True


def _writer(process: int | str) -> str:
    """Return what a process of this machine is called in the names of parts; other machines may share the folder."""
    return f"{zlib.crc32(socket.gethostname().encode()):08x}-{process}"


def _remove_left(target: Path) -> None:
    """Remove the parts of this file whose writers, on this machine, are no more."""
    begin = f".{target.name}.{_writer('')}"
    for part in target.parent.glob(f"{glob.escape(begin)}*.part"):
        process = part.name.removeprefix(begin).partition("-")[0]
        if process.isascii() and process.isdigit() and not _runs(int(process)):
            with contextlib.suppress(OSError):
                part.unlink()


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _umask() -> int:
    value = os.umask(0)
    os.umask(value)
    return value
