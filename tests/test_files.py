"""Files are written whole or not at all, and nothing but a regular file that the user named is replaced."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from contactvi.files import write_atomic
from contactvi.trajectory import plots


@pytest.fixture(scope="module")
def traj() -> cvi.Trajectory:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, placement=(0, 0, 0.2))
    return cvi.simulate(scene, duration=0.3, dt=1e-2)


def test_a_link_is_followed(tmp_path: Path, traj: cvi.Trajectory):
    (tmp_path / "real.npz").write_bytes(b"old")
    (tmp_path / "link.npz").symlink_to("real.npz")
    assert traj.save(tmp_path / "link.npz", overwrite=True) == tmp_path / "link.npz"
    assert (tmp_path / "link.npz").is_symlink()
    assert len(cvi.Trajectory.load(tmp_path / "real.npz").t) == len(traj.t)


WRITERS = {
    "save": "run.npz",
    "to_html": "run.html",
    "render": "run.png",
    "to_csv": "states.csv",
    "save_figure": "energy.png",
}


def written(name: str, traj: cvi.Trajectory, path: Path, **options) -> None:
    """Let one of the functions that write files of users write this one."""
    if name == "save_figure":
        plots.save_figure(plots.plot(traj), path, **options)
    elif name == "to_csv":
        traj.to_csv(path.parent, ["states"], **options)
    else:
        getattr(traj, name)(path, **(options if name != "render" else {"at": 0.1, **options}))


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_is_there_is_replaced_on_request_only(tmp_path: Path, traj: cvi.Trajectory, name: str):
    path = tmp_path / WRITERS[name]
    path.write_bytes(b"precious")
    with pytest.raises(cvi.OverwriteError, match=r"expected .* got a file of 8 bytes\. .*overwrite=True") as told:
        written(name, traj, path)
    assert told.value.path == str(path)
    assert path.read_bytes() == b"precious"
    assert list(tmp_path.iterdir()) == [path]
    if name != "render":  # needs a browser
        written(name, traj, path, overwrite=True)
        assert path.read_bytes() != b"precious"


def test_a_table_that_is_there_keeps_all_tables_from_being_written(tmp_path: Path, traj: cvi.Trajectory):
    (tmp_path / "units.csv").write_text("mine")
    with pytest.raises(cvi.OverwriteError, match="units.csv"):
        traj.to_csv(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["units.csv"]


def test_what_two_processes_write_at_once_is_kept_of_both(tmp_path: Path):
    path = tmp_path / "a.npz"

    def write(file) -> None:
        path.write_bytes(b"of the other")
        file.write(b"mine")

    with pytest.raises(cvi.OverwriteError, match="a-2.npz"):
        write_atomic(path, write, overwrite=False)
    assert path.read_bytes() == b"of the other"
    assert (tmp_path / "a-2.npz").read_bytes() == b"mine"
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("write", ["save", "to_html"])
def test_special_files_are_refused(tmp_path: Path, traj: cvi.Trajectory, write: str):
    os.mkfifo(tmp_path / "pipe")
    for path, got in ((tmp_path / "pipe", "pipe"), (tmp_path, "folder")):
        with pytest.raises(cvi.InputError, match=got):
            getattr(traj, write)(path)
    assert (tmp_path / "pipe").is_fifo()
    for path in (None, 3.5, "", "a\0b", b"bytes"):
        with pytest.raises(cvi.InputError, match="Path of a file"):
            getattr(traj, write)(path)


def test_parts_of_processes_that_are_no_more_are_removed(tmp_path: Path):
    code = "import os; print(os.getpid())"
    gone = int(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)
    written: list[str] = []
    write_atomic(tmp_path / "a.npz", lambda file: written.extend(path.name for path in tmp_path.iterdir()))
    (mine,) = written
    left, other = mine.replace(str(os.getpid()), str(gone)), mine.replace("a.npz", "b.npz")
    elsewhere = f".a.npz.00000000-{gone}-x.part"  # of another machine that shares the folder
    for name in (left, mine, other, elsewhere):
        (tmp_path / name).touch()
    write_atomic(tmp_path / "a.npz", lambda file: file.write(b"whole"))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([mine, other, elsewhere, "a.npz"])


def test_a_file_that_unpacks_to_very_much_is_refused(tmp_path: Path, traj: cvi.Trajectory):
    bomb = tmp_path / "bomb.npz"
    with (
        zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("t.npy", "w", force_zip64=True) as entry,
    ):
        for _ in range(1100):
            entry.write(bytes(1_000_000))
    with pytest.raises(cvi.SceneError, match=r"unpacks to 1.1 GB"):
        cvi.Trajectory.load(bomb)


@pytest.mark.parametrize("name", ["q", "p", "v", "kinetic_energy", "potential_energy"])
def test_numbers_that_are_not_finite_are_refused(tmp_path: Path, traj: cvi.Trajectory, name: str):
    traj.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as file:
        entries = dict(file)
    entries[name].flat[-1] = np.nan
    np.savez(tmp_path / "b.npz", **entries)
    with pytest.raises(cvi.SceneError, match="finite"):
        cvi.Trajectory.load(tmp_path / "b.npz")


def test_contacts_are_found_at_every_node_of_persistent_contact():
    """t + h may be one rounding short of the start of the next step."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.2, 0.2, 0.1), placement=(0, 0, 0.05))
    scene.set_contact(restitution=0.0, friction=0.4)
    run = cvi.simulate(scene, v0=scene.velocity({"box": (1, 0, 0)}), duration=1.2, dt=1e-2)
    assert [t for t in run.t[1:] if len(run.contacts.at(t)) < 4] == []


@pytest.mark.parametrize("links", [True, False])
def test_a_file_of_another_process_is_kept(tmp_path, monkeypatch, links):
    """One that comes into being while this one is written stays, and this one is kept beside it."""

    def refuse(*_: object) -> None:
        raise OSError(errno.EPERM, "no links here")

    if not links:
        monkeypatch.setattr(os, "link", refuse)
    path, taken = tmp_path / "run.npz", tmp_path / "run-2.npz"

    def write(out):
        path.write_bytes(b"theirs")
        taken.write_bytes(b"theirs, too")
        out.write(b"ours")

    with pytest.raises(cvi.OverwriteError, match="written by another process meanwhile.*run-3.npz"):
        write_atomic(path, write, overwrite=False)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run-2.npz", "run-3.npz", "run.npz"]
    assert path.read_bytes() == b"theirs"
    assert (tmp_path / "run-3.npz").read_bytes() == b"ours"
    write_atomic(tmp_path / "free.npz", lambda out: out.write(b"ours"), overwrite=False)
    assert (tmp_path / "free.npz").read_bytes() == b"ours"
