"""The calls that make a scene are noted as entries of a scene file that makes it again (contactvi.scene.written)."""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin

from contactvi.errors import InputError, SceneError
from contactvi.inputs import pose
from contactvi.scene.selection import PartHandle
from contactvi.scene.toml_tables import ELEMENTS, KEYS, LISTS
from contactvi.scene.toml_text import RelativePath

Class = TypeVar("Class", bound=type)
PARTS = LISTS[: LISTS.index("joint")]
_SECTIONS = {  # method -> section
    **{f"add_{section}": section for section in (*PARTS, *ELEMENTS)},
    **{f"set_{section}": section for section in ("joint", "servo", "actuator", "compliance", "surface_velocity")},
    "add_joint_equality": "equality",
    "prescribe": "prescribe",
}
_SOLIDS = ("add_torus", "add_superellipsoid", "add_thread", "add_solid")
_OTHERS = (  # methods that are noted, too
    "set_contact", "disable_pair", "enable_pair", "disable_overlapping", "remove", "add_surface", "add_potential",
    "add_force", "set_surface", "add_model", *_SOLIDS,
)  # fmt: skip


class Entry(NamedTuple):
    """A table of a scene file: the section and its keys; lost: what of the call no file can hold, None for nothing."""

    section: str
    keys: dict[str, Any]
    lost: str | None = None


class Notes:
    """What was called on a scene, as entries of a scene file, in order.

    Attributes:
        lost: why no file can hold the scene, whatever the entries are; None for nothing.
    """

    def __init__(self, entries: Sequence[Entry] = (), lost: str | None = None) -> None:
        self.entries, self.lost, self._depth = list(entries), lost, 0

    def copy(self) -> Notes:
        """Return notes that go on by themselves."""
        return Notes(self.entries, self.lost)

    def call(self, method: Callable[..., Any], scene: Any, arguments: Sequence[Any], named: Mapping[str, Any]) -> Any:
        """Call a method of the scene, and note it unless it is called by another one or fails."""
        self._depth += 1
        try:
            result = method(scene, *arguments, **named)
        finally:
            self._depth -= 1
        if self._depth == 0:
            given = inspect.signature(method).bind(scene, *arguments, **named).arguments
            self._note(method.__name__, dict(list(given.items())[1:]), result)
        return result

    def _note(self, method: str, given: dict[str, Any], result: Any) -> None:
        if method == "remove":
            self.entries = [entry for entry in self.entries if not _is_element(entry, given["name"])]
        elif method == "disable_overlapping":
            self.entries += [Entry("contact.disable", {"pair": list(pair)}) for pair in result]
        elif method in ("disable_pair", "enable_pair"):
            pair = [plain(given[end]) for end in ("a", "b")]
            self.entries.append(Entry(f"contact.{method.removesuffix('_pair')}", {"pair": pair}))
        elif method in _SECTIONS or method == "set_contact":
            section = _SECTIONS.get(method) or _contact_section(given)
            self.entries.append(_entry(method, section, given, result))
        else:
            keys = {"name": result} if isinstance(result, str) else {}
            why = "has no section in scene files" if method in _SOLIDS else "takes functions or a model"
            self.entries.append(Entry(method, keys, f"{method}({_first(given)}), which {why}"))


def _is_element(entry: Entry, name: str) -> bool:
    """Return whether an entry is that of the element of this name."""
    return entry.section in (*ELEMENTS, "add_potential", "add_force") and entry.keys.get("name") == name


def noted(cls: Class) -> Class:
    """Let the methods of a class that change a scene be noted."""
    for name in (*_SECTIONS, *_OTHERS):
        if inspect.isfunction(vars(cls).get(name)):
            setattr(cls, name, _noted(vars(cls)[name]))
    return cls


def _noted(method: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(method)
    def call(self: Any, *arguments: Any, **named: Any) -> Any:
        return self._notes.call(method, self, arguments, named)

    return call


def _contact_section(given: dict[str, Any]) -> str:
    if given.get("b") is not None:
        return "contact.pair"
    return "contact" if given.get("a") is None else "contact.body"


def _entry(method: str, section: str, given: dict[str, Any], result: Any) -> Entry:
    """Return the entry of a call; given: its arguments by name."""
    keys: dict[str, Any] = {}
    try:
        for name, value in given.items():
            if value is None:
                continue
            if name == "placement":
                keys |= _place(value)
            elif name == "mesh":
                keys["path"] = _path(value)
            elif name == "heights" and not isinstance(value, (str, os.PathLike)):
                keys["heights"] = plain(np.asarray(value))
            elif name == "heights":
                keys["path"] = _path(value)
            elif name in ("path", "srdf"):
                keys[name] = _path(getattr(value, "path", value))
            elif name == "package_dirs":
                keys[name] = [_path(value)] if isinstance(value, (str, os.PathLike)) else [_path(one) for one in value]
            elif name in ("frame_a", "frame_b"):
                keys[name] = _place(value)
            else:
                keys[name] = plain(value)
    except InputError as error:
        return Entry(section, keys, f"{method}({_first(given)}): {name} is {error.got}")
    if section == "joint":
        keys = {"name": keys.pop("joint"), **keys}
    elif section == "contact.body":
        keys = {"name": keys.pop("a"), **keys}
    if section in ELEMENTS and isinstance(result, str):
        keys["name"] = result
    unknown = [name for name in keys if name not in KEYS[section]]
    return Entry(section, keys, f"{method}({_first(given)}): {unknown[0]}" if unknown else None)


def _first(given: Mapping[str, Any]) -> str:
    first = next(iter(given.values()), "")
    return repr(first) if isinstance(first, str) else ""


def _path(value: Any) -> str:
    if not isinstance(value, (str, os.PathLike)):
        raise _unwritable("an array, and no file")
    text = str(os.fspath(value))
    given = "://" in text or os.path.isabs(text) or text.startswith("~")
    return text if given else RelativePath(os.path.abspath(text))


def _place(value: Any) -> dict[str, Any]:
    placement = pose("placement", value, told=True)
    turn = pin.rpy.matrixToRpy(placement.rotation)
    place = {"xyz": placement.translation.tolist()}
    return place | ({"rpy": turn.tolist()} if np.any(turn) else {})


def plain(value: Any) -> Any:
    """Return a value as plain data; raise InputError where it cannot be written."""
    if isinstance(value, (str, bool, int, float)):
        return value
    if isinstance(value, PartHandle):
        return value.name
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, pin.SE3):
        return pin.SE3ToXYZQUAT(value).tolist()
    if isinstance(value, Mapping):
        return {plain(name): plain(inner) for name, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(inner) for inner in value]
    raise _unwritable(f"a {type(value).__name__}" if not callable(value) else "a function")


def _unwritable(got: str) -> InputError:
    return InputError(
        "This cannot be written", expected="numbers, names, lists and the paths of files", got=got,
        remedy="Leave it out, and add it in Python after load_scene",
    )  # fmt: skip


def notes_of_file(data: Mapping[str, Any], folder: Path) -> Notes:
    """Return the notes of a scene that was read from the data of a file in this folder."""
    head = {name: data["scene"][name] for name in ("title", "description") if name in data.get("scene", {})}
    entries = [Entry("scene", head)]
    for section in (*part_order(data), *(name for name in LISTS if name not in PARTS)):
        taken = sum(entry.section == section for entry in entries)
        rows = data.get(section, ())
        for row in rows[taken : taken + 1] if section in PARTS else rows:
            keys = {name: _in_folder(folder, name, value) for name, value in row.items()}
            entries.append(Entry(section, keys))
    contact = data.get("contact", {})
    entries.append(Entry("contact", {name: contact[name] for name in contact if name not in _LISTED}))
    for name in ("disable", "enable"):
        entries += [Entry(f"contact.{name}", {"pair": list(pair)}) for pair in contact.get(name, ())]
    for name in ("body", "pair"):
        entries += [Entry(f"contact.{name}", dict(row)) for row in contact.get(name, ())]
    return Notes(entries)


_LISTED = ("disable", "enable", "body", "pair")


def _in_folder(folder: Path, name: str, value: Any) -> Any:
    """Return a path of a file in this folder as one from anywhere; other values as they are."""
    if name == "package_dirs":
        return [_in_folder(folder, "path", one) for one in value]
    if name not in ("path", "srdf") or "://" in value or os.path.isabs(value) or value.startswith("~"):
        return value
    there = folder / value
    return RelativePath(there.resolve()) if there.exists() else value


def part_order(data: Mapping[str, Any]) -> list[str]:
    """Return the sections of the parts of a file's data in the order in which they are added, each as often as it is.

    Raises:
        SceneError: for an order that names other sections.
    """
    usual = [section for section in PARTS for _ in data.get(section, ())]
    order = data.get("scene", {}).get("order")
    if order is None:
        return usual
    if not isinstance(order, list) or sorted(map(str, order)) != sorted(usual):
        raise SceneError(
            "The order of the parts does not fit them", expected=f"these in some order: {', '.join(usual)}",
            got=repr(order), remedy="Name in [scene] order each section as often as it has entries, or remove it",
        )  # fmt: skip
    return [str(section) for section in order]
