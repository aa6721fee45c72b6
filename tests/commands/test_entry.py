"""The start of the program: an import that Ctrl-C cuts short ends it as Ctrl-C does, another failure does not."""

from __future__ import annotations

import subprocess
import sys

import pytest

from contactvi.commands import cli, entry


def _cut_short() -> None:
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as error:
        raise ImportError("initialization failed") from error


def test_an_import_that_is_cut_short_is_an_interrupt(monkeypatch, capsys):
    monkeypatch.setattr(cli, "app", _cut_short)
    with pytest.raises(SystemExit) as ended:
        entry.main()
    assert ended.value.code == 130
    assert capsys.readouterr().err == "Aborted.\n"


def test_it_is_a_module_too():
    """`python -m contactvi` is the same program."""
    run = subprocess.run([sys.executable, "-m", "contactvi", "--version"], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("contactvi ")


def test_a_module_that_is_missing_is_told(monkeypatch):
    def missing() -> None:
        raise ImportError("no such module")

    monkeypatch.setattr(cli, "app", missing)
    with pytest.raises(ImportError, match="no such module"):
        entry.main()
