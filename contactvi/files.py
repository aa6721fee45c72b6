"""Writing files whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO

from contactvi.errors import InputError


def write_atomic(path: str | os.PathLike[str], write: Callable[[IO[bytes]], object]) -> Path:
    """Let `write` fill a temporary file in the folder of `path` and put it in place when it is complete.

    A reader sees the old file or the new one, never a part. Raises InputError where the folder is missing or cannot
    be written.
    """
    target = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent)
    except OSError as error:
        raise InputError(
            f"Cannot write {target}",
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
        os.replace(name, target)
    except BaseException as error:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(name)
        if isinstance(error, OSError):
            raise InputError(
                f"Cannot write {target}", name="path", expected="a file that can be replaced", got=error.strerror
            ) from error
        raise
    return target


def _umask() -> int:
    value = os.umask(0)
    os.umask(value)
    return value
