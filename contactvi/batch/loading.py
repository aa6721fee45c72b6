"""`load`: any file of ours, told apart by what is in it."""

from __future__ import annotations

import json
import os
import zipfile
from pathlib import Path

import numpy as np

from contactvi.batch import storage as batches
from contactvi.batch.storage import StoredBatch, load_batch
from contactvi.errors import SceneError
from contactvi.files import UNREADABLE, as_a_path, checked_path
from contactvi.scene.scene import Scene
from contactvi.scene.toml import load_scene
from contactvi.trajectory.trajectory import Trajectory

RUN_IN_A_FOLDER = "trajectory.npz"
_EXPECTED = "a run (Trajectory.save, contactvi run), a batch of runs (simulate_batch(path=)) or a scene file (.toml)"
_SHOWN = {  # what is made of runs and cannot be read back
    ".html": "a page", ".png": "a picture", ".svg": "a picture", ".gif": "a film", ".mp4": "a film",
    ".csv": "a table",
}  # fmt: skip
_MODELS = {".urdf": "scene.add_urdf(path)", ".xml": "Scene.from_mjcf(path)", ".mjcf": "Scene.from_mjcf(path)"}


def load(path: str | os.PathLike[str]) -> Trajectory | StoredBatch | Scene:
    """Return what is in a file of contactvi: a run, a batch of runs, or the scene of a scene file.

    Files are told apart by what is in them, not by their names, but for scene files, which end in .toml.

    Args:
        path: of the file; or the folder of `contactvi run`, in which the run is looked for.

    Raises:
        SceneError: there is no such file, or it is damaged, or of another kind.
    """
    file = checked_path(path)
    with as_a_path(file):
        if file.is_dir():
            file = file / RUN_IN_A_FOLDER
        there = file.is_file()
    if not there:
        raise SceneError(
            f"There is no file {file}", path=file, expected=_EXPECTED, got="nothing",
            remedy="Correct the path" if file.name != RUN_IN_A_FOLDER else f"Name a file, or a folder with {file.name}",
        )  # fmt: skip
    if file.suffix.lower() == ".toml":
        return load_scene(file)
    if file.suffix.lower() in _MODELS:
        remedy = f"Add it to a scene: {_MODELS[file.suffix.lower()]}"
        raise SceneError(f"{file.name} is a model", path=file, expected=_EXPECTED, got="a robot model", remedy=remedy)
    if file.suffix.lower() in _SHOWN:
        raise SceneError(
            f"{file.name} cannot be read back", path=file, expected=_EXPECTED, got=_SHOWN[file.suffix.lower()],
            remedy=f"Name the file of its run, {RUN_IN_A_FOLDER} in a folder of contactvi run",
        )  # fmt: skip
    return load_batch(file) if _format_of(file) == batches.FORMAT else Trajectory.load(file)


def _format_of(file: Path) -> str | None:
    """Return which format the header of a file names; None where it has none, which its reader tells."""
    try:
        with zipfile.ZipFile(file) as archive, archive.open("header.npy") as entry:
            header = json.loads(str(np.lib.format.read_array(entry, allow_pickle=False)))
        return str(header["format"])
    except (*UNREADABLE, TypeError, RecursionError):
        return None
