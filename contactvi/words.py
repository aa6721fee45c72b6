"""Errors of the package in the words of the command line: an argument is a flag, or a line of the scene file."""

from __future__ import annotations

import re
from collections.abc import Mapping

_GIVEN = re.compile(r"""\b([a-z][a-z0-9_]*)=(\.\.\.|"[^"]*"|'[^']*'|[-+\w.]*[\w])""")


def in_flags(text: str, flags: Mapping[str, str]) -> str:
    """Return a text with name=value as --flag value, or as a line of [run] where the command has no such flag.

    Args:
        flags: name of an argument -> flag of the command.
    """
    text = text.replace("overwrite=True", "--force")
    return _GIVEN.sub(lambda found: _flag(found[1], found[2], flags), text)


def in_lines(text: str) -> str:
    """Return a text with name=value as a line of a scene file: name = value, strings in double quotes."""
    return _GIVEN.sub(lambda found: f"{found[1]} = {_toml(found[2])}", text)


def _flag(name: str, value: str, flags: Mapping[str, str]) -> str:
    if name in flags:
        return f"{flags[name]} {value.strip(chr(39) + chr(34))}"
    from contactvi.options import option_names

    return f"{name} = {_toml(value)} under [run] in the scene file" if name in option_names() else f"{name}={value}"


def _toml(value: str) -> str:
    if value in ("True", "False"):
        return value.lower()
    return '"' + value[1:-1] + '"' if value[:1] == "'" else value
