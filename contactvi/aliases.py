"""Old names of public attributes, arguments and keys, which are kept for one release beside the new ones."""

from __future__ import annotations

import functools
import inspect
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

from contactvi.errors import DeprecatedWarning

Class = TypeVar("Class", bound=type)


def alias(name: str) -> Any:
    """Return a property that reads the attribute `name`."""

    def read(self: Any) -> Any:
        return getattr(self, name)

    return property(read, doc=f"Old name of `{name}`, kept for this release.")


def renamed_arguments(**new_names: str) -> Callable[[Class], Class]:
    """Let the constructor of a class take old names of arguments too: old name -> new name."""

    def decorate(cls: Class) -> Class:
        initialize = cls.__init__  # type: ignore[misc]

        @functools.wraps(initialize)
        def accept(self: Any, *arguments: Any, **named: Any) -> None:
            if not new_names.keys().isdisjoint(named):
                named = {new_names.get(name, name): value for name, value in named.items()}
            initialize(self, *arguments, **named)

        cls.__init__ = accept  # type: ignore[misc]
        return cls

    return decorate


def warn_deprecated(text: str) -> None:
    """Warn of an old name or meaning, at the line outside of contactvi that led here."""
    warnings.warn(text, DeprecatedWarning, stacklevel=callers())


def callers() -> int:
    """Return the stack level, for warnings of the caller, of the first function that is not of contactvi."""
    frame, level = inspect.currentframe(), 0
    while frame is not None and str(frame.f_globals.get("__name__")).partition(".")[0] == "contactvi":
        frame, level = frame.f_back, level + 1
    return level
