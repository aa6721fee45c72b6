"""What a playback page holds, read back: drawing commands, the words, the tracks of the animation."""

from __future__ import annotations

import base64
import json
import re

import numpy as np
import umsgpack

FLOAT_ARRAY = 0x17  # meshcat's code of a Float32Array


def commands(page: str) -> list[dict]:
    """The meshcat commands of a page, unpacked."""
    found = re.search(r"for \(const command of (\[.*?\])\) \{", page)
    assert found is not None
    return [umsgpack.unpackb(base64.b64decode(text)) for text in json.loads(found.group(1))]


def run_data(page: str) -> dict:
    found = re.search(r"^const run = (.*);$", page, re.MULTILINE)
    assert found is not None
    return json.loads(found.group(1))


def tracks(page: str) -> dict[str, dict[str, dict]]:
    """path -> track name -> track, arrays unpacked."""
    animations = next(command["animations"] for command in commands(page) if command["type"] == "set_animation")
    found: dict[str, dict[str, dict]] = {}
    for item in animations:
        assert item["clip"]["fps"] == 1  # times are seconds
        for track in item["clip"]["tracks"]:
            values = track["values"]
            track["times"] = np.frombuffer(track["times"].data, np.float32)
            track["values"] = np.frombuffer(values.data, np.float32) if isinstance(values, umsgpack.Ext) else values
            found.setdefault(item["path"], {})[track["name"]] = track
    return found
