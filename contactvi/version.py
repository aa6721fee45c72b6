"""The version of the installed package."""

from __future__ import annotations

import functools
import importlib.metadata


@functools.lru_cache(maxsize=1)
def version() -> str:
    """Return the version; "unknown" where the source folder is used without being installed."""
    try:
        return importlib.metadata.version("contactvi")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


__version__: str = version()
