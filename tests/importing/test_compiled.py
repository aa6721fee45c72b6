"""Compiled MJCF files in the cache: what is found there is what MuJoCo would make, and is never out of date."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from contactvi import cache
from contactvi.importing.mjcf import compiler
from contactvi.playback import scene_visuals
from helpers.extras import mujoco_module

mujoco_module()

MAIN = """<mujoco model="m"><compiler settotalmass="5"/><include file="assets.xml"/>
<option gravity="0 0 -3"/><worldbody><geom name="floor" type="plane" size="1 1 1"/>
<body name="b" pos="0 0 2"><freejoint/><geom name="t" type="mesh" mesh="t" condim="3"/>
<body pos="0 0 1"><joint name="j" axis="0 1 0" range="-50 50" damping=".2"/>
<geom name="u" type="mesh" mesh="u" contype="0" conaffinity="0"/></body></body></worldbody>
<actuator><motor name="a" joint="j" gear="3"/></actuator><sensor><jointpos joint="j"/></sensor>
<keyframe><key name="k" qpos="0 0 2 1 0 0 0 .3"/></keyframe></mujoco>"""
ASSETS = '<mujoco><asset><mesh name="t" file="t.obj"/><mesh name="u" file="u.obj"/></asset></mujoco>'
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 {height}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A model of four files, and an empty cache."""
    monkeypatch.setenv("CONTACTVI_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "assets.xml").write_text(ASSETS)
    for name, height in (("t", 1), ("u", 2)):
        (folder / f"{name}.obj").write_text(TETRAHEDRON.format(height=height))
    (folder / "m.xml").write_text(MAIN)
    return folder / "m.xml"


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Path]]:
    """The files that MuJoCo compiles from now on."""
    files: list[Path] = []
    compile_file = compiler._compile

    def counted(mujoco: Any, file: Path) -> Any:
        files.append(file)
        return compile_file(mujoco, file)

    monkeypatch.setattr(compiler, "_compile", counted)
    return files


def facts(model: Path) -> list[Any]:
    """All that a file decides: the report, numbers, hulls, configurations, pictures."""
    scene = cvi.Scene.from_mjcf(model)
    hull = next(item for item in scene.collision_model.geometryObjects if item.name == "t")
    found: list[Any] = [str(scene.report), scene.pair_names, scene.pair_friction.tobytes(), scene.neutral().tobytes()]
    found += [np.array(hull.geometry.points()).tobytes(), [str(inertia) for inertia in scene.model.inertias]]
    found += [{name: q.tobytes() for name, (q, _) in scene.named_configurations.items()}, scene.model.damping.tobytes()]
    found += [(v.name, v.vertices.tobytes(), v.faces.tobytes()) for v in scene_visuals.from_scene(scene)]
    return found


def test_a_model_is_compiled_once(model: Path, compiled: list[Path]):
    before = facts(model)
    assert "settotalmass" in before[0], "what MuJoCo warns of is in the report"
    assert facts(model) == before
    assert compiled == [model]


def test_without_a_cache_it_is_compiled_each_time(model: Path, compiled: list[Path], monkeypatch: pytest.MonkeyPatch):
    before = facts(model)
    monkeypatch.setenv("CONTACTVI_CACHE", "")
    assert facts(model) == before
    assert facts(model) == before
    assert len(compiled) == 3


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [("m.xml", "pos=\"0 0 2\"", "pos=\"0 0 3\""), ("assets.xml", 'file="u.obj"', 'file="t.obj"'),
     ("t.obj", "v 0 0 1", "v 0 0 3"), ("u.obj", "v 0 0 2", "v 0 0 3")],
)  # fmt: skip
def test_a_changed_file_is_compiled_again(model: Path, compiled: list[Path], name: str, old: str, new: str):
    before, file = facts(model), model.parent / name
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    assert facts(model) != before
    assert len(compiled) == 2
    file.write_text(text)
    assert facts(model) == before
    assert len(compiled) == 2


def test_a_moved_model_is_found(model: Path, compiled: list[Path], tmp_path: Path):
    before = facts(model)
    moved = model.parent.rename(tmp_path / "moved") / model.name
    after = facts(moved)
    assert after[0] == before[0].replace(str(model), str(moved))
    assert after[1:] == before[1:]
    assert len(compiled) == 1


def test_entries_that_are_gone_or_damaged_are_made_again(model: Path, compiled: list[Path], tmp_path: Path):
    before = facts(model)
    for k, path in enumerate(sorted((tmp_path / "cache").iterdir())):
        path.unlink()
        assert facts(model) == before
        cache.keep(path.stem, [np.arange(12.0)])
        assert facts(model) == before, k
    assert len(compiled) > 1


def test_meshes_that_are_gone_are_compiled_again_when_they_are_shown(
    model: Path, compiled: list[Path], monkeypatch: pytest.MonkeyPatch
):
    before = facts(model)
    scene = cvi.Scene.from_mjcf(model)
    monkeypatch.setenv("CONTACTVI_CACHE", "")
    assert [(v.name, v.vertices.tobytes(), v.faces.tobytes()) for v in scene_visuals.from_scene(scene)] == before[8:]
    assert len(compiled) == 2


def test_meshes_of_files_that_have_changed_since_are_an_error(model: Path, monkeypatch: pytest.MonkeyPatch):
    facts(model)
    scene = cvi.Scene.from_mjcf(model)
    monkeypatch.setenv("CONTACTVI_CACHE", "")
    model.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with pytest.raises(cvi.SceneError, match="load the model again"):
        scene_visuals.from_scene(scene)


def test_a_model_with_a_file_that_cannot_be_found_is_not_kept(model: Path, compiled: list[Path]):
    """MuJoCo names files of textures where it does not look for them."""
    texture = '<texture name="x" type="2d" file="missing.png"/><mesh name="t"'
    (model.parent / "assets.xml").write_text(ASSETS.replace('<mesh name="t"', texture))
    with pytest.raises(cvi.SceneError, match="missing.png"):
        facts(model)
    with pytest.raises(cvi.SceneError, match="missing.png"):
        facts(model)
    assert len(compiled) == 2


def test_what_is_compiled_is_loaded_without_mujoco(model: Path, tmp_path: Path):
    code = "import sys, contactvi as cvi; cvi.Scene.from_mjcf(sys.argv[1]).core(); print('mujoco' in sys.modules)"
    root = str(Path(cvi.__file__).parents[1])
    path = os.pathsep.join([root, os.environ.get("PYTHONPATH", "")]).strip(os.pathsep)
    found = [
        subprocess.run(
            [sys.executable, "-c", code, str(model)], check=True, capture_output=True, text=True, cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": path},
        ).stdout.strip()
        for _ in range(2)
    ]  # fmt: skip
    assert found == ["True", "False"]
