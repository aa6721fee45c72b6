"""Pinocchio's names are made by its compiled module: pyright finds none of them in its source."""

from typing import Any

def __getattr__(name: str) -> Any: ...
