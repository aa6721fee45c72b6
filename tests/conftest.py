"""What every test shares: the gate of the browser tests, and the command line run in an empty folder."""

from __future__ import annotations

import math
import os
import shutil
import tempfile

import pytest

_CACHE = tempfile.TemporaryDirectory(prefix="contactvi-tests-")


def pytest_configure() -> None:
    """Keep the tests away from the user's cache; processes that test side by side share one."""
    os.environ.setdefault("CONTACTVI_TESTS_CACHE", _CACHE.name)
    os.environ["CONTACTVI_CACHE"] = os.environ["CONTACTVI_TESTS_CACHE"]


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as slow what `thinned(n)` leaves out: all but every n-th of the sets of parameters of a test.

    Of a test with every combination of some parameters they are counted along the sums of their places, as in a Latin
    square, so that what is kept mixes all values.
    """
    tests: dict[object, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("thinned") is not None and item.get_closest_marker("long") is None:
            tests.setdefault((item.path, item.originalname), []).append(item)
    for same in tests.values():
        values: dict[str, dict[int, int]] = {}  # of each parameter: value -> place
        for item in same:
            for name, value in item.callspec.params.items():
                values.setdefault(name, {}).setdefault(id(value), len(values[name]))
        combined = math.prod(map(len, values.values())) == len(same)
        for k, item in enumerate(same):
            place = sum(values[name][id(value)] for name, value in item.callspec.params.items()) if combined else k
            if place % item.get_closest_marker("thinned").args[0]:
                item.add_marker(pytest.mark.slow)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Tests marked `browser` need chromium and chromedriver: skipped without them, but never silently under CI."""
    if item.get_closest_marker("browser") is None:
        return
    missing = [program for program in ("chromium", "chromedriver") if shutil.which(program) is None]
    if not missing:
        return
    message = f"not found: {', '.join(missing)} (Debian packages chromium and chromium-driver)"
    if os.environ.get("CI") == "true":
        pytest.fail(f"CI=true, but the browser is {message}", pytrace=False)
    pytest.skip(message)


@pytest.fixture
def command(tmp_path, monkeypatch):
    """Run a command in an empty folder; returns the result with .exit_code, .stdout and .stderr."""
    # Imported here: most tests need no command line.
    from typer.testing import CliRunner

    from contactvi.commands.cli import app

    monkeypatch.chdir(tmp_path)
    # Wide enough that no line is broken, whatever terminal the tests run in.
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments: object):
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        return result

    return run
