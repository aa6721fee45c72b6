"""Packages that some tests need and the test extra does not bring, because they are large."""

from __future__ import annotations

import importlib
import os
from typing import Any

import pytest


def extra(name: str) -> Any:
    """A package; skip where it is missing, an error where CONTACTVI_TEST_EXTRAS says that it is there (.ci/run)."""
    if "CONTACTVI_TEST_EXTRAS" in os.environ:
        return importlib.import_module(name)
    return pytest.importorskip(name)
