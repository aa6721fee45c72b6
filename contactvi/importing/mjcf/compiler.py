"""Compile an MJCF by MuJoCo, or find it compiled, and hold the result with a name for everything in it."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pinocchio as pin

from contactvi.errors import SceneError
from contactvi.files import as_a_path
from contactvi.importing.mjcf.compiled import Compiled, entry_of, meshes_of
from contactvi.importing.report import PartReport
from contactvi.importing.xml import read_xml

REMEDY = "pip install 'contactvi[mjcf]'"
_HANDLER = threading.Lock()
# The numbers of a compiled model that are read here, by what they belong to.
_NUMBERS = {
    "body": ("body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "body_gravcomp"),
    "joint": ("jnt_pos", "jnt_axis", "jnt_range", "jnt_stiffness", "jnt_actfrcrange"),
    "degree of freedom": ("dof_armature", "dof_damping", "dof_frictionloss", "qpos0", "qpos_spring"),
    "geom": ("geom_pos", "geom_quat", "geom_size", "geom_friction", "geom_solref"),
    "site": ("site_pos", "site_quat"),
    "equality": ("eq_data",),
    "tendon": ("tendon_stiffness", "tendon_damping", "tendon_lengthspring"),
    "actuator": ("actuator_gainprm", "actuator_biasprm", "actuator_gear", "actuator_ctrlrange", "actuator_forcerange"),
    "key": ("key_qpos", "key_qvel", "key_act", "key_ctrl"),
}


def import_mujoco() -> Any:
    """Return the module mujoco; raise SceneError where it is not installed."""
    try:
        import mujoco
    except ImportError as error:
        raise SceneError(
            "An MJCF is read by MuJoCo's compiler, which is not installed",
            expected="the package mujoco-core, version 4, which needs Python 3.11 or later",
            got=str(error),
            remedy=REMEDY,
        ) from None
    version = str(getattr(mujoco, "__version__", "unknown"))
    if version.partition(".")[0] != "4":
        raise SceneError(
            "An MJCF is read by MuJoCo's compiler", expected="mujoco-core, version 4", got=version, remedy=REMEDY
        )
    return mujoco


def open_source(file: Path, report: PartReport) -> Source:
    """Return the compiled model of an MJCF, from the cache on disk where it is there; warnings go to the report.

    Raises:
        SceneError: no MJCF, one that MuJoCo refuses, with its reason and the line, or one whose numbers are not finite.
    """
    # MuJoCo's own reader also takes URDF and binary models, and has no limit for the depth of a file.
    texts = _check_files(file)
    entry = entry_of(file, texts) or _new_entry_of(file, texts)
    found = None if entry is None else Compiled.found(entry, lambda: meshes_of(_compile(import_mujoco(), file)[0]))
    if found is not None:
        return Source(found, report)
    mujoco = import_mujoco()
    model, warnings = _compile(mujoco, file)
    _check_meshes(model)
    made = Compiled.of(mujoco, model, warnings, entry)
    source = Source(made, report)
    if entry is not None and entry_of(file, texts) == entry:  # no file has changed while it was compiled
        made.keep(entry)
    return source


def _new_entry_of(file: Path, texts: list[tuple[Path, bytes]]) -> str | None:
    """Return the name of the entry of a model whose files are not known yet; None where not all of them are there."""
    try:
        used = import_mujoco().mju_getXMLDependencies(str(file))
    except (ValueError, RuntimeError):  # the compiler says what is wrong
        return None
    return entry_of(file, texts, used) if all(map(os.path.isfile, used)) else None


def _compile(mujoco: Any, file: Path) -> tuple[Any, list[str]]:
    """Return the mujoco.MjModel of an MJCF, and what MuJoCo warns of."""
    try:
        with _warnings_of(mujoco) as warnings, _without_old_meshes(mujoco):
            return mujoco.MjModel.from_xml_path(str(file)), warnings
    except (ValueError, RuntimeError, MemoryError, UnicodeError) as error:
        reason = " ".join(line.strip() for line in str(error).splitlines() if line.strip()) or type(error).__name__
        raise SceneError(
            f"MuJoCo cannot compile {file.name}",
            path=file,
            expected="a model that MuJoCo loads",
            got=reason,
            remedy="Correct it where the message says; a part of a model is loaded through the file that includes it",
        ) from None


@contextmanager
def _warnings_of(mujoco: Any) -> Iterator[list[str]]:
    """Collect what MuJoCo else prints; its handler of warnings is one for the process."""
    texts: list[str] = []
    with _HANDLER:
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(texts.append)
        try:
            yield texts
        finally:
            mujoco.set_mju_user_warning(before)


@contextmanager
def _without_old_meshes(mujoco: Any) -> Iterator[None]:
    """Keep MuJoCo from taking meshes that it has read before: it knows them by the second of their last change.

    What it makes of them would be kept under the name of what they contain now.
    """
    cache = mujoco.mj_getCache()
    capacity = mujoco.mj_getCacheCapacity(cache)
    mujoco.mj_setCacheCapacity(cache, 0)
    try:
        yield
    finally:
        mujoco.mj_setCacheCapacity(cache, capacity)


def _check_meshes(model: Any) -> None:
    """Raise SceneError for vertices that are not finite."""
    bad = np.flatnonzero(~np.isfinite(model.mesh_vert).all(axis=1))
    if len(bad):
        _refuse_numbers("mesh_vert", "", model.mesh_vert[bad[0]])


def _refuse_numbers(field: str, of: str, values: Any, body: str | None = None) -> NoReturn:
    raise SceneError(
        f"The compiled model has numbers that are not finite in {field}{of}",
        body=body,
        expected="numbers whose squares and products are finite",
        got=str(values),
        remedy="Correct the sizes, places and masses behind it",
    )


def _check_files(file: Path) -> list[tuple[Path, bytes]]:
    """Return the file and all that it includes, with their contents.

    Raises:
        SceneError: one of them is no MJCF that a parser can take.
    """
    waiting, seen = [(file, read_xml(file, "mujoco", "an MJCF"))], {file: file.read_bytes()}
    while waiting:
        path, root = waiting.pop()
        if (composite := next(root.iter("composite"), None)) is not None:
            raise SceneError(
                f"{path.name} has a <composite>, which MuJoCo 4 does not read any more",
                path=path,
                expected="bodies, or a <flexcomp>",
                got=f"a composite of type {composite.get('type', 'none')!r}",
                remedy="Write its bodies out: MuJoCo 3 does so with mj_saveLastXML, and a cable is then a chain of "
                "rigid bodies; what is deformable (a <flexcomp>) is refused, unless with allow=('flex',)",
            )
        for name in (element.get("file", "") for element in root.iter("include")):
            # MuJoCo looks beside the main file.
            candidates = ((folder / name).resolve() for folder in (path.parent, file.parent))
            with as_a_path(name):
                inner = next((found for found in candidates if found.is_file()), None)
            if inner is None:
                raise SceneError(
                    f"{path.name}: no such include file",
                    path=path,
                    expected="an existing file",
                    got=repr(name),
                    remedy=f"Put it into {path.parent}, or correct the name",
                )
            if inner not in seen:
                waiting.append((inner, read_xml(inner, None, "an MJCF")))
                seen[inner] = inner.read_bytes()
    return list(seen.items())


class Source:
    """A compiled model (`m`, its fields as in MuJoCo's mjModel) with distinct names, and the report of its import.

    Attributes:
        m: the numbers of the model. meshes: its meshes.
        given: {"body" | "joint" | "geom" | "site" | "actuator" | "tendon" | "equality" | "key" | "flex" | "mesh": names
            in the file}, "" for what has none.
        names: the same with a distinct name for everything.
    """

    def __init__(self, compiled: Compiled, report: PartReport) -> None:
        m = compiled.m
        self.m, self.meshes, self.report = m, compiled.meshes, report
        self._enums = compiled.enums
        for text in compiled.warnings:
            report.note("suspicious", "file", "", f"MuJoCo: {text}")
        starts = {
            "body": m.name_bodyadr, "joint": m.name_jntadr, "geom": m.name_geomadr, "site": m.name_siteadr,
            "actuator": m.name_actuatoradr, "tendon": m.name_tendonadr, "equality": m.name_eqadr, "key": m.name_keyadr,
            "flex": m.name_flexadr, "mesh": m.name_meshadr,
        }  # fmt: skip
        texts = bytes(m.names)
        self.given = {kind: [_text_at(texts, start) for start in places] for kind, places in starts.items()}
        self.names = {kind: self._distinct(kind) for kind in starts}
        self.switched_off = int(m.opt.disableflags)
        self._check_numbers()
        self._check_rotations()

    def _check_numbers(self) -> None:
        """Raise SceneError for numbers of the compiled model that are not finite: MuJoCo's sums may overflow."""
        for kind, fields in _NUMBERS.items():
            for name in fields:
                values = np.atleast_1d(getattr(self.m, name))
                bad = np.unique(np.argwhere(~np.isfinite(values))[:, 0])
                if len(bad) == 0:
                    continue
                names = self.names.get(kind, [])
                of = f" of {kind} {names[bad[0]]!r}" if bad[0] < len(names) else ""
                _refuse_numbers(name, of, values[bad[0]], names[bad[0]] if of and kind == "body" else None)

    def _check_rotations(self) -> None:
        """Raise SceneError for quaternions of length zero: MuJoCo makes them of those whose squares overflow."""
        for kind, name in (("body", "body_quat"), ("body", "body_iquat"), ("geom", "geom_quat"), ("site", "site_quat")):
            lost = np.flatnonzero(~np.any(getattr(self.m, name), axis=1))
            if len(lost):
                self._refuse_rotation(kind, int(lost[0]))
        welds = np.asarray(self.m.eq_type) == self.number("Eq", "WELD")
        by_bodies = np.asarray(self.m.eq_objtype) == self.number("Obj", "BODY")
        lost = np.flatnonzero(welds & by_bodies & ~np.any(self.m.eq_data[:, 6:10], axis=1))
        if len(lost):
            self._refuse_rotation("equality", int(lost[0]))

    def _refuse_rotation(self, kind: str, index: int) -> NoReturn:
        name = self.names[kind][index]
        raise SceneError(
            f"The rotation of {kind} {name!r} is lost in the compiled model",
            body=name if kind == "body" else None,
            expected="a quaternion whose squares are finite",
            got="one of length 0, which MuJoCo makes of numbers above 1e154",
            remedy="Give a quaternion of length 1 in the file",
        )

    def _distinct(self, kind: str) -> list[str]:
        """Return the names of one kind; what has none is called by its kind and number, a geom by its body."""
        given = list(self.given[kind])
        taken = set(given)
        for i, name in enumerate(given):
            if name:
                continue
            base, k = f"{kind}_{i}", 0
            if kind == "geom":
                base = self.given["body"][self.m.geom_bodyid[i]] or base
                given[i] = base if base != "world" else f"{base}_0"
            else:
                given[i] = base
            while given[i] in taken:
                k += 1
                given[i] = f"{base}_{k}"
            taken.add(given[i])
        return given

    def lose(self, topic: str, name: str, text: str) -> None:
        """Note what the engine has no place for."""
        self.report.note("ignored", topic, name, text)

    def off(self, flag: str) -> bool:
        """Whether the file's <option><flag> switches something off: "CONTACT", "LIMIT", "SPRING", ..."""
        return bool(self.switched_off & self.number("DisableBit", flag))

    def number(self, enum: str, name: str) -> int:
        """Return the number of a member: number("Geom", "BOX")."""
        return self._enums[enum][name]

    def word(self, enum: str, value: int) -> str:
        """Return the name of a member in small letters: word("Geom", 6) = "box"."""
        return next(name for name, number in self._enums[enum].items() if number == int(value)).lower()


def _text_at(texts: bytes, start: int) -> str:
    """Return the text that begins at a place and ends with a zero."""
    return texts[start : texts.index(b"\0", start)].decode("utf-8", "replace")


def unit(wxyz: Any) -> np.ndarray:
    """Return a quaternion of any length above zero at length 1, shape (4,)."""
    numbers = np.asarray(wxyz, dtype=float)
    numbers = numbers / np.abs(numbers).max()  # the square of a length may overflow, or vanish
    return np.asarray(numbers / np.linalg.norm(numbers))


def rotation(wxyz: Any) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a quaternion w, x, y, z of any length above zero."""
    w, x, y, z = unit(wxyz)
    return np.asarray(pin.Quaternion(w, x, y, z).toRotationMatrix())


def pose(position: Any, wxyz: Any) -> pin.SE3:
    """Return the placement with this position [m] and quaternion w, x, y, z."""
    return pin.SE3(rotation(wxyz), np.array(position, dtype=float))
