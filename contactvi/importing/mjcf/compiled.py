"""What MuJoCo makes of an MJCF, as plain numbers: compiled once, and taken from the cache on disk from then on.

An entry is named by the contents of all files that MuJoCo reads for the model; which these are is known by another
entry, named by the texts of the XML files. A model whose files cannot all be found is not kept. Meshes have entries of
their own, since pictures are often not asked for. With both entries MuJoCo is not even imported.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from contactvi import cache
from contactvi.errors import SceneError
from contactvi.importing.pictures import Surface, find_surface

# The fields of mjModel that are kept, by how their names begin: not those of meshes, textures and skins, and of flexes
# the bodies at their vertices alone, which the error that refuses them counts.
_BEGINNINGS = (
    "n", "flg_", "qpos", "body_", "jnt_", "dof_", "geom_", "site_", "eq_", "tendon_", "wrap_", "actuator_", "key_",
    "pair_", "exclude_", "hfield_", "mat_rgba", "sensor_type", "flex_vertbodyid",
)  # fmt: skip
_OPTIONS = ("gravity", "wind", "density", "viscosity", "disableflags")
_ENUMS = ("Joint", "Geom", "Eq", "Trn", "Dyn", "Gain", "Bias", "Wrap", "Obj", "Sensor", "DisableBit")

Enums = dict[str, dict[str, int]]


class Meshes:
    """The meshes of a compiled model in the frames that MuJoCo gives them, read from the cache when they are needed.

    Args:
        entry: name of the model's entry, None where there is none. found: the known meshes, by number. again: compiles
            the model once more, where an entry is gone.
    """

    def __init__(self, entry: str | None, found: dict[int, Surface], again: Callable[[], dict[int, Surface]]) -> None:
        self._entry, self._found, self._again = entry, found, again

    def of(self, mesh: int) -> Surface:
        """Return a mesh by its number."""
        if mesh not in self._found:
            kept = None if self._entry is None else find_surface(_mesh_entry(self._entry, mesh))
            self._found |= self._again() if kept is None else {mesh: kept}
        if mesh in self._found:
            return self._found[mesh]
        raise SceneError(
            f"Mesh {mesh} of a model is gone",
            expected="the meshes that the file had when it was loaded",
            got=f"{len(self._found)} meshes",
            remedy="The files have changed since: load the model again",
        )

    def keep(self) -> None:
        """Write the entries of all meshes that are known."""
        if self._entry is not None:
            for mesh, surface in self._found.items():
                cache.keep(_mesh_entry(self._entry, mesh), surface)


@dataclass(frozen=True)
class Compiled:
    """A compiled model.

    Attributes:
        m: fields of mjModel, as far as they are kept, under their names there.
        enums: {"Geom": {"BOX": 6, ...}, ...}. warnings: what MuJoCo had to say. meshes: as they are asked for.
    """

    m: Any
    enums: Enums
    warnings: list[str]
    meshes: Meshes

    def keep(self, entry: str) -> None:
        """Write the entry, and those of the meshes."""
        fields, options = dict(vars(self.m)), dict(vars(self.m.opt))
        del fields["opt"]
        arrays = {name: value for name, value in fields.items() if isinstance(value, np.ndarray)}
        facts = {
            "numbers": {name: value for name, value in fields.items() if name not in arrays},
            "options": {name: np.asarray(value).tolist() for name, value in options.items()},
            "enums": self.enums, "warnings": self.warnings, "arrays": list(arrays),
        }  # fmt: skip
        cache.keep(entry, [np.frombuffer(json.dumps(facts).encode(), np.uint8), *arrays.values()])
        self.meshes.keep()

    @staticmethod
    def found(entry: str, again: Callable[[], dict[int, Surface]]) -> Compiled | None:
        """Return the model of an entry; None where there is none."""
        arrays = cache.find(entry)
        if not arrays or arrays[0].dtype != np.uint8:
            return None
        facts = json.loads(arrays[0].tobytes())
        options = SimpleNamespace(**{name: np.array(value) for name, value in facts["options"].items()})
        m = SimpleNamespace(**facts["numbers"], **dict(zip(facts["arrays"], arrays[1:], strict=True)), opt=options)
        return Compiled(m, facts["enums"], facts["warnings"], Meshes(entry, {}, again))

    @staticmethod
    def of(mujoco: Any, model: Any, warnings: list[str], entry: str | None) -> Compiled:
        """Return the numbers of a mujoco.MjModel, which is needed no more."""
        fields = {name: getattr(model, name) for name in dir(model) if name.startswith(_BEGINNINGS)}
        kept = {name: np.array(value) for name, value in fields.items() if isinstance(value, np.ndarray)}
        for array in kept.values():
            array.setflags(write=False)  # as those of the cache
        numbers = {name: value for name, value in fields.items() if isinstance(value, int)}
        options = SimpleNamespace(**{name: np.array(getattr(model.opt, name)) for name in _OPTIONS})
        m = SimpleNamespace(**numbers, **kept, names=np.frombuffer(model.names, np.uint8), opt=options)
        meshes = meshes_of(model)
        return Compiled(m, _enums_of(mujoco), warnings, Meshes(entry, meshes, lambda: meshes))


def meshes_of(model: Any) -> dict[int, Surface]:
    """Return the meshes of a mujoco.MjModel by their numbers."""
    found = {}
    for k in range(model.nmesh):
        points = slice(model.mesh_vertadr[k], model.mesh_vertadr[k] + model.mesh_vertnum[k])
        corners = slice(model.mesh_faceadr[k], model.mesh_faceadr[k] + model.mesh_facenum[k])
        faces = np.array(model.mesh_face[corners], dtype=np.uint32)
        found[k] = Surface(np.array(model.mesh_vert[points], dtype=np.float32), faces)
    return found


def entry_of(file: Path, texts: Sequence[tuple[Path, bytes]], used: Sequence[str] | None = None) -> str | None:
    """Return the name of the entry of a model; None where not all files of the model are known, or can be read.

    Args:
        texts: the XML files of the model and their contents.
        used: all files of the model, as MuJoCo tells; they are kept for the next time. None: those of the last time.
    """
    compiler = _version_of_mujoco()
    if compiler is None:
        return None
    parts = [part for path, text in texts for part in (str(path), text)]
    listed = cache.key("files of an MJCF", compiler, str(file), *parts)
    if used is None:
        known = cache.find(listed)
        if not known or known[0].dtype != np.uint8:
            return None
        used = json.loads(known[0].tobytes())
    else:
        cache.keep(listed, [np.frombuffer(json.dumps(list(used)).encode(), np.uint8)])
    try:
        contents = [(os.path.relpath(path, file.parent), Path(path).read_bytes()) for path in sorted(used)]
    except OSError:
        return None
    digests = [part for name, content in contents for part in (name, hashlib.sha256(content).hexdigest())]
    return cache.key("compiled MJCF", compiler, *digests)


def _mesh_entry(entry: str, mesh: int) -> str:
    return cache.key("mesh of a compiled MJCF", entry, str(mesh))


def _version_of_mujoco() -> str | None:
    """Return the version of the compiler, which need not be imported for that; None where there is none."""
    if "mujoco" in sys.modules:
        return getattr(sys.modules["mujoco"], "__version__", None)
    for package in ("mujoco-core", "mujoco"):
        try:
            return version(package)
        except PackageNotFoundError:
            continue
    return None


def _enums_of(mujoco: Any) -> Enums:
    """Return the names and numbers of MuJoCo's enumerations: mjtGeom.mjGEOM_BOX is "Geom", "BOX"."""
    members = {enum: getattr(mujoco, f"mjt{enum}").__members__.items() for enum in _ENUMS}
    return {enum: {name.partition("_")[2]: int(value) for name, value in found} for enum, found in members.items()}
