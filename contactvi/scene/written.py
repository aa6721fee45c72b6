"""Scenes as scene files: the entries that were noted are written, read again and compared.

So what is written is the scene, or an error says what of it no file holds.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.errors import ContactviError, SceneError
from contactvi.files import check_free, write_atomic
from contactvi.scene.notes import PARTS, Entry, Notes, plain
from contactvi.scene.toml_entries import fill
from contactvi.scene.toml_tables import ELEMENTS, check_keys
from contactvi.scene.toml_text import toml_page, value_in_file

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Scene = Any  # contactvi.Scene, which uses this module
_CLOSE = 1e-12  # numbers of a scene and of its file: turns are written as angles


def save_scene(scene: Scene, notes: Notes, path: str | os.PathLike[str], overwrite: bool = False) -> Path:
    """Write a scene, which was made by the calls in the notes, as a scene file; return its path. See `Scene.save`."""
    target = check_free(path, overwrite)
    lost = [notes.lost] if notes.lost else [entry.lost for entry in notes.entries if entry.lost]
    if lost:
        raise _not_written(target, lost[0])
    folder = Path(os.path.realpath(target)).parent
    text = toml_page("Written by Scene.save.", _tables(scene, notes.entries), folder)
    read = type(scene)(scene.gravity)
    try:
        data = tomllib.loads(text)
        check_keys(data, target)
        fill(read, data, folder / target.name)
    except ContactviError as error:
        raise _not_written(target, f"what its file does not load: {error}") from error
    different = _difference(scene, read)
    if different is not None:
        raise _not_written(target, f"{different}, which a file would change")
    return write_atomic(target, lambda file: file.write(text.encode("utf-8")), overwrite)


def _not_written(path: Path, what: str) -> SceneError:
    return SceneError(
        "The scene has what no scene file holds", path=path,
        expected="models and meshes from files, shapes, joints, contacts, elements with numbers", got=what,
        remedy="Leave it out and add it in Python after load_scene; pickle and the npz of a run keep more",
    )  # fmt: skip


def _tables(scene: Scene, entries: Sequence[Entry]) -> list[tuple[str, Mapping[str, Any]]]:
    parts = [entry for entry in entries if entry.section in PARTS]
    order = [entry.section for entry in parts]
    head: dict[str, Any] = {}
    for entry in entries:
        head |= entry.keys if entry.section == "scene" else {}
    head["gravity"] = scene.gravity.tolist()
    if scene.camera is not None:
        head["camera"] = scene.camera
    if order != sorted(order, key=PARTS.index):
        head["order"] = order
    tables: list[tuple[str, Mapping[str, Any]]] = [("[scene]", head)]
    tables += [(f"[[{entry.section}]]", entry.keys) for entry in parts]
    contact: dict[str, Any] = {}
    for entry in entries:
        if entry.section == "contact":
            contact |= entry.keys
        elif entry.section in ("contact.disable", "contact.enable"):
            contact.setdefault(entry.section.partition(".")[2], []).append(entry.keys["pair"])
    tables += [("[contact]", contact)] if contact else []
    for section in ("contact.body", "contact.pair", "joint", *ELEMENTS):
        tables += [(f"[[{section}]]", entry.keys) for entry in entries if entry.section == section]
    tables += _start(scene)
    settings = {name: value for name, value in scene.settings.items() if value is not None and name != "ledger"}
    tables += [("[run]", plain(settings))] if settings else []
    ledger = scene.settings.get("ledger")
    return [*tables, ("[run.ledger]", plain(dict(ledger)))] if ledger else tables


def _start(scene: Scene) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the tables of the start: joints whose value is not the neutral one, and those that move."""
    model, neutral = scene.model, scene.neutral()
    q = neutral if scene.q0 is None else np.asarray(scene.q0)
    v = np.zeros(model.nv) if scene.v0 is None else np.asarray(scene.v0)
    values: dict[str, Any] = {}
    speeds: dict[str, Any] = {}
    for joint, name in zip(list(model.joints)[1:], list(model.names)[1:], strict=True):
        own, moving = slice(joint.idx_q, joint.idx_q + joint.nq), slice(joint.idx_v, joint.idx_v + joint.nv)
        if not np.array_equal(q[own], neutral[own]):
            values[str(name)] = value_in_file(joint, q[own])
        if np.any(v[moving]):
            speeds[str(name)] = _speed(joint, q[own], v[moving])
    return [(f"[initial.{key}]", table) for key, table in (("q", values), ("v", speeds)) if table]


def _speed(joint: pin.JointModel, q: np.ndarray, v: np.ndarray) -> Any:
    """Return the velocity of a joint as scene files have it: of a free body in world axes."""
    if joint.nv == 6:
        turn = pin.XYZQUATToSE3(q).rotation
        return [(turn @ v[:3]).tolist(), (turn @ v[3:]).tolist()]
    return float(v[0]) if joint.nv == 1 else v.tolist()


def _difference(scene: Scene, read: Scene) -> str | None:
    """Return what of a scene is not what was read from its file, None where they are equal."""
    one, other = scene.to_dict(), read.to_dict()
    for data, of in ((one, scene), (other, read)):
        data["q0"] = of.neutral().tolist() if of.q0 is None else data["q0"]
        data["v0"] = np.zeros(of.nv).tolist() if of.v0 is None else data["v0"]
        data["elements"] = sorted(data["elements"], key=lambda element: str(element["name"]))
        data["settings"] = {name: value for name, value in data["settings"].items() if value is not None}
    return next((name for name in one if not _equal(one[name], other.get(name))), None)


def _equal(one: Any, other: Any) -> bool:
    """Return whether plain data are equal, numbers to rounding."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_equal(one[name], other[name]) for name in one)
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.shape(one) == np.shape(other) and np.allclose(one, other, rtol=_CLOSE, atol=_CLOSE)
    if isinstance(one, (list, tuple)) and isinstance(other, (list, tuple)):
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, float) or isinstance(other, float):
        numbers = isinstance(one, (int, float)) and isinstance(other, (int, float))
        return numbers and bool(np.isclose(one, other, rtol=_CLOSE, atol=_CLOSE, equal_nan=True))
    return bool(one == other)
