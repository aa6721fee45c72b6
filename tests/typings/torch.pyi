# PyTorch is large, and not there where the examples are checked: here it has no types.
from typing import Any, TypeAlias

Tensor: TypeAlias = Any

def __getattr__(name: str) -> Any: ...
