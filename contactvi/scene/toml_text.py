"""Values as TOML."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.importing.joint_kinds import joint_kind

FILES = ("path", "srdf")


class RelativePath(str):
    """The absolute path of a file that was given by a relative one: scene files have it relative to their folder."""


def toml_value(key: str, value: Any, folder: Path) -> str:
    """Return the value of a key; relative paths become relative to the folder of the scene file."""
    if key in FILES:
        return toml_string(_from(folder, value))
    if key == "package_dirs":
        return "[" + ", ".join(toml_string(_from(folder, entry)) for entry in value) + "]"
    return toml(value)


def toml_key(name: str) -> str:
    """Return a key, in quotes where it needs some."""
    return name if name.isascii() and name.replace("_", "").replace("-", "").isalnum() else toml_string(name)


def toml(value: Any) -> str:
    """Return plain data, lists and dicts among them, as TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{toml_key(key)} = {toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    return toml_string(value) if isinstance(value, str) else repr(value)


def toml_string(text: str) -> str:
    """Return a string as TOML's basic string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def toml_page(title: str, tables: Sequence[tuple[str, Mapping[str, Any]]], folder: Path) -> str:
    """Return a scene file of these tables: header with its brackets, keys and values."""
    lines = [f"# {title} SI units, radians."]
    for header, keys in tables:
        lines += ["", header, *(f"{toml_key(key)} = {toml_value(key, value, folder)}" for key, value in keys.items())]
    return "\n".join(lines) + "\n"


def value_in_file(joint: pin.JointModel, q: Sequence[float] | np.ndarray) -> Any:
    """Return the numbers of a joint, q (nq,), as scene files have them."""
    if joint.nv == 1:
        return float(q[0]) if joint.nq == 1 else math.atan2(q[1], q[0])
    if joint_kind(joint) == "planar":
        return [float(q[0]), float(q[1]), math.atan2(q[3], q[2])]
    return [float(value) for value in q]


def _from(folder: Path, path: str) -> str:
    if isinstance(path, RelativePath):
        return os.path.relpath(path, folder)
    if "://" in path or os.path.isabs(path) or path.startswith("~"):
        return path
    return os.path.relpath(os.path.abspath(path), folder)
