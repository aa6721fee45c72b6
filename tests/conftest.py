"""What every test shares: the gate of the browser tests."""

from __future__ import annotations

import os
import shutil

import pytest


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
