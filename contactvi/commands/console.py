"""What all commands share: where they print, how they report errors, their exit codes."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.markup import escape

from contactvi.errors import ContactviError, InputError

FAILED, WRONG_INPUT, ENDED_EARLY, NO_DERIVATIVE = 1, 2, 3, 4
out = Console(highlight=False, soft_wrap=True)
err = Console(stderr=True, highlight=False, soft_wrap=True)


def print_error(error: ContactviError) -> None:
    """Print an error as what happened, expected, got, remedy."""
    err.print(f"[bold red]Error:[/] {escape(error.what)}")
    for name in ("expected", "got", "remedy"):
        err.print(f"  [bold]{name + ':':<10}[/]{escape(str(getattr(error, name)))}")


def make_folder(folder: Path) -> None:
    """Make the folder for the results.

    Raises:
        InputError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"Cannot make the folder {folder}",
            name="output",
            expected="a folder that can be written",
            got=error.strerror,
            remedy="Choose another with -o",
        ) from error
