"""Compile an MJCF by MuJoCo, and hold the result with a name for everything in it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pinocchio as pin

from contactvi.errors import SceneError
from contactvi.files import as_a_path
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
    "mesh": ("mesh_vert",),
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


def compile_file(mujoco: Any, file: Path, report: PartReport) -> Any:
    """Return the mujoco.MjModel of an MJCF; what MuJoCo warns of goes to the report.

    Raises:
        SceneError: no MJCF, or one that MuJoCo refuses, with its reason and the line.
    """
    # MuJoCo's own reader also takes URDF and binary models, and has no limit for the depth of a file.
    _check_files(file)
    try:
        with _warnings_go_to(mujoco, report):
            return mujoco.MjModel.from_xml_path(str(file))
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
def _warnings_go_to(mujoco: Any, report: PartReport) -> Iterator[None]:
    """Collect what MuJoCo else prints; its handler of warnings is one for the process."""
    with _HANDLER:
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda text: report.note("suspicious", "file", "", f"MuJoCo: {text}"))
        try:
            yield
        finally:
            mujoco.set_mju_user_warning(before)


def _check_files(file: Path) -> None:
    """Raise SceneError where the file, or one that it includes, is no MJCF that a parser can take."""
    waiting, seen = [(file, read_xml(file, "mujoco", "an MJCF"))], {file}
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
                seen.add(inner)
                waiting.append((inner, read_xml(inner, None, "an MJCF")))


class Source:
    """A compiled model (`m`, its fields as in MuJoCo's mjModel) with distinct names, and the report of its import.

    Attributes:
        mujoco: the module.
        m: mujoco.MjModel.
        names: {"body" | "joint" | "geom" | "site" | "actuator" | "tendon" | "equality" | "key" | "flex": names}.
    """

    def __init__(self, mujoco: Any, m: Any, report: PartReport) -> None:
        self.mujoco, self.m, self.report = mujoco, m, report
        counts = {
            "body": m.nbody, "joint": m.njnt, "geom": m.ngeom, "site": m.nsite, "actuator": m.nactuator,
            "tendon": m.ntendon, "equality": m.neq, "key": m.nkey, "flex": m.nflex,
        }  # fmt: skip
        self.names = {kind: self._distinct(kind, count) for kind, count in counts.items()}
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
                raise SceneError(
                    f"The compiled model has numbers that are not finite in {name}{of}",
                    body=names[bad[0]] if of and kind == "body" else None,
                    expected="numbers whose squares and products are finite",
                    got=str(values[bad[0]]),
                    remedy="Correct the sizes, places and masses behind it",
                )

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

    def _distinct(self, kind: str, count: int) -> list[str]:
        """Return the names of one kind; what has none is called by its kind and number, a geom by its body."""
        number = getattr(self.mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
        given = [self.mujoco.mj_id2name(self.m, number, i) or "" for i in range(count)]
        taken = set(given)
        for i, name in enumerate(given):
            if name:
                continue
            base, k = f"{kind}_{i}", 0
            if kind == "geom":
                base = self.mujoco.mj_id2name(self.m, self.mujoco.mjtObj.mjOBJ_BODY, self.m.geom_bodyid[i]) or base
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
        return bool(self.switched_off & int(getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{flag}")))

    def number(self, enum: str, name: str) -> int:
        """Return the number of a member: number("Geom", "BOX")."""
        return int(getattr(getattr(self.mujoco, f"mjt{enum}"), f"mj{_PREFIXES[enum]}_{name}"))

    def word(self, enum: str, value: int) -> str:
        """Return the name of a member in small letters: word("Geom", 6) = "box"."""
        name = str(getattr(self.mujoco, f"mjt{enum}")(int(value)).name)
        return name.partition("_")[2].lower()


_PREFIXES = {
    "Joint": "JNT", "Geom": "GEOM", "Eq": "EQ", "Trn": "TRN", "Dyn": "DYN", "Gain": "GAIN", "Bias": "BIAS",
    "Wrap": "WRAP", "Obj": "OBJ",
}  # fmt: skip


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
