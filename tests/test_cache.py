"""The cache on disk: entries are whole or missing, and hulls from it are those that would be made."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from contactvi import cache
from contactvi.importing.hulls import faces_of
from contactvi.importing.mesh_hulls import MeshFile

ARRAYS = [np.linspace(0.0, 1.0, 12).reshape(4, 3), np.arange(6, dtype=np.int32).reshape(2, 3)]
# A scene of a box and a tetrahedron as mesh files, which fall on each other: the pair of hulls is rounded.
URDF = """<robot name="{name}"><link name="{name}">
  <inertial><mass value="1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><mesh filename="{file}" scale="{scale}"/></geometry></collision>
</link></robot>"""
BOX = [(x, y, z) for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)]
BOX_FACES = [
    (1, 2, 4), (2, 3, 4), (5, 7, 6), (6, 7, 8), (1, 5, 2), (2, 5, 6),
    (3, 4, 7), (4, 8, 7), (1, 3, 5), (3, 7, 5), (2, 6, 4), (4, 6, 8),
]  # fmt: skip
TETRAHEDRON = [(0.0, 0.0, -0.1), (0.1, 0.0, 0.1), (-0.05, 0.08, 0.1), (-0.05, -0.08, 0.1)]
TETRAHEDRON_FACES = [(1, 2, 3), (1, 3, 4), (1, 4, 2), (2, 4, 3)]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of its own."""
    monkeypatch.setenv("CONTACTVI_CACHE", str(tmp_path / "cache"))
    cache._make_room.cache_clear()
    return tmp_path / "cache"


def write_mesh(path: Path, vertices: list[tuple[float, float, float]], faces: list[tuple[int, int, int]]) -> None:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")


def falling(folder: Path, scale: str = "1 1 1") -> cvi.Scene:
    """A tetrahedron above a box that stands still."""
    scene = cvi.Scene()
    for name, base, z in (("box", "fixed", 0.0), ("tetrahedron", "free", 0.35)):
        (folder / f"{name}.urdf").write_text(URDF.format(name=name, file=f"{name}.obj", scale=scale))
        scene.add_urdf(folder / f"{name}.urdf", base=base, placement=(0.01, 0.02, z))
    return scene


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    write_mesh(tmp_path / "box.obj", BOX, BOX_FACES)
    write_mesh(tmp_path / "tetrahedron.obj", TETRAHEDRON, TETRAHEDRON_FACES)
    return tmp_path


def numbers(scene: cvi.Scene) -> list[bytes]:
    """All that hulls decide: their vertices and triangles, the rounding of pairs, and a run with an impact."""
    found = []
    for item in scene.built().collision.geometryObjects:
        found += [np.array(item.geometry.points()).tobytes(), faces_of(item.geometry).tobytes()]
    run = cvi.simulate(scene, duration=0.3, dt=1e-3)
    assert len(run.events) > 0
    return [*found, np.array(scene.core().rounding).tobytes(), run.q.tobytes(), str(scene.report).encode()]


def test_entry_is_read_as_it_was_written(place: Path):
    name = cache.key("test", b"bytes", 1.5)
    assert cache.find(name) is None
    cache.keep(name, ARRAYS)
    found = cache.find(name)
    assert found is not None
    for array, kept in zip(found, ARRAYS, strict=True):
        np.testing.assert_array_equal(array, kept)
        assert array.dtype == kept.dtype
    assert len(list(place.iterdir())) == 1, "no parts are left"


def test_names_tell_all_parts_apart(place: Path):
    parts = [(b"ab", b"c"), (b"a", b"bc"), (b"abc",), (1.0,), (b"1.0",), (b"abc", 1.0)]
    assert len({cache.key("test", *part) for part in parts} | {cache.key("other", b"abc")}) == len(parts) + 1


@pytest.mark.parametrize("damage", ["cut", "changed", "empty", "pickle", "text"])
def test_damaged_entries_count_as_missing(place: Path, damage: str):
    name = cache.key("test", 2.0)
    cache.keep(name, ARRAYS)
    (path,) = place.iterdir()
    data = bytearray(path.read_bytes())
    if damage == "changed":
        data[len(data) // 2] ^= 1
    elif damage == "pickle":
        with path.open("wb") as file:
            np.save(file, np.array([{"a": 1}], dtype=object), allow_pickle=True)
        data = bytearray(path.read_bytes())
    path.write_bytes({"cut": bytes(data[:-40]), "empty": b"", "text": b"not an entry"}.get(damage, bytes(data)))
    assert cache.find(name) is None
    cache.keep(name, ARRAYS)
    assert cache.find(name) is not None


def test_without_a_folder_nothing_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CONTACTVI_CACHE", "")
    cache.keep(cache.key("test"), ARRAYS)
    assert cache.folder() is None
    assert cache.find(cache.key("test")) is None
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("CONTACTVI_CACHE", str(tmp_path / "file" / "below"))  # cannot be made, for root either
    cache.keep(cache.key("test"), ARRAYS)
    assert cache.find(cache.key("test")) is None


def test_entries_of_a_folder_that_can_only_be_read_are_used(place: Path, monkeypatch: pytest.MonkeyPatch):
    """By patches, since root may write everywhere."""
    name, other = cache.key("test", 1.0), cache.key("test", 2.0)
    cache.keep(name, ARRAYS)

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(os, "utime", refuse)
    monkeypatch.setattr(cache.tempfile, "mkstemp", refuse)
    cache.keep(other, ARRAYS)
    assert cache.find(name) is not None
    assert cache.find(other) is None


@pytest.mark.parametrize("table", [b"5", b"[[1, 2]]", b'[["<f8", [3, -1]]]', b'[["|O", [2]]]', b'[["<f8", [4000]]]'])
def test_entries_whose_table_tells_nonsense_count_as_missing(place: Path, table: bytes):
    """With the right checksum, as of another program."""
    name = cache.key("test", 2.0)
    cache.keep(name, ARRAYS)
    body = len(table).to_bytes(4, "little") + table + bytes(16)
    (place / (name + ".hull")).write_bytes(zlib.crc32(body).to_bytes(4, "little") + body)
    assert cache.find(name) is None


def test_folder_by_default(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("CONTACTVI_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert cache.folder() == Path("/somewhere/contactvi")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/home/someone")
    assert cache.folder() == Path("/home/someone/.cache/contactvi")


def test_oldest_entries_make_room(place: Path, monkeypatch: pytest.MonkeyPatch):
    names = [cache.key("test", float(k)) for k in range(4)]
    for age, name in zip((300, 100, 400, 200), names, strict=True):
        cache.keep(name, ARRAYS)
        os.utime(place / (name + ".hull"), (1e9 - age, 1e9 - age))
    size = sum(path.stat().st_size for path in place.iterdir())
    monkeypatch.setattr(cache, "LARGEST", size // 2)
    assert cache.find(names[2]) is not None  # it is used now, and is the newest from now on
    cache._make_room.cache_clear()
    cache.keep(cache.key("test", 4.0), ARRAYS)
    assert [cache.find(name) is not None for name in names] == [False, True, True, False]


def test_hulls_from_the_cache_are_those_that_are_made(meshes: Path, place: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CONTACTVI_CACHE", "")
    made = numbers(falling(meshes))
    monkeypatch.setenv("CONTACTVI_CACHE", str(place))
    assert numbers(falling(meshes)) == made
    assert len(list(place.iterdir())) == 4, "two hulls, and two rounded ones"

    def unread(self: MeshFile) -> None:
        raise AssertionError(f"{self.path} is in the cache")

    monkeypatch.setattr(MeshFile, "read", unread)
    assert numbers(falling(meshes)) == made


def test_changed_files_and_other_scales_have_other_hulls(meshes: Path, place: Path):
    before = numbers(falling(meshes))
    wide = falling(meshes, scale="1.5 1 1")
    assert np.array(wide.built().collision.geometryObjects[0].geometry.points())[:, 0].max() == pytest.approx(0.15)
    write_mesh(meshes / "box.obj", [(x, y, 1.2 * z) for x, y, z in BOX], BOX_FACES)
    changed = falling(meshes)
    assert np.array(changed.built().collision.geometryObjects[0].geometry.points())[:, 2].max() == pytest.approx(0.12)
    write_mesh(meshes / "box.obj", BOX, BOX_FACES)
    assert numbers(falling(meshes)) == before


def test_entries_that_are_no_hulls_are_made_again(meshes: Path, place: Path):
    before = numbers(falling(meshes))
    for path in place.iterdir():
        cache.keep(path.stem, [np.full((4, 3), np.nan), np.zeros((4, 3), np.int32), np.zeros(3)])
    assert numbers(falling(meshes)) == before
    for path in place.iterdir():
        cache.keep(path.stem, [np.zeros((4, 3)), np.full((4, 3), 4, np.int32), np.zeros(1)])
    assert numbers(falling(meshes)) == before


def test_processes_side_by_side(meshes: Path, place: Path, tmp_path: Path):
    falling(meshes)  # writes the URDF files; nothing of the run is in the cache
    for path in place.iterdir():
        path.unlink()
    code = (
        "import hashlib, contactvi as cvi; scene = cvi.Scene()\n"
        "for name, base, z in (('box', 'fixed', 0.0), ('tetrahedron', 'free', 0.35)):\n"
        f"    scene.add_urdf({str(meshes)!r} + f'/{{name}}.urdf', base=base, placement=(0.01, 0.02, z))\n"
        "print(hashlib.sha256(cvi.simulate(scene, duration=0.3, dt=1e-3).q.tobytes()).hexdigest())"
    )
    running = [
        subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
        for _ in range(6)
    ]
    found = {process.communicate(timeout=120)[0] for process in running}
    assert all(process.returncode == 0 for process in running)
    assert len(found) == 1
    assert len(next(iter(found)).strip()) == 64
    assert sorted(path.suffix for path in place.iterdir()) == [".hull"] * 4
