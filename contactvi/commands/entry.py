"""Where the program `contactvi` starts: Ctrl-C ends it with the exit code 130, also while its modules are loaded."""

import sys


def main() -> None:
    """Run the command line."""
    try:
        from contactvi.commands.cli import app

        app()
    except KeyboardInterrupt:
        sys.stderr.write("Aborted.\n")
        sys.exit(130)
