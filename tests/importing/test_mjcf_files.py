"""Every MJCF of gymnasium and dm_control loads with MuJoCo's numbers and runs, or is refused with the one reason."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from helpers import mjcf_files
from helpers import mujoco_oracle as oracle
from helpers.extras import mujoco_module

mujoco = mujoco_module()

# Meshes of hundreds of bodies, or minutes of contact in a second.
LONG = ("fruitfly", "drosophila", "dog", "rodent", "humanoid_CMU")


def label(path: Path) -> str:
    return "/".join(path.parts[-3:])


def cases() -> list:
    marks = [pytest.mark.long]
    return [
        pytest.param(path, id=label(path), marks=marks if any(word in str(path) for word in LONG) else [])
        for path in mjcf_files.files()
    ]


def test_the_packages_are_there():
    names = [label(path) for path in mjcf_files.files()]
    assert sum("mujoco/assets" in name for name in names) >= 14
    if sys.version_info < (3, 13):  # dm_control needs labmaze, which has no wheel for later ones
        assert sum("control/suite" in name for name in names) >= 18


@pytest.mark.parametrize("path", cases())
def test_file(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file in the working folder
    if (why := mjcf_files.reason(path)) is not None:
        with pytest.raises(cvi.SceneError, match=why):
            cvi.Scene.from_mjcf(path)
        return
    scene, m = cvi.Scene.from_mjcf(path), mujoco.MjModel.from_xml_path(str(path))
    if m.nbody > 1:
        assert oracle.differences(scene, m).largest() < 1e-9
    wanted, differing = mjcf_files.pairs(scene, m)
    assert differing == 0
    assert len(scene.pair_names) == wanted


@pytest.mark.parametrize("path", [case for case in cases() if mjcf_files.reason(case.values[0]) is None])
def test_run(path: Path):
    """One second from the file's start, lifted where bodies lie in the floor."""
    scene = cvi.Scene.from_mjcf(path)
    if scene.nv == 0:
        return
    traj = cvi.simulate(scene, mjcf_files.lifted(scene), duration=1.0, dt=1e-3)
    assert traj.status.code is cvi.StatusCode.SUCCESS
    assert np.isfinite(traj.q).all()
