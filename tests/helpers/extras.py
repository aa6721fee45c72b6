"""Packages that some tests need and the test extra does not bring, because they are large or not for every Python."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

import pytest


def extra(name: str) -> Any:
    """A package; skip where it is missing, an error where CONTACTVI_TEST_EXTRAS says that it is there (.ci/run)."""
    if "CONTACTVI_TEST_EXTRAS" in os.environ:
        return importlib.import_module(name)
    return pytest.importorskip(name)


NO_MUJOCO = "mujoco-core has no version for Python 3.10"
needs_mujoco = pytest.mark.skipif(sys.version_info < (3, 11), reason=NO_MUJOCO)


def mujoco_module() -> Any:
    """The module mujoco, for modules of tests, which are skipped under Python 3.10; elsewhere it has to be there."""
    if sys.version_info < (3, 11):
        pytest.skip(NO_MUJOCO, allow_module_level=True)
    return importlib.import_module("mujoco")
