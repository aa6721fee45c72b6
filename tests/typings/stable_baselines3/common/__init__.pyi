"""Stable-Baselines3 is not installed where the examples are checked."""

from typing import Any

def __getattr__(name: str) -> Any: ...
