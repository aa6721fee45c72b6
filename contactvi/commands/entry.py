"""Where the program `contactvi` starts: Ctrl-C ends it with the exit code 130, also while its modules are loaded."""

import signal
import sys


def main() -> None:
    """Run the command line."""
    pressed: list[bool] = []
    former = signal.getsignal(signal.SIGINT)
    if former is signal.default_int_handler:  # a module whose import is cut short may fail with another error, or crash
        signal.signal(signal.SIGINT, lambda number, frame: pressed.append(True))
    try:
        from contactvi.commands.cli import app

        signal.signal(signal.SIGINT, former)
        if pressed:
            raise KeyboardInterrupt
        app()
    except (KeyboardInterrupt, ImportError) as error:
        if not _is_interrupt(error):
            raise
        sys.stderr.write("Aborted.\n")
        sys.exit(130)


def _is_interrupt(error: BaseException | None) -> bool:
    """Return whether Ctrl-C caused an error: an import that it cuts short may end with another one."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None
