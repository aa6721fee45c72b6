"""The families of cases. Each is a module with `draw`, which makes a case of draws, and `attempt`, which tries it."""

from __future__ import annotations

import importlib
from typing import Protocol

from fuzz.draws import Case, Draws

NAMES = ("urdf", "mjcf", "scene_file", "stored_run", "mesh", "arguments", "derivatives")


class Family(Protocol):
    """What the module of a family has."""

    def draw(self, d: Draws) -> Case:
        """Return a case: plain data, from which alone it can be made again."""

    def attempt(self, case: Case) -> bool:
        """Try it in the present, empty folder; return whether a run made steps. Raises what the package raises."""


def load(name: str) -> Family:
    """Return the module of a family."""
    return importlib.import_module(f"fuzz.{name}_cases")  # type: ignore[return-value]
