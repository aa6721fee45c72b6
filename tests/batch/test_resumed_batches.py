"""Files of batches: what they have of a result in memory, shards that are joined, batches that are interrupted."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from contactvi.batch import runs
from contactvi.batch.results import Batch
from helpers.rollout_scenes import at_wall, starts

SETTINGS: dict[str, Any] = {"dt": 0.01, "duration": 0.7}
ROOT = Path(__file__).resolve().parents[2]


def public(value: object) -> set[str]:
    return {name for name in dir(value) if not name.startswith("_")}


def names_of(batch: Batch) -> set[str]:
    """The public names of a batch, those that are read from its file among them."""
    return public(batch) | {name for kind in type(batch).__mro__ for name in vars(kind).get("__annotations__", ())}


@pytest.fixture
def both(tmp_path, monkeypatch) -> tuple[cvi.BatchResult, cvi.StoredBatch]:
    """The same runs in memory and in a file of several blocks; one of them is refused."""
    monkeypatch.setattr(runs, "BLOCK", 3)
    scene, q, v = at_wall()
    qs = starts(q, 10)
    qs[4, 0] = np.nan
    given = {"parameters": {"friction": np.linspace(0.1, 0.9, 10)[:, None]}, **SETTINGS}
    if not scene.pair_names:
        given.pop("parameters")
    memory = cvi.simulate_batch(scene, qs, v, keep="nodes", **given)
    return memory, cvi.simulate_batch(scene, qs, v, keep="nodes", path=tmp_path / "runs.npz", **given)


def test_a_file_has_the_public_names_of_a_result(both):
    memory, stored = both
    assert isinstance(memory, Batch)
    assert isinstance(stored, Batch)
    assert names_of(memory) <= names_of(stored)
    assert names_of(stored) - names_of(memory) == {"path", "options", "given", "header", "blocks"}
    for name in names_of(memory):
        assert hasattr(stored, name)


def test_a_file_has_the_values_of_a_result(both):
    memory, stored = both
    for name in ("t", "q", "v", "nodes", "impacts", "dense_steps", "error_estimate", "ok", "q0", "v0"):
        np.testing.assert_array_equal(getattr(stored, name), getattr(memory, name), err_msg=name)
    assert stored.parameters.keys() == memory.parameters.keys()
    for name, values in memory.parameters.items():
        np.testing.assert_array_equal(stored.parameters[name], values)
    assert list(stored.status) == list(memory.status)
    assert {k: str(error) for k, error in stored.errors.items()} == {k: str(e) for k, e in memory.errors.items()}
    assert list(stored.errors) == [4]
    assert [*stored.table.columns] == [*memory.table.columns]
    assert len(stored.to_pandas()) == 10
    assert stored.block.columns["q"].tobytes() == memory.block.columns["q"].tobytes()
    for chosen in (slice(2, 8), slice(None, None, -2), [7, 1, 7], np.arange(10) % 3 == 0):
        np.testing.assert_array_equal(stored[chosen].q, memory[chosen].q)
        assert [*stored[chosen].errors] == [*memory[chosen].errors]
    for batch in both:
        with pytest.raises(cvi.InputError, match="were not kept"):
            batch[3]
        with pytest.raises(cvi.InputError, match="were not kept"):
            next(iter(batch))
        with pytest.raises(IndexError):
            batch[10]
        assert "10 runs, 9 ok" in repr(batch)
        assert "Ended early" in batch._repr_html_()
    assert "runs.npz" in repr(stored)
    with pytest.raises(AttributeError, match="qs"):
        _ = stored.qs


def test_shards_are_joined(tmp_path, monkeypatch):
    scene, q, v = at_wall()
    qs = starts(q, 11)
    whole = cvi.simulate_batch(scene, qs, v, **SETTINGS)
    shards = [
        cvi.simulate_batch(scene, part, v, path=tmp_path / f"shard-{k}", **SETTINGS)
        for k, part in enumerate(np.array_split(qs, 3))
    ]
    batch = cvi.join_batches([shards[0], tmp_path / "shard-1", str(tmp_path / "shard-2")], tmp_path / "all")
    assert len(batch) == 11
    again = cvi.load(tmp_path / "all")
    for name in ("t", "q", "v", "q0"):
        np.testing.assert_array_equal(getattr(batch, name), getattr(again, name))
    np.testing.assert_array_equal(batch.q[:, -1], whole.q[:, -1])
    np.testing.assert_array_equal(batch.q0, qs)
    with pytest.raises(cvi.OverwriteError):
        cvi.join_batches(shards, tmp_path / "all")
    assert len(cvi.join_batches(shards[:2], tmp_path / "all", overwrite=True)) == 8


def test_batches_that_do_not_belong_together_are_not_joined(tmp_path):
    scene, q, v = at_wall()
    first = cvi.simulate_batch(scene, starts(q, 2), v, path=tmp_path / "first", **SETTINGS)
    changed = scene.copy()
    changed.set_contact(restitution=0.123)
    others = {
        "scene": cvi.simulate_batch(changed, starts(q, 2), v, path=tmp_path / "scene", **SETTINGS),
        "options": cvi.simulate_batch(scene, starts(q, 2), v, path=tmp_path / "options", dt=0.01, duration=0.5),
        "keep": cvi.simulate_batch(scene, starts(q, 2), v, path=tmp_path / "keep", keep="ends", **SETTINGS),
        "given": cvi.simulate_batch(scene, starts(q, 2), path=tmp_path / "given", **SETTINGS),
    }
    for name, other in others.items():
        with pytest.raises(cvi.InputError, match=f"do not belong together.*differ in .*{name}"):
            cvi.join_batches([first, other], tmp_path / "all")
    assert not (tmp_path / "all").exists()
    for nothing in ([], tmp_path / "first"):
        with pytest.raises(cvi.InputError, match="nothing to join"):
            cvi.join_batches(nothing, tmp_path / "all")


def test_an_interrupted_batch_goes_on_with_equal_bits(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "BLOCK", 2)
    scene, q, v = at_wall()
    qs = starts(q, 9)
    whole = cvi.simulate_batch(scene, qs, v, keep="nodes", **SETTINGS)
    call = {"keep": "nodes", "path": tmp_path / "runs", "resume": True, **SETTINGS}

    made: list[int] = []
    block_of = runs.block_of

    def counted(plan: Any, *rest: Any) -> Any:
        if len(made) == 3:
            made.clear()
            raise KeyboardInterrupt
        made.append(plan.runs)
        return block_of(plan, *rest)

    monkeypatch.setattr(runs, "block_of", counted)
    with pytest.raises(KeyboardInterrupt):
        cvi.simulate_batch(scene, qs, v, **call)
    assert not (tmp_path / "runs").exists()
    kept = sorted(path.name for path in (tmp_path / "runs.parts").iterdir())
    assert kept == ["0-2", "2-4", "4-6"]
    (tmp_path / "runs.parts" / "2-4").write_bytes(b"damaged")  # as by a full disk: these runs are made again
    monkeypatch.setattr(runs, "block_of", lambda plan, *rest: made.append(plan.runs) or block_of(plan, *rest))
    batch = cvi.simulate_batch(scene, qs, v, **call)
    assert sum(made) == 2 + 3
    assert batch.q.tobytes() == whole.q.tobytes()
    assert batch.v.tobytes() == whole.v.tobytes()
    np.testing.assert_array_equal(batch.q0, qs)
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]
    made.clear()
    assert cvi.simulate_batch(scene, qs, v, **call).q.tobytes() == whole.q.tobytes()
    assert not made  # it is complete


def test_blocks_that_are_kept_take_about_the_same_time(tmp_path, monkeypatch):
    """Of runs that take a tenth of a second each: the first block has one for each lane, the others two seconds."""
    scene, q, v = at_wall()
    qs, now, made, block_of = starts(q, 57), [0.0], [], runs.block_of

    def timed(plan: Any, *rest: Any) -> Any:
        made.append(plan.runs)
        now[0] += 0.1 * plan.runs
        return block_of(plan, *rest)

    monkeypatch.setattr(runs, "block_of", timed)
    monkeypatch.setattr(runs, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    batch = cvi.simulate_batch(scene, qs, v, path=tmp_path / "runs", resume=True, workers=1, **SETTINGS)
    assert made[0] == 8
    assert made[1:-1] == pytest.approx([20] * len(made[1:-1]), abs=1)
    assert batch.q.tobytes() == cvi.simulate_batch(scene, qs, v, keep="nodes", **SETTINGS).q.tobytes()


def test_another_batch_is_not_taken_for_the_one_that_was_interrupted(tmp_path, monkeypatch):
    scene, q, v = at_wall()
    qs = starts(q, 4)
    call = {"path": tmp_path / "runs", "resume": True}
    cvi.simulate_batch(scene, qs, v, **call, **SETTINGS)
    changed = scene.copy()
    changed.set_contact(restitution=0.123)
    for arguments, options in (
        ((scene, qs + 1e-9, v), SETTINGS),
        ((scene, qs, 1.1 * np.asarray(v)), SETTINGS),
        ((scene, qs, v), {**SETTINGS, "duration": 0.5}),
        ((changed, qs, v), SETTINGS),
    ):
        with pytest.raises(cvi.OverwriteError, match="a batch of other starts, scene or options"):
            cvi.simulate_batch(*arguments, **call, **options)
    (tmp_path / "mine").write_text("precious")
    with pytest.raises(cvi.OverwriteError):
        cvi.simulate_batch(scene, qs, v, path=tmp_path / "mine", resume=True, **SETTINGS)
    assert (tmp_path / "mine").read_text() == "precious"


def test_what_cannot_be_resumed_is_refused(tmp_path):
    scene, q, v = at_wall()
    with pytest.raises(cvi.InputError, match="a path with resume=True"):
        cvi.simulate_batch(scene, q, v, resume=True, **SETTINGS)
    with pytest.raises(cvi.InputError, match="cannot be resumed.*control"):
        cvi.simulate_batch(
            scene, q, v, control=lambda t, q, v: 0.0 * v, path=tmp_path / "runs", resume=True, **SETTINGS
        )


@pytest.mark.slow
def test_the_example_of_a_job_array_runs_as_one(tmp_path):
    """Three tasks as processes of their own, one of them twice, and the join: the bits of one call."""
    program = [sys.executable, str(ROOT / "examples" / "slurm_array.py")]

    def task(*arguments: str, **variables: str) -> str:
        environment = {**os.environ, "PYTHONPATH": str(Path(cvi.__file__).parents[1]), **variables}
        done = subprocess.run(
            [*program, *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout

    for k in (0, 1, 1, 2):
        task("--runs", "30", SLURM_ARRAY_TASK_ID=str(k), SLURM_ARRAY_TASK_COUNT="3")
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"shard-{k:04}.npz" for k in range(3)]
    assert "30 runs" in task("--join")
    task("--runs", "30", "--folder", "one", SLURM_ARRAY_TASK_ID="0", SLURM_ARRAY_TASK_COUNT="1")
    one, many = cvi.load_batch(tmp_path / "one" / "shard-0000.npz"), cvi.load_batch(tmp_path / "runs.npz")
    assert len(many) == 30
    assert many.q.tobytes() == one.q.tobytes()
