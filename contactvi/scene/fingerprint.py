"""The fingerprint of a scene: equal for equal scenes, however and wherever they were made."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

_OF_A_RUN = ("settings", "q0", "v0", "camera")  # not of the system that is simulated
_PAIRS = ("pairs", "pair_restitution", "pair_friction", "neutral_overlaps")


def fingerprint(data: Mapping[str, Any]) -> str:
    """Return a hash of the plain data of a scene (`Scene.to_dict`), without start, settings and camera.

    Which of the pairs that overlap at the neutral pose are tested is decided by the start of a run, and does not count.
    """
    system = {name: value for name, value in data.items() if name not in (*_OF_A_RUN, *_PAIRS)}
    tested = zip(data["pairs"], data["pair_restitution"], data["pair_friction"], strict=True)
    pairs = [[*pair, *map(float, values)] for pair, *values in tested]
    pairs += [
        [*row["pair"], float(row["restitution"]), float(row["friction"])] for row in data.get("neutral_overlaps", ())
    ]
    system["pairs"] = sorted({json.dumps(pair) for pair in pairs})
    return hashlib.sha256(json.dumps(system, sort_keys=True, default=_plain).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Return what JSON can hold in place of an array or a number of NumPy."""
    if isinstance(value, np.ndarray):
        return [str(value.dtype), list(value.shape), hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()]
    return value.item()
