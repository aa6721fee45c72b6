"""Long lists of cases: a few of them run always, the others on request."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def every(n: int, cases: Iterable[Any]) -> list[Any]:
    """Every n-th case as it is; the others are marked long. A case is an argument, or a tuple of them."""

    def marked(case: Any) -> Any:
        return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.long)

    return [marked(case) if k % n else case for k, case in enumerate(cases)]
