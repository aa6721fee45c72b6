"""Arrays in a page: little-endian numbers in base64, with what they are."""

from __future__ import annotations

import base64

import numpy as np
from numpy.typing import ArrayLike

_MOST = float(np.finfo(np.float32).max)


def packed(values: ArrayLike, kind: str) -> dict[str, str]:
    """Return numbers as data of JSON; `kind` is NumPy's code of f4, f8, i2, i4, u1, u2 or u4.

    Single precision keeps what is beyond its range as the largest number in it.
    """
    array = np.asarray(values)
    assert array.dtype.kind != "f" or np.isfinite(array).all()
    if kind == "f4":
        array = np.clip(array, -_MOST, _MOST)
    data = np.ascontiguousarray(array, "<" + kind).tobytes()
    return {"type": kind, "data": base64.b64encode(data).decode("ascii")}
