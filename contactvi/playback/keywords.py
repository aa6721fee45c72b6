"""Options that are passed on to a function of the playback by keyword, checked by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from typing import Any

from contactvi.errors import InputError, did_you_mean


def check_keywords(function: Callable[..., Any], given: Iterable[str], caller: str) -> None:
    """Raise InputError for a name that is no keyword of a function, with those that are; caller: what was called."""
    parameters = inspect.signature(function).parameters.values()
    known = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]
    for name in given:
        if name not in known:
            raise InputError(
                f"{caller} has no option {name!r}", name=name, expected=f"some of {', '.join(known)}", got=name,
                remedy=did_you_mean(name, known),
            )  # fmt: skip
