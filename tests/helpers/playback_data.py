"""What a playback page holds, read back: its data, arrays unpacked."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import dataclass
from typing import Any

import numpy as np


def unpacked(entry: dict[str, str]) -> np.ndarray:
    """The numbers of an array of the page, as one row."""
    return np.frombuffer(base64.b64decode(entry["data"]), "<" + entry["type"])


def run_data(page: str) -> dict[str, Any]:
    """The data of a page."""
    found = re.search(r'<script type="application/json" id="run">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found.group(1))


@dataclass(frozen=True)
class PageEvents:
    """The list of events of a page: words for kinds, pairs of names, arrays (n,) and (n, 3)."""

    kind: list[str]
    pair: list[tuple[str, str]]
    time: np.ndarray
    impulse: np.ndarray
    count: np.ndarray
    point: np.ndarray
    direction: np.ndarray

    @classmethod
    def of(cls, page: str) -> PageEvents:
        data = run_data(page)["events"]
        return cls(
            [data["kinds"][k] for k in unpacked(data["kind"])],
            [tuple(data["names"][k]) for k in unpacked(data["name"])],
            *(unpacked(data[name]) for name in ("time", "impulse", "count")),
            *(unpacked(data[name]).reshape(-1, 3) for name in ("point", "direction")),
        )
