"""What all commands share: where they print, how they report errors, their exit codes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from contactvi.errors import ContactviError, InputError, OverwriteError
from contactvi.words import in_flags

FAILED, WRONG_INPUT, ENDED_EARLY, NO_DERIVATIVE = 1, 2, 3, 4
out = Console(highlight=False, soft_wrap=True)
err = Console(stderr=True, highlight=False, soft_wrap=True)


def print_error(error: ContactviError, flags: Mapping[str, str] | None = None) -> None:
    """Print an error as what happened, expected, got, remedy.

    Args:
        flags: of the command, by the names of their arguments: the texts are put in its words.
    """
    err.print(f"[bold red]Error:[/] {escape(error.what)}")
    for name in ("expected", "got", "remedy"):
        text = str(getattr(error, name))
        shown = text if flags is None or name == "got" else in_flags(text, flags)
        err.print(f"  [bold]{name + ':':<10}[/]{escape(shown)}")


FORCE = "Replace files that are there."
Force = Annotated[bool, typer.Option("--force", help=FORCE)]


def make_folder(folder: Path, names: Sequence[str] = (), force: bool = True) -> None:
    """Make the folder for the results, of which these are the names.

    Raises:
        OverwriteError: some of them are there, without `force`. InputError: the folder cannot be made.
    """
    there = [name for name in names if (folder / name).exists()]
    if there and not force:
        raise OverwriteError(
            f"The folder {folder} has results of something else", path=folder / there[0],
            expected="a folder without them, or --force", got=", ".join(there),
            remedy="Choose another folder with -o, or replace them with --force",
        )  # fmt: skip
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"Cannot make the folder {folder}",
            name="output",
            expected="a folder that can be written",
            got="a file of this name" if folder.exists() else error.strerror,
            remedy="Choose another with -o",
        ) from error
