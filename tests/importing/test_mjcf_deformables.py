"""Deformable bodies of MJCF are refused by name, or taken as loose bodies where the user says so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import contactvi as cvi
from contactvi.importing.mjcf import compiler
from helpers.extras import mujoco_module

mujoco = mujoco_module()

CLOTH = '<flexcomp name="cloth" type="grid" count="3 3 1" spacing=".1 .1 .1" dim="2"/>'
BALL = '<body name="ball" pos="0 0 1"><freejoint/><geom size=".1"/></body>'
COMPOSITE = '<composite type="cable" curve="s" count="5 1 1" size="1"><geom type="capsule" size=".01"/></composite>'


def file_of(folder: Path, world: str, name: str = "model.xml") -> Path:
    path = folder / name
    path.write_text(f"<mujoco><worldbody>{world}</worldbody></mujoco>")
    return path


@pytest.mark.parametrize("included", [False, True])
def test_they_are_refused_by_name(included: bool, tmp_path: Path):
    file = file_of(tmp_path, CLOTH + BALL)
    if included:
        (tmp_path / "part.xml").write_text(f"<mujoco><worldbody>{CLOTH}</worldbody></mujoco>")
        file.write_text(f'<mujoco><include file="part.xml"/><worldbody>{BALL}</worldbody></mujoco>')
    for add in (cvi.Scene().add_mjcf, cvi.Scene.from_mjcf):
        with pytest.raises(cvi.SceneError, match=r"rigid bodies .* got 1 flex: 'cloth', with 9 bodies") as caught:
            add(file)
        assert "allow=('flex',)" in caught.value.remedy
        assert caught.value.path == str(file)


def test_they_are_taken_where_the_user_says_so(tmp_path: Path):
    file = file_of(tmp_path, CLOTH + BALL)
    scene = cvi.Scene()
    scene.add_mjcf(file, allow=("flex",))
    assert scene.nv == 27 + 6
    assert [note.name for note in scene.report.all_notes("ignored", "flex")] == ["cloth"]
    assert cvi.simulate(scene, duration=0.01, dt=1e-3).status.ok
    page = tmp_path / "scene.toml"
    page.write_text('[[mjcf]]\npath = "model.xml"\nallow = ["flex"]\n')
    assert cvi.load_scene(page).nv == scene.nv
    page.write_text('[[mjcf]]\npath = "model.xml"\n')
    with pytest.raises(cvi.SceneError, match="deformable"):
        cvi.load_scene(page)


@pytest.mark.parametrize("allow", [("skin",), 3, [1], ("flex", "x")])
def test_what_is_no_such_kind_is_refused(allow, tmp_path: Path):
    with pytest.raises(cvi.InputError):
        cvi.Scene().add_mjcf(file_of(tmp_path, BALL), allow=allow)


def test_a_composite_is_named(tmp_path: Path):
    with pytest.raises(cvi.SceneError, match="<composite>.* got a composite of type 'cable'") as caught:
        cvi.Scene().add_mjcf(file_of(tmp_path, COMPOSITE), allow=("flex",))
    assert "mj_saveLastXML" in caught.value.remedy


def test_the_command_line_has_the_choice(command, tmp_path: Path):
    file = file_of(tmp_path, CLOTH + BALL)
    for line in (("check",), ("run", "-o", str(tmp_path / "out"), "--duration", "0.01", "--no-html", "--no-plot")):
        refused = command(*line, str(file))
        assert refused.exit_code == 2
        assert "cloth" in refused.output
        assert command(*line, str(file), "--allow", "flex").exit_code == 0
    saved = tmp_path / "saved.toml"
    line = ("run", str(file), "-o", str(tmp_path / "out"), "--duration", "0.01", "--no-html", "--no-plot")
    assert command(*line, "--allow", "flex", "--save-scene", str(saved)).exit_code == 0
    assert 'allow = ["flex"]' in saved.read_text()
    assert cvi.load_scene(saved).nv == 33


def test_a_model_from_the_cache_is_refused_and_taken_as_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The cache has what MuJoCo makes of a file; whether it is taken is no part of that."""
    monkeypatch.setenv("CONTACTVI_CACHE", str(tmp_path / "cache"))
    compiled: list[Path] = []
    compile_file = compiler._compile

    def counted(mujoco: Any, file: Path) -> Any:
        compiled.append(file)
        return compile_file(mujoco, file)

    monkeypatch.setattr(compiler, "_compile", counted)
    file = file_of(tmp_path, CLOTH + BALL)
    errors, reports = [], []
    for _ in range(2):
        with pytest.raises(cvi.SceneError, match="got 1 flex: 'cloth', with 9 bodies") as caught:
            cvi.Scene.from_mjcf(file)
        errors.append(str(caught.value))
        scene = cvi.Scene.from_mjcf(file, allow=("flex",))
        assert scene.nv == 33
        reports.append(str(scene.report))
    assert errors[0] == errors[1]
    assert reports[0] == reports[1]
    assert compiled == [file]


def test_a_changed_mesh_of_a_deformable_body_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CONTACTVI_CACHE", str(tmp_path / "cache"))
    file = file_of(tmp_path, '<flexcomp name="patch" type="mesh" file="patch.obj" dim="2" mass="1"/>')
    square = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 .1\nf 1 2 3\nf 2 4 3\n"
    (tmp_path / "patch.obj").write_text(square)
    assert cvi.Scene.from_mjcf(file, allow=("flex",)).nv == 12
    (tmp_path / "patch.obj").write_text(square + "v 2 1 0\nf 2 5 4\n")
    assert cvi.Scene.from_mjcf(file, allow=("flex",)).nv == 15
