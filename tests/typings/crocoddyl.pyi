# pinocchio has no type information: its names come from a compiled module, where pyright does not see them.
from typing import Any

def __getattr__(name: str) -> Any: ...
