"""The size of a picture, as users give it."""

from __future__ import annotations

import re
from typing import Any

from contactvi.errors import InputError
from contactvi.inputs import count, entries, short

MAX_SIDE = 4096  # [pixels]: twice that is the largest picture that a browser draws


def picture_size(size: Any, even: bool = False) -> tuple[int, int]:
    """Return width and height in pixels; even: films need even numbers. Raises InputError."""
    parts: Any = size
    if isinstance(size, str):
        found = re.fullmatch(r"\s*(\d{1,6})\s*[xX]\s*(\d{1,6})\s*", size)
        parts = None if found is None else (int(found[1]), int(found[2]))
    parts = entries(parts) or ()
    if len(parts) != 2:
        raise InputError(
            "Size of a picture", name="size", expected='two numbers of pixels, or "800x600"', got=short(size),
            remedy="Use size=(800, 600)",
        )  # fmt: skip
    width, height = (count("size", part) for part in parts)
    odd = even and (width % 2 or height % 2)
    if max(width, height) > MAX_SIDE or min(width, height) < 16 or odd:
        raise InputError(
            "Size of a picture", name="size",
            expected=f"{'even ' if odd else ''}numbers of pixels from 16 to {MAX_SIDE}",
            got=f"{width}x{height}", remedy="Use size=(800, 600)",
        )  # fmt: skip
    return width, height
