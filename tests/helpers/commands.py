"""The command line as a process of its own, as a user's shell starts it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import contactvi

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]


def program() -> list[str]:
    """The arguments that start the command line: what the console script of an installation does."""
    project = ROOT / "pyproject.toml"
    if project.is_file():
        entry = tomllib.loads(project.read_text())["project"]["scripts"]["contactvi"]
    else:
        entry = next(point.value for point in entry_points(group="console_scripts") if point.name == "contactvi")
    module, _, name = entry.partition(":")
    return [sys.executable, "-c", f"import sys; from {module} import {name}; sys.exit({name}())"]


def environment() -> dict[str, str]:
    """That of this process, with the package that it uses."""
    return {**os.environ, "PYTHONPATH": str(Path(contactvi.__file__).parents[1]), "COLUMNS": "200"}


def start(arguments: list[str], folder: Path, **options: Any) -> subprocess.Popen[str]:
    """Start a program in a folder, its output in pipes. Ctrl-C reaches it even where this process ignores it."""
    return subprocess.Popen(
        arguments, cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL), **options,
    )  # fmt: skip
