"""Batches in files: what is read is what was computed, and only that; other files are refused."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import contactvi as cvi
from contactvi.batch import runs, storage
from helpers.rollout_scenes import at_wall, starts, thrown_ball

SETTINGS = {"dt": 0.01, "duration": 0.7}


@pytest.mark.parametrize("keep", ["ends", "nodes"])
def test_slices_of_a_file_are_the_runs(tmp_path, monkeypatch, keep):
    monkeypatch.setattr(runs, "BLOCK", 3)
    scene, q, v = at_wall()
    qs = starts(q, 10)
    qs[4, 0] = np.nan
    whole = cvi.simulate_batch(scene, qs, v, keep=keep, **SETTINGS)
    stored = cvi.simulate_batch(scene, qs, v, keep=keep, path=tmp_path / "runs.npz", workers=2, **SETTINGS)
    assert isinstance(stored, cvi.StoredBatch)
    again = cvi.load_batch(tmp_path / "runs.npz")
    assert len(again) == 10
    for first, last in ((0, 10), (2, 7), (9, 10), (3, 6)):
        part = again[first:last]
        for name in ("t", "q", "v", "impacts", "nodes"):
            assert getattr(part, name).tobytes() == getattr(whole, name)[first:last].tobytes()
        assert list(part.status) == whole.status[first:last]
        assert {k + first: str(e) for k, e in part.errors.items()} == {
            k: str(e) for k, e in whole.errors.items() if first <= k < last
        }
    assert again.options == whole_options(scene)
    assert type(again[4:5].errors[0]) is cvi.InputError


def whole_options(scene: cvi.Scene) -> cvi.Options:
    return cvi.Options.from_dict({**scene.settings, **SETTINGS})


@pytest.mark.parametrize("count", [1, 2, 1023, 1024, 1025, 5000])
@pytest.mark.parametrize("size", [40, 200_000, 2**27])
def test_blocks_are_few_and_even(count: int, size: int):
    """Results within the limits, in as few blocks as these allow, none of which is short by more than there are."""
    of_a_run = SimpleNamespace(runs=count, bytes_of_a_run=float(size))
    length = runs.runs_of_block(cast(Any, of_a_run))
    most = max(1, min(runs.BLOCK, runs.BLOCK_BYTES // size))
    blocks = -(-count // length)
    assert 1 <= length <= most
    assert blocks == -(-count // most)
    assert 0 <= blocks * length - count < blocks


def test_only_the_blocks_asked_for_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "BLOCK", 3)
    scene, q, v = at_wall()
    stored = cvi.simulate_batch(scene, starts(q, 10), v, path=tmp_path / "runs.npz", **SETTINGS)
    read: list[int] = []
    inner = storage._read
    monkeypatch.setattr(
        storage, "_read", lambda archive, first, *rest: read.append(first) or inner(archive, first, *rest)
    )
    stored[4:6]
    assert read == [3]


def test_runs_of_several_lengths(tmp_path):
    scene, q, v = thrown_ball()
    heights = np.tile(q, (3, 1))
    heights[:, 2] += [0.0, 0.3, 0.6]
    whole = cvi.simulate_batch(scene, heights, v, duration=0.5, dt="auto", keep="nodes")
    stored = cvi.simulate_batch(scene, heights, v, duration=0.5, dt="auto", keep="nodes", path=tmp_path / "a")[0:3]
    assert stored.q.tobytes() == whole.q.tobytes()
    assert np.array_equal(stored.error_estimate, whole.error_estimate)


def test_what_is_not_replaced_or_read(tmp_path):
    scene, q, v = at_wall()
    with pytest.raises(cvi.InputError, match="Cannot write"):
        cvi.simulate_batch(scene, q, v, path=tmp_path, **SETTINGS)
    with pytest.raises(cvi.InputError, match="Whole runs"):
        cvi.simulate_batch(scene, q, v, path=tmp_path / "a", keep="runs", **SETTINGS)
    with pytest.raises(cvi.SceneError, match="no such file"):
        cvi.load_batch(tmp_path / "none")
    (tmp_path / "text").write_text("no")
    with pytest.raises(cvi.SceneError, match="cannot be read"):
        cvi.load_batch(tmp_path / "text")
    stored = cvi.simulate_batch(scene, q, v, path=tmp_path / "a", **SETTINGS)
    for wrong in (slice(3, 2), [], "a"):
        with pytest.raises(cvi.InputError, match="no runs"):
            stored[wrong]
    with pytest.raises(cvi.InputError, match="were not kept"):
        stored[0]
    cut(tmp_path / "a", tmp_path / "cut")
    with pytest.raises(cvi.SceneError, match="one after the other"):
        cvi.load_batch(tmp_path / "cut")


def cut(path: Path, to: Path) -> None:
    """Leave out the blocks of a file."""
    with zipfile.ZipFile(path) as archive, zipfile.ZipFile(to, "w") as less:
        less.writestr("header.npy", archive.read("header.npy"))


def test_a_file_that_is_there_is_refused_before_the_first_run(tmp_path):
    scene, q, v = at_wall()
    (tmp_path / "a").write_bytes(b"precious")

    def never(made: int, of: int) -> None:
        raise AssertionError("a run was made")

    with pytest.raises(cvi.OverwriteError, match="overwrite=True"):
        cvi.simulate_batch(scene, q, v, path=tmp_path / "a", progress=never, **SETTINGS)
    assert (tmp_path / "a").read_bytes() == b"precious"
    assert len(cvi.simulate_batch(scene, q, v, path=tmp_path / "a", overwrite=True, **SETTINGS)) == 1


def test_a_batch_that_ends_leaves_the_file_that_was_there(tmp_path):
    scene, q, v = at_wall()
    cvi.simulate_batch(scene, q, v, path=tmp_path / "a", **SETTINGS)
    before = (tmp_path / "a").read_bytes()

    def stop(made: int, of: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cvi.simulate_batch(
            scene, q, v, dt=1e-6, duration=100.0, record_every=1000, path=tmp_path / "a", overwrite=True, progress=stop
        )
    assert (tmp_path / "a").read_bytes() == before
    assert os.listdir(tmp_path) == ["a"]


def test_a_file_has_what_was_given_and_how_runs_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "BLOCK", 3)
    scene, q, v = at_wall()
    qs = starts(q, 10)
    qs[4, 0] = np.nan
    gravity = np.column_stack([np.zeros((10, 2)), np.linspace(-9.0, -10.0, 10)])
    values = {"gravity": gravity, "restitution": np.linspace(0.1, 0.9, 10)[:, None]}
    names = [name for name in values if name == "gravity" or scene.pair_names]
    chosen = {name: values[name] for name in names}
    here = cvi.simulate_batch(scene, qs, v, parameters=chosen, **SETTINGS)
    stored = cvi.simulate_batch(scene, qs, v, parameters=chosen, path=tmp_path / "a", **SETTINGS)
    again = cvi.load_batch(tmp_path / "a")
    for result, rows in ((here, slice(0, 10)), (stored[0:10], slice(0, 10)), (again[2:7], slice(2, 7)),
                         (here[2:7], slice(2, 7))):  # fmt: skip
        np.testing.assert_array_equal(result.q0, qs[rows])
        np.testing.assert_array_equal(result.v0, np.tile(v, (10, 1))[rows])
        assert list(result.parameters) == list(chosen)
        for name, value in chosen.items():
            np.testing.assert_array_equal(result.parameters[name], value[rows])
    assert list(again.status) == list(here.status)
    np.testing.assert_array_equal(again.ok, here.ok)
    assert {k: str(e) for k, e in again.errors.items()} == {k: str(e) for k, e in here.errors.items()}
    assert repr(here.status) == "<BatchStatus: 9 SUCCESS, 1 REFUSED>"
    assert cvi.simulate_batch(scene, q, **SETTINGS).v0 is None


def test_a_table_of_runs():
    pytest.importorskip("pandas")
    scene, q, v = at_wall()
    gravity = np.array([[0.0, 0.0, -9.0], [0.0, 0.0, -10.0]])
    result = cvi.simulate_batch(scene, q, v, parameters={"gravity": gravity}, **SETTINGS)
    frame = result.to_pandas()
    assert list(frame["status"]) == ["SUCCESS", "SUCCESS"]
    np.testing.assert_array_equal(frame["gravity[2]"], gravity[:, 2])
    np.testing.assert_array_equal(frame["impacts"], result.impacts)
    np.testing.assert_array_equal(frame["t"], result.status.times)
